// Which Gaussians are drawn if a scene has more than the budget: of each chunk, the most visible ones.
import { anchorArrays } from "../web/container.js";

// Returns the most Gaussians of each chunk, `quotas`, at most `budget` in all; `kept`, how many the chunks have; and
// `dropped`, the numbers of chunks without any. Sparse chunks have large Gaussians, thus they keep more: the share of a
// chunk is the surface of as many cubes as fill its bounds. entries: of the chunk index.
export function planned(entries, count, budget) {
  const [quotas, shares] = [new Float64Array(count), new Float64Array(count)];
  for (const { number, kept, low, high } of entries) {
    quotas[number] = kept;
    shares[number] = Math.cbrt(kept * low.reduce((volume, x, i) => volume * (high[i] - x), 1) ** 2) + 1e-12 * kept;
  }
  const kept = quotas.reduce((sum, own) => sum + own, 0);
  let [left, whole] = [budget, shares.reduce((sum, share) => sum + share, 0)];
  // Chunks that keep all come first.
  const order = kept > budget ? quotas.map((_, i) => i) : [];
  for (const i of order.sort((a, b) => shares[b] * quotas[a] - shares[a] * quotas[b])) {
    // The sum of the shares is rounded, and may be below one of them.
    const share = shares[i] > 0 ? Math.floor((left * shares[i]) / Math.max(whole, shares[i])) : 0;
    whole -= shares[i];
    left -= quotas[i] = Math.min(quotas[i], share);
  }
  return { quotas, kept, dropped: [...quotas.keys()].filter((i) => shares[i] > 0 && quotas[i] === 0) };
}

// Returns a chunk with the anchors of its most visible Gaussians, at most `quota` of them. seen: Gaussians of its
// scene, empty. place: of a camera.
export function thinned(seen, chunk, quota, place) {
  const { header } = seen.scene;
  const { count, anchors, opacities, scales } = seen.chunk(seen.add(chunk), place);
  seen.clear();
  const [weights, kept] = [new Float64Array(chunk.count), new Uint32Array(chunk.count)];
  for (let i = 0; i < count; i++) {
    const [a, b, c] = scales.subarray(3 * i, 3 * i + 3);
    // The opacity times the root of the area.
    weights[anchors[i] - chunk.first] += opacities[i] * Math.sqrt(Math.max(a * b, a * c, b * c));
  }
  chunk.masks.forEach((mask, i) => (kept[Math.floor(i / header.offset_count)] += mask));
  let left = quota;
  const fits = (i) => kept[i] > 0 && kept[i] <= left && (left -= kept[i]) >= 0;
  const chosen = [...weights.keys()].sort((a, b) => weights[b] - weights[a]).filter(fits).sort((a, b) => a - b);
  const found = { ...chunk, count: chosen.length };
  for (const [name, [type, width]] of Object.entries(anchorArrays(header))) {
    found[name] = new type(width * chosen.length);
    chosen.forEach((i, to) => found[name].set(chunk[name].subarray(width * i, width * (i + 1)), width * to));
  }
  return found;
}
