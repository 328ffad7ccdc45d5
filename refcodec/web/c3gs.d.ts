// Decoder of C3GS, a bitstream for learned 3D Gaussian scenes. Clauses are those of SPEC.md.

/** A file by ranges. `read` returns exactly `size` bytes from byte `start` on, all of them within `length`. */
export interface Ranges {
  read(start: number, size: number): Bytes | Promise<Bytes>;
  length: number;
}

export type Bytes = ArrayBuffer | ArrayBufferView;

/** Inputs for reading from start to end. A response must be successful. */
export type Input =
  | Bytes
  | Blob
  | Response
  | ReadableStream<Uint8Array>
  | AsyncIterable<Bytes>
  | Iterable<Bytes>
  | Ranges;

/** Inputs for random access. */
export type Seekable = Bytes | Blob | Ranges;

export interface Options {
  /** The maximum number of anchors. */
  maxAnchors?: number;
  /**
   * The maximum memory of decoding in bytes, estimated from the header and from lengths in the file. It includes the
   * arrays of all anchors for `decodeAll`, and the memory of `Gaussians`.
   */
  maxMemory?: number;
  /** c3gs.wasm, if it is not beside c3gs.js. */
  wasm?: WebAssembly.Module | ArrayBuffer | ArrayBufferView;
}

/** A rejected file (10.2). The message states the place and the reason. */
export class C3gsError extends Error {
  /** The row of the registry (10.3), such as 502 and "substream.state". */
  readonly code: number;
  readonly name: string;
  readonly class: "malformed" | "invalid" | "unsupported";
  /** The clause to read. */
  readonly clause: string;
  /** The byte offset of the error. */
  readonly offset: number;
  toJSON(): { code: number; name: string; class: string; clause: string; offset: number };
}

/** A file that needs more than its caller allows. It is not a verdict on the file. */
export class BoundPassedError extends Error {
  readonly bound: "anchors" | "memory";
  readonly needed: number;
  readonly allowed: number;
}

/** A scene of another render_model: it cannot be drawn, or has no `splat`. It is not a verdict on the file. */
export class RenderModelError extends Error {}

type HeaderNumber =
  | "minor" | "profile" | "level" | "anchor_count" | "chunk_count" | "chunk_size"
  | "plane_lanes_log2" | "mask_lanes_log2" | "attribute_lanes_log2" | "scale_mantissa" | "scale_exponent"
  | "up_axis" | "near_plane" | "distance_unit" | "alpha_max" | "low_pass"
  | "colour_primaries" | "transfer_characteristics" | "render_model"
  | "offset_count" | "plane_channels" | "frequency_count" | "slice_count" | "view_inputs" | "colour_outputs"
  | "plane_size" | "render_width";

/**
 * The fields of 5.2 to 5.5 by name. Of the code points of Rec. ITU-T H.273 for drawn colours (6.5), 1 and 13 are BT.709
 * and sRGB; 8 is linear light. render_model: 0 is view-dependent, 1 static. Other scenes cannot be drawn (6.5).
 */
export interface Header extends Readonly<Record<HeaderNumber, number>> {
  /** Of features, scalings and offsets. */
  readonly base_step: readonly number[];
  readonly origin: readonly bigint[];
  /** Red, green and blue, 0 to 255. */
  readonly background: readonly number[];
  readonly hyper_width: readonly number[];
  readonly sarm_width: readonly number[];
  readonly carm_width: readonly number[];
  readonly slice_width: readonly number[];
  /** The sections in file order. `start` and `length` are in bytes, without padding. */
  readonly sections: readonly { type: string; mode: number; start: number; length: number; crc: number }[];
}

/** A layer of a network, in the order of 5.8. */
export interface Layer {
  /** "hyper", "sarm", "carm.1" and so on, "opacity", "covariance" or "colour". */
  readonly network: string;
  readonly outputs: number;
  readonly inputs: number;
  /** The weights, outputs by inputs, and then the biases. */
  readonly values: Float32Array;
}

