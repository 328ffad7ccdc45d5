// Draws Gaussians with WebGL 2, as in SPEC.md 14.4 and 14.5. Each is a rectangle around its ellipse. The farthest is
// drawn first.
//
// The image is blended in 16-bit floats if the device supports them. With 8 bits, faint Gaussians would be lost.
import { layersOf, TEXELS, UNIT_MAX, WIDTH } from "./rows.js";

// isStatic: whether the colours are in a texture of their own.
const vertex = (isStatic) => `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D gaussians, colours;
uniform mat3 rotation;
uniform vec3 centre;
uniform vec2 focal, principal, size;
uniform float lowPass;
layout(location = 0) in uint slot;
out vec2 at;
out vec4 paint;

void main() {
  ivec2 place = ivec2(int(slot % ${WIDTH}u) * ${TEXELS}, int(slot / ${WIDTH}u));
  vec4 mean = uintBitsToFloat(texelFetch(gaussians, place, 0));
  vec4 first = uintBitsToFloat(texelFetch(gaussians, place + ivec2(1, 0), 0));
  uvec4 last = texelFetch(gaussians, place + ivec2(2, 0), 0);
  vec2 second = uintBitsToFloat(last.xy);
  uvec2 colour = ${isStatic ? `texelFetch(colours, ivec2(int(slot % ${WIDTH}u), int(slot / ${WIDTH}u)), 0).xy` : "last.zw"};
  paint = vec4(float(colour.y >> 16) * vec3(unpackUnorm2x16(colour.x), unpackUnorm2x16(colour.y).x), mean.w);
  mat3 covariance = mat3(first.xyz, first.yw, second.x, first.z, second.xy);
  // 14.4, PROJECT. The matrix has the rows of the rotation, thus the transposed one transforms to the world.
  vec3 p = (mean.xyz - centre) * rotation;
  vec2 beyond = 0.15 * size / focal;
  vec2 slope = clamp(p.xy / p.z, -principal / focal - beyond, (size - principal) / focal + beyond);
  vec3 toX = rotation * vec3(focal.x / p.z, 0.0, -focal.x / p.z * slope.x);
  vec3 toY = rotation * vec3(0.0, focal.y / p.z, -focal.y / p.z * slope.y);
  float a = dot(toX, covariance * toX) + lowPass;
  float b = dot(toX, covariance * toY);
  float c = dot(toY, covariance * toY) + lowPass;
  // The axes of the ellipse, and the deviations along them.
  float half_ = (a - c) / 2.0;
  float root = length(vec2(half_, b));
  vec2 long_ = half_ >= 0.0 ? vec2(root + half_, b) : vec2(b, root - half_);
  long_ = root > 0.0 ? normalize(long_) : vec2(1.0, 0.0);
  float middle = (a + c) / 2.0;
  vec2 deviations = sqrt(vec2(middle + root, max(middle - root, max(lowPass, 1e-9))));
  // 14.5: an alpha below 1/255 counts as 0.
  float reach = sqrt(2.0 * log(max(255.0 * paint.w, 1.0)));
  at = reach * vec2(float(gl_VertexID & 1) * 2.0 - 1.0, float(gl_VertexID >> 1) * 2.0 - 1.0);
  vec2 pixel = focal * p.xy / p.z + principal
    + at.x * deviations.x * long_ + at.y * deviations.y * vec2(-long_.y, long_.x);
  vec2 position = 2.0 * pixel / size - 1.0;
  // Overflow, and Gaussians behind this camera that were not behind the camera of the sort.
  bool drawn = p.z > 0.0 && all(lessThan(abs(position), vec2(1e9)));
  gl_Position = drawn ? vec4(position.x, -position.y, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform float alphaMax;
in vec2 at;
in vec4 paint;
out vec4 result;

void main() {
  float alpha = min(paint.w * exp(-dot(at, at) / 2.0), alphaMax);
  if (alpha < 1.0 / 255.0) discard;
  result = vec4(alpha * paint.rgb, alpha);
}`;

