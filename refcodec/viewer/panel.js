// The texts around the scene: title, progress, cameras, bytes by part, photographs, and reasons of rejection.
import { printable } from "./text.js";

const byId = (id) => document.getElementById(id);
const find = (selector) => document.querySelector(selector);

const PARTS = {
  header: "header and index", weights: "weights of the networks", planes: "planes", positions: "positions",
  masks: "masks", attributes: "attributes", chunks: "chunks", ancillary: "cameras, metadata",
};
// Reasons of rejection, and the next step of the user.
const AGAIN = "Copy or download it again. If that does not help, ask its sender.";
const REASONS = {
  foreign: ["This is not a C3GS file", ""],
  cut: ["This file is incomplete", "Its end is missing. Copy or download it again."],
  malformed: ["This file is damaged", `Some bytes have changed. ${AGAIN}`],
  invalid: ["This file is damaged", `It violates a rule of the format. ${AGAIN}`],
  unsupported: ["This page does not support the file's version or profile", "A later refcodec may support it."],
  bound: ["This file is too large for the page", "A lower ?budget= may do. refcodec render needs no page."],
  memory: ["Out of memory", "Close other pages and programs, and load this page again."],
  lost: ["The graphics device was lost", "The scene returns with it. If it does not, load this page again."],
  fault: ["This file cannot be shown", ""],
};
const CONVERT = [
  "refcodec convert FILE -o scene.c3gs --fast", "", "refcodec convert FILE -o scene",
  "refcodec encode scene -o scene.c3gs", "",
];

// The most characters that are shown of a text.
const [TITLE_MAX, CREDIT_MAX, NAME_MAX, TEXT_MAX] = [120, 240, 80, 400];

const whole = (number) => number.toLocaleString("en");

// Three digits: 512 B, 51.2 kB, 5.12 MB, 1 MB being 10^6 bytes.
function readable(bytes) {
  for (const [unit, scale] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) {
    if (bytes >= 0.9995 * scale) return `${(bytes / scale).toPrecision(bytes >= 999.5 * scale ? 4 : 3)} ${unit}`;
  }
  return `${bytes} B`;
}

// All texts enter the page here, including those of files.
function put(element, text, most = TEXT_MAX) {
  element.textContent = printable(text, most);
}

function made(name, text, properties = {}) {
  const element = Object.assign(document.createElement(name), properties);
  put(element, text, NAME_MAX);
  return element;
}

export class Panel {
  // choose: called with the number of a chosen camera. slide: called when the slider moves. open: called with a file.
  // tools: the actions of further keys and their buttons.
  constructor({ choose, slide, open, tools }) {
    this.open = open;
    this.tools = { ...tools, KeyF: fill, KeyH: () => byId("help").showModal(), KeyO: () => byId("file").click() };
    for (const button of document.querySelectorAll("[data-key]")) {
      button.addEventListener("click", () => this.tools[button.dataset.key]());
    }
    find("#tools [data-key=KeyF]").hidden = !document.fullscreenEnabled;
    byId("file").addEventListener("change", ({ target }) => this.take(target.files));
    this.select = find("#cameras select");
    this.slider = find("#slider input");
    this.slider.addEventListener("input", () => slide());
    this.select.addEventListener("change", () => choose(this.select.selectedIndex));
    byId("before").addEventListener("click", () => choose(this.select.selectedIndex - 1));
    byId("after").addEventListener("click", () => choose(this.select.selectedIndex + 1));
    byId("sizes").addEventListener("click", () => this.#toggle());
  }

  #toggle(open = byId("details").hidden) {
    byId("details").hidden = !open;
    byId("sizes").setAttribute("aria-expanded", String(open));
  }

  // Whether the help is open.
  get isAsked() {
    return byId("help").open;
  }

  take([file]) {
    if (file !== undefined) this.open(file);
    // Allows choosing the same file again.
    byId("file").value = "";
  }

