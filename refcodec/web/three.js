// A loader of C3GS files for three.js, which the page provides. three.d.ts documents it.
import { Box3, Color, Loader, MathUtils, Matrix4, PerspectiveCamera, Quaternion, Vector3 } from "three";
import { cameraMatrix, centreOf, decode, Gaussians, uprightMatrix } from "./c3gs.js";

// Returns the camera of three.js with the view of a camera of the file.
function perspective(stated, near, bounds) {
  const { width, height, focal, principal_point: middle } = stated;
  const matrix = new Matrix4().fromArray(cameraMatrix(stated));
  const place = new Vector3().setFromMatrixPosition(matrix);
  const corner = bounds.isEmpty() ? place : bounds.getCenter(new Vector3());
  // Gaussians reach beyond the positions of their anchors.
  const far = 2 * (place.distanceTo(corner) + bounds.getSize(new Vector3()).length()) + 2 * near;
  const fov = 2 * MathUtils.RAD2DEG * Math.atan(height / (2 * focal[1]));
  const camera = new PerspectiveCamera(fov, (width * focal[1]) / (height * focal[0]), near, far);
  // The image is a part of a larger one with the principal point in the middle.
  camera.setViewOffset(width, height, width / 2 - middle[0], height / 2 - middle[1], width, height);
  // This changes the aspect, which differs if pixels are not square.
  camera.aspect = (width * focal[1]) / (height * focal[0]);
  camera.updateProjectionMatrix();
  matrix.decompose(camera.position, camera.quaternion, camera.scale);
  camera.updateMatrixWorld();
  camera.name = stated.name;
  Object.assign(camera.userData, { width, height });
  return camera;
}

export class C3gsModel {
  // The number of splats of each target.
  #shown = new WeakMap();

  constructor(scene, gaussians) {
    Object.assign(this, { scene, gaussians });
    this.bounds = new Box3();
    for (const { low, high, start, end } of gaussians.chunks) {
      if (start < end) this.bounds.union(new Box3(new Vector3(...low), new Vector3(...high)));
    }
    this.cameras = scene.cameras.map((stated) => perspective(stated, scene.header.near_plane, this.bounds));
    this.background = new Color().fromArray(scene.header.background.map((value) => value / 255));
    this.upright = new Quaternion().setFromRotationMatrix(new Matrix4().fromArray(uprightMatrix(scene.header)));
  }

  view(camera, object, out) {
    return this.gaussians.all(centreOf(camera, object), out);
  }

  fill(target, camera, object) {
    const { count, positions, scales, rotations, colours, opacities } = this.view(camera, object);
    const [centre, lengths, rotation, colour] = [new Vector3(), new Vector3(), new Quaternion(), new Color()];
    for (let i = 0; i < count; i++) {
      centre.fromArray(positions, 3 * i);
      lengths.fromArray(scales, 3 * i);
      const at = 4 * i;
      rotation.set(rotations[at + 1], rotations[at + 2], rotations[at + 3], rotations[at]);
      colour.fromArray(colours, 3 * i);
      target.setSplat(i, centre, lengths, rotation, opacities[i], colour);
    }
    for (let i = count; i < (this.#shown.get(target) ?? 0); i++) {
      target.setSplat(i, centre, lengths, rotation, 0, colour);
    }
    this.#shown.set(target, count);
    // As for textures of three.js: uploads the data again.
    target.needsUpdate = true;
    return count;
  }
}

// Yields the bytes of a response, and reports their number.
async function* arriving(response, tell) {
  const total = Number(response.headers.get("Content-Length") ?? 0);
  let loaded = 0;
  const reader = response.body.getReader();
  try {
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      loaded += value.length;
      tell({ type: "progress", lengthComputable: total > 0, loaded, total });
      yield value;
    }
  } finally {
    await reader.cancel();
  }
}

export class C3gsLoader extends Loader {
  constructor(manager) {
    super(manager);
    this.options = {};
  }

  setOptions(options) {
    this.options = options;
    return this;
  }

  load(url, onLoad, onProgress, onError) {
    const whole = this.manager.resolveURL(this.path + url);
    this.manager.itemStart(url);
    this.#fetch(whole, onProgress ?? (() => {}))
      .then(onLoad)
      .catch((error) => {
        if (onError) onError(error);
        else console.error(error);
        this.manager.itemError(url);
      })
      .finally(() => this.manager.itemEnd(url));
  }

  async #fetch(url, tell) {
    const response = await fetch(url, {
      headers: this.requestHeader, credentials: this.withCredentials ? "include" : "same-origin",
    });
    if (!response.ok) throw new Error(`${url} has status ${response.status}`);
    return this.parse(arriving(response, tell));
  }

  async parse(input) {
    const chunks = decode(input, this.options);
    let gaussians;
    for (;;) {
      const { value, done } = await chunks.next();
      gaussians ??= new Gaussians(value.scene, this.options);
      if (done) return new C3gsModel(value.scene, gaussians);
      gaussians.add(value);
    }
  }
}
