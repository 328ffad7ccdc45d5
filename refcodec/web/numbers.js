// Powers of two. Math.pow is not necessarily exact.

// 2^e, for -1022 <= e <= 1023
export function power(e) {
  const view = new DataView(new ArrayBuffer(8));
  view.setUint32(0, (e + 1023) << 20);
  return view.getFloat64(0);
}
