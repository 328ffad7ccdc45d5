"""Entropy models of others: tables of signs, mixtures, levels of anchors."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from benchmarks.peers.contexts import MODELS
from benchmarks.peers.hash_grid import FEATURES, GRIDS, HashGrid, Signs, corner_entries
from benchmarks.peers.levels import LEVELS, Levels, ladder
from benchmarks.peers.mixture import Mixture, mixed_bits
from refcodec.bitstream.attributes import KINDS
from refcodec.photographs.photographs import PhotographSet
from refcodec.train.rate_model.hyperprior import VectorMatrix
from refcodec.train.rate_model.model import OFFSETS, PAPER, RateModel
from refcodec.train.settings import EntropySettings, TrainSettings
from refcodec.train.settings_file import assigned, varied


def model(kind: type[RateModel], hyperprior: Any) -> RateModel:
    random = torch.Generator().manual_seed(0)
    likely = np.zeros(PAPER.width), np.ones(PAPER.width)
    return kind(hyperprior, 8, 32, *likely, random, EntropySettings(planes=1.0), columns=PAPER)


# --- tables of signs --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("entries", [64, 100_000])
def test_corners_of_a_cell(axes: int, entries: int) -> None:
    u = np.random.default_rng(0).uniform(0, 1, (50, axes))
    u[0], u[1] = 0, 1
    corners, shares = corner_entries(u, 9, entries)
    assert corners.shape == shares.shape == (50, 2**axes)
    assert corners.min() >= 0
    assert corners.max() < entries
    np.testing.assert_allclose(shares.sum(dim=1), 1, rtol=1e-6)
    if entries > 10**axes:
        # Without a hash each corner has an entry of its own, and what is linear in space is interpolated exactly.
        numbers = np.arange(10**axes)
        place = np.stack([numbers // 10**i % 10 for i in range(axes)], axis=1) / 9
        value = place @ np.arange(1, axes + 1)
        np.testing.assert_allclose((value[corners] * shares.numpy()).sum(axis=1), u @ np.arange(1, axes + 1), atol=1e-5)
        assert len(np.unique(corners[2])) == 2**axes


def test_signs_and_their_bits() -> None:
    found = cast(Signs, model(Signs, HashGrid()))
    symbols = found.symbols(torch.Generator())
    assert set(symbols.unique().tolist()) == {-1.0, 1.0}
    assert torch.equal(symbols, found.symbols(None))
    count = symbols.numel()
    assert count == FEATURES * 64 * sum(grid.levels * grid.units for grid in GRIDS)
    with torch.no_grad():
        found.latents.fill_(-0.5)
        found.latents.view(-1)[: count // 4] = 0.5
    # A quarter is 1: 2 - 3/4 log2 3 bits each.
    assert float(found.plane_bits(found.symbols(None)).detach()) == pytest.approx(
        count * (2 - 0.75 * math.log2(3)), rel=1e-5
    )


def test_the_gradient_of_signs_stops_outside() -> None:
    found = model(Signs, HashGrid())
    with torch.no_grad():
        found.latents.fill_(2.0)
        found.latents.view(-1)[:3] = torch.tensor([-0.9, 0.0, -2.0])
    found.symbols(None).sum().backward()
    assert found.latents.grad is not None
    assert found.latents.grad.view(-1)[:4].tolist() == [1, 1, 0, 0]


# --- mixtures ---------------------------------------------------------------------------------------------------------


def test_bits_of_a_mixture() -> None:
    """Three quarters of 1/2 and a quarter of 1/8 are 13/32."""
    found = mixed_bits(torch.tensor([1.0]), torch.tensor([3.0]), torch.tensor([math.log(3)]))
    assert float(found) == pytest.approx(-math.log2(13 / 32))


def test_a_mixture_begins_as_its_parts_are() -> None:
    """CARM's last layers begin with zeros, so that both distributions are the hyperprior's."""
    random = torch.Generator().manual_seed(5)
    hidden, kept = torch.rand(20, 32, generator=random), torch.ones(20, OFFSETS)
    symbols = torch.round(3 * torch.randn(20, PAPER.width, generator=random))
    one, two = model(RateModel, VectorMatrix()), model(Mixture, VectorMatrix())
    torch.testing.assert_close(one.attribute_bits(hidden, symbols, kept), two.attribute_bits(hidden, symbols, kept))
    with torch.no_grad():
        for network in two._carm():
            network.biases[-1].fill_(0.5)
    assert not torch.equal(one.attribute_bits(hidden, symbols, kept), two.attribute_bits(hidden, symbols, kept))


# --- levels -----------------------------------------------------------------------------------------------------------


def test_coarser_anchors_predict_finer_ones() -> None:
    cells = np.unique(np.random.default_rng(1).integers(-60, 60, (900, 3)), axis=0)
    found = ladder(cells)
    counts = np.bincount(found.level, minlength=LEVELS)
    assert len(counts) == LEVELS
    # Each level and those above it are at most a fifth of all below.
    for level in range(1, LEVELS):
        assert 0 < counts[level:].sum() <= 0.2 * counts[level - 1 :].sum()
    top = found.level == LEVELS - 1
    assert (found.parent[top] == np.flatnonzero(top)).all()
    below = np.flatnonzero(~top)
    # A parent is decoded first.
    assert (found.level[found.parent[below]] > found.level[below]).all()
    assert (np.abs(found.away) < 1).all()
    assert (found.away[top] == 0).all()


def test_a_single_anchor_has_no_parent() -> None:
    found = ladder(np.array([[3, 4, 5]]))
    assert (found.level.tolist(), found.parent.tolist()) == ([LEVELS - 1], [0])


class _Halves:
    """Steps that are half of the base steps for all anchors."""

    def activations(self, inputs: torch.Tensor) -> torch.Tensor:
        return inputs

    def steps(self, hidden: torch.Tensor) -> torch.Tensor:
        return torch.full((len(hidden), 3), 0.5)


def test_a_context_is_what_the_decoder_has() -> None:
    """A parent's rounded values; nothing of it if it is not in the file."""
    cells = np.unique(np.random.default_rng(2).integers(0, 50, (300, 3)), axis=0)
    n, steps = len(cells), {"features": 0.2, "scalings": 0.4}
    random = torch.Generator().manual_seed(2)
    tables = {kind: torch.randn(n, {"features": 50, "scalings": 6}[kind], generator=random) for kind in steps}
    kept = torch.ones(n, OFFSETS, dtype=torch.bool)
    rate = SimpleNamespace(
        masks=SimpleNamespace(decided=lambda: kept),
        started=_Halves,
        base_step=torch.tensor([0.2, 0.4, 1.0]),
        quantisation=SimpleNamespace(symbols=lambda values, steps: torch.floor(values[0] / steps + 0.5)),
        scaffold=SimpleNamespace(tables=tables, columns=PAPER),
    )
    hyperprior = Levels()
    hyperprior.rate = cast(Any, rate)
    contexts = hyperprior.contexts(cast(Any, None), cells.astype(np.float16), 8)
    found = ladder(cells)
    child = int(np.flatnonzero(found.level == 0)[0])
    parent = int(found.parent[child])
    (row,) = contexts.inputs(torch.zeros(1), torch.tensor([child]), False)
    for kind, place in (("features", slice(0, 50)), ("scalings", slice(50, 56))):
        wanted = torch.floor(tables[kind][parent] / (steps[kind] / 2) + 0.5) / 2
        torch.testing.assert_close(row[place], wanted)
    kept[parent] = False
    (row,) = contexts.inputs(torch.zeros(1), torch.tensor([child]), False)
    assert (row[:56] == 0).all()
    assert row[-LEVELS:].tolist() == [256, 0, 0]


# --- all of them ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(MODELS) - {"triplane72"}))
def test_a_training_with_each(name: str, photographs: PhotographSet) -> None:
    """It comes to its end, and its bits fall."""
    entry = MODELS[name]
    small = {"steps": 80, "size": "60", "start.anchors": 250, "growth.most": 300, "looks.count": 1}
    trainer = entry.trainer(photographs, assigned(varied(TrainSettings(), small), entry.changes))
    lengths = []

    def watch(_: object) -> None:
        if trainer.rate is not None and trainer.rate.model is not None:
            lengths.append(sum(trainer.estimate()[kind] for kind in KINDS))

    assert trainer.run(watch)
    assert math.isfinite(lengths[-1])
    assert lengths[-1] < lengths[0]
    assert trainer.rate is not None
    assert type(trainer.rate.started()) is entry.model


def test_a_model_needs_a_rate(photographs: PhotographSet) -> None:
    with pytest.raises(ValueError, match="above 0"):
        MODELS["hac"].trainer(photographs, varied(TrainSettings(), {"rate.weight": 0.0, "start.anchors": 250}))
