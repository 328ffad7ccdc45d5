"""An interrupted training run that is resumed ends with the same bytes, regardless of the step of the interrupt."""

import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from refcodec.folder.layout import REPORT_FILE
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.train import command
from refcodec.train.command import state_path, train
from refcodec.train.schedule import Clock
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer

# Anchors grow and may go in the step in which the rate begins.
TINY = varied(
    TrainSettings(),
    {
        "steps": 20,
        "start.anchors": 60,
        "growth.most": 160,
        "growth.pixels": 1,
        "growth.period": 4,
        "growth.offset_views": 1,
        "growth.gradient": 1e-6,
        "masks.drop_period": 2,
        "looks.count": 4,
        # Few grids to choose from: each is judged by drawing photographs.
        "weights.rendering_bits": (7, 8),
        "weights.coarser": (1, 2),
        "weights.judges": 1,
    },
)
CLOCK = Clock(TINY.phases, TINY.steps)
# The last step before each phase, and its first.
STEPS = sorted({max(CLOCK.step_of(phase.begin) + more, 1) for phase in TINY.phases for more in (0, 1)} | {TINY.steps})
METHODS: dict[str, dict[str, Any]] = {
    "coded": {},
    "uncompressed": {"rate.lambda_r": 0.0},
    "without planes": {"entropy.channels": 0},
    "without a hyperprior": {"entropy.channels": 0, "entropy.frequencies": 0, "entropy.layers": 0},
    "static": {"static": True, "degree": 2},
    "without masks": {"masks.used": False},
    "rounding before the rate": {"phases.growth.modes": {"quantisation": "round"}},
}


@pytest.fixture(scope="module")
def few(examples: Path) -> PhotographSet:
    return read_photographs(examples / "caliterra", (48, 36))


def same(one: dict[str, Any], two: dict[str, Any]) -> list[str]:
    """The names of the values in which two states differ, without what depends on the time."""

    def timeless(name: str, value: Any) -> Any:
        if name == "looks/history":
            return [{key: number for key, number in look.items() if key != "seconds"} for look in value]
        return None if name.startswith("looks/pace/") or name == "looks/seconds" else value

    def equal(name: str) -> bool:
        if isinstance(one.get(name), Tensor) and isinstance(two.get(name), Tensor):
            return torch.equal(one[name], two[name])
        return bool(timeless(name, one.get(name)) == timeless(name, two.get(name)))

    return [name for name in one.keys() | two.keys() if not equal(name)]


@pytest.mark.slow
@pytest.mark.parametrize("changes", METHODS.values(), ids=METHODS)
def test_every_step_follows_from_the_saved_state(changes: dict[str, Any], few: PhotographSet, tmp_path: Path) -> None:
    """A training that stops after any step and goes on has the next one as if it had not stopped."""
    settings, path = varied(TINY, changes), tmp_path / "state"
    whole = Trainer(few, settings)
    grown: list[int] = []
    while whole.clock.done < settings.steps:
        save(whole, path)
        again = Trainer(few, settings)
        restore(again, path)
        before = whole.scaffold.count
        for trainer in (whole, again):
            trainer.step()
            trainer.looks.look()
        assert (whole.clock.done, same(whole.state(), again.state())) == (whole.clock.done, [])
        if whole.scaffold.count > before:
            grown.append(whole.clock.done)
    # Those of a static scene grow once, earlier.
    if settings.rate.lambda_r and not settings.static:
        assert CLOCK.step_of(next(phase.begin for phase in TINY.phases if phase.name == "rate")) in grown


def files(folder: Path) -> dict[str, bytes]:
    """What a scene folder holds, without the report, which has times."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != REPORT_FILE}


def run(photographs: PhotographSet, output: Path, resume: bool = False, **changes: Any) -> bool:
    settings = varied(TINY, changes)
    return train(photographs, settings, output, threads=1, device="cpu", resume=resume, progress=False).whole


def interrupt(monkeypatch: pytest.MonkeyPatch, step: int, number: signal.Signals = signal.SIGINT) -> None:
    """Lets a signal arrive in the middle of a step, counted from 1."""
    looked_at = Trainer._looked_at

    def signalled(self: Trainer, view: int) -> Any:
        if self.clock.done + 1 == step:
            signal.raise_signal(number)
        return looked_at(self, view)

    monkeypatch.setattr(Trainer, "_looked_at", signalled)


def test_interrupts_within_steps_and_of_the_result(
    few: PhotographSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One training with each signal within a step, and with scenes that cannot be written, ends as one without."""
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = [signal.getsignal(each) for each in signals]
    assert run(few, tmp_path / "whole", steps=5)
    output = tmp_path / "scene"
    for step, number in enumerate(signals, start=1):
        with monkeypatch.context() as patch:
            interrupt(patch, step, number)
            assert not run(few, output, step > 1, steps=5)
        assert [signal.getsignal(each) for each in signals] == handlers
    before = files(output)

    def refused(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    def interrupted(*_: Any) -> None:
        signal.raise_signal(signal.SIGINT)

    # A result begins what has not begun, such as the rate. This is not saved.
    for step in (4, 5):
        with monkeypatch.context() as patch:
            interrupt(patch, step)
            patch.setattr(command, "write_folder", refused)
            with pytest.raises(OSError, match="--resume to continue"):
                run(few, output, True, steps=5)
    with monkeypatch.context() as patch:
        patch.setattr(command, "write_folder", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(few, output, True, steps=5)
    assert files(output) == before
    assert run(few, output, True, steps=5)
    assert files(output) == files(tmp_path / "whole")


@pytest.mark.slow
def test_interrupted_in_each_phase(few: PhotographSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene that each interrupt leaves takes nothing from what goes on, whichever phase has not begun."""
    assert run(few, tmp_path / "whole")
    assert not state_path(tmp_path / "whole").exists()
    for step in STEPS:
        with monkeypatch.context() as patch:
            interrupt(patch, step)
            assert run(few, tmp_path / "scene", step > STEPS[0]) == (step == TINY.steps)
    assert files(tmp_path / "scene") == files(tmp_path / "whole")
