// SPEC 2, 5, 8, Annex A and B.4: integers, bytes, tables, and the entropy coder.

export const PRECISION = 14, SCALE_MIN = -40, SINE_LENGTH = 1024, STEP_LENGTH = 64, STEP_SHIFT = 12;
const STATE_MIN = 2 ** 16, RAW_MAX = 16, SCALE_END = 24, FRACTIONS = 16;

// SPEC 2.4. By 7.11 all numbers that they meet in this program fit an i32.
export const rshiftRound = (a, s) => (a + ((1 << s) >> 1)) >> s;
export const clamp = (a, low, high) => Math.min(Math.max(a, low), high);

export const range = (n) => Array.from({ length: n }, (_, i) => i);
export const sum = (list) => list.reduce((a, b) => a + b, 0);
export const largest = (list) => list.reduce((a, b) => Math.max(a, b), 0);

export function check(condition, message) {
  if (!condition) throw new Error(message);
}

// --- bytes ----------------------------------------------------------------------------------------------------------

// SPEC 2.3: the size of a type, and the method of Buffer that writes it
const TYPES = {
  u8: [1, "writeUInt8"], u16: [2, "writeUInt16LE"], u32: [4, "writeUInt32LE"], u64: [8, "writeBigUInt64LE"],
  i8: [1, "writeInt8"], i16: [2, "writeInt16LE"], i32: [4, "writeInt32LE"], i64: [8, "writeBigInt64LE"],
  f32: [4, "writeFloatLE"],
};

// The bytes of a number, or of nested arrays of numbers. Buffer refuses integers out of range.
export function field(type, value) {
  const [size, write] = TYPES[type], values = [value].flat(3), out = Buffer.alloc(size * values.length);
  values.forEach((x, i) => {
    check(type === "f32" ? Number.isFinite(x) : size === 8 || Number.isInteger(x), `${x} is not of type ${type} (2.3)`);
    out[write](size === 8 ? BigInt(x) : x, size * i);
  });
  return out;
}

// SPEC 5: padding behind bytes
export const pad4 = (bytes) => Buffer.concat([bytes, Buffer.alloc(-bytes.length & 3)]);
export const struct = (...fields) => pad4(Buffer.concat(fields));

const CRC_TABLE = range(256).map((n) => range(8).reduce((c) => (c & 1 ? (c >>> 1) ^ 0xedb88320 : c >>> 1), n));

// SPEC 8.8
export function crc32(bytes) {
  let crc = ~0;
  for (const byte of bytes) crc = CRC_TABLE[(crc ^ byte) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}

// --- SPEC Annex A: tables-0.bin -------------------------------------------------------------------------------------

export function readTables(data) {
  let at = 0;
  const take = (count, read) => range(count).map(() => data[read]((at += 2) - 2));
  const sine = take(SINE_LENGTH, "readInt16LE"), step = take(STEP_LENGTH, "readUInt16LE");
  const model = () => take(2 * data[at++] + 2, "readUInt16LE");
  const family = () => range(SCALE_END - SCALE_MIN).map(() => range(FRACTIONS).map(model));
  return { sine, step, gauss: family(), laplace: family() };
}

// --- SPEC 8, B.4: a substream ---------------------------------------------------------------------------------------

export class Substream {
  constructor(lanesLog2) {
    this.lanes = 2 ** lanesLog2;
    this.ranges = []; // (lane, first slot, frequency) of each symbol, in the order of decoding
    this.symbols = [];
    this.raw = [];
    this.rawBits = 0;
  }

  // SPEC 8.3: a group of model indices. Each group begins with lane 0.
  group(models, indices, symbols = indices) {
    models.forEach((model, i) => {
      this.ranges.push([i % this.lanes, sum(model.slice(0, indices[i])), model[indices[i]]]);
      this.symbols.push(symbols[i]);
    });
  }

  // SPEC 8.5 to 8.7: a group with means. parameters: (mean, scale index) of each symbol
  values(family, parameters, symbols, limit) {
    const models = [], indices = [], escapes = [];
    parameters.forEach(([mean, scale], i) => {
      const y = symbols[i];
      check(Number.isInteger(y) && Math.abs(y) <= limit, `${y} is not a symbol of -${limit} to ${limit} [R8.5-1]`);
      const k = clamp(((scale - SCALE_END) >> 3) + 1, 0, RAW_MAX);
      const row = clamp(scale - 8 * k, SCALE_MIN, SCALE_END - 1);
      const h = rshiftRound(mean - 8 * ((1 << k) - 1), k) + 8;
      const model = family[row - SCALE_MIN][h & (FRACTIONS - 1)], radius = model.length / 2 - 1;
      const distance = (y >> k) - (h >> 4), n = Math.abs(distance) - radius;
      models.push(model);
      indices.push(n > 0 ? 2 * radius + 1 : distance + radius);
      if (n > 0) escapes.push([distance < 0, n]);
      this.bits(y, k);
    });
    this.group(models, indices, symbols);
    // SPEC 8.6: the escapes of a group follow all its raw bits.
    for (const [negative, n] of escapes) {
      const z = 31 - Math.clz32(n);
      this.bits(negative, 1);
      this.bits(1 << z, z + 1); // z zero bits, then a one bit
      this.bits(n, z); // n - 2^z is the low z bits of n
    }
  }

  // SPEC 8.6: the low bits of a number, from the least significant one on
  bits(value, count) {
    for (let i = 0; i < count; i++, this.rawBits++) {
      if (this.rawBits % 8 === 0) this.raw.push(0);
      this.raw[this.rawBits >> 3] |= ((value >> i) & 1) << (this.rawBits & 7);
    }
  }

  // SPEC B.4, 5.15: its bytes, not padded
  bytes() {
    const state = new Array(this.lanes).fill(STATE_MIN), words = [];
    for (let i = this.ranges.length - 1; i >= 0; i--) {
      const [lane, low, frequency] = this.ranges[i];
      if (state[lane] >>> (32 - PRECISION) >= frequency) {
        words.push(state[lane] & 0xffff);
        state[lane] >>>= 16;
      }
      state[lane] = Math.floor(state[lane] / frequency) * 2 ** PRECISION + (state[lane] % frequency) + low;
    }
    const head = field("u32", [crc32(field("i32", this.symbols)), words.length, state]);
    return Buffer.concat([head, field("u16", words.reverse()), Buffer.from(this.raw)]);
  }
}
