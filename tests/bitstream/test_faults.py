"""Files with several faults (SPEC.md 10): the reported one, the chunks that keep_going saves, and the work until then.

tests/conformance/test_decoders.py compares the verdicts of all decoders.
"""

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from random_scenes import random_scene, without_chunks

from conformance.cases.checksums import repair
from conformance.cases.target import Target
from conformance.fuzz.strategies import mutations, splices
from refcodec.bitstream import codec, directory, header, reader
from refcodec.bitstream.chunks import PARTS
from refcodec.bitstream.errors import REGISTRY, BitstreamError
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.bitstream.source import pad4

SCENE = random_scene(36, 23, chunk_size=5, lanes=Lanes(1, 1, 1))
FILE = codec.emit(replace(SCENE, ancillary=(Ancillary(b"noTE", 1, b"hello", 2),)))
TARGET = Target(FILE)
CHUNKS = len(SCENE.chunks)
# What is called for each group of chunks, in the order of PARTS.
DECODERS = ("parse_positions", "code_masks", "code_attributes")


def refused(data: bytes) -> BitstreamError | None:
    """None for an accepted file, which must then be canonical; otherwise its error, which must be a registered one."""
    try:
        scene = codec.parse(data).scene
    except BitstreamError as error:
        fault = error
    else:
        assert codec.emit(scene) == data
        return None
    assert REGISTRY[fault.kind.name] is fault.kind
    assert 0 <= fault.offset <= len(data)
    return fault


def verdict(error: BitstreamError | None) -> tuple[str, int] | None:
    return error and (error.kind.name, error.offset)


def put(data: bytes, *places: tuple[int, bytes]) -> bytes:
    for at, value in places:
        data = data[:at] + value + data[at + len(value) :]
    return data


def start(kind: str, chunk: int) -> int:
    return TARGET.part(kind, chunk)[0]


# --- verdicts ---------------------------------------------------------------------------------------------------------


