// The container of a C3GS file, format version 0, read and checked: prologue, header, directory, sections and frame.
// Written from SPEC.md. The numbers in comments are its clauses. A decoder in another language can start with a port of
// it.
import { need } from "./errors.js";
import { power } from "./numbers.js";

// 2.5
const [MAJOR, MINOR] = [0, 0];
const PROLOGUE_LENGTH = 20;
const SIGNATURE = [0x89, 0x43, 0x33, 0x47, 0x53, 0x0d, 0x0a, 0x1a];
const HEADER_LENGTH_MIN = 4;
const HEADER_LENGTH_MAX = 65532;
const SECTION_LENGTH_MAX = 2n ** 48n;
const LANES_LOG2_MAX = 8;
const BASE_STEP_MIN = power(-60);
const BASE_STEP_MAX = power(60);
const ORIGIN_BOUND = 2n ** 62n;
const SCALE_EXPONENT_MAX = 60;
const MATRIX_BOUND = 2 ** 20;
const TRANSLATION_BOUND = 2n ** 61n;
const FRAME_SHIFT_MAX = 60;
const FRAME_RANGE_BOUND = 2 ** 18;

// The block size for reading sections that are not kept.
const BLOCK = 1 << 20;

// 11.1 and 11.2
const PROFILES = [
  {
    offset_count: [1, 10], plane_channels: [0, 8], frequency_count: [0, 10], slice_count: [1, 4], hyper_layers: [0, 2],
    sarm_layers: [1, 2], carm_layers: [0, 2], view_inputs: [0, 8], colour_outputs: [1, 48], plane_size: [2, 32],
    render_width: [1, 64], hyper_width: [1, 64], sarm_width: [1, 16], carm_width: [1, 64], slice_width: [1, 16],
    chunk_size: [1, 65536],
    levels: [{ number: 0, anchors: 4096, planeSize: 32, work: 2 ** 28 }],
  },
  {
    offset_count: [1, 16], plane_channels: [0, 16], frequency_count: [0, 16], slice_count: [1, 16],
    hyper_layers: [0, 2], sarm_layers: [1, 2], carm_layers: [0, 2], view_inputs: [0, 8], colour_outputs: [1, 48],
    plane_size: [2, 1024], render_width: [1, 128], hyper_width: [1, 128], sarm_width: [1, 32], carm_width: [1, 128],
    slice_width: [1, 64], chunk_size: [256, 16384],
    levels: [
      { number: 10, anchors: 131072, planeSize: 128, work: 2 ** 33 },
      { number: 20, anchors: 1048576, planeSize: 256, work: 2 ** 36 },
      { number: 30, anchors: 4194304, planeSize: 256, work: 2 ** 38 },
      { number: 40, anchors: 16777216, planeSize: 512, work: 2 ** 41 },
      { number: 50, anchors: 67108864, planeSize: 1024, work: 2 ** 43 },
    ],
  },
];
const FEATURES_MAX = 128;
// [R6.5-1]
const ALPHA_LIMIT = Math.fround(0.99);

// 5.8: the rendering networks
export const RENDERING = ["opacity", "covariance", "colour"];

// 6.5: the render model of static scenes
const STATIC = 1;

// 5.7 to 5.14: the types of the critical sections in order, and those with a mode 1 (6.6)
const CRITICAL = ["FRAM", "WGTS", "PLNS", "INDX", "DATA"];
const MODE_1 = ["WGTS", "INDX"];

// 2.3
const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

