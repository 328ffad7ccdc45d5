"""Small files with every section and form, and hostile files derived from them, for any decoder."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import replace

from hypothesis import assume
from hypothesis import strategies as st
from random_scenes import random_scene

from conformance.cases.checksums import repair
from conformance.cases.fault import Refused
from conformance.cases.scenes import CONSTANT, PLANELESS, SMALLEST, TINY_DIMENSIONS, UNENCODED
from conformance.cases.target import Target
from conformance.fuzz.strategies import draw_fault, draw_mutation, draw_splice, drawable
from refcodec.bitstream import codec, directory
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes, RenderInfo
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.encoder.positions import position_model
from refcodec.encoder.weights import pack_weights


def _scenes() -> dict[str, Scene]:
    """Every section and form, with and without planes and frequencies, several chunks, and more than is known."""
    mixed = random_scene(39, 9, chunk_size=4, lanes=Lanes(0, 1, 0))
    sections = (Ancillary(b"noTE", 3, b"hello", 0), Ancillary(b"mETa", 0, bytes(4), 2), Ancillary(b"cAMs", 0, b"x", 5))
    return {
        "raw": random_scene(31, 7, chunk_size=3),
        "packed": pack_weights(replace(mixed, position_model=position_model(mixed.positions, 4))),
        "planeless": replace(random_scene(32, 7, PLANELESS), ancillary=sections),
        "unencoded": random_scene(33, 5, UNENCODED),
        "constant": replace(random_scene(34, 6, CONSTANT), minor=1, later=b"\1\2\3\4"),
        "smallest": random_scene(35, 3, SMALLEST, chunk_size=1),
        "empty": random_scene(36, 0, SMALLEST),
    }


SCENES = _scenes()
FILES = {name: codec.emit(scene) for name, scene in SCENES.items()}
# A scene of a later render model (SPEC 6.5), which decoders decode and renderers do not draw.
LATER = RenderInfo(colour_primaries=9, transfer_characteristics=16, render_model=7)
UNDRAWN = random_scene(37, 5, replace(TINY_DIMENSIONS, view_inputs=8, colour_outputs=27), render=LATER)


def largest_planes() -> Scene:
    """A scene with planes of the largest size (SPEC 11.1)."""
    d = Dimensions(2, (2, 3), 1, 2, 1024, (6,), (4,), (5,), 3)
    return random_scene(38, 300, d, profile=MAIN, chunk_size=256)


# --- one fault --------------------------------------------------------------------------------------------------------

# Files that between them have a place for every fault: ancillary sections, idle lanes, several chunks, one slice and
# more, no anchors, no planes and no frame, a later minor version, positions and weights that are packed.
TARGETS = [
    Target(codec.emit(scene))
    for scene in (
        replace(
            random_scene(32, 11, chunk_size=4, lanes=Lanes(1, 4, 1), spread=6),
            ancillary=(Ancillary(b"noTE", 1, b"hello", 2), Ancillary(b"mETa", 0, b"", 9)),
        ),
        random_scene(36, 3, Dimensions(1, (2,), 1, 1, 3, (2, 2), (2,), (), 1), chunk_size=1, lanes=Lanes(0, 2, 3)),
        random_scene(37, 0),
        replace(random_scene(38, 5, CONSTANT, chunk_size=3), minor=1, later=b"abcd"),
        # Anchors in no order: two raw chunks, and a packed one of a single anchor.
        SCENES["packed"],
    )
]


@st.composite
def faulty(draw: st.DrawFn, error: str) -> Refused:
    """A file with any fault that has this error."""
    name = draw(st.sampled_from([name for name, fault in drawable().items() if fault.error == error]))
    targets = draw(st.permutations(TARGETS))
    faulted = next((refused for t in targets if (refused := draw_fault(draw, t, name)) is not None), None)
    assume(faulted is not None)
    assert faulted is not None
    return faulted


# --- changed and cut files --------------------------------------------------------------------------------------------


def changes(draw: st.DrawFn, file: bytes) -> Iterator[bytes]:
    """Yields a file with one bit turned, one with changed bytes, and one with a changed substream."""
    at = draw(st.integers(0, len(file) - 1))
    yield file[:at] + bytes([file[at] ^ 1 << draw(st.integers(0, 7))]) + file[at + 1 :]
    yield draw_mutation(draw, file)
    yield draw_splice(draw, file)


SIZES = {"f32": 4, "f16": 2}


def places(target: Target) -> list[tuple[int, int]]:
    """(offset, bytes) of each element: fields, padding, and the first items of what is long."""
    fields = []
    for row in target.elements.values():
        item = row.kind.partition("[")
        size = SIZES.get(item[0], int(item[0][1:]) // 8 if item[0][1:].isdigit() else 1) if item[1] else 0
        if size:
            fields += [(at, size) for at in range(row.start, min(row.end, row.start + 12 * size) - size + 1, size)]
        elif 0 < row.end - row.start <= 8:
            fields.append((row.start, row.end - row.start))
    return fields


PLACES = {name: places(Target(file)) for name, file in FILES.items()}
FLOATS = [struct.unpack("<I", struct.pack("<f", v))[0] for v in (1e-45, -0.0, 3.4e38, 1024, float("nan"), float("inf"))]


@st.composite
def changed_fields(draw: st.DrawFn, name: str) -> bytes:
    """A file with one to three elements at values at an edge of their type, or near what they were, checksums right."""
    out = bytearray(FILES[name])
    for at, size in draw(st.lists(st.sampled_from(PLACES[name]), min_size=1, max_size=3)):
        top, old = 1 << 8 * size, int.from_bytes(out[at : at + size], "little")
        edges = [0, 1, top - 1, top // 2, top // 2 - 1, old + 1, old - 1, old ^ (top // 2), 2 * old, old // 2]
        edges += FLOATS if size == 4 else []
        value = draw(st.sampled_from(edges) | st.integers(0, top - 1)) % top
        out[at : at + size] = value.to_bytes(size, "little")
    return repair(bytes(out))


def cuts(file: bytes, step: int = 61) -> Iterator[bytes]:
    """Yields a file cut at the borders of the elements that tell how much follows, and at many other places.

    Each is cut; cut, with a byte behind it; and cut, with its checksums repaired.
    """
    target = Target(file)
    borders = [0, 19, 20, target.header_end, *(section.start for section in target.header.sections)]
    borders += [target.chunk_at(chunk) + more for chunk in range(target.header.chunk_count) for more in (0, 1, 16)]
    for length in sorted({*borders, *range(3, len(file), step)}):
        cut = file[:length]
        yield from (cut, cut + b"\0", repair(cut) if length >= 20 else cut)
    yield file + b"\0"


# --- asking for much --------------------------------------------------------------------------------------------------


def _wide(target: Target, path: str) -> bytes:
    """The file with all bits of a field set, checksums right."""
    element = target.element(path)
    return repair(target.put(element.start, b"\xff" * (element.end - element.start)))


def _longer(target: Target, kind: bytes) -> bytes:
    """The file whose section has a length of 2^48."""
    return target.with_values({f"directory[{target.sections[kind].number}].length": 1 << 48})


def _chunk_and_all(target: Target) -> bytes:
    """A chunk of almost 2^32 bytes, which the length of DATA includes."""
    rest = sum(target.value(f"index.entry[{n}].length") for n in range(1, target.header.chunk_count))
    length = f"directory[{target.sections[directory.DATA].number}].length"
    return target.with_values({"index.entry[0].length": 0xFFFFFFFC, length: 0xFFFFFFFC + rest})


FIELDS = (
    *("anchor_count", "chunk_size", "chunk_count", "section_count", "dimensions.plane_size", "dimensions.slice_count"),
    *("planes.length[1]", "index.entry[0].length", "index.entry[0].anchor_count", "chunk[0].position_length"),
    *("chunk[0].attribute_length", "attributes[chunk 0].word_count"),
)
GREEDY: dict[str, Callable[[Target], bytes]] = {
    **{path: lambda t, path=path: _wide(t, path) for path in FIELDS},  # type: ignore[misc]
    **{
        kind.decode(): lambda t, kind=kind: _longer(t, kind)  # type: ignore[misc]
        for kind in (directory.WEIGHTS, directory.PLANES_SECTION, directory.DATA)
    },
    "a chunk and all of them": _chunk_and_all,
}