/** The place of a chunk in the file and in the world (5.13). */
export interface Entry {
  readonly number: number;
  /** The number of its first anchor in the file. */
  readonly first: number;
  readonly count: number;
  /** The maximum number of its Gaussians. */
  readonly kept: number;
  /** Its first byte in the file, and its length in bytes. */
  readonly start: number;
  readonly length: number;
  /** Bounds of its world positions, 3 each. */
  readonly low: Float32Array;
  readonly high: Float32Array;
}

/** Values of anchors (9.3). K is header.offset_count and F is scene.features. */
export interface Anchors {
  readonly count: number;
  /** World positions, count by 3. */
  readonly positions: Float32Array;
  /** 1 for an offset that is kept, count by K. */
  readonly masks: Uint8Array;
  /** count by F. */
  readonly features: Float32Array;
  /** Natural logarithms of lengths, count by 6. */
  readonly scalings: Float32Array;
  /** In units of the exponentials of the first three scalings, count by K by 3. */
  readonly offsets: Float32Array;
}

/** A decoded chunk. Its arrays belong to the caller. */
export interface Chunk extends Anchors {
  readonly scene: Scene;
  readonly number: number;
  readonly first: number;
  /** The bytes of its parts in the file, without padding (5.14). */
  readonly lengths: { readonly positions: number; readonly masks: number; readonly attributes: number };
}

/** The plain Gaussians of a static scene (9.4), exact, in the order of anchors and kept offsets. */
export interface Splat {
  readonly count: number;
  /** World positions, count by 3. */
  readonly means: Float32Array;
  /** Natural logarithms of the lengths of the axes, count by 3. */
  readonly logLengths: Float32Array;
  /** Quaternions w, x, y, z of any length above 0, count by 4. */
  readonly quaternions: Float32Array;
  /** The opacity is the logistic function of this. */
  readonly logits: Float32Array;
  /** Red, green and blue of each spherical harmonic of 14.6, count by header.colour_outputs. */
  readonly harmonics: Float32Array;
}

/** A camera of the file (5.17). Invalid cameras (6.15) are skipped. */
export interface StatedCamera {
  readonly name: string;
  /** The image size in pixels, the unit of the focal lengths and of the principal point too. */
  readonly width: number;
  readonly height: number;
  readonly focal: readonly [number, number];
  readonly principal_point: readonly [number, number];
  /** A quaternion w, x, y, z, from the world to the camera. Its length is not necessarily 1. */
  readonly rotation: readonly [number, number, number, number];
  /** From the world to the camera. */
  readonly translation: readonly [number, number, number];
}

/** The contents of a file before the chunks. */
export interface Scene {
  readonly header: Header;
  /** F, the features of an anchor. */
  readonly features: number;
  readonly layers: readonly Layer[];
  /** The symbols of the sub-planes, 5 by plane_channels by plane_size by plane_size. */
  readonly planes: Int16Array;
  /**
   * The cameras of the file. The first one is the default view.
   *
   * It contains the cameras of the sections read so far. Sections may be before and after the chunks. `decode` has read
   * those before the chunks when it yields the first chunk, and all when it ends. `open` reads none: call
   * `readAncillary`. A section of more than 16 MiB or maxMemory is skipped.
   */
  readonly cameras: readonly StatedCamera[];
  /** The metadata of the file by key (5.16 and 6.14), from the sections read so far, as for `cameras`. */
  readonly metadata: ReadonlyMap<string, string>;
  /**
   * The Gaussians of a chunk of a static scene, or of all anchors of `decodeAll`. Throws RenderModelError if
   * header.render_model is not 1, TypeError for arrays of wrong types or lengths, and RangeError if out of memory.
   */
  splat(anchors: Anchors): Splat;
  /** Reads all ancillary sections, to complete `cameras` and `metadata`. Only after `open`. */
  readAncillary(): Promise<void>;
  /** The chunks of the file in its order. */
  entries(): IterableIterator<Entry>;
  /** Decodes one chunk. Throws RangeError if the file has no such chunk. */
  chunk(number: number): Promise<Chunk>;
}

export interface Whole {
  readonly scene: Scene;
}

