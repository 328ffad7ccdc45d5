// The drawing order: Gaussians by decreasing depth. At equal depth, the first one in the file is nearest (SPEC.md
// 14.5).
import { WIDTH } from "./rows.js";

const RADIX = 1 << 16;

export class Sorter {
  constructor() {
    this.counts = new Uint32Array(RADIX);
    this.room(0);
  }

  room(size) {
    this.keys = new Uint32Array(size);
    this.depths = new Float32Array(this.keys.buffer);
    this.slots = new Uint32Array(size);
    this.otherKeys = new Uint32Array(size);
    this.otherSlots = new Uint32Array(size);
  }

  // Returns row * WIDTH + column of each Gaussian that is not behind the near plane (14.4), the farthest one first.
  order({ means, counts }, centre, rotation, near) {
    const all = counts.reduce((sum, count) => sum + count, 0);
    if (all > this.slots.length) this.room(Math.ceil(1.25 * all));
    const [x, y, z] = rotation.slice(6);
    const shift = x * centre[0] + y * centre[1] + z * centre[2];
    let n = 0;
    for (let row = 0; row < counts.length; row++) {
      const own = means[row];
      for (let i = 0, at = 0; i < counts[row]; i++, at += 3) {
        const depth = x * own[at] + y * own[at + 1] + z * own[at + 2] - shift;
        if (depth > near) {
          // The bits of positive floats are in the order of the floats.
          this.depths[n] = depth;
          this.slots[n++] = row * WIDTH + i;
        }
      }
    }
    this.pass(n, 0, this.keys, this.slots, this.otherKeys, this.otherSlots);
    this.pass(n, 16, this.otherKeys, this.otherSlots, this.keys, this.slots);
    return this.slots.slice(0, n).reverse();
  }

  // One stable pass of a radix sort by 16 bits of the keys.
  pass(n, shift, keys, slots, toKeys, toSlots) {
    const { counts } = this;
    counts.fill(0);
    for (let i = 0; i < n; i++) counts[(keys[i] >>> shift) & (RADIX - 1)]++;
    for (let digit = 0, sum = 0; digit < RADIX; digit++) {
      const count = counts[digit];
      counts[digit] = sum;
      sum += count;
    }
    for (let i = 0; i < n; i++) {
      const to = counts[(keys[i] >>> shift) & (RADIX - 1)]++;
      toKeys[to] = keys[i];
      toSlots[to] = slots[i];
    }
  }
}
