"""Hostile files (SPEC.md 10 and 13): every one is a scene or one registered error, in bounded memory, whatever its checksums say."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scenes import MAIN_DIMENSIONS, TINY_DIMENSIONS, random_scene, without_chunks
from strategies import layout, mutations, repair, resized, scenes, splices, substreams

from refcodec import codec, container, syntax
from refcodec.container import PROLOGUE_BYTES
from refcodec.errors import REGISTRY, BitstreamError
from refcodec.limits import MAIN, PROFILES, TINY, dimension_fault
from refcodec.scene import Dimensions, Lanes, Scene

SMALLEST = Dimensions(1, (1, 1), 1, 1, 2, (2,), (2,), (2,), 1)
SMALL_FILE = codec.emit(random_scene(31, 5, SMALLEST, chunk_size=2, lanes=Lanes(0, 0, 0)))
FILE = codec.emit(replace(random_scene(32, 11, chunk_size=4, lanes=Lanes(1, 0, 1), spread=6), extensions=((5, 1, b"hello"),)))
EXAMPLE = Path(__file__).resolve().parent.parent / "vectors" / "tiny-example.c3gs"


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
    """What is refused as a whole is refused with keep_going too, or named as damage; what is kept is a scene that can be written."""
    error = refused(data)
    try:
        parsed = codec.parse(data, keep_going=True)
    except BitstreamError as found:
        other = found
    else:
        other = None
    if other is not None:
        # The chunks' own checks refuse no file as a whole, and the first fault before them stays the first.
        assert error is not None
        assert (other.kind.name, other.offset) == (error.kind.name, error.offset)
        return
    listed = {(e.kind.name, e.offset) for e in parsed.damage.values()}
    if error is None:
        assert not listed
    elif error.kind.name != "directory.file_length":
        # A file cut within an extension loses that, and no chunk.
        assert (error.kind.name, error.offset) in listed
    assert all(0 <= offset <= len(data) for _, offset in listed)
    assert codec.parse(codec.emit(parsed.scene)).scene.anchor_count == parsed.scene.anchor_count


def test_every_truncation() -> None:
    for length in range(len(SMALL_FILE)):
        assert refused(SMALL_FILE[:length]) is not None, length


def test_trailing_bytes() -> None:
    error = refused(SMALL_FILE + b"\0")
    assert error is not None
    assert (error.kind.name, error.offset) == ("directory.file_length", len(SMALL_FILE))


@pytest.mark.parametrize("bit", range(8))
def test_every_single_bit_flip(bit: int) -> None:
    for at in range(len(SMALL_FILE)):
        data = bytearray(SMALL_FILE)
        data[at] ^= 1 << bit
        assert refused(bytes(data)) is not None, (at, bit)


@given(mutations(FILE))
@settings(max_examples=300)
def test_changed_with_checksums_repaired(data: bytes) -> None:
    salvaged(data)


@given(splices(FILE))
@settings(max_examples=200)
def test_bytes_of_a_substream_taken_out_or_put_in(data: bytes) -> None:
    salvaged(data)


def test_every_substream_longer_and_shorter() -> None:
    """Each substream one byte longer, one byte shorter, and empty: refused where it starts."""
    sections = container.parse_container(FILE).sections
    for kind, at, length, length_at in substreams(FILE):
        head, tail = FILE[sections[kind].start : at], FILE[at + length : sections[kind].end]
        part = FILE[at : at + length]
        for content in (part + b"\0", part[:-1], b"", part[:7], part[:8]):
            error = refused(resized(FILE, kind, head + content + tail, length_at))
            assert error is not None
            assert error.offset == at
            assert error.kind.name.startswith("substream.")


@given(st.data(), scenes(max_anchors=4))
@settings(max_examples=40)
def test_any_scene_changed_with_checksums_repaired(data: st.DataObject, scene: Scene) -> None:
    file = codec.emit(scene)
    salvaged(data.draw(st.one_of(mutations(file), splices(file))))


def test_keep_going_with_single_bit_flips() -> None:
    """One bit of each byte, without any checksum repaired: an error, or damage to one chunk at most."""
    first = start(container.POSITIONS, SMALL_FILE)
    for at in range(len(SMALL_FILE)):
        data = put(at, bytes([SMALL_FILE[at] ^ (1 << at * 5 % 8)]), SMALL_FILE)
        try:
            parsed = codec.parse(data, keep_going=True)
        except BitstreamError:
            damage = None
        else:
            damage = [error.kind.name for error in parsed.damage.values()]
        assert damage == (None if at < first else ["chunks.crc"])


@given(st.binary(max_size=200))
def test_random_bytes(data: bytes) -> None:
    assert refused(data) is not None


@given(st.binary(max_size=400))
@example(b"")
def test_random_bytes_behind_a_prologue(data: bytes) -> None:
    head = struct.pack("<8sII", container.SIGNATURE, 0, max(4, len(data)))
    assert refused(head + struct.pack("<I", zlib.crc32(head)) + data) is not None


# --- one fault for each code -----------------------------------------------------------------------------------------


def where(path: str, data: bytes = FILE) -> int:
    """The offset of a header element."""
    return next(e.start for e in syntax.parse_elements("Header", data, PROLOGUE_BYTES, "header") if e.path == f"header.{path}")


def start(kind: int, data: bytes = FILE) -> int:
    return container.parse_container(data).sections[kind].start


def put(at: int, value: bytes, data: bytes = FILE) -> bytes:
    return data[:at] + value + data[at + len(value) :]


def fixed(at: int, value: bytes, data: bytes = FILE) -> tuple[bytes, int]:
    """The file with some bytes changed and the checksums repaired; the error is expected where they stand."""
    return repair(put(at, value, data)), at


def field(path: str, value: bytes) -> tuple[bytes, int]:
    return fixed(where(path), value)


def section_bytes(kind: int) -> bytes:
    s = container.parse_container(FILE).sections[kind]
    return FILE[s.start : s.end]


TABLE = start(container.CHUNK_TABLE) + 6  # K = 2: three contexts
ATTRIBUTES = start(container.ATTRIBUTES)
FIRST_LENGTH = int.from_bytes(FILE[TABLE + 16 : TABLE + 20], "little")
WORDS = struct.unpack_from("<I", FILE, ATTRIBUTES + 4)[0]
RAW_AT = ATTRIBUTES + 8 + 4 * 2 + 2 * WORDS


def prologue(**changes: object) -> bytes:
    values = {"signature": container.SIGNATURE, "version": 0, "header_length": 0, "prologue_crc": 0, **changes}
    head = syntax.build("Prologue", values)[:16]
    return head + zlib.crc32(head).to_bytes(4, "little")


def truncated_header() -> tuple[bytes, int]:
    return FILE[:100], 100


def header_syntax() -> tuple[bytes, int]:
    """Four bytes more than the fields take."""
    _, end = layout(FILE)
    head = FILE[PROLOGUE_BYTES : end - 4] + bytes(4)
    length = len(head) + 4
    return prologue(header_length=length) + head + zlib.crc32(head).to_bytes(4, "little") + FILE[end:], end


def level_not_minimal() -> tuple[bytes, int]:
    data = codec.emit(random_scene(33, 1, MAIN_DIMENSIONS))
    at = where("level", data)
    return repair(put(at, b"\2", data)), at


def low_chunk(at: int, value: bytes) -> tuple[bytes, int]:
    """A fault in the first attribute substream."""
    return repair(put(at, value)), ATTRIBUTES


def final_state() -> tuple[bytes, int]:
    """Changed bits of a state or word whose words are still consumed exactly."""
    for bit in range(8 * 8, 8 * (16 + 2 * WORDS)):
        at = ATTRIBUTES + bit // 8
        data = repair(put(at, bytes([FILE[at] ^ (1 << bit % 8)])))
        error = refused(data)
        if error is not None and error.kind.name == "substream.final_state":
            return data, ATTRIBUTES
    raise AssertionError("no such change was found")


def long_escape() -> tuple[bytes, int]:
    """All values are escapes; the raw bits are set to zero, so that the first prefix never ends."""
    scene = random_scene(34, 2, gain=0.0)
    scene.networks["hyper"][-1][1][:] = -320.0
    scene.attributes.features[:] = 1 << 22
    scene = replace(scene, attributes=replace(scene.attributes, steps=codec.derive_steps(scene)))
    data = codec.emit(scene)
    at = start(container.ATTRIBUTES, data)
    words = struct.unpack_from("<I", data, at + 4)[0]
    raw = at + 8 + 4 * len(range(1 << scene.lanes.attribute)) + 2 * words
    return repair(data[:raw] + bytes(len(data) - raw)), at


def past_the_range() -> tuple[bytes, int]:
    """The largest symbol, one further from its mean."""
    scene = random_scene(35, 1, SMALLEST, gain=0.0, lanes=Lanes(0, 0, 0), keep=0.0)
    scene.networks["hyper"][-1][1][:] = -320.0
    scene.attributes.features[0, 0] = (1 << 23) - 1
    scene = replace(scene, attributes=replace(scene.attributes, steps=codec.derive_steps(scene)))
    data = codec.emit(scene)
    at = start(container.ATTRIBUTES, data)
    raw = at + 12 + 2 * struct.unpack_from("<I", data, at + 4)[0]
    # The first escape: a sign, its prefix, then the low bits of its size, which become all ones.
    bits = int.from_bytes(data[raw:], "little")
    prefix = (bits >> 1 & -(bits >> 1)).bit_length() - 1
    bits |= ((1 << prefix) - 1) << (prefix + 2)
    return repair(data[:raw] + bits.to_bytes(len(data) - raw, "little")), at


def raw_length() -> tuple[bytes, int]:
    content = section_bytes(container.ATTRIBUTES)
    return resized(FILE, container.ATTRIBUTES, content[:FIRST_LENGTH] + b"\0" + content[FIRST_LENGTH:], TABLE + 16), ATTRIBUTES


def raw_padding() -> tuple[bytes, int]:
    """The first plane or attribute substream with an unused bit in its last raw byte."""
    at = ATTRIBUTES
    for chunk in range(3):
        length = int.from_bytes(FILE[TABLE + 24 * chunk + 16 : TABLE + 24 * chunk + 20], "little")
        last = at + length - 1
        words = struct.unpack_from("<I", FILE, at + 4)[0]
        if last >= at + 16 + 2 * words and FILE[last] < 128:
            data = repair(put(last, bytes([FILE[last] | 128])))
            error = refused(data)
            if error is not None and error.kind.name == "substream.raw_padding":
                return data, at
        at += length
    raise AssertionError("no substream has a padding bit")


def word_count() -> tuple[bytes, int]:
    content = section_bytes(container.ATTRIBUTES)
    more = content[:4] + (WORDS + 1).to_bytes(4, "little") + content[8 : 16 + 2 * WORDS] + b"\0\0" + content[16 + 2 * WORDS :]
    return resized(FILE, container.ATTRIBUTES, more, TABLE + 16), ATTRIBUTES


NAN = struct.pack("<f", float("nan"))
FAULTS: dict[str, Callable[[], tuple[bytes, int]]] = {
    "prologue.truncated": lambda: (FILE[:19], 19),
    "prologue.signature": lambda: (FILE.replace(b"\r\n", b"\n", 1), 0),
    "prologue.crc": lambda: (put(12, b"\1"), 16),
    "prologue.version": lambda: (prologue(version=1, header_length=243) + FILE[20:], 8),
    "prologue.header_length": lambda: (prologue(header_length=65536) + FILE[20:], 12),
    "header.truncated": truncated_header,
    "header.crc": lambda: (put(where("level"), b"\1"), where("header_crc")),
    "header.syntax": header_syntax,
    "header.reserved": lambda: field("reserved_1", b"\1"),
    "header.profile": lambda: field("profile", b"\2"),
    "header.level": lambda: field("level", b"\1"),
    "header.dimension": lambda: field("dimensions.offset_count", b"\0"),
    "header.anchor_count": lambda: field("anchor_count", struct.pack("<I", 4097)),
    "header.level_not_minimal": level_not_minimal,
    "header.chunk_size": lambda: field("chunk_size", struct.pack("<I", 65537)),
    "header.lanes": lambda: field("mask_lanes_log2", b"\x09"),
    "header.base_step": lambda: field("base_step[1]", NAN),
    "header.position_grid": lambda: field("position_grid.scale_mantissa", b"\0\0"),
    "header.render_info": lambda: field("render_info.alpha_max", NAN),
    "directory.unknown_critical": lambda: field("directory[7].type", b"\x88"),
    "directory.order": lambda: field("directory[7].type", b"\0"),
    "directory.mode": lambda: field("directory[2].mode", b"\1"),
    "directory.offset": lambda: field("directory[0].offset", struct.pack("<I", start(container.FRAME) + 1)),
    "directory.length": lambda: (resized(FILE, container.FRAME, section_bytes(container.FRAME) + b"\0"), where("directory[0].length")),
    "directory.file_length": lambda: (FILE[:-1], len(FILE) - 1),
    "section.crc": lambda: (put(ATTRIBUTES + 20, b"\xff\xff\xff"), ATTRIBUTES),
    "frame.range": lambda: fixed(start(container.FRAME) + 4, struct.pack("<i", 1 << 20)),
    "weights.scale": lambda: fixed(start(container.WEIGHTS) + 1, b"\xff"),
    "weights.not_finite": lambda: fixed(start(container.WEIGHTS) + 4 + 8, NAN),
    "weights.bound": lambda: (repair(put(start(container.WEIGHTS) + 4 + 8, struct.pack("<f", 1024.0))), start(container.WEIGHTS) + 4),
    "planes.length": lambda: fixed(start(container.PLANES_SECTION), b"\xff\xff\xff\xff"),
    "chunks.mask_model": lambda: fixed(start(container.CHUNK_TABLE) + 2, struct.pack("<H", 1 << 14)),
    "chunks.length": lambda: fixed(TABLE + 24, b"\xff"),
    "chunks.crc": lambda: (repair(put(TABLE + 20, b"\0\0\0\0"), chunks=False), ATTRIBUTES),
    "positions.not_finite": lambda: fixed(start(container.POSITIONS) + 10, b"\x00\x7c"),
    "positions.negative_zero": lambda: fixed(start(container.POSITIONS) + 10, b"\x00\x80"),
    "substream.length": lambda: low_chunk(ATTRIBUTES + 4, b"\xff\xff\xff\xff"),
    "substream.state": lambda: low_chunk(ATTRIBUTES + 8, struct.pack("<I", 0xFFFF)),
    "substream.words": word_count,
    "substream.final_state": final_state,
    "substream.escape": long_escape,
    "substream.symbol_range": past_the_range,
    "substream.raw_length": raw_length,
    "substream.raw_padding": raw_padding,
    "substream.symbol_crc": lambda: low_chunk(ATTRIBUTES, b"\0\0\0\0"),
}


def test_every_code_has_a_fault() -> None:
    assert list(FAULTS) == list(REGISTRY)


@pytest.mark.parametrize("name", FAULTS)
def test_fault(name: str) -> None:
    data, offset = FAULTS[name]()
    error = refused(data)
    assert error is not None
    assert (error.kind.name, error.offset) == (name, offset), error
    assert error.exit_status == (2 if error.kind.klass == "unsupported" else 1)
    assert str(error.kind.code) in error.to_json()


RENDER = [
    ("up_axis", b"\6"),
    ("near_plane", struct.pack("<f", 0.0)),
    ("near_plane", struct.pack("<f", float("inf"))),
    ("alpha_max", struct.pack("<f", 1.5)),
    ("low_pass", struct.pack("<f", -1.0)),
    ("camera_width", b"\0\0"),
    ("camera_height", b"\0\0"),
    ("camera_focal[0]", struct.pack("<f", 0.0)),
    ("camera_rotation[0]", bytes(16)),
    ("camera_rotation[3]", NAN),
    ("camera_translation[2]", NAN),
]


@pytest.mark.parametrize(("name", "value"), RENDER)
def test_render_information(name: str, value: bytes) -> None:
    error = refused(field(f"render_info.{name}", value)[0])
    assert error is not None
    assert error.kind.name == "header.render_info"
    vector = name.partition("[")
    assert error.offset == where(f"render_info.{vector[0]}" + ("[0]" if vector[1] else ""))


FRAME = [
    (0, "<i", -(1 << 20)),
    (32, "<i", 1 << 20),
    (36, "<q", 1 << 61),
    (52, "<q", -(1 << 61)),
    (62, "<B", 61),
    (63, "<B", 1),
    (64, "<i", -(1 << 18) - 1),
    (72, "<i", 1 << 18),
    (84, "<i", (1 << 18) + 1),
]


@pytest.mark.parametrize(("at", "form", "value"), FRAME)
def test_frame(at: int, form: str, value: int) -> None:
    data, offset = fixed(start(container.FRAME) + at, struct.pack(form, value))
    error = refused(data)
    assert error is not None
    assert (error.kind.name, error.offset) == ("frame.range", offset)


@pytest.mark.parametrize("axis", range(3))
def test_frame_bounds_without_extent(axis: int) -> None:
    at = start(container.FRAME) + 64 + 4 * axis
    data, offset = fixed(at + 12, FILE[at : at + 4])
    error = refused(data)
    assert error is not None
    assert (error.kind.name, error.offset) == ("frame.range", offset)


@pytest.mark.parametrize(
    ("profile", "change", "field"),
    [
        (TINY, {"slices": (2,)}, "carm_layers"),
        (TINY, {"carm_width": ()}, "carm_layers"),
        (TINY, {"slices": (2, 17)}, "slice_width[1]"),
        (TINY, {"slices": (1,) * 5}, "slice_count"),
        (TINY, {"hyper_width": ()}, "hyper_layers"),
        (TINY, {"sarm_width": (4, 17)}, "sarm_width[1]"),
        (TINY, {"plane_size": 33}, "plane_size"),
        (MAIN, {"slices": (5, 10, 20, 15)}, "slice_width[0]"),
        (MAIN, {"render_width": 51}, "render_width"),
        (MAIN, {"plane_size": 257}, "plane_size"),
    ],
)
def test_dimensions(profile: int, change: dict, field: str) -> None:
    base = {TINY: TINY_DIMENSIONS, MAIN: MAIN_DIMENSIONS}[profile]
    assert dimension_fault(PROFILES[profile], base) is None
    fault = dimension_fault(PROFILES[profile], replace(base, **change))
    assert fault is not None
    assert fault[0] == field


HUGE = struct.pack("<I", 0xFFFFFFFF)
GREEDY = {
    "anchor_count": lambda: field("anchor_count", HUGE)[0],
    "chunk_size": lambda: field("chunk_size", HUGE)[0],
    "section length": lambda: field("directory[6].length", HUGE)[0],
    "plane length": lambda: repair(put(start(container.PLANES_SECTION) + 8, HUGE)),
    "position length": lambda: repair(put(TABLE, HUGE)),
    "mask length": lambda: repair(put(TABLE + 8, HUGE)),
    "attribute length": lambda: repair(put(TABLE + 16, HUGE)),
    "word count": lambda: repair(put(ATTRIBUTES + 4, HUGE)),
    "plane_size": lambda: field("dimensions.plane_size", b"\xff\xff")[0],
    "slice_count": lambda: field("dimensions.slice_count", b"\xff")[0],
    "section_count": lambda: field("section_count", b"\xff")[0],
    "header_length": lambda: prologue(header_length=0xFFFFFFFF) + FILE[20:],
}


@pytest.mark.parametrize("keep_going", [False, True])
@pytest.mark.parametrize("name", GREEDY)
def test_asking_for_much_allocates_nothing(name: str, keep_going: bool) -> None:
    data = GREEDY[name]()
    codec.parse(FILE)  # imports and caches are not what is measured
    tracemalloc.start()
    try:
        if keep_going and name == "word count":
            assert list(codec.parse(data, keep_going=True).damage) == [0]
        else:
            with pytest.raises(BitstreamError):
                codec.parse(data, keep_going=keep_going)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2 << 20


def test_many_anchors_need_many_bytes() -> None:
    """The level's anchors without their bytes: the positions' length is checked against the directory, the directory against the file."""
    data = bytearray(field("anchor_count", struct.pack("<I", 4096))[0])
    error = refused(repair(bytes(data)))
    assert error is not None
    assert error.kind.name == "directory.length"


# --- damaged files that are still worth something --------------------------------------------------------------------

SCENE = random_scene(36, 23, chunk_size=5, lanes=Lanes(1, 1, 1))
WHOLE = codec.emit(SCENE)
CHUNKS = container.chunk_ranges(23, 5)


def part_start(kind: int, chunk: int) -> int:
    table = start(container.CHUNK_TABLE, WHOLE) + 6
    column = container.CHUNKED.index(kind)
    lengths = [int.from_bytes(WHOLE[table + 24 * c + 8 * column :][:4], "little") for c in range(chunk)]
    return start(kind, WHOLE) + sum(lengths)


@pytest.mark.parametrize("kind", container.CHUNKED)
@pytest.mark.parametrize("chunks", [[0], [2], [4], [1, 3], [0, 1, 2, 3, 4]])
def test_keep_going_keeps_the_other_chunks(kind: int, chunks: list[int]) -> None:
    data = bytearray(WHOLE)
    for chunk in chunks:
        data[part_start(kind, chunk) + 4] ^= 0x55
    assert refused(bytes(data)) is not None
    parsed = codec.parse(bytes(data), keep_going=True)
    assert sorted(parsed.damage) == chunks
    assert all(error.kind.name == "chunks.crc" for error in parsed.damage.values())
    expected = without_chunks(SCENE, chunks)
    assert parsed.scene.positions.tobytes() == expected.positions.tobytes()
    assert np.array_equal(parsed.scene.masks, expected.masks)
    for name in ("features", "scalings", "offsets", "steps"):
        assert np.array_equal(getattr(parsed.scene.attributes, name), getattr(expected.attributes, name))
    # What was kept is a scene of its own.
    assert codec.emit(codec.parse(codec.emit(parsed.scene)).scene) == codec.emit(parsed.scene)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("together", [1, 2, 1000])
@pytest.mark.parametrize("repaired", [False, True])
def test_keep_going_with_damage_of_every_kind(monkeypatch: pytest.MonkeyPatch, threads: int, together: int, repaired: bool) -> None:
    """Chunk 0 loses its attributes, chunk 1 its masks, chunk 3 its positions and masks: 2 and 4 are left, and each chunk has its own
    first error, whether a checksum finds it or the coder."""
    monkeypatch.setattr(codec, "GROUP_CHUNKS", together)
    faults = [(container.ATTRIBUTES, 0), (container.MASKS, 1), (container.POSITIONS, 3), (container.MASKS, 3)]
    data = WHOLE
    for kind, chunk in faults:
        # A symbol_crc, or the first position, which becomes NaN.
        data = put(part_start(kind, chunk), b"\xff\xff", data)
    parsed = codec.parse(repair(data) if repaired else data, keep_going=True, threads=threads)
    names = dict.fromkeys((0, 1), "substream.symbol_crc" if repaired else "chunks.crc")
    names[3] = "positions.not_finite" if repaired else "chunks.crc"
    assert {n: (e.kind.name, e.offset) for n, e in parsed.damage.items()} == {
        chunk: (names[chunk], part_start(kind, chunk)) for kind, chunk in faults[:3]
    }
    assert codec.emit(parsed.scene) == codec.emit(without_chunks(SCENE, [0, 1, 3]))


def test_keep_going_with_a_cut_file() -> None:
    cut = part_start(container.ATTRIBUTES, 3) + 7
    parsed = codec.parse(WHOLE[:cut], keep_going=True)
    assert sorted(parsed.damage) == [3, 4]
    assert np.array_equal(parsed.scene.attributes.features, SCENE.attributes.features[:15])
    with pytest.raises(BitstreamError):
        codec.parse(WHOLE[: start(container.CHUNK_TABLE, WHOLE)], keep_going=True)


def test_keep_going_with_a_whole_file() -> None:
    parsed = codec.parse(WHOLE, keep_going=True)
    assert parsed.damage == {}
    assert codec.emit(parsed.scene) == WHOLE


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("together", [1, 2, 1000])
def test_the_lowest_chunk_is_reported(monkeypatch: pytest.MonkeyPatch, threads: int, together: int) -> None:
    """A late fault of chunk 1 and an early one of chunk 3: chunk 1 wins, however chunks are grouped."""
    monkeypatch.setattr(codec, "GROUP_CHUNKS", together)
    data = put(part_start(container.ATTRIBUTES, 1), b"\0\0\0\0", WHOLE)
    data = repair(put(part_start(container.ATTRIBUTES, 3) + 4, b"\xff\xff\xff\xff", data))
    with pytest.raises(BitstreamError) as caught:
        codec.parse(data, threads=threads)
    assert (caught.value.kind.name, caught.value.offset) == ("substream.symbol_crc", part_start(container.ATTRIBUTES, 1))


def test_a_fault_in_masks_comes_before_one_in_attributes() -> None:
    data = put(part_start(container.ATTRIBUTES, 0), b"\0\0\0\0", WHOLE)
    data = repair(put(part_start(container.MASKS, 4), b"\0\0\0\0", data))
    error = refused(data)
    assert error is not None
    assert error.offset == part_start(container.MASKS, 4)


def test_the_lowest_plane_is_reported() -> None:
    at = start(container.PLANES_SECTION, WHOLE)
    second = at + 20 + int.from_bytes(WHOLE[at : at + 4], "little")
    third = second + int.from_bytes(WHOLE[at + 4 : at + 8], "little")
    error = refused(repair(put(third + 4, b"\xff\xff\xff\xff", put(second, b"\0\0\0\0", WHOLE))))
    assert error is not None
    assert (error.kind.name, error.offset) == ("substream.symbol_crc", second)