@given(st.binary(max_size=400), st.booleans())
@example(b"", False)
def test_random_bytes(data: bytes, prologue: bool) -> None:
    head = struct.pack("<8sHHI", header.SIGNATURE, 0, 0, max(4, len(data) // 4 * 4))
    assert refused(head + struct.pack("<I", zlib.crc32(head)) + data if prologue else data) is not None


def test_every_substream_longer_and_shorter() -> None:
    """Each substream one byte longer, one byte shorter, and empty: refused where it starts."""
    for path, s in TARGET.substreams.items():
        part = FILE[s.start : s.end]
        for content in (part + b"\0", part[:-1], b"", part[:7], part[:8]):
            error = refused(TARGET.with_substream(path, content))
            assert error.offset == s.start
            assert error.kind.name.startswith("substream.")


def second_and_third_plane() -> tuple[int, int]:
    first = TARGET.start(directory.PLANES_SECTION)
    lengths = struct.unpack_from("<2I", FILE, first)
    return first + 20 + pad4(lengths[0]), first + 20 + pad4(lengths[0]) + pad4(lengths[1])


LATE, EARLY = b"\0\0\0\0", b"\xff\xff\xff\xff"
# Of two faults the first one is reported, though the second one would be met earlier within its substream or its step:
# of chunks, of chunks whatever the steps, of steps of a chunk, of sub-planes.
PAIRS = {
    "chunks": ((start("attributes", 1), LATE), (start("attributes", 3) + 4, EARLY)),
    "chunks before steps": ((start("attributes", 0), LATE), (start("masks", 4), LATE)),
    "steps": ((start("masks", 2), LATE), (start("attributes", 2), LATE)),
    "planes": ((second_and_third_plane()[0], LATE), (second_and_third_plane()[1] + 4, EARLY)),
}


@pytest.mark.requirement("D10.2-3")
@pytest.mark.parametrize("together", [1, 2, 1000])
@pytest.mark.parametrize("pair", PAIRS)
def test_the_first_of_two_faults_is_reported(monkeypatch: pytest.MonkeyPatch, pair: str, together: int) -> None:
    """However many chunks are decoded together."""
    monkeypatch.setattr(reader, "GROUP_CHUNKS", together)
    assert verdict(refused(repair(put(FILE, *PAIRS[pair])))) == ("substream.symbol_crc", PAIRS[pair][0][0])


@pytest.mark.requirement("D13.1-1")
@pytest.mark.parametrize(("kind", "decoder"), list(zip(PARTS, DECODERS, strict=True)))
@pytest.mark.parametrize("chunk", range(CHUNKS))
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
    assert refused(repair(put(FILE, (start(kind, chunk), b"\xff\xff"))))
    step = DECODERS.index(decoder)
    assert list(calls.values()) == [chunk + 1] * (step + 1) + [chunk] * (len(DECODERS) - step - 1)


@pytest.mark.parametrize("kind", [kind for kind in directory.SECTIONS if kind != directory.DATA])
def test_a_damaged_section_is_refused_before_it_is_decoded(monkeypatch: pytest.MonkeyPatch, kind: bytes) -> None:
    section = TARGET.sections[kind]
    last = section.start + section.length - 1
    steps = dict(zip(directory.SECTIONS, ("parse_frame", "parse_weights", "parse_planes", "parse_index"), strict=False))
    monkeypatch.setattr(reader, steps[kind], None)
    assert verdict(refused(put(FILE, (last, bytes([FILE[last] ^ 1]))))) == ("section.crc", section.start)


# --- what is saved ----------------------------------------------------------------------------------------------------


def assert_same(scene: Scene, wanted: Scene) -> None:
    assert codec.emit(replace(scene, ancillary=())) == codec.emit(replace(wanted, ancillary=()))


@pytest.mark.requirement("D10.2-2")
@pytest.mark.no_cover
@settings(max_examples=100)
@given(mutations(FILE) | splices(FILE))
def test_any_damage(data: bytes) -> None:
    """What is refused as a whole is refused with keep_going too, or named as damage. What is kept can be written."""
    error, other = refused(data), None
    try:
        parsed = codec.parse(data, keep_going=True)
    except BitstreamError as refusal:
        other = refusal
    if other:
        # What comes before the chunks refuses the file as a whole.
        assert verdict(other) == verdict(error)
        return
    assert verdict(parsed.error) == verdict(error)
    assert error or not parsed.damage
    assert all(0 <= e.offset <= len(data) for e in parsed.damage.values())
    assert codec.parse(codec.emit(parsed.scene)).scene.anchor_count == parsed.scene.anchor_count


@pytest.mark.requirement("D10.2-2")
@pytest.mark.parametrize("kind", PARTS)
@pytest.mark.parametrize("chunks", [[], [0], [2], [4], [1, 3], [0, 1, 2, 3, 4]])
def test_the_other_chunks_are_kept(kind: str, chunks: list[int]) -> None:
    data = bytearray(FILE)
    for chunk in chunks:
        data[start(kind, chunk) + 4] ^= 0x55
    parsed = codec.parse(bytes(data), keep_going=True)
    assert {n: verdict(e) for n, e in parsed.damage.items()} == {n: ("chunk.crc", TARGET.chunk_at(n)) for n in chunks}
    assert_same(parsed.scene, without_chunks(SCENE, chunks))


@pytest.mark.parametrize("together", [1, 2, 1000])
@pytest.mark.parametrize("repaired", [False, True])
def test_damage_of_every_kind(monkeypatch: pytest.MonkeyPatch, together: int, repaired: bool) -> None:
    """Chunk 0 loses its attributes, chunk 1 its masks, chunk 3 its positions and masks: 2 and 4 are left.

    Each chunk has its own first error, whether a checksum finds it or the coder.
    """
    monkeypatch.setattr(reader, "GROUP_CHUNKS", together)
    faults = [("attributes", 0), ("masks", 1), ("positions", 3), ("masks", 3)]
    # A symbol_crc, or the first position, which becomes NaN.
    data = put(FILE, *((start(kind, chunk), b"\xff\xff") for kind, chunk in faults))
    parsed = codec.parse(repair(data) if repaired else data, keep_going=True)
    names = dict.fromkeys((0, 1), "substream.symbol_crc") | {3: "positions.not_finite"}
    assert {n: verdict(e) for n, e in parsed.damage.items()} == {
        chunk: (names[chunk], start(kind, chunk)) if repaired else ("chunk.crc", TARGET.chunk_at(chunk))
        for kind, chunk in faults[:3]
    }
    assert parsed.error is parsed.damage[0]
    assert_same(parsed.scene, without_chunks(SCENE, [0, 1, 3]))


@pytest.mark.parametrize("first", range(7))
def test_every_cut(first: int) -> None:
    """A chunk is damaged exactly when it is not all there, and the rest is as it was."""
    begin = TARGET.start(directory.DATA)
    ends = [TARGET.chunk_at(n) + TARGET.value(f"index.entry[{n}].length") for n in range(CHUNKS)]
    for length in range(begin + 13 * first, len(FILE), 97):
        parsed = codec.parse(FILE[:length], keep_going=True)
        lost = [n for n, end in enumerate(ends) if end > length]
        assert {n: verdict(e) for n, e in parsed.damage.items()} == dict.fromkeys(lost, ("section.truncated", length))
        assert_same(parsed.scene, without_chunks(SCENE, lost))
    with pytest.raises(BitstreamError):
        codec.parse(FILE[: begin - 1], keep_going=True)


def test_what_is_lost_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The work follows the bytes that are there: a lost chunk is not run through the networks."""
    rows = []
    real = reader.context

    def counted(*arguments: Any) -> np.ndarray:
        rows.append(len(arguments[-1]))
        return real(*arguments)

    monkeypatch.setattr(reader, "context", counted)
    parsed = codec.parse(FILE[: TARGET.start(directory.DATA)], keep_going=True)
    assert sorted(parsed.damage) == list(range(CHUNKS))
    assert sum(rows) == 0
