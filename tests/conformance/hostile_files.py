"""Small files with every section and form, and hostile files derived from them, for any decoder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from hypothesis import strategies as st

from conformance.cases.checksums import repair
from conformance.cases.scenes import (
    CONSTANT,
    PLANELESS,
    SMALLEST,
    TINY_DIMENSIONS,
    UNENCODED,
    packed_weights,
    random_scene,
)
from conformance.cases.target import Target
from conformance.fuzz.strategies import draw_mutation, draw_splice
from refcodec.bitstream import codec, directory
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes, RenderInfo
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.encoder.positions import position_model


def _scenes() -> dict[str, Scene]:
    """Every section and form, with and without planes and frequencies, several chunks, and more than is known."""
    mixed = random_scene(39, 9, chunk_size=4, lanes=Lanes(0, 1, 0))
    sections = (
        Ancillary(b"noTE", 3, b"hello", 0),
        Ancillary(b"mETa", 0, bytes(4), 2),
        Ancillary(b"cAMs", 0, b"x", 5),
    )
    return {
        "raw": random_scene(31, 7, chunk_size=3),
        "packed": packed_weights(replace(mixed, position_model=position_model(mixed.positions, 4))),
        "planeless": replace(random_scene(32, 7, PLANELESS), ancillary=sections),
        "unencoded": random_scene(33, 5, UNENCODED),
        "constant": replace(random_scene(34, 6, CONSTANT), minor=1, later=b"\1\2\3\4"),
        "smallest": random_scene(35, 3, SMALLEST, chunk_size=1),
        "empty": random_scene(36, 0, SMALLEST),
    }


SCENES = _scenes()
FILES = {name: codec.emit(scene) for name, scene in SCENES.items()}
# A scene of a later render model (SPEC 6.5), which decoders decode and renderers do not draw.
UNDRAWN = random_scene(
    37,
    5,
    replace(TINY_DIMENSIONS, view_inputs=8, colour_outputs=27),
    render=RenderInfo(colour_primaries=9, transfer_characteristics=16, render_model=7),
)


def largest_planes() -> Scene:
    """A scene with planes of the largest size (SPEC 11.1)."""
    d = Dimensions(2, (2, 3), 1, 2, 1024, (6,), (4,), (5,), 3)
    return random_scene(38, 300, d, profile=MAIN, chunk_size=256)


def changes(draw: st.DrawFn, file: bytes) -> Iterator[bytes]:
    """Yields a file with one bit turned, one with changed bytes, and one with a changed substream."""
    at = draw(st.integers(0, len(file) - 1))
    yield file[:at] + bytes([file[at] ^ 1 << draw(st.integers(0, 7))]) + file[at + 1 :]
    yield draw_mutation(draw, file)
    yield draw_splice(draw, file)


def cuts(file: bytes) -> Iterator[tuple[bytes, tuple[bytes, bytes]]]:
    """Yields a file cut at the borders of the elements that tell how much follows, and at many other places.

    With each come two more: the cut file with a byte behind it, and with its checksums repaired.
    """
    target = Target(file)
    borders = [0, 19, 20, target.header_end, *(section.start for section in target.header.sections)]
    borders += [target.chunk_at(chunk) + more for chunk in range(target.header.chunk_count) for more in (0, 1, 16)]
    for length in {*borders, *range(3, len(file), 61)}:
        cut = file[:length]
        yield cut, (cut + b"\0", repair(cut) if length >= 20 else cut)


def _wide(target: Target, path: str) -> bytes:
    """The file with all bits of a field set, checksums right."""
    element = target.element(path)
    return repair(target.put(element.start, b"\xff" * (element.end - element.start)))


GREEDY: dict[str, Callable[[Target], bytes]] = {
    "anchor_count": lambda t: _wide(t, "anchor_count"),
    "chunk_count": lambda t: _wide(t, "chunk_count"),
    "section_count": lambda t: _wide(t, "section_count"),
    "plane_size": lambda t: _wide(t, "dimensions.plane_size"),
    "weights": lambda t: t.with_values({f"directory[{t.sections[directory.WEIGHTS].number}].length": 1 << 48}),
    "planes": lambda t: t.with_values({f"directory[{t.sections[directory.PLANES_SECTION].number}].length": 1 << 48}),
    "data": lambda t: t.with_values({f"directory[{t.sections[directory.DATA].number}].length": 1 << 48}),
    "a plane": lambda t: _wide(t, "planes.length[1]"),
    "words": lambda t: _wide(t, "attributes[chunk 0].word_count"),
    "positions": lambda t: _wide(t, "chunk[0].position_length"),
    "a chunk and all of them": lambda t: t.with_values(
        {
            "index.entry[0].length": 0xFFFFFFFC,
            f"directory[{t.sections[directory.DATA].number}].length": 0xFFFFFFFC
            + sum(t.value(f"index.entry[{n}].length") for n in range(1, t.header.chunk_count)),
        }
    ),
}
