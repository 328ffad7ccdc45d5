// A loader of C3GS files for three.js. The page provides `three`.
import {
  Box3, BufferGeometry, Camera, Color, Loader, LoadingManager, Object3D, PerspectiveCamera, Quaternion,
} from "three";
import { Gaussians, Input, Options, Scene } from "./c3gs.js";

/** A decoded file. README.md has examples. */
export class C3gsModel {
  readonly scene: Scene;
  /** The chunks of the file that were decoded. */
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
   * The argument of `GaussianSplat` of three.js 0.187, which copies it. Colours and harmonics have eight bits.
   *
   * camera, object: of a scene that is not static, the Gaussians are those that the camera sees in the object that
   * draws it, with matrices that are up to date. The default is the first camera of the file.
   */
  geometry(camera?: Camera, object?: Object3D): BufferGeometry;
  /**
   * Turns an object by `upright`, and adds the first camera of the file to it with the aspect of a window. Returns the
   * camera.
   */
  place(object: Object3D, aspect: number): PerspectiveCamera;
}

/** Loads files. Throws the errors of `decode` and of `Gaussians`, and Error for a failed request. */
export class C3gsLoader extends Loader<C3gsModel> {
  constructor(manager?: LoadingManager);
  /** Options of `decode`, and a function that is called after each chunk, and awaited: with what is there so far. */
  setOptions(options: Options & { onChunk?: (model: C3gsModel) => unknown }): this;
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
