"""Hostile values, field by field (SPEC.md 10 and 13): each element of a file is set, and the checksums made right."""

from __future__ import annotations

import struct
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_hostile import refused

from conformance.cases.checksums import layout, repair
from conformance.cases.scenes import MAIN_DIMENSIONS, random_scene, without_chunks
from refcodec.bitstream import codec, directory, header, syntax
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import Lanes

SCENE = random_scene(
    41, 9, Dimensions(2, (1, 2), 1, 1, 3, (2,), (2,), (2,), 1), chunk_size=4, lanes=Lanes(0, 1, 0), spread=20
)
DATA = codec.emit(replace(SCENE, extensions=((3, 7, b"abc"),)))
SPAN = {kind: (s.start, s.end) for kind, s in parse_container(DATA).sections.items()}


def elements() -> list[tuple[int, int]]:
    """(offset, bytes) of each element, from the header to the heads and states of the substreams."""
    found = [(e.start, e.end - e.start) for e in syntax.parse_elements("Header", DATA, header.PROLOGUE_BYTES)]
    found += [(e.start, e.end - e.start) for e in syntax.parse_elements("Frame", DATA, SPAN[directory.FRAME][0])]
    at, end = SPAN[directory.WEIGHTS]
    found += [(at, 1), (at + 1, 1), (at + 2, 1)] + [(a, 4) for a in range(at + 3, end, 4)]
    at = SPAN[directory.PLANES_SECTION][0]
    lengths = struct.unpack_from("<5I", DATA, at)
    found += [(at + 4 * i, 4) for i in range(5)]
    streams = [at + 20 + sum(lengths[:i]) for i in range(5)]
    table = SPAN[directory.CHUNK_TABLE][0] + 6
    found += [(table - 6 + 2 * i, 2) for i in range(3)] + [
        (a, 4) for a in range(table, SPAN[directory.CHUNK_TABLE][1], 4)
    ]
    found += [(a, 2) for a in range(*SPAN[directory.POSITIONS], 2)]
    for kind, column in ((directory.MASKS, 8), (directory.ATTRIBUTES, 16)):
        start = SPAN[kind][0]
        for chunk in range(3):
            streams.append(start)
            start += struct.unpack_from("<I", DATA, table + 24 * chunk + column)[0]
    return found + [(s + 4 * i, 4) for s in streams for i in range(3)]


ELEMENTS = elements()


@st.composite
def faults(draw: st.DrawFn) -> bytes:
    """The file with one to three elements at values that stand at an edge of their type, or next to what they were."""
    out = bytearray(DATA)
    for _ in range(draw(st.integers(1, 3))):
        at, size = draw(st.sampled_from(ELEMENTS))
        top = 1 << 8 * size
        old = int.from_bytes(out[at : at + size], "little")
        edges = [0, 1, top - 1, top // 2, top // 2 - 1, old + 1, old - 1, old ^ (top // 2), 2 * old, old // 2]
        if size == 4:
            edges += [
                struct.unpack("<I", struct.pack("<f", v))[0]
                for v in (1e-45, -0.0, 3.4e38, 1024.0, float("nan"), float("inf"))
            ]
        value = draw(st.one_of(st.sampled_from(edges), st.integers(0, top - 1))) % top
        out[at : at + size] = value.to_bytes(size, "little")
    return repair(bytes(out))


@pytest.mark.slow
@pytest.mark.no_cover
@given(faults())
@settings(max_examples=500)
def test_any_field_at_any_edge(data: bytes) -> None:
    refused(data)


@pytest.mark.slow
@pytest.mark.no_cover
def test_each_field_at_each_edge() -> None:
    """Every element alone, at zero, at all ones and with its highest bit changed."""
    names = set()
    weights = range(SPAN[directory.WEIGHTS][0] + 15, SPAN[directory.WEIGHTS][1])
    # Of the weights a few are enough: they are alike.
    for at, size in (e for e in ELEMENTS if e[0] not in weights):
        for change in (0, (1 << 8 * size) - 1, int.from_bytes(DATA[at : at + size], "little") ^ 1 << (8 * size - 1)):
            data = DATA[:at] + change.to_bytes(size, "little") + DATA[at + size :]
            error = refused(repair(data))
            names.add(error.kind.name if error else "accepted")
    assert len(names) > 25, sorted(names)


@pytest.mark.requirement("D13.1-1")
@pytest.mark.parametrize("keep_going", [False, True])
def test_a_header_of_many_chunks_allocates_little(keep_going: bool) -> None:
    """Profile Main, 2^24 anchors in chunks of 256, and no byte behind the header."""
    data = codec.emit(random_scene(42, 0, replace(MAIN_DIMENSIONS, plane_size=2), chunk_size=256))
    _, end = layout(data)
    asked = bytearray(data)
    asked[24:28] = (1 << 24).to_bytes(4, "little")
    asked[21] = 3
    small = repair(bytes(asked))[:end]
    tracemalloc.start()
    try:
        with pytest.raises(BitstreamError) as caught:
            codec.parse(small, keep_going=keep_going)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert caught.value.kind.name == "directory.length"
    assert peak < 2 << 20, peak


@pytest.mark.parametrize("cut", range(0, 400, 7))
def test_keep_going_at_every_cut(cut: int) -> None:
    """Whatever is lost, the damage names it, within the file, and the rest is as it was."""
    start = SPAN[directory.POSITIONS][0]
    length = min(start + cut, len(DATA))
    parsed = codec.parse(DATA[:length], keep_going=True)
    for error in parsed.damage.values():
        assert error.kind.name == "chunks.crc"
        assert 0 <= error.offset <= length
    wanted = without_chunks(SCENE, sorted(parsed.damage))
    assert parsed.scene.positions.tobytes() == wanted.positions.tobytes()
    assert np.array_equal(parsed.scene.attributes.features, wanted.attributes.features)
    # A chunk is damaged exactly when one of its parts is not all there.
    table = SPAN[directory.CHUNK_TABLE][0] + 6
    for chunk in range(3):
        ends = []
        for column, kind in enumerate(directory.CHUNKED):
            sizes = [struct.unpack_from("<I", DATA, table + 24 * c + 8 * column)[0] for c in range(chunk + 1)]
            ends.append(SPAN[kind][0] + sum(sizes))
        assert (chunk in parsed.damage) == (max(ends) > length)


def test_keep_going_does_not_decode_what_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """The work follows the bytes that are there: a lost chunk is not run through the networks."""
    rows = []
    real = codec.context

    def counted(*arguments: object) -> np.ndarray:
        rows.append(len(arguments[-1]))
        return real(*arguments)

    monkeypatch.setattr(codec, "context", counted)
    parsed = codec.parse(DATA[: SPAN[directory.POSITIONS][0]], keep_going=True)
    assert sorted(parsed.damage) == [0, 1, 2]
    assert sum(rows) == 0
