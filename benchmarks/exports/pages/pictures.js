// What the pages share: cameras as three.js has them, and pictures that are sent back.

// A camera of cameras.json. Pixels need not be square, and the principal point may be anywhere.
// near: the nearest depth that is drawn, world units.
export function cameraOf(THREE, view, near) {
  const { width, height, fx, fy, cx, cy, pose } = view;
  const angle = 2 * Math.atan(height / 2 / fy) * 180 / Math.PI;
  const camera = new THREE.PerspectiveCamera(angle, width / fx / (height / fy), near, 1e5 * near);
  camera.setViewOffset(width, height, width / 2 - cx, height / 2 - cy, width, height);
  new THREE.Matrix4().set(...pose).decompose(camera.position, camera.quaternion, camera.scale);
  camera.updateMatrixWorld(true);
  return camera;
}

async function send(place, body) {
  await fetch(place, { method: "POST", body });
}

// begin: takes what cameras.json says, and gives a function that draws a camera on a canvas.
export async function pictures(begin) {
  window.addEventListener("unhandledrejection", (event) => send("/error", String(event.reason)));
  try {
    const stated = await (await fetch("/cameras.json")).json();
    const draw = await begin(stated);
    for (const [number, view] of stated.cameras.entries()) {
      const canvas = await draw(view);
      const flat = new OffscreenCanvas(view.width, view.height).getContext("2d");
      flat.drawImage(canvas, 0, 0);
      await send(`/picture/${number}`, flat.getImageData(0, 0, view.width, view.height).data);
    }
    await send("/done", "");
  } catch (error) {
    await send("/error", String(error.stack ?? error));
  }
}
