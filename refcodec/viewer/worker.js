// The worker of the page: it reads a file, which a team decodes, runs the rendering networks for the camera, and sorts
// by depth. In a static scene it only sorts for each camera.
//
// The page sends one "open", a "view" whenever the camera changes, and "taken" for each "frame". The worker sends
// "head", "chunk", "frame", "end" and "refused". The arrays of a frame go to the page and are not kept here.
import { checkBounds, decoderBytes, gaussiansBytes } from "../web/bounds.js";
import { BoundPassedError, C3gsError, centreOf, decode, Gaussians } from "../web/c3gs.js";
import { isAncillary, isStatic } from "../web/container.js";
import { planned } from "./budget.js";
import { looks } from "./looks.js";
import { Rows } from "./rows.js";
import { Sorter } from "./sort.js";
import { join, member } from "./team.js";
import { bytesOf } from "./text.js";

// The bounds of the page for files of unknown origin.
const BOUNDS = { maxAnchors: 4_000_000, maxMemory: 2 ** 30 };
// Milliseconds for the networks between two frames, in addition to sorting and drawing; until the page may have taken
// Gaussians; and between two orders while Gaussians arrive.
const [SLICE, REST, SORTING] = [24, 10, 500];
// The anchors that define the extent of the scene.
const SAMPLE = 4096;

let scene, rows, sorter, team, quotas;
const sample = [];
const inChunks = { positions: 0, masks: 0, attributes: 0 };
let view;
// The last sorted view, the time when it was sorted, and whether the page still takes the last frame.
let [sorted, sortedAt, owed] = [undefined, -Infinity, false];
let [working, ended] = [false, false];

self.onmessage = ({ data }) => {
  if (data.type === "join") join(data.port, reasonOf);
  else if (data.type === "open") open(data);
  else if (data.type === "pick") {
    const point = rows?.hit(data.centre, data.direction);
    if (point !== undefined) postMessage({ type: "picked", point: [...point] });
  } else {
    if (data.type === "view") view = data;
    else owed = false;
    work();
  }
};

// error: also a reason of another worker.
function reasonOf(error) {
  if (!(error instanceof Error)) return error;
  if (error instanceof C3gsError) return { error: error.toJSON() };
  const { message: text, bound, needed, allowed } = error;
  if (error instanceof BoundPassedError) return { kind: "bound", text, bound, needed, allowed };
  return { kind: error instanceof RangeError ? "memory" : "fault", text };
}

// Only a file with rejected first bytes can be in another format.
async function refuse(reason, data) {
  const { name } = reason.error ?? {};
  const isForeign = name === "prologue.signature" || name === "prologue.truncated";
  postMessage({ type: "refused", ...reason, looks: isForeign ? await looks(data) : undefined });
}

// ports: of the members of a team. budget: the most Gaussians. For the rest see readFrom.
async function open(data) {
  const failures = [];
  const chunks = readFrom(data);
  const lane = async (_, i) => {
    while (failures.length === 0) {
      let number = Infinity;
      try {
        // The page may still have to take the last Gaussians.
        while (rows?.isFull) await new Promise((resolve) => setTimeout(resolve, REST));
        const { value: chunk, done } = await chunks.next();
        if (done) break;
        ({ number } = chunk);
        const plan = { quota: quotas[number], slot: rows.slots[number] };
        add(await team[i % team.length]({ chunk: { ...chunk, bytes: chunk.bytes.slice() }, ...plan }));
      } catch (error) {
        failures.push({ number, reason: reasonOf(error) });
      }
    }
  };
  // A member has the next chunk when it is done with one.
  await Promise.all(Array.from({ length: 2 * data.ports.length }, lane));
  // The first error in the file counts, whichever is found first.
  const [first] = failures.sort((a, b) => a.number - b.number);
  if (first !== undefined) return refuse(first.reason, data);
  ended = true;
  postMessage({ type: "end", ...extent(), ...about() });
  work();
}

// Reads the chunks of a file. wasm: bytes of c3gs.wasm. input: bytes or a Blob. text: the bytes in base64. url: the
// address of the file, without the others.
async function* readFrom(data) {
  if (data.text !== undefined) data.input = bytesOf(data.text);
  const input = data.input ?? (await fetched(data.url));
  yield* decode(input, { wasm: data.wasm, ...BOUNDS, isRead: true, begun: (own) => begin(own, data) });
}

