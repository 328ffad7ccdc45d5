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
import { anchorArrays, isStatic } from "../web/container.js";
import { boundsOf } from "../web/gaussians.js";
import { activated } from "../web/splat.js";

// Gaussians of a row.
export const WIDTH = 1024;
export const TEXELS = 3;
const WORDS = 4 * TEXELS;
// The bytes of rows that wait for the page.
const WAITING_MAX = 48 << 20;
// A click hits Gaussians within this angle of its ray.
const COS_NEAR = Math.cos(0.15);
const MET = 16;
// The largest unit of colours. The blended numbers are within 16-bit floats.
export const UNIT_MAX = 1 << 15;
// 14.5: an alpha below this counts as 0.
const ALPHA_MIN = 1 / 255;

export class Rows {
  // gaussians: of a scene that is not static. entries: those of the chunk index.
  constructor(scene, gaussians, entries) {
    const { header } = scene;
    const k = header.offset_count;
    Object.assign(this, { scene, gaussians });
    this.harmonics = isStatic(header) ? header.colour_outputs : 0;
    // For each row: the anchors from start to before end, their bounds, and the place of their last view.
    this.blocks = [];
    this.anchorCount = 0;
    this.view = gaussians?.room(WIDTH);
    // A row may waste up to the offsets of one anchor.
    const least = WIDTH - k + 1;
    this.height = 0;
    this.most = 0;
    for (const { kept } of entries) {
      this.height += Math.floor(kept / least) + 1;
      this.most += kept;
    }
    // The bytes of a row here or in transit.
    this.rowBytes = 4 * WIDTH * (WORDS + 4 * layersOf(this.harmonics));
    // The most rows that wait for the page.
    this.waitingMax = Math.max(1, Math.floor(WAITING_MAX / this.rowBytes));
    this.means = [];
    this.found = [];
    this.counts = [];
  }

  // The memory of all rows, here, in sorting and on the page: 12 bytes of mean and 33 of order per Gaussian, the
  // textures, and the waiting rows.
  get bytes() {
    const colours = this.harmonics > 0 ? 8 * WIDTH * this.height : 0;
    return 45 * this.most + colours + this.rowBytes * (this.height + 2 * Math.min(this.height, this.waitingMax));
  }

  // chunk: its anchors.
  add(chunk) {
    const { count, masks, positions } = chunk;
    const offsets = this.scene.header.offset_count;
    this.gaussians?.add(chunk);
    for (let first = 0; first < count; ) {
      let [last, kept] = [first, 0];
      for (; last < count; last++) {
        const more = masks.subarray(offsets * last, offsets * (last + 1)).reduce((sum, mask) => sum + mask, 0);
        if (kept + more > WIDTH) break;
        kept += more;
      }
      const own = boundsOf(positions.subarray(3 * first, 3 * last));
      const anchors = this.gaussians === undefined ? this.#part(chunk, first, last) : undefined;
      const [start, end] = [this.anchorCount + first, this.anchorCount + last];
      this.blocks.push({ start, end, ...own, from: undefined, anchors });
      this.means.push(new Float32Array(3 * kept));
      this.found.push(undefined);
      this.counts.push(0);
      first = last;
    }
    this.anchorCount += count;
  }

  #part(chunk, first, last) {
    const part = ([name, [, width]]) => [name, chunk[name].subarray(width * first, width * last)];
    return { count: last - first, ...Object.fromEntries(Object.entries(anchorArrays(this.scene.header)).map(part)) };
  }

  // The change of the view of a row: the distance from its last view over the distance to its anchors.
  change({ low, high, from }, centre) {
    if (from === undefined) return Infinity;
    if (this.gaussians === undefined) return 0;
    const way = Math.hypot(...centre.map((x, axis) => x - from[axis]));
    if (way === 0) return 0;
    const distance = Math.hypot(...centre.map((x, axis) => Math.max(low[axis] - x, 0, x - high[axis])));
    return way / distance;
  }

  // The Gaussians of a row for a view.
  #seen(block, centre) {
    if (this.gaussians !== undefined) return this.gaussians.range(block.start, block.end, centre, this.view);
    const own = activated(this.scene.splat(block.anchors));
    block.anchors = undefined;
    return own;
  }

  // Computes a row. 14.4: a Gaussian's covariance is that of its axes, turned by its quaternion.
  update(row, centre) {
    const block = this.blocks[row];
    block.from = [...centre];
    const { count, positions, scales, rotations, colours, opacities, harmonics } = this.#seen(block, centre);
    const words = new Uint32Array(WORDS * count);
    const floats = new Float32Array(words.buffer);
    const layers = new Float32Array(4 * WIDTH * layersOf(this.harmonics));
    const means = this.means[row];
    let n = 0;
    for (let i = 0; i < count; i++) {
      if (!(opacities[i] >= ALPHA_MIN)) continue;
      const at = WORDS * n;
      for (let axis = 0; axis < 3; axis++) floats[at + axis] = means[3 * n + axis] = positions[3 * i + axis];
      floats[at + 3] = opacities[i];
      covariance(scales, 3 * i, rotations, 4 * i, floats, at + 4);
      if (colours !== undefined) setColour(colours, 3 * i, words, at + 10);
      for (let j = 0, from = this.harmonics * i; j < this.harmonics; j++) {
        layers[4 * (WIDTH * (j >> 2) + n) + (j & 3)] = harmonics[from + j];
      }
      // A non-finite number would spread over the image.
      if (finite(floats, at, at + 10)) n++;
    }
    this.counts[row] = n;
    this.found[row] = { row, words: words.subarray(0, WORDS * n), harmonics: layers };
  }

  // Returns the mean of a Gaussian that a ray hits, or undefined. A quarter of the hits may be in front of it: isolated
  // Gaussians are ignored.
  hit(centre, direction) {
    const ray = direction.map((x) => x / Math.hypot(...direction));
    const near = [];
    this.means.forEach((own, row) => {
      for (let at = 0; at < 3 * this.counts[row]; at += 3) {
        const way = centre.map((x, axis) => own[at + axis] - x);
        const along = way[0] * ray[0] + way[1] * ray[1] + way[2] * ray[2];
        const cosine = along / Math.hypot(...way);
        if (cosine > COS_NEAR) near.push({ along, cosine, point: own.subarray(at, at + 3) });
      }
    });
    const met = near.sort((a, b) => b.cosine - a.cosine).slice(0, MET).sort((a, b) => a.along - b.along);
    return met[met.length >> 2]?.point;
  }

  // Returns some rows, and does not keep them.
  take(rows) {
    return rows.map((row) => {
      const found = this.found[row];
      this.found[row] = undefined;
      return found;
    });
  }
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