// 14.6, HARMONICS
const HARMONICS = [
  "0.28209479177387814", "-0.4886025119029199 * y", "0.4886025119029199 * z", "-0.4886025119029199 * x",
  "1.0925484305920792 * x * y", "-1.0925484305920792 * y * z",
  "0.31539156525252005 * (2.0 * z * z - x * x - y * y)", "-1.0925484305920792 * x * z",
  "0.5462742152960396 * (x * x - y * y)", "-0.5900435899266435 * y * (3.0 * x * x - y * y)",
  "2.890611442640554 * x * y * z", "-0.4570457994644658 * y * (4.0 * z * z - x * x - y * y)",
  "0.3731763325901154 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)",
  "-0.4570457994644658 * x * (4.0 * z * z - x * x - y * y)", "1.445305721320277 * z * (x * x - y * y)",
  "-0.5900435899266435 * x * (x * x - 3.0 * y * y)",
];

// 14.6: the colour of each Gaussian of a static scene from the camera's centre, as in rows.js. count: of harmonics.
function shading(count) {
  const layers = layersOf(3 * count);
  const number = (at) => `t[${at >> 2}][${at & 3}]`;
  const term = (n) => `(${HARMONICS[n]}) * vec3(${[3 * n, 3 * n + 1, 3 * n + 2].map(number).join(", ")})`;
  return `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
precision highp sampler2DArray;
uniform usampler2D gaussians;
uniform sampler2DArray harmonics;
uniform vec3 centre;
out uvec2 result;

void main() {
  ivec2 place = ivec2(gl_FragCoord.xy);
  vec3 away = uintBitsToFloat(texelFetch(gaussians, ivec2(${TEXELS} * place.x, place.y), 0).xyz) - centre;
  float distance_ = length(away);
  vec3 direction = distance_ > 0.0 ? away / distance_ : vec3(0.0);
  float x = direction.x, y = direction.y, z = direction.z;
  vec4 t[${layers}];
  for (int i = 0; i < ${layers}; i++) t[i] = texelFetch(harmonics, ivec3(place, i), 0);
  vec3 colour = max(vec3(0.5) + ${HARMONICS.slice(0, count).map((_, n) => term(n)).join("\n    + ")}, 0.0);
  float unit = clamp(ceil(max(colour.r, max(colour.g, colour.b))), 1.0, ${UNIT_MAX}.0);
  uvec3 parts = uvec3(round(65535.0 * min(colour / unit, 1.0)));
  result = uvec2(parts.r | parts.g << 16, parts.b | uint(unit) << 16);
}`;
}

const COVERING = `#version 300 es
void main() {
  gl_Position = vec4(float(gl_VertexID & 1) * 4.0 - 1.0, float(gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

// 6.5: linear light is encoded with the sRGB transfer function. Other colours are displayed as they are.
const ENCODE = `#version 300 es
precision highp float;
uniform sampler2D blended;
uniform vec2 scale;
uniform bool linear;
out vec4 result;

