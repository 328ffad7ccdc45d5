#!/usr/bin/env node
// A small encoder of C3GS, format version 0, written from SPEC.md only: an example for writers of encoders.
//
//   python -m spec.example scene.c3gs > scene.json                         # the scene of a file, as text
//   node examples/encoder/encoder.mjs scene.json again.c3gs                # the same file
//
// The input has the form of vectors/tiny-example.json (SPEC Annex D). If it has every number, exactly one file conforms
// (4.3). The encoder chooses what is left out, as Annex B does:
//
//   mask_model                                   the observed frequencies (B.6)
//   position_model, cell_shift, position_forms   positions are packed, and the anchors sorted by cells (B.1)
//   weight_scales, weight_forms                  weights are packed (B.5)
//   chunk_anchors                                each chunk has chunk_size anchors
//   step_index of an anchor                      its features, scalings and offsets are values to be quantised (B.7)
//
// position_model or weight_scales of null gives raw positions or weights. Training gives the rest: dimensions, steps,
// frame, planes, networks. Not every violation of SPEC.md is found here: `conformance check-encoder` judges the files.

import * as fs from "node:fs";
import { pathToFileURL } from "node:url";
import {
  PRECISION, STEP_LENGTH, STEP_SHIFT, Substream, check, clamp, crc32, field, pad4, range, readTables, rshiftRound,
  struct, sum,
} from "./coder.mjs";
import {
  activation, checkShapes, deriveNetworks, isEntropyModel, network, onGrid, weightsSection,
} from "./networks.mjs";
import { chooseCellShift, choosePositionModel, contextOf, mortonNumber, toF16, treeGroups } from "./positions.mjs";

const MAJOR = 0, MINOR = 0; // [E15.2-2]
const PLANE_SYMBOL_MAX = 2 ** 15 - 1, ATTRIBUTE_SYMBOL_MAX = 2 ** 23 - 1, ANCHORS_OF_A_BYTE = 16;

// --- planes ---------------------------------------------------------------------------------------------------------

// SPEC 7.3: a sub-plane, plane[channel][i][j]
function planeSubstream(plane, sarm, size, lanesLog2, tables) {
  const stream = new Substream(lanesLog2);
  for (const t of range(3 * size - 2)) {
    const rows = range(size).filter((i) => t - 2 * i >= 0 && t - 2 * i < size);
    const points = plane.flatMap((channel) => rows.map((i) => [channel, i, t - 2 * i]));
    const parameters = points.map(([channel, i, j]) => {
      const near = [[i - 1, j - 1], [i - 1, j], [i - 1, j + 1], [i, j - 1]];
      return network(sarm, near.map(([row, column]) => activation(channel[row]?.[column] ?? 0)));
    });
    stream.values(tables.laplace, parameters, points.map(([channel, i, j]) => channel[i][j]), PLANE_SYMBOL_MAX);
  }
  return stream.bytes();
}

// SPEC 5.10
function planesSection({ planes, dimensions: d, lanes_log2: lanes }, sarm, tables) {
  const parts = planes.map((plane) => planeSubstream(plane, sarm, d.plane_size, lanes.plane, tables));
  return Buffer.concat([field("u32", parts.map((part) => part.length)), ...parts.map(pad4)]);
}

// --- masks ----------------------------------------------------------------------------------------------------------

// SPEC 7.6: the entry of the mask model for each bit of an anchor
const maskEntries = (mask) => mask.map((_, k) => (k * (k + 1)) / 2 + sum(mask.slice(0, k)));

// SPEC B.6
function chooseMaskModel(masks, offsetCount) {
  const kept = new Array((offsetCount * (offsetCount + 1)) / 2).fill(0), seen = [...kept], one = 2 ** PRECISION;
  for (const mask of masks) {
    maskEntries(mask).forEach((entry, k) => {
      kept[entry] += mask[k];
      seen[entry]++;
    });
  }
  return kept.map((n, i) => (seen[i] ? clamp(Math.round((n * one) / seen[i]), 1, one - 1) : one / 2));
}

// SPEC 7.6
function maskSubstream(masks, model, offsetCount, lanesLog2) {
  const stream = new Substream(lanesLog2), entries = masks.map(maskEntries);
  for (const k of range(offsetCount)) {
    const models = entries.map((of) => [2 ** PRECISION - model[of[k]], model[of[k]]]);
    stream.group(models, masks.map((mask) => mask[k]));
  }
  return stream.bytes();
}

