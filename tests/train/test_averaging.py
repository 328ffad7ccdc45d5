"""Training ends with the mean of its last steps."""

import pytest
import torch
from torch import Tensor

from refcodec.photographs.photographs import PhotographSet
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.stages.averaging import PERIOD, Averaging
from refcodec.train.trainer import Trainer

STEPS, FIRST = 60, 40
PHASES = {"masks": 0.1, "rate": 0.2, "rounding": 0.3, "integers": 0.4, "weights": 0.5, "averaging": FIRST / STEPS}
EARLY = {f"phases.{name}.begin": begin for name, begin in PHASES.items()}


def values(trainer: Trainer) -> dict[str, Tensor]:
    part = next(part for part in trainer.stages if isinstance(part, Averaging))
    return {name: value.detach().clone() for name, value in part._values().items()}


@pytest.mark.parametrize("rate", [0.0, 0.01])
def test_a_training_ends_with_means(
    rate: float, photographs: PhotographSet, small: TrainSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of tables, rendering networks, planes and coding networks: every fifth step from the phase's begin on."""
    trainer = Trainer(photographs, varied(small, {"steps": STEPS, "rate.lambda_r": rate, **EARLY}))
    seen: list[dict[str, Tensor]] = []
    count = Averaging._count

    def noted(part: Averaging) -> None:
        seen.append(values(trainer))
        count(part)

    monkeypatch.setattr(Averaging, "_count", noted)
    trainer.run(lambda _: None)
    assert len(seen) == (STEPS - FIRST) // PERIOD + 1
    ended = values(trainer)
    assert {"tables.features", "networks.colour_0_weight"} <= ended.keys()
    assert ("model.latents" in ended) == (rate > 0)
    for name, value in ended.items():
        torch.testing.assert_close(value, torch.stack([each[name] for each in seen]).mean(dim=0))
    assert not torch.equal(ended["tables.features"], seen[-1]["tables.features"])


def test_no_anchor_is_dropped_while_means_are_made(photographs: PhotographSet, small: TrainSettings) -> None:
    """Each step drops what is lost; here all anchors become lost once means are made."""
    settings = varied(small, {"steps": STEPS, **EARLY, "masks.drop_period": 1})
    trainer = Trainer(photographs, settings)
    while trainer.clock.done < FIRST:
        trainer.step()
    before = trainer.scaffold.count
    with torch.no_grad():
        trainer.scaffold.tables["masks"][::2] = -12.0
    trainer.step()
    assert trainer.scaffold.count == before