async function fetched(url) {
  const response = await fetch(url).catch(() => undefined);
  const why = response === undefined ? "" : `: the server answers ${response.status}`;
  if (!response?.ok) throw new Error(`${url} cannot be fetched${why}`);
  return response;
}

function begin(opened, { ports, wasm, budget }) {
  scene = opened;
  const h = scene.header;
  const plan = planned(scene.entries(), h.chunk_count, budget);
  ({ quotas } = plan);
  rows = new Rows(scene, isStatic(h) ? undefined : new Gaussians(scene), quotas);
  const held = isStatic(h) ? 0 : gaussiansBytes(h, Math.min(h.anchor_count, rows.most), rows.most);
  const room = Math.floor((BOUNDS.maxMemory - held - rows.bytes) / decoderBytes(h)) - 1;
  const members = Math.max(1, Math.min(ports.length, h.chunk_count, room));
  checkBounds(BOUNDS, h, 0, held + rows.bytes + members * decoderBytes(h));
  sorter = new Sorter();
  const { most, height, harmonics } = rows;
  const left = { most, kept: plan.kept, dropped: plan.dropped };
  postMessage({ type: "head", header: h, height, harmonics, members, left, ...about() });
  const place = centreOf(scene.cameras[0] ?? scene.entries().next().value?.low ?? [0, 0, 0]);
  const given = { wasm, parsed: scene.parsed, place, every: Math.max(1, Math.ceil(h.anchor_count / SAMPLE)) };
  team = ports.slice(0, members).map((port) => member(port, given));
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
  for (const section of scene.header.sections) {
    const part = isAncillary(section) ? "ancillary" : of[section.type];
    if (part !== undefined) own[part] += section.length;
  }
  const { end: length } = scene.header;
  own.header = Object.values(own).reduce((left, more) => left - more, length);
  return { length, parts: own };
}

// Takes a result of the team.
function add(result) {
  rows.add(result);
  for (const [part, length] of Object.entries(result.lengths)) inChunks[part] += length;
  // Sorting takes a while, thus the extent is computed again when the sample has grown by a third.
  const of = (length) => Math.floor(3.5 * Math.log(length));
  const isMore = of(sample.length) < of(sample.push(...result.sample));
  postMessage({ type: "chunk", anchors: rows.anchorCount, ...(isMore ? extent() : {}) });
  work();
}

// The middle of the scene, and its radius. The median and the quantile leave out the few anchors that are far away.
function extent() {
  if (sample.length === 0) return {};
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
    refuse(reasonOf(error));
  }
  working = false;
}

// Returns whether there is more to do.
function slice() {
  const until = performance.now() + SLICE;
  const { id, centre } = view;
  const stale = rows.blocks.map((block) => [rows.change(block, centre), block]).filter(([changed]) => changed > 0);
  stale.sort((a, b) => b[0] - a[0]);
  let done = 0;
  while (done < stale.length && !rows.isFull && (done === 0 || performance.now() < until)) {
    rows.update(stale[done++][1], centre);
  }
  const whole = done === stale.length;
  const state = `${id} ${rows.anchorCount} ${whole} ${ended}`;
  // If the buffer is full, the page has to receive the earlier rows first.
  if (owed || (rows.waiting.size === 0 && sorted === state)) return !whole && !rows.isFull;
  owed = true;
  const blocks = rows.take();
  const buffers = blocks.flatMap(({ words, harmonics }) => [words.buffer, harmonics.buffer]);
  const more = rows.waiting.size > 0;
  let order;
  // While Gaussians arrive, most of the time is not for sorting.
  if (!more || performance.now() - sortedAt > SORTING) {
    order = sorter.order(rows.ordered, view, scene.header.near_plane);
    [sorted, sortedAt] = [more ? undefined : state, performance.now()];
    buffers.push(order.buffer);
  }
  const arriving = more || !ended;
  postMessage({ type: "frame", id, blocks, order, arriving, settled: whole && !arriving }, buffers);
  return !whole;
}

// Lets messages arrive. Timers are throttled to some milliseconds.
function pause() {
  return new Promise((resolve) => {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = () => resolve(port1.close());
    port2.postMessage(null);
  });
}
