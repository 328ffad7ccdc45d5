// The Gaussians that are visible from a place (SPEC.md 14.3 and 14.6).
import { CHUNK, checkBounds, gaussiansBytes, limited } from "./bounds.js";
import { centreOf } from "./camera.js";
import { isStatic, splatWidth } from "./container.js";
import { RenderModelError } from "./errors.js";
import { kernelOf, PIECE, VIEW } from "./kernel.js";
import { SH_0 } from "./numbers.js";
import { checkedArrays, StaticRenderer } from "./splat.js";

// Bytes of a Gaussian of a view.
const SEEN = Object.values(VIEW).reduce((sum, [type, width]) => sum + type.BYTES_PER_ELEMENT * width, 0);

// Returns the number of kept offsets before each anchor, and in total.
function slotsOf(masks, count, offsets) {
  const slots = new Uint32Array(count + 1);
  for (let i = 0, at = 0; i < count; i++) {
    let kept = 0;
    for (const end = at + offsets; at < end; at++) kept += masks[at] !== 0 ? 1 : 0;
    slots[i + 1] = slots[i] + kept;
  }
  return slots;
}

export function boundsOf(positions) {
  const low = new Float32Array(3).fill(Infinity);
  const high = new Float32Array(3).fill(-Infinity);
  positions.forEach((x, i) => {
    if (x < low[i % 3]) low[i % 3] = x;
    if (x > high[i % 3]) high[i % 3] = x;
  });
  return { low, high };
}

// The change of the view of a box between two places.
function change({ low, high }, before, now) {
  const way = Math.hypot(...now.map((x, i) => x - before[i]));
  if (way === 0) return 0;
  // The distance to the nearest anchor is rarely less than this.
  const among = Math.hypot(...high.map((x, i) => x - low[i])) / 4;
  const away = Math.hypot(...now.map((x, i) => Math.max(low[i] - x, x - high[i], 0)));
  return way / Math.max(away, among);
}

// Draws anchors of a scene with render model 0, for Gaussians. `at`: their address in the kernel.
class NetworkRenderer {
  #kernel;
  #renderer;

  constructor(scene) {
    this.#kernel = kernelOf(scene);
    this.#renderer = this.#kernel.makeRenderer(scene);
  }

  add(chunk, arrays, kept) {
    const { count } = chunk;
    const at = this.#kernel.makeAnchors(this.#renderer, count, kept);
    try {
      for (let from = 0; from < count; from += PIECE) {
        const to = Math.min(from + PIECE, count);
        const piece = arrays.map(([array, width]) => array.subarray(from * width, to * width));
        this.#kernel.addAnchors(this.#renderer, at, to - from, piece);
      }
    } catch (error) {
      this.#kernel.release(at);
      throw error;
    }
    return at;
  }

  release(at) {
    this.#kernel.release(at);
  }

  // As in StaticRenderer.
  draw(at, slots, start, end, place, first, view) {
    const found = this.#kernel.draw(this.#renderer, at, start, end, place, first, slots[end] - slots[start]);
    for (const [name, [, width]] of Object.entries(VIEW)) view[name].set(found[name], width * view.count);
    view.count += found.count;
  }
}

export class Gaussians {
  #renderer;
  // For each chunk: what the renderer keeps of it, its slots, and the place of its last view.
  #own = [];
  #options;
  // The most anchors of `decodeAll` that were added at once, which the caller may hold.
  #held = 0;

  constructor(scene, options = {}) {
    this.#options = options;
    kernelOf(scene);
    const { header } = scene;
    // [G6.5-1]
    if (header.render_model !== 0 && !isStatic(header)) throw new RenderModelError(header.render_model);
    this.#renderer = isStatic(header) ? new StaticRenderer(scene) : new NetworkRenderer(scene);
    this.scene = scene;
    this.chunks = [];
    this.anchorCount = 0;
    this.slotCount = 0;
  }

  add(chunk) {
    const arrays = checkedArrays(this.scene, chunk);
    const { count } = chunk;
    const slots = slotsOf(chunk.masks, count, this.scene.header.offset_count);
    const kept = slots[count];
    const [start, slot] = [this.anchorCount, this.slotCount];
    if (count > this.scene.header.chunk_size) this.#held = Math.max(this.#held, count);
    this.#check(0, count, kept);
    const drawn = this.#renderer.add(chunk, arrays, kept);
    const { number, first = 0 } = chunk;
    this.chunks.push({ number, start, end: start + count, kept, slot, ...boundsOf(chunk.positions) });
    this.#own.push({ drawn, slots, first, seen: undefined });
    this.anchorCount += count;
    this.slotCount += kept;
    return this.chunks.length - 1;
  }

  // Throws BoundPassedError before further bytes, anchors and kept offsets exceed the bounds.
  #check(bytes, anchors = 0, kept = 0) {
    const { header } = this.scene;
    const own = gaussiansBytes(header, this.anchorCount + anchors, this.slotCount + kept);
    checkBounds(this.#options, header, this.#held, own + bytes);
  }

