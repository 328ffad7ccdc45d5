// The worker of the page: it decodes a file, runs the rendering networks for the camera, and sorts by depth. In a
// static scene it only sorts for each camera.
//
// The page sends one "open", a "view" whenever the camera changes, and "drawn" for each "frame". The worker sends
// "head", "chunk", "frame", "end" and "refused". The arrays of a frame go to the page and are not kept here.
import { checkBounds, gaussiansBytes } from "../web/bounds.js";
import { BoundPassedError, C3gsError, decode, Gaussians } from "../web/c3gs.js";
import { isAncillary, isStatic, pad4 } from "../web/container.js";
import { looks } from "./looks.js";
import { Rows } from "./rows.js";
import { Sorter } from "./sort.js";

// The bounds of the page for files of unknown origin.
const BOUNDS = { maxAnchors: 4_000_000, maxMemory: 2 ** 30 };
// Milliseconds for the networks between two frames, in addition to sorting and drawing.
const SLICE = 24;
// The anchors that define the extent of the scene.
const SAMPLE = 4096;

let scene, rows, sorter, sample;
const inChunks = { positions: 0, masks: 0, attributes: 0 };
let view;
// The last sorted view, the rows that the page does not have yet, and whether the last frame is pending.
let sorted;
const waiting = new Set();
let owed = false;
let working = false;
let ended = false;

self.onmessage = ({ data }) => {
  if (data.type === "open") {
    open(data).catch(async (error) => refuse(error, await lookedAt(error, data)));
    return;
  }
  if (data.type === "pick") {
    const point = rows?.hit(data.centre, data.direction);
    if (point !== undefined) postMessage({ type: "picked", point: [...point] });
    return;
  }
  if (data.type === "view") view = data;
  else owed = false;
  work();
};

// kind: the appearance of a file in another format.
function refuse(error, kind) {
  if (error instanceof C3gsError) return postMessage({ type: "refused", error: error.toJSON(), looks: kind });
  const { message: text, bound, needed, allowed } = error;
  if (error instanceof BoundPassedError) postMessage({ type: "refused", kind: "bound", text, bound, needed, allowed });
  else postMessage({ type: "refused", kind: error instanceof RangeError ? "memory" : "fault", text });
}

// Only a file with rejected first bytes can be in another format.
async function lookedAt({ name }, data) {
  return name === "prologue.signature" || name === "prologue.truncated" ? looks(data) : undefined;
}

// wasm: bytes of c3gs.wasm. input: bytes or a Blob. url: the address of the file, without an input.
async function open({ wasm, input, url }) {
  const chunks = decode(input ?? (await fetched(url)), { wasm, ...BOUNDS });
  for (;;) {
    const { value, done } = await chunks.next();
    if (scene === undefined) begin(value.scene);
    if (done) break;
    add(value);
    // Handles views, and sends frames for them, between two chunks.
    await pause();
  }
  ended = true;
  postMessage({ type: "end", ...about() });
  work();
}

async function fetched(url) {
  let response;
  try {
    response = await fetch(url);
  } catch {
    throw new Error(`${url} cannot be fetched`);
  }
  if (!response.ok) throw new Error(`${url} cannot be fetched: the server answers ${response.status}`);
  return response;
}

function begin(opened) {
  scene = opened;
  const h = scene.header;
  // In a static scene, rows keep their anchors until they are computed.
  rows = new Rows(scene, isStatic(h) ? undefined : new Gaussians(scene), scene.entries());
  const [held, more] = isStatic(h) ? [h.anchor_count, 0] : [0, gaussiansBytes(h, h.anchor_count, rows.most)];
  checkBounds(BOUNDS, h, held, more + rows.bytes);
  sorter = new Sorter();
  sample = [];
  const { anchor_count, chunk_count, background, up_axis, near_plane, alpha_max, low_pass } = h;
  const { transfer_characteristics } = h;
  const header = {
    anchor_count, chunk_count, background: [...background], up_axis, near_plane, alpha_max, low_pass,
    transfer_characteristics,
  };
  postMessage({ type: "head", header, height: rows.height, harmonics: rows.harmonics, ...about() });
}

