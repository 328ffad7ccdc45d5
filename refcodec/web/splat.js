// The Gaussians of a static scene: decoded (SPEC.md 9.4), and seen from a place (14.6).
import { RENDERING } from "./container.js";
import { power, roundScaled } from "./numbers.js";
import { ACTIVATION_MAX } from "./weights.js";

// 2.5
const OUTPUT_BITS = 12;
const SCALING_BITS = 16;
const SCALING_BOUND = 27 * 2 ** 16;

const EXP2 = [1073741824, 744260848, 257945537, 59571654, 10398739, 1330132, 234908];
const LOG2_E = 1549082005;
// 9.4: the outputs of the covariance network for an offset: logarithms of lengths, then a quaternion
const LENGTHS = 3;
const COVARIANCE = 7;
// The numbers of a Gaussian by array, in their order.
const WIDTHS = { means: 3, logLengths: 3, quaternions: 4, logits: 1 };

const clamp = (x, bound) => Math.min(Math.max(x, -bound), bound);

// 7.2: the outputs of some rows of a layer. Each sum is below ACCUMULATOR_BOUND.
function outputs({ weight, bias, exponent }, inputs, first, to) {
  const width = inputs.length;
  for (let o = 0; o < to.length; o++) {
    const row = first + o;
    let sum = bias[row];
    for (let i = 0, at = row * width; i < width; i++, at++) sum += weight[at] * inputs[i];
    const e = exponent[row];
    to[o] = (sum + ((1 << e) >> 1)) >> e;
  }
  return to;
}

// EXPONENTIAL: m, and 2^n
function exponential(t) {
  // Below 2^52, thus exact.
  const y = t * LOG2_E;
  const whole = Math.floor(y / 2 ** 46);
  const fraction = Math.floor((y - whole * 2 ** 46) / 2 ** 16);
  let m = EXP2[6];
  // A product has up to 61 bits. Its two parts, and the floor of their sum, are exact.
  for (let i = 5; i >= 0; i--) {
    const low = m % 2 ** 15;
    const high = (m - low) / 2 ** 15;
    m = EXP2[i] + Math.floor((high * fraction + Math.floor((low * fraction) / 2 ** 15)) / 2 ** 15);
  }
  return { m, unit: power(whole - 30) };
}

const bits = new DataView(new ArrayBuffer(8));

// ROUND_F32 of x * m * unit, for x an f32. The product has up to 55 bits. Two products with parts of m are exact. Their
// sum is rounded to odd: to the neighbour with an odd significand if it is not exact. Thus f32 rounds it correctly.
function product(x, { m, unit }) {
  const low = m % 2 ** 16;
  const [most, least] = [x * (m - low), x * low];
  const sum = most + least;
  const rest = least - (sum - most);
  if (rest === 0) return Math.fround(sum * unit);
  bits.setFloat64(0, sum);
  const word = bits.getUint32(4);
  if (word % 2 === 0) {
    const away = rest > 0 === sum > 0;
    if (!away && word === 0) bits.setUint32(0, bits.getUint32(0) - 1);
    bits.setUint32(4, away ? word + 1 : word - 1);
  }
  return Math.fround(bits.getFloat64(0) * unit);
}

// ADD_F32. Binary64 has more than twice the digits, thus rounding twice gives the same. The 0 turns -0 into +0.
function add(a, b) {
  return Math.fround(a + b) + 0;
}

// SPLAT for the anchors of a scene
export class Splatter {
  #header;
  #features;
  #networks;

  // layers: from parseWeights
  constructor({ header, features }, layers) {
    this.#header = header;
    this.#features = features;
    this.#networks = RENDERING.map((name) => layers.filter(({ network }) => network === name).map(({ rows }) => rows));
  }

  // Returns the arrays of WIDTHS and harmonics, and count, the number of Gaussians.
  splat({ count, positions, masks, features, scalings, offsets }) {
    const { offset_count: k, colour_outputs: colours, render_width: width } = this.#header;
    const f = this.#features;
    let kept = 0;
    for (const mask of masks) kept += mask !== 0 ? 1 : 0;
    const own = { count: kept };
    for (const [name, size] of Object.entries(WIDTHS)) own[name] = new Float32Array(size * kept);
    own.harmonics = new Float32Array(colours * kept);
    const inputs = new Int32Array(f);
    const hidden = RENDERING.map(() => new Int32Array(width));
    const [opacity, covariance, colour] = [1, COVARIANCE, colours].map((size) => new Int32Array(size));
    const s = new Float64Array(6);
    for (let anchor = 0, slot = 0; anchor < count; anchor++) {
      const mask = masks.subarray(k * anchor, k * (anchor + 1));
      if (mask.every((value) => value === 0)) continue;
      for (let i = 0; i < f; i++) inputs[i] = clamp(roundScaled(features[f * anchor + i], 1), ACTIVATION_MAX);
      this.#networks.forEach(([rows], n) => {
        const to = outputs(rows, inputs, 0, hidden[n]);
        for (let i = 0; i < width; i++) to[i] = Math.min(Math.max(to[i], 0), ACTIVATION_MAX);
      });
      for (let i = 0; i < 6; i++) s[i] = clamp(roundScaled(scalings[6 * anchor + i], 2 ** SCALING_BITS), SCALING_BOUND);
      const exponentials = [exponential(s[0]), exponential(s[1]), exponential(s[2])];
      for (let offset = 0; offset < k; offset++) {
        if (mask[offset] === 0) continue;
        // The outputs for other offsets are not used.
        [opacity, covariance, colour].forEach((to, n) => {
          outputs(this.#networks[n][1], hidden[n], offset * to.length, to);
        });
        for (let axis = 0; axis < 3; axis++) {
          const from = offsets[3 * (k * anchor + offset) + axis];
          const length = s[3 + axis] + covariance[axis] * 2 ** (SCALING_BITS - OUTPUT_BITS);
          own.means[3 * slot + axis] = add(positions[3 * anchor + axis], product(from, exponentials[axis]));
          own.logLengths[3 * slot + axis] = length / 2 ** SCALING_BITS;
        }
        const quaternion = covariance.subarray(LENGTHS);
        if (quaternion.every((x) => x === 0)) quaternion[0] = 1 << OUTPUT_BITS;
        for (let i = 0; i < 4; i++) own.quaternions[4 * slot + i] = quaternion[i] / 2 ** OUTPUT_BITS;
        own.logits[slot] = opacity[0] / 2 ** OUTPUT_BITS;
        for (let i = 0; i < colours; i++) own.harmonics[colours * slot + i] = colour[i] / 2 ** OUTPUT_BITS;
        slot++;
      }
    }
    return own;
  }
}

