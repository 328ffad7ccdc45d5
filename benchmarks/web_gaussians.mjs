// Says what the Gaussians of places cost. node web_gaussians.mjs FILE: a place for each line, 3 numbers.
//
// The first answer has the processor seconds of adding all chunks. The others have the seconds of a place and how many
// Gaussians it sees.
import fs from "node:fs";
import readline from "node:readline";
import { decode, Gaussians } from "../refcodec/web/c3gs.js";

const measured = (run) => {
  const before = process.cpuUsage();
  const value = run();
  const { user, system } = process.cpuUsage(before);
  return { seconds: (user + system) / 1e6, value };
};
const say = (said) => process.stdout.write(`${JSON.stringify(said)}\n`);

let gaussians;
let seconds = 0;
for await (const chunk of decode(fs.readFileSync(process.argv[2]))) {
  gaussians ??= new Gaussians(chunk.scene);
  seconds += measured(() => gaussians.add(chunk)).seconds;
}
say({ seconds });
const out = gaussians.room(gaussians.slotCount);
for await (const line of readline.createInterface({ input: process.stdin })) {
  const place = JSON.parse(line);
  const { seconds: own, value } = measured(() => gaussians.all(place, out));
  say({ seconds: own, count: value.count });
}
