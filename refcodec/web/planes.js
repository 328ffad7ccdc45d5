// The planes (SPEC.md 5.10, 6.9 and 7.3).
import { Cursor, isZero, pad4 } from "./container.js";
import { errorOfCode, need } from "./errors.js";

const PLANES = 5;
const TABLE_LENGTH = 4 * PLANES;

// [R6.9-1], [R6.9-2] and the substreams. data: the section. start: its offset. Returns the sub-planes, [5, ch, B, B].
export function parsePlanes(data, start, header, weights, kernel) {
  need(data.length >= TABLE_LENGTH, "planes.length", start);
  const lengths = new Cursor(data, start).array("length", "u32", PLANES);
  const whole = lengths.reduce((sum, length) => sum + pad4(length), TABLE_LENGTH);
  need(whole === data.length, "planes.length", start);
  const places = [];
  let place = TABLE_LENGTH;
  for (const length of lengths) {
    places.push(place);
    need(isZero(data, place + length, place + pad4(length)), "planes.padding", start + place + length);
    place += pad4(length);
  }
  kernel.makeScene(header, weights);
  const points = header.plane_channels * header.plane_size ** 2;
  const { statuses, planes } = kernel.decodePlanes(data, places, lengths, points);
  statuses.forEach((status, i) => {
    if (status !== 0) throw errorOfCode(status, start + places[i]);
  });
  return planes;
}
