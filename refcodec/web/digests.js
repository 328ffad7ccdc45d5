// The digests of the canonical reconstruction (SPEC.md 9.3), chunk by chunk. Only for Node: browsers have no SHA-256 of
// bytes that come piece by piece.
import { createHash } from "node:crypto";
import { isStatic } from "./container.js";

const PARTS = ["positions", "masks", "planes", "features", "scalings", "offsets", "weights"];
// The last part of a static scene (9.4).
const SPLAT = "splat";

export function partsOf(header) {
  return isStatic(header) ? [...PARTS, SPLAT] : PARTS;
}

// 2.3
const u32 = (...values) => Uint8Array.from(values.flatMap((value) => [0, 8, 16, 24].map((bit) => value >>> bit)));

// The first bytes of the digest input of a scene.
export function sceneHead({ anchor_count: count, drawn, later }) {
  const rest = later.length > 0 ? createHash("sha256").update(later).digest() : Buffer.alloc(0);
  return Buffer.concat([Buffer.from(rest.length > 0 ? "C3GSREC2" : "C3GSREC1"), u32(count), drawn, rest]);
}

// The numbers of each Gaussian one after the other.
function rowsOf({ count, ...splat }) {
  const arrays = Object.values(splat);
  const rows = new Float32Array(arrays.reduce((sum, { length }) => sum + length, 0));
  for (let i = 0, at = 0; i < count; i++) {
    for (const array of arrays) {
      const width = array.length / count;
      rows.set(array.subarray(width * i, width * (i + 1)), at);
      at += width;
    }
  }
  return rows;
}

export class Digests {
  constructor(scene) {
    this.scene = scene;
    this.hashes = new Map(partsOf(scene.header).map((name) => [name, createHash("sha256")]));
    this.hashes.get("planes").update(scene.planes);
    for (const { values } of scene.layers) this.hashes.get("weights").update(values);
  }

  // Adds the next chunk, or all anchors. Returns its digest, and its parts by name.
  add(chunk) {
    const { header, features } = this.scene;
    const parts = isStatic(header) ? { ...chunk, splat: rowsOf(this.scene.splat(chunk)) } : chunk;
    const own = createHash("sha256").update("C3GSCHK1").update(u32(chunk.count, header.offset_count, features));
    for (const [name, hash] of this.hashes) {
      if (name === "planes" || name === "weights") continue;
      own.update(parts[name]);
      hash.update(parts[name]);
    }
    return { digest: own.digest(), parts };
  }

  // Returns the digest of the scene, and of each part by name, 32 bytes each.
  end() {
    const whole = createHash("sha256").update(sceneHead(this.scene.header));
    const parts = Object.fromEntries(Array.from(this.hashes, ([name, hash]) => [name, hash.digest()]));
    for (const digest of Object.values(parts)) whole.update(digest);
    return { scene: whole.digest(), parts };
  }
}
