// Sources of file bytes: memory, a stream, or ranges (SPEC.md 10.2).
//
// A source has read(start, size), which returns `size` bytes, or fewer at the file end. length(), the file length, is
// called only after read() returned too few. close() ends reading. size: the file length, if the source is in memory.

class Whole {
  constructor(bytes) {
    this.bytes = bytes;
    this.size = bytes.length;
  }

  async read(start, size) {
    return bytesOf(this.bytes).subarray(start, start + size);
  }

  async length() {
    return this.bytes.length;
  }

  async close() {}
}

// A stream of blocks, read from start to end. Bytes are discarded after reading.
class Arriving {
  // next: returns the next block, or undefined at the end. close: cancels the stream.
  constructor(next, close) {
    Object.assign(this, { next, close, blocks: [], held: 0, start: 0 });
  }

  async more() {
    const block = await this.next();
    if (block === undefined) return false;
    this.blocks.push(bytesOf(block));
    this.held += block.byteLength;
    return true;
  }

  // Removes and returns `size` bytes, or all if there are fewer, as blocks.
  take(size) {
    const taken = [];
    let left = size;
    while (left > 0 && this.blocks.length > 0) {
      const block = this.blocks[0];
      if (block.length <= left) this.blocks.shift();
      else this.blocks[0] = block.subarray(left);
      taken.push(block.subarray(0, left));
      left -= taken[taken.length - 1].length;
    }
    this.held -= size - left;
    this.start += size - left;
    return taken;
  }

  async read(start, size) {
    if (start < this.start) throw new TypeError("bytes that arrive are read from start to end");
    while (this.start < start) {
      if (this.held === 0 && !(await this.more())) break;
      this.take(start - this.start);
    }
    while (this.held < size && (await this.more()));
    const taken = this.take(size);
    if (taken.length === 1) return taken[0];
    const whole = new Uint8Array(taken.reduce((sum, block) => sum + block.length, 0));
    let at = 0;
    for (const block of taken) {
      whole.set(block, at);
      at += block.length;
    }
    return whole;
  }

  async length() {
    do this.take(this.held);
    while (await this.more());
    return this.start;
  }
}

class Ranges {
  constructor({ read, length }) {
    Object.assign(this, { fetch: read, size: length });
  }

  async read(start, size) {
    const wanted = Math.min(size, this.size - start);
    if (wanted <= 0) return new Uint8Array(0);
    const bytes = bytesOf(await this.fetch(start, wanted));
    if (bytes.length !== wanted) throw new TypeError(`read(${start}, ${wanted}) gave ${bytes.length} bytes`);
    return bytes;
  }

  async length() {
    return this.size;
  }

  async close() {}
}

// A slice of Node's Buffer is not a copy, thus a Buffer becomes a plain Uint8Array.
function bytesOf(block) {
  if (!(block instanceof ArrayBuffer || ArrayBuffer.isView(block))) {
    throw new TypeError("bytes are a Uint8Array, an ArrayBuffer or a view of one");
  }
  try {
    return new Uint8Array(block.buffer ?? block, block.byteOffset, block.byteLength);
  } catch {
    throw new TypeError("the bytes are not there any more, since their ArrayBuffer was transferred");
  }
}

// Returns the source for an input: bytes, a Blob, a Response, a stream, a list of blocks, or {read, length}.
export function sourceOf(input) {
  if (input instanceof ArrayBuffer || ArrayBuffer.isView(input)) return new Whole(bytesOf(input));
  if (typeof Blob !== "undefined" && input instanceof Blob) {
    const read = (start, size) => input.slice(start, start + size).arrayBuffer();
    return new Ranges({ read, length: input.size });
  }
  if (typeof Response !== "undefined" && input instanceof Response) {
    if (!input.ok || input.body === null) throw new TypeError(`the response has status ${input.status}`);
    return sourceOf(input.body);
  }
  if (typeof input?.getReader === "function") {
    const reader = input.getReader();
    return new Arriving(async () => (await reader.read()).value, () => reader.cancel());
  }
  if (typeof input?.read === "function" && typeof input.length === "number") return new Ranges(input);
  const start = input?.[Symbol.asyncIterator] ?? input?.[Symbol.iterator];
  if (typeof start !== "function" || typeof input === "string") {
    throw new TypeError("a file is bytes, a Blob, a Response, a stream, blocks of bytes, or {read, length}");
  }
  const blocks = start.call(input);
  const next = async () => {
    const { value, done } = await blocks.next();
    return done ? undefined : value;
  };
  return new Arriving(next, async () => blocks.return?.());
}