  #hide(...names) {
    for (const name of names) byId(name).hidden = true;
  }

  // Shows that no file is open.
  wait() {
    this.#hide("status", "head", "error");
    byId("drop").hidden = false;
  }

  begin(name) {
    this.#hide("drop", "error", "cameras", "sizes", "slider", "photograph");
    put(byId("left"), "");
    this.#toggle(false);
    byId("head").hidden = false;
    this.#title(name, "");
    byId("status").hidden = false;
    byId("status").className = "";
    this.#status("reading", 0);
  }

  #title(title, credit) {
    put(byId("title"), title, TITLE_MAX);
    put(byId("credit"), credit, CREDIT_MAX);
    document.title = [byId("title").textContent, "C3GS"].filter(Boolean).join(", ");
  }

  #status(text, share) {
    put(find("#status span"), text);
    find("#status progress").value = share;
  }

  progress(share) {
    byId("status").classList.add("small");
    this.#status(share < 1 ? `decoding: ${Math.floor(100 * share)} %` : "drawing", share);
  }

  // most: Gaussians that are drawn, of those `kept` in the file. dropped: numbers of chunks without any.
  left({ most, kept, dropped }) {
    const chunks = dropped.length > 0 ? `, none of ${dropped.length} chunks: ${dropped.join(", ")}` : "";
    const text = `The ${whole(most)} most visible of ${whole(kept)} Gaussians; ?budget= sets how many${chunks}`;
    put(byId("left"), most < kept ? text : "");
  }

  // The whole scene is drawn.
  done() {
    byId("status").classList.add("done");
  }

  // files: the file, and the scene in other formats: name, length, what saves it, and PSNR to the scene, if known.
  about(name, metadata, header, length, parts, cameras, files) {
    const licence = metadata.licence && `licence ${metadata.licence}`;
    this.#title(metadata.title || name, [metadata.author, licence, metadata.source].filter(Boolean).join(" · "));
    find("#tools [data-key=KeyR]").hidden = false;
    this.#bytes(header, length, parts);
    this.#files(length, files, metadata);
    this.#cameras(cameras);
  }

  #bytes(header, length, parts) {
    const names = Object.keys(PARTS).filter((part) => parts[part] > 0);
    const colour = (part, more = "") => made("i", "", { style: `background: var(--${part})${more}` });
    const title = (part) => `${PARTS[part]}: ${whole(parts[part])} bytes`;
    const bar = names.map((part) => Object.assign(colour(part, `; flex-grow: ${parts[part]}`), { title: title(part) }));
    find("#sizes .bar").replaceChildren(...bar);
    const more = made("span", ` · ${whole(header.anchor_count)} anchors`, { className: "more" });
    find("#sizes .text").replaceChildren(`${readable(length)}, save`, more);
    const rows = names.map((part) => {
      const cell = made("td", PARTS[part]);
      cell.prepend(colour(part));
      const share = ((100 * parts[part]) / length).toFixed(1);
      return [cell, made("td", whole(parts[part])), made("td", `${share} %`)];
    });
    rows.push([made("td", "file"), made("td", whole(length)), made("td", "")]);
    fillTable("#share tbody", rows);
    byId("sizes").hidden = false;
  }

  // Also what the file says of itself besides its title.
  #files(length, files, metadata) {
    const rows = files.map(({ name, length: own, psnr, save }) => {
      const cell = made("td", "");
      cell.append(Object.assign(made("button", name, { type: "button", title: "Save" }), { onclick: save }));
      const quality = made("td", psnr == null ? "" : `${psnr.toFixed(1)} dB`);
      return [cell, made("td", whole(own)), made("td", `${(own / length).toFixed(1)} times`), quality];
    });
    fillTable("#files tbody", rows);
    const said = Object.entries(metadata).filter(([key]) => !["title", "author", "licence", "source"].includes(key));
    fillTable("#said tbody", said.map(([key, value]) => [made("td", key), made("td", value)]));
  }

  #cameras(cameras) {
    const options = cameras.map(({ name, isPhotograph }) => made("option", isPhotograph ? `photograph ${name}` : name));
    const chosen = this.select.selectedIndex;
    this.select.replaceChildren(...options);
    this.chosen(Math.max(chosen, 0));
    byId("cameras").hidden = cameras.length === 0;
  }

  chosen(number) {
    this.select.selectedIndex = number;
  }

  // Overlays a photograph on a part of the image, or none. box: left, top, width and height in CSS pixels.
  photograph(photograph, [left, top, width, height]) {
    const shown = byId("photograph");
    shown.hidden = byId("slider").hidden = photograph === undefined;
    if (photograph === undefined) return;
    const image = shown.firstElementChild;
    if (image.src !== photograph.image) image.src = photograph.image;
    const from = Number(this.slider.value);
    image.style.clipPath = `inset(0 0 0 ${100 * from}%)`;
    shown.style.setProperty("--from", from);
    Object.assign(shown.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px` });
  }

  // error: from the registry (10.3). Without one, kind and text state the reason, and for a bound the values needed and
  // allowed. looks: of a file in another format.
  refuse(name, error, reason) {
    const { kind, looks } = reason;
    this.#hide("status", "cameras", "sizes", "slider", "photograph", "details", "drop");
    put(byId("left"), "");
    find("#tools [data-key=KeyR]").hidden = true;
    this.#title(name ?? "", "");
    const cut = error?.name.endsWith(".truncated") ? "cut" : error?.class;
    const [heading, next] = REASONS[looks ? "foreign" : cut ?? kind];
    put(find("#error h2"), heading);
    put(find("#error p"), [why(reason), next].filter(Boolean).join(" "));
    const said = find("#error pre");
    said.hidden = error === undefined;
    if (error !== undefined) {
      const { code, offset, clause, name } = error;
      const rest = name.startsWith("chunk.") ? ["refcodec decode FILE -o rescued --keep-going"] : [];
      const near = looks ? [] : ["", `refcodec inspect FILE --near ${offset}`, ...rest];
      const facts = [`error ${code} ${name}, ${error.class}`, `SPEC.md ${clause}, byte ${offset}`];
      said.textContent = [...(looks?.isConverted ? CONVERT : []), ...facts, ...near].join("\n");
    }
    byId("error").hidden = false;
  }
}

// The details below the heading, as sentences.
function why({ kind, text, bound, needed, allowed, looks }) {
  if (looks?.isConverted) return `${looks.text} One command codes it in about a minute, or two train a smaller file:`;
  if (looks !== undefined) return looks.text;
  if (bound === "memory") return `It needs ${readable(needed)} of memory; the page allows ${readable(allowed)}.`;
  if (bound === "anchors") return `It has ${whole(needed)} anchors; the page allows ${whole(allowed)}.`;
  return kind === "memory" || text === undefined ? "" : `${text}.`;
}

function fillTable(selector, rows) {
  const table = rows.map((row) => {
    const line = made("tr", "");
    line.append(...row);
    return line;
  });
  find(selector).replaceChildren(...table);
}

function fill() {
  // The browser may refuse.
  const done = document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen();
  done.catch(() => {});
}
