"""The entropy coder (SPEC.md 8) and its tables (Annex A): values and verdicts are those of the text."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from refcodec.bitstream import tables
from refcodec.bitstream.entropy import STATE_MIN, Decoder, Encoder, Substream, ValueGroup, parse_substream, select
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.masks import mask_models
from refcodec.bitstream.source import Piece

Spec = dict[str, Any]
LIMIT = (1 << 23) - 1
# Past every type, so that escapes of each length can be coded.
WIDE = (1 << 31) - 1
FREQUENCIES = [1, (1 << 14) - 1, 1 << 13, 5000]


def no_name(stream: int, index: int) -> str:
    return f"{stream}:{index}"


class Group:
    """Symbols of one kind in several streams: values near their means, and a share of them far away.

    counts: the number of each stream. kind: "gauss", "laplace", or "mask", whose means are numbers of binary models.
    """

    def __init__(self, kind: str, counts: list[int], mean: Any, scale: Any, value: Any) -> None:
        self.kind, self.counts = kind, counts
        self.mean, self.scale, self.value = (np.asarray(x, np.int64) for x in (mean, scale, value))
        masks = kind == "mask"
        self.models = mask_models(np.array(FREQUENCIES, np.uint16)) if masks else getattr(tables.tables(), kind)

    @classmethod
    def random(cls, rng: np.random.Generator, kind: str, counts: list[int], far: float, spread: int = 1 << 12) -> Group:
        n = sum(counts)
        if kind == "mask":
            return cls(kind, counts, rng.integers(0, 4, n), np.zeros(n), rng.integers(0, 2, n))
        mean, scale = rng.integers(-spread, spread, n), rng.integers(-60, 200, n)
        near = np.rint(mean / 16 + rng.normal(0, 1, n) * 2.0 ** np.clip(scale / 8, -5, 18)).astype(np.int64)
        value = np.where(rng.random(n) < far, rng.choice([-1, 1], n) * (1 << rng.integers(0, 23, n)), near)
        return cls(kind, counts, mean, scale, np.clip(value, -LIMIT, LIMIT))

    def coded(self, coder: Encoder | Decoder, limit: int, *value: np.ndarray) -> Any:
        """Encodes values, or decodes them."""
        if self.kind == "mask":
            return coder.plain(self.models, self.mean, self.counts, no_name, *value)
        return coder.values(ValueGroup(self.models, self.mean, self.scale, self.counts, limit, no_name, *value))

    def by_the_text(self, spec: Spec, opened: Any, stream: int, limit: int) -> list[int]:
        """The values of a stream as SPEC.md's blocks decode them."""
        part = slice(sum(self.counts[:stream]), sum(self.counts[: stream + 1]))
        if self.kind == "mask":
            models = [[(1 << spec["PRECISION"]) - FREQUENCIES[m], FREQUENCIES[m]] for m in self.mean[part].tolist()]
            decoded: list[int] = spec["DECODE_GROUP"](opened, models)
            spec["NOTE_SYMBOLS"](opened, decoded)
            return decoded
        pairs = list(zip(self.mean[part].tolist(), self.scale[part].tolist(), strict=True))
        values: list[int] = spec["DECODE_VALUES"](opened, spec[self.kind.upper()], pairs, limit)
        return values


def encode(groups: list[Group], lanes: int, limit: int = LIMIT, values: list[Any] | None = None) -> list[bytes]:
    encoder = Encoder(len(groups[0].counts), lanes)
    for number, group in enumerate(groups):
        group.coded(encoder, limit, group.value if values is None else np.asarray(values[number], np.int64))
    return encoder.finish()


def decode(
    data: list[bytes], groups: list[Group], lanes: int, limit: int = LIMIT
) -> tuple[list[Any], list[str | None]]:
    """The values of each group, and for each stream the name of the first check at the end that fails."""
    decoder = Decoder([parse_substream(Piece(d, 0), lanes, "test") for d in data])
    values = [group.coded(decoder, limit).tolist() for group in groups]
    return values, [verdict.kind.name if verdict else None for verdict in decoder.finish()]


def by_the_text(
    spec: Spec, data: bytes, groups: list[Group], lanes: int, stream: int = 0, limit: int = LIMIT
) -> tuple[list[list[int]], str | None]:
    opened = spec["OPEN"](data, lanes)
    return [group.by_the_text(spec, opened, stream, limit) for group in groups], spec["END"](opened)


