"""Code lengths of other entropy models: who reads whom, what is counted, and that training saves bytes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.lengths import report
from benchmarks.lengths.bounds import cell_means, mean_of, measure, rows
from benchmarks.lengths.fit import count, fit
from benchmarks.lengths.model import Model
from benchmarks.lengths.moves import moved
from benchmarks.lengths.neighbours import nearest_before, nearest_coarser, nearest_of_all
from benchmarks.lengths.networks import Network, value_bits
from benchmarks.lengths.questions import QUESTIONS
from benchmarks.lengths.scenes import Coded
from benchmarks.lengths.variants import ALONE, OFFSETS, SCALINGS, Group, Variant, slices
from refcodec.train.rate_model.units import MEAN_UNIT, SCALE_UNIT

COUNTS = (6, 2, 6)
GROUPS = (*slices(2, 4), Group("s", 0, -1, "f"), Group("o", 0, -1, "fsm"))
SMALL = Variant(groups=GROUPS, hyper=(8,), carm=(4,), channels=2, frequencies=2, steps=60, batch=64)


def scene(count: int = 400) -> Coded:
    """Features that follow the place and each other, scalings that follow features, and offsets of noise."""
    draw = np.random.default_rng(0)
    cells = np.unique(draw.integers(0, 60, (count, 3)), axis=0)
    n = len(cells)
    features = cells @ draw.normal(0, 0.1, (3, COUNTS[0])) + draw.normal(0, 0.5, (n, COUNTS[0]))
    features[:, 4] = 2 * features[:, 0]
    symbols = np.concatenate([features, features[:, :2] * 3 - 20, draw.normal(0, 3, (n, COUNTS[2]))], axis=1)
    kept = draw.random((n, COUNTS[2] // 3)) < 0.6
    kept[:, 0] = True
    symbols[:, -COUNTS[2] :] *= np.repeat(kept, 3, axis=1)
    return Coded(
        "made",
        torch.tensor(np.round(symbols), dtype=torch.float32),
        torch.tensor(kept, dtype=torch.float32),
        cells * 1000,
        cells,
        COUNTS,
        (2, 4),
    )


def bits_of_columns(made: Coded, variant: Variant) -> torch.Tensor:
    """Bits of the first 50 anchors by kind, of a model whose networks are not zero."""
    model = Model(made, variant, torch.Generator().manual_seed(1))
    with torch.no_grad():
        for network in model.contexts.values():
            for weight in network.weights:
                weight.normal_(generator=torch.Generator().manual_seed(2))
    model.prepare("float")
    return model.attribute_bits(model.planes(True), torch.arange(50)).detach()


@pytest.mark.parametrize("shared", [False, True])
def test_a_group_reads_earlier_groups_alone(shared: bool) -> None:
    """A change of offsets changes no bits of features or scalings, one of scalings none of features."""
    variant = replace(SMALL, shared=shared, groups=(*slices(2, 4), Group("s", 0, -1, "f"), Group("o", 0, -1, "fs")))
    made = scene()
    first = bits_of_columns(made, variant)
    for kind, columns in enumerate((slice(0, 6), slice(6, 8), slice(8, 14))):
        other = made.symbols.clone()
        # Two anchors change places, so that no statistics change.
        other[[0, 1], columns] = other[[1, 0], columns]
        second = bits_of_columns(replace(made, symbols=other), variant)
        same = torch.isclose(first[:2], second[:2]).all(dim=0).tolist()
        assert same[:kind] == [True] * kind
        assert same[kind:] == [False] * (3 - kind)


def test_dropped_offsets_cost_nothing_and_are_not_read() -> None:
    """The symbols of offsets that are dropped change no bits."""
    made = scene()
    other = torch.where(
        torch.cat([torch.ones(made.count, 8), made.kept.repeat_interleave(3, dim=1)], dim=1) > 0, made.symbols, 99.0
    )
    assert torch.equal(bits_of_columns(made, SMALL), bits_of_columns(replace(made, symbols=other), SMALL))


def test_the_format_has_the_slices_of_the_scene() -> None:
    own = Variant().fitted((2, 4))
    assert own.groups == (*slices(2, 4), SCALINGS, OFFSETS)
    assert replace(Variant(), groups=ALONE).fitted((2, 4)).groups == (*slices(6), SCALINGS, OFFSETS)
    assert SMALL.fitted((1, 5)) == SMALL
    assert SMALL.fitted((1, 6)) is None
    assert own is not None
    Model(scene(), own, torch.Generator())


@pytest.mark.parametrize("name", QUESTIONS)
def test_questions_are_for_any_scene(name: str) -> None:
    """What has other features than the scene is left out. The rest has each feature once."""
    fitted = [variant.fitted((2, 4)) for variant in QUESTIONS[name].variants.values()]
    assert fitted[0] is not None
    for variant in filter(None, fitted):
        assert [k for g in variant.groups if g.kind == "f" for k in range(g.start, g.stop)] == list(range(6))


def test_groups_hold_each_column_once() -> None:
    """A column that no group has is a fault."""
    with pytest.raises(AssertionError):
        Model(scene(), replace(SMALL, groups=(*slices(2, 3), SCALINGS, OFFSETS)), torch.Generator())


def test_neighbours_are_those_a_decoder_has() -> None:
    """They are the nearest of those that come before, by comparison of all pairs."""
    cells = np.random.default_rng(3).integers(0, 40, (1300, 3))
    found = nearest_before(cells, 2)
    assert found[0].tolist() == [-1, -1]
    assert found[1].tolist() == [0, -1]
    for i in (2, 511, 512, 513, 1299):
        distances = ((cells[:i] - cells[i]) ** 2).sum(axis=1)
        assert (distances[found[i]] == np.sort(distances)[:2]).all()
    nearest = nearest_of_all(cells, 1)[:, 0]
    assert (nearest != np.arange(len(cells))).all()
    coarser = nearest_coarser(cells, 1)[:, 0]
    steps, at = 0, np.arange(len(cells))
    while (at >= 0).any():
        at = np.where(at >= 0, coarser[at], -1)
        steps += 1
    # No anchor waits for itself, and the levels are few.
    assert 2 <= steps <= 6


def test_bits_of_weights_are_those_of_their_distribution() -> None:
    """Gaussian values of a deviation of 4 take the entropy of their distribution, zeros next to nothing."""
    values = torch.round(torch.randn(20000, generator=torch.Generator().manual_seed(0)) * 4)
    entropy = 0.5 * np.log2(2 * np.pi * np.e * (16 + 1 / 12))
    assert float(value_bits(values, False)) / 20000 == pytest.approx(entropy, abs=0.02)
    assert float(value_bits(values, True)) > float(value_bits(values, False))
    assert float(value_bits(torch.zeros(1000), False)) < 10


def test_masked_weights_are_neither_used_nor_counted() -> None:
    """A network with masks counts the weights that are left."""
    masks = [torch.tensor([[True, False], [False, True]]), torch.tensor([[True, True]])]
    network = Network([2, 2, 1], torch.Generator().manual_seed(0), 1.0, masks)
    assert network.counted() == 2 + 2 + 2 + 1
    network.prepare("round", torch.Generator())
    assert network.used[0][0][0, 1] == 0


def test_training_saves_bytes() -> None:
    """A trained model is smaller than its start, in attributes, and in weights if they are in the loss."""
    made = scene()
    start = count(Model(made, SMALL, torch.Generator().manual_seed(0)), True)
    trained, after = fit(made, SMALL, 0), fit(made, replace(SMALL, weighed=False), 0)
    assert trained.attributes < start.attributes
    assert after.attributes < start.attributes
    assert sum(trained.networks.values()) < sum(start.networks.values())
    assert trained.weights == after.weights


@pytest.mark.parametrize(
    "variant",
    [
        replace(SMALL, channels=0, frequencies=0),
        replace(SMALL, hyper=(), carm=(), sarm=()),
        replace(SMALL, mixture=True, groups=(*slices(2, 4), SCALINGS, OFFSETS), order="falling"),
        replace(SMALL, sarm=None, neighbours="levels:2"),
        replace(SMALL, laplace=True, shared=True, neighbours="oracle:2", groups=(*slices(2, 4), SCALINGS, OFFSETS)),
    ],
)
def test_every_part_can_be_left_out(variant: Variant) -> None:
    """Each gives finite lengths, and parts that are not there cost nothing."""
    lengths = fit(scene(200), replace(variant, steps=4), 0)
    assert np.isfinite(lengths.total)
    assert (lengths.planes == 0) == (variant.channels == 0 or variant.sarm is None)


def test_anchors_together_are_a_scene() -> None:
    """They are the nearest ones, in their order, and their places fill the range."""
    made = scene().together(50, 1)
    assert made.count == 50
    assert made.places.min() == 0
    assert made.places.max() == 1 << 16
    assert fit(made, replace(SMALL, steps=2), 0).total > 0


def test_moves_save_what_they_promise() -> None:
    """A symbol far from its mean moves by one, one at its mean stays."""
    symbol, mean = np.array([3, 0, -5]), np.array([0, 0, 0])
    scale = np.zeros(3, np.int64)
    assert moved(symbol, mean, scale, 1.0).tolist() == [2, 0, -4]
    assert moved(symbol, mean, scale, 50.0).tolist() == [3, 0, -5]
    assert moved(np.array([4]), np.array([int(4 * MEAN_UNIT)]), np.array([int(SCALE_UNIT)]), 0.1).tolist() == [4]


def test_measurements_become_tables(tmp_path: Path) -> None:
    """Two models of a question make a table, with the change against the first."""
    variants = list(QUESTIONS["weights"].variants.values())
    lines = []
    for variant, size in zip(variants, (100.0, 110.0), strict=False):
        entry = {"scene": "made", "anchors": 5, "file": 1, "sections": {}, "variant": repr(variant), "seed": 0}
        lengths = {"features": size, "scalings": 0.0, "offsets": 0.0, "planes": 0.0, "networks": {"hyper": 0.0}}
        lines.append(report.json.dumps({**entry, **lengths}))
    (tmp_path / report.FILE).write_text("\n".join(lines))
    text = "\n".join(report.sections(tmp_path))
    assert "made" in text
    assert "+10.00 %" in text
    # The same models are of another question, which was asked of the scene.
    asked = [report.json.dumps({**report.json.loads(line), "question": "planes"}) for line in lines]
    (tmp_path / report.FILE).write_text("\n".join(asked))
    assert not report.sections(tmp_path)


def test_linear_prediction_finds_what_a_context_tells() -> None:
    """Scalings that are features to a factor cost little after them, and neighbours are no worse than nothing."""
    made = scene()
    found = measure(made)
    assert found["scalings after features"][1] < 0.5 * found["nothing"][1]
    assert found["slices (S)"][0] < found["nothing"][0]
    assert found["S, 8 nearest of all in space"][0] <= found["slices (S)"][0]
    assert rows(found)[1][-1] == "+0.0 %"


def test_means_of_neighbours_leave_out_oneself() -> None:
    """In a cell of two anchors each has the other's value; alone, it has none."""
    places = np.array([[10, 10, 0], [20, 20, 0], [60000, 60000, 0]])
    found = cell_means(np.array([[1.0], [4.0], [7.0]]), places, 2)[:, 0] + 4.0
    assert found.tolist() == [4.0, 1.0, 4.0]
    assert mean_of(np.array([[1.0], [3.0]]), np.array([[-1], [0]])).tolist() == [[0.0], [-1.0]]


def test_trainings_are_noted(tmp_path: Path) -> None:
    """What a folder reports of itself is a row."""
    folder = tmp_path / "scene"
    folder.mkdir()
    sizes = {"positions": 1, "attributes": 2, "masks": 3, "planes": 4, "weights": 5}
    settings = {"seed": 7, "weights": {"coarser": [0, 3], "rendering_bits": [8, 12]}}
    (folder / "training.json").write_text(report.json.dumps({"settings": settings, "psnr": 30.0, "bytes": sizes}))
    report.note_training(tmp_path, folder)
    assert report.trained(tmp_path)[-1] == "| scene | 7 | 0 to 3 | 8 to 12 | 2 | 5 | 15 | 30.000 |"
