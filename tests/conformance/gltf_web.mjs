// Loads GLB files with GLTFLoader of three.js and the plugin of c3gs/gltf. Says the attributes of each in hexadecimal.
import fs from "node:fs";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { C3gsGltfPlugin } from "c3gs/gltf";

const loader = new GLTFLoader();
loader.register((parser) => new C3gsGltfPlugin(parser));
const found = {};
for (const file of process.argv.slice(2)) {
  const bytes = new Uint8Array(fs.readFileSync(file));
  try {
    const { scene } = await loader.parseAsync(bytes.buffer, "");
    const points = scene.children[0];
    const own = Object.entries(points.geometry.attributes);
    found[file] = {
      kind: points.type,
      attributes: Object.fromEntries(own.map(([name, { array }]) => [name, Buffer.from(array.slice().buffer).toString("hex")])),
    };
  } catch (error) {
    found[file] = { error: `${error.name}: ${error.message}` };
  }
}
console.log(JSON.stringify(found));
