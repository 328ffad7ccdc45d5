// The Gaussians of a scene as rows of a texture. The anchors of a block fill one row, independent of the view.
//
// A Gaussian has three texels of four 32-bit words:
//
//   mean x, y, z, opacity            f32
//   covariance xx, xy, xz, yy        f32
//   covariance yz, zz                f32, then red and green, blue and unit, 16 bits each: colours as fractions of unit
//
// The unit is 1 unless a colour is above 1, as in a static scene (14.6). In a static scene, a row is computed once, and
// the page computes the colours from harmonics: the numbers of a Gaussian by layers of four, each layer for a whole row.
import { isStatic } from "../web/container.js";
import { boundsOf } from "../web/gaussians.js";
import { activated } from "../web/splat.js";

// Gaussians of a row.
export const WIDTH = 1024;
export const TEXELS = 3;
const WORDS = 4 * TEXELS;
// The bytes of rows that wait for the page, and of those that it gets at once.
const WAITING_MAX = 16 << 20;
const UPLOAD_MAX = 4 << 20;
// A click hits Gaussians within this angle of its ray.
const COS_NEAR = Math.cos(0.15);
const MET = 16;
// The largest unit of colours. The blended numbers are within 16-bit floats.
export const UNIT_MAX = 1 << 15;
// 14.5: an alpha below this counts as 0.
const ALPHA_MIN = 1 / 255;

export class Rows {
  // gaussians: of a scene that is not static. quotas: the most Gaussians of each chunk.
  constructor(scene, gaussians, quotas) {
    const { header } = scene;
    Object.assign(this, { scene, gaussians, most: 0, slots: new Float64Array(quotas.length) });
    this.harmonics = isStatic(header) ? header.colour_outputs : 0;
    // Rows, or parts of rows in a static scene: `slot`, the place of the first Gaussian, and what `packed` returned,
    // for what the page has. In other scenes also the anchors from start to before end, and where they were seen from.
    this.blocks = [];
    this.anchorCount = 0;
    this.view = gaussians?.room(WIDTH);
    // A row may waste up to the offsets of one anchor.
    const least = WIDTH - header.offset_count + 1;
    let next = 0;
    for (const [number, quota] of quotas.entries()) {
      this.slots[number] = next;
      next += gaussians === undefined ? quota : WIDTH * Math.ceil(quota / least);
      this.most += quota;
    }
    this.height = Math.ceil(next / WIDTH);
    // What `packed` returned of the blocks that the page does not have yet.
    Object.assign(this, { waiting: new Map(), waitingBytes: 0 });
  }

  // The memory of all rows, here, in sorting and on the page: 12 bytes of mean and 33 of order per Gaussian, the
  // textures, and the waiting rows.
  get bytes() {
    const layers = layersOf(this.harmonics);
    const texels = 4 * WORDS + (layers > 0 ? 8 * layers + 8 : 0);
    return 45 * this.most + texels * WIDTH * this.height + 2 * WAITING_MAX;
  }

  get isFull() {
    return this.waitingBytes >= WAITING_MAX;
  }

  // A result of the team: for a static scene the blocks, for another one the anchors.
  add({ number, count, blocks, chunk }) {
    this.anchorCount += count;
    if (chunk !== undefined) this.blocks.push(...this.#split(chunk, this.slots[number]));
    for (const { slot, found } of blocks ?? []) {
      const block = { slot, count: 0 };
      this.blocks.push(block);
      this.#wait(block, found);
    }
    this.isMixed = true;
  }

  // The blocks in the order of the file: chunks arrive in any order.
  get ordered() {
    if (this.isMixed) this.blocks.sort((a, b) => a.slot - b.slot);
    this.isMixed = false;
    return this.blocks;
  }

  #wait(block, found) {
    this.waitingBytes += bytesOf(found) - bytesOf(this.waiting.get(block));
    this.waiting.set(block, found);
  }

  *#split(chunk, slot) {
    const { count, masks, positions } = chunk;
    const offsets = this.scene.header.offset_count;
    const before = this.gaussians.anchorCount;
    this.gaussians.add(chunk);
    for (let first = 0; first < count; slot += WIDTH) {
      let [last, kept] = [first, 0];
      for (; last < count; last++) {
        const more = masks.subarray(offsets * last, offsets * (last + 1)).reduce((sum, mask) => sum + mask, 0);
        if (kept + more > WIDTH) break;
        kept += more;
      }
      const anchors = boundsOf(positions.subarray(3 * first, 3 * last));
      yield { slot, start: before + first, end: before + last, anchors, from: undefined, count: 0 };
      first = last;
    }
  }

  // The change of the view of a row: the distance from its last view over the distance to its anchors.
  change({ anchors, from }, centre) {
    if (anchors === undefined) return 0;
    if (from === undefined) return Infinity;
    const way = Math.hypot(...centre.map((x, axis) => x - from[axis]));
    if (way === 0) return 0;
    const { low, high } = anchors;
    const distance = Math.hypot(...centre.map((x, axis) => Math.max(low[axis] - x, 0, x - high[axis])));
    return way / distance;
  }

  // Computes a row of a scene that is not static.
  update(block, centre) {
    const own = this.gaussians.range(block.start, block.end, centre, this.view);
    block.from = [...centre];
    this.#wait(block, packed(own, 0, own.count, 0));
  }

  // Returns the texels of some blocks for the page, which are not kept.
  take() {
    const taken = [];
    let bytes = 0;
    for (const [block, { words, harmonics, ...found }] of this.waiting) {
      taken.push({ slot: block.slot, words, harmonics });
      Object.assign(block, found);
      this.waiting.delete(block);
      bytes += bytesOf({ words, harmonics });
      if (bytes > UPLOAD_MAX) break;
    }
    this.waitingBytes -= bytes;
    return taken;
  }

  // Returns the mean of a Gaussian that a ray hits, or undefined. A quarter of the hits may be in front of it: isolated
  // Gaussians are ignored.
  hit(centre, direction) {
    const ray = direction.map((x) => x / Math.hypot(...direction));
    const near = [];
    this.blocks.forEach(({ means: own, count }) => {
      for (let at = 0; at < 3 * count; at += 3) {
        const way = centre.map((x, axis) => own[at + axis] - x);
        const along = way[0] * ray[0] + way[1] * ray[1] + way[2] * ray[2];
        const cosine = along / Math.hypot(...way);
        if (cosine > COS_NEAR) near.push({ along, cosine, point: own.subarray(at, at + 3) });
      }
    });
    const met = near.sort((a, b) => b.cosine - a.cosine).slice(0, MET).sort((a, b) => a.along - b.along);
    return met[met.length >> 2]?.point;
  }
}

