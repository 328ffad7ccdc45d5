// SPEC 7.2, 5.8, 5.9, 7.13 and B.5: integer networks, and the section WGTS.

import { SCALE_MIN, Substream, check, clamp, field, largest, range, rshiftRound, struct, sum } from "./coder.mjs";

const ACTIVATION_MAX = 1023, WEIGHT_MAX = 1023, ACCUMULATOR_BOUND = 2 ** 24, EXPONENT_MAX = 20;
const WEIGHT_SYMBOL_MAX = 2 ** 24 - 1, WEIGHT_EXPONENT_MIN = -104, WEIGHT_EXPONENT_MAX = 149;
const VIEW_DEPENDENT = 0;

export const activation = (a) => clamp(a, -ACTIVATION_MAX, ACTIVATION_MAX);

// SPEC 5.8: the networks in file order, each with the (outputs, inputs) of its layers
export function shapesOf(d) {
  const features = sum(d.slices), inputs = features + d.view_inputs, k = d.offset_count;
  const layers = (...widths) => widths.slice(1).map((outputs, i) => [outputs, widths[i]]);
  const carm = (i) => layers(sum(d.slices.slice(0, i)), ...d.carm_width, 2 * d.slices[i]);
  return Object.fromEntries([
    ["hyper", layers(2 * (d.plane_channels + d.frequency_count), ...d.hyper_width, 2 * (features + 6 + 3 * k) + 3)],
    ...(d.plane_channels ? [["sarm", layers(4, ...d.sarm_width, 2)]] : []),
    ...range(d.slices.length).slice(1).map((i) => [`carm.${i}`, carm(i)]),
    ["opacity", layers(inputs, d.render_width, k)],
    ["covariance", layers(inputs, d.render_width, 7 * k)],
    ["colour", layers(inputs, d.render_width, d.colour_outputs * k)],
  ]);
}

export function checkShapes({ dimensions, networks }) {
  const shapes = shapesOf(dimensions), names = Object.keys(shapes);
  check(Object.keys(networks).join() === names.join(), `networks are ${Object.keys(networks)}, not ${names} (5.8)`);
  for (const name of names) {
    const found = networks[name].map(({ weight, bias }) => [bias.length, ...new Set(weight.map((row) => row.length))]);
    const same = JSON.stringify(found) === JSON.stringify(shapes[name]);
    check(same, `layers of ${name} have (outputs, inputs) of ${found}, not ${shapes[name]} (5.8)`);
  }
}

// --- SPEC 7.2 -------------------------------------------------------------------------------------------------------

// Exact, for an f32 has 24 bits and a double 53.
const roundScaled = (x, e) => Math.floor(x * 2 ** e + 0.5);

// DERIVE_ROW
function deriveRow(weights, bias) {
  for (let e = EXPONENT_MAX; e >= 0; e--) {
    const w = weights.map((x) => roundScaled(x, e)), b = roundScaled(bias, e), sizes = w.map(Math.abs);
    const worst = sum(sizes) * ACTIVATION_MAX + Math.abs(b) + ((1 << e) >> 1);
    if (largest(sizes) <= WEIGHT_MAX && worst < ACCUMULATOR_BOUND) return { w, b, e };
  }
  throw new Error("a row of an integer network has no exponent [R6.8-4]: make its weights smaller (B.5)");
}

const deriveLayer = ({ weight, bias }) => bias.map((b, row) => deriveRow(weight[row], b));

// The rows of the integer networks, which the rendering networks are not in a view-dependent scene
export function deriveNetworks({ networks, render_info: { render_model: model } }) {
  const whole = Object.entries(networks).filter(([name]) => model !== VIEW_DEPENDENT || isEntropyModel(name));
  return Object.fromEntries(whole.map(([name, layers]) => [name, layers.map(deriveLayer)]));
}

// NETWORK
export function network(layers, inputs) {
  layers.forEach((rows, number) => {
    inputs = rows.map(({ w, b, e }) => {
      let t = b;
      for (let i = 0; i < w.length; i++) t += w[i] * inputs[i];
      t = rshiftRound(t, e);
      return number === layers.length - 1 ? t : clamp(t, 0, ACTIVATION_MAX);
    });
  });
  return inputs;
}

