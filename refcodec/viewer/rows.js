// The Gaussians of a scene as rows of a texture. The anchors of a block fill one row, independent of the view.
//
// A Gaussian has three texels of four 32-bit words:
//
//   mean x, y, z, opacity            f32
//   covariance xx, xy, xz, yy        f32
//   covariance yz, zz                f32, then red and green, blue and unit, 16 bits each: colours as fractions of unit
//
// The unit is 1 unless a colour is above 1, as in a static scene (14.6).
import { boundsOf } from "../web/gaussians.js";

// Gaussians of a row.
export const WIDTH = 1024;
export const TEXELS = 3;
const WORDS = 4 * TEXELS;
export const ROW_WORDS = WORDS * WIDTH;
// The most rows that wait for the page. A row takes 48 KiB here and in transit.
export const WAITING_MAX = 1024;
// A click hits Gaussians within this angle of its ray.
const COS_NEAR = Math.cos(0.15);
const MET = 16;
// The largest unit of colours. The blended numbers are within 16-bit floats.
const UNIT_MAX = 1 << 15;
// 14.5: an alpha below this counts as 0.
const ALPHA_MIN = 1 / 255;

export class Rows {
  // gaussians: of the decoder. entries: those of the chunk index.
  constructor(gaussians, entries) {
    this.gaussians = gaussians;
    // For each row: the anchors from start to before end, their bounds, and the place of their last view.
    this.blocks = [];
    this.view = gaussians.room(WIDTH);
    // A row may waste up to the offsets of one anchor.
    const least = WIDTH - gaussians.scene.header.offset_count + 1;
    this.height = 0;
    this.most = 0;
    for (const { kept } of entries) {
      this.height += Math.floor(kept / least) + 1;
      this.most += kept;
    }
    // The sorted and the drawn order. They grow with the rows.
    this.means = [];
    this.words = [];
    this.counts = [];
  }

  // The memory of all rows, here, in sorting and on the page: 12 bytes of mean and 33 of order per Gaussian, the
  // texture, and the waiting rows.
  get bytes() {
    return 45 * this.most + 4 * ROW_WORDS * (this.height + 2 * Math.min(this.height, WAITING_MAX));
  }

  // added: from Gaussians. chunk: its anchors.
  add({ start }, { count, masks, positions }) {
    const offsets = this.gaussians.scene.header.offset_count;
    for (let first = 0; first < count; ) {
      let [last, kept] = [first, 0];
      for (; last < count; last++) {
        const more = masks.subarray(offsets * last, offsets * (last + 1)).reduce((sum, mask) => sum + mask, 0);
        if (kept + more > WIDTH) break;
        kept += more;
      }
      const own = boundsOf(positions.subarray(3 * first, 3 * last));
      this.blocks.push({ start: start + first, end: start + last, ...own, from: undefined });
      this.means.push(new Float32Array(3 * kept));
      this.words.push(undefined);
      this.counts.push(0);
      first = last;
    }
  }

  // Runs the networks for a row. 14.4: a Gaussian's covariance is that of its axes, turned by its quaternion.
  update(row, centre) {
    const block = this.blocks[row];
    block.from = [...centre];
    const { count, positions, scales, rotations, colours, opacities } = this.gaussians.range(
      block.start, block.end, centre, this.view,
    );
    const words = new Uint32Array(WORDS * Math.max(count, 1));
    const floats = new Float32Array(words.buffer);
    const means = this.means[row];
    let n = 0;
    for (let i = 0; i < count; i++) {
      if (!(opacities[i] >= ALPHA_MIN)) continue;
      const at = WORDS * n;
      for (let axis = 0; axis < 3; axis++) floats[at + axis] = means[3 * n + axis] = positions[3 * i + axis];
      floats[at + 3] = opacities[i];
      covariance(scales, 3 * i, rotations, 4 * i, floats, at + 4);
      const own = [colours[3 * i], colours[3 * i + 1], colours[3 * i + 2]];
      const unit = Math.min(Math.ceil(Math.max(1, own[0], own[1], own[2])), UNIT_MAX);
      const [red, green, blue] = own.map((x) => Math.round(65535 * Math.min(x / unit, 1)));
      words[at + 10] = red | (green << 16);
      words[at + 11] = blue | (unit << 16);
      // A non-finite number would spread over the image.
      if (finite(floats, at, at + 10)) n++;
    }
    this.counts[row] = n;
    this.words[row] = words.subarray(0, WORDS * n);
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

  // Returns the words of some rows in a sequence, and transfers them.
  packed(rows) {
    const data = new Uint32Array(ROW_WORDS * rows.length);
    rows.forEach((row, i) => {
      data.set(this.words[row], ROW_WORDS * i);
      this.words[row] = undefined;
    });
    return data;
  }
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

// The change of the view of a row: the distance from its last view over the distance to its anchors.
export function change({ low, high, from }, centre) {
  if (from === undefined) return Infinity;
  const way = Math.hypot(...centre.map((x, axis) => x - from[axis]));
  if (way === 0) return 0;
  const distance = Math.hypot(...centre.map((x, axis) => Math.max(low[axis] - x, 0, x - high[axis])));
  return way / distance;
}
