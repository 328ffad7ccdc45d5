"""Files read by arriving bytes or by ranges (SPEC.md 10.1, 10.2): the results equal those of a whole file."""

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace

import pytest
from hypothesis import given, settings
from random_scenes import random_scene

from conformance.cases.scenes import CONSTANT, TINY_DIMENSIONS
from conformance.fuzz.strategies import mutations
from refcodec.bitstream import codec
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.reader import Chunk, Reader, decode_chunk
from refcodec.bitstream.reconstruction import StreamDigest, chunk_digest, digest
from refcodec.bitstream.scene import Ancillary, Scene, take_anchors
from refcodec.bitstream.source import Arriving, Ranges, Source, WholeFile
from refcodec.encoder.quantise import packed

SCENE = replace(
    random_scene(71, 120, chunk_size=7, lanes=Lanes(0, 0, 0)),
    ancillary=(Ancillary(b"noTE", 2, b"before", 1), Ancillary(b"noTE", 0, b"behind", 5)),
)
FILE = codec.emit(packed(SCENE, "packed", "packed"))


def blocks(data: bytes, size: int) -> Iterator[bytes]:
    """A file as it arrives."""
    return (data[at : at + size] for at in range(0, len(data), size))


def streamed(source: Source) -> tuple[Scene | None, tuple[str, int] | None]:
    """What a reader of one chunk after the other gives: the scene, or the name and the offset of its first error."""
    chunks: list[Chunk] = []
    try:
        opened = Reader(source).open()
        for outcome in opened.chunks():
            if isinstance(outcome, BitstreamError):
                raise outcome
            chunks.append(outcome)
        opened.close()
    except BitstreamError as error:
        return None, (error.kind.name, error.offset)
    return opened.scene(chunks), None


@pytest.mark.requirement("D10.2-3")
@pytest.mark.parametrize("size", [1, 1000, 1 << 20])
def test_bytes_that_arrive_give_the_same_scene(size: int) -> None:
    scene, error = streamed(Arriving(blocks(FILE, size)))
    assert error is None
    assert scene is not None
    assert codec.emit(scene) == FILE


@pytest.mark.requirement("D10.2-3")
@pytest.mark.no_cover
@given(mutations(FILE))
@settings(max_examples=150)
def test_bytes_that_arrive_have_the_same_first_error(data: bytes) -> None:
    try:
        codec.parse(data)
        wanted = None
    except BitstreamError as error:
        wanted = error.kind.name, error.offset
    assert streamed(Arriving(blocks(data, 100)))[1] == wanted


@pytest.mark.requirement("D10.2-3")
@pytest.mark.no_cover
def test_every_cut_has_the_same_first_error() -> None:
    for length in range(0, len(FILE), 13):
        with pytest.raises(BitstreamError) as caught:
            codec.parse(FILE[:length])
        wanted = caught.value.kind.name, caught.value.offset
        assert wanted[1] <= length
        assert streamed(Arriving(blocks(FILE[:length], 64)))[1] == wanted


def test_a_chunk_is_delivered_before_the_next_one_arrives() -> None:
    arrived = 0

    def counted() -> Iterator[bytes]:
        nonlocal arrived
        for block in blocks(FILE, 16):
            arrived += len(block)
            yield block

    opened = Reader(Arriving(counted())).open()
    index = opened.index
    assert arrived <= index[0].start + 16
    for number, _ in enumerate(opened.chunks()):
        assert arrived <= index[number].start + index[number].length + 16


@pytest.mark.requirement("D9.3-1")
@pytest.mark.parametrize("dimensions", [TINY_DIMENSIONS, CONSTANT])
def test_one_range_gives_a_chunk(dimensions: object) -> None:
    data = FILE
    if dimensions is CONSTANT:
        data = codec.emit(packed(random_scene(72, 40, CONSTANT, chunk_size=7), "raw", "packed"))
    scene = codec.parse(data).scene
    fetched: list[tuple[int, int]] = []

    def fetch(start: int, size: int) -> bytes:
        fetched.append((start, size))
        return data[start : start + size]

    section = codec.parse_container(data).section(DATA)
    for number, rows in enumerate(scene.chunks):
        fetched.clear()
        chunk = decode_chunk(Ranges(fetch, len(data)), number)
        assert chunk_digest(chunk) == chunk_digest(take_anchors(scene, list(rows)))
        assert len([start for start, _ in fetched if start >= section.start]) == 1
    with pytest.raises(IndexError):
        decode_chunk(WholeFile(data), len(scene.chunks))


@pytest.mark.requirement("D9.3-1")
def test_the_digest_in_one_pass() -> None:
    opened = Reader(Arriving(blocks(FILE, 500)), keep_ancillary=False).open()
    summed = StreamDigest()
    for chunk in opened.chunks():
        assert isinstance(chunk, Chunk)
        summed.add(opened.scene([chunk]))
    opened.close()
    assert summed.finish(opened.scene([])) == digest(codec.parse(FILE).scene)[0]


def test_the_digest_does_not_depend_on_chunks() -> None:
    wanted = digest(SCENE)
    for counts in [(120,), (1,) * 120, (100, 20)]:
        scene = replace(SCENE, chunk_size=128, chunk_anchors=counts)
        assert digest(codec.parse(codec.emit(scene)).scene) == wanted


@pytest.mark.requirement("D13.1-1")
def test_a_long_ancillary_section_is_passed_in_bounded_memory() -> None:
    """16 MiB that nobody keeps: they are checked in blocks."""
    data = codec.emit(replace(SCENE, ancillary=(Ancillary(b"noTE", 0, bytes(1 << 24), 0),)))
    tracemalloc.start()
    try:
        reader = Reader(Arriving(blocks(data, 1 << 12)), keep_ancillary=False)
        reader.open()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert reader.ancillary == []
    assert peak < 6 << 20


def test_bytes_that_were_passed_cannot_be_read() -> None:
    source = Arriving(blocks(FILE, 10))
    assert source.read(5, 10) == FILE[5:15]
    with pytest.raises(ValueError, match="passed"):
        source.read(4, 1)
    assert source.read(len(FILE) - 2, 10) == FILE[-2:]
    assert source.length() == len(FILE)
