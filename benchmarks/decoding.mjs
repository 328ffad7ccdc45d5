// The decoder in JavaScript and WebAssembly: node decoding.mjs FILE decodes twice, and prints what decoding.py prints.
import { readFile } from "node:fs/promises";
import { decodeAll } from "../refcodec/web/c3gs.js";

// Processor seconds of this process and its threads.
const processor = () => {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1e6;
};

const data = await readFile(process.argv[2]);
await decodeAll(data);
const [start, before] = [performance.now(), processor()];
await decodeAll(data);
console.log(JSON.stringify({ seconds: (performance.now() - start) / 1e3, processor: processor() - before }));
