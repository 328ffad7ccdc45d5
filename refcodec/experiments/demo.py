"""The demo: photographs, training with and without the codec, a file, and a page of the results.

A separate process decodes the file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..bitstream.reconstruction import digest
from ..files.lock import hold_folder
from ..files.outputs import check_apart
from ..files.stage import write_file
from ..folder.layout import REPORT_FILE, SCENE_FILE
from ..folder.read import read_folder
from ..rendering.images import image_names
from .data_set import DataSet
from .page import page
from .runs import Command, Notes, RunError, Runner, has, is_evaluation, is_report, read_result, shown

FORMAT, NOTES, PAGE = "C3GS demo", "demo.json", "index.html"
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "photographs"
TITLES = {"caliterra": "A building site from the air", "snowmiku": "A plush doll"}
# lambda_r: the paper's middle.
RATE = 0.004
# Two parallel training runs on two cores take six minutes in total.
STEPS = 6000

UNCOMPRESSED, CODED = "uncompressed", "coded"
# Parts of a scene by their names in training reports and in files. All other sections are HEADERS.
PARTS = {
    "positions": "positions of the anchors",
    "attributes": "features, scalings and offsets",
    "masks": "kept offsets",
    "planes": "planes that predict the attributes",
    "weights": "weights of the networks",
}
HEADERS = "headers and tables"
# The files and folders that the page refers to.
FILES = {
    "scene.c3gs": "the file",
    "decoded": "the scene folder from decode; point_cloud.ply opens in viewers of Scaffold-GS",
    CODED: "the scene folder from train, the input of encode",
    UNCOMPRESSED: "the uncompressed scene: point_cloud.ply and networks.safetensors",
    f"images-{CODED}": "views rendered from the file, PNG",
    f"images-{UNCOMPRESSED}": "views rendered from the uncompressed scene, PNG",
    f"{CODED}.eval.json": "all figures of each view, and the decoding time",
    f"{UNCOMPRESSED}.eval.json": "the same for the uncompressed scene",
    NOTES: "the commands and their times",
}


@dataclass(frozen=True)
class Demo:
    """The settings of a demo. folder: for the results. steps: of each training run."""

    folder: Path
    photographs: DataSet
    steps: int

    def path(self, name: str) -> Path:
        return self.folder / name

    def _training(self, name: str, rate: float) -> Command:
        output, source = self.path(name), str(self.photographs.folder)
        words = ("--lambda", f"{rate:g}", "--steps", str(self.steps), *self.photographs.trained, "--threads", "1")
        state = output.with_name(f"{name}.train-state")
        return Command(
            name, ("train", source, "-o", str(output), *words, "--progress"), output / REPORT_FILE, state=state
        )

    def _evaluation(self, name: str, scene: Path, after: str) -> Command:
        what = (
            "eval",
            str(scene),
            str(self.photographs.folder),
            *self.photographs.evaluated,
            "--images",
            str(self.path(f"images-{name}")),
            "--json",
        )
        return Command(name, what, self.path(f"{name}.eval.json"), (after,), printed=True)

    def trainings(self) -> list[Command]:
        return [self._training(UNCOMPRESSED, 0), self._training(CODED, RATE)]

    def rest(self) -> list[list[Command]]:
        """The commands after training: one chain for the file, one for the uncompressed scene."""
        scene, file, decoded = (self.path(name) for name in (CODED, "scene.c3gs", "decoded"))
        return [
            [
                Command(CODED, ("encode", str(scene), "-o", str(file)), file, (f"{CODED} train",)),
                Command(CODED, ("decode", str(file), "-o", str(decoded)), decoded / SCENE_FILE, (f"{CODED} encode",)),
                self._evaluation(CODED, file, f"{CODED} encode"),
            ],
            [self._evaluation(UNCOMPRESSED, self.path(UNCOMPRESSED), f"{UNCOMPRESSED} train")],
        ]


def find_example(name: str) -> Path:
    """Returns the folder of photographs of the project. Raises RunError if only the package is installed."""
    folder = EXAMPLES / name
    if not folder.is_dir():
        raise RunError(
            f"{folder} does not exist: the photographs come with a checkout of the project, not with the installed "
            "package; run this command of a checkout (pip install -e .), or give --photographs FOLDER"
        )
    return folder


def run_demo(folder: Path, photographs: DataSet, steps: int) -> tuple[Path, bool]:
    """Trains, encodes, decodes, evaluates and writes the page.

    Finished commands with the same settings are not repeated. Returns the page's path, and whether both training runs
    finished. Raises RunError, also after Ctrl-C without results; PhotographError; SceneFolderError; UsageError if the
    folder is an input, or another run writes to it.
    """
    demo = Demo(folder, photographs, steps)
    # Errors in the photographs are reported before anything is written.
    found = photographs.read()
    check_apart([folder / NOTES, folder / PAGE], found.places())
    with hold_folder(folder):
        return _run(demo)


def _run(demo: Demo) -> tuple[Path, bool]:
    notes = Notes.open(demo.folder, NOTES, FORMAT)
    trainings, rest = demo.trainings(), demo.rest()
    with shown([UNCOMPRESSED, CODED]) as show:
        runner = Runner(notes, show, jobs=2)
        whole = runner.run([[command] for command in trainings])
        if not all(has(command.output) for command in trainings):
            raise RunError("stopped before both training runs had a scene; run the same command again to continue", 130)
        if not runner.run(rest):
            raise RunError("stopped; run the same command again to continue", 130)
    result = collect(demo, notes)
    path = demo.path(PAGE)
    write_file(path, page(result).encode())
    return path, whole


def check_decoder(demo: Demo) -> str:
    """Returns the SHA-256 of the scene before coding. Raises RunError if that of the decoder's folder differs."""
    before = digest(read_folder(demo.path(CODED)))[0]
    decoded = read_result(demo.path("decoded") / SCENE_FILE, lambda found: isinstance(found["digest"]["whole"], str))
    after = decoded["digest"]["whole"]
    if before != after:
        raise RunError(f"the decoded scene differs from the encoded one: SHA-256 {after} instead of {before}", 70)
    return before


