"""Plain Gaussians: harmonics, PLY files, density control, training."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from benchmarks.peers.density import Density
from benchmarks.peers.settings import DensitySettings, SplatSettings
from benchmarks.peers.splats import quality
from benchmarks.peers.trainer import SplatTrainer
from refcodec.photographs.photographs import PhotographSet
from refcodec.train.settings_file import varied

Splats = dict[str, Tensor]

# --- density ----------------------------------------------------------------------------------------------------------


def _after(splats: Splats, settings: DensitySettings, gradient: Tensor, large: bool = False) -> Splats:
    density = Density(settings, 1.0, len(gradient))
    density.note(gradient, torch.ones(len(gradient)))
    change = density.change(splats, large, torch.Generator().manual_seed(1))
    return {name: change.values(name, table, settings.shrink) for name, table in splats.items()}


@pytest.mark.parametrize("most", [200, 201, 230, 1000])
def test_the_cap_holds(most: int, splats: Splats) -> None:
    """And there is room for all that it allows."""
    gradient = torch.rand(200, generator=torch.Generator().manual_seed(3)) + 1
    alive = int((torch.sigmoid(splats["opacity"]) >= 0.005).sum())
    found = _after(splats, DensitySettings(most=most), gradient)
    assert len(found["mean"]) == min(most, 2 * alive)


# --- training ---------------------------------------------------------------------------------------------------------

SMALL = varied(
    SplatSettings(),
    {"steps": 60, "size": 60, "degree": 2, "density.most": 700, "density.period": 10, "density.reset_period": 25},
)


def test_a_training_learns_within_its_cap(photographs: PhotographSet) -> None:
    settings = varied(SMALL, {"density.reset_period": 1000})
    trainer = SplatTrainer(photographs, settings)
    before = quality(trainer.result(), photographs.test, trainer.view)["psnr"]
    counts = [trainer.count]
    assert trainer.run(lambda t: counts.append(t.count))
    assert counts[0] == 350
    assert max(counts) == 700
    assert quality(trainer.result(), photographs.test, trainer.view)["psnr"] > before + 3