// --- attributes -----------------------------------------------------------------------------------------------------

// SPEC 7.7, 7.8, B.7: the D symbols of an anchor, given or quantised. hyper: the outputs of F_h
function symbolsOf(anchor, hyper, baseStep, tables) {
  const kinds = [anchor.features, anchor.scalings, anchor.offsets.flat()];
  const index = hyper.slice(2 * sum(kinds.map((kind) => kind.length))).map((x) => clamp(x, 0, STEP_LENGTH - 1));
  if (anchor.step_index) {
    // They follow from positions, planes, frame and F_h, of which one is wrong if they differ.
    const same = index.join() === anchor.step_index.join();
    check(same, `step_index is ${anchor.step_index}, but F_h gives ${index} (7.8)`);
    return kinds.flat();
  }
  // SPEC 9.2: the step. The product is exact in a double, so it is rounded once.
  const step = index.map((q, a) => Math.fround((tables.step[q] * Math.fround(baseStep[a])) / 2 ** STEP_SHIFT));
  return kinds.flatMap((values, a) => values.map((x) => Math.round(x / step[a])));
}

// SPEC 7.9, 7.10
function attributeSubstream(scene, networks, anchors, tables) {
  const { slices, offset_count: offsets } = scene.dimensions;
  const features = sum(slices), total = features + 6 + 3 * offsets;
  const stream = new Substream(scene.lanes_log2.attribute);
  const hyper = anchors.map(({ position }) => network(networks.hyper, contextOf(scene, position, tables)));
  const symbols = anchors.map((anchor, n) => symbolsOf(anchor, hyper[n], scene.base_step, tables));
  // The symbols of channels first to end - 1. carm: the network of a slice
  const group = (first, end, carm) => {
    const parameters = [], values = [], width = end - first;
    anchors.forEach(({ mask }, n) => {
      const inputs = carm && symbols[n].slice(0, first).map((y, c) => activation(rshiftRound(y, scene.carm_shift[c])));
      const change = carm ? network(carm, inputs) : new Array(2 * width).fill(0);
      for (let c = first; c < end; c++) {
        if (c >= features + 6 && !mask[Math.floor((c - features - 6) / 3)]) continue; // SPEC 6.13
        parameters.push([hyper[n][c] + change[c - first], hyper[n][total + c] + change[width + c - first]]);
        values.push(symbols[n][c]);
      }
    });
    stream.values(tables.gauss, parameters, values, ATTRIBUTE_SYMBOL_MAX);
  };
  group(features, features + 6);
  group(features + 6, total);
  let first = 0;
  slices.forEach((width, i) => group(first, (first += width), networks[`carm.${i}`]));
  return stream.bytes();
}

// --- chunks ---------------------------------------------------------------------------------------------------------

// SPEC 6.10: the anchors of each chunk
function chunksOf({ anchors, chunk_anchors: counts, chunk_size: size }) {
  const chunks = [];
  for (let at = 0; at < anchors.length; at += chunks.at(-1).length) {
    chunks.push(anchors.slice(at, at + (counts?.[chunks.length] ?? size)));
  }
  return chunks;
}

// SPEC 7.12, B.1: the groups of a chunk's tree, or null if its positions are raw
function treeOf(scene, anchors, form) {
  if (scene.position_model === null || form === 0) return null;
  const cells = anchors.map(({ position }) => mortonNumber(position, scene.cell_shift));
  const packs = cells.every((cell, i) => cell > (i ? cells[i - 1] : -1)); // not of NaN
  check(packs || form === undefined, "a packed chunk has anchors in one cell, or not in the order of cells (7.12)");
  return packs ? treeGroups(cells) : null;
}

