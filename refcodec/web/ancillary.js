// The metadata and the cameras of a file (SPEC.md 5.16, 5.17, 6.14 and 6.15). Their faults are not errors of the file.
import { Cursor, pad4 } from "./container.js";

const METADATA_MAX = 1 << 16;
// The most bytes of cameras in memory. 65535 cameras with names of 196 bytes have fewer.
const CAMERAS_MAX = 1 << 24;
const KEY = /^[a-z0-9._-]+$/;
// The bytes of the fields before a name
const CAMERA_LENGTH = 60;

// Thrown by readers at the premature end of a section, and to end reading.
const END = Symbol("end");

const text = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });
// Maps each byte to a distinct letter, ASCII to itself.
const latin = new TextDecoder("latin1");

// Reads structs of 5.16 and 5.17. Throws END if they are longer than the section.
class Reader {
  constructor(data) {
    this.data = data;
    this.next = 0;
  }

  take(size) {
    if (this.next + size > this.data.length) throw END;
    const taken = this.data.subarray(this.next, this.next + size);
    this.next += size;
    return taken;
  }

  cursor(size) {
    return new Cursor(this.take(size), 0);
  }

  // Skips the padding after a struct that began at `start`, whether it is zero or not.
  pad(start) {
    this.take(pad4(this.next - start) - (this.next - start));
  }
}

// Calls `read` with a reader and the number of structs. Stops at the section end.
function structs(data, read) {
  const reader = new Reader(data);
  try {
    const count = reader.cursor(4).u16("count");
    for (let i = 0; i < count; i++) read(reader);
  } catch (error) {
    if (error !== END) throw error;
  }
}

function decoded(bytes) {
  try {
    return text.decode(bytes);
  } catch {
    return undefined;
  }
}

// 6.14: adds the entries before the first syntax fault. Entries of earlier sections remain.
function readMetadata(data, { metadata }) {
  const found = new Map();
  let last;
  structs(data, (reader) => {
    const start = reader.next;
    const head = reader.cursor(4);
    const [keyLength, valueLength] = [head.u16("key_length"), head.u16("value_length")];
    const key = latin.decode(reader.take(keyLength));
    const value = decoded(reader.take(valueLength));
    reader.pad(start);
    // Invalid UTF-8 is a syntax fault.
    if (value === undefined || /[^\0-\x7f]/.test(key)) throw END;
    if (KEY.test(key) && (last === undefined || key > last)) found.set(key, value);
    last = key;
  });
  for (const [key, value] of found) if (!metadata.has(key)) metadata.set(key, value);
}

// 6.15: adds the valid cameras.
function readCameras(data, { cameras }) {
  const names = new Set();
  structs(data, (reader) => {
    const start = reader.next;
    const c = reader.cursor(CAMERA_LENGTH);
    const length = c.u32("length");
    const camera = { name: undefined, width: c.u32("width"), height: c.u32("height") };
    for (const [field, count] of [["focal", 2], ["principal_point", 2], ["rotation", 4], ["translation", 3]]) {
      camera[field] = c.array(field, "f32", count);
    }
    const bytes = reader.take(c.u32("name_length"));
    reader.pad(start);
    // A later minor version may have more fields.
    const end = start + 4 + length;
    if (length % 4 !== 0 || end < reader.next || end > data.length) throw END;
    reader.next = end;
    camera.name = decoded(bytes);
    const { width, height, focal, rotation } = camera;
    const numbers = [...focal, ...camera.principal_point, ...rotation, ...camera.translation];
    const right =
      camera.name !== undefined && numbers.every(Number.isFinite) && width > 0 && height > 0 &&
      focal.every((length) => length > 0) && rotation.some((x) => x !== 0);
    const name = latin.decode(bytes);
    if (right && !names.has(name)) cameras.push(camera);
    names.add(name);
  });
}

const READERS = { mETa: [readMetadata, METADATA_MAX], cAMs: [readCameras, CAMERAS_MAX] };

// Returns the reader of a section, a function of its bytes and of {metadata, cameras}, or undefined.
export function ancillaryReader({ type, mode, length }, { maxMemory = Infinity }) {
  const [read, most] = READERS[type] ?? [undefined, 0];
  return mode === 0 && length <= Math.min(most, maxMemory) ? read : undefined;
}
