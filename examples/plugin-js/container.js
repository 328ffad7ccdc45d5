#!/usr/bin/env node
// The container of a C3GS file, format version 0, as a decoder under test. It is where a decoder in another language
// begins: refcodec/web/container.js, with the commands of the suite around it.
//
//   conformance run --select 'code:1*,2*,3*,40*' -- node examples/plugin-js/container.js {input} {output}
//
// A refused file: exit status 1 (malformed, invalid) or 2 (not supported), and a last line on stderr with the code and
// the offset. A file whose container is right: exit status 3, for this decoder knows no more. 64: usage.
import * as fs from "node:fs";
import { pathToFileURL } from "node:url";
import {
  checkData, checkEnd, parseFrame, passSection, readHeader, readSection,
} from "../../refcodec/web/container.js";
import { C3gsError } from "../../refcodec/web/errors.js";
import { sourceOf } from "../../refcodec/web/source.js";

const EXIT = { refused: 1, unsupported: 2, noMore: 3, usage: 64 };

// SPEC 10.1, PROLOGUE to DIRECTORY, of SECTIONS the sections themselves and what FRAM holds, and END
async function check(data) {
  const source = sourceOf(data);
  const header = await readHeader(source);
  for (const section of header.sections) {
    if (section.type === "FRAM") parseFrame(await readSection(source, section), section.start);
    // The chunks have CRC-32s of their own, so DATA is passed over.
    else if (section.type === "DATA") await passData(source, section);
    else await passSection(source, section);
  }
  await checkEnd(source, header);
}

async function passData(source, section) {
  const { start, length } = section;
  const end = start + length;
  if ((await source.length()) < end) throw new C3gsError("section.truncated", await source.length());
  checkData(section);
}

export async function main([input, output]) {
  if (output === undefined) {
    console.error("usage: container.js INPUT OUTPUT");
    return EXIT.usage;
  }
  try {
    await check(fs.readFileSync(input));
  } catch (error) {
    if (!(error instanceof C3gsError)) {
      // Node's own status for an error, 1, is a verdict.
      console.error(error.message);
      return EXIT.usage;
    }
    console.error(JSON.stringify(error));
    return error.class === "unsupported" ? EXIT.unsupported : EXIT.refused;
  }
  console.error("the container is right; the rest is not decoded");
  return EXIT.noMore;
}

if (import.meta.url === pathToFileURL(process.argv[1]).href) process.exitCode = await main(process.argv.slice(2));
