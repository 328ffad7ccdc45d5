"""Substreams of rANS (SPEC.md 8) as the text decodes them, symbol by symbol: values, verdicts, escapes, raw bits."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from refcodec.bitstream.entropy import Decoder, Encoder, parse_substream, select
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.source import Piece
from refcodec.bitstream.tables import tables

WIDE = (1 << 31) - 1
# Groups of (mean, scale index).
Groups = list[list[tuple[int, int]]]
# The values of each group, and the first of the checks at the end that fails.
Decoded = tuple[list[list[int]], str | None]
Decode = Callable[..., Decoded]


@pytest.fixture(scope="module")
def by_the_text(spec: dict[str, Any]) -> Decode:
    """As the text decodes a substream of Gaussian values."""

    def decode(data: bytes, groups: Groups, lanes: int, limit: int = WIDE) -> Decoded:
        stream = spec["OPEN"](data, lanes)
        values = [spec["DECODE_VALUES"](stream, spec["GAUSS"], group, limit) for group in groups]
        return values, spec["END"](stream)

    return decode


def split(group: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """Means and scale indices."""
    mean, scale = np.array(group, dtype=np.int64).reshape(-1, 2).T
    return mean, scale


def no_name(stream: int, index: int) -> str:
    return ""


def coded(groups: Groups, values: list[list[int]], lanes: int, limit: int = WIDE) -> bytes:
    encoder = Encoder(1, lanes)
    for group, value in zip(groups, values, strict=True):
        encoder.values(tables().gauss, *split(group), [len(group)], limit, no_name, np.array(value, dtype=np.int64))
    return encoder.finish()[0]


def decoded(data: bytes, groups: Groups, lanes: int, limit: int = WIDE) -> Decoded:
    try:
        decoder = Decoder([parse_substream(Piece(data, 0), lanes, "test")])
    except BitstreamError as error:
        return [], error.kind.name
    out = [decoder.values(tables().gauss, *split(group), [len(group)], limit, no_name).tolist() for group in groups]
    verdict = decoder.finish()[0]
    return out, verdict.kind.name if verdict else None


def substream(seed: int, lanes: int) -> tuple[Groups, list[list[int]], bytes]:
    """Three groups and an empty one: near values, escapes and raw bits."""
    rng = np.random.default_rng(seed)
    groups, values = [], []
    for size in (5, 0, 9, 7):
        means, scales = rng.integers(-200, 200, size).tolist(), rng.integers(-40, 70, size).tolist()
        groups.append(list(zip(means, scales, strict=True)))
        values.append(
            [m // 16 + int(rng.normal(0, 1) * 2 ** (s / 8)) + int(rng.integers(0, 8) == 0) * 300 for m, s in groups[-1]]
        )
    return groups, values, coded(groups, values, lanes)


@pytest.mark.requirement("D8.2-1", "D8.3-1", "D8.5-1")
@pytest.mark.parametrize("lanes", [1, 2, 4])
@pytest.mark.parametrize("seed", range(4))
def test_values_come_back(by_the_text: Decode, seed: int, lanes: int) -> None:
    groups, values, data = substream(seed, lanes)
    assert by_the_text(data, groups, lanes) == decoded(data, groups, lanes) == (values, None)


@pytest.mark.requirement("D8.8-2")
@pytest.mark.parametrize("repaired", [False, True])
@pytest.mark.parametrize("lanes", [1, 2])
def test_each_changed_bit_has_the_verdict_of_the_text(by_the_text: Decode, lanes: int, repaired: bool) -> None:
    """Values and verdict of a substream with one changed bit.

    With the CRC-32 of its symbols made right, one that is accepted is canonical.
    """
    groups, _, data = substream(7, lanes)
    limit, seen = 5000, set()
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        # A changed word count or a state below its bound is refused before any symbol is decoded.
        if 32 <= bit < 64 or any(s < 1 << 16 for s in struct.unpack_from(f"<{lanes}I", changed, 8)):
            continue
        if repaired:
            values, _ = by_the_text(bytes(changed), groups, lanes, limit)
            symbols = b"".join(struct.pack("<i", v) for group in values for v in group)
            changed[:4] = zlib.crc32(symbols).to_bytes(4, "little")
        wanted = by_the_text(bytes(changed), groups, lanes, limit)
        assert decoded(bytes(changed), groups, lanes, limit) == wanted
        if wanted[1] is None:
            assert coded(groups, wanted[0], lanes, limit) == bytes(changed)
        seen.add(wanted[1])
    assert {"substream.words", "substream.final_state", "substream.raw_padding"} <= seen
    assert ("substream.symbol_crc" in seen) is not repaired
    assert (None in seen) is repaired, "a changed raw bit is another valid substream"


@pytest.mark.requirement("D8.7-1")
@pytest.mark.parametrize("sign", [1, -1])
def test_escapes_of_every_prefix(by_the_text: Decode, sign: int) -> None:
    """The first and the last size of each prefix: its bits are a sign, `prefix` zeros, a one and `prefix` bits."""
    radius = int(tables().gauss.radius[0])
    for prefix in range(24):
        for size in {1 << prefix, (2 << prefix) - 1}:
            # The mean is -1/2 step for this model: column 0 of row -40, centre 0.
            groups, values = [[(-8, -40)]], [[sign * (radius + size)]]
            data = coded(groups, values, 1)
            assert by_the_text(data, groups, 1) == decoded(data, groups, 1) == (values, None), prefix
            word_count = struct.unpack_from("<I", data, 4)[0]
            field = (sign < 0) | 1 << (prefix + 1) | (size - (1 << prefix)) << (prefix + 2)
            assert data[12 + 2 * word_count :] == field.to_bytes((2 * prefix + 2 + 7) // 8, "little")


def test_a_prefix_of_24_zeros_is_too_long(by_the_text: Decode) -> None:
    groups, values = [[(-8, -40)]], [[1 << 23]]
    data = coded(groups, values, 1)
    word_count = struct.unpack_from("<I", data, 4)[0]
    for zeros, wanted in ((23, "substream.symbol_crc"), (24, "substream.escape"), (25, "substream.escape")):
        raw = (1 << (zeros + 1)).to_bytes(16, "little")[: (2 * zeros + 9) // 8 if zeros < 24 else 4]
        changed = data[: 12 + 2 * word_count] + raw
        assert decoded(changed, groups, 1)[1] == by_the_text(changed, groups, 1)[1] == wanted


@pytest.mark.requirement("D8.6-1")
@pytest.mark.parametrize("width", range(17))
def test_raw_bits_of_every_width(by_the_text: Decode, width: int) -> None:
    scale = 16 + 8 * width if width else -40
    n = 9
    groups = [[(40 * i - 100, scale) for i in range(n)]]
    assert set(select(*split(groups[0]))[2].tolist()) == {width}
    values = [[(i * 2654435761) % (1 << width) + (((40 * i - 100) // 16) >> width << width) for i in range(n)]]
    data = coded(groups, values, 2)
    assert by_the_text(data, groups, 2) == decoded(data, groups, 2) == (values, None)
