// A loader of C3GS files for three.js, which the page provides. three.d.ts documents it.
import {
  Box3, BufferAttribute, BufferGeometry, Color, Loader, MathUtils, Matrix4, PerspectiveCamera, Quaternion, Vector3,
} from "three";
import { checkMore } from "./bounds.js";
import { cameraMatrix, centreOf, decode, Gaussians, uprightMatrix } from "./c3gs.js";
import { SH_0 } from "./numbers.js";

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
  constructor(scene, gaussians) {
    Object.assign(this, { scene, gaussians });
    this.bounds = new Box3();
    for (const { low, high, count } of scene.entries()) {
      if (count > 0) this.bounds.union(new Box3(new Vector3(...low), new Vector3(...high)));
    }
    this.readCameras();
    this.background = new Color().fromArray(scene.header.background.map((value) => value / 255));
    this.upright = new Quaternion().setFromRotationMatrix(new Matrix4().fromArray(uprightMatrix(scene.header)));
  }

  // Their section may follow the chunks.
  readCameras() {
    const { cameras, header } = this.scene;
    if (this.cameras?.length === cameras.length) return;
    this.cameras = cameras.map((stated) => perspective(stated, header.near_plane, this.bounds));
  }

  geometry(camera = this.cameras[0], object) {
    const plain = this.gaussians.plain(camera && centreOf(camera, object));
    const { count, positions, scales, rotations, opacities, harmonics } = plain;
    const width = count > 0 ? harmonics.length / count : 3;
    checkMore(plain, count * (28 + 2 * width));
    const covariances = new Float32Array(6 * count);
    const colours = new Uint8ClampedArray(4 * count);
    const [matrix, centre, rotation, lengths] = [new Matrix4(), new Vector3(), new Quaternion(), new Vector3()];
    for (let i = 0; i < count; i++) {
      const [w, x, y, z] = rotations.subarray(4 * i, 4 * i + 4);
      const { elements: e } = matrix.compose(centre, rotation.set(x, y, z, w), lengths.fromArray(scales, 3 * i));
      // The upper triangle.
      for (let a = 0, at = 6 * i; a < 3; a++) {
        for (let b = a; b < 3; b++) covariances[at++] = e[a] * e[b] + e[4 + a] * e[4 + b] + e[8 + a] * e[8 + b];
      }
      for (let c = 0; c < 3; c++) colours[4 * i + c] = 255 * (0.5 + SH_0 * harmonics[width * i + c]);
      colours[4 * i + 3] = 255 * opacities[i];
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions, 3));
    geometry.setAttribute("covariance", new BufferAttribute(covariances, 6));
    geometry.setAttribute("color", new BufferAttribute(colours, 4, true));
    for (let degree = 1; 3 * degree ** 2 < width; degree++) {
      // Rows have whole words. 128 stands for 0.
      const [own, row] = [3 * (2 * degree + 1), 4 * Math.ceil((6 * degree + 3) / 4)];
      const bytes = new Uint8ClampedArray(row * count).fill(128);
      for (let i = 0; i < count; i++) {
        const from = width * i + 3 * degree ** 2;
        for (let n = 0; n < own; n++) bytes[row * i + n] = 128 + 128 * harmonics[from + n];
      }
      const words = new BufferAttribute(new Uint32Array(bytes.buffer), row / 4);
      geometry.setAttribute(`sphericalHarmonics${degree}`, words);
    }
    return geometry;
  }

  place(object, aspect) {
    const camera = this.cameras[0] ?? new PerspectiveCamera();
    // A camera of the file has a shape of its own.
    camera.clearViewOffset();
    camera.aspect = aspect;
    camera.updateProjectionMatrix();
    object.quaternion.copy(this.upright);
    object.add(camera);
    object.updateWorldMatrix(true, true);
    return camera;
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
    let model;
    for (;;) {
      const { value, done } = await chunks.next();
      model ??= new C3gsModel(value.scene, new Gaussians(value.scene, this.options));
      model.readCameras();
      if (done) return model;
      model.gaussians.add(value);
      await this.options.onChunk?.(model);
    }
  }
}
