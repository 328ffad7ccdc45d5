"""A small set of photographs, and random Gaussians."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("numba")
pytest.importorskip("skimage")
pytest.importorskip("bjontegaard")
pytest.importorskip("matplotlib")

import torch

from refcodec.formats.harmonics import REST
from refcodec.photographs.photographs import PhotographSet, read_photographs

CALITERRA = Path(__file__).resolve().parents[2] / "examples" / "photographs" / "caliterra"


@pytest.fixture(scope="session")
def folder() -> Path:
    return CALITERRA


@pytest.fixture(scope="session")
def photographs() -> PhotographSet:
    return read_photographs(CALITERRA, 60)


MakeSplats = Callable[[int, int], dict[str, torch.Tensor]]


@pytest.fixture(scope="session")
def make_splats() -> MakeSplats:
    """Makes a number of Gaussians in a ball, of a degree."""

    def made(count: int, degree: int) -> dict[str, torch.Tensor]:
        random = torch.Generator().manual_seed(count + degree)

        def normal(*shape: int) -> torch.Tensor:
            return torch.randn(shape, generator=random)

        return {
            "mean": normal(count, 3),
            "base": normal(count, 3),
            "rest": 0.3 * normal(count, REST[degree], 3),
            "opacity": normal(count),
            "scale": -2 + 0.3 * normal(count, 3),
            "quaternion": normal(count, 4),
        }

    return made


@pytest.fixture(params=[0, 1, 2, 3])
def splats(request: pytest.FixtureRequest, make_splats: MakeSplats) -> dict[str, torch.Tensor]:
    """200 Gaussians of each degree."""
    return make_splats(200, request.param)
