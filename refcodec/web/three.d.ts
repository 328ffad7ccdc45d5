// A loader of C3GS files for three.js. `three` is the page's own.
import { Box3, Camera, Color, Loader, LoadingManager, Object3D, PerspectiveCamera, Quaternion, Vector3 } from "three";
import { Gaussians, Input, Options, Scene, View, Viewpoint } from "./c3gs.js";

/** What takes Gaussians one by one, such as `PackedSplats` of `@sparkjsdev/spark`. */
export interface SplatTarget {
  setSplat(
    index: number,
    center: Vector3,
    scales: Vector3,
    quaternion: Quaternion,
    opacity: number,
    color: Color,
  ): void;
}

/**
 * A decoded file.
 *
 *     const model = await new C3gsLoader().loadAsync("scene.c3gs");
 *     const packedSplats = new PackedSplats({ maxSplats: model.gaussians.slotCount });
 *     const mesh = new SplatMesh({ packedSplats });
 *     mesh.quaternion.copy(model.upright);
 *     mesh.updateMatrixWorld();
 *     model.fill(packedSplats, camera, mesh);
 */
export class C3gsModel {
  readonly scene: Scene;
  /** All chunks of the file. */
  readonly gaussians: Gaussians;
  /** The cameras of the file in its world. The first one is the default view. `userData` has `width` and `height`. */
  readonly cameras: readonly PerspectiveCamera[];
  /** Bounds of the positions of the anchors in the file's world. */
  readonly bounds: Box3;
  /** The background of the file (6.5). Its numbers are those of the file. */
  readonly background: Color;
  /** A rotation for the object that draws the file, which turns what is up in the file to +y. */
  readonly upright: Quaternion;
  /**
   * What a camera sees. object: it draws the file. Without it, the file's world is that of the page. out: as in
   * `Gaussians.all`. The matrices of the camera and of the object must be up to date.
   */
  view(camera: Camera, object?: Object3D, out?: View): View;
  /**
   * Sets splats from 0 on to what a camera sees, and returns how many these are.
   *
   * The target needs room for `gaussians.slotCount` splats. Those that another camera saw and this one does not are
   * given no opacity. Colours are given as they are in the file.
   */
  fill(target: SplatTarget, camera: Camera, object?: Object3D): number;
}

/** Loads files. Errors are those of `decode`, and Error for a request that fails. */
export class C3gsLoader extends Loader<C3gsModel> {
  constructor(manager?: LoadingManager);
  /** Options of `decode`. */
  setOptions(options: Options): this;
  /** Loads a file. `onProgress` is told of bytes that arrived. */
  load(
    url: string,
    onLoad: (model: C3gsModel) => void,
    onProgress?: (event: ProgressEvent) => void,
    onError?: (error: unknown) => void,
  ): void;
  loadAsync(url: string, onProgress?: (event: ProgressEvent) => void): Promise<C3gsModel>;
  /** Decodes what is there already. */
  parse(input: Input): Promise<C3gsModel>;
}