/**
 * Decodes a file as it arrives, and yields each chunk before the next one is read. Its memory is that of one chunk.
 *
 * Throws C3gsError, BoundPassedError, RangeError if out of memory, and TypeError for an invalid input. The file is
 * accepted only when the iteration has ended: after an error, the chunks before it are not a complete scene.
 */
export function decode(input: Input, options?: Options): AsyncGenerator<Chunk, Whole, void>;

/** Decodes a whole file. Throws as `decode` does. */
export function decodeAll(input: Input, options?: Options): Promise<Whole & { readonly anchors: Anchors }>;

/** Reads the contents before the chunks: the header, networks, planes and chunk index. Throws as `decode` does. */
export function open(input: Seekable, options?: Options): Promise<Scene>;

/** Decodes one chunk with the fewest bytes. Throws as `open` and `Scene.chunk` do. */
export function decodeChunk(input: Seekable, number: number, options?: Options): Promise<Chunk>;

/** An object with a place in the world, such as an object or a camera of three.js. Its matrix must be up to date. */
export interface Placed {
  /** 16 numbers, column by column. */
  readonly matrixWorld: { readonly elements: ArrayLike<number> };
}

/**
 * A viewpoint. The Gaussians depend only on this place, not on the direction of the camera.
 *
 * It is a point of the scene's world, as three numbers or as {x, y, z}, a camera of the file, or a camera of three.js
 * whose world is that of the scene.
 */
export type Viewpoint =
  | ArrayLike<number>
  | { readonly x: number; readonly y: number; readonly z: number }
  | StatedCamera
  | Placed;

/** Gaussians of a view (14.3 or 14.6), in the order of anchors and offsets. Only the first `count` rows are valid. */
export interface View {
  count: number;
  /** Means in the scene's world, count by 3. */
  readonly positions: Float32Array;
  /** Lengths of the axes, count by 3. They are not logarithms. */
  readonly scales: Float32Array;
  /** Quaternions w, x, y, z of length 1, count by 4. */
  readonly rotations: Float32Array;
  /**
   * Red, green and blue from 0 to 1, count by 3. In a static scene they can be above 1, and blended values are limited
   * to 1. `transfer_characteristics` of the header states their encoding.
   */
  readonly colours: Float32Array;
  /** Above 0, at most 1. */
  readonly opacities: Float32Array;
  /** The number of the anchor of each in the file, and the number of its offset. */
  readonly anchors: Uint32Array;
  readonly offsets: Uint8Array;
}

/**
 * The plain Gaussians of a static scene, in the order of anchors and kept offsets. Only colours depend on the camera.
 * Three numbers of a Gaussian follow each other, thus the arrays are attributes of WebGL and of three.js as they are.
 */
export interface PlainGaussians extends Pick<View, "positions" | "scales" | "rotations"> {
  readonly count: number;
  /** From 0 to 1. A Gaussian with 0 is not drawn. */
  readonly opacities: Float32Array;
  /**
   * Red, green and blue of each spherical harmonic, count by header.colour_outputs. A colour is 1/2 plus the sum of
   * these numbers times the harmonics of 14.6, which are those of 3DGS, in the direction from the camera to the mean.
   */
  readonly harmonics: Float32Array;
}

/** A chunk that was added to Gaussians. */
export interface Added {
  /** The number of the chunk in the file, or undefined for the anchors of `decodeAll`. */
  readonly number: number | undefined;
  /** Its anchors in the order of adding: from `start` to before `end`. */
  readonly start: number;
  readonly end: number;
  /** The number of kept offsets, the maximum number of its Gaussians from any place. */
  readonly kept: number;
  /**
   * The number of kept offsets in the chunks before it. A page with one array of Gaussians may reserve the rows `slot`
   * to `slot + kept` for the chunk, with opacity 0 in the rows that a view does not fill.
   */
  readonly slot: number;
  /** Bounds of the positions of its anchors. */
  readonly low: Float32Array;
  readonly high: Float32Array;
}

