"""The commands `experiment` and `rd`: their folders, their messages, and the engine Ray. Training is simulated."""

import csv
import os
import re
import sys
from collections.abc import Callable
from concurrent import futures
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from refcodec.cli.main import main
from refcodec.experiments import on_ray
from refcodec.experiments.cells import read_result
from refcodec.experiments.jobs import Job, Outcome, RunError
from refcodec.experiments.plan import read_experiment, scene_name
from refcodec.files.lock import hold_folder

PHOTOGRAPHS = Path(__file__).resolve().parents[2] / "examples" / "photographs" / "caliterra"
NAMES = ["one/a/lambda-0.01/seed-0", "one/a/lambda-0.04/seed-0", "one/whole/lambda-0/seed-0"]
Call = Callable[..., tuple[int, list[str], str]]


@pytest.fixture
def call(place: Path, capsys: pytest.CaptureFixture[str]) -> Call:
    """Calls the command: its status, the cells that it began, and all that it printed."""

    def called(*words: str) -> tuple[int, list[str], str]:
        status = main(["experiment", str(place / "x.toml"), "-o", str(place / "out"), *words])
        printed = "".join(capsys.readouterr())
        return status, re.findall(r"^(\S+) begins$", printed, re.MULTILINE), printed

    return called


def change(place: Path, old: str, new: str) -> None:
    path = place / "x.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_an_experiment(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    out = place / "out"
    monkeypatch.setenv("FAKE_FAIL", "0.01")
    status, begun, printed = call("--jobs", "1")
    assert (status, begun) == (70, NAMES)
    assert f"cell {NAMES[0]} has failed" in printed
    assert "it went wrong" in printed
    assert "1 of 3 cells failed" in printed
    assert [one["lambda_r"] for one in table(out)] == ["0.04", "0"]
    assert f"1 of 3 cells are missing: {NAMES[0]}" in (out / "tables.md").read_text()
    monkeypatch.delenv("FAKE_FAIL")
    assert call()[:2] == (0, [NAMES[0]])
    assert "missing" not in (out / "tables.md").read_text()
    for one in table(out):
        folder = out / "cells" / one["scene"] / one["method"] / f"lambda-{one['lambda_r']}" / "seed-0"
        if one["lambda_r"] != "0":
            assert int(one["bytes"]) == (folder / "work" / "scene.c3gs").stat().st_size
        result = read_result(folder)
        assert float(one["psnr"]) == pytest.approx(result.mean.psnr, rel=1e-5)
        assert [image.psnr - result.mean.psnr for image in result.images] == pytest.approx([-1, 0, 1])
    assert {path.name for path in (out / "curves").iterdir()} == {"one.png", "one.svg"}
    # Again: no cell, and every byte is the same; nor with other jobs and threads.
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert call("--jobs", "1", "--threads", "1")[:2] == (0, [])
    assert {path: path.read_bytes() for path in before} == before
    # A result that is cut or changed is made again, and the same; its commands are not run again.
    result_file = out / "cells" / NAMES[0] / "result.json"
    whole = result_file.read_text()
    for text in (whole[:-20], whole.replace('"steps": 2', '"steps": 3', 1), "[]"):
        result_file.write_text(text)
        assert call()[:2] == (0, [NAMES[0]])
    assert {path: path.read_bytes() for path in before} == before
    # Results do not depend on the place of the photographs.
    (place / "photographs").rename(place / "elsewhere")
    change(place, '"photographs"', '"elsewhere"')
    assert call()[:2] == (0, [])
    # A setting more for one method runs that method only. A seed more is missing with each lambda_r and method.
    change(place, 'name = "a"', 'name = "a"\nset = ["masks.epsilon=0.02"]')
    assert call()[:2] == (0, NAMES[:2])
    change(place, "[0]", "[0, 1]")
    more = [name.replace("seed-0", "seed-1") for name in NAMES]
    assert f"3 of 6 cells are missing: {', '.join(more)}" in call("--tables")[2]
    # With another photograph all of its scene is run again.
    first = next((place / "elsewhere" / "images").iterdir())
    first.write_bytes(first.read_bytes() + b"\0")
    assert len(call()[1]) == 6


def test_tables_only(place: Path, call: Call) -> None:
    """Also while another call runs, and where the photographs are not."""
    assert call("--only", "*/whole/*")[:2] == (0, NAMES[2:])
    (place / "photographs").rename(place / "gone")
    with hold_folder(place / "out"):
        status, begun, printed = call("--tables")
        assert (status, begun) == (0, [])
        assert call("--only", "one/a*")[0] == 64
    assert f"2 of 3 cells are missing: {', '.join(NAMES[:2])}" in printed
    assert [one["method"] for one in table(place / "out")] == ["whole"]


def test_errors(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*words: str) -> str:
        status, begun, printed = call(*words)
        assert (status, begun) == (64, [])
        return printed

    assert "no cell has a name like two/*" in refused("--only", "two/*")
    with hold_folder(place / "out"):
        assert "another run writes to" in refused()
    monkeypatch.setitem(sys.modules, "ray", None)
    assert "pip install 'refcodec[ray]'" in refused("--engine", "ray")
    change(place, '"photographs"', '"none"')
    assert "scene one: " in refused()
    change(place, '"none"', '"photographs"')
    (place / "out" / "experiment.json").write_text("{}")
    assert "choose another one" in refused()
    (place / "x.toml").unlink()
    assert "No such file" in refused()


