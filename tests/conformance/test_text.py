"""SPEC.md's blocks as a decoder of whole files (Annex H): the text and both decoders agree on each file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conformance import spec_decoder
from conformance.cases.checksums import repair
from conformance.cases.scenes import CONSTANT, TINY_DIMENSIONS, random_scene
from conformance.cases.target import Target
from conformance.fuzz.compare import first_verdict, second_verdict
from conformance.fuzz.strategies import draw_mutation, draw_splice, scenes
from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.reconstruction import chunk_digest, digest
from refcodec.bitstream.scene import Ancillary, Scene, take_anchors
from refcodec.encoder.quantise import packed

Spec = dict[str, Any]

SMALLEST = Dimensions(1, (1, 1), 1, 1, 2, (2,), (2,), (2,), 1)
NOTES = (Ancillary(b"noTE", 1, b"hello", 2), Ancillary(b"cAMs", 9, b"x", 5))
SCENES = {
    "raw": random_scene(31, 5, SMALLEST, chunk_size=2, lanes=Lanes(0, 0, 0)),
    "packed": packed(
        replace(random_scene(32, 11, SMALLEST, chunk_size=4, lanes=Lanes(1, 0, 1), spread=6), ancillary=NOTES),
        "packed",
        "packed",
    ),
    "later": packed(replace(random_scene(33, 5, CONSTANT, chunk_size=3), minor=1, later=b"abcd"), "raw", "packed"),
    "tiny": random_scene(34, 9, TINY_DIMENSIONS, chunk_size=4, lanes=Lanes(0, 1, 2), gain=3, spread=40),
    "empty": random_scene(35, 0),
}
FILES = {name: codec.emit(scene) for name, scene in SCENES.items()}
# A field of a header, a table or a head of a substream, and not one of its words.
FIELD_BYTES = 8


def agreed(spec: Spec, data: bytes) -> tuple[str, int]:
    """The verdict of all three."""
    first = first_verdict(data)
    assert second_verdict(data) == first
    found, error = spec_decoder.verdict(spec, data)
    assert (error or (bytes(found["scene"]).hex(), -1)) == first
    return first


@pytest.mark.requirement("DH-1")
@pytest.mark.parametrize("name", SCENES)
def test_digests(spec: Spec, name: str) -> None:
    """Of the scene, of each part and of each chunk."""
    scene = codec.parse(FILES[name]).scene
    whole, parts = digest(scene)
    chunks = [chunk_digest(take_anchors(scene, list(rows))) for rows in scene.chunks]
    found, error = spec_decoder.verdict(spec, FILES[name])
    assert error is None
    assert found is not None
    assert bytes(found["scene"]).hex() == whole
    assert [bytes(own).hex() for own in found["parts"]] == list(parts.values())
    assert [bytes(own).hex() for own in found["chunks"]] == chunks


@pytest.mark.requirement("DH-1")
@pytest.mark.no_cover
@settings(max_examples=25)
@given(scenes(max_anchors=5))
def test_any_scene(spec: Spec, scene: Scene) -> None:
    assert agreed(spec, codec.emit(scene)) == (digest(scene)[0], -1)


@pytest.mark.requirement("D10.2-3", "DH-1")
@pytest.mark.no_cover
@pytest.mark.parametrize("name", ["raw", "packed", "later"])
def test_truncations(spec: Spec, name: str) -> None:
    data = FILES[name]
    for length in range(0, len(data), 31):
        assert agreed(spec, data[:length])[1] == length
    assert agreed(spec, data + b"\0") == ("file.trailing", len(data))


@st.composite
def changed_fields(draw: st.DrawFn) -> bytes:
    """A file with other values in a few fields, its checksums repaired if they can still be found."""
    target = Target(FILES[draw(st.sampled_from(list(FILES)))])
    rows = [row for row in target.elements.values() if 0 < row.end - row.start <= FIELD_BYTES]
    out = bytearray(target.data)
    for row in draw(st.lists(st.sampled_from(rows), min_size=1, max_size=4)):
        size = row.end - row.start
        old = int.from_bytes(out[row.start : row.end], "little")
        near = st.integers(-2, 2).map(lambda by, old=old, size=size: (old + by) % (1 << 8 * size))
        bit = st.integers(0, 8 * size - 1).map(lambda n, old=old: old ^ 1 << n)
        new = draw(st.one_of(near, bit, st.integers(0, (1 << 8 * size) - 1)))
        out[row.start : row.end] = new.to_bytes(size, "little")
    return repair(bytes(out))


@pytest.mark.requirement("D15.4-1", "D10.2-1", "D10.2-3", "DH-1")
@pytest.mark.no_cover
@settings(max_examples=150)
@given(changed_fields())
def test_changed_fields(spec: Spec, data: bytes) -> None:
    """The first error of several in the order of 10.1."""
    agreed(spec, data)


@pytest.mark.requirement("D10.2-3", "DH-1")
@pytest.mark.no_cover
@settings(max_examples=100)
@given(st.data())
def test_changed_bytes(spec: Spec, data: st.DataObject) -> None:
    file = FILES[data.draw(st.sampled_from(list(FILES)))]
    change = data.draw(st.sampled_from([draw_mutation, draw_splice]))
    agreed(spec, change(data.draw, file))


@pytest.mark.requirement("DH-1")
@pytest.mark.no_cover
@pytest.mark.slow
@pytest.mark.parametrize(("name", "first"), [("raw", 0), ("packed", 1), ("later", 2)])
def test_every_third_byte(spec: Spec, name: str, first: int) -> None:
    """Each third byte changed, with checksums repaired. What the files have alike is changed at each of its bytes."""
    data = FILES[name]
    for at in range(first, len(data), 3):
        agreed(spec, repair(data[:at] + bytes([data[at] ^ (1 << at * 5 % 8)]) + data[at + 1 :]))
