"""Exposures of photographs, and what is behind them."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from refcodec.photographs.photographs import PhotographSet
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.stages.exposure import Exposure
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer

ON = {
    "phases.start.modes.exposure": "on",
    "learning.exposure": {"start": 0.03, "end": 0.03},
    "steps": 160,
    "rate.lambda_r": 0.0,
}


@pytest.fixture(scope="module")
def uneven(photographs: PhotographSet) -> PhotographSet:
    """Eight photographs of which every second one is darker by a quarter."""
    train = tuple(replace(p) for p in photographs.train[:8])
    for p in train[::2]:
        p.__dict__["image"] = (p.image * 0.75).astype("uint8")
    return replace(photographs, train=train)


def test_exposures_are_found(uneven: PhotographSet, small: TrainSettings, tmp_path: Path) -> None:
    """What half of the photographs lack in light is no colour of the scene. A saved training finds the same."""
    trainer = Trainer(uneven, varied(small, ON))
    while trainer.clock.done < 80:
        trainer.step()
    save(trainer, tmp_path / "state")
    trainer.run(lambda _: None)
    again = Trainer(uneven, varied(small, ON))
    restore(again, tmp_path / "state")
    again.run(lambda _: None)
    (stage,), (other,) = trainer.of(Exposure), again.of(Exposure)
    torch.testing.assert_close(other.values, stage.values, rtol=0, atol=0)
    factor, more = stage.values.detach().split(3, dim=1)
    shade = 0.3 * factor.exp() + more
    assert 0.65 < shade[::2].mean() / shade[1::2].mean() < 0.85
    torch.testing.assert_close(stage.values.detach().mean(dim=0), torch.zeros(6), atol=1e-5, rtol=0)


@pytest.mark.parametrize("opaque", [True, False])
def test_nothing_shines_through_a_scene(opaque: bool, photographs: PhotographSet, small: TrainSettings) -> None:
    """A scene of opaque photographs looks the same over all backgrounds, one over a stated background need not."""
    trainer = Trainer(replace(photographs.over((0, 0, 0)), opaque=opaque), varied(small, {"rate.lambda_r": 0.0}))
    trainer.run(lambda _: None)
    camera = photographs.train[0].camera
    black = trainer.draw(camera)
    trainer.drawing = replace(trainer.drawing, background=(1.0, 1.0, 1.0))
    assert not next(trainer.of(Exposure)).values.any()
    through = float((trainer.draw(camera) - black).mean())
    assert (through < 0.05) == opaque
