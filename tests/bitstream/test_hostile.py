"""Hostile files (SPEC.md 10 and 13): each is a scene or one error, in bounded memory, also with valid checksums."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from conformance.cases.checksums import repair
from conformance.cases.scenes import MAIN_DIMENSIONS, TINY_DIMENSIONS, random_scene
from conformance.cases.target import Target
from conformance.fuzz.strategies import mutations, scenes, splices
from refcodec.bitstream import codec, directory, header
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.errors import REGISTRY, BitstreamError
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.limits import MAIN, PROFILES, TINY, dimension_fault
from refcodec.bitstream.scene import Ancillary, Scene

SMALLEST = Dimensions(1, (1, 1), 1, 1, 2, (2,), (2,), (2,), 1)
SMALL_FILE = codec.emit(random_scene(31, 5, SMALLEST, chunk_size=2, lanes=Lanes(0, 0, 0)))
FILE = codec.emit(
    replace(
        random_scene(32, 11, chunk_size=4, lanes=Lanes(1, 0, 1), spread=6),
        ancillary=(Ancillary(b"noTE", 1, b"hello", 2),),
    )
)
SMALL = Target(SMALL_FILE)
EXAMPLE = Path(__file__).resolve().parents[2] / "vectors" / "tiny-example.c3gs"


def refused(data: bytes) -> BitstreamError | None:
    """None for an accepted file, which must then be canonical; otherwise its error, which must be a registered one."""
    try:
        scene = codec.parse(data).scene
    except BitstreamError as error:
        found = error
    else:
        assert codec.emit(scene) == data
        return None
    assert REGISTRY[found.kind.name] is found.kind
    assert 0 <= found.offset <= len(data)
    return found


def salvaged(data: bytes) -> None:
    """What is refused as a whole is refused with keep_going too, or named as damage. What is kept can be written."""
    error = refused(data)
    try:
        parsed = codec.parse(data, keep_going=True)
    except BitstreamError as found:
        other = found
    else:
        other = None
    if other is not None:
        # What comes before the chunks refuses the file as a whole.
        assert error is not None
        assert (other.kind.name, other.offset) == (error.kind.name, error.offset)
        return
    listed = {(e.kind.name, e.offset) for e in parsed.damage.values()}
    if error is None:
        assert not listed
        assert parsed.error is None
    else:
        assert parsed.error is not None
        assert (parsed.error.kind.name, parsed.error.offset) == (error.kind.name, error.offset)
    assert all(0 <= offset <= len(data) for _, offset in listed)
    assert codec.parse(codec.emit(parsed.scene)).scene.anchor_count == parsed.scene.anchor_count


@pytest.mark.no_cover
@pytest.mark.slow
def test_every_truncation() -> None:
    for length in range(len(SMALL_FILE)):
        assert refused(SMALL_FILE[:length]) is not None, length


def test_trailing_bytes() -> None:
    error = refused(SMALL_FILE + b"\0")
    assert error is not None
    assert (error.kind.name, error.offset) == ("file.trailing", len(SMALL_FILE))


@pytest.mark.slow
@pytest.mark.no_cover
@pytest.mark.parametrize("bit", range(8))
def test_every_single_bit_flip(bit: int) -> None:
    for at in range(len(SMALL_FILE)):
        data = bytearray(SMALL_FILE)
        data[at] ^= 1 << bit
        assert refused(bytes(data)) is not None, (at, bit)


@pytest.mark.slow
@pytest.mark.no_cover
@given(mutations(FILE))
@settings(max_examples=300)
def test_changed_with_checksums_repaired(data: bytes) -> None:
    salvaged(data)


@pytest.mark.slow
@pytest.mark.no_cover
@given(splices(FILE))
@settings(max_examples=200)
def test_bytes_of_a_substream_taken_out_or_put_in(data: bytes) -> None:
    salvaged(data)


def test_every_substream_longer_and_shorter() -> None:
    """Each substream one byte longer, one byte shorter, and empty: refused where it starts."""
    for path, s in TARGET.substreams.items():
        part = FILE[s.start : s.end]
        for content in (part + b"\0", part[:-1], b"", part[:7], part[:8]):
            error = refused(TARGET.with_substream(path, content))
            assert error is not None
            assert error.offset == s.start
            assert error.kind.name.startswith("substream.")


@pytest.mark.slow
@pytest.mark.no_cover
@given(st.data(), scenes(max_anchors=4))
@settings(max_examples=40)
def test_any_scene_changed_with_checksums_repaired(data: st.DataObject, scene: Scene) -> None:
    file = codec.emit(scene)
    salvaged(data.draw(st.one_of(mutations(file), splices(file))))


@pytest.mark.slow
@pytest.mark.no_cover
def test_keep_going_with_single_bit_flips() -> None:
    """One bit of each byte, without any checksum repaired: an error, or damage to one chunk at most."""
    first = SMALL.start(directory.DATA)
    for at in range(len(SMALL_FILE)):
        data = Target(SMALL_FILE).put(at, bytes([SMALL_FILE[at] ^ (1 << at * 5 % 8)]))
        try:
            parsed = codec.parse(data, keep_going=True)
        except BitstreamError:
            damage = None
        else:
            damage = [error.kind.name for error in parsed.damage.values()]
        assert damage == (None if at < first else ["chunk.crc"])


@given(st.binary(max_size=200))
def test_random_bytes(data: bytes) -> None:
    assert refused(data) is not None


@given(st.binary(max_size=400))
@example(b"")
def test_random_bytes_behind_a_prologue(data: bytes) -> None:
    head = struct.pack("<8sHHI", header.SIGNATURE, 0, 0, max(4, len(data) // 4 * 4))
    assert refused(head + struct.pack("<I", zlib.crc32(head)) + data) is not None


# --- one field at a time ---------------------------------------------------------------------------------------------

TARGET = Target(FILE)
ATTRIBUTES = TARGET.substreams["attributes[chunk 0]"].start


def field(path: str, value: bytes) -> bytes:
    """The file with an element of the header or the frame changed, checksums repaired."""
    return repair(TARGET.put(TARGET.at(path), value))


RENDER = [
    ("up_axis", b"\6"),
    ("near_plane", struct.pack("<f", 0.0)),
    ("near_plane", struct.pack("<f", float("inf"))),
    ("distance_unit", struct.pack("<f", 0.0)),
    ("distance_unit", struct.pack("<f", -1.0)),
    ("distance_unit", struct.pack("<f", float("nan"))),
    ("alpha_max", struct.pack("<f", 1.5)),
    ("low_pass", struct.pack("<f", -1.0)),
]


@pytest.mark.requirement("R6.5-1")
@pytest.mark.parametrize(("name", "value"), RENDER)
def test_render_information(name: str, value: bytes) -> None:
    error = refused(field(f"render_info.{name}", value))
    assert error is not None
    assert error.kind.name == "header.render_info"
    vector = name.partition("[")
    assert error.offset == TARGET.at(f"render_info.{vector[0]}" + ("[0]" if vector[1] else ""))


FRAME = [
    (0, "<i", -(1 << 20)),
    (32, "<i", 1 << 20),
    (36, "<q", 1 << 61),
    (52, "<q", -(1 << 61)),
    (62, "<B", 61),
    (64, "<i", -(1 << 18) - 1),
    (72, "<i", 1 << 18),
    (84, "<i", (1 << 18) + 1),
]


@pytest.mark.requirement("R6.7-2")
@pytest.mark.parametrize(("at", "form", "value"), FRAME)
def test_frame(at: int, form: str, value: int) -> None:
    offset = TARGET.start(directory.FRAME) + at
    error = refused(repair(TARGET.put(offset, struct.pack(form, value))))
    assert error is not None
    assert (error.kind.name, error.offset) == ("frame.range", offset)


@pytest.mark.requirement("R6.7-2")
@pytest.mark.parametrize("axis", range(3))
def test_frame_bounds_without_extent(axis: int) -> None:
    at = TARGET.start(directory.FRAME) + 64 + 4 * axis
    error = refused(repair(TARGET.put(at + 12, FILE[at : at + 4])))
    assert error is not None
    assert (error.kind.name, error.offset) == ("frame.range", at + 12)


@pytest.mark.requirement("R11.1-2")
@pytest.mark.parametrize(
    ("profile", "change", "field"),
    [
        (TINY, {"slices": (2,)}, "carm_layers"),
        (TINY, {"plane_channels": 0}, "plane_size"),
        (TINY, {"plane_channels": 0, "plane_size": 0}, "sarm_layers"),
        (TINY, {"plane_size": 0}, "plane_size"),
        (TINY, {"plane_size": 1}, "plane_size"),
        (TINY, {"sarm_width": ()}, "sarm_layers"),
        (
            TINY,
            {"plane_channels": 0, "frequency_count": 0, "plane_size": 0, "sarm_width": ()},
            "hyper_layers",
        ),
        (TINY, {"slices": (2, 17)}, "slice_width[1]"),
        (TINY, {"slices": (1,) * 5}, "slice_count"),
        (TINY, {"hyper_width": (1, 1, 1)}, "hyper_layers"),
        (TINY, {"sarm_width": (4, 17)}, "sarm_width[1]"),
        (TINY, {"plane_size": 33}, "plane_size"),
        (MAIN, {"slices": (64, 64, 1)}, "slice_width"),
        (MAIN, {"slices": (65,)}, "slice_width[0]"),
        (MAIN, {"render_width": 129}, "render_width"),
        (MAIN, {"frequency_count": 17}, "frequency_count"),
        (MAIN, {"offset_count": 17}, "offset_count"),
        (MAIN, {"plane_size": 1025}, "plane_size"),
    ],
)
def test_dimensions(profile: int, change: dict, field: str) -> None:
    base = {TINY: TINY_DIMENSIONS, MAIN: MAIN_DIMENSIONS}[profile]
    assert dimension_fault(PROFILES[profile], base, 0) is None
    fault = dimension_fault(PROFILES[profile], replace(base, **change), 0)
    assert fault is not None
    assert fault[0] == field


HUGE = struct.pack("<I", 0xFFFFFFFF)


def huge_header() -> bytes:
    data = TARGET.put(12, HUGE)
    return data[:16] + struct.pack("<I", zlib.crc32(data[:16])) + data[20:]


GREEDY = {
    "anchor_count": lambda: field("anchor_count", HUGE),
    "chunk_size": lambda: field("chunk_size", HUGE),
    "chunk_count": lambda: field("chunk_count", HUGE),
    "section length": lambda: field("directory[5].length", HUGE),
    "most of a section's length": lambda: field("directory[2].length", b"\xff" * 8),
    "plane length": lambda: repair(TARGET.put(TARGET.start(directory.PLANES_SECTION) + 8, HUGE)),
    "chunk length": lambda: repair(TARGET.put(TARGET.at("index.entry[0].length"), HUGE)),
    "chunk anchors": lambda: repair(TARGET.put(TARGET.at("index.entry[0].anchor_count"), HUGE)),
    "position length": lambda: repair(TARGET.put(TARGET.at("chunk[0].position_length"), HUGE)),
    "attribute length": lambda: repair(TARGET.put(TARGET.at("chunk[0].attribute_length"), HUGE)),
    "word count": lambda: repair(TARGET.put(ATTRIBUTES + 4, HUGE)),
    "plane_size": lambda: field("dimensions.plane_size", b"\xff\xff"),
    "slice_count": lambda: field("dimensions.slice_count", b"\xff"),
    "section_count": lambda: field("section_count", b"\xff"),
    "header_length": huge_header,
}


@pytest.mark.requirement("D13.1-1")
@pytest.mark.parametrize("keep_going", [False, True])
@pytest.mark.parametrize("name", GREEDY)
def test_asking_for_much_allocates_nothing(name: str, keep_going: bool) -> None:
    data = GREEDY[name]()
    codec.parse(FILE)  # imports and caches are not what is measured
    tracemalloc.start()
    try:
        if keep_going and name in ("word count", "position length", "attribute length"):
            assert list(codec.parse(data, keep_going=True).damage) == [0]
        else:
            with pytest.raises(BitstreamError):
                codec.parse(data, keep_going=keep_going)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2 << 20


def test_many_anchors_need_many_bytes() -> None:
    """An anchor takes a sixteenth of a byte at least."""
    chunk = struct.pack("<II", 16 + 4, 0) + struct.pack("<II", 65, 0)
    error = refused(repair(TARGET.put(TARGET.at("index.entry[0].length"), chunk)))
    assert error is not None
    assert (error.kind.name, error.offset) == ("index.chunk", TARGET.at("index.entry[0].anchor_count"))
    big = Target(codec.emit(random_scene(33, 700, chunk_size=700)))
    short = struct.pack("<I", 16 + 40)
    error = refused(repair(big.put(big.at("index.entry[0].length"), short)))
    assert error is not None
    assert (error.kind.name, error.offset) == ("index.chunk", big.at("index.entry[0].length"))