def sizes(before: dict[str, int], sections: dict[str, int]) -> list[dict[str, Any]]:
    """Returns name, text and bytes of each part: before in the uncompressed scene, after in the file.

    before: the bytes by part. sections: the bytes of the sections of the file.
    """
    others = sum(size for name, size in sections.items() if name not in PARTS)
    return [
        {"name": name, "text": text, "before": before.get(name, 0), "after": sections.get(name, 0)}
        for name, text in PARTS.items()
    ] + [{"name": "headers", "text": HEADERS, "before": 0, "after": others}]


def collect(demo: Demo, notes: Notes) -> dict[str, Any]:
    """Returns the values of page.html, from the files of a demo. Pairs begin with the uncompressed scene."""
    reports = {name: read_result(demo.path(name) / REPORT_FILE, is_report) for name in (UNCOMPRESSED, CODED)}
    evals = {name: read_result(demo.path(f"{name}.eval.json"), is_evaluation) for name in (UNCOMPRESSED, CODED)}
    found, name = demo.photographs.read(), demo.photographs.folder.name
    held_out = {p.camera.name: p for p in (found.test or found.train)}
    views = []
    names = image_names(row["image"] for row in evals[CODED]["images"])
    for before, after, file in zip(evals[UNCOMPRESSED]["images"], evals[CODED]["images"], names, strict=True):
        images = {
            key: _read(demo.path(f"images-{name}") / file)
            for key, name in ((UNCOMPRESSED, UNCOMPRESSED), ("decoded", CODED))
        }
        photograph = held_out[before["image"]].image
        views.append({"name": before["image"], "photograph": photograph, "before": before, "after": after, **images})
    commands = [*demo.trainings(), *(command for chain in demo.rest() for command in chain)]
    return {
        "title": TITLES.get(name, name),
        "photographs": len(found.train) + len(found.test),
        "held_out": bool(found.test),
        "views": views,
        "mean_before": evals[UNCOMPRESSED]["mean"],
        "mean_after": evals[CODED]["mean"],
        "parts": sizes(evals[UNCOMPRESSED]["parts"], evals[CODED]["parts"]),
        "anchors": (evals[UNCOMPRESSED]["anchors"], evals[CODED]["anchors"]),
        "trained": (reports[UNCOMPRESSED]["steps"], reports[CODED]["steps"]),
        "steps_wanted": demo.steps,
        "rate": RATE,
        "digest": check_decoder(demo),
        "steps": [
            (command.name, str(command).replace(f"{Path.cwd()}/", ""), notes.seconds(command.name))
            for command in commands
        ],
        "charts": {
            name: [(row["seconds"], row["psnr"]) for row in report["history"]] for name, report in reports.items()
        },
        "files": [(name, text, _size(demo.path(name))) for name, text in FILES.items()],
        "credits": _credits(demo.photographs.folder),
    }


def _read(path: Path) -> NDArray[np.uint8]:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def _size(path: Path) -> int:
    return sum(p.stat().st_size for p in path.rglob("*") if p.is_file()) if path.is_dir() else path.stat().st_size


def _credits(photographs: Path) -> str:
    """Returns the source and the licence of the photographs."""
    found = [
        path.read_text(encoding="utf-8", errors="replace").strip()
        for name in ("SOURCE.md", "LICENSE")
        if has(path := photographs / name)
    ]
    # The page wraps the lines of list items itself.
    return re.sub(r"\n +", " ", "\n\n".join(found)).removeprefix("# ") or f"The photographs are those in {photographs}."
