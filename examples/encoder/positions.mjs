// SPEC 7.4, 7.5, 7.12 and B.1: positions, the tree of cells, and the context of an anchor.

import { PRECISION, SINE_LENGTH, check, clamp, largest, range, rshiftRound, sum } from "./coder.mjs";
import { activation } from "./networks.mjs";

const CELL_LEVELS = 16, CELL_INDEX = 40, POSITION_MODELS = 18, UNIT_BITS = 16, FRAME_CLAMP = 2 ** 30 - 1, LERP_BITS = 8;

// SPEC B.1, 7.4: the nearest f16 of a coordinate, as its 16 bits and as P. -0 becomes +0.
export function toF16(x) {
  const a = Math.abs(x) * 2 ** 24;
  let e = 0;
  while (a >= 2 ** (11 + e)) e++;
  let m = Math.floor(a / 2 ** e);
  const rest = a / 2 ** e - m;
  if (rest > 0.5 || (rest === 0.5 && m % 2)) m++;
  const bits = (e << 10) + m; // the leading one of a normal number counts in the exponent
  check(bits < 0x7c00, `the coordinate ${x} is not a finite f16: change the position grid (B.1)`);
  return x < 0 && m ? { bits: bits | 0x8000, p: -m * 2 ** e } : { bits, p: m * 2 ** e };
}

// --- SPEC 7.12: cells -----------------------------------------------------------------------------------------------

// The inverse of CELL_NUMBER, or NaN
function cellOf({ bits, p }, cellShift) {
  const n = cellShift < CELL_INDEX ? p / 2 ** cellShift : bits & 0x8000 ? 0x8000 - bits : bits;
  const c = n + 2 ** (CELL_LEVELS - 1);
  return Number.isInteger(c) && c >= 0 && c < 2 ** CELL_LEVELS ? c : NaN;
}

// The number of a position's cell along the Morton curve: octal digits x + 2 y + 4 z, the root's first. NaN: no cell
export function mortonNumber(position, cellShift) {
  const [x, y, z] = position.map((q) => cellOf(q, cellShift));
  const digit = (level) => ((x >> level) & 1) + 2 * ((y >> level) & 1) + 4 * ((z >> level) & 1);
  return Number.isNaN(x + y + z) ? NaN : range(CELL_LEVELS).reduce((a, i) => 8 * a + digit(CELL_LEVELS - 1 - i), 0);
}

// The groups of a packed chunk: (numbers of models, symbols) of each. numbers: its cells in ascending order
export function treeGroups(numbers) {
  return range(CELL_LEVELS).reverse().flatMap((level) => {
    const nodes = new Map(); // the children of each node, in the order of the nodes
    for (const number of numbers) {
      const cube = Math.floor(number / 8 ** level), node = Math.floor(cube / 8);
      nodes.set(node, nodes.get(node) | (1 << (cube % 8)));
    }
    const children = [...nodes.values()], low = children.map((c) => c & 15), first = 6 * Math.min(level, 2);
    const second = low.map((a) => first + 1 + sum(range(4).map((i) => (a >> i) & 1)));
    return [[low.map(() => first), low], [second, children.map((c) => c >> 4)]];
  });
}

// SPEC B.1: the largest shift that divides every P. If it has not all cells, no smaller one has.
export function chooseCellShift(positions) {
  const all = positions.flat();
  if (all.every(({ p }) => p === 0)) return 0;
  let shift = CELL_INDEX - 1;
  while (!all.every(({ p }) => Number.isInteger(p / 2 ** shift))) shift--;
  return all.some((q) => Number.isNaN(cellOf(q, shift))) ? CELL_INDEX : shift;
}

