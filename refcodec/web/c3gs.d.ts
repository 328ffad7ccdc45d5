// Decoder of C3GS, a bitstream for learned 3D Gaussian scenes. Clauses are those of SPEC.md.

/** A file by ranges. `read` gives exactly `size` bytes from byte `start` on, all of them within `length`. */
export interface Ranges {
  read(start: number, size: number): Bytes | Promise<Bytes>;
  length: number;
}

export type Bytes = ArrayBuffer | ArrayBufferView;

/** What can be read from its start to its end. A response must be of a request that succeeded. */
export type Input =
  | Bytes
  | Blob
  | Response
  | ReadableStream<Uint8Array>
  | AsyncIterable<Bytes>
  | Iterable<Bytes>
  | Ranges;

/** What can be read at any place. */
export type Seekable = Bytes | Blob | Ranges;

export interface Options {
  /** The most anchors that the file may have. */
  maxAnchors?: number;
  /** The most bytes of memory that decoding may take, by an estimate from the header, and by lengths in the file. */
  maxMemory?: number;
  /** Whether to compute the digests of 9.3. */
  digests?: boolean;
  /** c3gs.wasm, where it does not lie beside c3gs.js. */
  wasm?: WebAssembly.Module | ArrayBuffer | ArrayBufferView;
}

/** A file that is refused (10.2). The message says where and why. */
export class C3gsError extends Error {
  /** The row of the registry (10.3), such as 502 and "substream.state". */
  readonly code: number;
  readonly name: string;
  readonly class: "malformed" | "invalid" | "unsupported";
  /** The clause to read. */
  readonly clause: string;
  /** A byte of the file. */
  readonly offset: number;
  toJSON(): { code: number; name: string; class: string; clause: string; offset: number };
}

/** A file that needs more than its caller allows. It says nothing of whether the file is right. */
export class BoundPassedError extends Error {
  readonly bound: "anchors" | "memory";
  readonly needed: number;
  readonly allowed: number;
}

/** The fields of 5.2 to 5.5 by their names. */
export interface Header {
  readonly minor: number;
  readonly profile: number;
  readonly level: number;
  readonly anchor_count: number;
  readonly chunk_count: number;
  readonly chunk_size: number;
  readonly plane_lanes_log2: number;
  readonly mask_lanes_log2: number;
  readonly attribute_lanes_log2: number;
  /** Of features, scalings and offsets. */
  readonly base_step: readonly number[];
  readonly origin: readonly bigint[];
  readonly scale_mantissa: number;
  readonly scale_exponent: number;
  /** Red, green and blue, 0 to 255. */
  readonly background: readonly number[];
  readonly up_axis: number;
  readonly near_plane: number;
  readonly distance_unit: number;
  readonly alpha_max: number;
  readonly low_pass: number;
  readonly offset_count: number;
  readonly plane_channels: number;
  readonly frequency_count: number;
  readonly render_width: number;
  readonly plane_size: number;
  readonly slice_count: number;
  readonly slice_width: readonly number[];
  readonly hyper_width: readonly number[];
  readonly sarm_width: readonly number[];
  readonly carm_width: readonly number[];
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

/** Where a chunk lies, in the file and in the world (5.13). */
export interface Entry {
  readonly number: number;
  /** The number of its first anchor in the file. */
  readonly first: number;
  readonly count: number;
  /** Its Gaussians are no more than this. */
  readonly kept: number;
  /** The byte of the file at which it starts, and how many bytes it has. */
  readonly start: number;
  readonly length: number;
  /** Bounds of its world positions, 3 each. */
  readonly low: Float32Array;
  readonly high: Float32Array;
}

/** Numbers of anchors (9.3). K is header.offset_count and F is scene.features. */
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
  /** SHA-256 (9.3), 32 bytes, if `decode` was told to compute digests. */
  readonly digest?: Uint8Array;
}

/** What comes before the chunks. */
export interface Scene {
  readonly header: Header;
  /** F, the features of an anchor. */
  readonly features: number;
  readonly layers: readonly Layer[];
  /** The symbols of the sub-planes, 5 by plane_channels by plane_size by plane_size. */
  readonly planes: Int16Array;
  /** The chunks of the file in its order. */
  entries(): IterableIterator<Entry>;
  /** Decodes one chunk. Throws RangeError if there is none of this number. */
  chunk(number: number): Promise<Chunk>;
}

/** SHA-256, 32 bytes each (9.3). */
export interface Digests {
  readonly scene: Uint8Array;
  readonly parts: Record<
    "positions" | "masks" | "planes" | "features" | "scalings" | "offsets" | "weights",
    Uint8Array
  >;
}

export interface Whole {
  readonly scene: Scene;
  /** If the options ask for them. */
  readonly digests?: Digests;
}

/**
 * Decodes a file as it arrives, and yields each chunk before the next one is read. Its memory is that of one chunk.
 *
 * Throws C3gsError, BoundPassedError, RangeError without memory, and TypeError for an input that is none. Only once it
 * has ended is the file accepted: after an error, the chunks before it are no whole scene.
 */
export function decode(input: Input, options?: Options): AsyncGenerator<Chunk, Whole, void>;

/** Decodes a whole file. Throws as `decode` does. */
export function decodeAll(input: Input, options?: Options): Promise<Whole & { readonly anchors: Anchors }>;

/** Reads what comes before the chunks: the header, networks, planes and the chunk index. Throws as `decode` does. */
export function open(input: Seekable, options?: Options): Promise<Scene>;

/** Decodes one chunk with the fewest bytes. Throws as `open` and `Scene.chunk` do. */
export function decodeChunk(input: Seekable, number: number, options?: Options): Promise<Chunk>;
