"""Every command while its outputs fail: each write, flush, rename, new folder and new file in turn.

After each fault the inputs are as they were, each output is the old one or the whole new one, nothing else is there,
and the command has said one line. Then it succeeds, whatever was left.
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
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conformance.cases.scenes import random_scene
from conformance.cli import main as suite_cli
from conformance.manifest import VECTORS
from refcodec import statuses
from refcodec.bitstream.codec import emit
from refcodec.bitstream.scene import Ancillary
from refcodec.cli.main import main
from refcodec.files.interrupts import SIGNALS
from refcodec.folder.write import write_folder

sys.path.extend(str(Path(__file__).resolve().parents[1] / name) for name in ("files", "convert"))
from faults import Faults

ROOT = Path(__file__).resolve().parents[2]
SCENE_FILES = {
    "scene.json",
    "point_cloud.ply",
    "networks.safetensors",
    "planes.safetensors",
    "coded.safetensors",
    "render.json",
}


def full() -> OSError:
    return OSError(errno.ENOSPC, "No space left on device")


def forbidden() -> OSError:
    return OSError(errno.EACCES, "Permission denied")


def signalled(number: int) -> Callable[[], BaseException]:
    """Makes the signal of that number, which the command takes as an interrupt."""

    def make() -> BaseException:
        os.kill(os.getpid(), number)
        return AssertionError("the signal did not interrupt it")

    return make


# What goes wrong at a point beside Ctrl-C: something is forbidden, or the disk is full.
ERRORS = {"open": forbidden, "rename": forbidden, "replace": forbidden}


@dataclass
class Case:
    """A command.

    words: its arguments, from the folder that it runs in. least: points that it has at least. old: further commands
    that make older outputs first. changing: names of outputs that are different each time, such as those with times.
    run: the program.
    """

    words: list[str]
    least: int
    old: list[list[str]] = field(default_factory=list)
    changing: tuple[str, ...] = ()
    run: Callable[[list[str]], int] = main


def camera() -> str:
    return json.dumps(
        {
            "width": 8,
            "height": 6,
            "focal": [8, 8],
            "principal_point": [4, 3],
            "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            "translation": [0, 0, 4],
        }
    )


def photographs(folder: Path) -> None:
    """Four photographs, of which two have one name in two folders, in NeRF's format."""
    pytest.importorskip("PIL")
    from PIL import Image  # noqa: PLC0415

    frames = []
    for number, name in enumerate(("l/0.png", "r/0.png", "l/1.png", "r/1.png")):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = np.random.default_rng(number).integers(0, 256, (12, 16, 3)).astype(np.uint8)
        Image.fromarray(pixels).save(path)
        angle = number / 3
        c, s = np.cos(angle), np.sin(angle)
        pose = [[c, 0, s, 4 * s], [0, 1, 0, 0], [-s, 0, c, 4 * c], [0, 0, 0, 1]]
        frames.append({"file_path": name, "transform_matrix": pose})
    split = {"train": frames[2:], "test": frames[:2]}
    for part, some in split.items():
        (folder / f"transforms_{part}.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": some}))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the commands read."""
    folder = tmp_path_factory.mktemp("inputs")
    scene = replace(random_scene(21, 6, chunk_size=4), ancillary=(Ancillary(b"noTE", 0, b"kept", 5),))
    scene.networks["opacity"][-1][1][:] = 5
    (folder / "scene.c3gs").write_bytes(emit(scene))
    (folder / "other.c3gs").write_bytes(emit(random_scene(22, 5, chunk_size=4)))
    (folder / "bad.c3gs").write_bytes(emit(scene)[:-1])
    write_folder(scene, folder / "scene")
    write_folder(random_scene(22, 5), folder / "other")
    (folder / "camera.json").write_text(camera())
    photographs(folder / "photos")
    (folder / "points3D.txt").write_text(
        "\n".join(f"{i} {i % 5} {i // 5} {i % 3} 90 90 200 0.5" for i in range(30)) + "\n"
    )
    suite = folder / "suite"
    document = json.loads((VECTORS / "manifest.json").read_text())
    document["vectors"] = [v for v in document["vectors"] if v["id"].startswith("valid-")][:2]
    for name in ("flags", "features"):
        used = {entry for vector in document["vectors"] for entry in vector[name]}
        document[name] = {entry: text for entry, text in document[name].items() if entry in used}
    for vector in document["vectors"]:
        path = suite / vector["input"]["path"]
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(VECTORS / vector["input"]["path"], path)
    (suite / "manifest.json").write_text(json.dumps(document))
    shutil.copyfile(VECTORS / "manifest.schema.json", suite / "manifest.schema.json")
    return folder


def contents(folder: Path) -> dict[str, bytes | None]:
    """Everything below a folder by name; None for a folder."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))
    }


