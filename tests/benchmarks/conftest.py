"""A small set of photographs, and random Gaussians."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("numba")
pytest.importorskip("skimage")
pytest.importorskip("bjontegaard")

import torch  # noqa: E402

from benchmarks.peers.harmonics import REST  # noqa: E402
from refcodec.photographs.photographs import PhotographSet, read_photographs  # noqa: E402

CALITERRA = Path(__file__).resolve().parents[2] / "examples" / "photographs" / "caliterra"


@pytest.fixture(scope="session")
def folder() -> Path:
    return CALITERRA


@pytest.fixture(scope="session")
def photographs() -> PhotographSet:
    return read_photographs(CALITERRA, 60)


@pytest.fixture(params=[0, 1, 2, 3])
def splats(request: pytest.FixtureRequest) -> dict[str, torch.Tensor]:
    """200 Gaussians in a ball, of each degree."""
    return random_splats(200, request.param)


def random_splats(count: int, degree: int) -> dict[str, torch.Tensor]:
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