// --- SPEC 7.13, B.5: packing ----------------------------------------------------------------------------------------

export const isEntropyModel = (name) => /^(hyper|sarm|carm)/.test(name);

// SPEC B.5: the integers of 7.2 as weights, which changes no symbol. `+ 0` turns -0, which cannot be packed, into +0.
export function onGrid(layer) {
  const rows = deriveLayer(layer);
  return { weight: rows.map(({ w, e }) => w.map((x) => x / 2 ** e + 0)), bias: rows.map(({ b, e }) => b / 2 ** e + 0) };
}

// SPEC 7.13, [R6.8-8], B.5: the exponent of the LayerModel and the integers of a layer, or null if it cannot be packed
function packLayer({ weight, bias }) {
  const rows = bias.map((b, row) => [...weight[row], b]);
  const least = rows.map((row) => {
    let e = row.some((x) => x !== 0) ? -128 : null; // a row of zeros has none of its own
    while (e !== null && !row.every((x) => Number.isInteger(x * 2 ** e))) e++;
    return e;
  });
  const exponent = least.find((e) => e !== null) ?? 0, exponents = [exponent];
  for (const e of least) exponents.push(e ?? exponents.at(-1));
  const integers = rows.map((row, i) => row.map((x) => x * 2 ** exponents[i + 1]));
  const packs = exponents.every((e) => e >= WEIGHT_EXPONENT_MIN && e <= WEIGHT_EXPONENT_MAX)
    && integers.flat().every((n) => Math.abs(n) <= WEIGHT_SYMBOL_MAX && !Object.is(n, -0));
  return !packs ? null : {
    exponent,
    differences: exponents.slice(1).map((e, i) => e - exponents[i]),
    weights: integers.flatMap((row) => row.slice(0, -1)),
    biases: integers.map((row) => row.at(-1)),
  };
}

// SPEC B.5: the scale indices of grid exponents, weights and biases, less SCALE_MIN as in a LayerModel (5.9)
function chooseScales({ differences, weights, biases }) {
  const index = (scale) => clamp(Math.round(8 * Math.log2(scale)) - SCALE_MIN, 0, 255); // 0 if the scale is 0
  const mean = (list) => sum(list.map(Math.abs)) / Math.max(list.length, 1);
  return [index(mean(differences)), index(Math.sqrt(mean(weights.map((n) => n * n)))), index(mean(biases))];
}

// SPEC 5.8: (mode, content)
export function weightsSection(scene, tables) {
  const { networks, carm_shift: carmShift, weight_scales: scales, weight_forms: forms } = scene;
  const layers = Object.values(networks).flat(), few = [[], []], many = [[], []];
  const parts = [struct(field("u8", [scene.plane_shift, carmShift.length, carmShift]))];
  layers.forEach((layer, i) => {
    const packed = scales === null || forms?.[i] === 0 ? null : packLayer(layer);
    check(packed || !forms?.[i], `layer ${i} cannot be packed (B.5): make its form 0`);
    if (packed) {
      const [exponentScale, weightScale, biasScale] = scales?.[i] ?? chooseScales(packed);
      const u8 = (...values) => field("u8", values);
      parts.push(struct(u8(1, exponentScale), field("i16", packed.exponent), u8(weightScale, biasScale)));
      const add = ([parameters, symbols], scale, integers) => integers.forEach((n) => {
        parameters.push([0, SCALE_MIN + scale]);
        symbols.push(n);
      });
      add(few, exponentScale, packed.differences);
      add(few, biasScale, packed.biases);
      add(many, weightScale, packed.weights);
    } else {
      if (scales !== null) parts.push(field("u8", new Array(8).fill(0)));
      parts.push(field("f32", [layer.weight, layer.bias]));
    }
  });
  if (scales === null) return [0, Buffer.concat(parts)];
  const stream = new Substream(scene.lanes_log2.attribute);
  stream.values(tables.laplace, ...few, WEIGHT_SYMBOL_MAX);
  stream.values(tables.gauss, ...many, WEIGHT_SYMBOL_MAX);
  return [1, Buffer.concat([...parts, stream.bytes()])];
}
