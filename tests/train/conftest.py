"""A small set of photographs, and a training run of some seconds on it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("numba")

from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.trainer import Trainer

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "photographs"
# Few grids to choose from: each is judged by drawing photographs, which takes most of a short training.
FEW_GRIDS = {"weights.rendering_bits": (7, 8), "weights.coarser": (1, 2), "weights.judges": 1}
SMALL = varied(TrainSettings(), {"steps": 160, "start.anchors": 800, "growth.most": 900, **FEW_GRIDS})


@pytest.fixture(scope="session")
def examples() -> Path:
    return EXAMPLES


@pytest.fixture(scope="session")
def small() -> TrainSettings:
    """Settings of a training of seconds."""
    return SMALL


@pytest.fixture(scope="session")
def photographs() -> PhotographSet:
    return read_photographs(EXAMPLES / "caliterra", (100, 75))


@pytest.fixture(scope="session")
def trained(photographs: PhotographSet) -> Trainer:
    """A training that came to its end."""
    trainer = Trainer(photographs, SMALL)
    assert trainer.run(lambda _: None)
    return trainer
