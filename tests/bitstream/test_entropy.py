"""The entropy coder (SPEC.md 8) and its tables (Annex A)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from refcodec.bitstream import tables
from refcodec.bitstream.entropy import STATE_MIN, Decoder, Encoder, Substream, parse_substream, select
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.masks import mask_models
from refcodec.bitstream.source import Piece

LIMIT = (1 << 23) - 1
# Past every type, so that escapes of each length can be coded.
WIDE = (1 << 31) - 1
ROOT = Path(__file__).resolve().parents[2]


def no_name(stream: int, index: int) -> str:
    return f"{stream}:{index}"


def encode(groups: list, streams: int, lanes: int, limit: int = LIMIT) -> list[bytes]:
    """groups: (models, means, scales, counts, values); without scales the means are indices of binary models."""
    encoder = Encoder(streams, lanes)
    for models, mean, scale, counts, value in groups:
        if scale is None:
            encoder.plain(models, mean, counts, no_name, value)
        else:
            encoder.values(models, mean, scale, counts, limit, no_name, value)
    return encoder.finish()


def run(decoder: Decoder, groups: list, limit: int = LIMIT) -> tuple[list[np.ndarray], list]:
    values = [
        decoder.plain(models, mean, counts, no_name)
        if scale is None
        else decoder.values(models, mean, scale, counts, limit, no_name)
        for models, mean, scale, counts, _ in groups
    ]
    return values, decoder.finish()


def decode(data: list[bytes], groups: list, lanes: int, limit: int = LIMIT) -> tuple[list[np.ndarray], list]:
    return run(Decoder([parse_substream(Piece(d, 0), lanes, "test") for d in data]), groups, limit)


def random_group(
    rng: np.random.Generator, counts: list[int], kind: str, far_share: float, spread: int = 1 << 12
) -> tuple:
    """A group of one kind: values near their means, and a share of them anywhere."""
    n = sum(counts)
    if kind == "mask":
        frequencies = np.array([1, (1 << 14) - 1, 1 << 13, 5000], np.uint16)
        return mask_models(frequencies), rng.integers(0, 4, n), None, counts, rng.integers(0, 2, n)
    mean, scale = rng.integers(-spread, spread, n), rng.integers(-60, 200, n)
    near = np.rint(mean / 16 + rng.normal(0, 1, n) * 2.0 ** np.clip(scale / 8, -5, 18)).astype(np.int64)
    far = rng.choice([-1, 1], n) * (1 << rng.integers(0, 23, n))
    value = np.where(rng.random(n) < far_share, far, near)
    return getattr(tables.tables(), kind), mean, scale, counts, np.clip(value, -LIMIT, LIMIT)


@st.composite
def group_lists(draw: st.DrawFn) -> tuple[list, int, int]:
    """Groups with ragged and empty parts, some of binary symbols; values near the mean, far from it, at the limits."""
    streams, lanes = draw(st.integers(1, 4)), 1 << draw(st.integers(0, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    groups = []
    for _ in range(draw(st.integers(1, 4))):
        counts = draw(st.lists(st.integers(0, 20), min_size=streams, max_size=streams))
        kind = draw(st.sampled_from(["gauss", "laplace", "mask"]))
        groups.append(random_group(rng, counts, kind, draw(st.sampled_from([0.0, 0.1, 1.0]))))
    return groups, streams, lanes


@given(group_lists())
def test_groups_come_back(case: tuple[list, int, int]) -> None:
    groups, streams, lanes = case
    data = encode(groups, streams, lanes)
    values, verdicts = decode(data, groups, lanes)
    assert verdicts == [None] * streams
    for found, group in zip(values, groups, strict=True):
        assert np.array_equal(found, group[4])


@given(group_lists())
@settings(max_examples=20)
def test_a_substream_does_not_depend_on_its_neighbours(case: tuple[list, int, int]) -> None:
    """Coded alone or in a batch, a substream has the same bytes."""
    groups, streams, lanes = case
    data = encode(groups, streams, lanes)
    for stream in range(streams):
        alone = []
        for family, mean, scale, counts, value in groups:
            part = slice(sum(counts[:stream]), sum(counts[: stream + 1]))
            alone.append((family, mean[part], None if scale is None else scale[part], [counts[stream]], value[part]))
        assert encode(alone, 1, lanes) == [data[stream]]


@pytest.mark.parametrize("family", ["gauss", "laplace"])
def test_each_escape_prefix_and_each_raw_width(family: str) -> None:
    """The first and the last excess of each prefix, both signs, with the low bits all zeros and all ones."""
    models = getattr(tables.tables(), family)
    widths = set()
    for scale in [-40, *range(16, 152, 8)]:
        model, centre, raw = (int(x[0]) for x in select(np.array([0]), np.array([scale])))
        widths.add(raw)
        radius = int(models.radius[model])
        away = [radius + size for prefix in range(24) for size in (1 << prefix, (2 << prefix) - 1)]
        limit = WIDE << raw
        values = np.array(
            [((centre + sign * a) << raw) + low for a in away for sign in (1, -1) for low in {0, (1 << raw) - 1}]
        )
        # The CRC-32 is that of i32 symbols: the longest prefixes are there with few raw bits only.
        values = values[np.abs(values) <= WIDE]
        n = len(values)
        groups = [(models, np.zeros(n, np.int64), np.full(n, scale), [n], values)]
        data = encode(groups, 1, 2, limit)
        found, verdicts = decode(data, groups, 2, limit)
        assert verdicts == [None]
        assert np.array_equal(found[0], values)
    assert widths == set(range(17))


@pytest.mark.parametrize("prefix", [23, 24])
def test_the_longest_prefix(prefix: int) -> None:
    """23 zeros are allowed, 24 are not, and nothing else is wrong with that substream."""
    radius = int(tables.tables().gauss.radius[0])
    # At mean -1/2 and the smallest scale the model is the first one and its centre 0.
    groups = [(tables.tables().gauss, np.array([-8]), np.array([-40]), [1], np.array([radius + (1 << prefix)]))]
    _, verdicts = decode(encode(groups, 1, 1, WIDE), groups, 1, WIDE)
    if prefix == 23:
        assert verdicts == [None]
    else:
        assert verdicts[0].kind.name == "substream.escape"


@pytest.mark.parametrize(("past", "wanted"), [(0, None), (1, "substream.symbol_range")])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_symbol(past: int, wanted: str | None, sign: int) -> None:
    """A symbol at the limit of its type is accepted, the next one is not; the encoder refuses it too."""
    groups = [
        (tables.tables().gauss, np.zeros(1, np.int64), np.zeros(1, np.int64), [1], np.array([sign * (LIMIT + past)]))
    ]
    values, verdicts = decode(encode(groups, 1, 1, WIDE), groups, 1)
    assert (verdicts[0].kind.name if verdicts[0] else None) == wanted
    if wanted:
        assert values[0].tolist() == [0]
        with pytest.raises(ValueError, match=r"8\.5"):
            encode(groups, 1, 1)
    else:
        assert np.array_equal(values[0], groups[0][4])


CASES = {
    # lanes; (kind, symbols, share of values far from their mean) of each group
    "one lane": (1, [("gauss", 20, 0.1)]),
    "two lanes": (2, [("gauss", 9, 0.0), ("laplace", 0, 0.0), ("mask", 7, 0.0), ("gauss", 3, 1.0)]),
    "four lanes": (4, [("laplace", 11, 0.3), ("mask", 5, 0.0)]),
    "masks": (2, [("mask", 40, 0.0)]),
    "escapes": (1, [("gauss", 4, 1.0)]),
    "no symbol": (2, [("gauss", 0, 0.0)]),
}


@pytest.mark.parametrize("case", CASES)
def test_every_changed_bit_is_refused_or_canonical(case: str) -> None:
    """A substream with one bit changed is refused.

    With the CRC-32 of its symbols made right, it is refused, or it is exactly what its own symbols encode to.
    """
    lanes, kinds = CASES[case]
    rng = np.random.default_rng(3)
    groups = [random_group(rng, [n], kind, far, 64) for kind, n, far in kinds]
    data = encode(groups, 1, lanes)[0]
    refused, accepted = set(), 0
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << (bit % 8)
        try:
            stream = parse_substream(Piece(bytes(changed), 0), lanes, "test")
        except BitstreamError as error:
            refused.add(error.kind.name)
            continue
        first = Decoder([stream])
        _, verdicts = run(first, groups)
        assert verdicts[0] is not None, bit
        refused.add(verdicts[0].kind.name)
        # Whatever the symbols are, their CRC-32 is made right, so that nothing but the coder itself can refuse them.
        changed[:4] = first.crc[0].to_bytes(4, "little")
        found, verdicts = decode([bytes(changed)], groups, lanes)
        if verdicts[0] is None:
            again = [(*group[:4], values) for group, values in zip(groups, found, strict=True)]
            assert encode(again, 1, lanes)[0] == bytes(changed)
            accepted += bit >= 32
        else:
            refused.add(verdicts[0].kind.name)
    assert "substream.symbol_crc" in refused
    assert {"substream.length", "substream.final_state"} <= refused
    # Some changes, of raw bits above all, give another valid substream.
    assert (accepted > 0) == (case != "no symbol")


@pytest.mark.parametrize("case", CASES)
def test_every_cut_and_every_added_byte_is_refused(case: str) -> None:
    """Bytes at the end of a substream are raw bytes: one less, or one more, is one too few or too many."""
    lanes, kinds = CASES[case]
    groups = [random_group(np.random.default_rng(4), [n], kind, far, 64) for kind, n, far in kinds]
    data = encode(groups, 1, lanes)[0]
    raw = len(parse_substream(Piece(data, 0), lanes, "test").raw)
    for length in range(len(data)):
        if length < len(data) - raw:
            with pytest.raises(BitstreamError) as caught:
                decode([data[:length]], groups, lanes)
            assert caught.value.kind.name == "substream.length"
        else:
            _, verdicts = decode([data[:length]], groups, lanes)
            assert verdicts[0].kind.name in {"substream.raw_length", "substream.escape", "substream.symbol_range"}
    _, verdicts = decode([data + b"\0"], groups, lanes)
    assert verdicts[0].kind.name == "substream.raw_length"


@pytest.mark.requirement("D8.8-1")
def test_past_the_end_is_zero_and_bounded() -> None:
    """A substream without words or raw bytes decodes to something, and is refused."""
    n = 50
    groups = [(tables.tables().gauss, np.zeros(n, np.int64), np.full(n, 100), [n], None)]
    empty = Substream(0, np.full(2, STATE_MIN, np.uint32), np.empty(0, np.uint16), b"", 0, "test")
    decoder = Decoder([empty])
    assert len(decoder.values(*groups[0][:4], LIMIT, no_name)) == n
    verdict = decoder.finish()[0]
    assert verdict is not None
    assert verdict.kind.name == "substream.words"


@pytest.mark.parametrize("family", ["gauss", "laplace"])
def test_models(family: str) -> None:
    models = getattr(tables.tables(), family)
    assert len(models.offset) == tables.MODELS + 1
    starts = models.first.reshape(-1, 256)
    for index in range(tables.MODELS):
        start = models.offset[index]
        count = 2 * int(models.radius[index]) + 2
        lower, upper = models.lower[start : start + count].astype(int), models.upper[start : start + count].astype(int)
        assert lower[0] == 0
        assert upper[-1] == tables.TOTAL
        assert (lower[1:] == upper[:-1]).all()
        assert (upper > lower).all()
        assert upper[-1] - lower[-1] == 1
        # The symbol from which a slot is looked for is never past the right one.
        assert starts[index].tolist() == np.searchsorted(upper, np.arange(256) * 64, side="right").tolist()
        # A table is a distribution of the stated mean and scale: checked to the accuracy of 14 bits where it is wide
        # enough.
        x = np.arange(-models.radius[index], models.radius[index] + 1)
        p = (upper - lower)[:-1] / tables.TOTAL
        mean = (p * x).sum()
        scale = 2.0 ** ((index // 16 + tables.SCALE_MIN) / 8)
        if scale > 1:
            assert abs(mean - (index % 16 / 16 - 0.5)) < 0.02
            deviation = scale * (1 if family == "gauss" else 2**0.5)
            assert abs(np.sqrt((p * (x - mean) ** 2).sum() + 1 / 12) / deviation - 1) < 0.1


@pytest.mark.requirement("DA-1")
def test_a_damaged_table_file_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "TABLES_SHA256", "0" * 64)
    with pytest.raises(RuntimeError, match="damaged"):
        tables.tables_bytes.__wrapped__()
