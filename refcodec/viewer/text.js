// Text from outside, in printable form (SPEC.md 13.4), and bytes as text. refcodec/files/text.py has the same rule.

// Characters that Python does not call printable: controls, marks of text direction, halves of surrogate pairs,
// unassigned characters, and separators except the space.
const HIDDEN = /(?! )[\p{C}\p{Z}]/u;
const SHORT = new Map([["\t", "\\t"], ["\n", "\\n"], ["\r", "\\r"]]);

// The escape of Python: \x1b, \u202e, \U000e0001.
function escaped(letter) {
  const code = letter.codePointAt(0);
  const [mark, digits] = code < 0x100 ? ["x", 2] : code < 0x10000 ? ["u", 4] : ["U", 8];
  return SHORT.get(letter) ?? `\\${mark}${code.toString(16).padStart(digits, "0")}`;
}

// Returns a text in which every character can be seen. most: the most characters. A longer text ends with an ellipsis.
export function printable(text, most) {
  // Examines only characters that can be shown. A character has at most two units.
  const letters = [...text.slice(0, 2 * most + 2)];
  const shown = letters.map((letter) => (HIDDEN.test(letter) ? escaped(letter) : letter)).join("");
  const kept = [...shown];
  return kept.length <= most ? shown : `${kept.slice(0, most).join("")}…`;
}

// The bytes of a text in base64.
export function bytesOf(text) {
  const letters = atob(text.trim());
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}
