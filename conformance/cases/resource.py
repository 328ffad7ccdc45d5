"""Cases of clause 13.1: small files that require or claim much memory or time. They test the budgets."""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import Dimensions, layers_of
from refcodec.bitstream.directory import DATA, INDEX, SECTION_LENGTH_MAX
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.index import index_bytes
from refcodec.bitstream.limits import MAIN, PROFILES
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .cells import MIDDLE, of_cells, placed, sharp_model
from .checksums import Depth, repair, resized
from .directory import long_section
from .entropy_substreams import symbol_crc, word_count
from .fault import Edit, Whole, fault
from .numbers import Numbers
from .positions import overgrown
from .samplers import drawn
from .scenes import SMALLEST, constant, f16, scene, silent, with_symbols
from .target import Target
from .targets import main_file, plain

# SPEC [R6.10-5]: the smallest length of a chunk of 16,384 anchors.
FLOOR = 16 + 16384 // 16
# The number of anchors with a nonzero feature, which takes bytes, in the chunk of the smallest length.
COSTLY = 242


@fault("directory.length")
def anchors_without_chunks(t: Target, values: dict[str, int]) -> Edit:
    """The header has more chunks than the index has entries. values: fields, within the limits of the level."""
    return Edit(t.pack(values), t.at(f"directory[{t.sections[INDEX].number}].length"))


@fault("section.truncated")
def index_beyond(t: Target, level: int) -> Whole:
    """There are as many anchors as a level of Main allows, each in its own chunk, and no entry of the index."""
    most = PROFILES[MAIN].levels[level].anchors
    length = index_bytes(t.header.dimensions.offset_count, t.sections[INDEX].mode, most)
    values = {
        "anchor_count": most,
        "chunk_count": most,
        "chunk_size": 256,
        "level": level,
        f"directory[{t.sections[INDEX].number}].length": length,
    }
    data = t.with_values(values, Depth.HEADER)
    return Whole(data, len(data))


def announced(t: Target, level: int, chunks: int, length: int, content: bytes = b"") -> bytes:
    """Returns a file of Main with many chunks of 16,384 anchors, all of which have entries in the index.

    length: of each chunk. content: the present bytes of DATA.
    """
    data = resized(t.data, INDEX, t.content(INDEX) + struct.pack("<4I12x", length, 0, 16384, 0) * chunks)
    out = bytearray(data + content)
    values = {
        "anchor_count": 16384 * chunks,
        "chunk_count": chunks,
        "chunk_size": 16384,
        "level": level,
        f"directory[{t.sections[DATA].number}].length": chunks * length,
    }
    for at, value in t.pack(values).items():
        out[at : at + len(value)] = value
    return repair(bytes(out))


@fault("section.truncated")
def chunks_without_bytes(t: Target, level: int, chunks: int, length: int) -> Whole:
    """There are many entries with allowed lengths, but no chunks."""
    data = announced(t, level, chunks, length)
    return Whole(data, len(data))


@fault("index.chunk")
def crowded(t: Target, level: int, chunks: int, length: int) -> Whole:
    """The chunks have fewer bytes than their anchors need."""
    at = t.start(INDEX) + t.sections[INDEX].length
    return Whole(announced(t, level, chunks, length), at)


@fault("chunk.length")
def chunks_of_zeros(t: Target, level: int, chunks: int) -> Whole:
    """The chunks have the smallest length, and all bytes are zero."""
    data = announced(t, level, chunks, FLOOR, bytes(FLOOR * chunks))
    return Whole(data, len(data) - FLOOR * chunks)


