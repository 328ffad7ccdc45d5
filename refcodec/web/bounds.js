// What a caller allows (SPEC.md 13.1). To pass a bound is no verdict on the file.
import { attributeChannels, weightCount } from "./container.js";
import { BoundPassedError } from "./errors.js";

// Estimates in bytes: a weight as f32, as an integer and with its copies; a point of a plane while it is decoded; a
// value of an anchor that is being decoded.
const WEIGHT = 32;
const PLANE_POINT = 32;
const DECODING = 56;

// options: maxAnchors, maxMemory. header: as readHeader gives it.
export function checkBounds({ maxAnchors = Infinity, maxMemory = Infinity }, header) {
  const h = header;
  if (h.anchor_count > maxAnchors) throw new BoundPassedError("anchors", h.anchor_count, maxAnchors);
  const planes = 5 * h.plane_channels * h.plane_size ** 2;
  const anchor = attributeChannels(h) + h.offset_count;
  const atOnce = Math.min(h.anchor_count, h.chunk_size);
  const needed = weightCount(h) * WEIGHT + planes * PLANE_POINT + anchor * atOnce * DECODING;
  checkBytes({ maxMemory }, needed);
}

// The same for bytes of the file that are held together.
export function checkBytes({ maxMemory = Infinity }, needed) {
  if (needed > maxMemory) throw new BoundPassedError("memory", needed, maxMemory);
}
