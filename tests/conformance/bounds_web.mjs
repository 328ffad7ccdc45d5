// Calls a function of the package under a bound, and says what it took. Without a bound it says the least one, and
// without a function which there are, and which exported ones are not listed here.
//
// node bounds_web.mjs FILE [NAME [BOUND]]
import fs from "node:fs";
import * as adapters from "../../refcodec/web/adapters.js";
import * as c3gs from "../../refcodec/web/c3gs.js";
import * as gltf from "../../refcodec/web/gltf.js";

const [file, name, bound] = process.argv.slice(2);
let bytes = new Uint8Array(fs.readFileSync(file));
const place = [0, 0, 0];
const options = { maxMemory: Number(bound ?? 0) };

// Returns a function that loads Gaussians chunk by chunk, calls another one, and holds everything.
const held = (call) => async () => {
  let gaussians;
  for await (const chunk of c3gs.decode(bytes, options)) {
    (gaussians ??= new c3gs.Gaussians(chunk.scene, options)).add(chunk);
  }
  return [gaussians, call(gaussians)];
};
const whole = (call) => async () => {
  const found = await c3gs.decodeAll(bytes, options);
  return [found, call(found)];
};
const adapted = ([adapter, call]) => [adapter, held((gaussians) => [(gaussians = gaussians.plain(place)), call(gaussians)])];
const calls = {
  decode: async () => { for await (const _ of c3gs.decode(bytes, options)); },
  decodeAll: whole(() => {}),
  decodeChunk: () => c3gs.decodeChunk(bytes, 0, options),
  open: async () => (await c3gs.open(bytes, options)).chunk(0),
  decodeAttributes: () => gltf.decodeAttributes(bytes, options),
  splat: whole(({ scene, anchors }) => scene.splat(anchors)),
  add: whole(({ scene, anchors }) => [scene = new c3gs.Gaussians(scene, options), scene.add(anchors)]),
  chunk: held((own) => own.chunk(0, place)),
  range: held((own) => own.range(0, own.anchorCount, place)),
  all: held((own) => own.all(place)),
  room: held((own) => own.all(place, own.room(own.slotCount))),
  enlarge: held((own) => own.enlarge(own.all(place))),
  plain: held((own) => own.plain(place)),
  ...Object.fromEntries(Object.entries(adapters).map(adapted)),
};
// These take no memory that grows with a file. The plugin calls decodeAttributes.
const small = ["cameraMatrix", "centreOf", "projectionMatrix", "uprightMatrix", "changes", "clear", "slotOf",
  "constructor", "Gaussians", "C3gsGltfPlugin", "BoundPassedError", "C3gsError", "RenderModelError"];
if (name === undefined) {
  const methods = Object.getOwnPropertyNames(c3gs.Gaussians.prototype);
  const exported = [c3gs, gltf, adapters].flatMap(Object.keys).concat(methods);
  const unlisted = exported.filter((own) => !(own in calls) && !small.includes(own));
  console.log(JSON.stringify({ names: Object.keys(calls), unlisted }));
}
// The process that started this one does not count, as it would in resourceUsage.
const peak = () => 1024 * Number(/VmHWM:\s*(\d+)/.exec(fs.readFileSync("/proc/self/status", "utf8"))[1]);
// The compiled module and code count neither.
if (name !== undefined) {
  const [given, most] = [bytes, options.maxMemory];
  bytes = new Uint8Array(fs.readFileSync(new URL("../../vectors/valid/static-degree-3.c3gs", import.meta.url)));
  options.maxMemory = Infinity;
  await calls[name]();
  [bytes, options.maxMemory] = [given, most];
}
const before = peak();
for (let said; name !== undefined && said === undefined; ) {
  try {
    globalThis.kept = await calls[name]();
    said = { bound: options.maxMemory, taken: peak() - before };
  } catch (error) {
    if (error instanceof c3gs.BoundPassedError && bound === undefined) options.maxMemory = error.needed;
    else said = { error: error.name };
  }
  if (said !== undefined) console.log(JSON.stringify(said));
}