def try_all(
    case: Case, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Runs a command with each fault in turn."""
    before, work = tmp_path / "before", tmp_path / "work"
    shutil.copytree(inputs, before)
    monkeypatch.chdir(before)
    for words in case.old:
        assert case.run(words) == 0
    faults = Faults(work)

    def run(at: int = -1, error: Callable[[], BaseException] = full) -> tuple[int, str]:
        capsys.readouterr()
        with faults.watching(at, error):
            status = case.run(case.words)
        return status, capsys.readouterr().err

    def fresh() -> None:
        monkeypatch.chdir(tmp_path)
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(before, work)
        monkeypatch.chdir(work)

    old = contents(before)
    fresh()
    status, said = run()
    assert status == 0, said
    points, new = list(faults.points), contents(work)
    print(f"{' '.join(case.words)}: {len(points)} points")
    assert len(points) >= case.least, points
    assert not [name for name in new if "/." in name or name.startswith(".")]
    changed = {name for name in new if new[name] != old.get(name, b"none")}
    assert changed
    for number, point in enumerate(points):
        ends = SIGNALS[number % len(SIGNALS)] if case.run is main else signal.SIGINT
        for error, expected in (
            (ERRORS.get(point.split()[0], full), statuses.USAGE),
            (signalled(ends), statuses.INTERRUPTED),
        ):
            fresh()
            status, said = run(number, error)
            where = f"{point} (point {number}), {expected}: {said}"
            assert status == expected, where
            assert not re.search(r" output:|\.refcodec-|\.c3gs-", said), where
            assert len([line for line in said.splitlines() if not line.startswith("train: ")]) == 1, where
            left = contents(work)
            for name in old.keys() | left.keys():
                known = [side[name] for side in (old, new) if name in side]
                if name in left and Path(name).name in case.changing and name in changed:
                    continue
                assert name in left or name not in old or name not in new, f"{name} is lost: {where}"
                assert name not in left or left[name] in known, f"{name} is no old or new output: {where}"
            for name in left.keys() - old.keys():
                # A new folder has something in it, unless it is meant to be empty.
                filled = any(n.startswith(f"{name}/") for n in new)
                left_over = filled and left[name] is None and not any(n.startswith(f"{name}/") for n in left)
                assert not left_over, f"{name} is left: {where}"
            # A scene is the old one or the new one, not something between. So is a model.
            for folder in {
                Path(name).parent for name in changed if Path(name).name in ("scene.json", "checkpoints.pth")
            }:
                files = SCENE_FILES | {"checkpoints.pth"}
                names = {n for n in old.keys() | new.keys() if Path(n).parent == folder and Path(n).name in files}
                scene = {name: left[name] for name in names if name in left}
                sides = [{name: side[name] for name in names if name in side} for side in (old, new)]
                assert scene in sides, f"{folder} is a mixture: {where}"
    # The last fault is no hindrance.
    status, said = run()
    assert status == 0, said
    assert contents(work).keys() == new.keys()


CODING = {
    "encode": Case(["encode", "scene", "-o", "out.c3gs"], 5),
    "encode over an old file": Case(["encode", "scene", "-o", "out.c3gs"], 5, [["encode", "other", "-o", "out.c3gs"]]),
    "decode": Case(["decode", "scene.c3gs", "-o", "deep/out"], 30),
    "decode over an old scene": Case(
        ["decode", "scene.c3gs", "-o", "out"], 34, [["decode", "other.c3gs", "-o", "out"]]
    ),
    "reconstruct": Case(["reconstruct", "scene.c3gs", "out.bin", "--trace", "trace.txt"], 9),
    "reconstruct over old files": Case(
        ["reconstruct", "scene.c3gs", "out.bin", "--trace", "trace.txt"],
        9,
        [["reconstruct", "other.c3gs", "out.bin", "--trace", "trace.txt"]],
    ),
    "gaussians": Case(["gaussians", "scene.c3gs", "camera.json", "out.json"], 5),
    "inspect": Case(["inspect", "scene.c3gs", "--html", "page.html"], 5),
    "inspect over an old page": Case(
        ["inspect", "scene.c3gs", "--html", "page.html"], 5, [["inspect", "other.c3gs", "--html", "page.html"]]
    ),
}
DRAWING = {
    "render": Case(["render", "scene.c3gs", "--cameras", "photos", "--size", "full", "-o", "images"], 20),
    "render over old images": Case(
        ["render", "scene.c3gs", "--cameras", "photos", "--size", "full", "-o", "images"],
        17,
        [["render", "other.c3gs", "--cameras", "photos", "--size", "full", "-o", "images"]],
    ),
    "render an orbit": Case(
        ["render", "scene.c3gs", "--cameras", "orbit", "--frames", "2", "-o", "images"],
        12,
    ),
    "eval": Case(["eval", "scene.c3gs", "photos", "--size", "full", "--holdout", "8", "--images", "images"], 12),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CODING)
def test_coding(name: str, inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    try_all(CODING[name], inputs, tmp_path, monkeypatch, capsys)


@pytest.mark.parametrize("name", DRAWING)
def test_drawing(name: str, inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    for package in ("numba", "PIL", "skimage", "scipy"):
        pytest.importorskip(package)
    from refcodec.render import view  # noqa: PLC0415

    if "orbit" in name:
        # Small images are as good.
        real = view.own_camera
        monkeypatch.setattr(view, "own_camera", lambda info: real(info).resized(16, 12))
    try_all(DRAWING[name], inputs, tmp_path, monkeypatch, capsys)


@pytest.mark.parametrize(
    "words",
    [
        ["digest", "scene.c3gs"],
        ["validate", "scene.c3gs"],
        ["inspect", "scene.c3gs", "--hex"],
        ["inspect", "scene.c3gs", "--json"],
        ["explain", "432"],
        ["eval", "scene.c3gs", "photos"],
    ],
)
def test_commands_that_write_nothing(words: list[str], inputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(inputs)
    before = contents(inputs)
    faults = Faults(inputs)
    with faults.watching() as points:
        assert main(words) == 0
    assert points == []
    assert contents(inputs) == before


@pytest.mark.parametrize(
    "words",
    [
        ["decode", "bad.c3gs", "-o", "new"],
        ["decode", "bad.c3gs", "-o", "scene"],
        ["reconstruct", "bad.c3gs", "new.bin", "--trace", "new.txt"],
        ["gaussians", "bad.c3gs", "camera.json", "new.json"],
        ["inspect", "bad.c3gs", "--html", "new.html"],
        ["render", "bad.c3gs", "-o", "new"],
        ["eval", "bad.c3gs", "photos", "--images", "new"],
        ["export", "bad.c3gs", "-o", "new.ply"],
    ],
)
def test_a_refused_file_makes_no_output(words: list[str], inputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if words[0] in ("render", "eval", "export"):
        pytest.importorskip("numba")
    monkeypatch.chdir(inputs)
    before = contents(inputs)
    assert main(words) == 1
    assert contents(inputs) == before


# --- learning ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_train(inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """Over the result of an uncompressed training. One training serves all runs: what is written is the same."""
    pytest.importorskip("torch")
    from refcodec.train import command  # noqa: PLC0415

    trained: dict[bool, Any] = {}
    real = command.Trainer

    def once(photographs: Any, settings: Any, device: str, given: None) -> Any:
        coded = settings.rate.weight > 0
        if coded not in trained:
            trained[coded] = real(photographs, settings, device, given=given)
            trained[coded].run(lambda _: None)
            result = trained[coded].result()
            trained[coded].result = lambda: result
        return trained[coded]

    report = command.report
    reports: dict[bool, Any] = {}

    def told_once(trainer: Any, result: Any) -> Any:
        coded = trainer is trained.get(True)
        if coded not in reports:
            reports[coded] = report(trainer, result)
        return reports[coded]

    monkeypatch.setattr(command, "Trainer", once)
    monkeypatch.setattr(command, "report", told_once)
    words = ["train", "photos", "-o", "out", "--steps", "2", "--set", "start.anchors=100"]
    case = Case(words, 30, [[*words, "--rate", "0"]])
    try_all(case, inputs, tmp_path, monkeypatch, capsys)


@pytest.mark.slow
def test_fit(inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """The state that a fit saves meanwhile is another matter (tests/train)."""
    pytest.importorskip("torch")
    from refcodec.train import fit  # noqa: PLC0415

    known: list[Any] = []
    real = fit.fit

    def once(*arguments: Any, **options: Any) -> Any:
        if not known:
            known.append(real(*arguments, **{**options, "state": None}))
        return known[0]

    monkeypatch.setattr(fit, "fit", once)
    case = Case(["fit", "points3D.txt", "-o", "deep/out", "--steps", "2"], 28)
    try_all(case, inputs, tmp_path, monkeypatch, capsys)


# --- for other programs, and from them --------------------------------------------------------------------------------

_QUICK = ("--iterations", "0", "--degree", "1")
EXPORTING = {
    suffix: Case(["export", "scene.c3gs", "-o", f"out{suffix}", *_QUICK], 4)
    for suffix in (".ply", ".spz", ".sog", ".glb")
} | {
    "over an old file": Case(
        ["export", "scene.c3gs", "-o", "out.ply", *_QUICK],
        4,
        [["export", "scene.c3gs", "-o", "out.ply", "--iterations", "0", "--degree", "0"]],
    ),
    "to photographs": Case(
        ["export", "scene.c3gs", "-o", "out.glb", *_QUICK, "--cameras", "photos", "--size", "16"], 4
    ),
}
# TorchScript counts what it makes.
_SCRIPTS = ("opacity_mlp.pt", "cov_mlp.pt", "color_mlp.pt")
SCAFFOLD = {
    "a new folder": Case(["export", "scene.c3gs", "-o", "deep/model", "--scaffold"], 30, changing=_SCRIPTS),
    "over an old folder": Case(
        ["export", "scene.c3gs", "-o", "model", "--scaffold"],
        30,
        [["export", "other.c3gs", "-o", "model", "--scaffold"]],
        _SCRIPTS,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPORTING)
def test_export_of_splats(name: str, inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    for package in ("numba", "PIL", "scipy", "skimage"):
        pytest.importorskip(package)
    from refcodec.export import views  # noqa: PLC0415

    monkeypatch.setattr(views, "AROUND", 9)
    monkeypatch.setattr(views, "SIDE", 16)
    case = EXPORTING[name]
    try_all(replace(case, run=partial(_without_hints, capsys=capsys)), inputs, tmp_path, monkeypatch, capsys)


def _without_hints(words: list[str], capsys: Any) -> int:
    """The command without the line that says what the views are."""
    status = main(words)
    lines = [line for line in capsys.readouterr().err.splitlines() if "photographs are taken at size" not in line]
    lines = [line for line in lines if "refcodec: the views are" not in line]
    print(*lines, sep="\n", end="\n" if lines else "", file=sys.stderr)
    return status


@pytest.mark.slow
@pytest.mark.parametrize("name", SCAFFOLD)
def test_export_of_a_scaffold(name: str, inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    pytest.importorskip("torch")
    case = replace(SCAFFOLD[name], run=partial(_without_hints, capsys=capsys))
    try_all(case, inputs, tmp_path, monkeypatch, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("old", [False, True])
def test_convert_a_model(old: bool, inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("scipy")
    from family import LAYOUTS, Model  # noqa: PLC0415

    start = tmp_path / "start"
    for number, layout in enumerate(("hac", "scaffold, plain")):
        Model(LAYOUTS[layout]).write(start / f"model{number}")
    output = "out" if old else "deep/out"
    case = Case(["convert", "model0", "-o", output], 12, [["convert", "model1", "-o", output]] if old else [])
    try_all(case, start, tmp_path, monkeypatch, capsys)


@pytest.mark.slow
@pytest.mark.parametrize("pictures", [False, True])
def test_convert_splats(pictures: bool, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """With the pictures of the splats as a second output. One training serves all runs."""
    for package in ("torch", "numba", "PIL", "scipy", "skimage"):
        pytest.importorskip(package)
    from writers import made, write_plain  # noqa: PLC0415

    from refcodec.train import command  # noqa: PLC0415

    start = tmp_path / "start"
    start.mkdir()
    write_plain(made(200, 1), start / "a.ply")
    trained: list[Any] = []
    real, report = command.Trainer, command.report

    def once(*arguments: Any, **options: Any) -> Any:
        if not trained:
            trained.append(real(*arguments, **options))
            trained[0].run(lambda _: None)
            result = trained[0].result()
            trained[0].result = lambda: result
            told = report(trained[0], result)
            monkeypatch.setattr(command, "report", lambda trainer, result: told)
        return trained[0]

    monkeypatch.setattr(command, "Trainer", once)
    words = ["convert", "a.ply", "-o", "deep/out", "--views", "8", "--size", "24", "--steps", "2"]
    words += ["--set", "start.anchors=100", *(["--pictures", "other/pictures"] if pictures else [])]
    try_all(Case(words, 50), start, tmp_path, monkeypatch, capsys)


# --- demo and rd ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_rd(inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """A folder in which all commands are done: the table and the chart."""
    for package in ("torch", "matplotlib", "bjontegaard"):
        pytest.importorskip(package)
    from refcodec.experiments import rd, runs  # noqa: PLC0415
    from refcodec.experiments.data_set import DataSet  # noqa: PLC0415

    start = tmp_path / "start"
    shutil.copytree(inputs, start)
    monkeypatch.chdir(start)
    photographs = DataSet(Path("photos"), "16", "auto", 8, ("--preset", "fast"))
    settings = rd.Settings(Path("curve"), photographs, 2)
    notes = runs.Notes.open(settings.folder, rd.NOTES, rd.FORMAT)
    figures = {"bytes": 100, "parts": {}, "anchors": 5, "mean": dict.fromkeys(rd.FIGURES, 20.0), "images": []}
    for made in settings.chain(0.01):
        made.output.parent.mkdir(exist_ok=True)
        made.output.write_text(json.dumps(figures))
        notes.begin(made)
        notes.end(made, 1.0, True)
    words = ["rd", "photos", "-o", "curve", "--rates", "0.01", "--size", "16"]
    quiet = partial(_only_last_line, capsys=capsys)
    try_all(Case(words, 10, run=quiet), start, tmp_path, monkeypatch, capsys)


def _only_last_line(words: list[str], capsys: Any) -> int:
    """The command without its lines of progress."""
    status = main(words)
    lines = [line for line in capsys.readouterr().err.splitlines() if ": done before" not in line]
    print(*lines, sep="\n", end="\n" if lines else "", file=sys.stderr)
    return status


def test_what_runs_commands(tmp_path: Path, monkeypatch: Any) -> None:
    """The notes of demo and rd, and the outputs that are printed."""
    from refcodec.experiments import runs  # noqa: PLC0415

    monkeypatch.setattr(runs, "PROGRAM", (sys.executable, "-S", "-c", "print('new')"))
    folder = tmp_path / "out"
    faults = Faults(folder)

    def run() -> None:
        notes = runs.Notes.open(folder, "notes.json", "a format")
        runs.Runner(notes, lambda name, text: None, 1).run(
            [[runs.Command("x", ("a",), folder / "x.json", printed=True)]]
        )

    def fresh() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        runs.Notes.open(folder, "notes.json", "a format")
        (folder / "x.json").write_text("old\n")

    fresh()
    with faults.watching():
        run()
    count = len(faults.points)
    print(f"notes and runner: {count} points")
    assert count >= 14
    for number in range(count):
        for error in (full, KeyboardInterrupt):
            fresh()
            with faults.watching(number, error), pytest.raises((OSError, KeyboardInterrupt)):
                run()
            assert {p.name for p in folder.iterdir()} <= {"notes.json", "x.json"}
            assert (folder / "x.json").read_text() in ("old\n", "new\n")
            json.loads((folder / "notes.json").read_text())


# --- the suite's commands ---------------------------------------------------------------------------------------------


def test_report(inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    """One run of a decoder serves all: its report is what is written."""
    from conformance.cli import running  # noqa: PLC0415

    known: list[Any] = []
    real = running.run

    def once(*arguments: Any, **options: Any) -> Any:
        if not known:
            known.append(real(*arguments, **options))
        return known[0]

    monkeypatch.setattr(running, "run", once)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    decoder = [sys.executable, "-m", "conformance.spec_decoder", "decode", "{input}", "{output}"]
    words = ["run", "--vectors", "suite", "--jobs", "1", "--report", "report", "--", *decoder]
    # The decoder runs before faults are counted: what a runner does elsewhere is not of the report.
    other = [word.replace("report", "other") for word in words]
    other[other.index("--other")] = "--report"
    case = Case(words, 14, old=[other], changing=("report.json", "report.xml", "report.html"), run=suite_cli)
    try_all(case, inputs, tmp_path, monkeypatch, capsys)


@pytest.mark.slow
def test_export(inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    case = Case(["export", "--vectors", "suite", "--fluster", "out"], 25, run=suite_cli)
    try_all(case, inputs, tmp_path, monkeypatch, capsys)


def test_generate(inputs: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    from conformance import cases  # noqa: PLC0415
    from conformance.cases import suite  # noqa: PLC0415

    document = {"id": "valid-a"}
    monkeypatch.setattr(cases, "recipes", list)
    monkeypatch.setattr(suite, "vectors", lambda recipes: [(document, {"valid/a.c3gs": b"a"})])
    case = Case(["generate", "-o", "suite"], 29, run=suite_cli)
    try_all(case, inputs, tmp_path, monkeypatch, capsys)
