"""{commands} x {failures of outputs} x {what must be left}, and outputs that no command replaces.

After each fault the inputs are unchanged, each output is the old one or the complete new one, no other file is left,
and the command has printed one line. The next run succeeds, regardless of the files that were left.
"""

import errno
import json
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from cli_inputs import CALITERRA, EXAMPLE, VECTORS, Call, contents, inputs, lacking, packages, rows

from conformance.cli import main as suite
from conformance.spec_decoder.__main__ import main as second
from refcodec import statuses
from refcodec.cli.main import main
from refcodec.files.interrupts import SIGNALS

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


PROGRAMS: dict[str, Callable[[list[str]], int]] = {"suite": suite, "second": second}


def run(words: str) -> int:
    """Runs a command of refcodec, of the suite, or of the second decoder."""
    words = words.replace("DECODER", f"{sys.executable} -m conformance.spec_decoder decode {{input}} {{output}}")
    program, *rest = words.replace("VECTORS", str(VECTORS)).split()
    return PROGRAMS[program](rest) if program in PROGRAMS else main([program, *rest])


# A command, one that makes older outputs first, names of outputs that differ each time, and packages that it needs. The
# state that a fit saves meanwhile is tested in tests/train. All cells of rd are done: it writes tables and curves.
CASES = rows(
    """
    encode scene -o out.c3gs | encode other -o out.c3gs
    decode scene.c3gs -o deep/out | | | slow
    decode scene.c3gs -o out | decode other.c3gs -o out
    reconstruct scene.c3gs out --trace t | reconstruct VECTORS/valid/minor-1-four-bytes.c3gs out --trace t | | slow
    gaussians scene.c3gs camera.json out.json | | | slow
    inspect scene.c3gs --html page.html | inspect other.c3gs --html page.html | | slow
    render scene.c3gs --cameras photos --size 16 -o a | render other.c3gs --cameras photos --size 16 -o a | | DRAW
    render scene.c3gs --cameras orbit --frames 2 -o images | | | DRAW slow
    eval scene.c3gs photos --size 16 --holdout 8 --images images | | | DRAW slow
    export scene.c3gs -o out.glb FIT 1 --cameras photos --size 16 | export scene.c3gs -o out.glb FIT 0 | | DRAW slow
    train photos -o out --steps 2 START | decode other.c3gs -o out | | torch DRAW slow
    fit points3D.txt -o deep/out --steps 2 | | | torch scipy slow
    convert model0 -o out | convert model1 -o out | | torch scipy slow
    convert a.ply -o deep/out --views 8 --size 24 --steps 2 START --pictures other/p | | | torch DRAW slow
    rd photos -o curve --lambdas 0.01 --size 16 | | | torch matplotlib bjontegaard slow
    RUN --report a -- DECODER | RUN --report b -- DECODER | REPORTS
    suite generate -o suite
    """.replace("DRAW", "numba PIL scipy skimage")
    .replace("FIT", "--iterations 0 --degree")
    .replace("START", "--set start.anchors=100")
    .replace("RUN", "suite run --vectors suite --jobs 1")
    .replace("REPORTS", "report.json report.html"),
    4,
)


def more_inputs(words: str) -> None:
    """Makes the inputs of one command in the working folder."""
    if "model0" in words:
        family: Any = import_module("family")
        for number, layout in enumerate(("hac", "scaffold, plain")):
            family.Model(family.LAYOUTS[layout]).write(Path(f"model{number}"))
    if "a.ply" in words:
        plain: Any = import_module("plain")
        plain.write(plain.made(200, 1), Path("a.ply"))
    if words.startswith("rd"):
        finished_curve(Path("curve"))


def finished_curve(folder: Path) -> None:
    """Makes the result of the only cell of an experiment."""
    from refcodec.experiments import cells, command, jobs, plan  # noqa: PLC0415

    (cell,) = cells.cells(plan.one_scene(Path("photos"), {"size": "16"}, [0.01], False, None))
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


def shorten(words: str, patch: pytest.MonkeyPatch) -> None:
    """Makes work before the outputs short, and does it once."""

    def once(module: str, name: str, after: Callable[[Any], None] = lambda value: None, **fixed: Any) -> None:
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

    if "orbit" in words:
        view: Any = import_module("refcodec.rendering.view")
        real = view.own_camera
        patch.setattr(view, "own_camera", lambda info: real(info).resized(16, 12))
    if ".glb" in words:
        patch.setattr("refcodec.export.views.AROUND", 9)
        patch.setattr("refcodec.export.views.SIDE", 16)
    if words.startswith(("train", "convert a")):
        once("refcodec.train.command", "Trainer", trained)
        once("refcodec.train.command", "report")
    if words.startswith("fit"):
        once("refcodec.train.fit", "fit", state=None)
    if words.startswith("suite run"):
        patch.setenv("PYTHONPATH", str(TESTS.parent))
        once("conformance.cli.running", "run")
    if words.startswith("suite generate"):
        patch.setattr("conformance.cases.recipes", list)
        patch.setattr(
            "conformance.cases.suite.vectors", lambda recipes: [({"operation": "gaussians"}, {"valid/a": b""})]
        )


