// The page: opens a file in the worker, draws the frames of the worker, and moves the camera.
import { around, facing, fitted, lensOf, look, moved, nearer, nearestFirst, orbit, poseOf, upOf } from "./camera.js";
import { Drawing } from "./draw.js";
import { Panel } from "./panel.js";
import { bytesOf } from "./text.js";

// Radians per pixel, the logarithmic distance factor of a wheel step, and scene radii per second.
const [TURN, WHEEL, FLY] = [0.006, 0.0012, 0.4];
// Frame times in milliseconds above which the image gets fewer pixels: while the camera moves, and until the networks
// have computed all Gaussians. Below the share QUICK of them it gets more.
const SLOW = { moving: 60, coming: 200 };
const [QUICK, SHARE_MIN] = [0.4, 0.1];
// Milliseconds without motion until all pixels are drawn again.
const STILL = 150;
// The most workers that decode: more would take memory, and few devices have more quick cores.
const MEMBERS_MAX = 4;
// The most Gaussians by default, on phones and tablets and on other devices.
const BUDGET = { small: 1_000_000, large: 4_000_000 };
// The most device pixels per CSS pixel: more are not visible.
const RATIO_MAX = 2;
// How often a lost device is taken again before a scene is drawn: the scene may be the reason.
const LOSSES_MAX = 3;
const KEYS = { KeyW: [2, 1], KeyS: [2, -1], KeyD: [0, 1], KeyA: [0, -1], KeyE: [1, -1], KeyQ: [1, 1] };

const byId = (id) => document.getElementById(id);

// The most Gaussians that are drawn: `budget` of the address, or what suits the device.
function budgetOf(search) {
  const asked = Number(new URLSearchParams(search).get("budget") || NaN);
  const isSmall = matchMedia("(pointer: coarse)").matches || navigator.deviceMemory < 4;
  return asked >= 0 ? Math.floor(asked) : BUDGET[isSmall ? "small" : "large"];
}

