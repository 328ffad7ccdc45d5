"""Files with several faults (SPEC.md 10.1): the reported fault, and the chunks that keep_going saves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from conformance.cases.checksums import repair
from conformance.cases.scenes import random_scene, without_chunks
from conformance.cases.target import Target
from refcodec.bitstream import codec, directory, reader
from refcodec.bitstream.chunks import PARTS, chunk_ranges
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.source import pad4


def refused(data: bytes) -> tuple[str, int]:
    """The name and the offset of the first error."""
    with pytest.raises(BitstreamError) as caught:
        codec.parse(data)
    return caught.value.kind.name, caught.value.offset


SCENE = random_scene(36, 23, chunk_size=5, lanes=Lanes(1, 1, 1))
WHOLE = codec.emit(SCENE)
CHUNKS = chunk_ranges(23, 5)


TARGET = Target(WHOLE)
SECTIONS = TARGET.sections

# What is called for each group of chunks, in the order of PARTS.
DECODERS = ("parse_positions", "code_masks", "code_attributes")


def put(data: bytes, at: int, value: bytes) -> bytes:
    return data[:at] + value + data[at + len(value) :]


def part_start(kind: str, chunk: int) -> int:
    return TARGET.part(kind, chunk)[0]


@pytest.mark.requirement("D10.2-2")
@pytest.mark.parametrize("kind", PARTS)
@pytest.mark.parametrize("chunks", [[0], [2], [4], [1, 3], [0, 1, 2, 3, 4]])
def test_keep_going_keeps_the_other_chunks(kind: str, chunks: list[int]) -> None:
    data = bytearray(WHOLE)
    for chunk in chunks:
        data[part_start(kind, chunk) + 4] ^= 0x55
    refused(bytes(data))
    parsed = codec.parse(bytes(data), keep_going=True)
    assert sorted(parsed.damage) == chunks
    assert all(error.kind.name == "chunk.crc" for error in parsed.damage.values())
    expected = without_chunks(SCENE, chunks)
    assert parsed.scene.positions.tobytes() == expected.positions.tobytes()
    assert np.array_equal(parsed.scene.masks, expected.masks)
    for name in ("features", "scalings", "offsets", "steps"):
        assert np.array_equal(getattr(parsed.scene.attributes, name), getattr(expected.attributes, name))
    # What was kept is a scene of its own.
    assert codec.emit(codec.parse(codec.emit(parsed.scene)).scene) == codec.emit(parsed.scene)


@pytest.mark.parametrize("together", [1, 2, 1000])
@pytest.mark.parametrize("repaired", [False, True])
def test_keep_going_with_damage_of_every_kind(monkeypatch: pytest.MonkeyPatch, together: int, repaired: bool) -> None:
    """Chunk 0 loses its attributes, chunk 1 its masks, chunk 3 its positions and masks: 2 and 4 are left.

    Each chunk has its own first error, whether a checksum finds it or the coder.
    """
    monkeypatch.setattr(reader, "GROUP_CHUNKS", together)
    faults = [("attributes", 0), ("masks", 1), ("positions", 3), ("masks", 3)]
    data = WHOLE
    for kind, chunk in faults:
        # A symbol_crc, or the first position, which becomes NaN.
        data = put(data, part_start(kind, chunk), b"\xff\xff")
    parsed = codec.parse(repair(data) if repaired else data, keep_going=True)
    names = dict.fromkeys((0, 1), "substream.symbol_crc" if repaired else "chunk.crc")
    names[3] = "positions.not_finite" if repaired else "chunk.crc"
    assert {n: (e.kind.name, e.offset) for n, e in parsed.damage.items()} == {
        chunk: (names[chunk], part_start(kind, chunk) if repaired else TARGET.chunk_at(chunk))
        for kind, chunk in faults[:3]
    }
    assert parsed.error is parsed.damage[0]
    assert codec.emit(parsed.scene) == codec.emit(without_chunks(SCENE, [0, 1, 3]))


def test_keep_going_with_a_cut_file() -> None:
    cut = part_start("attributes", 3) + 7
    parsed = codec.parse(WHOLE[:cut], keep_going=True)
    assert sorted(parsed.damage) == [3, 4]
    assert np.array_equal(parsed.scene.attributes.features, SCENE.attributes.features[:15])
    with pytest.raises(BitstreamError):
        codec.parse(WHOLE[: SECTIONS[directory.INDEX].start], keep_going=True)


def test_keep_going_with_a_whole_file() -> None:
    parsed = codec.parse(WHOLE, keep_going=True)
    assert parsed.damage == {}
    assert codec.emit(parsed.scene) == WHOLE


@pytest.mark.requirement("D10.2-3")
@pytest.mark.parametrize("together", [1, 2, 1000])
def test_the_lowest_chunk_is_reported(monkeypatch: pytest.MonkeyPatch, together: int) -> None:
    """A late fault of chunk 1 and an early one of chunk 3: chunk 1 wins, however chunks are grouped."""
    monkeypatch.setattr(reader, "GROUP_CHUNKS", together)
    data = put(WHOLE, part_start("attributes", 1), b"\0\0\0\0")
    data = repair(put(data, part_start("attributes", 3) + 4, b"\xff\xff\xff\xff"))
    refused(data)
    with pytest.raises(BitstreamError) as caught:
        codec.parse(data)
    assert (caught.value.kind.name, caught.value.offset) == (
        "substream.symbol_crc",
        part_start("attributes", 1),
    )


@pytest.mark.requirement("D10.2-3")
def test_a_fault_of_a_chunk_comes_before_those_of_later_chunks() -> None:
    data = put(WHOLE, part_start("attributes", 0), b"\0\0\0\0")
    data = repair(put(data, part_start("masks", 4), b"\0\0\0\0"))
    assert refused(data) == ("substream.symbol_crc", part_start("attributes", 0))


@pytest.mark.requirement("D10.2-3")
def test_a_fault_in_masks_comes_before_one_in_attributes() -> None:
    data = put(WHOLE, part_start("attributes", 2), b"\0\0\0\0")
    data = repair(put(data, part_start("masks", 2), b"\0\0\0\0"))
    assert refused(data) == ("substream.symbol_crc", part_start("masks", 2))


@pytest.mark.requirement("D10.2-3")
def test_the_lowest_plane_is_reported() -> None:
    at = SECTIONS[directory.PLANES_SECTION].start
    second = at + 20 + pad4(int.from_bytes(WHOLE[at : at + 4], "little"))
    third = second + pad4(int.from_bytes(WHOLE[at + 4 : at + 8], "little"))
    assert refused(repair(put(put(WHOLE, second, b"\0\0\0\0"), third + 4, b"\xff\xff\xff\xff"))) == (
        "substream.symbol_crc",
        second,
    )


@pytest.mark.requirement("D13.1-1")
@pytest.mark.parametrize(("kind", "decoder"), list(zip(PARTS, DECODERS, strict=True)))
@pytest.mark.parametrize("chunk", range(len(CHUNKS)))
def test_nothing_is_decoded_after_the_group_of_an_error(
    monkeypatch: pytest.MonkeyPatch, kind: str, decoder: str, chunk: int
) -> None:
    """A file of many chunks is refused for its first one as soon as that is decoded, and no later step begins."""
    # The steps of the native kernel cannot be counted.
    monkeypatch.setenv("REFCODEC_PATH", "numpy")
    monkeypatch.setattr(reader, "GROUP_CHUNKS", 1)
    calls = dict.fromkeys(DECODERS, 0)

    def counted(name: str) -> Callable[..., Any]:
        original = getattr(reader, name)

        def decode(*arguments: Any) -> Any:
            calls[name] += 1
            return original(*arguments)

        return decode

    for name in DECODERS:
        monkeypatch.setattr(reader, name, counted(name))
    with pytest.raises(BitstreamError):
        codec.parse(repair(put(WHOLE, part_start(kind, chunk), b"\xff\xff")))
    step = DECODERS.index(decoder)
    assert list(calls.values()) == [chunk + 1] * (step + 1) + [chunk] * (len(DECODERS) - step - 1)


@pytest.mark.parametrize("kind", [kind for kind in directory.SECTIONS if kind != directory.DATA])
def test_a_damaged_section_is_refused_before_it_is_decoded(monkeypatch: pytest.MonkeyPatch, kind: bytes) -> None:
    section = SECTIONS[kind]
    last = section.start + section.length - 1
    steps = dict(zip(directory.SECTIONS, ("parse_frame", "parse_weights", "parse_planes", "parse_index"), strict=False))
    monkeypatch.setattr(reader, steps[kind], None)
    with pytest.raises(BitstreamError) as caught:
        codec.parse(put(WHOLE, last, bytes([WHOLE[last] ^ 1])))
    assert (caught.value.kind.name, caught.value.offset) == ("section.crc", section.start)
