"""Every command while its outputs fail: each write, flush, rename, new folder and new file in turn.

After each fault the inputs are unchanged, each output is the old one or the complete new one, no other file is left,
and the command has printed one line. The next run succeeds, regardless of the files that were left.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_scenes import random_scene

from conformance.cli import main as suite_cli
from conformance.manifest import VECTORS
from refcodec import statuses
from refcodec.bitstream.codec import emit
from refcodec.bitstream.scene import Ancillary
from refcodec.cli.main import main
from refcodec.files.interrupts import SIGNALS
from refcodec.folder.write import write_folder

TESTS = Path(__file__).resolve().parents[1]
sys.path.extend(str(TESTS / name) for name in ("files", "convert"))
from faults import Faults  # noqa: E402

# Files that are the old ones or the new ones only together: those of a scene, and of a model.
TOGETHER = {"scene.json", "point_cloud.ply", "networks.safetensors", "planes.safetensors", "coded.safetensors"}
TOGETHER |= {"render.json", "checkpoints.pth"}
# Lines on stderr beside the one about the end of a command.
NOTES = re.compile(
    r"train: |photographs are scaled to size|refcodec: the views are|.*: done before|.* are done before$"
)


def fault_of(point: str) -> OSError:
    """What goes wrong at a point: something is forbidden, or the disk is full."""
    number = errno.EACCES if point.split(maxsplit=1)[0] in ("open", "rename", "replace") else errno.ENOSPC
    return OSError(number, os.strerror(number))


def signalled(number: int) -> BaseException:
    """Sends a signal, which the command takes as an interrupt."""
    os.kill(os.getpid(), number)
    return AssertionError("the signal did not interrupt it")


@dataclass
class Case:
    """A command.

    words: its arguments, from the folder that it runs in. old: further commands that make older outputs first.
    changing: names of outputs that differ each time, such as those with times. needs: modules. run: the program.
    """

    words: str
    old: tuple[str, ...] = ()
    changing: tuple[str, ...] = ()
    needs: str = ""
    slow: bool = False
    run: Callable[[list[str]], int] = main


DRAW = "numba PIL scipy skimage"
DECODER = "-m conformance.spec_decoder decode {input} {output}"
REPORTS = ("report.json", "report.xml", "report.html")
# TorchScript counts what it makes.
SCRIPTS = ("opacity_mlp.pt", "cov_mlp.pt", "color_mlp.pt")
SPLATS = "--iterations 0 --degree"
SMALL = "--size 16"
CASES = [
    Case("encode scene -o out.c3gs", ("encode other -o out.c3gs",)),
    Case("decode scene.c3gs -o deep/out", slow=True),
    Case("decode scene.c3gs -o out", ("decode other.c3gs -o out",)),
    Case("reconstruct scene.c3gs out --trace t", ("reconstruct other.c3gs out --trace t",), slow=True),
    Case("gaussians scene.c3gs camera.json out.json", slow=True),
    Case("inspect scene.c3gs --html page.html", ("inspect other.c3gs --html page.html",), slow=True),
    Case(
        f"render scene.c3gs --cameras photos {SMALL} -o images",
        (f"render other.c3gs --cameras photos {SMALL} -o images",),
        needs=DRAW,
    ),
    Case("render scene.c3gs --cameras orbit --frames 2 -o images", needs=DRAW, slow=True),
    Case(f"eval scene.c3gs photos {SMALL} --holdout 8 --images images", needs=DRAW, slow=True),
    Case(
        f"export scene.c3gs -o out.glb {SPLATS} 1 --cameras photos {SMALL}",
        (f"export scene.c3gs -o out.glb {SPLATS} 0",),
        needs=DRAW,
        slow=True,
    ),
    Case(
        "export scene.c3gs -o deep/model --scaffold",
        ("export other.c3gs -o deep/model --scaffold",),
        SCRIPTS,
        needs="torch",
        slow=True,
    ),
    Case(
        "train photos -o out --steps 2 --set start.anchors=100",
        ("decode other.c3gs -o out",),
        needs="torch " + DRAW,
        slow=True,
    ),
    # The state that a fit saves meanwhile is tested in tests/train.
    Case("fit points3D.txt -o deep/out --steps 2", needs="torch scipy", slow=True),
    Case("convert model0 -o out", ("convert model1 -o out",), needs="torch scipy", slow=True),
    Case(
        "convert a.ply -o deep/out --views 8 --size 24 --steps 2 --set start.anchors=100 --pictures other/pictures",
        needs="torch " + DRAW,
        slow=True,
    ),
    # All of its cells are done: it writes the table and the chart.
    Case(f"rd photos -o curve --lambdas 0.01 {SMALL}", needs="torch matplotlib bjontegaard", slow=True),
    Case(
        f"run --vectors suite --jobs 1 --report report -- {sys.executable} {DECODER}",
        (f"run --vectors suite --jobs 1 --report other -- {sys.executable} {DECODER}",),
        REPORTS,
        run=suite_cli,
    ),
    Case("generate -o suite", run=suite_cli),
]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The inputs of the commands."""
    folder = tmp_path_factory.mktemp("inputs")
    scene = replace(random_scene(21, 6, chunk_size=4), ancillary=(Ancillary(b"noTE", 0, b"kept", 5),))
    scene.networks["opacity"][-1][1][:] = 5
    other = random_scene(22, 5, chunk_size=4)
    (folder / "scene.c3gs").write_bytes(emit(scene))
    (folder / "other.c3gs").write_bytes(emit(other))
    (folder / "bad.c3gs").write_bytes(emit(scene)[:-1])
    write_folder(scene, folder / "scene")
    write_folder(other, folder / "other")
    camera = {"width": 8, "height": 6, "focal": [8, 8], "principal_point": [4, 3], "translation": [0, 0, 4]}
    (folder / "camera.json").write_text(json.dumps({**camera, "rotation": np.eye(3).tolist()}))
    points = [f"{i} {i % 5} {i // 5} {i % 3} 90 90 200 0.5\n" for i in range(30)]
    (folder / "points3D.txt").write_text("".join(points))
    photographs(folder / "photos")
    document = json.loads((VECTORS / "manifest.json").read_text())
    document["vectors"] = [v for v in document["vectors"] if v["id"].startswith("valid-")][:2]
    for name in ("flags", "features"):
        used = {entry for vector in document["vectors"] for entry in vector[name]}
        document[name] = {entry: text for entry, text in document[name].items() if entry in used}
    for name in ("manifest.schema.json", *(vector["input"]["path"] for vector in document["vectors"])):
        (folder / "suite" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(VECTORS / name, folder / "suite" / name)
    (folder / "suite" / "manifest.json").write_text(json.dumps(document))
    return folder


def photographs(folder: Path) -> None:
    """Four photographs in NeRF's format, of which two have one name in two folders."""
    image = pytest.importorskip("PIL.Image")
    frames = []
    for number, name in enumerate(("l/0.png", "r/0.png", "l/1.png", "r/1.png")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        pixels = np.random.default_rng(number).integers(0, 256, (12, 16, 3)).astype(np.uint8)
        image.fromarray(pixels).save(folder / name)
        c, s = np.cos(number / 3), np.sin(number / 3)
        pose = [[c, 0, s, 4 * s], [0, 1, 0, 0], [-s, 0, c, 4 * c], [0, 0, 0, 1]]
        frames.append({"file_path": name, "transform_matrix": pose})
    for part, some in {"train": frames[2:], "test": frames[:2]}.items():
        (folder / f"transforms_{part}.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": some}))


