"""Code lengths on the page, against the probabilities of SPEC.md's rules for each value; pictures and plots."""

import math

import numpy as np
import pytest

from refcodec.bitstream.entropy import select
from refcodec.bitstream.tables import TOTAL, tables
from refcodec.inspect.page.measures import LIMIT, Tally
from refcodec.inspect.page.pictures import palette, png
from refcodec.pages.plots import bars


def probability(family: str, mean: int, scale: int, value: int) -> float:
    """SPEC 8.5 to 8.7: the probability of one value, with its raw bits and its escape."""
    models = getattr(tables(), family)
    model, centre, raw = (int(x[0]) for x in select(np.array([mean]), np.array([scale])))
    radius, start = int(models.radius[model]), int(models.offset[model])
    away = (value >> raw) - centre
    escaped = abs(away) > radius
    at = start + (2 * radius + 1 if escaped else away + radius)
    share = (int(models.upper[at]) - int(models.lower[at])) / TOTAL / 2**raw
    if escaped:
        zeros = (abs(away) - radius).bit_length() - 1
        share /= 2 ** (2 + 2 * zeros)
    return share


CASES = [
    ("gauss", [(0, 0), (5, 3), (-37, -20), (200, 23), (8, -40), (40, 30), (-16 * 300, 60), (16 * 505, 10)]),
    ("laplace", [(0, 0), (-3, 23), (100, -40), (16 * 20, 44), (16 * 700, 5), (-16 * 10_000, 0), (0, 150)]),
]


@pytest.mark.parametrize(("family", "parameters"), CASES)
def test_bits(family: str, parameters: list[tuple[int, int]]) -> None:
    models, tally = getattr(tables(), family), Tally(3)
    values = [0, 1, -9, 30, 511, -512, 4000, 16 * 40][: len(parameters)]
    mean, scale = (np.array(each) for each in zip(*parameters, strict=True))
    bits = tally.add(models, mean, scale, np.array(values), np.arange(len(parameters)) % 3)
    wanted = [-math.log2(probability(family, *p, v)) for p, v in zip(parameters, values, strict=True)]
    assert bits == pytest.approx(wanted)
    assert tally.bits == pytest.approx(sum(wanted))
    assert tally.channel_bits == pytest.approx([sum(wanted[i::3]) for i in range(3)])
    assert tally.beyond == sum(abs(value) > LIMIT for value in values)
    assert tally.counts.sum() == tally.symbols == len(values)


def test_entropy_is_that_of_each_channel() -> None:
    tally, values = Tally(2), np.array([0, 7, 0, 7, 0, 7, 1, 7])
    zeros = np.zeros(8, np.int64)
    tally.add(tables().gauss, zeros, zeros, values, np.arange(8) % 2)
    # Four symbols, of which three are 0, and four equal ones.
    assert tally.entropy == pytest.approx(3 * math.log2(4 / 3) + 2)


def test_pictures_are_png(tmp_path) -> None:
    image = pytest.importorskip("PIL.Image")
    pixels = np.random.default_rng(3).integers(0, 256, (7, 5)).astype(np.uint8)
    for grey in (True, False):
        (tmp_path / "x.png").write_bytes(png(pixels, grey))
        shown = np.array(image.open(tmp_path / "x.png").convert("RGB"))
        wanted = np.repeat(pixels[..., None], 3, axis=2) if grey else palette()[pixels]
        assert np.array_equal(shown, wanted)


def test_bars_may_have_no_height() -> None:
    flat = bars("words", [0.0, 0.0], ["a", "b"], "x", "y")
    assert [height for *_, height, _ in flat.bars] == [0.0, 0.0]
