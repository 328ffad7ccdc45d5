// What a file looks like that is no C3GS file.

// Its first bytes, one letter each, a sentence of it, and whether `refcodec convert` reads it.
const KINDS = [
  [/^$/, "It is empty.", false],
  [/^ply[\r\n]/, "It looks like a PLY file.", true],
  [/^(\x1f\x8b|NGSP)/, "It looks like an SPZ file.", true],
  [/^PK\x03\x04/, "It looks like a ZIP archive, such as a SOG file.", true],
  [/^glTF/, "It looks like a .glb file.", true],
  [/^\s*<(!doctype|html)/i, "It looks like a web page.", false],
  [/^(\x89PNG|\xff\xd8\xff)/, "It looks like an image.", false],
  // SPEC.md 6.1
  [/^(?!\x89C3GS)/, "It is a file of another kind.", false],
];
const HEAD = 64;

// Returns what is known of a file: text, and isConverted, or undefined for what begins as a C3GS file does.
// input: bytes or a Blob. url: where the file is, without an input.
export async function looks({ input, url }) {
  const body = input === undefined ? (await fetch(url)).body : new Blob([input]).slice(0, HEAD).stream();
  const reader = body.getReader();
  const { value = [] } = await reader.read();
  await reader.cancel();
  const start = String.fromCharCode(...value.slice(0, HEAD));
  const found = KINDS.find(([pattern]) => pattern.test(start));
  return found && { text: found[1], isConverted: found[2] };
}
