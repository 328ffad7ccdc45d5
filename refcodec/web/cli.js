#!/usr/bin/env node
// The decoder as a program, as the conformance suite runs it:
//
//   conformance run -- node refcodec/web/cli.js decode {input} {output}
//   conformance run --serve -- node refcodec/web/cli.js serve
//   conformance run --gaussians 'node refcodec/web/cli.js gaussians {input} {camera} {output}' -- ...
//
// Exit status: 0 accepted, 1 malformed or invalid, 2 unsupported; the last line on stderr then has the error (SPEC.md
// 10.3). 64: wrong usage, or a file that cannot be read, written or drawn. 70: internal error, or out of memory.
//
// An output is written to a temporary file and then renamed: a failed run changes nothing.
import { randomUUID } from "node:crypto";
import * as fs from "node:fs";
import * as path from "node:path";
import * as readline from "node:readline";
import { C3gsError, decode, Gaussians, RenderModelError } from "./c3gs.js";
import { Digests, partsOf, sceneHead } from "./digests.js";

const EXIT = { done: 0, refused: 1, unsupported: 2, usage: 64, fault: 70 };

// The number of paths of each command.
const PATHS = { decode: 2, gaussians: 3 };

class UsageError extends Error {}

// A file by ranges, to hold only one chunk in memory.
function fileSource(file) {
  const read = (start, size) => {
    const bytes = new Uint8Array(size);
    let got = 0;
    for (let n = -1; got < size && n !== 0; got += n) n = fs.readSync(file, bytes, got, size - got, start + got);
    return bytes.subarray(0, got);
  };
  return { read, length: fs.fstatSync(file).size };
}

function write(file, data, at) {
  const bytes = new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
  for (let done = 0; done < bytes.length; ) done += fs.writeSync(file, bytes, done, bytes.length - done, at + done);
}

// The offset of each part of the reconstruction in the output (vectors/README.md), after head and digests.
function partPlaces({ header, features, planes, layers }) {
  const [n, k] = [header.anchor_count, header.offset_count];
  const sizes = {
    positions: 12 * n, masks: k * n, planes: planes.byteLength, features: 4 * features * n, scalings: 24 * n,
    offsets: 12 * k * n, weights: layers.reduce((sum, { values }) => sum + values.byteLength, 0),
  };
  const parts = partsOf(header);
  const places = {};
  let at = sceneHead(header).length + 32 * parts.length;
  for (const name of parts) {
    places[name] = at;
    at += sizes[name] ?? 0;
  }
  return places;
}

// Writes the canonical reconstruction, chunk by chunk.
async function reconstruct(input, output) {
  const chunks = decode(fileSource(input));
  let digests, at;
  const append = (name, data) => {
    write(output, data, at[name]);
    at[name] += data.byteLength;
  };
  for (;;) {
    const { value, done } = await chunks.next();
    const { scene } = value;
    digests ??= new Digests(scene);
    at ??= partPlaces(scene);
    if (!done) {
      const { parts } = digests.add(value);
      for (const name of partsOf(scene.header)) if (name in parts) append(name, parts[name]);
      continue;
    }
    const head = sceneHead(scene.header);
    write(output, Buffer.concat([head, ...Object.values(digests.end().parts)]), 0);
    append("planes", scene.planes);
    for (const { values } of scene.layers) append("weights", values);
    return;
  }
}

// The place of the camera of a document (vectors/README.md, SPEC 14.2).
function readCentre(path) {
  const { rotation, translation } = cameraOf(fs.readFileSync(path, "utf8"));
  const three = (list, right) => Array.isArray(list) && list.length === 3 && list.every(right);
  const numbers = (list) => three(list, Number.isFinite);
  if (!three(rotation, numbers) || !numbers(translation)) throw new UsageError(`${path} is no camera`);
  return [0, 1, 2].map((axis) => -rotation.reduce((sum, row, i) => sum + row[axis] * translation[i], 0));
}

function cameraOf(text) {
  try {
    return JSON.parse(text) ?? {};
  } catch {
    return {};
  }
}

// The Gaussians of a view as JSON (vectors/README.md).
function documents(view) {
  return Array.from({ length: view.count }, (_, i) => {
    const row = (array, width) => Array.from(array.subarray(width * i, width * (i + 1)));
    return JSON.stringify({
      anchor: view.anchors[i], offset: view.offsets[i], mean: row(view.positions, 3), lengths: row(view.scales, 3),
      quaternion: row(view.rotations, 4), opacity: view.opacities[i], colour: row(view.colours, 3),
    });
  });
}