def more_inputs(case: Case) -> None:
    """Makes the inputs of one command in the working folder."""
    if "model0" in case.words:
        family: Any = import_module("family")
        for number, layout in enumerate(("hac", "scaffold, plain")):
            family.Model(family.LAYOUTS[layout]).write(Path(f"model{number}"))
    if "a.ply" in case.words:
        plain: Any = import_module("plain")
        plain.write(plain.made(200, 1), Path("a.ply"))
    if case.words.startswith("rd"):
        finished_curve(Path("curve"))


def finished_curve(folder: Path) -> None:
    """Makes the result of the only cell of an experiment."""
    from refcodec.experiments import cells, command, jobs, rd  # noqa: PLC0415

    scene = {"name": "photos", "photographs": "photos", "size": "16", "holdout": 8, "set": []}
    plan = rd.one_scene(scene, "fast", [0.01], uncompressed=False, seeds=[0], steps=4000)
    (cell,) = cells.cells(plan)
    jobs.claim(folder, command.MARK, command.FORMAT)
    job = cell.job(folder, Path("photos"), command._digest(Path("photos")), 1)
    record = {step.name: {"key": "", "seconds": 1.0, "processor_seconds": 1.0} for step in job.steps}
    figures = {"bytes": 100, "parts": {}, "anchors": 5, "mean": dict.fromkeys(cells.Measures.__struct_fields__, 20.0)}
    (cell.folder(folder) / "work").mkdir(parents=True)
    for path, content in ((job.record, record), (job.steps[-1].output, {**figures, "images": []})):
        path.write_text(json.dumps(content))
    (cell.folder(folder) / "work" / "scene.c3gs").write_bytes(b"")
    assert job.finish is not None
    job.finish(job)