def add(book: Book) -> None:
    """Adds the vectors."""
    add = partial(book.add, features="many", requirements="D13.1-1", flags="allocates-first lengths-trusted")
    for level, most in PROFILES[MAIN].levels.items():
        title = f"a file of a few kilobytes with {most.anchors} anchors, each of them a chunk"
        add(f"resource-anchors-of-level-{level}", title, index_beyond.of(main_file, level))
    title = "16,777,216 anchors in 1,024 chunks, of which there is the index alone"
    add("resource-anchors-in-large-chunks", title, chunks_without_bytes.of(main_file, 4, 1024, FLOOR))
    title = "16,777,216 anchors in chunks with fewer bytes than these need"
    add("resource-anchors-in-few-bytes", title, crowded.of(main_file, 4, 1024, FLOOR - 4))
    title = "524,288 anchors in 32 chunks of zeros, as few bytes as these can have"
    add("resource-anchors-of-zeros", title, chunks_of_zeros.of(main_file, 2, 32))
    title = "an index that announces terabytes"
    add("resource-lengths-of-gigabytes", title, chunks_without_bytes.of(main_file, 4, 1024, 0xFFFFFFFC))
    title, make = "an ancillary section of four gigabytes", long_section.of(plain, 6, 0xFFFFFFFF)
    add("resource-section-of-4-gigabytes", title, make)
    title, make = "an ancillary section of 256 terabytes", long_section.of(plain, 6, SECTION_LENGTH_MAX)
    add("resource-section-of-256-terabytes", title, make)
    title, make = "a substream of two thousand million words", word_count.of(plain, "attributes[chunk 1]", 0x7FFFFFFF)
    add("resource-words-of-4-gigabytes", title, make)
    title = "4,096 anchors in as many chunks, in a file that has two"
    values = {"chunk_size": 1, "chunk_count": 4096}
    add("resource-chunks-of-one", title, anchors_without_chunks.of(_large_chunks, values))
    book.add(
        "resource-tree-of-all-cells",
        "a tree all of whose nodes have all their children",
        # There would be 8^16 cells without a limit.
        overgrown.of(_one_tree, 16),
        features="many",
        requirements="D13.1-1",
        flags="tree-dropped allocates-first",
    )
    accepted = partial(book.add, requirements="D13.1-1", flags="buffer-too-small")
    accepted(
        "resource-largest-tiny",
        "as many anchors and planes as Tiny allows, most of them predicted",
        lambda: codec.emit(_largest()),
        features="many",
        seconds=120,
    )
    accepted(
        "resource-many-chunks",
        "1,000 chunks of one anchor",
        lambda: codec.emit(_quiet("resource-chunks", 1000, SMALLEST, 1)),
        features="many chunks",
        seconds=60,
    )
    accepted(
        "resource-chunk-at-the-floor",
        "a chunk of 16,384 anchors in 1,040 bytes, as few as these can have",
        _at_floor,
        features="many main",
        seconds=120,
    )
    title = "one lane in each substream, and symbols that take next to no bytes"
    accepted("resource-one-lane", title, lambda: _one_lane().data, features="many lanes", seconds=120)
    for path in ("weights", "planes.r1", "positions[chunk 0]", "masks[chunk 0]", "attributes[chunk 0]"):
        # The last check of a substream, after all of its symbols.
        part = path.partition("[")[0].replace(".", "-")
        title, make = f"one lane, and a wrong symbol_crc of {path}", symbol_crc.of(_one_lane, path, 0, 1)
        add(f"resource-one-lane-{part}", title, make, flags="symbol-crc", seconds=120)
    accepted(
        "resource-many-sections",
        "3,000 ancillary sections without bytes",
        lambda: codec.emit(replace(drawn("sections", 1, SMALLEST), ancillary=(Ancillary(b"noTE", 0, b""),) * 3000)),
        features="many ancillary",
    )


def _at_floor() -> bytes:
    made = _quiet("resource-floor", 16384, SMALLEST, 16384, profile=MAIN, lanes=Lanes(0, 5, 7))
    made = replace(made, position_model=position_model(made.positions, 16384))
    features = np.zeros_like(made.attributes.features)
    # Large values, so that the chunk has the smallest allowed length.
    features[:COSTLY] = 1
    data = codec.emit(with_symbols(made, features=features))
    assert Target(data).value("index.entry[0].length") == FLOOR
    return data


@cache
def _large_chunks() -> Target:
    return Target(codec.emit(_quiet("resource-chunks", 4096, SMALLEST, 2048)))


@cache
def _one_tree() -> Target:
    where, lanes = f16(np.arange(192).reshape(64, 3)), Lanes(0, 0, 0)
    return Target(codec.emit(placed("resource-tree", where, sharp_model(), lanes=lanes)))


def _quiet(name: str, anchors: int, d: Dimensions, chunk_size: int, **changes: Any) -> Scene:
    """Returns a scene with positions of few bits, and symbols of 0, which take almost no bits.

    changes: as of scene.
    """
    numbers = Numbers(name)
    zero = np.zeros(d.attribute_width, np.int64)
    networks = constant(d, numbers, zero, zero - 40)
    networks["sarm"] = silent(networks["sarm"])
    networks["sarm"][-1][1][1] = -40
    for layers in (networks["opacity"], networks["covariance"], networks["colour"]):
        layers[:] = silent(layers)
    side = 16 if anchors <= 4096 else 32
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
        mask_model=np.ones(d.offset_count * (d.offset_count + 1) // 2, np.uint16),
        weight_scales=np.zeros((len(layers_of(d)), 3), np.uint8),
        **{"lanes": Lanes(3, 0, 3 if chunk_size > 9 else 0), **changes},
    )
    made = replace(made, planes=np.zeros_like(made.planes))
    return with_symbols(
        made, **{kind: np.zeros_like(getattr(made.attributes, kind)) for kind in ("features", "scalings", "offsets")}
    )


@cache
def _one_lane() -> Target:
    d = Dimensions(10, (16, 16), 8, 1, 32, (16, 16), (16,), (16,), 16)
    made = _quiet("resource-one-lane", 1024, d, 1024, lanes=Lanes(0, 0, 0))
    features = np.zeros_like(made.attributes.features)
    # Large values, so that the chunk with packed positions has the smallest allowed length.
    features[:4] = 1
    made = replace(made, position_model=position_model(made.positions, 1024))
    return Target(codec.emit(with_symbols(made, features=features)))


def _largest() -> Scene:
    d = Dimensions(10, (16, 16), 8, 1, 32, (4,), (4,), (2,), 1)
    made = _quiet("resource-largest", 4096, d, 192)
    return replace(made, position_model=position_model(made.positions, 192))