// Unpacks the bytes in an element of the page.
async function unpacked(id) {
  const stream = new Blob([bytesOf(byId(id).textContent)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function addressOf(part) {
  return URL.createObjectURL(new Blob([part]));
}

function save(download, href) {
  Object.assign(document.createElement("a"), { download, href }).click();
}

class Viewer {
  constructor(settings) {
    this.settings = settings;
    this.canvas = byId("canvas");
    this.panel = new Panel({
      choose: (number) => this.choose(number),
      slide: () => this.ask(),
      open: (file) => this.open({ input: file, name: file.name }),
      tools: { KeyP: () => this.#save(), KeyR: () => this.#back() },
    });
    this.drawing = new Drawing(this.canvas);
    this.pressed = new Set();
    this.pointers = new Map();
    Object.assign(this, { waiting: [], workers: [], losses: 0 });
    this.share = 1;
    this.#listen();
  }

  // Opens a file in place of the current one. input: bytes or a Blob. text: bytes in base64. url: its address, without
  // the others.
  async open(given) {
    const { input, text, url, name } = (this.given = given);
    this.#stop();
    // Callers that wait for the previous file wait for this one.
    const opening = (this.opening = {});
    Object.assign(this, { header: undefined, cameras: [], extent: undefined, name, touched: false });
    Object.assign(this, { view: 0, settled: undefined, arriving: false, refused: undefined });
    // The camera of the previous file does not apply to this one.
    Object.assign(this, { pose: undefined, lens: undefined, camera: undefined, number: undefined });
    this.panel.begin(name);
    this.drawing.clear();
    if (this.drawing.gl.isContextLost()) return this.on_refused({ kind: "lost" });
    try {
      this.wasm ??= await unpacked("wasm");
      // A page from a disk cannot load a worker from another file.
      this.code ??= URL.createObjectURL(new Blob([await unpacked("worker")], { type: "text/javascript" }));
      // Meanwhile another file may have been chosen, or the device lost.
      if (this.opening !== opening || this.refused !== undefined) return;
      const members = Math.max(1, Math.min(navigator.hardwareConcurrency, MEMBERS_MAX));
      this.workers = Array.from({ length: 1 + members }, () => new Worker(this.code));
    } catch (error) {
      if (this.opening !== opening) return;
      return this.on_refused({ kind: "fault", text: `This browser cannot begin: ${error.message}` });
    }
    const [worker, ...members] = this.workers;
    this.worker = worker;
    // Messages of a terminated worker may still arrive.
    const heard = (take) => (event) => this.worker === worker && take(event);
    worker.onmessage = heard(({ data }) => this[`on_${data.type}`](data));
    const failed = heard(({ message: text }) => this.on_refused({ kind: "fault", text }));
    for (const own of this.workers) own.onerror = failed;
    const ports = members.map((member) => {
      const { port1, port2: port } = new MessageChannel();
      member.postMessage({ type: "join", port }, [port]);
      return port1;
    });
    const budget = budgetOf(location.search);
    worker.postMessage({ type: "open", wasm: this.wasm, input, text, url, ports, budget }, ports);
  }

  // Ends the workers but some.
  #stop(kept = 0) {
    for (const worker of this.workers.splice(kept)) worker.terminate();
    if (kept === 0) this.worker = undefined;
  }

  on_head({ header, height, harmonics, members, left, ...about }) {
    this.#stop(1 + members);
    try {
      this.drawing.begin(header, height, harmonics);
    } catch (error) {
      return this.on_refused({ kind: "bound", text: error.message });
    }
    this.header = header;
    this.panel.left(left);
    this.#about(about);
  }

  #about({ cameras, metadata, length, parts }) {
    const photographs = this.settings.photographs.map((photograph) => ({ ...photograph, isPhotograph: true }));
    this.cameras = [...nearestFirst(cameras), ...photographs];
    this.up = upOf(this.header, cameras);
    this.panel.about(this.name, metadata, this.header, length, parts, this.cameras, this.#files(length));
  }

  // The file, and the scene in other formats if the page has it, with what saves them.
  #files(length) {
    const { input, text, url, beside = [] } = this.given;
    const name = this.name ?? "scene.c3gs";
    const own = { name, length, save: () => save(name, url ?? addressOf(input ?? bytesOf(text))) };
    return [own, ...beside.map((more) => ({ ...more, save: () => save(more.name, addressOf(bytesOf(more.text))) }))];
  }

  on_chunk({ anchors, middle, radius }) {
    this.panel.progress(anchors / this.header.anchor_count);
    if (radius !== undefined) this.#extend(middle, radius);
  }

  on_end({ middle = [0, 0, 0], radius = 1, ...about }) {
    this.#stop(1);
    this.#about(about);
    this.panel.progress(1);
    this.#extend(middle, radius);
  }

  #extend(middle, radius) {
    this.extent = { middle, radius };
    if (!this.touched) this.#start();
    this.ask();
  }

  async on_frame(frame) {
    const { worker } = this;
    await this.drawing.idle();
    if (this.worker !== worker) return;
    this.drawing.take(frame);
    worker.postMessage({ type: "taken" });
    this.arriving = frame.arriving;
    if (frame.id === this.view && frame.settled) this.settled = frame.id;
    this.ask();
  }

  // After an error, the chunks before it are not a complete scene.
  on_refused({ type, error, ...reason }) {
    this.#stop();
    this.refused = error ?? reason;
    this.drawing.clear();
    this.panel.refuse(this.name, error, reason);
    this.#tell();
  }

  // Opens the file again, with the camera of before.
  #restore() {
    const { given, pose, lens, camera, number } = this;
    this.drawing = new Drawing(this.canvas);
    if (given === undefined) return this.panel.wait();
    this.open(given);
    if (pose === undefined) return;
    Object.assign(this, { pose, lens, camera, number, touched: true });
    this.changed();
  }

  // The first camera, or one that looks at the scene from above. The extent of the scene may grow later.
  #start() {
    if (this.cameras.length > 0) this.choose(0, true);
    else this.#stand(around(this.extent, this.up));
  }

  #stand({ lens, pose }, camera) {
    Object.assign(this, { lens, pose, camera });
    this.changed();
  }

  // Goes to a camera of the list, by its number.
  choose(number, untouched = false) {
    if (this.extent === undefined || this.cameras.length === 0) return;
    const camera = this.cameras.at(number % this.cameras.length);
    this.touched ||= !untouched;
    this.number = this.cameras.indexOf(camera);
    this.#stand({ lens: lensOf(camera), pose: poseOf(camera, this.extent) }, camera);
    this.panel.chosen(this.number);
  }

  // Sets a new pose, or without one marks the camera as changed.
  changed(pose) {
    if (pose !== undefined) Object.assign(this, { pose, camera: undefined, touched: true });
    this.stale = true;
    this.movedAt = performance.now();
    this.ask();
  }

  ask() {
    this.asked ??= this.#idle().then(() => requestAnimationFrame((time) => this.#tick(time)));
  }

  async #idle() {
    await this.drawing.idle();
    const { took } = this.drawing;
    // A device that draws slowly takes Gaussians for as long as an image takes.
    if (this.arriving && took > SLOW.moving) await new Promise((resolve) => setTimeout(resolve, took));
  }

  #tick(time) {
    this.asked = undefined;
    const passed = time - (this.last ?? time);
    this.last = time;
    if (this.pose !== undefined) this.#fly(Math.min(passed, 200) / 1000);
    if (this.stale && this.header !== undefined && this.pose !== undefined) this.#send();
    // The user may continue to drag.
    const isHeld = this.pointers.size > 0;
    const moving = isHeld || time - this.movedAt < STILL;
    const state = moving ? "moving" : this.settled === this.view ? "still" : "coming";
    // The interval of consecutive frames is the frame time.
    if (state !== "still" && passed > 0) this.#adapt(passed, SLOW[state]);
    this.draw(state === "still" ? 1 : this.share);
    if (moving && !isHeld && this.share < 1) {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.ask(), STILL);
    }
    if (state === "still") this.last = undefined;
    if (this.pressed.size > 0) this.ask();
  }

  #adapt(passed, slow) {
    // The time is at most proportional to the pixels. With frames of seconds, small steps would take minutes.
    if (passed > slow) this.share = Math.max(SHARE_MIN, Math.min(0.8, Math.sqrt(slow / passed)) * this.share);
    else if (passed < QUICK * slow) this.share = Math.min(1, 1.1 * this.share);
  }

  #fly(seconds) {
    if (this.pressed.size === 0) return;
    const way = [0, 0, 0];
    for (const code of this.pressed) way[KEYS[code][0]] += KEYS[code][1];
    const length = FLY * this.extent.radius * seconds * (this.fast ? 4 : 1);
    this.changed(moved(this.pose, way.map((x) => x * length)));
  }

  #send() {
    this.stale = false;
    this.view++;
    const { rotation, centre } = this.pose;
    this.worker?.postMessage({ type: "view", id: this.view, rotation, centre, slope: this.#slope() });
  }

  // The largest slope from the axis of the camera at which Gaussians may be drawn: in the window, and in its own image.
  #slope() {
    // Three deviations of the filter, with the fewest pixels.
    const blur = (3.4 * Math.sqrt(this.header.low_pass)) / SHARE_MIN;
    const lenses = [this.lens, fitted(this.lens, [innerWidth, innerHeight]).lens];
    return Math.max(...lenses.map(({ width, height, focal, principal_point: [x, y] }) => {
      return Math.hypot((Math.max(x, width - x) + blur) / focal[0], (Math.max(y, height - y) + blur) / focal[1]);
    }));
  }

  draw(share) {
    if (this.header === undefined || this.pose === undefined || this.refused !== undefined) return;
    const { canvas } = this;
    const ratio = Math.min(devicePixelRatio, RATIO_MAX);
    const [wide, high] = [innerWidth, innerHeight].map((side) => Math.max(1, Math.round(side * ratio)));
    if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
    const { lens, left, top, scale } = fitted(this.lens, [wide, high]);
    this.drawing.draw(this.pose, lens, share);
    const box = [left, top, this.lens.width * scale, this.lens.height * scale].map((side) => side / ratio);
    this.panel.photograph(this.camera?.isPhotograph ? this.camera : undefined, box);
    if (this.settled !== undefined && this.settled === this.view) {
      this.losses = 0;
      this.panel.done();
    }
    this.#tell();
  }

  // Resolves once the whole file is drawn for the camera at hand. Rejects if the file is rejected.
  settle() {
    return new Promise((resolve, reject) => {
      this.waiting.push({ resolve, reject });
      this.#tell();
      this.ask();
    });
  }

  #tell() {
    const whole = !this.stale && this.settled !== undefined && this.settled === this.view;
    if (this.refused === undefined && !whole) return;
    const error = this.refused && new Error(JSON.stringify(this.refused));
    for (const { resolve, reject } of this.waiting.splice(0)) error ? reject(error) : resolve();
  }

  // The image of a camera in its own size, as the address of a PNG file. camera: a StatedCamera of the decoder.
  async picture(camera) {
    const pose = poseOf(camera, this.extent);
    this.#stand({ lens: lensOf(camera), pose });
    this.touched = true;
    await this.settle();
    return this.#png(camera.width, camera.height, pose, this.lens);
  }

  #png(width, height, pose, lens) {
    const image = Object.assign(document.createElement("canvas"), { width, height });
    const pixels = this.drawing.pixels(width, height, pose, lens);
    image.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
    return image.toDataURL("image/png");
  }

  #save() {
    if (this.pose === undefined) return;
    const { width, height } = this.canvas;
    const download = `${(this.name ?? "scene").replace(/\.c3gs$/, "")}.png`;
    const href = this.#png(width, height, this.pose, fitted(this.lens, [width, height]).lens);
    save(download, href);
  }

  #listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
    });
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    const released = (event) => {
      this.pointers.delete(event.pointerId);
      this.movedAt = performance.now();
      this.ask();
    };
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, released);
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextlost", (event) => {
      // Otherwise the device does not return.
      if (this.losses++ < LOSSES_MAX) event.preventDefault();
      this.on_refused({ kind: "lost" });
    });
    canvas.addEventListener("webglcontextrestored", () => this.#restore());
    const wheel = (event) => {
      event.preventDefault();
      if (this.pose === undefined) return;
      const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
      this.changed(nearer(this.pose, Math.exp(WHEEL * lines * event.deltaY)));
    };
    canvas.addEventListener("wheel", wheel, { passive: false });
    canvas.addEventListener("dblclick", (event) => this.#focus(event));
    addEventListener("resize", () => this.changed());
    addEventListener("keydown", (event) => this.#key(event));
    addEventListener("keyup", (event) => {
      this.fast = event.shiftKey;
      this.pressed.delete(event.code);
    });
    addEventListener("blur", () => this.pressed.clear());
    this.#listenToFiles();
  }

  #drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (before === undefined || this.pose === undefined) return;
    this.pointers.set(event.pointerId, event);
    const [x, y] = [event.clientX - before.clientX, event.clientY - before.clientY];
    const scale = fitted(this.lens, [innerWidth, innerHeight]).scale;
    const [across, down] = this.lens.focal.map((focal) => this.pose.pivot / (focal * scale));
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers.values()].filter(({ pointerId }) => pointerId !== event.pointerId);
      const distance = ({ clientX, clientY }) => Math.hypot(clientX - other.clientX, clientY - other.clientY);
      // Each of two fingers contributes half of the motion.
      const pose = moved(this.pose, [(-x * across) / 2, (-y * down) / 2, 0]);
      this.changed(nearer(pose, Math.max(distance(before), 1) / Math.max(distance(event), 1)));
    } else if (event.buttons & 2 || event.shiftKey) {
      this.changed(moved(this.pose, [-x * across, -y * down, 0]));
    } else {
      const turn = this.pressed.size > 0 ? look : orbit;
      this.changed(turn(this.pose, this.up, [-TURN * x, -TURN * y]));
    }
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || this.panel.isAsked) return;
    if (event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement) return;
    this.fast = event.shiftKey;
    const { code } = event;
    if (code in this.panel.tools) {
      if (!event.repeat) this.panel.tools[code]();
    } else if (this.pose === undefined) return;
    else if (code in KEYS) {
      this.pressed.add(code);
      this.ask();
    } else if (code === "ArrowRight") this.choose((this.number ?? -1) + 1);
    else if (code === "ArrowLeft") this.choose((this.number ?? 0) - 1);
    else return;
    event.preventDefault();
  }

  // Returns to the camera, or without one to a view of the whole scene.
  #back() {
    if (this.pose === undefined) return;
    if (this.cameras.length > 0) this.choose(this.number ?? 0);
    else this.#stand(around(this.extent, this.up));
  }

  // Turns to the point at a place of the page, which becomes the pivot. Only the worker knows its distance.
  #focus({ clientX, clientY }) {
    if (this.pose === undefined) return;
    const { focal, principal_point: middle } = fitted(this.lens, [innerWidth, innerHeight]).lens;
    const way = [(clientX - middle[0]) / focal[0], (clientY - middle[1]) / focal[1], 1];
    const { centre } = this.pose;
    const { centre: direction } = moved({ ...this.pose, centre: [0, 0, 0] }, way);
    this.worker?.postMessage({ type: "pick", centre, direction });
  }

  on_picked({ point }) {
    this.changed(facing(this.pose, point));
  }

  #listenToFiles() {
    for (const name of ["dragover", "dragleave", "drop"]) {
      addEventListener(name, (event) => {
        event.preventDefault();
        document.body.classList.toggle("over", name === "dragover");
        if (name === "drop") this.panel.take(event.dataTransfer.files);
      });
    }
  }
}

function start() {
  const settings = JSON.parse(byId("settings").textContent);
  let viewer;
  try {
    viewer = new Viewer(settings);
  } catch (error) {
    return new Panel({}).refuse(settings.name, undefined, { kind: "fault", text: error.message });
  }
  globalThis.c3gs = viewer;
  const scene = byId("scene").textContent.trim();
  byId("scene").remove();
  const asked = new URLSearchParams(location.search).get("file") ?? settings.url;
  if (scene !== "") viewer.open({ text: scene, name: settings.name, beside: settings.beside });
  else if (asked !== null) openAt(viewer, asked, settings);
  else viewer.panel.wait();
}

function openAt(viewer, asked, settings) {
  let url;
  try {
    url = new URL(asked, location.href);
  } catch {
    return viewer.on_refused({ kind: "fault", text: `${asked} is no address of a file` });
  }
  viewer.open({ url: url.href, name: settings.url === asked ? settings.name : url.pathname.split("/").pop() });
}

start();
