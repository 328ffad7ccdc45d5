// Static C3GS files in splat-transform of PlayCanvas, 2 and 3, with the bits of the decoder. In an empty folder, with a
// clone of the project in ../c3gs:
//
//   npm pack ../c3gs/refcodec/web && npm install ./c3gs-1.0.0-rc.1.tgz @playcanvas/splat-transform
//   cp ../c3gs/examples/splat-transform-reader/read-c3gs.mjs .
//   npx splat-transform -g cpu read-c3gs.mjs -p file=scene.c3gs -r 0,0,180 scene.sog
//
// The output may be any of splat-transform. -r states the axes of PLY files, which a generator cannot do.
import { decodeAll } from "c3gs";

// SPEC.md 9.4: the columns of a PLY file, [name, Float32Array] each. input, options, errors: as of decodeAll and splat.
async function columnsOf(input, options) {
  const { scene, anchors } = await decodeAll(input, options);
  const { count, means, logLengths, quaternions, logits, harmonics } = scene.splat(anchors);
  const width = scene.header.colour_outputs;
  const rest = width / 3 - 1;
  const of = (names, array, step, at = (j) => j) =>
    names.map((name, j) => [name, Float32Array.from({ length: count }, (_, i) => array[step * i + at(j)])]);
  const numbered = (name, size) => Array.from({ length: size }, (_, j) => `${name}_${j}`);
  return [
    ...of(["x", "y", "z"], means, 3),
    ...of(numbered("f_dc", 3), harmonics, width),
    // All harmonics of red come first, then those of green and of blue.
    ...of(numbered("f_rest", 3 * rest), harmonics, width, (j) => 3 * (1 + (j % rest)) + Math.floor(j / rest)),
    ...of(["opacity"], logits, 1),
    ...of(numbered("scale", 3), logLengths, 3),
    ...of(numbered("rot", 4), quaternions, 4),
  ];
}

// What readSpz of their code is: returns the DataTable of a ReadSource. In their readFile, version 3 wraps it in
// dataTableToChunkSource. SuperSplat reads by that readFile, and needs .c3gs in the suffixes of its file-handler.ts.
export async function readC3gs(source, options) {
  const { Column, DataTable, Transform } = await import("@playcanvas/splat-transform");
  const columns = await columnsOf(await source.read().readAll(), options);
  return new DataTable(columns.map(([name, values]) => new Column(name, values)), Transform.PLY);
}

// A generator of their command line
export class Generator {
  static async create(params) {
    const { readFile } = await import("node:fs/promises");
    const columns = await columnsOf(await readFile(params.find(({ name }) => name === "file").value));
    const getRow = (i, row) => columns.forEach(([name, values]) => { row[name] = values[i]; });
    return { count: columns[0][1].length, columnNames: columns.map(([name]) => name), getRow };
  }
}
