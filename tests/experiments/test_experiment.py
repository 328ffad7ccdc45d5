"""The command `experiment`: its commands, its files, and the equality of both engines."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable
from concurrent import futures
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

for package in ("numba", "PIL", "skimage", "scipy", "matplotlib", "bjontegaard", "torch"):
    pytest.importorskip(package, reason="experiments need the packages of the extras train, render and rd")

from refcodec import statuses  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.experiments import experiment as experiments  # noqa: E402
from refcodec.experiments import on_ray, runs  # noqa: E402
from refcodec.experiments.engines import Local, Stop  # noqa: E402
from refcodec.experiments.on_ray import OnRay  # noqa: E402
from refcodec.experiments.runs import RunError  # noqa: E402
from refcodec.experiments.work import Outcome, Task  # noqa: E402
from refcodec.files.lock import hold_folder  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
FAKE = (sys.executable, str(ROOT / "tests" / "experiments" / "fake_refcodec.py"))
TEXT = """
rates = [0.01, 0.04]
seeds = [0]
steps = 2
baseline = "a"
[[scenes]]
name = "one"
photographs = "photographs"
size = 40
[[methods]]
name = "a"
[[methods]]
name = "whole"
kind = "uncompressed"
"""
NAMES = ["one/a/rate-0.01/seed-0", "one/a/rate-0.04/seed-0", "one/whole/rate-0/seed-0"]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an experiment and its photographs; commands are those of the fake."""
    monkeypatch.setattr(runs, "PROGRAM", FAKE)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    shutil.copytree(ROOT / "examples" / "photographs" / "caliterra", tmp_path / "photographs")
    (tmp_path / "x.toml").write_text(TEXT)
    return tmp_path


Call = Callable[..., tuple[int, list[str], str]]


@pytest.fixture
def call(place: Path, capsys: pytest.CaptureFixture[str]) -> Call:
    """Calls the command: its status, the cells that it began, and all that it printed."""

    def called(*words: str) -> tuple[int, list[str], str]:
        status = main(["experiment", str(place / "x.toml"), "-o", str(place / "out"), *words])
        printed = "".join(capsys.readouterr())
        return status, re.findall(r"^(\S+) begins;", printed, re.MULTILINE), printed

    return called


