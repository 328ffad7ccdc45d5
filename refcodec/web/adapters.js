// The plain Gaussians of a static scene in the layouts of other renderers. adapters.d.ts documents them.

const SH_0 = 0.28209479177387814;
// The width of Spark's textures: arrays have whole rows.
const SPARK_ROW = 2048;
// The exponents of Spark's colours with a common exponent.
const [EXPONENT_MIN, EXPONENT_MAX] = [-15, 16];

const floats = new Float32Array(1);
const words = new Uint32Array(floats.buffer);

// The bits of the nearest binary16, or of infinity.
function half(x) {
  floats[0] = x;
  const sign = (words[0] >>> 16) & 0x8000;
  const size = Math.abs(floats[0]);
  if (!(size < 65520)) return sign | (Number.isNaN(size) ? 0x7e00 : 0x7c00);
  const exponent = Math.max(((words[0] >>> 23) & 255) - 127, -14);
  // The sum with 1.5 * 2^23 times the last place rounds to this place.
  const place = 2 ** (exponent - 10);
  const rounded = Math.fround(size + 12582912 * place) - 12582912 * place;
  // Numbers below 2^-14 are subnormal. A carry increments the exponent.
  return sign | ((exponent + 14) * 1024 + rounded / place);
}

// Three numbers with a common exponent: eight bits each, then signs and the exponent.
function common(red, green, blue) {
  const parts = [red, green, blue];
  const most = Math.max(...parts.map(Math.abs));
  const exponent = Math.min(Math.max(Math.ceil(Math.log2(most)), EXPONENT_MIN), EXPONENT_MAX);
  return parts.reduce((word, part, i) => {
    const size = Math.min(Math.round((Math.abs(part) * 255) / 2 ** exponent), 255);
    return word | (size << (8 * i)) | ((part < 0 ? 1 : 0) << (24 + i));
  }, (exponent - EXPONENT_MIN) << 27);
}

// A quaternion w, x, y, z of length 1: its axis on an octahedron, and its angle.
function turn(rotations, at) {
  const sign = rotations[at] < 0 ? -1 : 1;
  const [w, x, y, z] = [0, 1, 2, 3].map((i) => sign * rotations[at + i]);
  const sum = Math.abs(x) + Math.abs(y) + Math.abs(z);
  let [u, v] = sum > 0 ? [x / sum, y / sum] : [1, 0];
  if (z < 0) [u, v] = [(1 - Math.abs(v)) * (u < 0 ? -1 : 1), (1 - Math.abs(u)) * (v < 0 ? -1 : 1)];
  const angle = Math.round((2 * Math.acos(Math.min(w, 1)) * 4095) / Math.PI);
  return (angle << 20) | (Math.round((v / 2 + 0.5) * 1023) << 10) | Math.round((u / 2 + 0.5) * 1023);
}

export function sparkSplats({ count, positions, scales, rotations, opacities, harmonics }) {
  const width = count > 0 ? harmonics.length / count : 3;
  const degree = Math.sqrt(width / 3) - 1;
  const size = 4 * SPARK_ROW * Math.max(Math.ceil(count / SPARK_ROW), 1);
  const [first, second] = [new Uint32Array(size), new Uint32Array(size)];
  const names = [["sh1"], ["sh1", "sh2"], ["sh1", "sh2", "sh3a", "sh3b"]][degree - 1] ?? [];
  const extra = Object.fromEntries(names.map((name) => [name, new Uint32Array(size)]));
  const places = new Float32Array(first.buffer);
  const pair = (a, b) => half(a) | (half(b) << 16);
  for (let i = 0; i < count; i++) {
    const at = 4 * i;
    for (let axis = 0; axis < 3; axis++) places[at + axis] = positions[3 * i + axis];
    first[at + 3] = half(opacities[i]);
    const [red, green, blue] = [0, 1, 2].map((j) => 0.5 + SH_0 * harmonics[width * i + j]);
    const [a, b, c] = [0, 1, 2].map((axis) => Math.log(scales[3 * i + axis]));
    second[at] = pair(red, green);
    second[at + 1] = pair(blue, a);
    second[at + 2] = pair(b, c);
    second[at + 3] = turn(rotations, 4 * i);
    for (let n = 0, from = width * i + 3; 3 * n + 3 < width; n++, from += 3) {
      extra[names[n >> 2]][at + (n & 3)] = common(harmonics[from], harmonics[from + 1], harmonics[from + 2]);
    }
  }
  return { extArrays: [first, second], numSplats: count, extra };
}

export function playCanvasElements({ count, positions, scales, rotations, opacities, harmonics }) {
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
  add("opacity", opacities, 1, 0, (x) => Math.log(x / (1 - x)));
  for (let axis = 0; axis < 3; axis++) add(`scale_${axis}`, scales, 3, axis, Math.log);
  for (let i = 0; i < 4; i++) add(`rot_${i}`, rotations, 4, i);
  return [{ name: "vertex", count, properties }];
}