// SPEC B.1: the frequencies of each model. trees: the groups of each packed chunk
export function choosePositionModel(trees) {
  const counts = range(POSITION_MODELS).map(() => new Array(16).fill(0));
  for (const [models, symbols] of trees.flat()) symbols.forEach((y, i) => counts[models[i]][y]++);
  return counts.map((count, model) => {
    const absent = [1, 7, 13].includes(model) ? 1 : 0; // [R6.10-4]: frequency 0 of symbol 0
    if (sum(count) === 0) count.fill(1, absent);
    const total = sum(count), one = 2 ** PRECISION;
    const frequency = count.map((n, y) => (y < absent ? 0 : Math.max(1, Math.floor((n * one) / total))));
    frequency[count.indexOf(largest(count))] += one - sum(frequency);
    return frequency;
  });
}

// --- SPEC 7.5: the context ------------------------------------------------------------------------------------------

function isqrt(q) {
  let n = BigInt(Math.floor(Math.sqrt(Number(q))));
  while (n * n > q) n--;
  while ((n + 1n) * (n + 1n) <= q) n++;
  return n;
}

// SPEC 7.5.1 to 7.5.3: (u_0, u_1, u_2). BigInt where 7.11 has more than 53 bits. The quotients are of integers below
// 2^48: rounded to a double they have the right floor.
function rescaled(frame, position) {
  const v = frame.matrix.map((row, c) => {
    const t = row.reduce((a, m, i) => a + BigInt(m) * BigInt(position[i].p), BigInt(frame.translation[c]));
    const s = BigInt(frame.shift[c]);
    return clamp(Number((t + ((1n << s) >> 1n)) >> s), -FRAME_CLAMP, FRAME_CLAMP);
  });
  const unit = 2 ** UNIT_BITS, q = v.reduce((a, x) => a + BigInt(x) ** 2n, 0n), n = Number(isqrt(q));
  const f = Math.floor(((2 * n - unit) * unit) / n);
  return v.map((x, c) => {
    const w = q <= unit * unit ? x : Math.floor((x * f) / n), low = frame.low[c];
    return clamp(Math.floor(((w - low) * unit) / (frame.high[c] - low)), 0, unit);
  });
}

// SPEC 7.5.4. at(k, i, j): the symbol of channel k at a point of the plane, which has size points along a side
function query(at, channels, size, u, planeShift) {
  const [[j, fj], [i, fi]] = u.slice(0, 2).map((x) => {
    const g = x * (size - 1), c = Math.min(g >> UNIT_BITS, size - 2);
    return [c, rshiftRound(g - (c << UNIT_BITS), UNIT_BITS - LERP_BITS)];
  });
  const one = 1 << LERP_BITS;
  return range(channels).map((k) => {
    const upper = at(k, i, j) * (one - fj) + at(k, i, j + 1) * fj;
    const lower = at(k, i + 1, j) * (one - fj) + at(k, i + 1, j + 1) * fj;
    return activation(rshiftRound(upper * (one - fi) + lower * fi, 2 * LERP_BITS - planeShift));
  });
}

// SPEC 7.5.5
function gamma(u, frequencies, sine) {
  return range(frequencies).flatMap((k) => {
    const phase = ((u - 2 ** (UNIT_BITS - 1)) << k) & (2 ** UNIT_BITS - 1);
    const turn = rshiftRound(phase * SINE_LENGTH, UNIT_BITS);
    return [sine[turn % SINE_LENGTH], sine[(turn + SINE_LENGTH / 4) % SINE_LENGTH]];
  });
}

// SPEC 7.5, CONTEXT: the inputs of F_h
export function contextOf({ frame, planes, plane_shift: shift, dimensions: d }, position, tables) {
  if (!frame) return [];
  const u = rescaled(frame, position), size = d.plane_size, encoding = gamma(u[2], d.frequency_count, tables.sine);
  if (size === 0) return encoding;
  const single = (k, i, j) => planes[0][k][i][j];
  const double = (k, i, j) => planes[1 + 2 * (i >= size) + (j >= size)][k][i % size][j % size]; // SPEC 7.3
  const samples = (at, side) => query(at, d.plane_channels, side, u, shift);
  return [...samples(single, size), ...samples(double, 2 * size), ...encoding];
}
