// Static scenes in glTF by KHR_gaussian_splatting_compression_c3gs (spec/gltf), and a plugin of the GLTFLoader of
// three.js, which the page provides. gltf.d.ts documents them.
import { checkBounds } from "./bounds.js";
import { decode } from "./c3gs.js";
import { splatWidth } from "./container.js";

const BASE = "KHR_gaussian_splatting";
const NAME = `${BASE}_compression_c3gs`;
const FLOAT = 5126;
// The largest f32. An accessor holds finite numbers only.
const LARGEST = (2 - 2 ** -23) * 2 ** 127;
// The colour spaces of the base extension by transfer_characteristics, with any of these colour_primaries (6.5).
const PRIMARIES = [1, 2];
const SPACES = { 2: "srgb_rec709_display", 8: "lin_rec709_display", 13: "srgb_rec709_display" };

// The names of the attributes in order, and the parts of each. harmonics: 1, 4, 9 or 16.
function widthsOf(harmonics) {
  const widths = { POSITION: 3, [`${BASE}:ROTATION`]: 4, [`${BASE}:SCALE`]: 3, [`${BASE}:OPACITY`]: 1 };
  for (let degree = 0; degree ** 2 < harmonics; degree++) {
    for (let i = 0; i <= 2 * degree; i++) widths[`${BASE}:SH_DEGREE_${degree}_COEF_${i}`] = 3;
  }
  return widths;
}

// Sets the attributes of some Gaussians of 9.4, from Gaussian `first` on. Finite means and harmonics keep their bits.
function fill(attributes, { count, means, logLengths, quaternions, logits, harmonics }, first) {
  const [position, rotation, scale, opacity, ...colours] = Object.values(attributes);
  means.forEach((x, i) => (position[3 * first + i] = Math.min(Math.max(x, -LARGEST), LARGEST)));
  logLengths.forEach((x, i) => (scale[3 * first + i] = Math.min(Math.exp(x), LARGEST)));
  logits.forEach((x, i) => (opacity[first + i] = 1 / (1 + Math.exp(-x))));
  for (let i = 0; i < count; i++) {
    const w = quaternions[4 * i], x = quaternions[4 * i + 1], y = quaternions[4 * i + 2], z = quaternions[4 * i + 3];
    const length = Math.sqrt(w * w + x * x + y * y + z * z);
    for (let at = 0; at < 4; at++) rotation[4 * (first + i) + at] = quaternions[4 * i + ((at + 1) & 3)] / length;
    colours.forEach((colour, n) => {
      const from = 3 * (colours.length * i + n);
      for (let c = 0; c < 3; c++) colour[3 * (first + i) + c] = harmonics[from + c];
    });
  }
}

export async function decodeAttributes(input, options = {}) {
  const chunks = decode(input, options);
  let found, first = 0;
  for (;;) {
    const { value, done } = await chunks.next();
    const { header } = value.scene;
    if (found === undefined) {
      // Throws RenderModelError for another render model.
      if (header.render_model !== 1) value.scene.splat(value);
      let count = 0;
      for (const { kept } of value.scene.entries()) count += kept;
      // The Gaussians of the last two chunks may still be there when those of the next one are.
      const last = 2 * header.offset_count * Math.min(header.chunk_size, header.anchor_count);
      checkBounds(options, header, 0, 4 * splatWidth(header) * (count + last));
      const widths = Object.entries(widthsOf(header.colour_outputs / 3));
      const attributes = widths.map(([name, width]) => [name, new Float32Array(width * count)]);
      found = { header, count, attributes: Object.fromEntries(attributes) };
    }
    if (done) return found;
    const splat = value.scene.splat(value);
    fill(found.attributes, splat, first);
    first += splat.count;
  }
}

const isCompressed = (name) => name === "POSITION" || name.startsWith(`${BASE}:`);

// Throws for a primitive that does not describe the Gaussians of its file.
function check({ attributes, extensions }, { header, attributes: decoded }) {
  const stated = Object.keys(attributes).filter(isCompressed);
  const names = Object.keys(decoded);
  const wrong = [...stated, ...names].find((name) => !stated.includes(name) || !names.includes(name));
  if (wrong !== undefined) throw new Error(`${wrong} must be in both the primitive and its C3GS file, or in neither`);
  const { colour_primaries: primaries, transfer_characteristics: transfer } = header;
  if (!PRIMARIES.includes(primaries) || SPACES[transfer] !== extensions[BASE].colorSpace) {
    throw new Error(`the C3GS file has colour_primaries ${primaries} and transfer_characteristics ${transfer}, ` +
      `which are not the colorSpace of the primitive, ${extensions[BASE].colorSpace}`);
  }
}

export class C3gsGltfPlugin {
  #parser;
  #options;
  // The decoded buffer views by number.
  #scenes = new Map();
  // For each buffer view that this plugin has added: what it stands for.
  #added = new Map();

  constructor(parser, options = {}) {
    this.name = NAME;
    this.#parser = parser;
    this.#options = options;
  }

  // Called by GLTFLoader before anything is loaded. Each accessor of a compressed attribute gets a buffer view of its
  // own, which loadBufferView fills.
  async beforeRoot() {
    const { json } = this.#parser;
    const taken = new Set();
    for (const primitive of (json.meshes ?? []).flatMap(({ primitives }) => primitives)) {
      const own = primitive.extensions?.[BASE]?.extensions?.[NAME];
      if (own === undefined) continue;
      for (const [name, number] of Object.entries(primitive.attributes)) {
        if (!isCompressed(name) || taken.has(number)) continue;
        const accessor = json.accessors[number];
        if (accessor.componentType !== FLOAT) throw new Error(`the accessor of ${name} must have float numbers`);
        const { count, type } = accessor;
        this.#added.set(json.bufferViews.length, { primitive, from: own.bufferView, name, count, type });
        Object.assign(accessor, { bufferView: json.bufferViews.length, byteOffset: 0, sparse: undefined });
        json.bufferViews.push({ byteLength: 0 });
        taken.add(number);
      }
    }
  }

  // Called by GLTFLoader for each buffer view. Null: it is an ordinary one.
  loadBufferView(index) {
    const added = this.#added.get(index);
    return added === undefined ? null : this.#column(added);
  }

  async #column({ primitive, from, name, count, type }) {
    const scene = await this.#scene(from);
    check(primitive, scene);
    const values = scene.attributes[name];
    const parts = { SCALAR: 1, VEC3: 3, VEC4: 4 }[type];
    if (count !== scene.count || values.length !== parts * count) {
      throw new Error(`the accessor of ${name} has ${count} ${type}, but the scene has ${scene.count} Gaussians`);
    }
    return values.buffer;
  }

  #scene(number) {
    if (!this.#scenes.has(number)) {
      const bytes = this.#parser.getDependency("bufferView", number);
      this.#scenes.set(number, bytes.then((data) => decodeAttributes(data, this.#options)));
    }
    return this.#scenes.get(number);
  }
}
