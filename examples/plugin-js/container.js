#!/usr/bin/env node
// The container of a C3GS file, format version 0, read and validated: prologue, header, directory, the sections' CRC-32s and the frame.
// Written from SPEC.md; the numbers in comments are its clauses. It is where a decoder in another language begins:
//
//   conformance run --select 'code:1*,2*,3*,401' -- node examples/plugin-js/container.js {input} {output}
//
// A refused file: exit status 1 (malformed, invalid) or 2 (unsupported), and a last line on stderr with the code and the offset.
// A file whose container is right: exit status 3, for this decoder knows no more. 64: usage.
"use strict";
const fs = require("node:fs");

const EXIT = { refused: 1, unsupported: 2, noMore: 3, usage: 64 };

// 2.5
const VERSION = 0;
const HEADER_LENGTH_MIN = 4;
const HEADER_LENGTH_MAX = 65535;
const LANES_LOG2_MAX = 8;
const BASE_STEP_MIN = 2 ** -60;
const BASE_STEP_MAX = 2 ** 60;
const ORIGIN_BOUND = 2n ** 62n;
const SCALE_EXPONENT_MAX = 60;
const MATRIX_BOUND = 2 ** 20;
const TRANSLATION_BOUND = 2n ** 61n;
const FRAME_SHIFT_MAX = 60;
const FRAME_RANGE_BOUND = 2 ** 18;

// 10.2
const CODES = {
  "prologue.truncated": 101, "prologue.signature": 102, "prologue.crc": 103, "prologue.version": 104, "prologue.header_length": 105,
  "header.truncated": 201, "header.crc": 202, "header.syntax": 203, "header.reserved": 204, "header.profile": 205, "header.level": 206,
  "header.dimension": 207, "header.anchor_count": 208, "header.level_not_minimal": 209, "header.chunk_size": 210, "header.lanes": 211,
  "header.base_step": 212, "header.position_grid": 213, "header.render_info": 214,
  "directory.unknown_critical": 301, "directory.order": 302, "directory.mode": 303, "directory.offset": 304, "directory.length": 305,
  "directory.file_length": 306, "section.crc": 307, "frame.range": 401,
};
const UNSUPPORTED = new Set(["prologue.version", "header.profile", "header.level", "directory.unknown_critical", "directory.mode"]);

// 11.1 and 11.2
const PROFILES = [
  {
    offset_count: [1, 10], slice_count: [1, 4], slice_width: [1, 16], plane_channels: [1, 8], frequency_count: [1, 10],
    plane_size: [2, 32], hyper_layers: [1, 2], hyper_width: [1, 64], sarm_layers: [1, 2], sarm_width: [1, 16], carm_layers: [0, 2],
    carm_width: [1, 64], render_width: [1, 64], chunk_size: [1, 65536],
    levels: [{ number: 0, anchors: 4096, planeSize: 32 }],
  },
  {
    offset_count: [10, 10], slice_count: [4, 4], slice_width: [5, 20], plane_channels: [8, 8], frequency_count: [10, 10],
    plane_size: [2, 256], hyper_layers: [1, 1], hyper_width: [16, 128], sarm_layers: [2, 2], sarm_width: [16, 16], carm_layers: [1, 1],
    carm_width: [16, 128], render_width: [50, 50], chunk_size: [256, 65536], slices: [5, 10, 15, 20],
    levels: [
      { number: 1, anchors: 131072, planeSize: 128 },
      { number: 2, anchors: 1048576, planeSize: 256 },
      { number: 3, anchors: 16777216, planeSize: 256 },
    ],
  },
];

// 5.7 to 5.13: the types of the critical sections, in their order, and the highest mode of each (6.6)
const [FRAME, WEIGHTS, PLANES, CHUNK_TABLE, POSITIONS, MASKS, ATTRIBUTES] = [0x81, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87];
const CRITICAL = [FRAME, WEIGHTS, PLANES, CHUNK_TABLE, POSITIONS, MASKS, ATTRIBUTES];
const MODE_MAX = { [WEIGHTS]: 1, [POSITIONS]: 1 };

class Refusal extends Error {
  constructor(name, offset) {
    super(name);
    this.name = name;
    this.offset = offset;
  }
}

function need(condition, name, offset) {
  if (!condition) throw new Refusal(name, offset);
}

// 2.3
const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