// The numbers of each Gaussian one after the other, as in the part splat (9.3)
export function rowsOf({ count, ...arrays }) {
  const list = Object.values(arrays).map((array) => [array, count === 0 ? 0 : array.length / count]);
  const width = list.reduce((sum, [, own]) => sum + own, 0);
  const rows = new Float32Array(width * count);
  let first = 0;
  for (const [array, own] of list) {
    for (let i = 0; i < array.length; i++) rows[width * Math.floor(i / own) + first + (i % own)] = array[i];
    first += own;
  }
  return rows;
}

// HARMONICS: sets the first ones of 16 numbers
function setHarmonics(x, y, z, count, to) {
  to[0] = 0.28209479177387814;
  if (count === 1) return;
  to[1] = -0.4886025119029199 * y;
  to[2] = 0.4886025119029199 * z;
  to[3] = -0.4886025119029199 * x;
  if (count === 4) return;
  to[4] = 1.0925484305920792 * x * y;
  to[5] = -1.0925484305920792 * y * z;
  to[6] = 0.31539156525252005 * (2 * z * z - x * x - y * y);
  to[7] = -1.0925484305920792 * x * z;
  to[8] = 0.5462742152960396 * (x * x - y * y);
  if (count === 9) return;
  to[9] = -0.5900435899266435 * y * (3 * x * x - y * y);
  to[10] = 2.890611442640554 * x * y * z;
  to[11] = -0.4570457994644658 * y * (4 * z * z - x * x - y * y);
  to[12] = 0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y);
  to[13] = -0.4570457994644658 * x * (4 * z * z - x * x - y * y);
  to[14] = 1.445305721320277 * z * (x * x - y * y);
  to[15] = -0.5900435899266435 * x * (x * x - 3 * y * y);
}

// Draws anchors of a static scene, for Gaussians. Only colours depend on the place.
export class StaticRenderer {
  #scene;
  #values;
  #count;

  constructor(scene) {
    this.#scene = scene;
    this.#count = scene.header.colour_outputs / 3;
    this.#values = new Float64Array(this.#count);
  }

  // STATIC_GAUSSIAN except the colours. Opacity 0 marks a Gaussian that is not drawn.
  add(anchors) {
    const { count, means, logLengths: scales, quaternions: rotations, logits, harmonics } = this.#scene.splat(anchors);
    const k = this.#scene.header.offset_count;
    const offsets = new Uint8Array(count);
    let slot = 0;
    anchors.masks.forEach((mask, i) => {
      if (mask !== 0) offsets[slot++] = i % k;
    });
    scales.forEach((x, i) => (scales[i] = Math.exp(x)));
    const opacities = logits.map((x) => 1 / (1 + Math.exp(-x)));
    for (let i = 0; i < count; i++) {
      const rotation = rotations.subarray(4 * i, 4 * i + 4);
      const length = Math.sqrt(rotation.reduce((sum, x) => sum + x * x, 0));
      rotation.forEach((x, at) => (rotation[at] = x / length));
      const numbers = [...means.subarray(3 * i, 3 * i + 3), ...scales.subarray(3 * i, 3 * i + 3)];
      if (!numbers.every(Number.isFinite)) opacities[i] = 0;
    }
    return { means, scales, rotations, opacities, harmonics, offsets };
  }

  release() {}

  // Appends the Gaussians of the anchors from `start` to before `end` to a view. slots: those before each anchor.
  // first: the number of the first anchor.
  draw(own, slots, start, end, [x, y, z], first, view) {
    const [values, count] = [this.#values, this.#count];
    for (let anchor = start; anchor < end; anchor++) {
      for (let from = slots[anchor]; from < slots[anchor + 1]; from++) {
        if (!(own.opacities[from] > 0)) continue;
        const to = view.count++;
        for (let i = 0; i < 3; i++) {
          view.positions[3 * to + i] = own.means[3 * from + i];
          view.scales[3 * to + i] = own.scales[3 * from + i];
        }
        for (let i = 0; i < 4; i++) view.rotations[4 * to + i] = own.rotations[4 * from + i];
        view.opacities[to] = own.opacities[from];
        view.anchors[to] = first + anchor;
        view.offsets[to] = own.offsets[from];
        const away = [own.means[3 * from] - x, own.means[3 * from + 1] - y, own.means[3 * from + 2] - z];
        const distance = Math.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2);
        const scale = distance > 0 ? 1 / distance : 0;
        setHarmonics(away[0] * scale, away[1] * scale, away[2] * scale, count, values);
        for (let i = 0; i < 3; i++) {
          let sum = 0.5;
          for (let n = 0, at = 3 * count * from + i; n < count; n++, at += 3) sum += values[n] * own.harmonics[at];
          view.colours[3 * to + i] = Math.max(sum, 0);
        }
      }
    }
  }
}
