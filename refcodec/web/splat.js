// The Gaussians of a static scene: decoded (SPEC.md 9.4), and seen from a place (14.6).
import { anchorArrays, RENDERING } from "./container.js";
import { PIECE } from "./kernel.js";

// Returns the arrays of anchors, and their widths. Throws TypeError for others.
export function checkedArrays({ header }, anchors) {
  const { count } = anchors;
  if (!Number.isSafeInteger(count) || count < 0) throw new TypeError("the count of a chunk is no number of anchors");
  return Object.entries(anchorArrays(header)).map(([name, [type, width]]) => {
    const array = anchors[name];
    if (!(array instanceof type) || array.length !== count * width) {
      throw new TypeError(`${name} is no ${type.name} of ${count} x ${width} numbers`);
    }
    return [array, width];
  });
}

// SPLAT for the anchors of a scene
export class Splatter {
  #scene;
  #kernel;
  #networks;
  // The numbers of a Gaussian by array, in their order.
  #widths;

  // coding: from parseWeights. The rows of the rendering networks are last.
  constructor(scene, kernel, { layers, coding }) {
    this.#scene = scene;
    this.#kernel = kernel;
    this.#widths = { means: 3, logLengths: 3, quaternions: 4, logits: 1, harmonics: scene.header.colour_outputs };
    const own = layers.filter(({ network }) => RENDERING.includes(network));
    const rows = own.reduce((sum, { outputs }) => sum + outputs, 0);
    const weights = own.reduce((sum, { outputs, inputs }) => sum + outputs * inputs, 0);
    const { weight, bias, exponent } = coding;
    const last = [weight.subarray(weight.length - weights), bias.subarray(bias.length - rows)];
    this.#networks = kernel.makeSplatter(scene, ...last, exponent.subarray(exponent.length - rows));
  }

  // Returns the arrays, and count, the number of Gaussians. check: called with this number first.
  splat(anchors, check) {
    const arrays = checkedArrays(this.#scene, anchors);
    const names = Object.entries(this.#widths);
    const keptOf = (masks) => masks.reduce((sum, mask) => sum + (mask !== 0 ? 1 : 0), 0);
    const whole = keptOf(anchors.masks);
    check(whole);
    const found = { count: 0 };
    for (const [name, width] of names) found[name] = new Float32Array(width * whole);
    for (let from = 0; from < anchors.count; from += PIECE) {
      const count = Math.min(PIECE, anchors.count - from);
      const piece = arrays.map(([array, width]) => array.subarray(from * width, (from + count) * width));
      const kept = keptOf(piece[1]);
      const splats = this.#kernel.splat(this.#networks, count, piece, kept, Object.values(this.#widths));
      names.forEach(([name, width], i) => found[name].set(splats[i], width * found.count));
      found.count += kept;
    }
    return found;
  }
}

// STATIC_GAUSSIAN except the colours, in place of the numbers of a splat. Opacity 0 marks a Gaussian that is not drawn,
// since it is transparent or a number of it is infinite.
export function activated({ count, means: positions, logLengths: scales, quaternions: rotations, logits, harmonics }) {
  const opacities = logits;
  for (let i = 0; i < scales.length; i++) scales[i] = Math.exp(scales[i]);
  for (let i = 0; i < count; i++) {
    let square = 0;
    for (let at = 4 * i; at < 4 * i + 4; at++) square += rotations[at] * rotations[at];
    const length = Math.sqrt(square);
    for (let at = 4 * i; at < 4 * i + 4; at++) rotations[at] /= length;
    opacities[i] = 1 / (1 + Math.exp(-logits[i]));
    let check = 0;
    for (let at = 3 * i; at < 3 * i + 3; at++) check += positions[at] * 0 + scales[at] * 0;
    // The other numbers are the only ones that can be infinite, which would spread over bounds and images.
    if (check === 0) continue;
    opacities[i] = 0;
    for (const own of [positions, scales]) own.fill(0, 3 * i, 3 * i + 3);
  }
  return { count, positions, scales, rotations, opacities, harmonics };
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

  // Returns the Gaussians, and the number of the offset of each.
  add(anchors) {
    const own = activated(this.#scene.splat(anchors));
    const k = this.#scene.header.offset_count;
    const offsets = new Uint8Array(own.count);
    let slot = 0;
    anchors.masks.forEach((mask, i) => {
      if (mask !== 0) offsets[slot++] = i % k;
    });
    return { ...own, offsets };
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
          view.positions[3 * to + i] = own.positions[3 * from + i];
          view.scales[3 * to + i] = own.scales[3 * from + i];
        }
        for (let i = 0; i < 4; i++) view.rotations[4 * to + i] = own.rotations[4 * from + i];
        view.opacities[to] = own.opacities[from];
        view.anchors[to] = first + anchor;
        view.offsets[to] = own.offsets[from];
        const away = [own.positions[3 * from] - x, own.positions[3 * from + 1] - y, own.positions[3 * from + 2] - z];
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
