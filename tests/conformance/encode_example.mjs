// Runs the encoder of examples/encoder for many scenes in one process: starting Node takes longer than most scenes.
//
// node encode_example.mjs: reads each line as the path, in JSON, of a scene as text, writes the file beside it, and
// answers with "" or the error.
import * as fs from "node:fs";
import readline from "node:readline";
import { readTables } from "../../examples/encoder/coder.mjs";
import { encode, readScene } from "../../examples/encoder/encoder.mjs";

const tables = readTables(fs.readFileSync(new URL("../../refcodec/data/tables-0.bin", import.meta.url)));
for await (const line of readline.createInterface({ input: process.stdin })) {
  const path = JSON.parse(line);
  let said = "";
  try {
    fs.writeFileSync(`${path}.c3gs`, encode(readScene(fs.readFileSync(path, "utf8")), tables));
  } catch (error) {
    said = error.message;
  }
  console.log(JSON.stringify(said));
}
