// Lets SplatMesh of Spark, which the page provides, load C3GS files. spark.d.ts documents it.
import { ExtSplats, SplatMesh } from "@sparkjsdev/spark";
import { sparkSplats } from "./adapters.js";
import { centreOf } from "./c3gs.js";
import { C3gsLoader } from "./three.js";

// The change of the view of a chunk, in radians, from which on a view-dependent scene is computed again.
const CHANGE = 0.01;

export const options = {};

// Spark 2 has no list of loaders. SplatMesh calls the first one for a file, and the second one before each frame.
const { asyncInitialize, update } = SplatMesh.prototype;

SplatMesh.prototype.asyncInitialize = async function (given) {
  const { url, fileName, fileBytes, stream, onProgress } = given;
  if (!/\.c3gs($|[?#])/i.test(url ?? fileName ?? "")) return asyncInitialize.call(this, given);
  this.packedSplats = undefined;
  let started, failed, model, place, shown = 0;
  this.userData.c3gs = new Promise((resolve, reject) => ([started, failed] = [resolve, reject]));
  // `initialized` has the error, too.
  this.userData.c3gs.catch(() => {});
  const isStatic = () => model.scene.header.render_model === 1;
  const show = () => {
    const { scene, gaussians, cameras } = model;
    place ??= cameras[0] && centreOf(cameras[0]);
    if (place === undefined && !isStatic()) return;
    const plain = gaussians.plain(place);
    shown = gaussians.chunks.length;
    if (shown < scene.header.chunk_count) gaussians.enlarge(plain);
    this.extSplats?.dispose();
    // A new object, since Spark does not show later changes of one.
    this.splats = this.extSplats = new ExtSplats(sparkSplats(plain));
  };
  this.update = (context) => {
    place = centreOf(context.camera, this);
    // While chunks arrive, this concerns those that are shown.
    const changes = model && !isStatic() ? model.gaussians.changes(place).subarray(0, shown || 1) : [];
    if (changes.some((change) => change > CHANGE)) show();
    update.call(this, context);
  };
  const onChunk = async (own) => {
    model = own;
    if (model.cameras.length > 0) started(model);
    // Twice as many each time, so that all of it takes as long as two views of the whole scene.
    if (model.gaussians.chunks.length < 2 * shown) return;
    show();
    // The frame is drawn before the next chunk is decoded.
    await new Promise((resolve) => setTimeout(resolve));
  };
  try {
    const loader = new C3gsLoader().setOptions({ ...options, onChunk });
    model = await (url ? loader.loadAsync(url, onProgress) : loader.parse(fileBytes ?? stream));
    if (shown < model.gaussians.chunks.length) show();
    started(model);
  } catch (error) {
    failed(error);
    throw error;
  }
};