// The description of the scene. Sections after the chunks are read at the end.
function about() {
  const cameras = scene.cameras.map((camera) => ({ ...camera }));
  return { cameras, metadata: Object.fromEntries(scene.metadata), ...parts() };
}

// The bytes of each part of the file. Those within the chunks are known once all are decoded.
function parts() {
  const own = { ancillary: 0, weights: 0, planes: 0, ...(ended ? inChunks : { chunks: 0 }) };
  const of = { WGTS: "weights", PLNS: "planes", DATA: ended ? undefined : "chunks" };
  let end = 0;
  for (const section of scene.header.sections) {
    const { type, start, length } = section;
    end = start + pad4(length);
    const part = isAncillary(section) ? "ancillary" : of[type];
    if (part !== undefined) own[part] += length;
  }
  own.header = end - Object.values(own).reduce((sum, length) => sum + length, 0);
  return { length: end, parts: own };
}

function add(chunk) {
  const start = rows.anchorCount;
  rows.add(chunk);
  for (const [part, length] of Object.entries(chunk.lengths)) inChunks[part] += length;
  const every = Math.max(1, Math.ceil(scene.header.anchor_count / SAMPLE));
  for (let i = -start % every; i < chunk.count; i += every) {
    if (i >= 0) sample.push(Array.from(chunk.positions.subarray(3 * i, 3 * i + 3)));
  }
  postMessage({ type: "chunk", anchors: rows.anchorCount, ...extent() });
  work();
}

// The middle of the scene, and its radius. The median and the quantile leave out the few anchors that are far away.
function extent() {
  const median = (axis) => sample.map((point) => point[axis]).sort((a, b) => a - b)[sample.length >> 1];
  const middle = [0, 1, 2].map(median);
  const away = sample.map((point) => Math.hypot(...point.map((x, axis) => x - middle[axis]))).sort((a, b) => a - b);
  return { middle, radius: Math.max(away[Math.floor(0.9 * (away.length - 1))], 1e-6) };
}

// Updates the Gaussians to the view, those with the largest changes first. The page gets a frame after each slice,
// unless it still draws the last one.
async function work() {
  if (working || view === undefined || rows === undefined) return;
  working = true;
  try {
    // No message may arrive after the last slice while this is marked as working.
    while (slice()) await pause();
  } catch (error) {
    refuse(error);
  }
  working = false;
}

// Returns whether there is more to do.
function slice() {
  const until = performance.now() + SLICE;
  const { id, centre, rotation } = view;
  const stale = [];
  rows.blocks.forEach((block, i) => {
    const changed = rows.change(block, centre);
    if (changed > 0) stale.push([changed, i]);
  });
  stale.sort((a, b) => b[0] - a[0]);
  let done = 0;
  while (done < stale.length && waiting.size < rows.waitingMax && (done === 0 || performance.now() < until)) {
    const row = stale[done++][1];
    rows.update(row, centre);
    waiting.add(row);
  }
  const whole = done === stale.length;
  const state = `${id} ${rows.blocks.length} ${whole} ${ended}`;
  // If the buffer is full, the page has to receive the earlier rows first.
  if (owed || (waiting.size === 0 && sorted === state)) return !whole && waiting.size < rows.waitingMax;
  const chosen = [...waiting];
  waiting.clear();
  sorted = state;
  owed = true;
  const found = rows.take(chosen);
  const order = sorter.order(rows, centre, rotation, scene.header.near_plane);
  const settled = whole && ended;
  const buffers = found.flatMap(({ words, harmonics }) => [words.buffer, harmonics.buffer]);
  postMessage({ type: "frame", id, rows: found, order, settled }, [...buffers, order.buffer]);
  return !whole;
}

// Lets messages arrive. Timers are throttled to some milliseconds.
function pause() {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(null);
  });
}