function crc32(data, start, end) {
  let crc = 0xffffffff;
  for (let i = start; i < end; i++) crc = CRC_TABLE[(crc ^ data[i]) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

// Reads fields one after the other; `at` has the offset of each by its path.
class Cursor {
  constructor(data, start, end, overrun) {
    Object.assign(this, { data, end, overrun, next: start, at: {} });
    this.view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  }

  take(path, type, size) {
    need(this.next + size <= this.end, ...this.overrun);
    const offset = this.next;
    this.at[path] = offset;
    this.next += size;
    return this.view[`get${type}`](offset, true);
  }

  u8(path) { return this.take(path, "Uint8", 1); }
  i8(path) { return this.take(path, "Int8", 1); }
  u16(path) { return this.take(path, "Uint16", 2); }
  u32(path) { return this.take(path, "Uint32", 4); }
  i32(path) { return this.take(path, "Int32", 4); }
  i64(path) { return this.take(path, "BigInt64", 8); }
  f32(path) { return this.take(path, "Float32", 4); }

  array(path, type, count) {
    this.at[path] = this.next;
    return Array.from({ length: count }, (_, i) => this[type](`${path}[${i}]`));
  }
}

// 6.1
function prologue(data) {
  need(data.length >= 20, "prologue.truncated", data.length);
  need([0x89, 0x43, 0x33, 0x47, 0x0d, 0x0a, 0x1a, 0x0a].every((byte, i) => data[i] === byte), "prologue.signature", 0);
  const cursor = new Cursor(data, 8, 20, []);
  const version = cursor.u32("version");
  const headerLength = cursor.u32("header_length");
  need(cursor.u32("prologue_crc") === crc32(data, 0, 16), "prologue.crc", 16);
  need(version === VERSION, "prologue.version", 8);
  need(headerLength >= HEADER_LENGTH_MIN && headerLength <= HEADER_LENGTH_MAX, "prologue.header_length", 12);
  return 20 + headerLength;
}

// 5.2 to 5.6; end: of the header
function readHeader(data, end) {
  need(data.length >= end, "header.truncated", data.length);
  // 6.2: the CRC-32 is the last four bytes, whatever the fields say.
  need(new DataView(data.buffer, data.byteOffset).getUint32(end - 4, true) === crc32(data, 20, end - 4), "header.crc", end - 4);
  const c = new Cursor(data, 20, end - 4, ["header.syntax", end]);
  const h = { at: c.at, profile: c.u8("profile"), level: c.u8("level"), section_count: c.u8("section_count") };
  h.reserved_0 = c.u8("reserved_0");
  h.anchor_count = c.u32("anchor_count");
  h.chunk_size = c.u32("chunk_size");
  for (const name of ["plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2", "reserved_1"]) h[name] = c.u8(name);
  for (const name of ["offset_count", "slice_count"]) h[name] = c.u8(name);
  h.slice_width = c.array("slice_width", "u8", h.slice_count);
  h.plane_channels = c.u8("plane_channels");
  h.frequency_count = c.u8("frequency_count");
  h.plane_size = c.u16("plane_size");
  for (const network of ["hyper", "sarm", "carm"]) {
    h[`${network}_layers`] = c.u8(`${network}_layers`);
    h[`${network}_width`] = c.array(`${network}_width`, "u8", h[`${network}_layers`]);
  }
  h.render_width = c.u8("render_width");
  h.base_step = c.array("base_step", "f32", 3);
  h.origin = c.array("origin", "i64", 3);
  h.scale_mantissa = c.u16("scale_mantissa");
  h.scale_exponent = c.i8("scale_exponent");
  h.grid_reserved = c.u8("grid_reserved");
  c.array("background", "u8", 3);
  h.up_axis = c.u8("up_axis");
  for (const name of ["near_plane", "distance_unit", "alpha_max", "low_pass"]) h[name] = c.f32(name);
  for (const name of ["camera_width", "camera_height"]) h[name] = c.u16(name);
  h.camera_focal = c.array("camera_focal", "f32", 2);
  h.camera_rotation = c.array("camera_rotation", "f32", 4);
  h.camera_translation = c.array("camera_translation", "f32", 3);
  h.directory = Array.from({ length: h.section_count }, (_, i) => ({
    type: c.u8(`type ${i}`), mode: c.u8(`mode ${i}`), reserved: c.u16(`reserved ${i}`),
    offset: c.u32(`offset ${i}`), length: c.u32(`length ${i}`), crc: c.u32(`crc ${i}`),
  }));
  need(c.next === end - 4, "header.syntax", c.next);
  return h;
}

// 10.1, step 2: [R6.2-4], then the order of the codes
function checkHeader(h) {
  const { at } = h;
  for (const name of ["reserved_0", "reserved_1", "grid_reserved"]) need(h[name] === 0, "header.reserved", at[name]);
  h.directory.forEach((entry, i) => need(entry.reserved === 0, "header.reserved", at[`reserved ${i}`]));
  const profile = PROFILES[h.profile];
  need(profile !== undefined, "header.profile", at.profile);
  const level = profile.levels.find((row) => row.number === h.level);
  need(level !== undefined, "header.level", at.level);
  checkDimensions(h, profile, level);
  need(h.anchor_count <= level.anchors, "header.anchor_count", at.anchor_count);
  const lowest = profile.levels.find((row) => h.anchor_count <= row.anchors && h.plane_size <= row.planeSize);
  need(lowest === level, "header.level_not_minimal", at.level);
  need(within(h.chunk_size, profile.chunk_size), "header.chunk_size", at.chunk_size);
  const lanes = ["plane_lanes_log2", "mask_lanes_log2", "attribute_lanes_log2"];
  lanes.forEach((name) => need(h[name] <= LANES_LOG2_MAX, "header.lanes", at[name]));
  // A NaN is within nothing.
  h.base_step.forEach((step, i) => need(within(step, [BASE_STEP_MIN, BASE_STEP_MAX]), "header.base_step", at[`base_step[${i}]`]));
  h.origin.forEach((origin, i) => need(origin > -ORIGIN_BOUND && origin < ORIGIN_BOUND, "header.position_grid", at[`origin[${i}]`]));
  need(h.scale_mantissa >= 1, "header.position_grid", at.scale_mantissa);
  need(Math.abs(h.scale_exponent) <= SCALE_EXPONENT_MAX, "header.position_grid", at.scale_exponent);
  checkRenderInfo(h);
}

function within(value, [low, high]) {
  return value >= low && value <= high;
}

// [R11.1-2]: the fields in the order of 5.3
function checkDimensions(h, profile, level) {
  const { at } = h;
  const field = (name) => need(within(h[name], profile[name]), "header.dimension", at[name]);
  const list = (name) => h[name].forEach((width, i) => need(within(width, profile[name]), "header.dimension", at[`${name}[${i}]`]));
  field("offset_count");
  field("slice_count");
  list("slice_width");
  for (const name of ["plane_channels", "frequency_count", "plane_size"]) field(name);
  for (const network of ["hyper", "sarm", "carm"]) {
    field(`${network}_layers`);
    list(`${network}_width`);
  }
  field("render_width");
  need((h.carm_layers === 0) === (h.slice_count === 1), "header.dimension", at.carm_layers);
  if (profile.slices) need(profile.slices.every((width, i) => h.slice_width[i] === width), "header.dimension", at["slice_width[0]"]);
  need(h.plane_size <= level.planeSize, "header.dimension", at.plane_size);
}

// [R6.5-1], in the order of its sentence; an array is told by its first byte
function checkRenderInfo(h) {
  const check = (condition, name) => need(condition, "header.render_info", h.at[name]);
  check(h.up_axis <= 5, "up_axis");
  for (const name of ["near_plane", "distance_unit", "alpha_max", "low_pass"]) check(Number.isFinite(h[name]), name);
  check(h.near_plane > 0, "near_plane");
  check(h.distance_unit > 0, "distance_unit");
  check(h.alpha_max > 0 && h.alpha_max <= 1, "alpha_max");
  check(h.low_pass >= 0, "low_pass");
  for (const name of ["camera_width", "camera_height"]) check(h[name] >= 1, name);
  for (const name of ["camera_focal", "camera_rotation", "camera_translation"]) check(h[name].every(Number.isFinite), name);
  check(h.camera_focal.every((focal) => focal > 0), "camera_focal");
  check(h.camera_rotation.some((value) => value !== 0), "camera_rotation");
}

// 5.8: weights and biases of all networks
function weightCount(h) {
  const features = h.slice_width.reduce((a, b) => a + b, 0);
  const channels = features + 6 + 3 * h.offset_count;
  const network = (widths) => widths.slice(1).reduce((sum, out, i) => sum + out * (widths[i] + 1), 0);
  let count = network([2 * h.plane_channels + 2 * h.frequency_count, ...h.hyper_width, 2 * channels + 3]);
  count += network([4, ...h.sarm_width, 2]);
  let inputs = h.slice_width[0];
  for (const width of h.slice_width.slice(1)) {
    count += network([inputs, ...h.carm_width, 2 * width]);
    inputs += width;
  }
  for (const outputs of [1, 7, 3]) count += network([features + 4, h.render_width, outputs * h.offset_count]);
  return { count, carmInputs: features - h.slice_width[h.slice_count - 1] };
}

// 10.1, step 3: the requirements of 6.6 in their order, each over all entries
function checkDirectory(data, h, headerEnd) {
  const { at, directory } = h;
  directory.forEach(({ type }, i) => need(type < 0x80 || CRITICAL.includes(type), "directory.unknown_critical", at[`type ${i}`]));
  directory.forEach(({ type }, i) => {
    const before = i === CRITICAL.length ? 0 : directory[i - 1]?.type;
    need(i < CRITICAL.length ? type === CRITICAL[i] : type < 0x80 && type > before, "directory.order", at[`type ${i}`]);
  });
  need(directory.length >= CRITICAL.length, "directory.order", at.section_count);
  directory.forEach(({ type, mode }, i) => need(type < 0x80 || mode <= (MODE_MAX[type] ?? 0), "directory.mode", at[`mode ${i}`]));
  let end = headerEnd;
  directory.forEach(({ offset, length }, i) => {
    need(offset === end, "directory.offset", at[`offset ${i}`]);
    end += length;
  });
  const mode = Object.fromEntries(directory.map((entry) => [entry.type, entry.mode]));
  const weights = weightCount(h);
  const lengths = { [FRAME]: 88 };
  if (mode[WEIGHTS] === 0) lengths[WEIGHTS] = 2 + weights.carmInputs + 4 * weights.count;
  lengths[CHUNK_TABLE] = h.offset_count * (h.offset_count + 1) + 577 * mode[POSITIONS] + 24 * Math.ceil(h.anchor_count / h.chunk_size);
  if (mode[POSITIONS] === 0) lengths[POSITIONS] = 6 * h.anchor_count;
  directory.forEach(({ type, length }, i) => need(length === (lengths[type] ?? length), "directory.length", at[`length ${i}`]));
  need(end === data.length, "directory.file_length", Math.min(end, data.length));
  for (const { offset, length, crc } of directory) need(crc32(data, offset, offset + length) === crc, "section.crc", offset);
}

// [R6.7-1]
function checkFrame(data, start) {
  const c = new Cursor(data, start, start + 88, []);
  const matrix = c.array("matrix", "i32", 9);
  const translation = c.array("translation", "i64", 3);
  const shift = c.array("shift", "u8", 3);
  const reserved = c.u8("reserved");
  const low = c.array("low", "i32", 3);
  const high = c.array("high", "i32", 3);
  const check = (condition, name) => need(condition, "frame.range", c.at[name]);
  matrix.forEach((value, i) => check(Math.abs(value) < MATRIX_BOUND, `matrix[${i}]`));
  translation.forEach((value, i) => check(value > -TRANSLATION_BOUND && value < TRANSLATION_BOUND, `translation[${i}]`));
  shift.forEach((value, i) => check(value <= FRAME_SHIFT_MAX, `shift[${i}]`));
  check(reserved === 0, "reserved");
  for (let axis = 0; axis < 3; axis++) {
    check(low[axis] >= -FRAME_RANGE_BOUND && low[axis] < FRAME_RANGE_BOUND, `low[${axis}]`);
    check(low[axis] < high[axis] && high[axis] <= FRAME_RANGE_BOUND, `high[${axis}]`);
  }
}

function main([input, output]) {
  if (output === undefined) {
    console.error("usage: container.js INPUT OUTPUT");
    return EXIT.usage;
  }
  const data = fs.readFileSync(input);
  try {
    const headerEnd = prologue(data);
    const header = readHeader(data, headerEnd);
    checkHeader(header);
    checkDirectory(data, header, headerEnd);
    checkFrame(data, header.directory[0].offset);
  } catch (refusal) {
    if (!(refusal instanceof Refusal)) throw refusal;
    console.error(JSON.stringify({ code: CODES[refusal.name], name: refusal.name, offset: refusal.offset }));
    return UNSUPPORTED.has(refusal.name) ? EXIT.unsupported : EXIT.refused;
  }
  console.error("the container is right; the rest is not decoded");
  return EXIT.noMore;
}

process.exitCode = main(process.argv.slice(2));
