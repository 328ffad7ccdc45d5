// Decodes files in one process, in all ways that c3gs.js has, and says what came of each.
//
// Reads lines {"file", "way", ...}, with options of c3gs.js in "options". Answers each with digests in hexadecimal and
// the chunks that were delivered, or with the error.
import fs from "node:fs";
import readline from "node:readline";
import { BoundPassedError, C3gsError, decode, decodeAll, decodeChunk, open } from "../../refcodec/web/c3gs.js";

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
  if (way === "entries") {
    const scene = await open(bytes, options);
    const plain = ({ low, high, ...own }) => ({ ...own, low: [...low], high: [...high] });
    return { entries: Array.from(scene.entries(), plain) };
  }
  if (way === "all") {
    const { anchors, digests } = await decodeAll(bytes, { ...options, digests: true });
    return { scene: hex(digests.scene), arrays: Object.keys(anchors), offsets: hex(anchors.offsets.buffer) };
  }
  const run = decode(input(bytes, { way, ...rest }), { ...options, digests: true });
  for (;;) {
    const { value, done } = await run.next();
    if (!done) {
      chunks.push(hex(value.digest));
      continue;
    }
    const { scene, parts } = value.digests;
    const named = Object.entries(parts).map(([name, own]) => [name, hex(own)]);
    return { scene: hex(scene), parts: Object.fromEntries(named) };
  }
}

for await (const line of readline.createInterface({ input: process.stdin })) {
  const chunks = [];
  let said;
  try {
    said = await answer(JSON.parse(line), chunks);
  } catch (error) {
    if (error instanceof C3gsError) said = { error };
    else if (error instanceof BoundPassedError) said = { bound: error.bound, needed: error.needed };
    else said = { fault: `${error?.name}: ${error?.stack ?? error}` };
  }
  process.stdout.write(`${JSON.stringify({ ...said, chunks })}\n`);
}
