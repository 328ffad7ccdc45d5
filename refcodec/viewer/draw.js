// Draws Gaussians with WebGL 2, as in SPEC.md 14.4 and 14.5. Each is a rectangle around its ellipse. The farthest is
// drawn first.
//
// The image is blended in 16-bit floats if the device supports them. With 8 bits, faint Gaussians would be lost.
import { ROW_WORDS, TEXELS, WIDTH } from "./rows.js";

const VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform usampler2D gaussians;
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
  paint = vec4(float(last.w >> 16) * vec3(unpackUnorm2x16(last.z), unpackUnorm2x16(last.w).x), mean.w);
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
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    this.device = gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
    this.splats = program(gl, VERTEX, FRAGMENT);
    this.encoding = program(gl, COVERING, ENCODE);
    this.array = gl.createVertexArray();
    this.slots = gl.createBuffer();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.slots);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    this.none = gl.createVertexArray();
    this.texture = texture(gl);
  }

  // header: background, alpha_max, low_pass, transfer_characteristics. height: rows of Gaussians. Throws RangeError if
  // the device is out of memory.
  begin(header, height) {
    const { gl } = this;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (height > most) throw new RangeError(`The scene has more Gaussians than this device draws, ${most * WIDTH}`);
    Object.assign(this, { header, count: 0 });
    gl.deleteTexture(this.texture);
    this.texture = texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, TEXELS * WIDTH, Math.max(height, 1));
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

  // rows: their numbers. data: the rows in a sequence. order: the Gaussians in drawing order.
  take({ rows, data, order }) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    rows.forEach((row, i) => {
      gl.texSubImage2D(
        gl.TEXTURE_2D, 0, 0, row, TEXELS * WIDTH, 1, gl.RGBA_INTEGER, gl.UNSIGNED_INT, data, ROW_WORDS * i,
      );
    });
    gl.bindBuffer(gl.ARRAY_BUFFER, this.slots);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    this.count = order.length;
  }

  // Blends into an image of a size in pixels. pose: rotation, row by row, and centre. lens: focal and principal_point.
  #blend(width, height, { rotation, centre }, { focal, principal_point }) {
    const { gl, header, splats } = this;
    if (this.target?.width !== width || this.target?.height !== height) {
      if (this.target) {
        gl.deleteTexture(this.target.image);
        gl.deleteFramebuffer(this.target.frame);
      }
      this.target = { width, height, image: texture(gl, gl.LINEAR), frame: gl.createFramebuffer() };
      gl.texStorage2D(gl.TEXTURE_2D, 1, this.format, width, height);
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.frame);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.target.image, 0);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.frame);
    gl.viewport(0, 0, width, height);
    const [red, green, blue] = header.background.map((value) => value / 255);
    gl.clearColor(red, green, blue, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (this.count === 0) return;
    gl.useProgram(splats.program);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
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
  }

  // Returns an image, as bytes of red, green, blue and 255, from the top row.
  pixels(width, height, pose, lens) {
    const { gl } = this;
    this.#blend(width, height, pose, lens);
    const image = texture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, image, 0);
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

  // Waits until the device has finished drawing.
  finish() {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }
}

function texture(gl, filter = gl.NEAREST) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  return made;
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
