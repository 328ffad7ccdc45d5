// Runs the examples of the package's README.md and of docs/page.md, one after the other, with what they leave to the
// page.
//
// node readme_web.mjs FILE: a file of eight chunks or more. It says how many examples ran, and how many Gaussians they
// drew. Those that are whole pages are left out: test_web_pages.py opens them in a browser.
import fs from "node:fs";
import * as c3gs from "../../refcodec/web/c3gs.js";

const web = new URL("../../refcodec/web/", import.meta.url);
const [file, wasm] = [process.argv[2], new URL("c3gs.wasm", web)].map((path) => fs.readFileSync(path));
const texts = ["README.md", "../../docs/page.md"].map((name) => fs.readFileSync(new URL(name, web), "utf8"));
const blocks = texts.join("\n").matchAll(/```js\n([\s\S]*?)```/g);

let drawn = 0;
const page = {
  ...c3gs,
  fetch: async (url, { headers } = {}) => {
    if (url === "c3gs.wasm") return new Response(wasm, { headers: { "Content-Type": "application/wasm" } });
    const range = /^bytes=(\d+)-(\d+)$/.exec(headers?.Range);
    const bytes = range === null ? file : file.subarray(Number(range[1]), Number(range[2]) + 1);
    return new Response(bytes, { headers: { "Content-Length": bytes.length } });
  },
  wasmUrl: "c3gs.wasm",
  draw: ({ count }) => (drawn += count),
};
const AsyncFunction = (async () => {}).constructor;

let ran = 0;
for (const [, text] of blocks) {
  if (/"(three|playcanvas)[/"]/.test(text)) continue;
  // Imports are there already. What a block declares, the next ones have, too.
  const code = text.replace(/^import .*$/gm, "").replace(/^(const|let) (\w+)( =|;)/gm, (all, kind, name, rest) => {
    return rest === ";" ? `page.${name} = undefined;` : `page.${name} =`;
  });
  page.response = new Response(file);
  await new AsyncFunction("page", `with (page) { ${code} }`)(page);
  ran += 1;
}
console.log(JSON.stringify({ ran, drawn }));