@pytest.mark.parametrize(
    ("words", "older", "changing", "needs"),
    [pytest.param(*row, id=row[0][:30], marks=[pytest.mark.slow] * ("slow" in row[3])) for row in CASES],
)
def test_faults(
    words: str, older: str, changing: str, needs: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    if not packages(*needs.replace("slow", "").split()):
        pytest.skip(f"needs {needs}")
    before, work = tmp_path / "before", tmp_path / "work"
    shutil.copytree(inputs(), before)
    monkeypatch.chdir(before)
    more_inputs(words)
    shorten(words, monkeypatch)
    assert not older or run(older) == 0
    faults, old = Faults(work), contents(before)

    def tried(at: int = -1, error: Callable[[], BaseException] = RuntimeError) -> tuple[int, list[str]]:
        if at >= 0 or not work.exists():
            monkeypatch.chdir(tmp_path)
            shutil.rmtree(work, ignore_errors=True)
            shutil.copytree(before, work)
            monkeypatch.chdir(work)
        capsys.readouterr()
        with faults.watching(at, error):
            status = run(words)
        return status, [line for line in capsys.readouterr().err.splitlines() if not NOTES.match(line)]

    status, message = tried()
    assert status == 0, message
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
        ends = signal.SIGINT if words.startswith("suite") else SIGNALS[number % len(SIGNALS)]
        for error, expected in (
            (lambda point=point: fault_of(point), statuses.USAGE),
            (lambda ends=ends: signalled(ends), statuses.INTERRUPTED),
        ):
            status, message = tried(number, error)
            where = f"{point} (point {number}), {expected}: {message}"
            assert status == expected, where
            assert len(message) == 1, where
            assert not re.search(r" output:|\.refcodec-", message[0]), where
            left = contents(work)
            for name in old.keys() | left.keys():
                assert name in left or name not in old or name not in new, f"{name} is lost: {where}"
                known = [side[name] for side in (old, new) if name in side]
                free = Path(name).name in changing.split() and name in changed
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
    status, message = tried()
    assert status == 0, message
    assert contents(work).keys() == new.keys()


NOTHING = (
    *("digest scene.c3gs", "validate scene.c3gs", "inspect scene.c3gs --hex", "inspect scene.c3gs --json"),
    *("explain 432", "eval scene.c3gs photos"),
)


@pytest.mark.parametrize("command", NOTHING)
def test_nothing_is_written(command: str, place: Path) -> None:
    """By commands without outputs, which do not try."""
    if lacking(command):
        pytest.skip("needs numba")
    before, faults = contents(place), Faults(place)
    with faults.watching() as points:
        assert main(command.split()) == 0
    assert points == []
    assert contents(place) == before


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


# --- what no command replaces -----------------------------------------------------------------------------------------

# What is in the place of a file.
ELSE = {"dangling": "ln -s nowhere {}", "circle": "ln -s self {}", "pipe": "mkfifo {}", "directory": "mkdir {}"}
# The command that is refused, what it says, steps before, and packages that it needs.
REFUSED = rows(
    """
    reconstruct scene.c3gs out --trace scene.c3gs | is not a symbol trace
    reconstruct scene.c3gs out --trace letter.txt | is not a symbol trace
    reconstruct scene.c3gs out --trace ./out | are one file
    # A trace that is a file as C3GS knows it, and a link to it.
    reconstruct trace out --trace hard | is read | refcodec reconstruct scene.c3gs out --trace trace; ln trace hard
    # An empty file may be replaced, but not if it is read.
    reconstruct empty link | is read | touch empty; ln -s empty link
    gaussians scene.c3gs empty link | is read | touch empty; ln -s empty link
    gaussians empty camera.json ./empty | is read | touch empty
    encode scene -o hard | not a C3GS file | ln scene/scene.json hard
    encode scene -o scene/new.c3gs | are read
    encode scene -o letter.txt | not a C3GS file
    decode scene/ancillary_0_noTE.bin -o scene | is read | mv scene.c3gs scene/ancillary_0_noTE.bin
    decode scene.c3gs -o photos | not a scene folder
    inspect scene.c3gs --html letter.txt | not a page
    inspect scene.c3gs --html scene.c3gs | not a page
    inspect scene.c3gs --html mine.html | not a page | echo '<!DOCTYPE html><title>mine</title>' > mine.html
    inspect scene.c3gs --html photos | is a directory
    fit scene -o scene | read | | torch
    fit scene/point_cloud.ply -o scene | read | | torch
    fit scene -o new | saved state | echo precious > new.fit-state | torch
    train scene -o new | saved state | echo precious > new.train-state | torch numba
    fit scene -o new | --resume, or remove it | STATE > new.fit-state | torch
    train scene -o new | --resume, or remove it | STATE > new.train-state | torch numba
    train photos -o new --log mine.csv | is not the log of a training | echo a,b > mine.csv | torch numba
    train photos -o new --log none/log.csv | there is no directory | | torch numba
    train photos -o new --log photos | is not a folder of TensorBoard | | torch numba
    train photos -o new --log letter.txt | neither a .csv file nor a folder | | torch numba
    train photos -o new --log way/l/log.csv | whose files are read | ln -s photos way | torch numba
    # coded.safetensors counted as absent, and encode quantised anew silently. Nor does an uncompressed scene.
    encode scene -o out | not a file | rm scene/coded.safetensors; ELSE scene/coded.safetensors
    render scene -o images | render.json | ELSE scene/render.json | numba
    fit scene -o new | render.json | ELSE scene/render.json | torch
    render scene.c3gs --cameras photos -o photos | photos | | numba
    render scene.c3gs --cameras photos -o photos/l/.. | is read | | numba
    render scene.c3gs --cameras photos -o way | photos | ln -s photos way | numba
    eval scene.c3gs photos --images photos | photos | | numba
    # What is not a photograph of this run is still not refcodec's.
    render scene.c3gs --cameras photos -o album | refcodec wrote | mkdir -p album/l; cp photos/l/0.png album/l | numba
    render scene.c3gs --cameras photos -o a | read | refcodec render scene.c3gs --cameras photos -o a; LINK | numba
    render scene.c3gs --cameras orbit --frames 2 -o a | animation | mkdir a; printf GIF89a > a/orbit.gif | numba
    # The suite removed folders with the names of classes.
    suite generate -o . | not a conformance suite | mkdir valid; echo precious > valid/thesis.txt
    suite run --report . --select id:valid-plain -- sh {input} {output} | not a report | echo mine > report.json
    suite run --report . --select id:valid-plain -- sh {input} {output} | not a report | echo mine > report.html
    suite run --report VECTORS --select id:valid-plain -- sh {input} {output} | are read
    second decode scene.c3gs scene.c3gs
    second decode scene.c3gs out --trace scene.c3gs
    second decode scene.c3gs out --trace out
    second decode scene.c3gs hard | | ln scene.c3gs hard
    """.replace("STATE", """printf '12345678{"__metadata__":{"format":"C3GS training state"}}'"""),
    4,
)
EACH = [row for row in REFUSED if "ELSE" not in row[2]]
EACH += [
    [*row[:2], row[2].replace("ELSE scene", step.format("scene").replace("self", row[2].rpartition("/")[2])), row[3]]
    for row in REFUSED
    if "ELSE" in row[2]
    for step in ELSE.values()
]


@pytest.mark.parametrize(("words", "message", "steps", "needs"), EACH)
def test_refused(words: str, message: str, steps: str, needs: str, place: Path, capsys: Any) -> None:
    """Status 64, one line, and nothing changed."""
    if not packages(*needs.split()):
        pytest.skip(f"needs {needs}")
    for step in steps.replace("LINK", "ln a/l/0.png photos/l/2.png").split("; ") if steps else []:
        if step.startswith("refcodec "):
            assert main(step.split()[1:]) == 0
        else:
            subprocess.run(step, shell=True, check=True)
    before = contents(place)
    capsys.readouterr()
    assert run(words) == 64
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1, err
    assert contents(place) == before


def test_a_refused_file_leaves_its_outputs(place: Path, call: Call) -> None:
    assert call("reconstruct", "scene.c3gs", "out", "--trace", "trace")[0] == 0
    before = contents(place)
    assert len(Path("trace").read_text().splitlines()) > 100
    assert call("reconstruct", "bad.c3gs", "out", "--trace", "trace")[0] == 1
    assert call("decode", "bad.c3gs", "-o", "scene")[0] == 1
    assert contents(place) == before


def test_outputs_that_are_no_plain_files(place: Path, call: Call) -> None:
    """A pipe is written to, a link stays, and rights are the usual ones. A missing file may be missing."""
    done = subprocess.run(
        f"{sys.executable} -m refcodec encode scene -o /dev/stdout | cat", shell=True, capture_output=True, check=False
    )
    assert (done.stdout, done.stderr.count(b"\n")) == (Path("scene.c3gs").read_bytes(), 1)
    Path("link").symlink_to("scene.c3gs")
    before = os.umask(0o022)
    try:
        assert call("encode", "scene", "-o", "link")[0] == call("decode", "scene.c3gs", "-o", "new")[0] == 0
    finally:
        os.umask(before)
    assert Path("link").is_symlink()
    assert {stat.S_IMODE(f.stat().st_mode) for f in (Path("scene.c3gs"), *Path("new").iterdir())} == {0o644}
    Path("scene/coded.safetensors").unlink()
    assert call("encode", "scene", "-o", "out")[0] == 0


def test_images_keep_apart(place: Path, call: Call) -> None:
    if not packages("numba"):
        pytest.skip("needs numba")
    for _ in range(2):
        assert "4 images" in call("render", "scene.c3gs", "--cameras", "photos", "-o", "out")[1]
    images = [p for p in Path("out").rglob("*") if p.is_file()]
    assert {p.relative_to("out").as_posix() for p in images} == {"l/0.png", "r/0.png", "l/1.png", "r/1.png"}
    assert len({p.read_bytes() for p in images}) == 4


def test_names_of_images() -> None:
    pytest.importorskip("PIL")
    from refcodec.rendering.images import image_names  # noqa: PLC0415

    for cameras, names in {
        ("l/0.png", "r/0.png", "plain"): ["l/0.png", "r/0.png", "plain.png"],
        ("0.jpg", "0.tif", "0.jpg", "0.jpg"): ["0.png", "0.tif.png", "0.jpg.png", "0.jpg-2.png"],
        # A system may take these for one name.
        ("a.jpg", "A.jpg"): ["a.png", "A.jpg.png"],
        # A name cannot be that of a file and of a folder.
        ("a.jpg", "a.png/b.jpg"): ["a.png", "a.png_b.jpg-2.png"],
        ("a.png/b.jpg", "a.jpg"): ["a.png/b.png", "a.jpg.png"],
        # None leads out of the folder.
        ("/x/../../y.jpg", "", ".."): ["x/y.png", "image.png", "image-2.png"],
    }.items():
        assert image_names(cameras) == names


def test_a_link_in_the_place_of_a_training_s_report(place: Path, call: Call) -> None:
    pytest.importorskip("numba")
    assert call("decode", EXAMPLE, "-o", "tiny")[0] == 0
    Path("tiny/training.json").symlink_to("nowhere")
    status, _, err = call("eval", "tiny", CALITERRA)
    assert (status, "a link that leads nowhere" in err) == (64, True)


# --- runs at once -----------------------------------------------------------------------------------------------------


def together(count: int, *words: str) -> list[tuple[int, str]]:
    """The exit status and stderr of some processes with one command."""
    command = [sys.executable, "-m", "refcodec", *words]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(count)]
    return [(p.returncode, message) for p in processes for message in [p.communicate(timeout=120)[1]]]


def test_decodes_at_once(place: Path, call: Call) -> None:
    """They shared a folder for what is not whole yet, and most failed. What a killed one leaves is no hindrance."""
    assert together(9, "decode", "scene.c3gs", "-o", "new") == [(0, "new: 6 anchors of scene.c3gs\n")] * 9
    new, old = ({p.name: p.read_bytes() for p in (place / name).iterdir()} for name in ("new", "scene"))
    assert new == old
    Path("new/.refcodec-incoming/old").mkdir(parents=True)
    Path("new/scene.json").rename("new/.refcodec-incoming/old/scene.json")
    assert call("decode", "scene.c3gs", "-o", "new")[0] == 0
    assert {p.name for p in (place / "new").iterdir()} == set(old)


@pytest.mark.slow
def test_one_fit_at_a_time(place: Path) -> None:
    """They share the state that is saved."""
    pytest.importorskip("torch")
    ends = together(3, "fit", "points3D.txt", "-o", "new", "--steps", "300")
    assert min(status for status, _ in ends) == 0, ends
    for status, message in ends:
        assert status in (0, 64)
        assert status == 0 or ("another run" in message and len(message.splitlines()) == 1)
    assert not list(place.glob("*.lock"))