// SPEC 5.14, 5.13: a chunk and its entry. tree: of treeOf
function codeChunk(scene, networks, anchors, tree, tables) {
  const { dimensions: d, lanes_log2: lanes } = scene, masks = anchors.map(({ mask }) => mask);
  const positions = anchors.map(({ position }) => position);
  const assemble = (form, ...parts) => Buffer.concat([
    field("u32", parts.map((part) => part.length)), field("u8", [form, 0, 0, 0]), ...parts.map(pad4),
  ]);
  const others = [
    maskSubstream(masks, scene.mask_model, d.offset_count, lanes.mask),
    attributeSubstream(scene, networks, anchors, tables),
  ];
  let bytes = assemble(0, field("u16", positions.flat().map(({ bits }) => bits)), ...others);
  if (tree) {
    const stream = new Substream(lanes.mask);
    for (const [models, symbols] of tree) stream.group(models.map((m) => scene.position_model[m]), symbols);
    const packed = assemble(1, stream.bytes(), ...others);
    // [R6.10-5], B.1: a chunk that would be too short has raw positions
    if (packed.length >= 16 + Math.ceil(anchors.length / ANCHORS_OF_A_BYTE)) bytes = packed;
  }
  const bound = (sign) => range(3).map((axis) => positions.map((p) => p[axis])
    .reduce((a, b) => (sign * b.p > sign * a.p ? b : a)).bits);
  const numbers = [bytes.length, crc32(bytes), anchors.length, sum(masks.flat())];
  return { bytes, entry: Buffer.concat([field("u32", numbers), field("u16", [bound(-1), bound(1)])]) };
}

// SPEC 5.11 to 5.13: (mode, content)
function indexSection({ mask_model: masks, position_model: model, cell_shift: shift }, chunks) {
  const positions = model ? [field("u8", [shift, 0, 0, 0]), field("u16", model)] : [];
  const entries = chunks.map(({ entry }) => entry);
  return [model ? 1 : 0, Buffer.concat([struct(field("u16", masks)), ...positions, ...entries])];
}

// --- the file -------------------------------------------------------------------------------------------------------

// SPEC 11.2: largest anchor_count, plane_size and work of each level. Level 0 is that of Tiny, the others are of Main.
const LEVELS = [
  [4096, 32, 2 ** 28], [131072, 128, 2 ** 33], [1048576, 256, 2 ** 36], [4194304, 256, 2 ** 38],
  [16777216, 512, 2 ** 41], [67108864, 1024, 2 ** 43],
];

// SPEC 11.2, B.7: the lowest level that allows the scene
function levelOf({ profile, dimensions: d, networks, anchors }) {
  const values = (layers) => sum(layers.map(({ weight, bias }) => weight.flat().length + bias.length));
  const sarm = values(networks.sarm ?? []);
  const counted = Object.keys(networks).filter((name) => isEntropyModel(name) || d.view_inputs === 0);
  const ofAnchor = sum(counted.map((name) => values(networks[name]))) - sarm;
  const channels = sum(d.slices) + 6 + 3 * d.offset_count;
  const work = anchors.length * (ofAnchor + 16 * channels) + 5 * d.plane_channels * d.plane_size ** 2 * (sarm + 16);
  const level = LEVELS.findIndex(([n, size, most], i) => (
    profile === Math.min(i, 1) && anchors.length <= n && d.plane_size <= size && work <= most
  ));
  check(level >= 0, `no level of profile ${profile} allows the scene (11.2)`);
  return level;
}

// SPEC 5.2 to 5.6. sections: (type, mode, content)
function header(scene, chunkCount, sections) {
  const { position_grid: grid, render_info: r, dimensions: d, lanes_log2: lanes } = scene;
  const fields = struct(
    field("u8", [scene.profile, levelOf(scene)]), field("u16", sections.length),
    field("u32", [scene.anchors.length, chunkCount, scene.chunk_size]),
    field("u8", [lanes.plane, lanes.mask, lanes.attribute, 0]), field("f32", scene.base_step),
    field("i64", grid.origin), field("u16", grid.scale_mantissa), field("i8", [grid.scale_exponent, 0]),
    field("u8", [r.background, r.up_axis]), field("f32", [r.near_plane, r.distance_unit, r.alpha_max, r.low_pass]),
    field("u8", [r.colour_primaries, r.transfer_characteristics, r.render_model, 0]),
    field("u8", [d.offset_count, d.plane_channels, d.frequency_count, d.slices.length]),
    field("u8", [d.hyper_width.length, d.sarm_width.length, d.carm_width.length, d.view_inputs, d.colour_outputs, 0]),
    field("u16", [d.plane_size, d.render_width, d.hyper_width, d.sarm_width, d.carm_width]), field("u8", d.slices),
  );
  const entries = sections.map(([type, mode, content]) => Buffer.concat([
    Buffer.from(type, "latin1"), field("u8", [mode, 0, 0, 0]), field("u64", content.length),
    field("u32", type === "DATA" ? 0 : crc32(content)),
  ]));
  const bytes = Buffer.concat([fields, ...entries]);
  return Buffer.concat([bytes, field("u32", crc32(bytes))]);
}

