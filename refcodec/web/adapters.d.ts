// Plain Gaussians (`Gaussians.plain`) in the layouts of other renderers. None of them is imported.
//
// The Gaussians are in the world of the file, and stand upright in an object turned by `uprightMatrix`.
import { PlainGaussians } from "./c3gs.js";

/**
 * Options of `ExtSplats` of `@sparkjsdev/spark` 2: 32 bytes for a Gaussian, and 16 to 64 for its harmonics.
 *
 * Means are binary32. Opacities, colours and logarithms of lengths are binary16. A quaternion has 32 bits. The three
 * numbers of a harmonic have eight bits each, and a common exponent. Spark draws them as SPEC.md 14.4 if the scene has
 * a `SparkRenderer` with `preBlurAmount: header.low_pass` and `blurAmount: 0`.
 */
export function sparkSplats(gaussians: PlainGaussians): {
  extArrays: [Uint32Array, Uint32Array];
  numSplats: number;
  extra: Record<string, Uint32Array>;
};

/** An array of a property of PlayCanvas. */
export interface PlayCanvasProperty {
  type: "float";
  name: string;
  storage: Float32Array;
  byteSize: 4;
}

/**
 * The argument of `GSplatData` of `playcanvas` 2: the properties of PLY files of 3DGS, an array for each.
 *
 * PlayCanvas adds 0.075 square pixels to covariances, whatever the header states as `low_pass`.
 */
export function playCanvasElements(
  gaussians: PlainGaussians,
): [{ name: "vertex"; count: number; properties: PlayCanvasProperty[] }];
