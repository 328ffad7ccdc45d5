// The chunk index, the chunk head, and the offsets of the errors of its parts (SPEC.md 5.11 to 5.14, 6.10, 6.11).
import { Cursor, crc32, isZero, pad4, truncated } from "./container.js";
import { errorOfCode, need, REGISTRY } from "./errors.js";

// 2.5
const PRECISION = 14;
const CELL_INDEX = 40;
const POSITION_MODELS = 18;
const ANCHORS_OF_A_BYTE = 16;

const HALVES = 16;
// The models with a first frequency of 0.
const EMPTY_FIRST = [1, 7, 13];
const ENTRY_LENGTH = 28;
const HEAD_LENGTH = 16;
const PARTS = 3;
const RAW_POSITION = 6;

const notFinite = (bits) => (bits & 0x7c00) === 0x7c00;
const negativeZero = (bits) => bits === 0x8000;
// Maps f16 bits to an integer with the order of the numbers.
const order = (bits) => (bits >> 15 ? -(bits & 0x7fff) : bits);

// [R6.10-1] to [R6.10-6]. data: the section. start: its offset. body: the section DATA.
//
// Returns maskModel, and in mode 1 cellShift and positionModel, for the kernel.
export function parseIndex(data, start, mode, header, body) {
  const c = new Cursor(data, start);
  const maskModel = Uint16Array.from(c.array("mask", "u16", (header.offset_count * (header.offset_count + 1)) / 2));
  maskModel.forEach((f, i) => need(f >= 1 && f < 1 << PRECISION, "index.mask_model", c.at[`mask[${i}]`]));
  const padding = pad4(c.next);
  need(isZero(data, c.next, padding), "index.padding", start + c.next);
  c.next = padding;
  const index = { maskModel, data, header, start, first: 0, body: body.start };
  if (mode === 1) Object.assign(index, parsePositionModel(c));
  index.first = c.next;
  let [anchors, bytes] = [0, 0];
  for (const entry of entries(index)) {
    checkEntry(entry, header);
    anchors += entry.anchors;
    bytes += entry.length;
  }
  need(anchors === header.anchor_count, "index.length", start);
  need(bytes === body.length, "index.length", start);
  return index;
}

// [R6.10-3] and [R6.10-4]
function parsePositionModel(c) {
  const cellShift = c.u8("cellShift");
  const reserved = c.array("reserved", "u8", 3);
  need(reserved.every((byte) => byte === 0), "index.reserved", c.at.reserved);
  need(cellShift <= CELL_INDEX, "index.position_model", c.at.cellShift);
  const positionModel = new Uint16Array(POSITION_MODELS * HALVES);
  for (let m = 0; m < POSITION_MODELS; m++) {
    const model = c.array(`model ${m}`, "u16", HALVES);
    const sum = model.reduce((total, f) => total + f, 0);
    const empty = EMPTY_FIRST.includes(m);
    const right = model.every((f, i) => (empty && i === 0 ? f === 0 : f >= 1));
    need(sum === 1 << PRECISION && right, "index.position_model", c.at[`model ${m}`]);
    positionModel.set(model, m * HALVES);
  }
  return { cellShift, positionModel };
}

// Yields the entries one by one, thus memory does not grow with their number. Each has number, first anchor, start in
// the file, length, crc, anchors, kept, low and high (f16 bits), and `at`, its offset.
export function* entries(index) {
  const view = new DataView(index.data.buffer, index.data.byteOffset, index.data.byteLength);
  let [first, start] = [0, index.body];
  for (let number = 0; number < index.header.chunk_count; number++) {
    const at = index.first + ENTRY_LENGTH * number;
    const u32 = (field) => view.getUint32(at + 4 * field, true);
    const u16 = (field) => view.getUint16(at + 16 + 2 * field, true);
    const [length, crc, anchors, kept] = [u32(0), u32(1), u32(2), u32(3)];
    const [low, high] = [[u16(0), u16(1), u16(2)], [u16(3), u16(4), u16(5)]];
    yield { number, first, start, length, crc, anchors, kept, low, high, at: index.start + at };
    first += anchors;
    start += length;
  }
}

// [R6.10-5]
function checkEntry({ at, length, anchors, kept, low, high }, header) {
  need(anchors >= 1 && anchors <= header.chunk_size, "index.chunk", at + 8);
  const enough = ANCHORS_OF_A_BYTE * (length - HEAD_LENGTH) >= anchors;
  need(length % 4 === 0 && enough, "index.chunk", at);
  need(kept <= header.offset_count * anchors, "index.chunk", at + 12);
  [...low, ...high].forEach((bits, i) => {
    need(!notFinite(bits) && !negativeZero(bits), "index.chunk", at + 16 + 2 * i);
  });
  low.forEach((bits, i) => need(order(bits) <= order(high[i]), "index.chunk", at + 16 + 2 * i));
}

// [R6.6-6] and [R6.11-1] to [R6.11-5]: returns the arguments for decoding the chunk of an entry.
//
// places, lengths: of its parts.
export async function readChunk(source, entry, index) {
  const { start, length, anchors } = entry;
  const bytes = await source.read(start, length);
  if (bytes.length < length) await truncated(source);
  need(crc32(bytes, 0, length) === entry.crc, "chunk.crc", start);
  const c = new Cursor(bytes, start);
  const lengths = c.array("lengths", "u32", PARTS);
  const form = c.u8("form");
  const reserved = c.array("reserved", "u8", 3);
  need(reserved.every((byte) => byte === 0), "chunk.reserved", c.at.reserved);
  need(form <= (index.positionModel === undefined ? 0 : 1), "chunk.form", c.at.form);
  const whole = lengths.reduce((sum, own) => sum + pad4(own), HEAD_LENGTH) === length;
  need(whole && (form === 1 || lengths[0] === RAW_POSITION * anchors), "chunk.length", start);
  const places = [];
  let place = HEAD_LENGTH;
  for (const own of lengths) {
    places.push(place);
    need(isZero(bytes, place + own, place + pad4(own)), "chunk.padding", start + place + own);
    place += pad4(own);
  }
  return { ...entry, bytes, form, places, lengths };
}

// Returns the error for a code of the kernel. part: the number of the part with the error.
export function chunkError(code, part, { bytes, start, places, anchors }) {
  const is = (...names) => names.some((name) => REGISTRY.get(name).code === code);
  if (is("chunk.kept", "chunk.bounds")) return errorOfCode(code, start);
  let at = 0;
  if (is("positions.not_finite", "positions.negative_zero")) {
    const view = new DataView(bytes.buffer, bytes.byteOffset + places[part], RAW_POSITION * anchors);
    while (!notFinite(view.getUint16(at, true)) && !negativeZero(view.getUint16(at, true))) at += 2;
  }
  return errorOfCode(code, start + places[part] + at);
}