// SPEC 5.7
const frameSection = (frame) => Buffer.concat([
  field("i32", frame.matrix), field("i64", frame.translation), field("u8", [frame.shift, 0]),
  field("i32", [frame.low, frame.high]),
]);

// The scene with positions as f16, and with the choices of Annex B that precede the chunks
function complete(given) {
  checkShapes(given);
  const scene = { ...given, anchors: given.anchors.map((a) => ({ ...a, position: a.position.map(toF16) })) };
  if (scene.weight_scales === undefined) {
    const item = ([name, layers]) => [name, isEntropyModel(name) ? layers.map(onGrid) : layers];
    scene.networks = Object.fromEntries(Object.entries(scene.networks).map(item));
  }
  if (scene.position_model === undefined) {
    const shift = (scene.cell_shift = chooseCellShift(scene.anchors.map(({ position }) => position)));
    const numbers = new Map(scene.anchors.map((a) => [a, mortonNumber(a.position, shift)]));
    scene.anchors.sort((a, b) => numbers.get(a) - numbers.get(b));
  }
  scene.mask_model ??= chooseMaskModel(scene.anchors.map(({ mask }) => mask), scene.dimensions.offset_count);
  return scene;
}

// Returns the file of a scene, as bytes.
export function encode(given, tables) {
  const scene = complete(given), networks = deriveNetworks(scene), chunks = chunksOf(scene);
  const trees = chunks.map((anchors, c) => treeOf(scene, anchors, scene.position_forms?.[c]));
  if (scene.position_model === undefined) scene.position_model = choosePositionModel(trees.filter(Boolean));
  const coded = chunks.map((anchors, c) => codeChunk(scene, networks, anchors, trees[c], tables));
  const critical = [
    scene.frame && ["FRAM", 0, frameSection(scene.frame)],
    ["WGTS", ...weightsSection(scene, tables)],
    networks.sarm && ["PLNS", 0, planesSection(scene, networks.sarm, tables)],
    ["INDX", ...indexSection(scene, coded)],
    ["DATA", 0, Buffer.concat(coded.map(({ bytes }) => bytes))],
  ].filter(Boolean);
  // SPEC 12.1: each ancillary section is behind so many critical ones.
  const ancillary = (n) => (scene.ancillary ?? []).filter(({ after }) => after === n)
    .map(({ type, mode, content }) => [type, mode, Buffer.from(content, "hex")]);
  const sections = [...ancillary(0), ...critical.flatMap((section, i) => [section, ...ancillary(i + 1)])];
  const head = header(scene, chunks.length, sections);
  const signature = Buffer.from("89433347530d0a1a", "hex");
  const prologue = Buffer.concat([signature, field("u16", [MAJOR, MINOR]), field("u32", head.length)]); // SPEC 5.1
  return Buffer.concat([
    prologue, field("u32", crc32(prologue)), head, ...sections.map(([, , content]) => pad4(content)),
  ]);
}

// JSON.parse rounds integers above 2^53 (5.4, 5.7). They become strings, from which BigInt makes the integers.
export const readScene = (text) => JSON.parse(text.replace(/(?<=[[,:]\s*)-?\d{16,}(?=\s*[\],}])/g, '"$&"'));

function main([input, output]) {
  if (output === undefined) {
    console.error("usage: node encoder.mjs SCENE.json OUTPUT.c3gs");
    return 64;
  }
  const place = process.env.C3GS_TABLES ?? new URL("../../refcodec/data/tables-0.bin", import.meta.url);
  try {
    fs.writeFileSync(output, encode(readScene(fs.readFileSync(input, "utf8")), readTables(fs.readFileSync(place))));
  } catch (error) {
    console.error(error.message);
    return 1;
  }
  return 0;
}

// The URL of a module has no symbolic links.
const program = process.argv[1] && pathToFileURL(fs.realpathSync(process.argv[1])).href;
if (import.meta.url === program) process.exitCode = main(process.argv.slice(2));
