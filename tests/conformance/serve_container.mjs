// Runs the plug-in of the guide for many files in one process: starting Node takes longer than most files.
//
// node serve_container.mjs: answers each line {"input", "output"} as `conformance run --serve` demands.
import readline from "node:readline";
import { main } from "../../examples/plugin-js/container.js";

for await (const line of readline.createInterface({ input: process.stdin })) {
  const { input, output } = JSON.parse(line);
  const said = [];
  console.error = (text) => said.push(text);
  const status = await main([input, output]);
  process.stdout.write(`${JSON.stringify({ status, stderr: said.join("\n") })}\n`);
}