# --- rd ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("fake")
def test_rd(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The options of train are in the experiment's file. A curve is compared with that of a table."""
    out = tmp_path / "curve"
    given = "--background 9,20,30 --holdout 30 --anchors 700 --up=-z --static --set masks.epsilon=0.02"
    command = ["rd", str(PHOTOGRAPHS), "-o", str(out), "--steps", "2", "--size", "40", *given.split(), "--lambdas"]
    assert main([*command, "0.04", "--uncompressed"]) == 0
    assert "| coded | 0.04 | 1 |" in capsys.readouterr().out
    experiment = read_experiment(out / "experiment.toml")
    (scene,) = experiment.scenes
    assert (scene.photographs, scene.size, scene.holdout, scene.up) == (str(PHOTOGRAPHS), "40", 30, "-z")
    assert experiment.methods[0].static
    assert scene.changes == ("background=9,20,30", "start.anchors=700", "masks.epsilon=0.02")
    # More points: the others are not trained again.
    assert main([*command, "0.04", "0.01", "0.004", "0.002"]) == 0
    assert "1 of 4 cells are done before" in capsys.readouterr().err
    other = tmp_path / "other.csv"
    rows = [f"{int(row['bytes']) * 1.25},{row['psnr']}\n" for row in table(out)]
    other.write_text("".join(["bytes,psnr\n", *rows]))
    assert main([*command, "0.04", "0.01", "0.004", "0.002", "--against", str(other)]) == 0
    assert "BD-rate -20.00 %" in capsys.readouterr().out
    assert str(other) in (out / "curves" / "caliterra.svg").read_text()
    # Before any training: too few points, tables that are none, and a reference that would be overwritten.
    for text, words in (("bytes,psnr\n1,30\n", "needs 4 points"), ("bytes,psnr\n1,x\n", "not a table"), ("", "needs")):
        other.write_text(text)
        assert main([*command, "0.03", "--against", str(other)]) == 64
        assert words in capsys.readouterr().err
    assert main([*command, "0.04", "0.01", "0.004", "0.002", "--against", str(out / "results.csv")]) == 64
    for wrong in ("--holdout -1", "--set masks.epsilom=1", "--background grey", "--set rate.lambda_r=0.1"):
        assert main([*command, "0.04", "-o", str(tmp_path / "none"), *wrong.split()]) == 64
    assert not (tmp_path / "none").exists()
    names = [scene_name(Path("/a", name)) for name in ("b_1.c", "a b/", ".é.", "x" * 70)]
    assert names == ["b_1.c", "a-b", "scene", "x" * 64]


# --- Ray --------------------------------------------------------------------------------------------------------------


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Ray, as far as the engine uses it: a task runs in a thread. asked: the options of the last one."""
    pool, fake = futures.ThreadPoolExecutor(), SimpleNamespace(connected=False)

    def init(**options: Any) -> None:
        if os.environ.get("RAY_ADDRESS"):
            raise ConnectionError("nobody\nis there")
        fake.connected = options["num_cpus"] == os.cpu_count()

    def remote(function: Callable[..., Any]) -> Any:
        def options(**asked: Any) -> Any:
            fake.asked = asked
            return SimpleNamespace(remote=lambda *arguments: pool.submit(function, *arguments))

        return SimpleNamespace(options=options)

    fake.init, fake.remote, fake.get = init, remote, lambda reference: reference.result()
    fake.wait = lambda references, timeout: futures.wait(references, 0.01)
    fake.shutdown, fake.exceptions = lambda: setattr(fake, "connected", False), SimpleNamespace(RayError=LookupError)
    fake.cluster_resources = lambda: {"CPU": 4.0, "GPU": 2.0}
    monkeypatch.setitem(sys.modules, "ray", fake)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    return fake


def test_ray(tmp_path: Path, ray: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """A job runs, receives the signal, or is lost. Processors and GPUs are counted."""

    def fake(job: Job, wanted: Callable[[], int]) -> Outcome:
        if job.name == "lost":
            raise LookupError("the machine was lost")
        while job.name == "stopped" and not wanted():
            pass
        return Outcome(job.name, 130 if wanted() else 0)

    monkeypatch.setattr(on_ray, "run_job", fake)
    with on_ray.on_ray(tmp_path, None, 1, 0) as (room, run):
        job = Job("done", tmp_path / "record.json", ())
        assert (room, ray.connected, ray.asked) == (4, True, {"num_cpus": 1, "num_gpus": 0})
        assert run(job, lambda: 0).status == 0
        assert run(Job("lost", job.record, ()), lambda: 0).text == "Ray: the machine was lost"
        assert run(Job("stopped", job.record, ()), lambda: 2).status == 130
    assert (ray.connected, list(tmp_path.iterdir())) == (False, [])
    for asked, expected in (((None, 1, 1), 2), ((None, 3, 0), 1), ((3, 1, 0), 3)):
        with on_ray.on_ray(tmp_path, *asked) as (room, _):
            assert room == expected
    with pytest.raises(RunError, match="5 processors"), on_ray.on_ray(tmp_path, None, 5, 0):
        pass
    monkeypatch.setenv("RAY_ADDRESS", "somewhere:6379")
    with pytest.raises(RunError, match="Ray: nobody is there"), on_ray.on_ray(tmp_path, None, 1, 0):
        pass
