// Where the bytes of a file come from: from memory, as they arrive, or by ranges (SPEC.md 10.2).
//
// A source has read(start, size), which gives `size` bytes, or fewer where the file ends. length(), that of the file,
// is asked for only after read() gave too few. close() says that nothing more is read. size: the bytes that are there
// from the start, of a source in memory.

class Whole {
  constructor(bytes) {
    this.bytes = bytes;
    this.size = bytes.length;
  }

  async read(start, size) {
    return this.bytes.subarray(start, start + size);
  }

  async length() {
    return this.bytes.length;
  }

  async close() {}
}

// Bytes that arrive in blocks are read from start to end. What was read is not held.
class Arriving {
  // next: gives the next block, or undefined at the end. close: ends it before that.
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

  // Takes `size` bytes away, or all if there are fewer, and returns them as blocks.
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

// Node's Buffer is a Uint8Array whose slice is no copy, so it becomes a plain one.
function bytesOf(block) {
  if (block instanceof ArrayBuffer) return new Uint8Array(block);
  if (ArrayBuffer.isView(block)) return new Uint8Array(block.buffer, block.byteOffset, block.byteLength);
  throw new TypeError("bytes are a Uint8Array, an ArrayBuffer or a view of one");
}

// Returns the source of what a caller has: bytes, a Blob, a Response, a stream, a list of blocks, or {read, length}.
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