void main() {
  vec3 c = clamp(texture(blended, gl_FragCoord.xy * scale).rgb, 0.0, 1.0);
  if (linear) c = mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
  result = vec4(c, 1.0);
}`;

// The transfer characteristics of linear light.
const LINEAR = 8;

export class Drawing {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false });
    if (gl === null) throw new Error("This browser has no WebGL 2, which draws the scene. Enable graphics acceleration, or use another browser");
    Object.assign(this, { canvas, gl, count: 0, target: undefined });
    const floats = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    this.format = floats ? gl.RGBA16F : gl.RGBA8;
    // By the number of harmonics, 0 if the scene is not static.
    this.programs = new Map();
    this.encoding = program(gl, COVERING, ENCODE);
    this.array = gl.createVertexArray();
    this.slots = gl.createBuffer();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.slots);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    this.none = gl.createVertexArray();
  }

  // header: background, alpha_max, low_pass, transfer_characteristics. height: rows of Gaussians. harmonics: their
  // numbers for each Gaussian of a static scene, otherwise 0. Throws RangeError if the device is out of memory.
  begin(header, height, harmonics) {
    const { gl } = this;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (height > most) throw new RangeError(`The scene has more Gaussians than this device draws, ${most * WIDTH}`);
    Object.assign(this, { header, height: Math.max(height, 1), layers: layersOf(harmonics), count: 0 });
    for (const old of [this.texture, this.harmonics, this.colours?.image]) gl.deleteTexture(old ?? null);
    gl.deleteFramebuffer(this.colours?.frame ?? null);
    Object.assign(this, { harmonics: undefined, colours: undefined, shaded: undefined });
    if (!this.programs.has(harmonics)) this.programs.set(harmonics, programs(gl, harmonics / 3));
    Object.assign(this, this.programs.get(harmonics));
    this.texture = texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, TEXELS * WIDTH, this.height);
    if (this.layers > 0) {
      this.harmonics = texture(gl, gl.NEAREST, gl.TEXTURE_2D_ARRAY);
      gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA16F, WIDTH, this.height, this.layers);
      this.colours = target(gl, gl.RG32UI, WIDTH, this.height);
    }
    if (gl.getError() === gl.OUT_OF_MEMORY) throw new RangeError("The device has no memory for the scene");
  }

  // Clears the canvas.
  clear() {
    const { gl } = this;
    this.count = 0;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  // Resolves once the device has done what it was asked for. Until then, a call might block the page.
  async idle() {
    const { gl } = this;
    const isBusy = () => gl.getSyncParameter(this.sync, gl.SYNC_STATUS) !== gl.SIGNALED && !gl.isContextLost();
    for (let rest = 4; this.sync && isBusy(); rest *= 1.1) await new Promise((resolve) => setTimeout(resolve, rest));
    // The milliseconds for the last image.
    if (this.begun !== undefined) [this.took, this.begun] = [performance.now() - this.begun, undefined];
  }

  #asked() {
    const { gl } = this;
    gl.deleteSync(this.sync ?? null);
    this.sync = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }

  // blocks: from Rows. order: the Gaussians in drawing order, unless it stays.
  take({ blocks, order }) {
    const { gl, layers } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    if (layers > 0) gl.bindTexture(gl.TEXTURE_2D_ARRAY, this.harmonics);
    for (const { slot, words, harmonics } of blocks) {
      const [column, row] = [slot % WIDTH, Math.floor(slot / WIDTH)];
      const [format, type] = [gl.RGBA_INTEGER, gl.UNSIGNED_INT];
      gl.texSubImage2D(gl.TEXTURE_2D, 0, TEXELS * column, row, words.length / 4, 1, format, type, words);
      if (layers === 0) continue;
      const count = harmonics.length / (4 * layers);
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, column, row, 0, count, 1, layers, gl.RGBA, gl.FLOAT, harmonics);
    }
    if (blocks.length > 0) this.shaded = undefined;
    if (order !== undefined) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.slots);
      gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
      this.count = order.length;
    }
    this.#asked();
  }

  // Computes the colours of a static scene, unless the camera has only turned.
  #shade(centre) {
    const { gl, shades, colours, height } = this;
    if (this.shaded?.every((x, axis) => x === centre[axis])) return;
    this.shaded = [...centre];
    gl.bindFramebuffer(gl.FRAMEBUFFER, colours.frame);
    gl.viewport(0, 0, WIDTH, height);
    gl.useProgram(shades.program);
    bind(gl, shades, { gaussians: [gl.TEXTURE_2D, this.texture], harmonics: [gl.TEXTURE_2D_ARRAY, this.harmonics] });
    gl.uniform3fv(shades.at("centre"), centre);
    gl.bindVertexArray(this.none);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Blends into an image of a size in pixels. pose: rotation, row by row, and centre. lens: focal and principal_point.
  #blend(width, height, { rotation, centre }, { focal, principal_point }) {
    const { gl, header, splats } = this;
    if (this.target?.width !== width || this.target?.height !== height) {
      if (this.target) {
        gl.deleteTexture(this.target.image);
        gl.deleteFramebuffer(this.target.frame);
      }
      this.target = target(gl, this.format, width, height, gl.LINEAR);
    }
    if (this.colours !== undefined && this.count > 0) this.#shade(centre);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.frame);
    gl.viewport(0, 0, width, height);
    const [red, green, blue] = header.background.map((value) => value / 255);
    gl.clearColor(red, green, blue, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (this.count === 0) return;
    gl.useProgram(splats.program);
    const own = { gaussians: [gl.TEXTURE_2D, this.texture] };
    if (this.colours !== undefined) own.colours = [gl.TEXTURE_2D, this.colours.image];
    bind(gl, splats, own);
    // GL expects columns, thus the shader gets the transposed matrix.
    gl.uniformMatrix3fv(splats.at("rotation"), false, rotation);
    gl.uniform3fv(splats.at("centre"), centre);
    gl.uniform2fv(splats.at("focal"), focal);
    gl.uniform2fv(splats.at("principal"), principal_point);
    gl.uniform2f(splats.at("size"), width, height);
    gl.uniform1f(splats.at("lowPass"), header.low_pass);
    gl.uniform1f(splats.at("alphaMax"), header.alpha_max);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
    gl.disable(gl.BLEND);
  }

  // Copies the blended image to a framebuffer of a size, or with null to the canvas.
  #encode(frame, width, height) {
    const { gl, encoding } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(0, 0, width, height);
    gl.useProgram(encoding.program);
    gl.bindTexture(gl.TEXTURE_2D, this.target.image);
    gl.uniform2f(encoding.at("scale"), 1 / width, 1 / height);
    gl.uniform1i(encoding.at("linear"), Number(this.header.transfer_characteristics === LINEAR));
    gl.bindVertexArray(this.none);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Draws to the canvas. share: the resolution of blending, relative to the canvas.
  draw(pose, lens, share = 1) {
    const { width, height } = this.canvas;
    const scaled = (values) => values.map((value) => value * share);
    const smaller = { focal: scaled(lens.focal), principal_point: scaled(lens.principal_point) };
    this.#blend(Math.ceil(width * share), Math.ceil(height * share), pose, smaller);
    this.#encode(null, width, height);
    this.begun = performance.now();
    this.#asked();
  }

  // Returns an image, as bytes of red, green, blue and 255, from the top row.
  pixels(width, height, pose, lens) {
    const { gl } = this;
    this.#blend(width, height, pose, lens);
    const { image, frame } = target(gl, gl.RGBA8, width, height);
    this.#encode(frame, width, height);
    const found = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, found);
    gl.deleteFramebuffer(frame);
    gl.deleteTexture(image);
    const turned = new Uint8ClampedArray(found.length);
    for (let row = 0; row < height; row++) {
      turned.set(found.subarray(4 * width * row, 4 * width * (row + 1)), 4 * width * (height - 1 - row));
    }
    return turned;
  }
}

function texture(gl, filter = gl.NEAREST, kind = gl.TEXTURE_2D) {
  const made = gl.createTexture();
  gl.bindTexture(kind, made);
  gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, filter);
  gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, filter);
  gl.texParameteri(kind, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return made;
}

// A texture to draw to, and its framebuffer.
function target(gl, format, width, height, filter) {
  const made = { width, height, image: texture(gl, filter), frame: gl.createFramebuffer() };
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, made.frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.image, 0);
  return made;
}

// Sets the samplers of the program in use. The first texture unit is active again afterwards.
function bind(gl, { at }, textures) {
  const list = Object.entries(textures);
  for (const [unit, [name, [kind, own]]] of [...list.entries()].reverse()) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, own);
    gl.uniform1i(at(name), unit);
  }
}

// The programs of a scene. count: of harmonics, 0 if it is not static.
function programs(gl, count) {
  if (count === 0) return { splats: program(gl, vertex(false), FRAGMENT) };
  return { splats: program(gl, vertex(true), FRAGMENT), shades: program(gl, COVERING, shading(count)) };
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) {
    const logs = gl.getAttachedShaders(made).map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(`the shaders do not compile: ${[gl.getProgramInfoLog(made), ...logs].join(" ")}`);
  }
  const places = new Map();
  const at = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(made, name));
    return places.get(name);
  };
  return { program: made, at };
}
