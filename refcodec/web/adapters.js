// Plain Gaussians in the layouts of other renderers. adapters.d.ts documents them.
import { checkMore } from "./bounds.js";
import { SH_0 } from "./numbers.js";

// The width of Spark's textures: arrays have whole rows.
const SPARK_ROW = 2048;
// The exponents of Spark's colours with a common exponent, and the unit of their eight bits by exponent.
const [EXPONENT_MIN, EXPONENT_MAX] = [-15, 16];
const UNITS = Float64Array.from({ length: 32 }, (_, i) => 255 / 2 ** (i + EXPONENT_MIN));
// The largest binary16 and its least exponent, the places of its numbers by exponent, and the smallest binary32.
const [LARGEST, LEAST, SMALLEST] = [65504, -14, 2 ** -149];
const PLACES = Float64Array.from({ length: 30 }, (_, i) => 2 ** (i + LEAST - 10));

const floats = new Float32Array(1);
const words = new Uint32Array(floats.buffer);

// The bits of the nearest binary16 that is finite.
function half(x) {
  floats[0] = Math.min(Math.max(x, -LARGEST), LARGEST);
  const sign = (words[0] >>> 16) & 0x8000;
  const size = Math.abs(floats[0]);
  const exponent = Math.max(((words[0] >>> 23) & 255) - 127, LEAST);
  // The sum with 1.5 * 2^23 times the last place rounds to this place.
  const place = PLACES[exponent - LEAST];
  const rounded = Math.fround(size + 12582912 * place) - 12582912 * place;
  // Numbers below 2^-14 are subnormal. A carry increments the exponent.
  return sign | ((exponent - LEAST) * 1024 + rounded / place);
}

// Three numbers with a common exponent: eight bits each, then signs and the exponent.
function common(harmonics, from) {
  floats[0] = 0;
  for (let i = from; i < from + 3; i++) floats[0] = Math.max(floats[0], Math.abs(harmonics[i]));
  // That of the next power of two.
  const exponent = ((words[0] + 0x7fffff) >>> 23) - 127;
  const place = Math.min(Math.max(exponent, EXPONENT_MIN), EXPONENT_MAX) - EXPONENT_MIN;
  let word = place << 27;
  for (let i = 0; i < 3; i++) {
    const x = harmonics[from + i];
    word |= Math.min(Math.round(Math.abs(x) * UNITS[place]), 255) << (8 * i);
    if (x < 0) word |= 1 << (24 + i);
  }
  return word;
}

// A quaternion w, x, y, z of length 1: its axis on an octahedron, and its angle.
function turn(rotations, at) {
  const sign = rotations[at] < 0 ? -1 : 1;
  const x = sign * rotations[at + 1], y = sign * rotations[at + 2], z = sign * rotations[at + 3];
  const sum = Math.abs(x) + Math.abs(y) + Math.abs(z);
  let u = sum > 0 ? x / sum : 1, v = sum > 0 ? y / sum : 0;
  if (z < 0) [u, v] = [(1 - Math.abs(v)) * (u < 0 ? -1 : 1), (1 - Math.abs(u)) * (v < 0 ? -1 : 1)];
  const angle = Math.round((2 * Math.acos(Math.min(sign * rotations[at], 1)) * 4095) / Math.PI);
  return (angle << 20) | (Math.round((v / 2 + 0.5) * 1023) << 10) | Math.round((u / 2 + 0.5) * 1023);
}

export function sparkSplats(gaussians) {
  const { count, positions, scales, rotations, opacities, harmonics } = gaussians;
  const width = count > 0 ? harmonics.length / count : 3;
  const names = [["sh1"], ["sh1", "sh2"], ["sh1", "sh2", "sh3a", "sh3b"]][Math.sqrt(width / 3) - 2] ?? [];
  const size = 4 * SPARK_ROW * Math.max(Math.ceil(count / SPARK_ROW), 1);
  checkMore(gaussians, 4 * size * (2 + names.length));
  const [first, second, ...more] = Array.from({ length: 2 + names.length }, () => new Uint32Array(size));
  const places = new Float32Array(first.buffer);
  const pair = (a, b) => half(a) | (half(b) << 16);
  const colour = (i) => 0.5 + SH_0 * harmonics[i];
  const length = (i) => Math.log(Math.max(scales[i], SMALLEST));
  for (let i = 0; i < count; i++) {
    const at = 4 * i;
    for (let axis = 0; axis < 3; axis++) places[at + axis] = positions[3 * i + axis];
    first[at + 3] = half(opacities[i]);
    second[at] = pair(colour(width * i), colour(width * i + 1));
    second[at + 1] = pair(colour(width * i + 2), length(3 * i));
    second[at + 2] = pair(length(3 * i + 1), length(3 * i + 2));
    second[at + 3] = turn(rotations, 4 * i);
    for (let n = 1; 3 * n < width; n++) more[(n - 1) >> 2][at + ((n - 1) & 3)] = common(harmonics, width * i + 3 * n);
  }
  const extra = Object.fromEntries(names.map((name, i) => [name, more[i]]));
  return { extArrays: [first, second], numSplats: count, extra };
}

export function playCanvasElements(gaussians) {
  const { count, positions, scales, rotations, opacities, harmonics } = gaussians;
  checkMore(gaussians, [positions, scales, rotations, opacities, harmonics].reduce((sum, own) => sum + own.byteLength, 0));
  const width = count > 0 ? harmonics.length / count : 3;
  const properties = [];
  const add = (name, array, size, at, of = (x) => x) => {
    const storage = new Float32Array(count);
    for (let i = 0; i < count; i++) storage[i] = of(array[size * i + at]);
    properties.push({ type: "float", name, storage, byteSize: 4 });
  };
  ["x", "y", "z"].forEach((name, axis) => add(name, positions, 3, axis));
  for (let j = 0; j < 3; j++) add(`f_dc_${j}`, harmonics, width, j);
  // All harmonics of red come first, then those of green and of blue.
  const rest = width / 3 - 1;
  for (let j = 0; j < 3 * rest; j++) add(`f_rest_${j}`, harmonics, width, 3 * (1 + (j % rest)) + Math.floor(j / rest));
  const logit = (x) => Math.log(Math.max(x, SMALLEST) / Math.max(1 - x, 2 ** -25));
  add("opacity", opacities, 1, 0, logit);
  for (let axis = 0; axis < 3; axis++) add(`scale_${axis}`, scales, 3, axis, (x) => Math.log(Math.max(x, SMALLEST)));
  for (let i = 0; i < 4; i++) add(`rot_${i}`, rotations, 4, i);
  return [{ name: "vertex", count, properties }];
}
