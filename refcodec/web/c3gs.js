// Decodes C3GS files, format version 0 (SPEC.md), in browsers and in Node. c3gs.d.ts documents the functions.
import { ancillaryReader } from "./ancillary.js";
import { checkBounds, checkBytes } from "./bounds.js";
import { chunkError, entries, parseIndex, readChunk } from "./chunks.js";
import {
  anchorArrays, checkData, checkEnd, features, isAncillary, isStatic, parseFrame, passSection, readHeader, readSection,
  splatWidth,
} from "./container.js";
import { RenderModelError } from "./errors.js";
import { loadKernel, shareKernel } from "./kernel.js";
import { parsePlanes } from "./planes.js";
import { sourceOf } from "./source.js";
import { Splatter } from "./splat.js";
import { parseWeights } from "./weights.js";

export { cameraMatrix, centreOf, projectionMatrix, uprightMatrix } from "./camera.js";
export { BoundPassedError, C3gsError, RenderModelError } from "./errors.js";
export { Gaussians } from "./gaussians.js";

const STEP_SHIFT = 12;
// 5.14
const CHUNK_PARTS = ["positions", "masks", "attributes"];
// The most bytes of anchors per file byte that are allocated before a chunk is decoded. The header states the number of
// anchors in a few bytes, thus a small file could otherwise allocate much memory.
const ROOM_OF_A_BYTE = 64;
// 9.2
const KINDS = ["features", "scalings", "offsets"];

// The contents before the chunks, and the state to decode any chunk.
class Scene {
  #source;
  #kernel;
  #options;
  #index;
  #tables;
  #splatter;
  #whole;

  constructor(source, kernel, options, header) {
    this.#source = source;
    this.#kernel = kernel;
    this.#options = options;
    this.header = header;
    this.features = features(header);
    this.planes = new Int16Array(0);
    this.cameras = [];
    this.metadata = new Map();
    shareKernel(this, kernel);
    // 9.2, STEP_VALUE: the product of an entry and a base step is exact in binary64, and rounded once.
    const table = (base) => Float32Array.from(kernel.steps, (step) => (step * base) / (1 << STEP_SHIFT));
    this.#tables = header.base_step.map(table);
  }

