// The decoder in JavaScript and WebAssembly as a contender in a separate process: node worker.mjs FILE
//
// It answers like worker.py: a line of JSON when it is ready, then one for each line of its input.
import { readFile } from "node:fs/promises";
import { createInterface } from "node:readline";
import { decode, decodeAll } from "../refcodec/web/c3gs.js";

const answer = (found) => console.log(JSON.stringify(found));

// The SHA-256 of the canonical reconstruction, in hexadecimal digits.
async function digest(data) {
  const chunks = decode(data, { digests: true });
  for (;;) {
    const { value, done } = await chunks.next();
    if (done) return Buffer.from(value.digests.scene).toString("hex");
  }
}

// Processor seconds of this process and its threads.
const processor = () => {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1e6;
};

const data = await readFile(process.argv[2]);
await decodeAll(data);
answer({ digest: await digest(data), says: `all symbols and float32 values; node ${process.versions.node}` });
for await (const _ of createInterface({ input: process.stdin })) {
  const [start, before] = [performance.now(), processor()];
  await decodeAll(data);
  answer({ seconds: (performance.now() - start) / 1e3, processor: processor() - before });
}
