// Calls c3gs.js wrongly, and says which error each call got.
import fs from "node:fs";
import { centreOf, decodeAll, Gaussians } from "../../refcodec/web/c3gs.js";
import { sourceOf } from "../../refcodec/web/source.js";

const { scene, anchors } = await decodeAll(fs.readFileSync(process.argv[2]));
const gaussians = new Gaussians(scene);
const place = [0, 0, 0];
const gone = [new ArrayBuffer(9), new Uint8Array(9)];
gone.forEach((bytes) => structuredClone(bytes, { transfer: [bytes.buffer ?? bytes] }));
const transferred = (bytes) => {
  try {
    sourceOf(bytes);
  } catch (error) {
    if (error.message.includes("transferred")) throw error;
  }
};
const calls = {
  "no scene": () => new Gaussians({ ...scene }),
  "no arrays": () => gaussians.add({ count: 1 }),
  "no count": () => gaussians.add({ ...anchors, count: undefined }),
  "a wrong count": () => gaussians.add({ ...anchors, count: anchors.count + 1 }),
  "a negative count": () => gaussians.add({ ...anchors, count: -1 }),
  "wrong numbers": () => gaussians.add({ ...anchors, features: Float64Array.from(anchors.features) }),
  "a short array": () => gaussians.add({ ...anchors, offsets: anchors.offsets.subarray(1) }),
  "not static": () => gaussians.plain(),
  "no chunk": () => gaussians.chunk(0, place),
  "no anchor": () => gaussians.range(0, 1, place),
  "before the first anchor": () => gaussians.range(-1, 0, place),
  "half an anchor": () => gaussians.slotOf(0.5),
  "no place": () => gaussians.all(undefined),
  "two numbers": () => gaussians.all([0, 0]),
  "NaN": () => gaussians.all([0, NaN, 0]),
  "a text": () => gaussians.all("abc"),
  "a transferred buffer": () => transferred(gone[0]),
  "a view of one": () => transferred(gone[1]),
  "a flat object": () => centreOf(place, { matrixWorld: { elements: new Float32Array(16) } }),
};
const outcome = (call) => {
  try {
    call();
    return "right";
  } catch (error) {
    return error.name;
  }
};
const found = Object.fromEntries(Object.entries(calls).map(([name, call]) => [name, outcome(call)]));
gaussians.add(anchors);
const after = {
  "too many anchors": () => gaussians.range(0, anchors.count + 1, place),
  "from behind": () => gaussians.range(2, 1, place),
  "no room": () => gaussians.all(place, gaussians.room(gaussians.slotCount - 1)),
  "an incomplete view": () => gaussians.all(place, { ...gaussians.room(gaussians.slotCount), colours: undefined }),
  "right": () => gaussians.all(place, gaussians.room(gaussians.slotCount)),
};
for (const [name, call] of Object.entries(after)) found[name] = outcome(call);
console.log(JSON.stringify(found));
