// Loads a file with the loader for three.js, from a server of its own, and says what came of it.
//
// node three_web.mjs FILE DAMAGED: in a folder whose node_modules has three and c3gs.
import fs from "node:fs";
import http from "node:http";
import { cameraMatrix, centreOf, projectionMatrix } from "c3gs";
import { C3gsLoader } from "c3gs/three";
import { LoadingManager, Matrix4, Object3D, PerspectiveCamera } from "three";

const [file, damaged] = process.argv.slice(2);
const server = http.createServer((request, response) => {
  const path = { "/scene.c3gs": file, "/damaged.c3gs": damaged }[request.url];
  response.writeHead(path ? 200 : 404).end(path ? fs.readFileSync(path) : undefined);
});
await new Promise((listening) => server.listen(0, "127.0.0.1", listening));
const base = `http://127.0.0.1:${server.address().port}/`;

// Events of the manager and of the loader, in their order.
const events = [];
const manager = new LoadingManager(
  () => events.push("all"),
  (url) => events.push(`loaded ${url}`),
  (url) => events.push(`failed ${url}`),
);
const loader = new C3gsLoader(manager).setPath(base);
const progress = [];
const model = await loader.loadAsync("scene.c3gs", (event) => progress.push(event.loaded));
const failure = async (name) => {
  const error = await loader.loadAsync(name).catch((reason) => reason);
  return { kind: error.constructor.name, message: error.message, code: error.code };
};
const failures = { damaged: await failure("damaged.c3gs"), missing: await failure("missing.c3gs") };
const bound = await new C3gsLoader().setOptions({ maxAnchors: 1 }).parse(fs.readFileSync(file)).catch((error) => error);
const called = await new Promise((load, fail) => new C3gsLoader().load(`${base}scene.c3gs`, load, undefined, fail));

// The cameras against the functions of c3gs, as the largest difference of each matrix.
const apart = (a, b) => Math.max(...Array.from(a, (x, i) => Math.abs(x - b[i])));
const cameras = model.cameras.map((camera, i) => {
  const stated = model.scene.cameras[i];
  return {
    name: camera.name, ...camera.userData,
    matrix: apart(camera.matrixWorld.elements, cameraMatrix(stated)),
    projection: apart(camera.projectionMatrix.elements, projectionMatrix(stated, camera.near, camera.far)),
  };
});

// An object that is turned and moved, seen by a camera that is moved with it, has the same Gaussians.
const camera = new PerspectiveCamera();
camera.position.set(0.5, -0.25, 6);
camera.updateMatrixWorld();
const view = model.gaussians.all(camera);
const object = new Object3D();
object.position.set(3, -2, 1);
object.quaternion.copy(model.upright);
object.scale.setScalar(2);
object.updateMatrixWorld();
const moved = new PerspectiveCamera();
moved.position.copy(camera.position).applyMatrix4(object.matrixWorld);
moved.updateMatrixWorld();
const again = model.gaussians.all(centreOf(moved, object));

// What GaussianSplat of three.js is given.
const { attributes } = model.geometry(camera);
const row = (array, width, i) => [...array.subarray(width * i, width * (i + 1))];
const rows = (array, width) => Array.from({ length: view.count }, (_, i) => row(array, width, i));
console.log(JSON.stringify({
  events, progress, failures, bound: bound.constructor.name, called: called.gaussians.anchorCount, cameras,
  anchors: model.gaussians.anchorCount, background: model.background.toArray(),
  bounds: [model.bounds.min.toArray(), model.bounds.max.toArray()],
  upright: new Matrix4().makeRotationFromQuaternion(model.upright).elements,
  view: {
    positions: rows(view.positions, 3), scales: rows(view.scales, 3), rotations: rows(view.rotations, 4),
    opacities: [...view.opacities], colours: rows(view.colours, 3),
  },
  moved: apart(view.opacities, again.opacities), movedCount: again.count,
  geometry: Object.fromEntries(Object.entries(attributes).map(([name, own]) => [name, rows(own.array, own.itemSize)])),
}));
server.close();