def change(place: Path, old: str, new: str) -> None:
    path = place / "x.toml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def table(place: Path) -> list[dict[str, str]]:
    with (place / "out" / "results.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_what_is_done_is_not_done_again(place: Path, call: Call) -> None:
    status, begun, printed = call()
    assert (status, sorted(begun)) == (0, NAMES)
    assert "3 of 3 done, 0 running, 0 left" in printed
    assert "missing" not in printed
    out = place / "out"
    for one in table(place):
        work = out / "cells" / one["scene"] / one["method"] / f"rate-{one['rate']}" / "seed-0" / "work"
        if one["rate"] != "0":
            assert int(one["bytes"]) == (work / "scene.c3gs").stat().st_size
        assert float(one["psnr"]) == pytest.approx(20 + int(one["bytes"]) / 1000, rel=1e-5)
        assert float(one["processor_seconds"]) > 0
    assert {path.name for path in (out / "curves").iterdir()} == {"one.png", "one.svg"}
    assert (out / "experiment.toml").read_text() == TEXT
    # Again: no cell, and every byte is the same.
    before = tree(out)
    assert call()[:2] == (0, [])
    assert tree(out) == before
    # Nor with other jobs and threads.
    assert call("--jobs", "1", "--threads", "1")[:2] == (0, [])
    # A result that is cut, or of another hash, is made again; its commands are not.
    result = out / "cells" / NAMES[0] / "result.json"
    whole = result.read_text()
    for text in (whole[:-20], whole.replace('"steps": 2', '"steps": 3', 1), "[]"):
        result.write_text(text)
        assert call()[:2] == (0, [NAMES[0]])
        assert result.read_text() == whole
    # Nor do results depend on where things lie.
    (place / "elsewhere").mkdir()
    (place / "photographs").rename(place / "elsewhere" / "found")
    change(place, '"photographs"', '"elsewhere/found"')
    assert call()[:2] == (0, [])
    # A setting more for one method runs that method alone, and nothing is left of what it was before.
    change(place, 'name = "a"', 'name = "a"\nset = ["masks.epsilon=0.02"]')
    assert call()[:2] == (0, NAMES[:2])
    assert json.loads(result.read_text())["definition"]["settings"]["masks"]["epsilon"] == 0.02
    # A seed more is missing with each rate and method, and nothing else is.
    change(place, "[0]", "[0, 1]")
    more = [name.replace("seed-0", "seed-1") for name in NAMES]
    assert f"3 of 6 cells are missing: {', '.join(more)}." in call("--tables")[2]
    # With another photograph all of its scene is missing, and with a new date of the same one nothing.
    first = next((place / "elsewhere" / "found" / "images").iterdir())
    os.utime(first)
    assert "3 of 6 cells are missing" in call("--tables")[2]
    first.write_bytes(first.read_bytes() + b"\0")
    assert "6 of 6 cells are missing" in call("--tables")[2]


@pytest.mark.slow
def test_a_failing_cell_does_not_end_the_others(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_FAIL", "0.01")
    status, begun, printed = call("--jobs", "1")
    assert (status, begun) == (70, NAMES)
    assert f"cell {NAMES[0]} has failed" in printed
    assert "this command failed: refcodec train" in printed
    assert "it went wrong" in printed
    assert "1 of 3 cells failed" in printed
    assert "2 of 3 cells are in" in printed
    assert [one["rate"] for one in table(place)] == ["0.04", "0"]
    assert f"1 of 3 cells are missing: {NAMES[0]}." in (place / "out" / "tables.md").read_text()
    monkeypatch.delenv("FAKE_FAIL")
    assert call()[:2] == (0, [NAMES[0]])
    assert "missing" not in (place / "out" / "tables.md").read_text()


def test_tables_of_what_is_there(place: Path, call: Call) -> None:
    assert call("--tables")[:2] == (0, [])
    assert table(place) == []
    assert call("--only", "*/whole/*")[:2] == (0, NAMES[2:])
    # Also while another call runs, and where the photographs are not.
    (place / "photographs").rename(place / "gone")
    with hold_folder(experiments.Folder(place / "out").path):
        status, begun, printed = call("--tables")
        assert (status, begun) == (0, [])
        assert call("--only", "one/a*")[0] == 64
    assert f"2 of 3 cells are missing: {', '.join(NAMES[:2])}." in printed
    assert "The photographs of these scenes are missing: one" in printed
    assert [one["method"] for one in table(place)] == ["whole"]


def test_what_is_wrong_is_said(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*words: str) -> str:
        status, begun, printed = call(*words)
        assert (status, begun) == (64, [])
        assert printed.count("\n") == 1
        return printed

    assert "no cell has a name like two/*" in refused("--only", "two/*")
    with hold_folder(experiments.Folder(place / "out").path):
        assert "another run writes to" in refused()
    monkeypatch.setitem(sys.modules, "ray", None)
    status, _, printed = call("--engine", "ray")
    assert status == 64
    assert "pip install 'refcodec[ray]'" in printed
    change(place, '"photographs"', '"none"')
    assert "scene one: " in refused()
    change(place, '"none"', '"${C3GS_NOWHERE}"')
    assert "set the variable C3GS_NOWHERE" in refused()
    (place / "out" / "experiment.json").write_text("{}")
    assert "not the folder of an experiment" in refused()
    (place / "out" / "experiment.json").unlink()
    (place / "out" / "experiment.json").symlink_to("nowhere")
    assert "not the folder of an experiment" in refused()
    change(place, "steps", "stops")
    assert "has stops" in refused()
    (place / "x.toml").unlink()
    assert "No such file" in refused()


def test_the_command_needs_its_extras(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("refcodec.experiments.command", "refcodec.experiments.curves", "matplotlib", "matplotlib.figure"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    status, _, printed = call()
    assert status == 64
    assert "pip install 'refcodec[train,render,rd]'" in printed


# --- interrupted ------------------------------------------------------------------------------------------------------


def steps(place: Path, name: str) -> list[int]:
    """Of the made-up training, as its log has them."""
    return [int(n) for n in re.findall(r"step (\d+)", (place / "out" / "cells" / name / "log.txt").read_text())]


def started(place: Path, *words: str) -> subprocess.Popen[str]:
    """The command in a process of its own, after a training of it has begun."""
    arguments = ["experiment", str(place / "x.toml"), "-o", str(place / "out"), *words]
    program = f"import sys; from refcodec.experiments import runs; runs.PROGRAM = {FAKE!r}\n"
    program += f"from refcodec.cli.main import main; sys.exit(main({arguments!r}))"
    process = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    log = place / "out" / "cells" / NAMES[0] / "log.txt"
    while process.poll() is None and not (log.exists() and "step 3" in log.read_text()):
        pass
    return process


@pytest.mark.slow
def test_interrupted(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C: the training keeps what it has, no other cell begins, and the next call goes on."""
    change(place, "steps = 2", "steps = 400")
    monkeypatch.setenv("FAKE_STEP", "20")
    with started(place, "--jobs", "1") as process:
        process.send_signal(signal.SIGINT)
        _, printed = process.communicate(timeout=60)
    assert process.returncode == statuses.INTERRUPTED
    assert "stopped with 0 of 3 cells done" in printed
    assert NAMES[1] not in printed
    before = steps(place, NAMES[0])
    monkeypatch.setenv("FAKE_STEP", "0")
    assert call("--only", NAMES[0])[:2] == (0, [NAMES[0]])
    assert steps(place, NAMES[0])[len(before) :] == [*range(before[-1] + 1, 401)]


@pytest.mark.slow
def test_killed(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """A call that is killed leaves a training, which ends at the next line that nobody reads; the next call waits."""
    change(place, "steps = 2", "steps = 400")
    monkeypatch.setenv("FAKE_STEP", "20")
    with started(place, "--jobs", "1") as process:
        process.kill()
        process.communicate(timeout=60)
    assert not (place / "out" / "cells" / NAMES[0] / "result.json").exists()
    monkeypatch.setenv("FAKE_STEP", "0")
    assert call("--only", NAMES[0])[:2] == (0, [NAMES[0]])
    assert steps(place, NAMES[0])[-1] == 400


@pytest.mark.slow
def test_a_state_that_is_refused(place: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """A training that does not take its saved state begins anew at once. The state is kept if that fails, too."""
    only = ("--only", NAMES[0])
    monkeypatch.setenv("FAKE_FAIL", "0.01")
    assert call(*only)[0] == 70
    state = place / "out" / "cells" / NAMES[0] / "work" / "scene.train-state"
    monkeypatch.delenv("FAKE_FAIL")
    state.write_text("1")
    # The cell's own lines say whether it went on.
    assert call(*only)[0] == 0
    assert steps(place, NAMES[0]) == [2]
    real, refuse = runs.PROGRAM, "import sys; '--resume' in sys.argv and sys.exit(64); "
    change(place, "steps = 2", "steps = 3")
    monkeypatch.setattr(runs, "PROGRAM", (sys.executable, "-c", f"{refuse}sys.exit(70)"))
    assert call(*only)[0] == 70
    state.write_text("1")
    assert call(*only)[0] == 70
    assert state.read_text() == "1"
    others = f"import subprocess; sys.exit(subprocess.call([*{real!r}, *sys.argv[1:]]))"
    monkeypatch.setattr(runs, "PROGRAM", (sys.executable, "-c", f"{refuse}{others}"))
    assert call(*only)[0] == 0
    assert steps(place, NAMES[0])[-3:] == [1, 2, 3]
    assert [path.name for path in state.parent.iterdir() if "state" in path.name] == []


# --- engines ----------------------------------------------------------------------------------------------------------


def task(folder: Path, name: str, gpus: int = 0, threads: int = 1) -> Task:
    return Task(name, folder / name, (), {}, threads, gpus)


class FakeRay(types.ModuleType):
    """Ray, as far as the engine uses it: a task runs in a thread."""

    def __init__(self, **resources: float) -> None:
        super().__init__("ray")
        self.resources = resources
        self.exceptions = types.SimpleNamespace(RayError=LookupError)
        self.pool = ThreadPoolExecutor()
        self.asked: list[dict[str, Any]] = []
        self.connected: dict[str, Any] | None = None

    def init(self, **options: Any) -> None:
        assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"
        self.connected = options

    def shutdown(self) -> None:
        self.connected = None

    def cluster_resources(self) -> dict[str, float]:
        return self.resources

    def remote(self, function: Callable[..., Any]) -> Any:
        def options(**asked: Any) -> Any:
            self.asked.append(asked)
            return types.SimpleNamespace(remote=lambda *arguments: self.pool.submit(function, *arguments))

        return types.SimpleNamespace(options=options)

    def wait(self, references: list[Any], timeout: float) -> Any:
        return futures.wait(references, timeout / 50)

    def get(self, reference: Any) -> Any:
        return reference.result()


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> FakeRay:
    module = FakeRay(CPU=4.0, GPU=2.0)
    monkeypatch.setitem(sys.modules, "ray", module)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.delenv("RAY_USAGE_STATS_ENABLED", raising=False)
    return module


def ran(engine: Any, tasks: list[Task], stop: Stop | None = None) -> tuple[list[str], list[Outcome]]:
    begun: list[str] = []
    ended: list[Outcome] = []
    engine(tasks, stop or Stop(), lambda task: begun.append(task.name), ended.append)
    return begun, ended


def test_ray_counts_processors_and_gpus(tmp_path: Path, ray: FakeRay, monkeypatch: pytest.MonkeyPatch) -> None:
    def half(task: Task, wanted: Callable[[], int]) -> Outcome:
        assert ray.connected == {
            "log_to_driver": False,
            "logging_level": 40,
            "num_cpus": os.cpu_count(),
            "include_dashboard": False,
        }
        if task.name == "1":
            raise LookupError("the machine was lost")
        return Outcome(task.name, 0)

    monkeypatch.setattr(on_ray, "run_cell", half)
    rooms = []

    def one_at_a_time(jobs: int, run: Any) -> Local:
        rooms.append(jobs)
        return Local(1, run)

    monkeypatch.setattr(on_ray, "Local", one_at_a_time)
    names = [str(i) for i in range(6)]
    begun, ended = ran(OnRay(tmp_path, None), [task(tmp_path, name) for name in names])
    assert begun == [outcome.name for outcome in ended] == names
    assert [outcome.status for outcome in ended] == [0, 70, 0, 0, 0, 0]
    assert "the machine was lost" in ended[1].text
    assert ray.asked[0] == {"num_cpus": 1, "num_gpus": 0, "name": "0"}
    assert ray.connected is None
    # Two GPUs hold two cells, three threads hold one, and jobs are a bound.
    for one, jobs in (
        (task(tmp_path, "0", gpus=1), None),
        (task(tmp_path, "0", threads=3), None),
        (task(tmp_path, "0"), 3),
    ):
        ran(OnRay(tmp_path, jobs), [one])
        assert (ray.asked[-1]["num_cpus"], ray.asked[-1]["num_gpus"]) == (one.threads, one.gpus)
    assert rooms == [4, 2, 1, 3]
    assert list(tmp_path.iterdir()) == []


def test_ray_without_room_or_cluster(tmp_path: Path, ray: FakeRay, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RunError, match="5 processors"):
        ran(OnRay(tmp_path, None), [task(tmp_path, "0", threads=5)])
    ray.resources = {"CPU": 4.0}
    with pytest.raises(RunError, match="a GPU"):
        ran(OnRay(tmp_path, None), [task(tmp_path, "0", gpus=1)])
    assert ray.connected is None
    # A cluster has its own processors.
    monkeypatch.setenv("RAY_ADDRESS", "somewhere:6379")

    def refused(**options: Any) -> None:
        assert "num_cpus" not in options
        raise ConnectionError("nobody\nis there")

    monkeypatch.setattr(ray, "init", refused)
    with pytest.raises(RunError, match="Ray cannot be reached: nobody is there"):
        ran(OnRay(tmp_path, None), [task(tmp_path, "0")])


@pytest.mark.parametrize("kind", ["local", "ray"])
def test_stopping(tmp_path: Path, ray: FakeRay, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """Running tasks receive the signal, and no other begins."""
    stop, signals = Stop(), []

    def cell(task: Task, wanted: Callable[[], int]) -> Outcome:
        stop.number = signal.SIGINT
        # The task of Ray receives it with the engine's next look.
        while not wanted():
            time.sleep(0.01)
        signals.append(wanted())
        return Outcome(task.name, statuses.INTERRUPTED)

    monkeypatch.setattr(on_ray, "run_cell", cell)
    engine = OnRay(tmp_path, 1) if kind == "ray" else Local(1, cell)
    begun, ended = ran(engine, [task(tmp_path, str(i)) for i in range(5)], stop)
    assert begun == [outcome.name for outcome in ended] == ["0"]
    assert signals == [signal.SIGINT]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_same_files_by_both_engines(tmp_path: Path) -> None:
    """True training runs, by processes of this machine and by a Ray of this machine."""
    pytest.importorskip("ray", reason="the engine ray needs the extra ray")
    program = [sys.executable, "-m", "refcodec", "experiment", str(ROOT / "benchmarks" / "experiments" / "tiny.toml")]
    files = []
    for engine in ("local", "ray"):
        out = tmp_path / engine
        subprocess.run([*program, "-o", str(out), "--engine", engine], check=True, timeout=600)
        files.append({name: data for name, data in tree(out).items() if name.endswith(".c3gs")})
    assert len(files[0]) == 2
    assert files[0] == files[1]
