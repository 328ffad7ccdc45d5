// The weights of all networks, and the integers of the integer networks (SPEC.md 5.8, 5.9, 6.8, 7.2 and 7.13).
import { Cursor, carmInputs, isStatic, isZero, layers, pad4, RENDERING } from "./container.js";
import { errorOfCode, need } from "./errors.js";
import { power, roundScaled } from "./numbers.js";

// 2.5
const PLANE_SHIFT_MAX = 10;
const CARM_SHIFT_MAX = 16;
const WEIGHT_EXPONENT_MIN = -104;
const WEIGHT_EXPONENT_MAX = 149;
const ACTIVATION_MAX = 1023;
const WEIGHT_MAX = 1023;
const ACCUMULATOR_BOUND = 2 ** 24;
const EXPONENT_MAX = 20;

const MODEL_LENGTH = 8;

// [R6.8-1] to [R6.8-8] in the order of 10.1. data: the section. start: its offset. kernel: decodes packed weights.
//
// Returns planeShift, carmShift, `layers` with the values of each layer in file order, and for the kernel `coding` and
// `shapes`: the integers of the integer networks, layer by layer, and the numbers of outputs and inputs of each.
export function parseWeights(data, start, mode, header, kernel) {
  const inputs = carmInputs(header);
  const first = pad4(2 + inputs);
  need(first <= data.length, "weights.length", start);
  const [planeShift, count] = data;
  need(planeShift <= (header.plane_channels > 0 ? PLANE_SHIFT_MAX : 0), "weights.scale", start);
  need(count === inputs, "weights.scale", start + 1);
  const carmShift = data.slice(2, 2 + inputs);
  carmShift.forEach((shift, i) => need(shift <= CARM_SHIFT_MAX, "weights.scale", start + 2 + i));
  need(isZero(data, 2 + inputs, first), "weights.padding", start + 2 + inputs);
  const list = layers(header).map((layer) => ({ ...layer, form: 0, values: undefined }));
  if (mode === 0) readRaw(list, data, first, start);
  else readPacked(list, data, first, start, header, kernel);
  return { planeShift, carmShift, layers: list, ...derive(list, mode, header) };
}

// A copy of the layer values, bit for bit
function rawValues(data, at, length) {
  return new Float32Array(data.slice(at, at + 4 * length).buffer);
}

// [R6.8-3]; at: the offset of the first value
function checkFinite(values, at) {
  const wrong = values.findIndex((value) => !Number.isFinite(value));
  need(wrong < 0, "weights.not_finite", at + 4 * wrong);
}

function readRaw(list, data, first, start) {
  let at = first;
  for (const layer of list) {
    layer.at = start + at;
    layer.values = rawValues(data, at, layer.outputs * (layer.inputs + 1));
    checkFinite(layer.values, layer.at);
    at += layer.values.byteLength;
  }
}

function readPacked(list, data, first, start, header, kernel) {
  let at = first;
  for (const layer of list) {
    need(at + MODEL_LENGTH <= data.length, "weights.length", start);
    layer.at = start + at;
    Object.assign(layer, parseModel(data.subarray(at, at + MODEL_LENGTH), layer.at));
    at += MODEL_LENGTH;
    if (layer.form === 1) continue;
    const length = layer.outputs * (layer.inputs + 1);
    need(at + 4 * length <= data.length, "weights.length", start);
    layer.values = rawValues(data, at, length);
    at += 4 * length;
  }
  unpack(list.filter(({ form }) => form === 1), data.subarray(at), start + at, header, kernel);
  for (const layer of list) {
    if (layer.form === 0) checkFinite(layer.values, layer.at + MODEL_LENGTH);
    // [R6.8-8]
    else need(layer.values !== undefined, "weights.exponent", layer.at);
  }
}

// [R6.8-6] and [R6.8-7]
function parseModel(data, at) {
  const c = new Cursor(data, at);
  const model = { form: c.u8("form"), exponentScale: c.u8("exponentScale"), exponent: c.i16("exponent") };
  Object.assign(model, { weightScale: c.u8("weightScale"), biasScale: c.u8("biasScale") });
  need(isZero(data, 6, MODEL_LENGTH), "weights.reserved", at + 6);
  need(model.form <= 1, "weights.layer", at);
  const within = model.exponent >= WEIGHT_EXPONENT_MIN && model.exponent <= WEIGHT_EXPONENT_MAX;
  need(within, "weights.layer", c.at.exponent);
  for (const name of ["exponentScale", "exponent", "weightScale", "biasScale"]) {
    need(model.form === 1 || model[name] === 0, "weights.layer", c.at[name]);
  }
  return model;
}