def assert_round_trip(spec: Spec, groups: list[Group], lanes: int, limit: int = LIMIT) -> list[bytes]:
    """Values come back. The text decodes each stream by itself, so that no stream depends on its neighbours."""
    data = encode(groups, lanes, limit)
    assert decode(data, groups, lanes, limit) == ([group.value.tolist() for group in groups], [None] * len(data))
    for stream, own in enumerate(data):
        ends = [(sum(g.counts[:stream]), sum(g.counts[: stream + 1])) for g in groups]
        wanted = [g.value[first:end].tolist() for g, (first, end) in zip(groups, ends, strict=True)]
        assert by_the_text(spec, own, groups, lanes, stream, limit) == (wanted, None)
    return data


@st.composite
def group_lists(draw: st.DrawFn) -> tuple[list[Group], int]:
    """Groups with ragged and empty parts, some of binary symbols; values near the mean, far from it, at the limits."""
    streams, lanes = draw(st.integers(1, 4)), 1 << draw(st.integers(0, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kinds = st.sampled_from(["gauss", "laplace", "mask"])
    counts = st.lists(st.integers(0, 20), min_size=streams, max_size=streams)
    groups = [
        Group.random(rng, draw(kinds), draw(counts), draw(st.sampled_from([0.0, 0.1, 1.0])))
        for _ in range(draw(st.integers(1, 4)))
    ]
    return groups, lanes


@pytest.mark.requirement("D8.2-1", "D8.3-1", "D8.5-1", "D8.6-1")
@given(group_lists())
def test_groups_come_back(spec: Spec, case: tuple[list[Group], int]) -> None:
    assert_round_trip(spec, *case)


@pytest.mark.requirement("D8.6-1", "D8.7-1")
@pytest.mark.parametrize("family", ["gauss", "laplace"])
def test_each_escape_prefix_and_each_raw_width(spec: Spec, family: str) -> None:
    """The first and the last excess of each prefix, both signs, with the low bits all zeros and all ones."""
    models = getattr(tables.tables(), family)
    widths = set()
    for scale in [-40, *range(16, 152, 8)]:
        model, centre, raw = (int(x[0]) for x in select(np.array([0]), np.array([scale])))
        widths.add(raw)
        radius = int(models.radius[model])
        away = [radius + size for prefix in range(24) for size in {1 << prefix, (2 << prefix) - 1}]
        ends = {0, (1 << raw) - 1}
        values = np.array([((centre + sign * a) << raw) + low for a in away for sign in (1, -1) for low in ends])
        # The CRC-32 is that of i32 symbols: the longest prefixes are there with few raw bits only.
        values = values[np.abs(values) <= WIDE]
        n = len(values)
        assert_round_trip(spec, [Group(family, [n], np.zeros(n), np.full(n, scale), values)], 2, WIDE << raw)
    assert widths == set(range(17))


@pytest.mark.requirement("D8.7-1")
@pytest.mark.parametrize(("sign", "prefix", "last"), [(s, p, e) for s in (1, -1) for p in (0, 1, 23) for e in (0, 1)])
def test_the_bits_of_an_escape(sign: int, prefix: int, last: int) -> None:
    """A sign, `prefix` zeros, a one and `prefix` bits. The mean is -1/2 step: centre 0 of the first model."""
    size = (2 << prefix) - 1 if last else 1 << prefix
    radius = int(tables.tables().gauss.radius[0])
    (data,) = encode([Group("gauss", [1], [-8], [-40], [sign * (radius + size)])], 1, WIDE)
    field = (sign < 0) | 1 << (prefix + 1) | (size - (1 << prefix)) << (prefix + 2)
    words = struct.unpack_from("<I", data, 4)[0]
    assert data[12 + 2 * words :] == field.to_bytes((2 * prefix + 2 + 7) // 8, "little")


def test_a_prefix_of_24_zeros_is_too_long(spec: Spec) -> None:
    """And nothing else is wrong with that substream."""
    radius = int(tables.tables().gauss.radius[0])
    for prefix, wanted in ((23, None), (24, "substream.escape")):
        groups = [Group("gauss", [1], [-8], [-40], [radius + (1 << prefix)])]
        (data,) = encode(groups, 1, WIDE)
        assert decode([data], groups, 1, WIDE)[1] == [wanted]
        assert by_the_text(spec, data, groups, 1, limit=WIDE)[1] == wanted


@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_symbol(sign: int) -> None:
    """A symbol at the limit of its type is accepted, the next one is not; the encoder refuses it too."""
    for past, wanted in ((0, None), (1, "substream.symbol_range")):
        groups = [Group("gauss", [1], [0], [0], [sign * (LIMIT + past)])]
        assert decode(encode(groups, 1, WIDE), groups, 1)[1] == [wanted]
    with pytest.raises(ValueError, match=r"8\.5"):
        encode(groups, 1)


CASES = {
    # lanes; (kind, symbols, share of values far from their mean) of each group
    "one lane": (1, [("gauss", 20, 0.1)]),
    "two lanes": (2, [("gauss", 9, 0.0), ("laplace", 0, 0.0), ("mask", 7, 0.0), ("gauss", 3, 1.0)]),
    "four lanes": (4, [("laplace", 11, 0.3), ("mask", 5, 0.0)]),
    "escapes": (1, [("gauss", 4, 1.0)]),
    "no symbol": (2, [("gauss", 0, 0.0)]),
}


def of_case(case: str, seed: int) -> tuple[int, list[Group], bytes]:
    lanes, kinds = CASES[case]
    rng = np.random.default_rng(seed)
    groups = [Group.random(rng, kind, [n], far, 64) for kind, n, far in kinds]
    return lanes, groups, encode(groups, lanes)[0]


@pytest.mark.requirement("D8.8-2")
@pytest.mark.parametrize("case", CASES)
def test_each_changed_bit_has_the_verdict_of_the_text(spec: Spec, case: str) -> None:
    """With the CRC-32 of its symbols made right, one that is accepted is what its symbols encode to."""
    lanes, groups, data = of_case(case, 3)
    seen: set[str | None] = set()
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        for repaired in (False, True):
            try:
                values, (verdict,) = decode([bytes(changed)], groups, lanes)
            except BitstreamError as error:
                seen.add(error.kind.name)
                break
            wanted = by_the_text(spec, bytes(changed), groups, lanes)
            assert (values, verdict) == wanted, bit
            assert verdict is not None or repaired, "a changed bit without a right CRC-32 is refused"
            if verdict is None:
                assert encode(groups, lanes, values=values) == [bytes(changed)]
            seen.add(verdict)
            symbols = b"".join(struct.pack("<i", v) for group in wanted[0] for v in group)
            changed[:4] = zlib.crc32(symbols).to_bytes(4, "little")
    assert {"substream.symbol_crc", "substream.length", "substream.final_state"} <= seen
    # Some changes, of raw bits above all, give another valid substream. Without symbols, it is the same one.
    assert None in seen


@pytest.mark.parametrize("case", CASES)
def test_every_cut_and_every_added_byte_is_refused(case: str) -> None:
    """Bytes at the end of a substream are raw bytes: one less, or one more, is one too few or too many."""
    lanes, groups, data = of_case(case, 4)
    raw = len(parse_substream(Piece(data, 0), lanes, "test").raw)
    for length in range(len(data) - raw):
        with pytest.raises(BitstreamError) as caught:
            decode([data[:length]], groups, lanes)
        assert caught.value.kind.name == "substream.length"
    for length in range(len(data) - raw, len(data)):
        (verdict,) = decode([data[:length]], groups, lanes)[1]
        assert verdict in {"substream.raw_length", "substream.escape", "substream.symbol_range"}
    assert decode([data + b"\0"], groups, lanes)[1] == ["substream.raw_length"]


@pytest.mark.requirement("D8.8-1")
def test_past_the_end_is_zero_and_bounded() -> None:
    """A substream without words or raw bytes decodes to something, and is refused."""
    group = Group("gauss", [50], np.zeros(50), np.full(50, 100), np.zeros(50))
    decoder = Decoder([Substream(0, np.full(2, STATE_MIN, np.uint32), np.empty(0, np.uint16), b"", 0, "test")])
    assert len(group.coded(decoder, LIMIT)) == 50
    (verdict,) = decoder.finish()
    assert verdict.kind.name == "substream.words"


# --- tables -----------------------------------------------------------------------------------------------------------


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
