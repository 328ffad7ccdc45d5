// A parser of C3GS files for the assets of PlayCanvas, which the page provides. playcanvas.d.ts documents it.
import { Color, Entity, GSplatData, GSplatResource, Mat4, math, Quat } from "playcanvas";
import { playCanvasElements } from "./adapters.js";
import { cameraMatrix, decodeAll, Gaussians, uprightMatrix } from "./c3gs.js";

const matrixOf = (numbers) => {
  const matrix = new Mat4();
  matrix.data.set(numbers);
  return matrix;
};
const rotationOf = (matrix) => new Quat().setFromMat4(matrix);

export function place(entity) {
  const { header, cameras: [stated] } = entity.gsplat.resource.gaussians.scene;
  const { near_plane: nearClip } = header;
  const clearColor = new Color(header.background.map((value) => value / 255));
  const fov = stated ? 2 * math.RAD_TO_DEG * Math.atan(stated.height / (2 * stated.focal[1])) : 45;
  const camera = new Entity("camera");
  camera.addComponent("camera", { fov, clearColor, nearClip, farClip: 1e5 * nearClip });
  if (stated !== undefined) {
    const matrix = matrixOf(cameraMatrix(stated));
    camera.setLocalPosition(matrix.getTranslation());
    camera.setLocalRotation(rotationOf(matrix));
  }
  entity.setLocalRotation(rotationOf(matrixOf(uprightMatrix(header))));
  entity.addChild(camera);
  return camera;
}

export class C3gsParser {
  constructor(app, options = {}) {
    Object.assign(this, { app, options });
  }

  canParse({ ext }) {
    return ext === "c3gs";
  }

  async load(url, callback, asset) {
    try {
      const input = await (asset?.file?.contents ?? fetch(url.load ?? url));
      const { scene, anchors } = await decodeAll(input, this.options);
      const gaussians = new Gaussians(scene, this.options);
      gaussians.add(anchors);
      const data = new GSplatData(playCanvasElements(gaussians.plain(scene.cameras[0])));
      callback(null, Object.assign(new GSplatResource(this.app.graphicsDevice, data), { gaussians }));
    } catch (error) {
      callback(error, null);
    }
  }
}
