// What a caller allows (SPEC.md 13.1). To pass a bound is no verdict on the file.
import { attributeChannels, weightCount } from "./container.js";
import { BoundPassedError } from "./errors.js";

// Estimates in bytes, those of refcodec.bitstream.bounds: a weight as f32, as an integer and with its copies; a point of
// a plane while it is decoded; a value of an anchor that is being decoded; a value that is held; and of each chunk,
// what is made of its entry in the index, and its objects while all chunks are held.
const WEIGHT = 32;
const PLANE_POINT = 8;
const DECODING = 56;
const HOLDING = 8;
const CHUNK = 192;
const HELD_CHUNK = 2048;
// What Gaussians hold, in draw.c and gaussians.js: bytes of an anchor, of it for each unit of a hidden layer of the
// three networks, and of a kept offset.
const ANCHOR = 32;
const UNIT = 12;
const KEPT = 13;

// options: maxAnchors, maxMemory. header: as readHeader gives it. held: anchors of a scene that is kept. more: further
// bytes.
export function checkBounds({ maxAnchors = Infinity, maxMemory = Infinity }, header, held = 0, more = 0) {
  const h = header;
  if (h.anchor_count > maxAnchors) throw new BoundPassedError("anchors", h.anchor_count, maxAnchors);
  const planes = 5 * h.plane_channels * h.plane_size ** 2;
  const anchor = attributeChannels(h) + h.offset_count;
  const atOnce = Math.min(h.anchor_count, h.chunk_size);
  const chunks = h.chunk_count * (CHUNK + (held ? HELD_CHUNK : 0));
  const own = weightCount(h) * WEIGHT + planes * PLANE_POINT + chunks + anchor * (atOnce * DECODING + held * HOLDING);
  checkBytes({ maxMemory }, own + more);
}

// What Gaussians take for some anchors and their kept offsets.
export function gaussiansBytes({ render_width: width }, count, kept) {
  return count * (ANCHOR + UNIT * 4 * Math.ceil(width / 4)) + kept * KEPT;
}

// The same for bytes of the file that are held together.
export function checkBytes({ maxMemory = Infinity }, needed) {
  if (needed > maxMemory) throw new BoundPassedError("memory", needed, maxMemory);
}
