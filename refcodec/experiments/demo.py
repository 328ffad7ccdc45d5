"""The demo: photographs, training with and without the codec, a file, and a page of the results.

A separate process decodes the file.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from PIL import Image

from ..bitstream.reconstruction import digest
from ..files.lock import hold_folder
from ..files.outputs import check_apart
from ..files.stage import write_file
from ..folder.layout import REPORT_FILE, SCENE_FILE
from ..folder.read import read_folder
from ..photographs.as_trained import stated_photographs
from ..photographs.photographs import TEST_EVERY, PhotographSet
from ..rendering.images import image_names
from ..statuses import DONE, FAULT, INTERRUPTED
from ..train.settings import TrainSettings
from .cells import Evaluation, Training
from .jobs import Job, RunError, Step, claim, has, read, run_job, run_jobs, shown
from .page import page
from .plan import CODED, UNCOMPRESSED

FORMAT, MARK, PAGE = "C3GS demo", "demo.json", "index.html"
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "photographs"
TITLES = {"caliterra": "A building site from the air", "snowmiku": "A plush doll"}
# lambda_r: the paper's middle.
LAMBDA = 0.004
# Of further rates, which continue from the coded scene for this share of the steps.
FURTHER, SHARE = (0.016, 0.001), 6

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
}


# Words of `train` that state how photographs are read, and where a training begins, in the order of the arguments.
WORDS = ("static", "background", "holdout", "anchors", "voxel", "degree", "set", "up")


def options_of(words: Mapping[str, Any]) -> tuple[str, ...]:
    """Returns WORDS as arguments of `train`."""
    made: list[str] = []
    for name in WORDS:
        value = words.get(name)
        if name == "up" and value:
            # As an argument by itself, -y would be an option.
            made.append(f"--{name}={value}")
        elif name == "static":
            made += [f"--{name}"] if value else []
        elif value is not None:
            made += [word for one in (value if name == "set" else [value]) for word in (f"--{name}", str(one))]
    return tuple(made)


class _Digest(Struct):
    whole: str


class _Decoded(Struct):
    """The used field of a scene folder's document."""

    digest: _Digest