  // 10.1, SECTIONS. all: whether ancillary sections are checked too.
  async open(all) {
    const body = this.header.sections.find(({ type }) => type === "DATA");
    let frame, weights, index;
    for (const section of this.header.sections) {
      const { type, mode, start } = section;
      if (section === body) break;
      if (isAncillary(section)) {
        if (all) await this.#passAncillary(section);
        continue;
      }
      checkBytes(this.#options, section.length);
      const data = await readSection(this.#source, section);
      if (type === "FRAM") frame = parseFrame(data, start);
      else if (type === "WGTS") weights = parseWeights(data, start, mode, this.header, this.#kernel);
      else if (type === "PLNS") this.planes = parsePlanes(data, start, this.header, weights, this.#kernel);
      // A copy, since another worker may get it, but not the whole file.
      else index = parseIndex(data.slice(), start, mode, this.header, body);
    }
    return this.prepare({ header: this.header, frame, weights, planes: this.planes, index });
  }

  // parsed: the contents of the sections before the chunks, also for `open`.
  prepare(parsed) {
    const { frame, weights, planes, index } = parsed;
    Object.assign(this, { parsed, planes });
    this.#index = index;
    this.layers = weights.layers.map(({ network, outputs, inputs, values }) => ({ network, outputs, inputs, values }));
    this.#kernel.makeScene(this.header, weights, { ...index, frame, planes });
    if (isStatic(this.header)) this.#splatter = new Splatter(this, this.#kernel, weights);
    return this;
  }

  // 10.1, an ancillary section; metadata and cameras are kept
  async #passAncillary(section) {
    const read = ancillaryReader(section, this.#options);
    if (read === undefined) await passSection(this.#source, section);
    else read(await readSection(this.#source, section), this);
  }

  splat(anchors) {
    if (this.#splatter === undefined) throw new RenderModelError(this.header.render_model, "only 1 is static");
    const h = this.header;
    // Decoding counts the Gaussians of one chunk.
    const isMore = anchors.count > h.chunk_size;
    const check = (kept) => checkBounds(this.#options, h, anchors.count, 4 * splatWidth(h) * kept);
    return this.#splatter.splat(anchors, isMore ? check : () => {});
  }

  async readAncillary() {
    this.cameras = [];
    this.metadata = new Map();
    for (const section of this.header.sections) {
      if (isAncillary(section)) await this.#passAncillary(section);
    }
  }

  // Allocates arrays for all anchors, if the source has enough bytes. Chunks are then decoded into them, as views.
  // Returns the arrays, or undefined.
  holdWhole() {
    const { anchor_count: count } = this.header;
    const arrays = Object.entries(anchorArrays(this.header));
    const needed = arrays.reduce((sum, [, [type, width]]) => sum + count * width * type.BYTES_PER_ELEMENT, 0);
    if (!(needed <= ROOM_OF_A_BYTE * this.#source.size)) return undefined;
    this.#whole = Object.fromEntries(arrays.map(([name, [type, width]]) => [name, new type(count * width)]));
    return this.#whole;
  }

  *entries() {
    for (const { number, first, start, length, anchors, kept, low, high } of entries(this.#index)) {
      const world = (bits) => this.#world(Uint16Array.from(bits));
      yield { number, first, start, length, count: anchors, kept, low: world(low), high: world(high) };
    }
  }

  // 9.1: the world position of one position, as f16 bits
  #world(bits) {
    const at = this.#kernel.keepCopy("position", bits);
    return this.#kernel.worldPositions(at, 1, this.header).slice();
  }

  async chunk(number) {
    for (const entry of entries(this.#index)) {
      if (entry.number === number) return this.decodeRead(await this.#read(entry));
    }
    throw new RangeError(`there is no chunk ${number}: the file has ${this.header.chunk_count}`);
  }

  async *chunks() {
    for (const entry of entries(this.#index)) {
      const chunk = await this.#read(entry);
      yield this.#options.isRead ? chunk : this.decodeRead(chunk);
    }
  }

  // 10.1, CHUNKS for one chunk, up to its parts
  #read(entry) {
    checkBytes(this.#options, entry.length);
    return readChunk(this.#source, entry, this.#index);
  }

  // The rest of it, and 9.1 and 9.2
  decodeRead(chunk) {
    const [h, kernel] = [this.header, this.#kernel];
    const { status, part, own } = kernel.decodeChunk(h, chunk);
    if (status !== 0) throw chunkError(status, part, chunk);
    const { number, first, anchors: n } = chunk;
    // Copies from the kernel's memory.
    const copied = (name, view) => {
      if (this.#whole === undefined) return view.slice();
      const at = first * (view.length / n);
      this.#whole[name].set(view, at);
      return this.#whole[name].subarray(at, at + view.length);
    };
    const values = KINDS.map((name, kind) => {
      const [, width] = anchorArrays(h)[name];
      return [name, copied(name, kernel.values(own[name], own.steps, kind, this.#tables[kind], n, width))];
    });
    return {
      scene: this,
      number,
      first,
      count: n,
      lengths: Object.fromEntries(CHUNK_PARTS.map((name, i) => [name, chunk.lengths[i]])),
      positions: copied("positions", kernel.worldPositions(own.positions, n, h)),
      masks: copied("masks", kernel.view(Uint8Array, own.masks, n * h.offset_count)),
      ...Object.fromEntries(values),
    };
  }

  // 10.1: the crc of DATA, the sections after DATA, and END
  async close() {
    let behind = false;
    for (const section of this.header.sections) {
      if (section.type === "DATA") {
        checkData(section);
        behind = true;
      } else if (behind) {
        await this.#passAncillary(section);
      }
    }
    await checkEnd(this.#source, this.header);
  }
}

// holds: whether all anchors are kept in memory.
async function begin(source, options, all, holds = false) {
  const header = await readHeader(source);
  checkBounds(options, header, holds ? header.anchor_count : 0);
  return new Scene(source, await loadKernel(options.wasm), options, header).open(all);
}

// parsed: of a scene in another worker, in place of an input, to decode the chunks which that one reads.
export async function open(input, { parsed, ...options } = {}) {
  if (parsed) return new Scene(undefined, await loadKernel(options.wasm), options, parsed.header).prepare(parsed);
  return begin(sourceOf(input), options, false);
}

// isRead: whether chunks are only read, for decodeRead in another worker.
export function decode(input, { begun, ...options } = {}) {
  return run(input, options, begun);
}

// begun: called with the scene before its chunks are decoded.
async function* run(input, options, begun) {
  const source = sourceOf(input);
  try {
    const scene = await begin(source, options, true, begun !== undefined && !options.isRead);
    begun?.(scene);
    yield* scene.chunks();
    await scene.close();
    return { scene };
  } finally {
    await source.close();
  }
}

export async function decodeChunk(input, number, options = {}) {
  return (await open(input, options)).chunk(number);
}

// Joins the arrays of all chunks, kind by kind.
function joined(chunks, name, type) {
  const whole = new type(chunks.reduce((sum, chunk) => sum + chunk[name].length, 0));
  let at = 0;
  for (const chunk of chunks) {
    whole.set(chunk[name], at);
    at += chunk[name].length;
    // The joined arrays need only one copy.
    chunk[name] = undefined;
  }
  return whole;
}

export async function decodeAll(input, options = {}) {
  let whole;
  const chunks = [];
  const decoding = run(input, options, (scene) => {
    whole = scene.holdWhole();
  });
  for (;;) {
    const { value, done } = await decoding.next();
    if (!done) {
      if (whole === undefined) chunks.push(value);
      continue;
    }
    const anchors = { count: value.scene.header.anchor_count, ...whole };
    if (whole === undefined) {
      const arrays = Object.entries(anchorArrays(value.scene.header));
      for (const [name, [type]] of arrays) anchors[name] = joined(chunks, name, type);
    }
    return { ...value, anchors };
  }
}
