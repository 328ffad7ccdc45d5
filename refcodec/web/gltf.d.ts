// Static scenes in glTF, by KHR_gaussian_splatting_compression_c3gs. Nothing of three.js is imported.
import { Header, Input, Options } from "./c3gs.js";

/** The Gaussians of a static scene as attributes of KHR_gaussian_splatting. */
export interface Attributes {
  readonly header: Header;
  /** The number of Gaussians. */
  readonly count: number;
  /**
   * By name, such as `POSITION` and `KHR_gaussian_splatting:SCALE`. Lengths are not logarithms, quaternions are x, y, z,
   * w of length 1, and opacities are from 0 to 1. Means and harmonics have the bits of 9.4.
   */
  readonly attributes: Readonly<Record<string, Float32Array>>;
}

/** Decodes the file of a buffer view. Throws RenderModelError for a scene that is not static, and as `decode` does. */
export function decodeAttributes(input: Input, options?: Options): Promise<Attributes>;

/** What the plugin uses of the parser of GLTFLoader. */
export interface Parser {
  readonly json: any;
  getDependency: (type: string, index: number) => Promise<any>;
}

/**
 * A plugin of GLTFLoader: compressed primitives get their attributes as if they were in the file as plain numbers.
 *
 * Without a plugin for KHR_gaussian_splatting itself, such as GLTFGaussianSplatLoaderExtension of three.js, the loader
 * makes white `Points` of them. That extension needs WebGPURenderer with `outputColorSpace = LinearSRGBColorSpace`:
 * the colours of a file are those of the display.
 *
 * Errors of `decodeAttributes` reach the caller of the loader, and so does an Error for a primitive that does not
 * describe the Gaussians of its C3GS file.
 */
export class C3gsGltfPlugin {
  /** options: of `decode`. */
  constructor(parser: Parser, options?: Options);
  readonly name: string;
  beforeRoot(): Promise<void>;
  loadBufferView(index: number): Promise<ArrayBuffer> | null;
}
