// Decodes files in one process, in all ways that c3gs.js has, and says what came of each.
//
// Reads lines {"file", "way", ...}, with options of c3gs.js in "options". Answers each with digests in hexadecimal and
// the chunks that were delivered, or with the error.
import fs from "node:fs";
import readline from "node:readline";
import {
  BoundPassedError, C3gsError, cameraMatrix, centreOf, decode, decodeAll, decodeChunk, Gaussians, open,
  projectionMatrix, uprightMatrix,
} from "../../refcodec/web/c3gs.js";
import { playCanvasElements } from "../../refcodec/web/adapters.js";
import { Digests } from "../../refcodec/web/digests.js";

const hex = (bytes) => Buffer.from(bytes).toString("hex");
const blocks = function* (bytes, size) {
  for (let at = 0; at < bytes.length; at += size) yield bytes.subarray(at, at + size);
};

function input(bytes, { way, size }) {
  if (way === "iterable") return blocks(bytes, size);
  if (way === "stream") {
    const rest = blocks(bytes, size);
    return new ReadableStream({
      pull(controller) {
        const { value, done } = rest.next();
        if (done) controller.close();
        else controller.enqueue(value);
      },
    });
  }
  if (way === "blob") return new Blob([bytes]);
  if (way === "response") return new Response(bytes);
  return bytes;
}

const WIDTHS = { positions: 3, scales: 3, rotations: 4, colours: 3, opacities: 1, anchors: 1, offsets: 1 };
const seen = (view) => {
  const rows = (name, width) => hex(view[name].slice(0, width * view.count).buffer);
  const own = Object.entries(WIDTHS).map(([name, width]) => [name, rows(name, width)]);
  return { arrays: Object.keys(view), ...Object.fromEntries(own) };
};

// What a place sees of a file, in all ways in which it can be asked for, one list of views for each.
async function views(bytes, place) {
  const [few, whole] = [[], await decodeAll(bytes)];
  const all = new Gaussians(whole.scene);
  all.add(whole.anchors);
  const { scene } = whole;
  const gaussians = new Gaussians(scene);
  const single = [];
  for await (const chunk of decode(bytes)) {
    const index = gaussians.add(chunk);
    single.push(seen(gaussians.chunk(index, place)));
  }
  const out = gaussians.room(gaussians.slotCount);
  const n = gaussians.anchorCount;
  for (let at = 0; at < n; at += 2) few.push(seen(gaussians.range(at, Math.min(at + 2, n), place, out)));
  return {
    single, few, all: [seen(all.all(place))], out: [seen(gaussians.all(place, out))],
    added: gaussians.chunks.map(({ low, high, ...own }) => ({ ...own, low: [...low], high: [...high] })),
    slots: Array.from({ length: n + 1 }, (_, anchor) => gaussians.slotOf(anchor)),
    changes: Array.from(gaussians.changes(place)),
  };
}

// The plain Gaussians of a static scene, added chunk by chunk, and the properties that PlayCanvas gets.
async function plain(bytes) {
  let gaussians;
  for await (const chunk of decode(bytes)) (gaussians ??= new Gaussians(chunk.scene)).add(chunk);
  const { count, ...arrays } = gaussians.plain();
  const [{ properties }] = playCanvasElements({ count, ...arrays });
  const named = [...Object.entries(arrays), ...properties.map(({ name, storage }) => [name, storage])];
  return { count, ...Object.fromEntries(named.map(([name, array]) => [name, hex(array.buffer)])) };
}

// How much the view of each chunk changes on the way between two places. The last chunk is not seen before.
async function changes(bytes, { first, second }) {
  const { scene } = await decodeAll(bytes);
  const gaussians = new Gaussians(scene);
  for await (const chunk of decode(bytes)) gaussians.add(chunk);
  for (let i = 0; i + 1 < gaussians.chunks.length; i++) gaussians.chunk(i, first);
  const added = gaussians.chunks.map(({ low, high }) => ({ low: [...low], high: [...high] }));
  return { added, changes: [...gaussians.changes(second)] };
}

