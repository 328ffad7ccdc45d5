// The digests of the canonical reconstruction (SPEC.md 9.3), chunk by chunk.
import { isStatic } from "./container.js";

const PARTS = ["positions", "masks", "planes", "features", "scalings", "offsets", "weights"];
// The parts of anchors.
const OF_ANCHORS = ["positions", "masks", "features", "scalings", "offsets"];
// The last part of a static scene (9.4).
const SPLAT = "splat";

export function partsOf(header) {
  return isStatic(header) ? [...PARTS, SPLAT] : PARTS;
}

export function anchorParts(header) {
  return isStatic(header) ? [...OF_ANCHORS, SPLAT] : OF_ANCHORS;
}

const ascii = (text) => Uint8Array.from(text, (letter) => letter.charCodeAt(0));
// 2.3
const u32 = (...values) => {
  const view = new DataView(new ArrayBuffer(4 * values.length));
  values.forEach((value, i) => view.setUint32(4 * i, value, true));
  return new Uint8Array(view.buffer);
};

// The first bytes of the digest input of a scene.
export function sceneHead({ anchor_count: count, drawn }) {
  return Uint8Array.of(...ascii("C3GSREC1"), ...u32(count), ...drawn);
}

// The first bytes of the digest input of a chunk.
function chunkHead(count, header, features) {
  return Uint8Array.of(...ascii("C3GSCHK1"), ...u32(count, header.offset_count, features));
}

export class Digests {
  constructor(kernel, scene) {
    this.parts = partsOf(scene.header);
    Object.assign(this, { kernel, scene, hashes: new Map(this.parts.map((name) => [name, kernel.makeHash()])) });
    kernel.addToHash(this.hashes.get("planes"), scene.planes);
    for (const { values } of scene.layers) kernel.addToHash(this.hashes.get("weights"), values);
  }

  // Adds the next chunk, and returns its digest. Its parts are in it by name.
  add(chunk) {
    const { header, features } = this.scene;
    const own = this.kernel.makeHash();
    this.kernel.addToHash(own, chunkHead(chunk.count, header, features));
    for (const name of anchorParts(header)) {
      this.kernel.addToHash(own, chunk[name]);
      this.kernel.addToHash(this.hashes.get(name), chunk[name]);
    }
    return this.kernel.endHash(own);
  }

  // Returns the digest of the scene, and of each part by name, 32 bytes each.
  end() {
    const parts = Object.fromEntries(this.parts.map((name) => [name, this.kernel.endHash(this.hashes.get(name))]));
    const whole = this.kernel.makeHash();
    this.kernel.addToHash(whole, sceneHead(this.scene.header));
    for (const name of this.parts) this.kernel.addToHash(whole, parts[name]);
    return { scene: this.kernel.endHash(whole), parts };
  }
}
