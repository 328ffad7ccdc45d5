// Bounds of the caller (SPEC.md 13.1). Exceeding a bound is not a verdict on the file.
import { attributeChannels, isStatic, splatWidth, weightCount } from "./container.js";
import { BoundPassedError } from "./errors.js";

// Estimates in bytes, those of refcodec.bitstream.bounds: a weight as f32, as an integer and with its copies; a point
// of a plane during decoding; a value of an anchor during decoding; a stored value; for each chunk, its parsed index
// entry, and its objects while all chunks are stored.
const WEIGHT = 32;
const PLANE_POINT = 8;
const DECODING = 56;
const HOLDING = 8;
export const CHUNK = 192;
const HELD_CHUNK = 2048;
// Memory of Gaussians, in draw.c and gaussians.js: bytes per anchor, per anchor and unit of the hidden layers of the
// three networks, and per kept offset.
const ANCHOR = 32;
const UNIT = 12;
const KEPT = 13;
// The same in a static scene, in splat.js: bytes per anchor, and per kept offset besides the numbers of its Gaussian.
const STATIC_ANCHOR = 4;
const STATIC_KEPT = 1;

// A bound, which is Infinity without one. Anything but a number of at least 0 would pass every comparison.
function bound(options, name) {
  const { [name]: value = Infinity } = options;
  if (typeof value === "number" && value >= 0) return value;
  throw new TypeError(`${name} must be a number of at least 0, not ${String(value)}`);
}

// options: maxAnchors, maxMemory. header: from readHeader. held: stored anchors. more: further bytes.
export function checkBounds(options, header, held = 0, more = 0) {
  const h = header;
  const maxAnchors = bound(options, "maxAnchors");
  if (h.anchor_count > maxAnchors) throw new BoundPassedError("anchors", h.anchor_count, maxAnchors);
  const chunks = h.chunk_count * (CHUNK + (held ? HELD_CHUNK : 0));
  const anchors = held * anchorWidth(h) * HOLDING;
  checkBytes(options, decoderBytes(h) + chunks + anchors + more);
}

const anchorWidth = (h) => attributeChannels(h) + h.offset_count;

// The memory of a decoder of chunks.
export function decoderBytes(h) {
  const planes = 5 * h.plane_channels * h.plane_size ** 2;
  // 9.4: the Gaussians of one chunk, as arrays and in the kernel
  const splat = isStatic(h) ? 8 * h.offset_count * splatWidth(h) : 0;
  const atOnce = Math.min(h.anchor_count, h.chunk_size);
  return weightCount(h) * WEIGHT + planes * PLANE_POINT + atOnce * (anchorWidth(h) * DECODING + splat);
}

// The memory of Gaussians for some anchors and their kept offsets.
export function gaussiansBytes(header, count, kept) {
  if (isStatic(header)) return count * STATIC_ANCHOR + kept * (STATIC_KEPT + 4 * splatWidth(header));
  const { render_width: width } = header;
  return count * (ANCHOR + UNIT * 4 * Math.ceil(width / 4)) + kept * KEPT;
}

// What is held besides, for the adapters: functions of further bytes by the arrays that Gaussians returned.
const limits = new WeakMap();

export function limited(arrays, limit) {
  limits.set(arrays, limit);
  return arrays;
}

export function checkMore(arrays, bytes) {
  limits.get(arrays)?.(bytes);
}

// The same for file bytes that are in memory together.
export function checkBytes(options, needed) {
  const maxMemory = bound(options, "maxMemory");
  if (needed > maxMemory) throw new BoundPassedError("memory", needed, maxMemory);
}
