// Workers that decode chunks, which are independent (SPEC.md E.5), for the worker that reads them.
import { Gaussians, open } from "../web/c3gs.js";
import { isStatic } from "../web/container.js";
import { thinned } from "./budget.js";
import { staticBlocks } from "./rows.js";

// Makes this worker a member of a team, which sends what `decoded` needs of the scene, and then chunks.
export function join(port, reasonOf) {
  let given, scene;
  port.onmessage = async ({ data }) => {
    if (given === undefined) {
      [given, scene] = [data, open(undefined, data)];
      return;
    }
    try {
      const result = decoded(await scene, given, data);
      const owners = [result.chunk ?? {}, ...(result.blocks ?? []).map(({ found }) => found)];
      const arrays = owners.flatMap(Object.values).filter(ArrayBuffer.isView);
      port.postMessage(result, arrays.map(({ buffer }) => buffer));
    } catch (error) {
      port.postMessage({ reason: reasonOf(error) });
    }
  };
}

// Returns a function that gives a member a chunk and returns the result, or throws the reason.
export function member(port, given) {
  const waiting = [];
  port.onmessage = ({ data }) => waiting.shift()[data.reason === undefined ? 0 : 1](data.reason ?? data);
  port.postMessage(given);
  return (data) => new Promise((...ends) => {
    waiting.push(ends);
    port.postMessage(data, [data.chunk.bytes.buffer]);
  });
}

// chunk: as read. quota: its most Gaussians. slot: of the first one. every: anchors for each one in the sample. place:
// of a camera. Returns the texels of a static scene's Gaussians in `blocks`, or `chunk`, the anchors.
function decoded(scene, given, { chunk: read, quota, slot }) {
  const { scene: _, ...whole } = scene.decodeRead(read);
  const { number, count, first, lengths, positions } = whole;
  const sample = [];
  for (let i = -first % given.every; i < count; i += given.every) {
    if (i >= 0) sample.push([...positions.subarray(3 * i, 3 * i + 3)]);
  }
  const isWhole = quota === read.kept;
  const chunk = isWhole ? whole : thinned((given.seen ??= new Gaussians(scene)), whole, quota, given.place);
  const own = isStatic(scene.header) ? { blocks: staticBlocks(scene, chunk, slot) } : { chunk };
  return { number, count, lengths, sample, ...own };
}
