"use strict";
// The map: the piece that is pointed at, tapped or reached by the arrows is described below it.
const pieces = [...document.querySelectorAll(".map .piece")];
const readout = document.querySelector(".readout");
let current = -1;
function show(number) {
  current = (number + pieces.length) % pieces.length;
  for (const piece of pieces) piece.classList.toggle("on", piece === pieces[current]);
  readout.textContent = pieces[current].title;
}
pieces.forEach((piece, number) => {
  for (const event of ["mouseenter", "focus", "click"]) piece.addEventListener(event, () => show(number));
});
for (const button of document.querySelectorAll(".go")) {
  button.addEventListener("click", () => show(current < 0 ? 0 : current + Number(button.dataset.go)));
}
