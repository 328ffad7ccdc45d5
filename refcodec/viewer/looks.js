// Recognises files of other formats.

// The first bytes of each as letters, a sentence about it, and whether `refcodec convert` reads it.
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

// Returns text and isConverted of a file, or undefined for a file that begins as C3GS.
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
