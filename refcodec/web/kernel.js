// The native kernel in WebAssembly: memory, calls, and the meaning of its statuses.

import { RENDERING } from "./container.js";
import { power } from "./numbers.js";

// The only kind of vectors, and a status.
const VARIANT = 0;
const NO_MEMORY = -1;
// The end of the address space.
const MEMORY_MAX = 2 ** 32 - 1;
// The step table follows the sine table (SPEC.md Annex A).
const SINE_LENGTH = 1024;
const STEP_LENGTH = 64;
const PLANES = 5;
const SLICES_MAX = 16;
const SCALINGS = 6;
// SPEC.md 7.4: the unit of a position is 2^-24.
const GRID_BITS = 24;
// The arrays of a view (SPEC.md 14.3), in the order of the arguments of draw.c: types and widths.
export const VIEW = {
  positions: [Float32Array, 3], scales: [Float32Array, 3], rotations: [Float32Array, 4], colours: [Float32Array, 3],
  opacities: [Float32Array, 1], anchors: [Uint32Array, 1], offsets: [Uint8Array, 1],
};

// Anchors per kernel call. A scene may be too large for two copies in memory.
export const PIECE = 4096;

let compiled;
// The kernels of scenes, hidden from callers.
const kernels = new WeakMap();

// Returns the module of c3gs.wasm, compiled once.
function compile() {
  compiled ??= read(new URL("./c3gs.wasm", import.meta.url)).catch((error) => {
    compiled = undefined;
    throw error;
  });
  return compiled;
}

