"""The reports of training: schedule, time left, bytes, first and last lines, logs; and more steps."""

import csv
import io
import json
import re
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import pytest

from refcodec.bitstream.codec import emit, parse
from refcodec.cli.main import main
from refcodec.photographs.photographs import PhotographSet
from refcodec.train import messages
from refcodec.train.command import state_path
from refcodec.train.estimate import UNCOUNTED
from refcodec.train.log import Logging, Table
from refcodec.train.looks import COLUMNS, PARTS
from refcodec.train.pace import ENOUGH, RATIO, Pace
from refcodec.train.schedule import Clock
from refcodec.train.settings import PHASES, TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.state import Saved, StateError, restore, save
from refcodec.train.trainer import Trainer

FEW = {"start.anchors": 300, "growth.most": 400, "weights.judges": 1}
TINY = ["--size", "60", *(word for name, value in FEW.items() for word in ("--set", f"{name}={value}"))]


def until(trainer: Trainer, done: int) -> Trainer:
    while trainer.clock.done < done:
        trainer.step()
        trainer.looks.look()
    return trainer


# --- the schedule -----------------------------------------------------------------------------------------------------


def extended(done: int, steps: int, more: int) -> Clock:
    before, after = Clock(PHASES, steps), Clock(PHASES, more)
    before.done = done
    after.restore(Saved(before.state()))
    return after


def test_the_schedule_goes_on_where_it_is() -> None:
    for done, more in ((0, 90), (10, 41), (30, 300), (40, 41), (40, 400)):
        clock = extended(done, 40, more)
        before = Clock(PHASES, 40)
        before.done = done
        assert (clock.done, clock.share) == (done, before.share)
        assert all(clock.mode(part) == before.mode(part) for part in ("growth", "masks", "rate", "weights"))
        shares = [clock.share_at(step) for step in range(done, more + 1)]
        assert shares == sorted(shares)
        assert shares[-1] == pytest.approx(1)
        for share in (0.41, 0.8, 1.0):
            step = clock.step_of(share)
            assert clock.share_at(step) >= share - 1e-6
            assert step == clock.first or clock.share_at(step - 1) < share
    # Once more, and without a change.
    twice = Clock(PHASES, 1000)
    twice.restore(Saved(extended(30, 40, 300).state()))
    assert (twice.first, twice.base) == (30, pytest.approx(0.75))
    same = Clock(PHASES, 300)
    same.restore(Saved(extended(30, 40, 300).state()))
    assert (same.first, same.base, same.steps) == (30, 0.75, 300)


def test_a_schedule_that_is_not_extended_is_exact() -> None:
    clock = Clock(PHASES, 4000)
    for clock.done in range(4001):
        assert clock.share == clock.done / 4000


# --- more steps -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("done", [10, 25, 40])
def test_a_training_is_extended(done: int, photographs: PhotographSet, tmp_path: Path) -> None:
    """Before the rate, with it, and after the end."""
    before = until(Trainer(photographs, varied(TrainSettings(), {**FEW, "steps": 40})), done)
    save(before, tmp_path / "state")
    after = Trainer(photographs, varied(TrainSettings(), {**FEW, "steps": 60}))
    restore(after, tmp_path / "state")
    assert (after.clock.done, after.clock.share) == (done, before.clock.share)
    assert after.run(lambda _: None)
    assert after.clock.done == 60
    assert after.looks.history[: len(before.looks.history)] == before.looks.history
    assert parse(emit(after.result())).scene.anchor_count > 100
    # Not the other way.
    save(after, tmp_path / "state")
    with pytest.raises(StateError, match="can be extended, but not cut to 40 steps"):
        restore(before, tmp_path / "state")