@dataclass(frozen=True)
class Demo:
    """A demo. folder: for the results. photographs: their folder. options: further arguments of `train`."""

    folder: Path
    photographs: Path
    settings: TrainSettings
    options: tuple[str, ...]

    def read(self) -> PhotographSet:
        """The photographs. Raises PhotographError."""
        settings = self.settings
        return stated_photographs(self.photographs, settings.size, settings.background, settings.holdout)

    def path(self, name: str) -> Path:
        return self.folder / name

    def job(self, name: str, *steps: Step) -> Job:
        """A job of one of the two scenes. Both jobs of a scene have one record."""
        return Job(name, self.path(f"{name}.steps.json"), steps)

    def training(self, name: str, lambda_r: float, source: Path | None = None) -> Step:
        """The training of a scene, from a coded one if a source is given."""
        output, steps = self.path(name), self.settings.steps
        words = ("--lambda", f"{lambda_r:g}", *self.options, "--size", self.settings.size)
        words += ("--steps", str(steps)) if source is None else ("--steps", str(steps // SHARE), "--from", str(source))
        return Step(
            ("train", str(self.photographs), "-o", str(output), *words),
            output / REPORT_FILE,
            () if source is None else (source / REPORT_FILE,),
            state=self.path(f"{name}.train-state"),
            free=("--threads", "1", "--progress"),
        )

    def further(self) -> dict[float, Job]:
        """The jobs of further rates by lambda_r. A static scene has none, because no training continues it."""
        jobs = {}
        for rate in FURTHER if not self.settings.static else ():
            name = f"{CODED}-{rate:g}"
            scene, file = self.path(name), self.path(f"{name}.c3gs")
            training = self.training(name, rate, self.path(CODED))
            jobs[rate] = self.job(name, training, _encoding(scene, file), self._evaluation(name, file, file))
        return jobs

    def _evaluation(self, name: str, scene: Path, made: Path) -> Step:
        settings, images = self.settings, str(self.path(f"images-{name}"))
        # A scene has its background. A file does not state the held-out photographs.
        held = () if settings.holdout == TEST_EVERY else ("--holdout", str(settings.holdout))
        words = ("eval", str(scene), str(self.photographs), "--size", settings.size, *held, "--images", images)
        return Step((*words, "--json"), self.path(f"{name}.eval.json"), (made,), printed=True)

    def jobs(self) -> list[list[Job]]:
        """The jobs that train, and those after them: for the uncompressed scene, and for the file."""
        plain, scene, file, decoded = map(self.path, (UNCOMPRESSED, CODED, "scene.c3gs", "decoded"))
        coding = [
            _encoding(scene, file),
            Step(("decode", str(file), "-o", str(decoded)), decoded / SCENE_FILE, (file,)),
            self._evaluation(CODED, file, file),
        ]
        rest = [
            self.job(UNCOMPRESSED, self._evaluation(UNCOMPRESSED, plain, plain / REPORT_FILE)),
            self.job(CODED, *coding),
        ]
        trainings = {UNCOMPRESSED: 0, CODED: LAMBDA}
        return [[self.job(name, self.training(name, rate)) for name, rate in trainings.items()], rest]


def _encoding(scene: Path, file: Path) -> Step:
    return Step(("encode", str(scene), "-o", str(file)), file, (scene / REPORT_FILE,))


def find_example(name: str) -> Path:
    """Returns the folder of photographs of the project. Raises RunError if only the package is installed."""
    folder = EXAMPLES / name
    if not folder.is_dir():
        raise RunError(
            f"{folder} does not exist: the photographs come with a checkout of the project, not with the installed "
            "package; run this command of a checkout (pip install -e .), or give --photographs FOLDER"
        )
    return folder


def run_demo(demo: Demo) -> tuple[Path, bool]:
    """Trains, encodes, decodes, evaluates and writes the page.

    Finished commands with the same settings are not repeated. Returns the page's path, and whether both training runs
    finished. Raises RunError, also after Ctrl-C without results; PhotographError; SceneFolderError; UsageError if the
    folder is an input, or another run writes to it; OSError.
    """
    folder = demo.folder
    # Errors in the photographs are reported before anything is written.
    places = demo.read().places()
    check_apart([folder / MARK, folder / PAGE], places)
    claim(folder, MARK, FORMAT)
    with hold_folder(folder):
        trainings, rest = demo.jobs()
        whole = _ran(trainings)
        if not all(has(job.steps[0].output) for job in trainings):
            raise RunError("stopped before both training runs had a scene; the same command continues", INTERRUPTED)
        if not _ran(rest):
            raise RunError("stopped; the same command continues", INTERRUPTED)
        # Who stopped a training wants to see what there is.
        whole = whole and _ran([*demo.further().values()])
        write_file(folder / PAGE, page(collect(demo)).encode())
    return folder / PAGE, whole


def _ran(jobs: list[Job]) -> bool:
    """Runs jobs, and shows their lines. Returns whether all are done. Raises RunError for one that fails."""
    with shown([job.name for job in jobs]) as show:
        outcomes, _ = run_jobs(jobs, 2, lambda job, wanted: run_job(job, wanted, show), together=True)
    for outcome in outcomes:
        if outcome.status not in (DONE, INTERRUPTED):
            raise RunError(outcome.text, outcome.status)
    return len(outcomes) == len(jobs) and all(outcome.status == DONE for outcome in outcomes)


def check_decoder(demo: Demo) -> str:
    """Returns the SHA-256 of the scene before coding. Raises RunError if that of the decoder's folder differs."""
    before = digest(read_folder(demo.path(CODED)))[0]
    after = read(demo.path("decoded") / SCENE_FILE, _Decoded).digest.whole
    if before != after:
        raise RunError(f"the decoded scene differs from the encoded one: SHA-256 {after} instead of {before}", FAULT)
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


def collect(demo: Demo) -> dict[str, Any]:
    """Returns the values of page.html, from the files of a demo. Pairs begin with the uncompressed scene."""
    names = UNCOMPRESSED, CODED
    reports = [read(demo.path(name) / REPORT_FILE, Training) for name in names]
    before, after = (read(demo.path(f"{name}.eval.json"), Evaluation) for name in names)
    photographs, name = demo.read(), demo.photographs.name
    held_out = {p.camera.name: p.image for p in (photographs.test or photographs.train)}
    files = image_names(row.image for row in after.images)
    views = [
        {
            "name": plain.image,
            "photograph": held_out[plain.image],
            "before": plain,
            "after": coded,
            UNCOMPRESSED: _pixels(demo.path(f"images-{UNCOMPRESSED}") / file),
            "decoded": _pixels(demo.path(f"images-{CODED}") / file),
        }
        for plain, coded, file in zip(before.images, after.images, files, strict=True)
    ]
    further = {rate: job for rate, job in demo.further().items() if has(job.steps[-1].output)}
    jobs = [*(job for group in demo.jobs() for job in group), *further.values()]
    rates = {LAMBDA: after} | {rate: read(job.steps[-1].output, Evaluation) for rate, job in further.items()}
    return {
        "title": TITLES.get(name, name),
        "photographs": len(photographs.train) + len(photographs.test),
        "held_out": bool(photographs.test),
        "views": views,
        "mean_before": before.mean,
        "mean_after": after.mean,
        "parts": sizes(before.parts, after.parts),
        "difference": median(a.psnr - b.psnr for a, b in zip(after.images, before.images, strict=True)),
        "rates": [(e.bytes, rate, e.mean) for rate, e in sorted(rates.items(), reverse=True)],
        "anchors": (before.anchors, after.anchors),
        "trained": [report.steps for report in reports],
        "steps_wanted": demo.settings.steps,
        "lambda_r": LAMBDA,
        "digest": check_decoder(demo),
        "steps": [
            (f"{job.name} {step.name}", str(step).replace(f"{Path.cwd()}/", ""), job.entries()[step.name].seconds)
            for job in jobs
            for step in job.steps
        ],
        "charts": {
            name: [(look.seconds, look.psnr) for look in report.history]
            for name, report in zip(names, reports, strict=True)
        },
        "files": [(name, text, _size(demo.path(name))) for name, text in FILES.items()],
        "credits": _credits(demo.photographs),
    }


def _pixels(path: Path) -> NDArray[np.uint8]:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def _size(path: Path) -> int:
    return sum(p.stat().st_size for p in path.rglob("*") if p.is_file()) if path.is_dir() else path.stat().st_size


def _credits(photographs: Path) -> str:
    """Returns the source and the licence of the photographs."""
    texts = [
        path.read_text(encoding="utf-8", errors="replace").strip()
        for name in ("SOURCE.md", "LICENSE")
        if has(path := photographs / name)
    ]
    # The page wraps the lines of list items itself.
    return re.sub(r"\n +", " ", "\n\n".join(texts)).removeprefix("# ") or f"The photographs are those in {photographs}."
