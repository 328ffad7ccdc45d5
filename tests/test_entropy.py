"""The entropy coder (SPEC.md 8) and its tables (Annex A)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from refcodec import tables
from refcodec.entropy import ESCAPE_PREFIX_MAX, STATE_MIN, Decoder, Encoder, Substream, parse_substream, select

LIMIT = (1 << 23) - 1
ROOT = Path(__file__).resolve().parent.parent


def no_name(stream: int, index: int) -> str:
    return f"{stream}:{index}"


def encode(groups: list, streams: int, lanes: int) -> list[bytes]:
    """groups: (family, means, scales, counts, values)."""
    encoder = Encoder(streams, lanes)
    for family, mean, scale, counts, value in groups:
        encoder.values(family, mean, scale, counts, LIMIT, no_name, value)
    return encoder.finish()


def decode(data: list[bytes], groups: list, lanes: int) -> tuple[list[np.ndarray], list]:
    decoder = Decoder([parse_substream(d, 0, len(d), lanes, "test") for d in data])
    values = [decoder.values(family, mean, scale, counts, LIMIT, no_name) for family, mean, scale, counts, _ in groups]
    return values, decoder.finish()


@st.composite
def group_lists(draw: st.DrawFn) -> tuple[list, int, int]:
    """Groups with ragged and empty parts; values near the mean, far from it, and at the limits."""
    streams, lanes = draw(st.integers(1, 4)), 1 << draw(st.integers(0, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    groups = []
    for _ in range(draw(st.integers(1, 4))):
        counts = draw(st.lists(st.integers(0, 20), min_size=streams, max_size=streams))
        n = sum(counts)
        family = tables.tables().gauss if draw(st.booleans()) else tables.tables().laplace
        mean, scale = rng.integers(-(1 << 12), 1 << 12, n), rng.integers(-60, 200, n)
        near = np.rint(mean / 16 + rng.normal(0, 1, n) * 2.0 ** np.clip(scale / 8, -5, 18)).astype(np.int64)
        far = rng.choice([-1, 1], n) * (1 << rng.integers(0, 23, n))
        value = np.where(rng.random(n) < draw(st.sampled_from([0.0, 0.1, 1.0])), far, near)
        groups.append((family, mean, scale, counts, np.clip(value, -LIMIT, LIMIT)))
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
            alone.append((family, mean[part], scale[part], [counts[stream]], value[part]))
        assert encode(alone, 1, lanes) == [data[stream]]


def test_each_escape_prefix_and_each_raw_width() -> None:
    family = tables.tables().gauss
    for scale in [-40, *range(16, 152, 8)]:
        model, centre, raw = (int(x[0]) for x in select(np.array([0]), np.array([scale])))
        radius = int(family.radius[model])
        away = [radius + (1 << prefix) for prefix in range(ESCAPE_PREFIX_MAX + 1)] + [radius + (2 << prefix) - 1 for prefix in range(24)]
        values = [((centre + sign * a) << raw) + low for a in away for sign in (1, -1) for low in {0, (1 << raw) - 1}]
        values = np.array([v for v in values if abs(v) <= LIMIT])
        n = len(values)
        groups = [(family, np.zeros(n, np.int64), np.full(n, scale), [n], values)]
        data = encode(groups, 1, 2)
        found, verdicts = decode(data, groups, 2)
        assert verdicts == [None]
        assert np.array_equal(found[0], values)
    assert raw == 16


def test_every_changed_bit_is_refused_or_canonical() -> None:
    """A substream with one bit changed is refused, or it is exactly what its own symbols encode to."""
    rng = np.random.default_rng(3)
    n = 30
    mean, scale = rng.integers(-64, 64, n), rng.integers(-40, 60, n)
    value = np.rint(mean / 16 + rng.normal(0, 4, n)).astype(np.int64)
    groups = [(tables.tables().gauss, mean, scale, [n], value)]
    data = encode(groups, 1, 2)[0]
    refused = set()
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << (bit % 8)
        try:
            stream = parse_substream(bytes(changed), 0, len(changed), 2, "test")
        except Exception as error:
            refused.add(error.kind.name)  # type: ignore[attr-defined]
            continue
        # Whatever the symbols are, their CRC-32 is made right, so that nothing but the coder itself can refuse them.
        first = Decoder([stream])
        first.values(*groups[0][:4], LIMIT, no_name)
        repaired = Substream(first.crc[0], stream.states, stream.words, stream.raw, 0, "test")
        second = Decoder([repaired])
        found = second.values(*groups[0][:4], LIMIT, no_name)
        verdict = second.finish()[0]
        if verdict is None:
            assert encode([(*groups[0][:4], found)], 1, 2)[0][8:] == bytes(changed)[8:]
        else:
            refused.add(verdict.kind.name)
    assert {"substream.length", "substream.words", "substream.final_state", "substream.raw_padding"} <= refused


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
    for index in range(tables.MODELS):
        start = models.offset[index]
        count = 2 * int(models.radius[index]) + 2
        lower, upper = models.lower[start : start + count].astype(int), models.upper[start : start + count].astype(int)
        assert lower[0] == 0
        assert upper[-1] == tables.TOTAL
        assert (lower[1:] == upper[:-1]).all()
        assert (upper > lower).all()
        assert upper[-1] - lower[-1] == 1
        # A table is a distribution of the stated mean and scale: checked to the accuracy of 14 bits where it is wide enough.
        x = np.arange(-models.radius[index], models.radius[index] + 1)
        p = (upper - lower)[:-1] / tables.TOTAL
        mean = (p * x).sum()
        scale = 2.0 ** ((index // 16 + tables.SCALE_MIN) / 8)
        if scale > 1:
            assert abs(mean - (index % 16 / 16 - 0.5)) < 0.02
            deviation = scale * (1 if family == "gauss" else 2**0.5)
            assert abs(np.sqrt((p * (x - mean) ** 2).sum() + 1 / 12) / deviation - 1) < 0.1


def test_the_tables_follow_their_rules() -> None:
    """Annex A's rules, with 50 digits, give the shipped file."""
    done = subprocess.run([sys.executable, str(ROOT / "tools" / "make_tables.py"), "--check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert tables.TABLES_SHA256 in done.stdout


def test_a_damaged_table_file_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "TABLES_SHA256", "0" * 64)
    with pytest.raises(RuntimeError, match="damaged"):
        tables.tables.__wrapped__()