// Writes the Gaussians that are visible from a place, chunk by chunk.
async function see(input, centre, output) {
  let [gaussians, at, separator] = [undefined, 0, ""];
  const add = (text) => {
    const bytes = new TextEncoder().encode(text);
    write(output, bytes, at);
    at += bytes.length;
  };
  add('{"gaussians":[');
  for await (const chunk of decode(fileSource(input))) {
    gaussians ??= new Gaussians(chunk.scene);
    const found = documents(gaussians.chunk(gaussians.add(chunk), centre));
    gaussians.clear();
    if (found.length === 0) continue;
    add(separator + found.join(","));
    separator = ",";
  }
  add("]}");
}

// Calls `make` with a file to write, then moves it to `output`. Links are followed. A device is written directly.
async function staged(output, inputs, make) {
  const status = (name) => fs.statSync(name, { bigint: true, throwIfNoEntry: false });
  const there = status(output);
  if (there !== undefined && !there.isFile()) return written(output, "w", make, output);
  for (const name of inputs) {
    const read = status(name);
    if (there !== undefined && read?.dev === there.dev && read.ino === there.ino) {
      throw new UsageError(`${output} is ${name}, which is read: choose another output`);
    }
  }
  const place = there === undefined ? output : fs.realpathSync(output);
  const beside = path.join(path.dirname(place), `.c3gs-${randomUUID()}`);
  try {
    await written(beside, "wx", make, output);
    fs.renameSync(beside, place);
  } catch (error) {
    fs.rmSync(beside, { force: true });
    throw error;
  }
}

// shown: the output in errors.
async function written(name, flags, make, shown) {
  let file;
  try {
    file = fs.openSync(name, flags);
    await make(file);
  } catch (error) {
    // The others are of the input.
    if (["open", "write"].includes(error.syscall)) error.message = `${shown}: ${error.message.split(",")[0]}`;
    throw error;
  } finally {
    if (file !== undefined) fs.closeSync(file);
  }
}

// Decodes one file. camera: the path of a camera document, to write its Gaussians.
//
// Returns the exit status and the last line of stderr.
async function run(input, output, camera) {
  let file;
  try {
    const centre = camera === undefined ? undefined : readCentre(camera);
    file = fs.openSync(input, "r");
    await staged(output, camera === undefined ? [input] : [input, camera], (out) =>
      centre === undefined ? reconstruct(file, out) : see(file, centre, out),
    );
    return { status: EXIT.done, stderr: "" };
  } catch (error) {
    if (error instanceof C3gsError) {
      const status = error.class === "unsupported" ? EXIT.unsupported : EXIT.refused;
      return { status, stderr: JSON.stringify(error) };
    }
    const isUsage = error instanceof UsageError || error instanceof RenderModelError;
    if (error.syscall !== undefined || isUsage) {
      return { status: EXIT.usage, stderr: `c3gs: ${error.message}` };
    }
    return { status: EXIT.fault, stderr: `c3gs: a fault of the program\n${error.stack}` };
  } finally {
    if (file !== undefined) fs.closeSync(file);
  }
}

// The request in a line of `serve`.
function request(line) {
  let asked;
  try {
    asked = JSON.parse(line);
  } catch {
    asked = undefined;
  }
  if (typeof asked?.input !== "string" || typeof asked.output !== "string") {
    throw new UsageError(`serve reads lines {"id", "input", "output"}, which are JSON`);
  }
  return asked;
}

// Answers each line {"id", "input", "output"} as `conformance run --serve` requires.
async function serve() {
  for await (const line of readline.createInterface({ input: process.stdin })) {
    const { id, input, output } = request(line);
    process.stdout.write(`${JSON.stringify({ id, ...(await run(input, output)) })}\n`);
  }
  return EXIT.done;
}

async function main([command, ...paths]) {
  if (command === "serve" && paths.length === 0) return serve();
  if (!(command in PATHS) || paths.length !== PATHS[command]) {
    console.error("usage: c3gs decode INPUT OUTPUT, or c3gs gaussians INPUT CAMERA OUTPUT, or c3gs serve");
    return EXIT.usage;
  }
  const [camera] = paths.slice(1, -1);
  const { status, stderr } = await run(paths[0], paths[paths.length - 1], camera);
  if (stderr !== "") console.error(stderr);
  return status;
}

// The exit status 1, which Node uses for errors, is a verdict.
function fail(error) {
  const usage = error instanceof UsageError || error.syscall !== undefined;
  console.error(usage ? `c3gs: ${error.message}` : `c3gs: a fault of the program\n${error.stack}`);
  process.exit(usage ? EXIT.usage : EXIT.fault);
}

process.on("uncaughtException", fail);
process.exitCode = await main(process.argv.slice(2));
