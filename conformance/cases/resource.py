"""Cases of clause 13.1: small files that ask for much, or say that they hold much. The budget is what they test."""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import Dimensions, layers_of
from refcodec.bitstream.directory import CHUNK_TABLE, POSITIONS
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.limits import MAIN, PROFILES
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .cells import MIDDLE, of_cells, placed, sharp_model
from .checksums import Depth, repair, resized
from .entropy_substreams import word_count
from .fault import Edit, Whole, fault
from .numbers import Numbers
from .positions import overgrown
from .scenes import SMALLEST, constant, f16, scene, silent, with_symbols
from .target import Target
from .targets import main_file, plain


@fault("directory.length")
def anchors_without_chunks(t: Target, values: dict[str, int]) -> Edit:
    """A header with more chunks than the chunk table has entries. values: fields, within the limits of the level."""
    return Edit(t.pack(values), t.at("directory[3].length"))


@fault("chunks.length")
def chunks_without_bytes(t: Target, lengths: tuple[int, int, int]) -> Whole:
    """As many anchors as level 3 of Main allows, in 256 chunks of which there is the table alone.

    lengths: of each chunk's parts, which the chunk could have.
    """
    most, size = PROFILES[MAIN].levels[3].anchors, PROFILES[MAIN].chunk_size[1]
    entry = struct.pack("<6I", *(field for length in lengths for field in (length, 0)))
    table = t.content(CHUNK_TABLE) + entry * (most // size)
    data = bytearray(resized(t.data, CHUNK_TABLE, table))
    for at, value in t.pack({"anchor_count": most, "chunk_size": size, "level": 3}).items():
        data[at : at + len(value)] = value
    # SPEC [R6.10-2]: without bytes a position_length is too small; else the sum of them is not the section.
    told = t.start(POSITIONS) + (len(entry) * (most // size) if lengths[0] else 0)
    return Whole(repair(bytes(data), Depth.SECTIONS), told)


@fault("directory.file_length")
def long_section(t: Target, entry: int, length: int) -> Edit:
    """A last section that the file does not hold."""
    return Edit(t.pack({f"directory[{entry}].length": length}), len(t.data))


def add(book: Book) -> None:
    """Adds the vectors."""
    add = partial(book.add, features="many", requirements="D13.1-1", flags="allocates-first lengths-trusted")
    for level, most in PROFILES[MAIN].levels.items():
        title = f"a file of a few kilobytes with {most.anchors} anchors"
        values = {"anchor_count": most.anchors, "level": level, "chunk_size": 256}
        add(f"resource-anchors-of-level-{level}", title, anchors_without_chunks.of(main_file, values))
    title, make = "16,777,216 anchors in 256 chunks of no bytes", chunks_without_bytes.of(main_file, (0, 0, 0))
    add("resource-anchors-in-large-chunks", title, make)
    title = "a chunk table that announces gigabytes"
    make = chunks_without_bytes.of(main_file, (65536 * 6, 1 << 20, 1 << 22))
    add("resource-lengths-of-gigabytes", title, make)
    title, make = "an ancillary section of four gigabytes", long_section.of(plain, 8, 0xFFFFFFFF)
    add("resource-section-of-4-gigabytes", title, make)
    title, make = "a substream of two thousand million words", word_count.of(plain, "attributes[chunk 1]", 0x7FFFFFFF)
    add("resource-words-of-4-gigabytes", title, make)
    title = "4,096 anchors in as many chunks, in a file that has three"
    add("resource-chunks-of-one", title, anchors_without_chunks.of(_large_chunks, {"chunk_size": 1}))
    book.add(
        "resource-tree-of-all-cells",
        "a tree all of whose nodes have all their children",
        # 8^16 cells, were they not dropped.
        overgrown.of(_one_tree, 16),
        features="many",
        requirements="D13.1-1",
        flags="tree-dropped allocates-first",
    )
    book.add(
        "resource-largest-tiny",
        "as many anchors and planes as Tiny allows, most of them predicted",
        lambda: codec.emit(_largest()),
        features="many",
        requirements="D13.1-1",
        flags="buffer-too-small",
        seconds=120,
    )
    book.add(
        "resource-many-chunks",
        "2,000 chunks of one anchor",
        lambda: codec.emit(_quiet("resource-chunks", 2000, SMALLEST, 1)),
        features="many chunks",
        requirements="D13.1-1",
        flags="buffer-too-small",
        seconds=60,
    )


@cache
def _large_chunks() -> Target:
    return Target(codec.emit(_quiet("resource-chunks", 4096, SMALLEST, 2048)))


@cache
def _one_tree() -> Target:
    where, lanes = f16(np.arange(192).reshape(64, 3)), Lanes(0, 0, 0)
    return Target(codec.emit(placed("resource-tree", where, sharp_model(), lanes=lanes)))


def _quiet(name: str, anchors: int, d: Dimensions, chunk_size: int) -> Scene:
    """A scene whose symbols are all 0 and cost next to nothing, in positions that cost little."""
    numbers = Numbers(name)
    zero = np.zeros(d.attribute_width, np.int64)
    networks = constant(d, numbers, zero, zero - 40)
    networks["sarm"] = silent(networks["sarm"])
    networks["sarm"][-1][1][1] = -40
    for layers in (networks["opacity"], networks["covariance"], networks["colour"]):
        layers[:] = silent(layers)
    side = 16
    n = np.arange(anchors)
    where = of_cells(MIDDLE + np.stack([n % side, n // side % side, n // side**2], axis=1), 20)
    made = scene(
        name,
        anchors,
        d,
        networks=networks,
        positions=where,
        masks=np.zeros((anchors, d.offset_count), bool),
        chunk_size=chunk_size,
        lanes=Lanes(3, 0, 3 if chunk_size > 9 else 0),
        mask_model=np.ones(d.offset_count * (d.offset_count + 1) // 2, np.uint16),
        weight_scales=np.zeros((len(layers_of(d)), 3), np.uint8),
    )
    made = replace(made, planes=np.zeros_like(made.planes))
    return with_symbols(
        made, **{kind: np.zeros_like(getattr(made.attributes, kind)) for kind in ("features", "scalings", "offsets")}
    )


def _largest() -> Scene:
    d = Dimensions(10, (16, 16), 8, 1, 32, (4,), (4,), (2,), 1)
    made = _quiet("resource-largest", 4096, d, 192)
    return replace(made, position_model=position_model(made.positions, 192))
