// Exact arithmetic with binary64.

// 2^e, for -1022 <= e <= 1023. Math.pow is not necessarily exact.
export function power(e) {
  const view = new DataView(new ArrayBuffer(8));
  view.setUint32(0, (e + 1023) << 20);
  return view.getFloat64(0);
}

// ROUND_SCALED (2.4): floor(x * unit + 1/2). x * unit has 24 bits, thus it is exact in binary64. The sum is exact too,
// except for small and large numbers, where the rounded sum has the same floor.
export function roundScaled(x, unit) {
  return Math.floor(x * unit + 0.5);
}

// The constant harmonic (14.6).
export const SH_0 = 0.28209479177387814;