async function read(url) {
  if (url.protocol === "file:") {
    // Only for Node. The comment makes bundlers for browsers skip it.
    const { readFile } = await import(/* webpackIgnore: true */ /* @vite-ignore */ "node:fs/promises");
    return WebAssembly.compile(await readFile(url));
  }
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url} has status ${response.status}`);
  return WebAssembly.compile(await response.arrayBuffer());
}

export function shareKernel(scene, kernel) {
  kernels.set(scene, kernel);
}

// Returns the kernel of a scene.
export function kernelOf(scene) {
  const kernel = kernels.get(scene);
  if (kernel === undefined) throw new TypeError("that is no scene of open or decode");
  return kernel;
}

// wasm: a WebAssembly.Module of c3gs.wasm or its bytes, if it is not beside this file.
export async function loadKernel(wasm) {
  const given = wasm === undefined || wasm instanceof WebAssembly.Module ? wasm : await WebAssembly.compile(wasm);
  return new Kernel(await WebAssembly.instantiate(given ?? (await compile())));
}

// The memory of one decoder, with at most one scene. It is released with its object.
class Kernel {
  constructor({ exports }) {
    this.run = exports;
    this.scene = 0;
    this.buffers = new Map();
    exports._initialize();
    const tables = this.#made("start", []);
    // 2.3: a file is little-endian, as WebAssembly is.
    this.steps = new Uint16Array(exports.memory.buffer, tables + 2 * SINE_LENGTH, STEP_LENGTH).slice();
  }

  allocate(size) {
    if (size > MEMORY_MAX) throw noMemory();
    return this.#made("allocate", [size]);
  }

  // Calls a function that returns new memory. given: what is released after the call.
  #made(name, values, given = []) {
    // WebAssembly returns the unsigned address as a signed number.
    const at = this.run[name](...values) >>> 0;
    for (const own of given) this.run.release(own);
    if (at === 0) throw noMemory();
    return at;
  }

  release(at) {
    this.run.release(at);
  }

  // Copies an array to new memory.
  put(array) {
    return this.#copied(array, this.allocate(array.byteLength));
  }

  #copied(array, at) {
    const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
    new Uint8Array(this.run.memory.buffer).set(bytes, at);
    return at;
  }

  // Returns memory that is reused by the next call with the same name, and grows on demand.
  keep(name, size) {
    const kept = this.buffers.get(name);
    if (kept !== undefined && kept.size >= size) return kept.at;
    if (kept !== undefined) this.run.release(kept.at);
    this.buffers.delete(name);
    const at = this.allocate(size);
    this.buffers.set(name, { at, size });
    return at;
  }

  // The same, with a copy of an array in it.
  keepCopy(name, array) {
    return this.#copied(array, this.keep(name, array.byteLength));
  }

  // A view of memory, valid until the next call.
  view(type, at, length) {
    return new type(this.run.memory.buffer, at, length);
  }

  // SPEC 7.13: decodes the symbols of the two groups of packed weights. scales: one per symbol. The first `few` symbols
  // form the first group. Returns an error code or 0, and the symbols.
  decodeWeights(bytes, lanes, scales, few) {
    const part = this.put(bytes);
    const scale = this.put(scales);
    const to = this.allocate(4 * scales.length);
    const many = scales.length - few;
    const status = known(this.run.decodeWeights(part, bytes.length, lanes, scale, few, many, to));
    const symbols = this.view(Int32Array, to, scales.length).slice();
    for (const at of [part, scale, to]) this.run.release(at);
    return { status, symbols };
  }

  // SPEC 7.2 and 7.3: sets the state for decoding symbols, in place of the earlier one.
  //
  // header: the header fields. weights: from parseWeights. chunks: frame, planes, maskModel, cellShift
  // and positionModel, or undefined if only planes are decoded.
  makeScene(header, weights, chunks) {
    const h = header;
    const { coding, shapes } = weights;
    const sarm = h.plane_channels > 0 ? h.sarm_layers + 1 : 0;
    const slices = Array.from({ length: SLICES_MAX }, (_, i) => h.slice_width[i] ?? 0);
    const numbers = Int32Array.of(
      h.offset_count, h.plane_channels, h.plane_size, h.frequency_count, weights.planeShift, h.slice_count, ...slices,
      h.hyper_layers + 1, sarm, h.carm_layers + 1, 1 << h.plane_lanes_log2, 1 << h.mask_lanes_log2,
      1 << h.attribute_lanes_log2, chunks?.cellShift ?? -1,
    );
    const given = [
      numbers, shapes, coding.weight, coding.bias, coding.exponent, weights.carmShift, chunks?.frame, chunks?.planes,
      chunks?.maskModel, chunks?.positionModel,
    ].map((array) => (array === undefined ? 0 : this.put(array)));
    this.run.freeScene(this.scene);
    this.scene = 0;
    this.scene = this.#made("makeScene", given, given);
  }

  // SPEC 7.3: decodes the five substreams of planes. places, lengths: in bytes. points: per sub-plane.
  decodePlanes(bytes, places, lengths, points) {
    const at = this.put(bytes);
    const place = this.put(Uint32Array.of(...places, ...lengths));
    const to = this.allocate(2 * PLANES * points);
    const status = this.allocate(4 * PLANES);
    this.run.decodePlanes(this.scene, at, place, to, status);
    const statuses = Array.from(this.view(Int32Array, status, PLANES), known);
    const planes = this.view(Int16Array, to, PLANES * points).slice();
    for (const own of [at, place, to, status]) this.run.release(own);
    return { statuses, planes };
  }

  // SPEC 10.1, CHUNKS, from the positions on. chunk: from parseChunk. Returns an error code or 0, and the number
  // of the part with the error. The integers stay in memory, for `values`.
  decodeChunk(header, chunk) {
    const h = header;
    const n = chunk.anchors;
    const features = h.slice_width.reduce((sum, width) => sum + width, 0);
    const bytes = this.keepCopy("bytes", chunk.bytes);
    const place = this.keepCopy("place", Uint32Array.of(...chunk.places, ...chunk.lengths));
    const bounds = this.keepCopy("bounds", Uint16Array.of(...chunk.low, ...chunk.high));
    const own = {
      positions: this.keep("positions", 6 * n),
      masks: this.keep("masks", h.offset_count * n),
      features: this.keep("features", 4 * features * n),
      scalings: this.keep("scalings", 4 * SCALINGS * n),
      offsets: this.keep("offsets", 12 * h.offset_count * n),
      steps: this.keep("steps", 3 * n),
    };
    const failed = this.keep("failed", 4);
    const status = known(this.run.decodeChunk(
      this.scene, bytes, place, chunk.form, n, chunk.kept, bounds, own.positions, own.masks, own.features,
      own.scalings, own.offsets, own.steps, failed,
    ));
    const [part] = this.view(Int32Array, failed, 1);
    return { status, part, own };
  }

  // SPEC 9.1: the world positions of positions (f16 bits) at an address.
  worldPositions(at, n, { origin, scale_mantissa, scale_exponent }) {
    const from = this.keepCopy("origin", BigInt64Array.from(origin));
    const to = this.keep("values", 12 * n);
    this.run.worldPositions(at, n, from, scale_mantissa, power(scale_exponent - GRID_BITS), to);
    return this.view(Float32Array, to, 3 * n);
  }

  // SPEC 9.2: the values of symbols [n, width] of a kind of attribute.
  values(symbols, steps, kind, table, n, width) {
    const step = this.keepCopy("table", table);
    const to = this.keep("values", 4 * n * width);
    this.run.attributeValues(symbols, steps + kind, step, n, width, to);
    return this.view(Float32Array, to, n * width);
  }

  // SPEC 9.4: returns the rendering networks of a static scene. weight, bias, exponent: of all their layers.
  makeSplatter({ header, features }, weight, bias, exponent) {
    const { render_width: width, offset_count: offsets, colour_outputs: colours } = header;
    const given = [weight, bias, exponent].map((array) => this.put(array));
    return this.#made("makeSplatter", [VARIANT, features, width, offsets, colours, ...given], given);
  }

  // SPEC 9.4: returns the Gaussians of anchors, one array for each width, the numbers of a Gaussian in it. arrays: as
  // for addAnchors. kept: the kept offsets. The results are views, valid until the next call.
  splat(splatter, count, arrays, kept, widths) {
    const places = arrays.map((array, i) => this.keepCopy(`anchors ${i}`, array));
    const to = widths.map((width, i) => this.keep(`splat ${i}`, 4 * width * kept));
    // The arrays have no symbols, so that there are no steps. Their rows have no gaps, so that their stride is 0.
    known(this.run.splat(splatter, count, ...places, 0, 0, kept, 0, ...to, 1));
    return widths.map((width, i) => this.view(Float32Array, to[i], width * kept));
  }

  // SPEC 14.3: returns the rendering networks. layers: of the scene.
  makeRenderer({ header, features, layers }) {
    const own = layers.filter(({ network }) => RENDERING.includes(network));
    const count = own.reduce((sum, { values }) => sum + values.length, 0);
    const whole = new Float32Array(count);
    let next = 0;
    for (const { values } of own) {
      whole.set(values, next);
      next += values.length;
    }
    const given = this.put(whole);
    const { render_width: width, offset_count: offsets, distance_unit: unit } = header;
    return this.#made("makeRenderer", [features, width, offsets, unit, given, count], [given]);
  }

  // Allocates memory for anchors and their kept offsets, for `addAnchors`.
  makeAnchors(renderer, count, kept) {
    return this.#made("makeAnchors", [renderer, count, kept]);
  }

  // Appends anchors. arrays: positions, masks, features, scalings and offsets.
  addAnchors(renderer, anchors, count, arrays) {
    const places = arrays.map((array, i) => this.keepCopy(`anchors ${i}`, array));
    known(this.run.addAnchors(renderer, anchors, count, ...places));
  }

  // SPEC 14.3: returns the Gaussians of some of the anchors. They are views, valid until the next call.
  //
  // place: 3 numbers. number: that of the first anchor. room: capacity in Gaussians.
  draw(renderer, anchors, start, end, place, number, room) {
    const from = this.keepCopy("centre", place);
    const kinds = Object.entries(VIEW);
    const to = kinds.map(([name, [type, width]]) => this.keep(`view ${name}`, type.BYTES_PER_ELEMENT * width * room));
    const count = known(this.run.draw(renderer, anchors, start, end, from, number, room, ...to));
    const own = kinds.map(([name, [type, width]], i) => [name, this.view(type, to[i], width * count)]);
    return { count, ...Object.fromEntries(own) };
  }
}

function known(status) {
  if (status === NO_MEMORY) throw noMemory();
  if (status < 0) throw new Error(`the kernel refuses what was checked before, with status ${status}`);
  return status;
}

function noMemory() {
  return new RangeError("there is no memory for the scene");
}
