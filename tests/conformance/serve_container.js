// Runs the plug-in of the guide for many files in one process: starting Node takes longer than most files.
//
// node serve_container.js: answers each line {"input", "output"} as `conformance run --serve` demands. The plug-in is
// read anew for each file, as the command is, so that nothing is left from the file before.
"use strict";
const path = require("node:path");
const readline = require("node:readline");

const PLUGIN = path.resolve(__dirname, "../../examples/plugin-js/container.js");
const node = process.argv[0];

readline.createInterface({ input: process.stdin }).on("line", (line) => {
  const { input, output } = JSON.parse(line);
  const said = [];
  console.error = (text) => said.push(text);
  process.argv = [node, PLUGIN, input, output];
  delete require.cache[PLUGIN];
  require(PLUGIN);
  const status = process.exitCode;
  process.exitCode = 0;
  process.stdout.write(JSON.stringify({ status, stderr: said.join("\n") }) + "\n");
});