// The blocks of the anchors of a chunk of a static scene. slot: of its first Gaussian.
export function staticBlocks(scene, chunk, slot) {
  const own = activated(scene.splat(chunk));
  const blocks = [];
  for (let from = 0; from < own.count; ) {
    const to = Math.min(own.count, from + WIDTH - ((slot + from) % WIDTH));
    blocks.push({ slot: slot + from, found: packed(own, from, to, scene.header.colour_outputs) });
    from = to;
  }
  return blocks;
}

// Returns the texels of Gaussians that may be seen, words and harmonics. Also count, means, and a sphere around their
// ellipsoids, middle and radius. 14.4: a Gaussian's covariance is that of its axes, turned by its quaternion.
function packed({ positions, scales, rotations, colours, opacities, harmonics }, from, to, numbers) {
  const room = to - from;
  const words = new Uint32Array(WORDS * room);
  const floats = new Float32Array(words.buffer);
  const layers = new Float32Array(4 * room * layersOf(numbers));
  const means = new Float32Array(3 * room);
  let [n, reach] = [0, 0];
  for (let i = from; i < to; i++) {
    if (!(opacities[i] >= ALPHA_MIN)) continue;
    const at = WORDS * n;
    for (let axis = 0; axis < 3; axis++) floats[at + axis] = means[3 * n + axis] = positions[3 * i + axis];
    floats[at + 3] = opacities[i];
    covariance(scales, 3 * i, rotations, 4 * i, floats, at + 4);
    if (colours !== undefined) setColour(colours, 3 * i, words, at + 10);
    for (let j = 0; j < numbers; j++) {
      // The textures have 16-bit floats.
      layers[4 * (room * (j >> 2) + n) + (j & 3)] = Math.max(-65504, Math.min(harmonics[numbers * i + j], 65504));
    }
    // A non-finite number would spread over the image.
    if (!finite(floats, at, at + 10)) continue;
    n++;
    const longest = Math.max(scales[3 * i], scales[3 * i + 1], scales[3 * i + 2]);
    reach = Math.max(reach, longest * Math.sqrt(2 * Math.log(opacities[i] / ALPHA_MIN)));
  }
  const { low, high } = boundsOf(means.subarray(0, 3 * n));
  const middle = Array.from(low, (x, axis) => (x + high[axis]) / 2);
  const radius = Math.hypot(...Array.from(low, (x, axis) => high[axis] - x)) / 2 + reach;
  return { count: n, words: words.subarray(0, WORDS * n), harmonics: layers, means, middle, radius };
}

function bytesOf(found) {
  return found === undefined ? 0 : found.words.byteLength + found.harmonics.byteLength;
}

// The texels of the harmonics of a Gaussian. numbers: of its harmonics.
export function layersOf(numbers) {
  return Math.ceil(numbers / 4);
}

// Writes a colour as two words.
function setColour(colours, from, words, at) {
  const own = [colours[from], colours[from + 1], colours[from + 2]];
  const unit = Math.min(Math.ceil(Math.max(1, ...own)), UNIT_MAX);
  const [red, green, blue] = own.map((x) => Math.round(65535 * Math.min(x / unit, 1)));
  words[at] = red | (green << 16);
  words[at + 1] = blue | (unit << 16);
}

function finite(values, from, to) {
  for (let i = from; i < to; i++) if (!Number.isFinite(values[i])) return false;
  return true;
}

// Writes xx, xy, xz, yy, yz, zz of R S S R^T, with the rotation R of a unit quaternion and the lengths S.
function covariance(scales, s, rotations, r, out, at) {
  const [w, x, y, z] = [rotations[r], rotations[r + 1], rotations[r + 2], rotations[r + 3]];
  const [a, b, c] = [scales[s], scales[s + 1], scales[s + 2]];
  const m00 = a * (1 - 2 * (y * y + z * z)), m01 = b * 2 * (x * y - w * z), m02 = c * 2 * (x * z + w * y);
  const m10 = a * 2 * (x * y + w * z), m11 = b * (1 - 2 * (x * x + z * z)), m12 = c * 2 * (y * z - w * x);
  const m20 = a * 2 * (x * z - w * y), m21 = b * 2 * (y * z + w * x), m22 = c * (1 - 2 * (x * x + y * y));
  out[at] = m00 * m00 + m01 * m01 + m02 * m02;
  out[at + 1] = m00 * m10 + m01 * m11 + m02 * m12;
  out[at + 2] = m00 * m20 + m01 * m21 + m02 * m22;
  out[at + 3] = m10 * m10 + m11 * m11 + m12 * m12;
  out[at + 4] = m10 * m20 + m11 * m21 + m12 * m22;
  out[at + 5] = m20 * m20 + m21 * m21 + m22 * m22;
}
