"""Hostile values by field (SPEC.md 10 and 13): each element of a file is set, and the checksums are corrected."""

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
from conformance.cases.target import Target
from refcodec.bitstream import codec, directory, reader
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Ancillary

SCENE = random_scene(
    41, 9, Dimensions(2, (1, 2), 1, 1, 3, (2,), (2,), (2,), 1), chunk_size=4, lanes=Lanes(0, 1, 0), spread=20
)
DATA = codec.emit(replace(SCENE, ancillary=(Ancillary(b"noTE", 7, b"abc", 3),)))
TARGET = Target(DATA)
SIZES = {"f32": 4, "f16": 2}


def elements() -> list[tuple[int, int]]:
    """(offset, bytes) of each element: fields, padding, and the first items of what is long."""
    found = []
    for row in TARGET.elements.values():
        item = row.kind.partition("[")
        size = SIZES.get(item[0], int(item[0][1:]) // 8 if item[0][1:].isdigit() else 1) if item[1] else 0
        if size:
            found += [(at, size) for at in range(row.start, min(row.end, row.start + 12 * size) - size + 1, size)]
        elif row.end - row.start <= 8:
            found.append((row.start, row.end - row.start))
    return found


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
    for at, size in ELEMENTS:
        for change in (0, (1 << 8 * size) - 1, int.from_bytes(DATA[at : at + size], "little") ^ 1 << (8 * size - 1)):
            data = DATA[:at] + change.to_bytes(size, "little") + DATA[at + size :]
            error = refused(repair(data))
            names.add(error.kind.name if error else "accepted")
    assert len(names) > 40, sorted(names)


@pytest.mark.requirement("D13.1-1")
@pytest.mark.parametrize("keep_going", [False, True])
def test_a_header_of_many_chunks_allocates_little(keep_going: bool) -> None:
    """Profile Main, 2^24 anchors in chunks of 256, and no byte behind the header."""
    data = codec.emit(random_scene(42, 0, replace(MAIN_DIMENSIONS, plane_size=2), chunk_size=256))
    _, end = layout(data)
    asked = bytearray(data)
    asked[24:28] = (1 << 24).to_bytes(4, "little")
    asked[28:32] = (1 << 16).to_bytes(4, "little")
    asked[21] = 4
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
    start = TARGET.start(directory.DATA)
    length = min(start + cut, len(DATA))
    parsed = codec.parse(DATA[:length], keep_going=True)
    for error in parsed.damage.values():
        assert (error.kind.name, error.offset) == ("section.truncated", length)
    wanted = without_chunks(SCENE, sorted(parsed.damage))
    assert parsed.scene.positions.tobytes() == wanted.positions.tobytes()
    assert np.array_equal(parsed.scene.attributes.features, wanted.attributes.features)
    # A chunk is damaged exactly when it is not all there.
    for chunk in range(3):
        end = TARGET.chunk_at(chunk) + TARGET.value(f"index.entry[{chunk}].length")
        assert (chunk in parsed.damage) == (end > length)


def test_keep_going_does_not_decode_what_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """The work follows the bytes that are there: a lost chunk is not run through the networks."""
    rows = []
    real = reader.context

    def counted(*arguments: object) -> np.ndarray:
        rows.append(len(arguments[-1]))
        return real(*arguments)

    monkeypatch.setattr(reader, "context", counted)
    parsed = codec.parse(DATA[: TARGET.start(directory.DATA)], keep_going=True)
    assert sorted(parsed.damage) == [0, 1, 2]
    assert sum(rows) == 0