/**
 * The Gaussians of a scene, from any place (14.3 and 14.6). The networks run in WebAssembly, where the scene was
 * decoded.
 *
 * Values that do not depend on the place are computed once, when a chunk is added. They take 12 bytes times
 * header.render_width plus 32 bytes per anchor, and 13 bytes per kept offset. In a static scene only colours depend on
 * the place, and the values take 4 bytes per anchor, and 45 bytes plus 4 times header.colour_outputs per kept offset.
 * They are released with the scene.
 */
export class Gaussians {
  /**
   * scene: from `decode`, `decodeAll`, `open` or a chunk. maxMemory: for decoding, added chunks and what a method or an
   * adapter returns together; they throw BoundPassedError before they allocate more. Throws
   * RenderModelError if header.render_model is not 0 or 1.
   */
  constructor(scene: Scene, options?: Pick<Options, "maxAnchors" | "maxMemory">);
  readonly scene: Scene;
  /** The chunks that were added, in the order of adding. */
  readonly chunks: readonly Added[];
  /** The numbers of anchors and of kept offsets so far. */
  readonly anchorCount: number;
  readonly slotCount: number;
  /**
   * Adds a chunk of the scene, or all anchors of `decodeAll`, and returns its index in `chunks`.
   *
   * The arrays may come from another thread. They are copied. Throws TypeError for arrays of wrong types or lengths,
   * BoundPassedError before the memory exceeds the options, and RangeError if out of memory.
   */
  add(chunk: Anchors & { readonly number?: number; readonly first?: number }): number;
  /** Removes all chunks, and releases their memory. */
  clear(): void;
  /**
   * The Gaussians of a chunk by its index in `chunks`.
   *
   * out: receives the Gaussians, and is returned with a new `count`. Without it, new arrays are allocated. Throws
   * RangeError if there is no such chunk or `out` is smaller than `kept`, and TypeError as `centreOf`.
   */
  chunk(index: number, from: Viewpoint, out?: View): View;
  /** The same for the anchors from `start` to before `end`, in the order of adding. */
  range(start: number, end: number, from: Viewpoint, out?: View): View;
  /** The same for all anchors that were added. */
  all(from: Viewpoint, out?: View): View;
  /**
   * Makes the Gaussians of `all` or `plain` longer where chunks are missing, and returns the view: so a part of a file
   * that is coarse first shows no gaps (SPEC.md E.2). Draw the view of all chunks as it is.
   */
  enlarge<T extends View | PlainGaussians>(view: T): T;
  /**
   * The plain Gaussians of all anchors that were added, as new arrays. `from` is for scenes that are not static: those
   * of `all(from)`, with colours for this place only. Throws RenderModelError for such a scene without it.
   */
  plain(from?: Viewpoint): PlainGaussians;
  /** The number of kept offsets of the anchors before this one, in the order of adding. anchorCount is allowed. */
  slotOf(anchor: number): number;
  /** Allocates arrays for `size` Gaussians, with count 0. */
  room(size: number): View;
  /**
   * The change of the view of each chunk since `chunk` or `all` last returned it: the distance of the two places
   * divided by the distance to the bounds of the chunk, or by a quarter of their diagonal if that is more. It
   * approximates the largest change in direction to an anchor, in radians. Infinity: never returned.
   */
  changes(from: Viewpoint): Float64Array;
}

/**
 * The place of a camera in the scene's world, 3 numbers.
 *
 * object: the object of three.js that draws the scene; the place is transformed into its coordinates. Throws TypeError
 * without a place of finite numbers.
 */
export function centreOf(camera: Viewpoint, object?: Placed): Float64Array;

/**
 * The matrix from the camera frame of OpenGL or three.js (y up, z backwards) to the scene's world: 16 numbers, column
 * by column.
 */
export function cameraMatrix(camera: StatedCamera): Float64Array;

/** The OpenGL matrix from that frame to clip coordinates, with the principal point: 16 numbers, column by column. */
export function projectionMatrix(camera: StatedCamera, near: number, far: number): Float64Array;

/** The rotation from the up direction of the scene (header.up_axis) to +y: 16 numbers, column by column. */
export function uprightMatrix(header: Header): Float64Array;