// before: the CRC-32 of the bytes before these.
export function crc32(data, start, end, before = 0) {
  let crc = ~before;
  for (let i = start; i < end; i++) crc = CRC_TABLE[(crc ^ data[i]) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

// 5
export function pad4(n) {
  return n + ((4 - (n % 4)) % 4);
}

export function isZero(data, start, end) {
  return data.subarray(start, end).every((byte) => byte === 0);
}

// Reads consecutive fields; `at` has the file offset of each, by its path.
//
// start: the offset of data in the file. overrun: the error for fields longer than data.
export class Cursor {
  constructor(data, start, overrun = []) {
    Object.assign(this, { start, overrun, next: 0, at: {} });
    this.view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  }

  take(path, type, size) {
    need(this.next + size <= this.view.byteLength, ...this.overrun);
    const place = this.next;
    this.at[path] = this.start + place;
    this.next += size;
    return this.view[`get${type}`](place, true);
  }

  u8(path) { return this.take(path, "Uint8", 1); }
  i8(path) { return this.take(path, "Int8", 1); }
  u16(path) { return this.take(path, "Uint16", 2); }
  i16(path) { return this.take(path, "Int16", 2); }
  u32(path) { return this.take(path, "Uint32", 4); }
  i32(path) { return this.take(path, "Int32", 4); }
  u64(path) { return this.take(path, "BigUint64", 8); }
  i64(path) { return this.take(path, "BigInt64", 8); }
  f32(path) { return this.take(path, "Float32", 4); }

  array(path, type, count) {
    this.at[path] = this.start + this.next;
    return Array.from({ length: count }, (_, i) => this[type](`${path}[${i}]`));
  }
}

// 10.1, PROLOGUE to DIRECTORY: returns the header fields by name, `at` with their offsets, and `sections`, each with
// type, mode, start, length and crc. Lengths of critical sections are possible file lengths.
export async function readHeader(source) {
  const { minor, end } = readPrologue(await source.read(0, PROLOGUE_LENGTH));
  const data = await source.read(PROLOGUE_LENGTH, end - PROLOGUE_LENGTH);
  const h = parseHeader(data, end, minor);
  checkHeader(h);
  checkDirectory(h);
  let start = end;
  h.sections = h.directory.map(({ type, mode, length, crc }) => {
    const section = { type, mode, start, length: Number(length), crc };
    // Exact within a file: a section that begins in the file is at most 2^48 bytes long.
    start += pad4(section.length);
    return section;
  });
  h.end = start;
  return h;
}

// 6.1
function readPrologue(data) {
  need(data.length === PROLOGUE_LENGTH, "prologue.truncated", data.length);
  need(SIGNATURE.every((byte, i) => data[i] === byte), "prologue.signature", 0);
  const cursor = new Cursor(data.subarray(8), 8);
  const major = cursor.u16("major");
  const minor = cursor.u16("minor");
  const headerLength = cursor.u32("header_length");
  need(cursor.u32("prologue_crc") === crc32(data, 0, 16), "prologue.crc", 16);
  need(major === MAJOR, "prologue.version", 8);
  const right = within(headerLength, [HEADER_LENGTH_MIN, HEADER_LENGTH_MAX]) && headerLength % 4 === 0;
  need(right, "prologue.header_length", 12);
  return { minor, end: PROLOGUE_LENGTH + headerLength };
}

// 5.2 to 5.6. end: the offset of the header end
function parseHeader(data, end, minor) {
  need(PROLOGUE_LENGTH + data.length === end, "header.truncated", PROLOGUE_LENGTH + data.length);
  // [R6.2-2]: the CRC-32 is the last four bytes, independent of the fields.
  const crc = new DataView(data.buffer, data.byteOffset).getUint32(data.length - 4, true);
  need(crc === crc32(data, 0, data.length - 4), "header.crc", end - 4);
  const c = new Cursor(data.subarray(0, -4), PROLOGUE_LENGTH, ["header.syntax", end]);
  const h = { at: c.at, minor, profile: c.u8("profile"), level: c.u8("level"), section_count: c.u16("section_count") };
  for (const name of ["anchor_count", "chunk_count", "chunk_size"]) h[name] = c.u32(name);
  for (const name of ["plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2", "reserved"]) h[name] = c.u8(name);
  h.base_step = c.array("base_step", "f32", 3);
  h.origin = c.array("origin", "i64", 3);
  h.scale_mantissa = c.u16("scale_mantissa");
  h.scale_exponent = c.i8("scale_exponent");
  h.grid_reserved = c.u8("grid_reserved");
  h.background = c.array("background", "u8", 3);
  h.up_axis = c.u8("up_axis");
  for (const name of ["near_plane", "distance_unit", "alpha_max", "low_pass"]) h[name] = c.f32(name);
  for (const name of ["colour_primaries", "transfer_characteristics", "render_model"]) h[name] = c.u8(name);
  h.render_reserved = c.u8("render_reserved");
  for (const name of [
    "offset_count", "plane_channels", "frequency_count", "slice_count", "hyper_layers", "sarm_layers", "carm_layers",
    "view_inputs", "colour_outputs", "dimensions_reserved",
  ]) h[name] = c.u8(name);
  for (const name of ["plane_size", "render_width"]) h[name] = c.u16(name);
  for (const name of ["hyper", "sarm", "carm"]) {
    h[`${name}_width`] = c.array(`${name}_width`, "u16", h[`${name}_layers`]);
  }
  h.slice_width = c.array("slice_width", "u8", h.slice_count);
  h.padding = c.array("padding", "u8", pad4(c.next) - c.next);
  // 9.3: the bytes of RenderInfo and of Dimensions
  h.drawn = data.slice(c.at.background - c.start, c.next);
  h.directory = Array.from({ length: h.section_count }, (_, i) => ({
    type: String.fromCharCode(...c.array(`type ${i}`, "u8", 4)), mode: c.u8(`mode ${i}`),
    reserved: c.array(`reserved ${i}`, "u8", 3), length: c.u64(`length ${i}`), crc: c.u32(`crc ${i}`),
  }));
  // [R6.2-3]: a later minor version may have more fields (12.3).
  const rest = c.start + c.next;
  h.later = data.slice(c.next, -4);
  need(rest === end - 4 || minor > MINOR, "header.syntax", rest);
  return h;
}

function within(value, [low, high]) {
  return value >= low && value <= high;
}

// 10.1, HEADER from [R6.2-4] on, then FIELDS
function checkHeader(h) {
  const { at } = h;
  need(h.padding.every((byte) => byte === 0), "header.padding", at.padding);
  for (const name of ["reserved", "grid_reserved", "render_reserved", "dimensions_reserved"]) {
    need(h[name] === 0, "header.reserved", at[name]);
  }
  h.directory.forEach(({ reserved }, i) => {
    need(reserved.every((byte) => byte === 0), "header.reserved", at[`reserved ${i}`]);
  });
  const profile = PROFILES[h.profile];
  need(profile !== undefined, "header.profile", at.profile);
  const level = profile.levels.find((row) => row.number === h.level);
  need(level !== undefined, "header.level", at.level);
  checkDimensions(h, profile, level);
  need(h.anchor_count <= level.anchors, "header.anchor_count", at.anchor_count);
  const needed = work(h);
  const holds = (row) => h.anchor_count <= row.anchors && h.plane_size <= row.planeSize && needed <= row.work;
  const lower = profile.levels.filter((row) => row.number < level.number);
  need(!lower.some(holds), "header.level_not_minimal", at.level);
  need(within(h.chunk_size, profile.chunk_size), "header.chunk_size", at.chunk_size);
  const lanes = ["plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2"];
  lanes.forEach((name) => need(h[name] <= LANES_LOG2_MAX, "header.lanes", at[name]));
  // A NaN is within no limits.
  h.base_step.forEach((step, i) => {
    need(within(step, [BASE_STEP_MIN, BASE_STEP_MAX]), "header.base_step", at[`base_step[${i}]`]);
  });
  h.origin.forEach((origin, i) => {
    need(origin > -ORIGIN_BOUND && origin < ORIGIN_BOUND, "header.position_grid", at[`origin[${i}]`]);
  });
  need(h.scale_mantissa >= 1, "header.position_grid", at.scale_mantissa);
  need(Math.abs(h.scale_exponent) <= SCALE_EXPONENT_MAX, "header.position_grid", at.scale_exponent);
  checkRenderInfo(h);
  need(needed <= level.work, "header.work", at.anchor_count);
  const chunks = [Math.ceil(h.anchor_count / h.chunk_size), h.anchor_count];
  need(within(h.chunk_count, chunks), "header.chunk_count", at.chunk_count);
}

// [R11.1-2]: the fields in the order of 5.3
function checkDimensions(h, profile, level) {
  const check = (condition, name) => need(condition, "header.dimension", h.at[name]);
  const numbers = [
    "offset_count", "plane_channels", "frequency_count", "slice_count", "hyper_layers", "sarm_layers", "carm_layers",
    "view_inputs", "colour_outputs", "plane_size", "render_width",
  ];
  const planes = h.plane_channels > 0;
  for (const name of numbers) {
    const absent = h[name] === 0 && (name === "plane_size" || name === "sarm_layers");
    check(absent || within(h[name], profile[name]), name);
  }
  for (const name of ["hyper_width", "sarm_width", "carm_width", "slice_width"]) {
    h[name].forEach((width, i) => check(within(width, profile[name]), `${name}[${i}]`));
  }
  check(features(h) <= FEATURES_MAX, "slice_width");
  check(h.plane_size > 0 === planes, "plane_size");
  check(h.sarm_layers > 0 === planes, "sarm_layers");
  check(planes || h.frequency_count > 0 || h.hyper_layers === 0, "hyper_layers");
  check(h.slice_count > 1 || h.carm_layers === 0, "carm_layers");
  // 6.5: render models 0 and 1 limit these two.
  check(h.render_model !== 0 || h.view_inputs === 4, "view_inputs");
  check(h.render_model !== 0 || h.colour_outputs === 3, "colour_outputs");
  check(!isStatic(h) || h.view_inputs === 0, "view_inputs");
  check(!isStatic(h) || [3, 12, 27, 48].includes(h.colour_outputs), "colour_outputs");
  check(h.plane_size <= level.planeSize, "plane_size");
}

// [R6.5-1], in the order of the requirement
function checkRenderInfo(h) {
  const check = (condition, name) => need(condition, "header.render_info", h.at[name]);
  check(h.up_axis <= 5, "up_axis");
  for (const name of ["near_plane", "distance_unit", "alpha_max", "low_pass"]) check(Number.isFinite(h[name]), name);
  check(h.near_plane > 0, "near_plane");
  check(h.distance_unit > 0, "distance_unit");
  check(h.alpha_max > 0 && h.alpha_max <= ALPHA_LIMIT, "alpha_max");
  check(h.low_pass >= 0, "low_pass");
}

// 6.5
export function isStatic(h) {
  return h.render_model === STATIC;
}

// 9.4: the numbers of a Gaussian of a static scene
export function splatWidth(h) {
  return 11 + h.colour_outputs;
}

// 6.3: F, and D
export function features(h) {
  return h.slice_width.reduce((sum, width) => sum + width, 0);
}

// 9.3: the types of the arrays of anchors, and their numbers per anchor
export function anchorArrays(h) {
  const k = h.offset_count;
  return {
    positions: [Float32Array, 3], masks: [Uint8Array, k], features: [Float32Array, features(h)],
    scalings: [Float32Array, 6], offsets: [Float32Array, 3 * k],
  };
}

export function attributeChannels(h) {
  return features(h) + 6 + 3 * h.offset_count;
}

// 5.8: the layers in file order, each with the name of its network, and its numbers of outputs and inputs
export function layers(h) {
  const found = [];
  const network = (name, widths) => {
    widths.slice(1).forEach((outputs, i) => found.push({ network: name, outputs, inputs: widths[i] }));
  };
  const inputs = 2 * h.plane_channels + 2 * h.frequency_count;
  network("hyper", [inputs, ...h.hyper_width, 2 * attributeChannels(h) + 3]);
  if (h.plane_channels > 0) network("sarm", [4, ...h.sarm_width, 2]);
  let before = h.slice_width[0];
  for (const [i, width] of h.slice_width.slice(1).entries()) {
    network(`carm.${i + 1}`, [before, ...h.carm_width, 2 * width]);
    before += width;
  }
  [1, 7, h.colour_outputs].forEach((outputs, i) => {
    network(RENDERING[i], [features(h) + h.view_inputs, h.render_width, outputs * h.offset_count]);
  });
  return found;
}

// The number of weights and biases of the chosen networks
export function weightCount(h, chosen = () => true) {
  const counts = layers(h).map(({ network, outputs, inputs }) => chosen(network) ? outputs * (inputs + 1) : 0);
  return counts.reduce((sum, count) => sum + count, 0);
}

// The inputs of CARM: the features except those of the last slice
export function carmInputs(h) {
  return features(h) - h.slice_width[h.slice_count - 1];
}

// 11.2: below 2^46, thus exact as a number
function work(h) {
  const counted = (name) => {
    return name === "hyper" || name.startsWith("carm") || (h.view_inputs === 0 && RENDERING.includes(name));
  };
  const anchor = weightCount(h, counted) + 16 * attributeChannels(h);
  const points = 5 * h.plane_channels * h.plane_size ** 2;
  return h.anchor_count * anchor + points * (weightCount(h, (name) => name === "sarm") + 16);
}

// 12.1: a lower-case first letter
export function isAncillary({ type }) {
  return (type.charCodeAt(0) & 32) !== 0;
}

// 10.1, DIRECTORY: [R6.6-1] to [R6.6-5], each for all entries
function checkDirectory(h) {
  const { at, directory } = h;
  directory.forEach(({ type }, i) => need(/^[A-Za-z]{4}$/.test(type), "directory.type", at[`type ${i}`]));
  directory.forEach((entry, i) => {
    need(isAncillary(entry) || CRITICAL.includes(entry.type), "directory.unknown_critical", at[`type ${i}`]);
  });
  const absent = { FRAM: h.plane_channels + h.frequency_count === 0, PLNS: h.plane_channels === 0 };
  const wanted = CRITICAL.filter((type) => !absent[type]);
  directory.forEach((entry, i) => {
    need(isAncillary(entry) || entry.type === wanted.shift(), "directory.order", at[`type ${i}`]);
  });
  need(wanted.length === 0, "directory.order", at.section_count);
  directory.forEach((entry, i) => {
    need(isAncillary(entry) || entry.mode <= (MODE_1.includes(entry.type) ? 1 : 0), "directory.mode", at[`mode ${i}`]);
  });
  const weights = pad4(2 + carmInputs(h)) + 4 * weightCount(h);
  const index = pad4(h.offset_count * (h.offset_count + 1)) + 28 * h.chunk_count;
  directory.forEach(({ type, mode, length }, i) => {
    const implied = { FRAM: 88, WGTS: mode === 0 ? weights : undefined, INDX: index + 580 * mode }[type];
    const right = implied === undefined ? length <= SECTION_LENGTH_MAX : length === BigInt(implied);
    need(right, "directory.length", at[`length ${i}`]);
  });
}

// [R6.6-6] to [R6.6-8]: returns the bytes of a section other than DATA
export async function readSection(source, { start, length, crc }) {
  const data = await source.read(start, pad4(length));
  if (data.length < pad4(length)) await truncated(source);
  need(crc32(data, 0, length) === crc, "section.crc", start);
  need(isZero(data, length, data.length), "section.padding", start + length);
  return data.subarray(0, length);
}

// The same for a section that is not kept, in bounded memory
export async function passSection(source, { start, length, crc }) {
  const end = start + length;
  let found = 0;
  for (let at = start; at < end; ) {
    const block = await source.read(at, Math.min(BLOCK, end - at));
    if (block.length === 0) await truncated(source);
    found = crc32(block, 0, block.length, found);
    at += block.length;
  }
  const padding = await source.read(end, pad4(length) - length);
  if (padding.length < pad4(length) - length) await truncated(source);
  need(found === crc, "section.crc", start);
  need(isZero(padding, 0, padding.length), "section.padding", end);
}

// [R6.6-6]
export async function truncated(source) {
  need(false, "section.truncated", await source.length());
}

// [R6.6-7], of DATA
export function checkData({ start, crc }) {
  need(crc === 0, "section.crc", start);
}

// [R6.6-9]
export async function checkEnd(source, h) {
  need((await source.read(h.end, 1)).length === 0, "file.trailing", h.end);
}

// 6.7: returns matrix, translation, shift, low and high, 21 integers of 64 bits. start: the section offset
export function parseFrame(data, start) {
  const c = new Cursor(data, start);
  const matrix = c.array("matrix", "i32", 9);
  const translation = c.array("translation", "i64", 3);
  const shift = c.array("shift", "u8", 3);
  const reserved = c.u8("reserved");
  const low = c.array("low", "i32", 3);
  const high = c.array("high", "i32", 3);
  need(reserved === 0, "frame.reserved", c.at.reserved);
  const check = (condition, name) => need(condition, "frame.range", c.at[name]);
  matrix.forEach((value, i) => check(Math.abs(value) < MATRIX_BOUND, `matrix[${i}]`));
  translation.forEach((value, i) => {
    check(value > -TRANSLATION_BOUND && value < TRANSLATION_BOUND, `translation[${i}]`);
  });
  shift.forEach((value, i) => check(value <= FRAME_SHIFT_MAX, `shift[${i}]`));
  for (let axis = 0; axis < 3; axis++) {
    check(low[axis] >= -FRAME_RANGE_BOUND && low[axis] < FRAME_RANGE_BOUND, `low[${axis}]`);
    check(low[axis] < high[axis] && high[axis] <= FRAME_RANGE_BOUND, `high[${axis}]`);
  }
  return BigInt64Array.from([matrix, translation, shift, low, high].flat(), BigInt);
}
