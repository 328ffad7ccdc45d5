"""Masks: anchors with only low masks are removed, and the others keep their meaning."""

from pathlib import Path

import pytest
import torch

from refcodec.photographs.photographs import PhotographSet
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer


def masked(photographs: PhotographSet, small: TrainSettings) -> Trainer:
    """A training just before a step after which anchors are dropped, whose every third anchor has no kept offset."""
    settings = varied(small, {"steps": 40, "masks.drop_period": 5, "rate.lambda_r": 0.01})
    trainer = Trainer(photographs, settings)
    while trainer.clock.mode("rate") == "off" or trainer.clock.done % 5 != 4:
        trainer.step()
    trainer.scaffold.tables["masks"][::3] = -20
    # The step that comes now is the fifth.
    trainer.clock.done += 1
    return trainer


def _of_all(trainer: Trainer) -> tuple[torch.Tensor, ...]:
    """What Rate.prepare finds of its sample, of all anchors and without noise."""
    rate = trainer.rate
    assert rate is not None
    model, rows = rate.started(), torch.arange(trainer.scaffold.count)
    planes = model.symbols(None)
    hidden = model.activations(rate.contexts.inputs(planes, rows, model.integers))
    return hidden, model.steps(hidden) * rate.base_step, planes


def losses(trainer: Trainer) -> list[float]:
    """Those of masks and rate, of all anchors."""
    rate, values = trainer.rate, []
    assert rate is not None
    for part in (rate.masks, rate):
        step, _ = trainer._looked_at(0)
        everyone = torch.arange(trainer.scaffold.count)
        step.rows, step.leaves = everyone, trainer.scaffold.leaves(everyone)
        torch.manual_seed(0)
        for other in (rate.masks, rate):
            other.prepare(step)
        if part is rate:
            rate._sampled = (everyone, *_of_all(trainer))
        values.append(float(part.loss(step).detach()))
    return values


def test_anchors_without_a_kept_offset_go(photographs: PhotographSet, small: TrainSettings, tmp_path: Path) -> None:
    trainer = masked(photographs, small)
    rate, scaffold = trainer.rate, trainer.scaffold
    assert rate is not None
    count, lost = scaffold.count, (scaffold.tables["masks"] == -20).all(dim=1)
    # One that is hardly not kept may come back.
    scaffold.tables["masks"][1] = -4.7
    before, bits = losses(trainer), rate.bits(rate.masks.decided())
    lattice = torch.from_numpy(scaffold.lattice)[~lost]
    rate.masks.after_step()
    assert scaffold.count == len(lattice) < 0.7 * count
    assert torch.equal(torch.from_numpy(scaffold.lattice), lattice)
    assert rate.masks.total == count
    # They had no bits, and the contexts of the others are what they were.
    later = rate.bits(rate.masks.decided())
    assert torch.allclose(later[0], bits[0], rtol=0.02)
    assert later[1] == bits[1]
    # L_rate, and the part of L_m that the anchors left have, do not change.
    after = losses(trainer)
    assert after[0] == pytest.approx(before[0], rel=1e-3)
    assert after[1] == pytest.approx(before[1], rel=0.05)
    # A saved training knows how many there were.
    save(trainer, tmp_path / "state")
    again = Trainer(photographs, trainer.settings)
    restore(again, tmp_path / "state")
    assert again.rate is not None
    assert again.rate.masks.total == count
    for _ in range(6):
        trainer.step()
        again.step()
    for name, table in scaffold.tables.items():
        assert torch.equal(table, again.scaffold.tables[name])
