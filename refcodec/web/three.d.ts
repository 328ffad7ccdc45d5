// A loader of C3GS files for three.js. The page provides `three`.
import { Box3, Camera, Color, Loader, LoadingManager, Object3D, PerspectiveCamera, Quaternion, Vector3 } from "three";
import { Gaussians, Input, Options, Scene, View, Viewpoint } from "./c3gs.js";

/** A target for Gaussians one by one, such as `PackedSplats` of Spark, which needs a `SparkRenderer` in the scene. */
export interface SplatTarget {
  /** Set after an update. */
  needsUpdate?: boolean;
  setSplat(
    index: number,
    center: Vector3,
    scales: Vector3,
    quaternion: Quaternion,
    opacity: number,
    color: Color,
  ): void;
}

/** A decoded file. README.md has examples. */
export class C3gsModel {
  readonly scene: Scene;
  /** All chunks of the file. */
  readonly gaussians: Gaussians;
  /**
   * The cameras of the file in its world. The first one is the default view. `userData` has `width` and `height`.
   *
   * If an object that draws the file is turned, such as by `upright`, its cameras turn with it as its children:
   * `object.add(camera)`.
   */
  readonly cameras: readonly PerspectiveCamera[];
  /** Bounds of the positions of the anchors in the file's world. */
  readonly bounds: Box3;
  /** The background of the file (6.5). Its numbers are those of the file. */
  readonly background: Color;
  /** The rotation from the up direction of the file to +y, for the object that draws the file. */
  readonly upright: Quaternion;
  /**
   * The view of a camera. object: draws the file; without it, the file's world is that of the page. out: as in
   * `Gaussians.all`. The matrices of the camera and of the object must be up to date.
   */
  view(camera: Camera, object?: Object3D, out?: View): View;
  /**
   * Sets splats from 0 on to the view of a camera, and returns their number.
   *
   * For a static scene, `sparkSplats` of `c3gs/adapters` gives all cameras at once.
   *
   * The target needs room for `gaussians.slotCount` splats, and must show later changes: Spark's `PackedSplats` does,
   * its `ExtSplats` does not. Splats of an earlier view that are not in this one get
   * opacity 0. Colours are those of the file, whose header states their encoding.
   */
  fill(target: SplatTarget, camera: Camera, object?: Object3D): number;
}

/** Loads files. Throws the errors of `decode` and of `Gaussians`, and Error for a failed request. */
export class C3gsLoader extends Loader<C3gsModel> {
  constructor(manager?: LoadingManager);
  /** Options of `decode`. */
  setOptions(options: Options): this;
  /** Loads a file. `onProgress` is called with the number of received bytes. */
  load(
    url: string,
    onLoad: (model: C3gsModel) => void,
    onProgress?: (event: ProgressEvent) => void,
    onError?: (error: unknown) => void,
  ): void;
  loadAsync(url: string, onProgress?: (event: ProgressEvent) => void): Promise<C3gsModel>;
  /** Decodes bytes in memory. */
  parse(input: Input): Promise<C3gsModel>;
}