// The numbers of the header, and the error of drawing.
async function drawing(bytes) {
  const { scene } = await decodeAll(bytes);
  const header = Object.fromEntries(Object.entries(scene.header).filter(([, value]) => typeof value === "number"));
  header.background = scene.header.background;
  try {
    new Gaussians(scene);
  } catch (error) {
    return { header, error: [error.name, error.message] };
  }
  return { header };
}

const listed = ({ cameras, metadata }) => ({ cameras, metadata: Object.fromEntries(metadata) });

async function answer({ file, way, number, options, ...rest }, chunks) {
  const bytes = fs.readFileSync(file);
  if (way === "chunk") {
    const asked = [];
    const read = (start, size) => {
      asked.push([start, size]);
      return bytes.subarray(start, start + size);
    };
    const chunk = await decodeChunk({ read, length: bytes.length }, number, options);
    return { asked, features: hex(chunk.features.buffer), positions: hex(chunk.positions.buffer) };
  }
  if (way === "camera") {
    const { camera, near, far } = rest;
    const matrices = { matrix: cameraMatrix(camera), projection: projectionMatrix(camera, near, far) };
    const own = Object.entries(matrices).map(([name, matrix]) => [name, [...matrix]]);
    return { centre: [...centreOf(camera)], ...Object.fromEntries(own) };
  }
  if (way === "centre") return { centre: [...centreOf(rest.camera, rest.object)] };
  if (way === "upright") return { matrix: [...uprightMatrix({ up_axis: rest.axis })] };
  if (way === "changes") return changes(bytes, rest);
  if (way === "held") return new Gaussians((await decodeAll(bytes)).scene, options).room(1);
  if (way === "views") return views(bytes, rest.place);
  if (way === "plain") return plain(bytes);
  if (way === "enlarged") {
    const gaussians = new Gaussians(await open(bytes));
    for (let i = 0; i < rest.there; i++) gaussians.add(await gaussians.scene.chunk(i));
    return { before: [seen(gaussians.all(rest.place))], after: [seen(gaussians.enlarge(gaussians.all(rest.place)))] };
  }
  if (way === "drawing") return drawing(bytes);
  if (way === "ancillary") {
    const scene = await open(bytes, options);
    const before = listed(scene);
    await scene.readAncillary();
    return { before, read: listed(scene), decoded: listed((await decodeAll(bytes, options)).scene) };
  }
  if (way === "entries") {
    const scene = await open(bytes, options);
    const plain = ({ low, high, ...own }) => ({ ...own, low: [...low], high: [...high] });
    return { entries: Array.from(scene.entries(), plain) };
  }
  if (way === "all") {
    const { scene, anchors } = await decodeAll(bytes, options);
    const digests = new Digests(scene);
    digests.add(anchors);
    return { scene: hex(digests.end().scene), arrays: Object.keys(anchors), offsets: hex(anchors.offsets.buffer) };
  }
  const run = decode(input(bytes, { way, ...rest }), options);
  let digests;
  for (;;) {
    const { value, done } = await run.next();
    digests ??= new Digests(value.scene);
    if (!done) {
      chunks.push(hex(digests.add(value).digest));
      continue;
    }
    const { scene, parts } = digests.end();
    const named = Object.entries(parts).map(([name, own]) => [name, hex(own)]);
    return { scene: hex(scene), parts: Object.fromEntries(named) };
  }
}

for await (const line of readline.createInterface({ input: process.stdin })) {
  const chunks = [];
  let said;
  try {
    said = await answer(JSON.parse(line, (_, value) => (value === "NaN" ? NaN : value)), chunks);
  } catch (error) {
    if (error instanceof C3gsError) said = { error };
    else if (error instanceof BoundPassedError) said = { bound: error.bound, needed: error.needed };
    else said = { fault: `${error?.name}: ${error?.stack ?? error}` };
  }
  process.stdout.write(`${JSON.stringify({ chunks, ...said })}\n`);
}