// 7.13: sets the values of the packed layers, or leaves them undefined if an exponent is invalid
function unpack(packed, bytes, start, header, kernel) {
  const rows = packed.reduce((sum, { outputs }) => sum + outputs, 0);
  const weights = packed.reduce((sum, { outputs, inputs }) => sum + outputs * inputs, 0);
  const scales = new Uint8Array(2 * rows + weights);
  let [few, many] = [0, 2 * rows];
  for (const { outputs, inputs, exponentScale, biasScale, weightScale } of packed) {
    scales.fill(exponentScale, few, few + outputs).fill(biasScale, few + outputs, few + 2 * outputs);
    scales.fill(weightScale, many, many + outputs * inputs);
    few += 2 * outputs;
    many += outputs * inputs;
  }
  const { status, symbols } = kernel.decodeWeights(bytes, 1 << header.attribute_lanes_log2, scales, 2 * rows);
  if (status !== 0) throw errorOfCode(status, start);
  [few, many] = [0, 2 * rows];
  for (const layer of packed) {
    const { outputs, inputs } = layer;
    const differences = symbols.subarray(few, few + outputs);
    const biases = symbols.subarray(few + outputs, few + 2 * outputs);
    layer.values = packedLayer(layer, differences, symbols.subarray(many, many + outputs * inputs), biases);
    few += 2 * outputs;
    many += outputs * inputs;
  }
}

// PACKED_LAYER: values from integers, or undefined if an exponent is invalid
function packedLayer({ outputs, inputs, exponent }, differences, weights, biases) {
  const values = new Float32Array(outputs * (inputs + 1));
  let e = exponent;
  let first = true;
  for (let r = 0; r < outputs; r++) {
    e += differences[r];
    let all = biases[r];
    for (let i = 0; i < inputs; i++) all |= weights[r * inputs + i];
    const within = e >= WEIGHT_EXPONENT_MIN && e <= WEIGHT_EXPONENT_MAX;
    // The last bit is the parity of negative integers too.
    if (!within || (all !== 0 && (all & 1) === 0) || (differences[r] !== 0 && (all === 0 || first))) return undefined;
    first = first && all === 0;
    // Exact: a multiple of 2^-149 with at most 24 bits.
    const unit = power(-e);
    for (let i = 0; i < inputs; i++) values[r * inputs + i] = weights[r * inputs + i] * unit;
    values[outputs * inputs + r] = biases[r] * unit;
  }
  return first && exponent !== 0 ? undefined : values;
}

// [R6.8-4] and 7.2. The kernel ignores the rendering networks of a static scene, which are last.
function derive(list, mode, header) {
  const coded = list.filter(({ network }) => isStatic(header) || !RENDERING.includes(network));
  const rows = coded.reduce((sum, { outputs }) => sum + outputs, 0);
  const weights = coded.reduce((sum, { outputs, inputs }) => sum + outputs * inputs, 0);
  const coding = { weight: new Int16Array(weights), bias: new Int32Array(rows), exponent: new Uint8Array(rows) };
  let [row, at] = [0, 0];
  for (const layer of coded) {
    const { outputs, inputs, values } = layer;
    for (let r = 0; r < outputs; r++, row++, at += inputs) {
      const own = values.subarray(r * inputs, (r + 1) * inputs);
      const right = deriveRow(own, values[outputs * inputs + r], coding, row, at);
      need(right, "weights.bound", layer.at + (mode === 0 ? 4 * r * Math.max(inputs, 1) : 0));
    }
  }
  return { coding, shapes: Int32Array.from(coded.flatMap(({ outputs, inputs }) => [outputs, inputs])) };
}

// DERIVE_ROW: writes a row's integers, and returns whether it has an exponent
function deriveRow(weights, bias, coding, row, at) {
  const largest = weights.reduce((most, w) => Math.max(most, Math.abs(w)), 0);
  for (let e = EXPONENT_MAX; e >= 0; e--) {
    const unit = power(e);
    // The least magnitude of a rounded number.
    if (Math.ceil(largest * unit - 0.5) > WEIGHT_MAX) continue;
    let most = 0;
    let sum = 0;
    for (let i = 0; i < weights.length; i++) {
      const w = roundScaled(weights[i], unit);
      coding.weight[at + i] = w;
      most = Math.max(most, Math.abs(w));
      sum += Math.abs(w);
    }
    const b = roundScaled(bias, unit);
    const worst = sum * ACTIVATION_MAX + Math.abs(b) + Math.floor(unit / 2);
    if (most <= WEIGHT_MAX && worst < ACCUMULATOR_BOUND) {
      coding.bias[row] = b;
      coding.exponent[row] = e;
      return true;
    }
  }
  return false;
}

