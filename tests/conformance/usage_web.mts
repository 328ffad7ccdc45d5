// A use of all that the types of the package declare. test_web_three.py has its types checked; it never runs.
import {
  BoundPassedError, C3gsError, cameraMatrix, centreOf, decode, decodeAll, decodeChunk, Gaussians, open,
  projectionMatrix, RenderModelError, uprightMatrix, type Scene, type View,
} from "c3gs";
import { playCanvasElements, sparkSplats } from "c3gs/adapters";
import { C3gsGltfPlugin, decodeAttributes } from "c3gs/gltf";
import { C3gsLoader, C3gsModel } from "c3gs/three";
import { options } from "c3gs/spark";
import { ExtSplats, SplatMesh } from "@sparkjsdev/spark";
import { Object3D, PerspectiveCamera, Scene as World } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { GaussianSplat } from "three/addons/objects/GaussianSplat.js";

async function stream(response: Response, place: PerspectiveCamera, object: Object3D): Promise<void> {
  let gaussians: Gaussians | undefined;
  let out: View | undefined;
  try {
    const bounds = { maxAnchors: 1e6, maxMemory: 1 << 29 };
    for await (const chunk of decode(response, bounds)) {
      gaussians ??= new Gaussians(chunk.scene, bounds);
      const index: number = gaussians.add(chunk);
      out = gaussians.chunk(index, centreOf(place, object));
      const sum: number = chunk.lengths.positions + chunk.lengths.masks + chunk.lengths.attributes;
      console.log(sum, gaussians.chunks[index].slot, gaussians.changes(place), gaussians.all([0, 0, 0], out).count);
    }
  } catch (error) {
    if (error instanceof C3gsError) console.log(error.code, error.clause, error.offset);
    else if (error instanceof BoundPassedError) console.log(error.bound);
    else if (error instanceof RenderModelError) console.log(error.message);
  }
}

async function whole(bytes: Uint8Array): Promise<Scene> {
  const { scene, anchors } = await decodeAll(bytes);
  const gaussians = new Gaussians(scene);
  gaussians.add(anchors);
  const view: View = gaussians.range(0, 10, { x: 1, y: 2, z: 3 }, gaussians.room(100));
  for (const camera of scene.cameras) {
    gaussians.all(camera, view);
    console.log(cameraMatrix(camera), projectionMatrix(camera, 0.1, 100), scene.metadata.get("title"));
  }
  console.log(uprightMatrix(scene.header), gaussians.slotOf(3));
  const { colour_primaries: primaries, transfer_characteristics: transfer, render_model: model } = scene.header;
  console.log(primaries + transfer + model);
  const other = await open(new Blob([new Uint8Array(3)]));
  await other.readAncillary();
  await decodeChunk({ read: async () => new Uint8Array(1), length: 1 }, 0);
  gaussians.clear();
  // @ts-expect-error A place has numbers.
  gaussians.all("abc".length);
  // @ts-expect-error Cameras are read.
  scene.cameras = [];
  return scene;
}

async function three(world: World, camera: PerspectiveCamera): Promise<void> {
  const loader = new C3gsLoader().setOptions({ maxAnchors: 10, onChunk: ({ bounds }) => bounds }).setPath("/files/");
  const model: C3gsModel = await loader.loadAsync("scene.c3gs", (event) => console.log(event.loaded));
  options.maxMemory = 1 << 29;
  const mesh = new SplatMesh({ url: "scene.c3gs" });
  model.place(mesh, 16 / 9).updateMatrixWorld();
  world.add(mesh);
  world.background = model.background;
  world.add(new GaussianSplat(model.geometry()), new GaussianSplat(model.geometry(camera, mesh)));
  const plain = model.gaussians.enlarge(model.gaussians.plain(camera));
  world.add(new SplatMesh({ splats: new ExtSplats(sparkSplats(plain)) }));
  console.log(playCanvasElements(plain)[0].properties.map(({ name, storage }) => [name, storage.length]));
  loader.load("a.c3gs", (own) => console.log(own.bounds), undefined, (error) => console.log(error));
}
async function gltf(world: World, bytes: Uint8Array): Promise<void> {
  const loader = new GLTFLoader();
  loader.register((parser) => new C3gsGltfPlugin(parser, { maxMemory: 1 << 29 }));
  world.add((await loader.loadAsync("scene.glb")).scene);
  const { header, count, attributes } = await decodeAttributes(bytes);
  const scales: Float32Array = attributes["KHR_gaussian_splatting:SCALE"];
  console.log(header.colour_outputs, count, scales.length);
}
void [stream, whole, three, gltf];
