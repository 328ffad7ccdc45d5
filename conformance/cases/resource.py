"""Small files that ask for much, or say that they hold much: the budget is what they test."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np

from refcodec.bitstream import codec, directory
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book, Refused
from .decoding import f16
from .files import Target, repair, resized
from .numbers import Numbers
from .packing import MIDDLE, of_cells, sharp_model
from .refused_header import main_file, patched, plain
from .refused_sections import overgrown
from .refused_streams import stream_of
from .scenes import SMALLEST, constant, scene, silent, with_symbols

MOST = {1: 1 << 17, 2: 1 << 20, 3: 1 << 24}


def add(book: Book) -> None:
    """Adds the vectors."""

    def add_refused(name: str, text: str, make: object, flags: str) -> None:
        book.add(f"resource-{name}", text, make, features="many", requirements="D13.1-1", flags=flags)  # type: ignore[arg-type]

    flags = "allocates-first lengths-trusted"
    for level, most in MOST.items():

        def crowd(level: int = level, most: int = most) -> Refused:
            t = main_file()
            data = bytearray(t.put(t.at("anchor_count"), struct.pack("<I", most)))
            data[t.at("level")] = level
            data[t.at("chunk_size") : t.at("chunk_size") + 4] = struct.pack("<I", 256)
            # The chunk table has not the entries that so many chunks need.
            return Refused(repair(bytes(data)), "directory.length", t.at("directory[3].length"))

        add_refused(f"anchors-of-level-{level}", f"a file of a few kilobytes with {most} anchors", crowd, flags)

    def large_chunks() -> Refused:
        # Chunks so large that their entries are there; the positions are not.
        t = main_file()
        chunks = (1 << 24) // 65536
        table = t.content(directory.CHUNK_TABLE)[: t.entries - t.table]
        data = bytearray(resized(t.data, directory.CHUNK_TABLE, table + bytes(24 * chunks)))
        for path, form, value in (("anchor_count", "<I", 1 << 24), ("chunk_size", "<I", 65536), ("level", "B", 3)):
            size = struct.calcsize(form)
            data[t.at(path) : t.at(path) + size] = struct.pack(form, value)
        return Refused(repair(bytes(data)), "chunks.length", t.entries)

    add_refused("anchors-in-large-chunks", "16,777,216 anchors in 256 chunks of no bytes", large_chunks, flags)

    def stated() -> Refused:
        # As before, with lengths that would do, and sections that are not there.
        t = main_file()
        chunks = (1 << 24) // 65536
        table = t.content(directory.CHUNK_TABLE)[: t.entries - t.table]
        entry = struct.pack("<6I", 65536 * 6, 0, 1 << 20, 0, 1 << 22, 0)
        data = bytearray(resized(t.data, directory.CHUNK_TABLE, table + entry * chunks))
        for path, form, value in (("anchor_count", "<I", 1 << 24), ("chunk_size", "<I", 65536), ("level", "B", 3)):
            size = struct.calcsize(form)
            data[t.at(path) : t.at(path) + size] = struct.pack(form, value)
        return Refused(repair(bytes(data), chunks=False), "chunks.length", t.start(directory.POSITIONS) + 24 * chunks)

    add_refused("lengths-of-gigabytes", "a chunk table that announces gigabytes", stated, flags)

    def sections() -> Refused:
        t = plain()
        at = t.at("directory[8].length")
        return Refused(repair(t.put(at, b"\xff\xff\xff\xff")), "directory.file_length", len(t.data))

    add_refused("section-of-4-gigabytes", "an ancillary section of four gigabytes", sections, flags)

    def words() -> Refused:
        t = plain()
        stream = stream_of(t, "attributes", 1)
        return Refused(repair(t.put(stream[1] + 4, b"\xff\xff\xff\x7f")), "substream.length", stream[1])

    add_refused("words-of-4-gigabytes", "a substream of two thousand million words", words, flags)
    add_refused(
        "chunks-of-one",
        "4,096 anchors in as many chunks, in a file that has three",
        patched(_many_small, "chunk_size", "<I", 1, "directory.length", "directory[3].length"),
        flags,
    )

    def tree() -> Refused:
        # 8^16 cells, were they not dropped.
        made = scene("resource-tree", 64, SMALLEST, positions=f16(np.arange(192).reshape(64, 3)), lanes=Lanes(0, 0, 0))
        return overgrown(Target(codec.emit(replace(made, position_model=sharp_model({})))), 16)

    add_refused(
        "tree-of-all-cells", "a tree all of whose nodes have all their children", tree, "tree-dropped allocates-first"
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
        lambda: codec.emit(_many(2000, 1)),
        features="many chunks",
        requirements="D13.1-1",
        flags="buffer-too-small",
        seconds=60,
    )


def _many_small() -> Target:
    return Target(codec.emit(_many(4096, 2048)))


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
    )
    layers_count = sum(map(len, networks.values()))
    made = replace(made, planes=np.zeros_like(made.planes), weight_scales=np.zeros((layers_count, 3), np.uint8))
    return with_symbols(
        made, **{kind: np.zeros_like(getattr(made.attributes, kind)) for kind in ("features", "scalings", "offsets")}
    )


def _largest() -> Scene:
    d = Dimensions(10, (16, 16), 8, 1, 32, (4,), (4,), (2,), 1)
    made = _quiet("resource-largest", 4096, d, 192)
    return replace(made, position_model=position_model(made.positions, 192))


def _many(anchors: int, chunk_size: int) -> Scene:
    return _quiet("resource-chunks", anchors, SMALLEST, chunk_size)
