"""Code lengths and curves of the page, against the probabilities of SPEC.md's rules for each value."""

from __future__ import annotations

import math

import numpy as np
import pytest

from refcodec.bitstream.entropy import select
from refcodec.bitstream.tables import TOTAL, tables
from refcodec.inspect.page.lengths import LIMIT, Tally
from refcodec.inspect.page.pictures import palette, png
from refcodec.pages.plots import bars, histogram


def probability(family: str, mean: int, scale: int, value: int) -> float:
    """SPEC 8.5 to 8.7: the probability of one value, with its raw bits and its escape."""
    models = getattr(tables(), family)
    model, centre, raw = (int(x[0]) for x in select(np.array([mean]), np.array([scale])))
    radius, start = int(models.radius[model]), int(models.offset[model])
    away = (value >> raw) - centre
    escaped = abs(away) > radius
    at = start + (2 * radius + 1 if escaped else away + radius)
    found = (int(models.upper[at]) - int(models.lower[at])) / TOTAL / 2**raw
    if escaped:
        zeros = (abs(away) - radius).bit_length() - 1
        found /= 2 ** (2 + 2 * zeros)
    return found


CASES = [
    ("gauss", [(0, 0), (5, 3), (-37, -20), (200, 23), (8, -40), (40, 30), (-16 * 300, 60), (16 * 505, 10)]),
    ("laplace", [(0, 0), (-3, 23), (100, -40), (16 * 20, 44), (16 * 700, 5), (-16 * 10_000, 0), (0, 150)]),
]


@pytest.mark.parametrize(("family", "parameters"), CASES)
def test_curve_and_bits(family: str, parameters: list[tuple[int, int]]) -> None:
    models, tally = getattr(tables(), family), Tally(3)
    values = [0, 1, -9, 30, 511, -512, 4000, 16 * 40][: len(parameters)]
    mean, scale = (np.array(each) for each in zip(*parameters, strict=True))
    channel = np.arange(len(parameters)) % 3
    bits = tally.add(models, mean, scale, np.array(values[: len(mean)]), channel)
    wanted = [-math.log2(probability(family, *p, v)) for p, v in zip(parameters, values, strict=False)]
    assert bits == pytest.approx(wanted)
    assert tally.bits == pytest.approx(sum(wanted))
    assert tally.channel_bits == pytest.approx([sum(wanted[i::3]) for i in range(3)])
    every = range(-LIMIT, LIMIT + 1)
    curve = [sum(probability(family, *p, value) for p in parameters) for value in every]
    # A model whose centre is far past the limit reaches it with escapes alone, which are left out.
    assert tally.curve == pytest.approx(curve, abs=1e-6)
    assert tally.histogram.sum() + tally.beyond == tally.symbols == len(bits)
    assert tally.histogram.tolist() == [values[: len(mean)].count(value) for value in every]


def test_what_models_promise_is_the_mean_of_their_lengths() -> None:
    for family in ("gauss", "laplace"):
        tally = Tally(1)
        tally.add(getattr(tables(), family), np.array([5]), np.array([9]), np.array([0]), np.array([0]))
        chances = [probability(family, 5, 9, value) for value in range(-40_000, 40_001)]
        assert sum(chances) == pytest.approx(1, abs=1e-6)
        assert tally.expected == pytest.approx(sum(-p * math.log2(p) for p in chances), abs=1e-4)


def test_the_misfit_is_small_where_symbols_come_as_expected() -> None:
    """Symbols as often as a model says, and the same ones with a model that is twice as wide."""
    counts = [round(200_000 * probability("gauss", 0, 8, value)) for value in range(-40, 41)]
    values = np.repeat(np.arange(-40, 41), counts)
    zeros = np.zeros_like(values)
    fits, wide = Tally(1), Tally(1)
    fits.add(tables().gauss, zeros, zeros + 8, values, zeros)
    wide.add(tables().gauss, zeros, zeros + 16, values, zeros)
    assert fits.misfit / len(values) < 1e-4
    assert fits.bits == pytest.approx(fits.expected, rel=1e-3)
    assert fits.bits == pytest.approx(fits.entropy, rel=1e-3)
    # With one model for all symbols, all that they cost beyond their entropy is the misfit.
    assert wide.misfit == pytest.approx(wide.bits - wide.entropy, rel=1e-3)
    assert wide.misfit / len(values) > 0.1
    assert wide.bits < wide.expected


def test_pictures_are_png(tmp_path) -> None:
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(3).integers(0, 256, (7, 5)).astype(np.uint8)
    for grey in (True, False):
        (tmp_path / "x.png").write_bytes(png(pixels, grey))
        found = np.array(image.open(tmp_path / "x.png").convert("RGB"))
        wanted = np.repeat(pixels[..., None], 3, axis=2) if grey else palette()[pixels]
        assert np.array_equal(found, wanted)


def test_plots_join_values_that_are_too_many() -> None:
    counts = np.zeros(2 * LIMIT + 1, dtype=np.int64)
    counts[[0, LIMIT - 1, LIMIT, LIMIT + 7]] = 3, 40, 1000, 5
    drawn = histogram("words", counts, counts.astype(np.float64), "symbol", "times")
    assert drawn.x_label.endswith("a bar is the mean of 4")
    assert len(drawn.bars) == 3
    narrow = histogram("words", counts[LIMIT - 9 : LIMIT + 10], np.zeros(19), "symbol", "times")
    assert narrow.x_label == "symbol"
    assert [title for *_, title in narrow.bars] == ["-1: 40", "0: 1,000", "7: 5"]
    flat = bars("words", [0.0, 0.0], ["a", "b"], "x", "y", [0.0, 0.0])
    assert len(flat.bars) == len(flat.lines) == 2
