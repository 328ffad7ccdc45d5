// After `import "c3gs/spark"`, `new SplatMesh({ url: "scene.c3gs" })` of `@sparkjsdev/spark` 2 loads C3GS files, and so
// do `fileBytes` and `stream` with a `fileName` that ends in `.c3gs`. `PackedSplats`, `ExtSplats` and `SplatLoader`
// alone do not. `lod`, `paged` and `maxSplats` do not count.
//
// The mesh shows what is there of a file while the rest arrives. Its `initialized` ends with the last chunk, and
// `userData.c3gs` is a promise of the `C3gsModel`, which ends with the first chunk if the cameras of the file precede
// it. Both have the errors of `C3gsLoader`. A scene that is not static is computed again when the camera of a frame has
// moved, in its thread.
import { Options } from "./c3gs.js";

/** Those of `decode` for meshes that are made later, such as bounds: set its properties. */
export const options: Options;