def shorten(case: Case, patch: pytest.MonkeyPatch) -> None:
    """Makes work before the outputs short, and does it once."""

    def once(module: str, name: str, after: Callable[[Any], None] = lambda found: None, **fixed: Any) -> None:
        place, known = import_module(module), []
        real = getattr(place, name)

        def call(*arguments: Any, **options: Any) -> Any:
            if not known:
                known.append(real(*arguments, **{**options, **fixed}))
                after(known[0])
            return known[0]

        patch.setattr(place, name, call)

    def trained(trainer: Any) -> None:
        trainer.run(lambda _: None)
        result = trainer.result()
        trainer.result = lambda: result

    if "orbit" in case.words:
        view: Any = import_module("refcodec.rendering.view")
        real = view.own_camera
        patch.setattr(view, "own_camera", lambda info: real(info).resized(16, 12))
    if ".glb" in case.words:
        patch.setattr("refcodec.export.views.AROUND", 9)
        patch.setattr("refcodec.export.views.SIDE", 16)
    if case.words.startswith(("train", "convert a")):
        once("refcodec.train.command", "Trainer", trained)
        once("refcodec.train.command", "report")
    if case.words.startswith("fit"):
        once("refcodec.train.fit", "fit", state=None)
    if case.words.startswith("run"):
        patch.setenv("PYTHONPATH", str(TESTS.parent))
        once("conformance.cli.running", "run")
    if case.words.startswith("generate"):
        patch.setattr("conformance.cases.recipes", list)
        patch.setattr("conformance.cases.suite.vectors", lambda recipes: [({"id": "valid-a"}, {"valid/a.c3gs": b"a"})])