@pytest.mark.slow
def test_a_command_that_extends(
    examples: Path, tmp_path: Path, refused: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    scene, log = tmp_path / "scene", tmp_path / "log.csv"
    words = ["train", str(examples / "caliterra"), "-o", str(scene), *TINY, "--log", str(log)]
    assert main([*words, "--steps", "12", "--keep-state"]) == 0
    assert state_path(scene).is_file()
    assert "--resume" in refused(*words, "--steps", 12)
    assert "not cut to 10 steps" in refused(*words, "--steps", 10, "--resume")
    other = refused(*words, "--steps", 12, "--size", 50, "--resume")
    assert other.endswith("is of other settings; size is 60, not 50\n")
    first = log.read_bytes().splitlines()
    assert main([*words, "--steps", "15", "--resume"]) == 0
    printed = capsys.readouterr()
    assert "from step 12 on" in printed.err
    assert "15 steps" in printed.out
    report = json.loads((scene / "training.json").read_text())
    assert (report["steps"], report["settings"]["steps"], report["schedule"]) == (15, 15, {"first": 12, "base": 1.0})
    assert not state_path(scene).exists()
    # The log has the rows of both.
    assert log.read_bytes().splitlines()[: len(first)] == first
    assert len(log.read_bytes().splitlines()) == 16
    assert "only with --keep-state" in refused(*words, "--steps", 20, "--resume")


# --- time left --------------------------------------------------------------------------------------------------------


def paced(clock: Clock, pace: Pace, begin: int, end: int) -> None:
    """Steps of 10 ms before the rate and 30 ms with it. The first of a process takes a minute."""
    for number in range(begin, end):
        clock.done = number + 1
        rate = clock.mode("rate", number) != "off"
        pace.note(60.0 if pace._last is None else 0.03 if rate else 0.01)


def true_time(done: int) -> float:
    return sum(0.01 if number < 400 else 0.03 for number in range(done, 1000))


def test_time_left() -> None:
    clock = Clock(PHASES, 1000)
    pace = Pace(clock, True)
    assert pace.left() is None
    paced(clock, pace, 0, 1)
    assert pace.left() is None
    paced(clock, pace, 1, 100)
    seconds, sure = pace.left() or (0, True)
    # The ratio is not measured yet.
    assert seconds == pytest.approx(300 * 0.01 + 600 * 0.01 * RATIO)
    assert not sure
    paced(clock, pace, 100, 400 + ENOUGH + 1)
    assert pace.left() == (pytest.approx(true_time(411)), True)
    paced(clock, pace, 411, 900)
    assert pace.left() == (pytest.approx(true_time(900)), True)
    clock.done = 1000
    assert pace.left() == (0, True)


def test_time_left_after_resume() -> None:
    """It was ten times too much: the first step, which compiles, counted."""
    clock = Clock(PHASES, 1000)
    pace = Pace(clock, True)
    paced(clock, pace, 0, 500)
    again = Pace(clock, True)
    again.restore(Saved(pace.state()))
    paced(clock, again, 500, 501)
    assert again.left() == (pytest.approx(true_time(501)), True)
    # Without a rate all steps are alike, whatever the phases say.
    plain = Pace(clock, False)
    paced(clock, plain, 500, 510)
    plain.means[0] = 0.01
    assert (plain.left() or (0,))[0] == pytest.approx(490 * 0.01)


# --- lines ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_lines(photographs: PhotographSet) -> None:
    trainer = until(Trainer(photographs, varied(TrainSettings(), {**FEW, "steps": 40})), 1)
    assert "s left" not in messages.line(trainer)
    assert "KB" not in messages.line(trainer)
    until(trainer, 8)
    assert re.search(r" anchors, about \d+ s left$", messages.line(trainer))
    # With the rate, bytes are counted.
    until(trainer, 17)
    assert " KB, about " in messages.line(trainer)
    until(trainer, 40)
    assert messages.line(trainer).endswith(" KB")


def test_bytes_are_counted_when_the_rate_begins(trained: Trainer) -> None:
    """Numbers before it were 46 % too low, and earlier ten times too high."""
    history = trained.looks.history
    names = [row["phase"] for row in history]
    begin = names.index("rate")
    assert list(dict.fromkeys(names)) == [phase.name for phase in PHASES]
    assert [row["bytes"] > 0 for row in history] == [number >= begin for number in range(len(names))]
    for row in history:
        assert row["bytes"] == pytest.approx(sum(row[part] for part in PARTS), abs=3)


@pytest.mark.slow
def test_first_and_last_lines(examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, scene, log = str(examples / "caliterra"), tmp_path / "my scene", tmp_path / "log.csv"

    def logged() -> bool:
        """Whether the log is the history of the scene's training."""
        rows = list(csv.DictReader(log.open(newline="")))
        history = json.loads((scene / "training.json").read_text())["history"]
        assert list(rows[0]) == [*COLUMNS, "phase"]
        assert [row["step"] for row in rows] == [str(step) for step in range(1, len(rows) + 1)]
        return rows == [{name: str(value) for name, value in row.items()} for row in history]

    assert main(["train", source, "-o", str(scene), *TINY, "--steps", "6", "--log", str(log)]) == 0
    assert logged()
    printed = capsys.readouterr()
    words = [
        "65 photographs of 60 x 45",
        "10 held out",
        " points, background 89,84,74",
        " anchors, 6 steps, lambda 0.004",
    ]
    first = printed.err.splitlines()[0]
    assert first.startswith("train: ")
    assert all(word in first for word in words)
    report, lines = json.loads((scene / "training.json").read_text()), printed.out.splitlines()
    assert lines[0].startswith(f"{scene}: {report['anchors']} anchors, 6 steps, ")
    mean = sum(report["quantised"].values()) / len(report["quantised"])
    size = sum(report["bytes"][part] for part in PARTS) + UNCOUNTED
    assert lines[1] == f"held-out PSNR {mean:.2f} dB of 10 photographs; about {size / 1000:.0f} KB in a file"
    assert lines[2:] == [f"next: refcodec encode '{scene}' -o '{scene}.c3gs'"]
    words = [*TINY, "--steps", "3", "--lambda", "0", "--holdout", "0", "--log", str(log)]
    assert main(["train", source, "-o", str(scene), *words]) == 0
    assert logged()
    printed = capsys.readouterr()
    assert "75 photographs of 60 x 45, none held out, " in printed.err
    assert "lambda 0: an uncompressed scene" in printed.err
    sizes = json.loads((scene / "training.json").read_text())["bytes"]
    assert printed.out.splitlines()[1:] == [
        f"no photographs are held out; {sum(sizes.values()) / 1000:.0f} KB uncompressed",
        f"next: refcodec eval '{scene}' {source}",
    ]


def test_compilation_is_reported_once(trained: Trainer, capsys: pytest.CaptureFixture[str]) -> None:
    with messages.shown(trained, False, lambda _: None):
        assert capsys.readouterr().err == ""
        for _ in range(2):
            numba.njit(lambda x: x + 1)(1)
    assert capsys.readouterr().err.count("train: compiling") == 1


@pytest.mark.slow
def test_the_bar_of_a_terminal(examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its time left is the training's own: tqdm's knows neither the rate nor the steps before --resume."""
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", "140")
    monkeypatch.setenv("LINES", "24")
    assert main(["train", str(examples / "caliterra"), "-o", str(tmp_path / "scene"), *TINY, "--steps", "40"]) == 0
    bars = [bar for bar in terminal.getvalue().split("\r") if "/40 [" in bar]
    assert any(re.search(r" 20/40 \[.* dB, \d+ anchors, \d+ KB, about \d+ s left\]", bar) for bar in bars), bars
    assert re.search(r" 40/40 \[.* dB, \d+ anchors, \d+ KB\]", bars[-1])


# --- logs -------------------------------------------------------------------------------------------------------------


def test_a_log_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is said once, and ends nothing."""
    (tmp_path / "gone").write_text("a file")
    logging, row = Logging(Table(tmp_path / "gone" / "log.csv"), []), dict.fromkeys((*COLUMNS, "phase"), 1)
    for count in (1, 1, 2, 3):
        logging([row] * count)
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "training continues" in message
    (tmp_path / "gone").unlink()
    logging([row] * 4)
    assert len((tmp_path / "gone" / "log.csv").read_text().splitlines()) == 5


@pytest.mark.slow
def test_tensorboard(
    examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    """With a writer of TensorBoard's that keeps what it gets."""
    got: list[tuple[Any, ...]] = []

    class Writer:
        def __init__(self, folder: str, purge_step: int | None) -> None:
            got.append((folder, purge_step))

        def add_scalar(self, *what: Any) -> None:
            got.append(what)

        add_text = add_scalar

        def flush(self) -> None:
            """Nothing is held back."""

    module = types.ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = Writer  # type: ignore[attr-defined]
    words = ["train", str(examples / "caliterra"), "-o", str(tmp_path / "scene"), *TINY, "--steps", "3"]
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    monkeypatch.delitem(sys.modules, "torch.utils.tensorboard", raising=False)
    assert "pip install 'refcodec[tensorboard]'" in refused(*words, "--log", tmp_path / "board")
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    assert main([*words, "--log", str(tmp_path / "board")]) == 0
    history = json.loads((tmp_path / "scene" / "training.json").read_text())["history"]
    rows = [(name, row[name], row["step"]) for row in history for name in (*COLUMNS[1:], "phase")]
    assert got == [(str(tmp_path / "board"), 1), *rows]