  clear() {
    for (const { drawn } of this.#own) this.#renderer.release(drawn);
    this.#own = [];
    this.chunks = [];
    this.anchorCount = 0;
    this.slotCount = 0;
  }

  chunk(index, from, out) {
    const chunk = this.chunks[index];
    if (chunk === undefined) throw new RangeError(`there is no chunk ${index}: ${this.chunks.length} were added`);
    const place = centreOf(from);
    const view = this.range(chunk.start, chunk.end, place, out);
    this.#own[index].seen = place;
    return view;
  }

  all(from, out) {
    const place = centreOf(from);
    const view = this.range(0, this.anchorCount, place, out);
    for (const own of this.#own) own.seen = place;
    return view;
  }

  range(start, end, from, out) {
    const place = centreOf(from);
    const most = this.slotOf(end) - this.slotOf(start);
    if (start > end) throw new RangeError(`there are no anchors from ${start} to ${end}`);
    const view = out ?? this.room(most);
    if (!hasRoom(view, most)) throw new RangeError(`the view has no room for ${most} Gaussians`);
    view.count = 0;
    for (const [i, chunk] of this.chunks.entries()) {
      const last = Math.min(end, chunk.end);
      for (let at = Math.max(start, chunk.start); at < last; at += PIECE) {
        const { drawn, slots, first } = this.#own[i];
        const [low, high] = [at - chunk.start, Math.min(at + PIECE, last) - chunk.start];
        this.#renderer.draw(drawn, slots, low, high, place, first, view);
      }
    }
    if (out !== undefined || view.count === most) return view;
    this.#check(SEEN * (most + view.count));
    return trimmed(view);
  }

  plain(from) {
    const { header } = this.scene;
    if (!isStatic(header) && from === undefined) throw new RenderModelError(header.render_model, "only 1 is static");
    if (!isStatic(header)) {
      const { colours: harmonics, ...view } = this.all(from);
      harmonics.forEach((x, i) => (harmonics[i] = (x - 0.5) / SH_0));
      return limited({ ...view, harmonics }, (more) => this.#check(SEEN * view.count + more));
    }
    const widths = { positions: 3, scales: 3, rotations: 4, opacities: 1, harmonics: header.colour_outputs };
    const bytes = 4 * splatWidth(header) * this.slotCount;
    this.#check(bytes);
    const whole = limited({ count: this.slotCount }, (more) => this.#check(bytes + more));
    for (const [name, width] of Object.entries(widths)) {
      whole[name] = new Float32Array(width * this.slotCount);
      this.chunks.forEach(({ slot }, i) => whole[name].set(this.#own[i].drawn[name], width * slot));
    }
    return whole;
  }

  // SPEC E.2
  enlarge(view) {
    const { positions: p, scales: l, count } = view;
    this.#check(SEEN * (p.length / 3) + 8 * count + CHUNK * this.scene.header.chunk_count);
    const least = Math.min(1, this.anchorCount / this.scene.header.anchor_count);
    const there = new Set(this.chunks.map(({ number }) => number));
    const boxes = Array.from(this.scene.entries(), ({ number, count, low, high }) => {
      const sides = Array.from(high, (x, i) => x - low[i]);
      const side = Math.max(...sides) * 1e-3 || 1;
      return { low, high, has: there.has(number), density: sides.reduce((d, x) => d / Math.max(x, side), count) };
    });
    const area = (i) => Math.max(l[i] * l[i + 1], l[i + 1] * l[i + 2], l[i + 2] * l[i]);
    const middle = Float64Array.from({ length: count }, (_, i) => area(3 * i)).sort()[count >> 1];
    const run = 64;
    let near = boxes;
    for (let i = 0; i < 3 * count; i += 3) {
      // Gaussians that follow each other are near each other: only the chunks around a run are asked for.
      if (i % (3 * run) === 0) {
        const own = boundsOf(p.subarray(i, Math.min(i + 3 * run, 3 * count)));
        near = boxes.filter(({ low, high }) => low.every((x, a) => x <= own.high[a] && high[a] >= own.low[a]));
      }
      let [here, all] = [0, 0];
      const [x, y, z] = [p[i], p[i + 1], p[i + 2]];
      for (const { low, high, has, density } of near) {
        if (x < low[0] || x > high[0] || y < low[1] || y > high[1] || z < low[2] || z > high[2]) continue;
        all += density;
        if (has) here += density;
      }
      const share = Math.max(least, all > 0 ? here / all : 0);
      const factor = Math.sqrt(1 + (1 / Math.sqrt(share) - 1) * Math.sqrt(middle / area(i)));
      for (let axis = 0; axis < 3 && factor < Infinity; axis++) l[i + axis] *= factor;
    }
    return view;
  }

  slotOf(anchor) {
    const right = Number.isSafeInteger(anchor) && anchor >= 0 && anchor <= this.anchorCount;
    if (!right) throw new RangeError(`there is no anchor ${anchor}: ${this.anchorCount} were added`);
    if (anchor === this.anchorCount) return this.slotCount;
    const index = this.chunks.findIndex(({ end }) => anchor < end);
    const { start, slot } = this.chunks[index];
    return slot + this.#own[index].slots[anchor - start];
  }

  room(size) {
    this.#check(SEEN * size);
    const arrays = Object.entries(VIEW).map(([name, [type, width]]) => [name, new type(width * size)]);
    return { count: 0, ...Object.fromEntries(arrays) };
  }

  changes(from) {
    const place = centreOf(from);
    const of = ({ seen }, i) => (seen === undefined ? Infinity : change(this.chunks[i], seen, place));
    return Float64Array.from(this.#own, of);
  }
}

function hasRoom(view, count) {
  return Object.entries(VIEW).every(([name, [type, width]]) => {
    return view[name] instanceof type && view[name].length >= width * count;
  });
}

// The same Gaussians in arrays without spare room.
function trimmed(view) {
  const arrays = Object.entries(VIEW).map(([name, [, width]]) => [name, view[name].slice(0, width * view.count)]);
  return { count: view.count, ...Object.fromEntries(arrays) };
}