def contents(folder: Path) -> dict[str, bytes | None]:
    """Returns everything below a folder by name; None for a folder."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


@pytest.mark.parametrize("case", [pytest.param(c, id=c.words[:30], marks=[pytest.mark.slow] * c.slow) for c in CASES])
def test_faults(case: Case, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    for module in case.needs.split():
        pytest.importorskip(module)
    before, work = tmp_path / "before", tmp_path / "work"
    shutil.copytree(inputs, before)
    monkeypatch.chdir(before)
    more_inputs(case)
    shorten(case, monkeypatch)
    for words in case.old:
        assert case.run(words.split()) == 0
    faults, old = Faults(work), contents(before)

    def tried(at: int = -1, error: Callable[[], BaseException] = RuntimeError) -> tuple[int, list[str]]:
        if at >= 0 or not work.exists():
            monkeypatch.chdir(tmp_path)
            shutil.rmtree(work, ignore_errors=True)
            shutil.copytree(before, work)
            monkeypatch.chdir(work)
        capsys.readouterr()
        with faults.watching(at, error):
            status = case.run(case.words.split())
        return status, [line for line in capsys.readouterr().err.splitlines() if not NOTES.match(line)]

    status, said = tried()
    assert status == 0, said
    points, new = list(faults.points), contents(work)
    done: dict[str, set[str]] = {}
    for kind, name in (point.split(" ", 1) for point in points):
        done.setdefault(kind, set()).add(name)
    assert done["write"] <= done["open"] & done["fsync"]
    assert done.keys() & {"rename", "replace"}
    assert not [name for name in new if "/." in name or name.startswith(".")]
    changed = {name for name in new if new[name] != old.get(name, b"none")}
    assert done["fsync"] & {above.name for name in changed for above in (work / name).parents}
    for number, point in enumerate(points):
        ends = SIGNALS[number % len(SIGNALS)] if case.run is main else signal.SIGINT
        for error, expected in (
            (lambda point=point: fault_of(point), statuses.USAGE),
            (lambda ends=ends: signalled(ends), statuses.INTERRUPTED),
        ):
            status, said = tried(number, error)
            where = f"{point} (point {number}), {expected}: {said}"
            assert status == expected, where
            assert len(said) == 1, where
            assert not re.search(r" output:|\.refcodec-", said[0]), where
            left = contents(work)
            for name in old.keys() | left.keys():
                assert name in left or name not in old or name not in new, f"{name} is lost: {where}"
                known = [side[name] for side in (old, new) if name in side]
                free = Path(name).name in case.changing and name in changed
                assert free or name not in left or left[name] in known, f"{name} is neither old nor new: {where}"
                # A new folder has an entry, unless it is meant to be empty.
                assert not (
                    name not in old
                    and left[name] is None
                    and any(n.startswith(f"{name}/") for n in new)
                    and not any(n.startswith(f"{name}/") for n in left)
                ), f"{name} is left: {where}"
            for folder in {Path(name).parent for name in changed if Path(name).name in TOGETHER}:
                sides = [
                    {n: side[n] for n in side if Path(n).parent == folder and Path(n).name in TOGETHER}
                    for side in (left, old, new)
                ]
                assert sides[0] in sides[1:], f"{folder} is a mixture: {where}"
    # What the last fault left is no hindrance.
    status, said = tried()
    assert status == 0, said
    assert contents(work).keys() == new.keys()


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0, "digest scene.c3gs"),
        (0, "validate scene.c3gs"),
        (0, "inspect scene.c3gs --hex"),
        (0, "inspect scene.c3gs --json"),
        (0, "explain 432"),
        (0, "eval scene.c3gs photos"),
        (1, "decode bad.c3gs -o new"),
        (1, "decode bad.c3gs -o scene"),
        (1, "reconstruct bad.c3gs new.bin --trace new.txt"),
        (1, "gaussians bad.c3gs camera.json new.json"),
        (1, "inspect bad.c3gs --html new.html"),
        (1, "render bad.c3gs -o new"),
        (1, "eval bad.c3gs photos --images new"),
        (1, "export bad.c3gs -o new.ply"),
    ],
)
def test_nothing_is_written(status: int, words: str, inputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By commands without outputs, which do not try, and of files that are refused."""
    if words.startswith(("render", "eval", "export")):
        pytest.importorskip("numba")
    monkeypatch.chdir(inputs)
    before, faults = contents(inputs), Faults(inputs)
    with faults.watching() as points:
        assert main(words.split()) == status
    assert status or points == []
    assert contents(inputs) == before


def test_the_runner_of_commands(tmp_path: Path, monkeypatch: Any) -> None:
    """The record of a job, and the outputs that are printed."""
    from refcodec.experiments import jobs  # noqa: PLC0415

    monkeypatch.setattr(jobs, "PROGRAM", (sys.executable, "-S", "-c", "print('new')"))
    folder = tmp_path / "out"
    faults = Faults(folder)

    def run() -> None:
        step = jobs.Step(("a",), folder / "x.json", printed=True)
        outcome = jobs.run_job(jobs.Job("x", folder / "record.json", (step,)), lambda: 0)
        if outcome.status:
            raise OSError(outcome.text)

    def fresh() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        (folder / "x.json").write_text("old\n")
        (folder / "record.json").write_text("{}")

    fresh()
    with faults.watching():
        run()
    points = list(faults.points)
    assert sum(point.startswith("replace") for point in points) == 3
    for number, point in enumerate(points):
        for error in (lambda point=point: fault_of(point), KeyboardInterrupt):
            fresh()
            with faults.watching(number, error), pytest.raises((OSError, KeyboardInterrupt)):
                run()
            assert {p.name for p in folder.iterdir()} <= {"record.json", "record.log", "x.json"}
            assert (folder / "x.json").read_text() in ("old\n", "new\n")
            json.loads((folder / "record.json").read_text())
