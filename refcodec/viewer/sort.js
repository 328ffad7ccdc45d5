// The drawing order: Gaussians by decreasing depth. At equal depth, the first in the file is nearest (SPEC.md 14.5).
const RADIX = 1 << 16;

export class Sorter {
  constructor() {
    this.counts = new Uint32Array(RADIX);
    this.room(0);
  }

  room(size) {
    const [keys, slots, otherKeys, otherSlots] = Array.from({ length: 4 }, () => new Uint32Array(size));
    Object.assign(this, { keys, slots, otherKeys, otherSlots, depths: new Float32Array(keys.buffer) });
  }

  // Returns the slot of each Gaussian that is not behind the near plane (14.4), nor in a block outside the image, the
  // farthest one first. blocks: of Rows. slope: the largest one of the image, from the axis of the camera.
  order(blocks, { centre, rotation, slope }, near) {
    const [x, y, z] = rotation.slice(6);
    // 14.4 projects at most sqrt(1 + s^2) times a length, at a slope s that is at most 1.3 times that of the image.
    const stretch = Math.hypot(1, 1.3 * slope);
    const seen = blocks.filter(({ count, middle, radius }) => {
      if (count === 0) return false;
      const way = middle.map((a, i) => a - centre[i]);
      const ahead = x * way[0] + y * way[1] + z * way[2];
      const aside = Math.sqrt(Math.max(Math.hypot(...way) ** 2 - ahead ** 2, 0));
      return ahead + radius > near && aside - slope * ahead <= stretch * radius;
    });
    const all = seen.reduce((sum, { count }) => sum + count, 0);
    if (all > this.slots.length) this.room(Math.ceil(1.25 * all));
    const shift = x * centre[0] + y * centre[1] + z * centre[2];
    const { depths, keys, slots, otherKeys, otherSlots } = this;
    let n = 0;
    for (const { slot, count, means } of seen) {
      for (let i = 0, at = 0; i < count; i++, at += 3) {
        const depth = x * means[at] + y * means[at + 1] + z * means[at + 2] - shift;
        if (depth > near) {
          // The bits of positive floats are in the order of the floats.
          depths[n] = depth;
          slots[n++] = slot + i;
        }
      }
    }
    this.pass(n, 0, keys, slots, otherKeys, otherSlots);
    this.pass(n, 16, otherKeys, otherSlots, keys, slots);
    return slots.slice(0, n).reverse();
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
