"""Cases of clauses 5.10, 5.15 and 6.10: the chunk table, its models, and the parts of chunks."""

from __future__ import annotations

import copy
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec, syntax
from refcodec.bitstream.chunks import ANCHORS_OF_A_BYTE
from refcodec.bitstream.directory import CHUNK_TABLE, CHUNKED, MASKS, POSITIONS, SECTIONS
from refcodec.bitstream.header import PROLOGUE_BYTES, Lanes
from refcodec.bitstream.positions import CELL_INDEX, HALVES, POSITION_MODELS, encode_positions
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .cells import MIDDLE, any_model, of_cells, placed, sharp_model
from .checksums import Depth, repair
from .fault import Draw, Drawn, Edit, Refused, Whole, fault
from .numbers import Numbers
from .samplers import drawn
from .scenes import SMALLEST, constant, lattice, packed_weights, scene, with_symbols
from .target import Target
from .targets import main_file, packed, plain

# SPEC 5.10: the parts of a chunk as the fields of its entry name them, and their sections.
PARTS = {SECTIONS[kind].removesuffix("s"): kind for kind in CHUNKED}


# --- faults of the mask model and the entries -------------------------------------------------------------------------


@fault("chunks.mask_model")
def mask_model(t: Target, number: int, value: int) -> Edit:
    """A frequency of the mask model that is outside its limits."""
    path = f"chunk_table.mask_model[{number}]"
    return Edit(t.pack({path: value}), t.at(path))


@mask_model.drawn
def _(draw: Draw, t: Target) -> Drawn:
    k = t.header.dimensions.offset_count
    return t, draw.integer(0, k * (k + 1) // 2 - 1), draw.choice([0, 1 << 14, 65535])


@fault("chunks.length")
def lengths(t: Target, changes: dict[tuple[int, str], int]) -> Edit:
    """Lengths of chunks' parts that do not add up. changes: what is added modulo 2^32, by (chunk, part)."""
    values, told = {}, []
    for (chunk, part), more in changes.items():
        path = f"chunk_table.entry[{chunk}].{part}_length"
        values[path] = (t.value(path) + more) % (1 << 32)
        # SPEC [R6.10-2]: the length of raw positions is known; packed ones need a byte for so many anchors.
        few = ANCHORS_OF_A_BYTE * values[path] < len(t.header.chunks[chunk])
        alone = part == "position" and (not t.sections[POSITIONS].mode or few)
        told.append((list(PARTS).index(part), not alone, t.at(path) if alone else t.start(PARTS[part])))
    return Edit(t.pack(values), min(told)[-1], Depth.SECTIONS)


@lengths.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if not t.header.chunks:
        return None
    chunk, part = draw.integer(0, len(t.header.chunks) - 1), draw.choice(list(PARTS))
    old = t.value(f"chunk_table.entry[{chunk}].{part}_length")
    return t, {(chunk, part): draw.choice([1, -1, -old, 0xFFFFFFFF - old])}


@fault("chunks.length")
def more_anchors_than_bytes_hold(t: Target) -> Whole:
    """A packed chunk of so many anchors in two bytes, which hold 32 at most."""
    return Whole(t.with_positions(0, b"\1\0"), t.at("chunk_table.entry[0].position_length"))


@fault("chunks.length")
def bytes_without_chunks(t: Target, kind: int) -> Whole:
    """A byte in a section that has parts of chunks, in a file without anchors."""
    content = {other: b"\0" if other == kind else t.content(other) for other in SECTIONS}
    return Whole(joined(t, content, 0), t.start(kind))


@bytes_without_chunks.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return without_anchors(), draw.choice(CHUNKED)


def joined(t: Target, content: dict[int, bytes], anchors: int) -> bytes:
    """The file with so many anchors, all in one chunk, and with other sections. content: by type, in their order."""
    fields = copy.deepcopy(t.fields)
    fields.anchor_count, fields.chunk_size = anchors, max(anchors, fields.chunk_size)
    at = t.header_end
    for entry in fields.directory:
        entry.offset, entry.length = at, len(content[entry.type])
        at += entry.length
    return repair(t.data[:PROLOGUE_BYTES] + syntax.build("Header", fields) + b"".join(content.values()))


@cache
def without_anchors() -> Target:
    """A file without anchors, whose positions are in mode 1."""
    return Target(codec.emit(scene("outside-empty", 0, SMALLEST, position_model=sharp_model())))


# --- faults of the parts' checksums -----------------------------------------------------------------------------------


@fault("chunks.crc")
def crc(t: Target, chunk: int, part: str, bits: int) -> Edit:
    """Bits of a CRC-32 of a chunk's part are turned."""
    flipped = t.flip(t.at(f"chunk_table.entry[{chunk}].{part}_crc"), bits)
    return Edit(flipped, t.part(PARTS[part], chunk)[0], Depth.SECTIONS)


@crc.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if not t.header.chunks:
        return None
    return t, draw.integer(0, len(t.header.chunks) - 1), draw.choice(list(PARTS)), draw.integer(1, 255)


@fault("chunks.crc")
def part_byte(t: Target, chunk: int, part: str, at: int, bits: int) -> Edit:
    """Bits of a byte of a chunk's part are turned, and the part's CRC-32 is the old one; its section's is right."""
    start, _ = t.part(PARTS[part], chunk)
    return Edit(t.flip(start + at, bits), start, Depth.SECTIONS)


@part_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if not t.header.chunks:
        return None
    chunk, part = draw.integer(0, len(t.header.chunks) - 1), draw.choice(list(PARTS))
    start, end = t.part(PARTS[part], chunk)
    return t, chunk, part, draw.integer(0, end - start - 1), draw.integer(1, 255)


@fault("chunks.crc")
def crc_behind_many_anchors(t: Target) -> Whole:
    """A packed chunk of 65536 anchors in a file that has none, and behind it a part whose CRC-32 is wrong."""
    axes = np.meshgrid(np.arange(16), np.arange(64), np.arange(64), indexing="ij")
    cells = np.stack(axes, axis=-1).reshape(-1, 3) + MIDDLE
    # Models that know no cuboid, for a byte stands for 16 anchors at most.
    model = replace(any_model(Numbers("outside-crowd")), cell_shift=22)
    part = encode_positions(model, of_cells(cells, 22), [range(len(cells))], 1 << t.header.lanes.mask)[0]
    content = {kind: t.content(kind) for kind in SECTIONS}
    numbers = struct.pack("<B288H", model.cell_shift, *model.frequency.reshape(-1).tolist())
    # Of the masks there is a byte, of the attributes none.
    entry = struct.pack("<6I", len(part), 0, 1, 0, 0, 0)
    content[CHUNK_TABLE] = content[CHUNK_TABLE][: -len(numbers)] + numbers + entry
    content[POSITIONS], content[MASKS] = part, b"\0"
    refused = crc(Target(joined(t, content, len(cells))), 0, "mask", 1)
    return Whole(refused.data, refused.offset)


# --- faults of the model of positions ---------------------------------------------------------------------------------


@fault("chunks.position_model")
def cell_shift(t: Target, value: int) -> Edit:
    """A cell_shift above the largest."""
    path = "chunk_table.position_model.cell_shift"
    return Edit(t.pack({path: value}), t.at(path))


@cell_shift.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (t, draw.integer(CELL_INDEX + 1, 255)) if t.sections[POSITIONS].mode else None


def _frequencies(t: Target, model: int) -> tuple[str, list[int]]:
    """A model's path and its frequencies."""
    path = "chunk_table.position_model.frequency"
    return path, [t.value(f"{path}[{HALVES * model + i}]") for i in range(HALVES)]


def _with_frequencies(t: Target, model: int, values: list[int]) -> Edit:
    path, _ = _frequencies(t, model)
    packed = t.pack({f"{path}[{HALVES * model + i}]": value for i, value in enumerate(values)})
    return Edit(packed, t.at(f"{path}[{HALVES * model}]"))


@fault("chunks.position_model")
def frequencies(t: Target, model: int, changes: dict[int | None, int]) -> Edit:
    """Frequencies that do not add up to the total, or stand for what cannot be.

    changes: what is added, by symbol. None is the symbol with the largest frequency.
    """
    _, values = _frequencies(t, model)
    largest = int(np.argmax(values))
    for symbol, more in changes.items():
        values[largest if symbol is None else symbol] += more
    return _with_frequencies(t, model, [value % (1 << 16) for value in values])


@frequencies.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if not t.sections[POSITIONS].mode:
        return None
    return t, draw.integer(0, POSITION_MODELS - 1), {draw.integer(0, HALVES - 1): draw.integer(1, 65535)}


@fault("chunks.position_model")
def no_frequency(t: Target, model: int, symbol: int) -> Edit:
    """A frequency of 0 for a symbol that can be; the largest of the others has what it had."""
    _, values = _frequencies(t, model)
    other = max((n for n in range(HALVES) if n != symbol), key=lambda n: (values[n], -n))
    values[symbol], values[other] = 0, values[other] + values[symbol]
    return _with_frequencies(t, model, values)


@no_frequency.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if not t.sections[POSITIONS].mode:
        return None
    model, symbol = draw.integer(0, POSITION_MODELS - 1), draw.integer(0, HALVES - 1)
    # Of an empty node symbol 0 cannot be, and has the frequency 0.
    return (t, model, symbol) if _frequencies(t, model)[1][symbol] else None


# --- the suite's ------------------------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _lengths(book)
    _checksums(book)
    _models(book)
    _valid(book)


def _lengths(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="lengths-trusted last-chunk")
    rows: list[tuple[str, str, Callable[[], Target], int, str, int]] = [
        ("position-more", "a position_length that is not six times the anchors", plain, 1, "position", 6),
        ("position-last", "the last chunk has as many positions as the others", plain, 2, "position", 6),
        ("mask-more", "mask lengths that add up to one more", plain, 0, "mask", 1),
        ("mask-less", "mask lengths that add up to one less", plain, 2, "mask", -1),
        ("attribute-more", "attribute lengths that add up to one more", plain, 2, "attribute", 1),
        ("attribute-huge", "an attribute_length of 2^31 more", plain, 1, "attribute", 1 << 31),
        ("packed-position-more", "packed position lengths that add up to one more", packed, 0, "position", 1),
        ("packed-position-less", "packed position lengths that add up to one less", packed, 2, "position", -1),
    ]
    for name, title, base, chunk, part, more in rows:
        add(f"malformed-chunks-{name}", title, lengths.of(base, {(chunk, part): more}))
    flags = "lengths-trusted sum-wraps"
    make = lengths.of(plain, {(0, "mask"): 1 << 31, (1, "mask"): 1 << 31})
    add("malformed-chunks-mask-wraps", "mask lengths that add up modulo 2^32", make, flags=flags)
    add = partial(book.add, features="chunks packed-positions")
    title = "a packed chunk of no bytes"
    add("malformed-chunks-packed-position-none", title, partial(_position_length, 1, 0), flags="lengths-trusted")
    title, flags = "a position_length of which sixteen times is 2^32", "sum-wraps lengths-trusted"
    add("malformed-chunks-position-wraps", title, partial(_position_length, 0, 1 << 28), flags=flags)
    title, flags = "33 anchors in two bytes", "lengths-trusted limit-off-by-one"
    add("malformed-chunks-packed-position-crowded", title, more_anchors_than_bytes_hold.of(_crowd), flags=flags)
    for kind in CHUNKED:
        book.add(
            f"malformed-empty-{SECTIONS[kind]}-of-1-byte",
            f"no anchors, and a byte of {SECTIONS[kind]}",
            bytes_without_chunks.of(without_anchors, kind),
            features="empty chunks",
            requirements="R11.2-2",
            flags="empty-sections",
        )


def _position_length(chunk: int, value: int) -> Refused:
    t = packed()
    old = t.value(f"chunk_table.entry[{chunk}].position_length")
    return lengths(t, {(chunk, "position"): value - old})


@cache
def _crowd() -> Target:
    return Target(codec.emit(placed("refused-crowd", lattice(Numbers("refused-crowd"), 33))))


def _checksums(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="checksum-unchecked")
    for base, before, part in (
        (plain, "", "position"),
        (plain, "", "mask"),
        (plain, "", "attribute"),
        (packed, "packed-", "position"),
    ):
        title = f"the CRC-32 of chunk 1 of the {part}s does not match"
        add(f"malformed-chunk-crc-{before}{part}s", title, crc.of(base, 1, part, 1))
    title = "the CRC-32 of the last chunk's attributes does not match"
    add("malformed-chunk-crc-last", title, crc.of(plain, 2, "attribute", 0x80))
    book.add(
        "malformed-chunk-of-65536-anchors",
        "a packed chunk of as many anchors as there can be, and a wrong CRC-32 behind it",
        crc_behind_many_anchors.of(main_file),
        features="packed-positions chunks main",
        requirements="D7.12-1",
        flags="count-in-16-bits",
    )


def _models(book: Book) -> None:
    for number, value in ((0, 0), (2, 1 << 14), (1, 65535)):
        title, make = f"a frequency of {value} in the mask model", mask_model.of(plain, number, value)
        book.add(f"invalid-mask-model-{value}", title, make, features="masks", flags="limit-off-by-one")
    add = partial(book.add, features="packed-positions", flags="position-model limit-off-by-one")
    for name, title, make in (
        ("sum-more", "frequencies that add up to one more", frequencies.of(packed, 0, {None: 1})),
        ("sum-less", "frequencies that add up to one less", frequencies.of(packed, 17, {None: -1})),
        ("zero", "a frequency of 0", no_frequency.of(packed, 6, 9)),
        ("zero-after-none", "a frequency of 0 after no children, not of symbol 0", no_frequency.of(packed, 7, 9)),
        (
            "empty-node",
            "a frequency above 0 for a node without children",
            frequencies.of(packed, 13, {None: -1, 0: 1}),
        ),
        ("no-first-half", "a frequency of 0 for no children in the first half", no_frequency.of(packed, 12, 0)),
        # The sum is right modulo 2^16.
        ("sum-wraps", "frequencies that add up modulo 2^16", frequencies.of(packed, 2, {3: 32768, 4: 32768})),
    ):
        add(f"invalid-position-model-{name}", title, make)
    title, make = "cell_shift 41", cell_shift.of(packed, 41)
    flags = "limit-off-by-one shift-overflow"
    book.add("invalid-cell-shift-41", title, make, features="packed-positions", flags=flags)


def _valid(book: Book) -> None:
    for size, anchors, title in (
        (1, 4, "chunks of one anchor"),
        (3, 7, "the last chunk is shorter than the others"),
        (4, 8, "all chunks are full"),
        (65536, 5, "a chunk that could hold more than there is"),
    ):
        book.valid(
            f"chunks-of-{size}",
            title,
            partial(drawn, f"chunks-{size}", anchors, chunk_size=size),
            features="chunks",
            requirements="D7.6-1 D7.10-1",
            flags="last-chunk",
        )
    book.valid(
        "chunks-packed",
        "chunks of seven anchors, packed",
        _packed,
        features="chunks packed-positions packed-weights",
        requirements="D7.12-1 D7.13-1",
        flags="last-chunk",
    )
    book.valid(
        "cells-short-chunk",
        "a last chunk of one anchor, in fewer bytes than a sixteenth of chunk_size",
        _short,
        features="packed-positions chunks",
        requirements="R6.10-2",
        flags="last-chunk",
    )
    book.valid(
        "empty",
        "no anchors, and no chunks",
        partial(scene, "empty", 0),
        features="empty",
        requirements="D7.3-1",
        flags="empty-refused",
    )
    book.valid(
        "empty-packed",
        "no anchors, in mode 1 of positions and weights",
        _empty_packed,
        features="empty packed-positions packed-weights",
        requirements="D7.13-1",
        flags="empty-refused",
    )


def _packed() -> Scene:
    where = lattice(Numbers("packed-chunks"), 50)
    made = drawn("packed-chunks", 50, positions=where, chunk_size=7, lanes=Lanes(0, 0, 0))
    return packed_weights(replace(made, position_model=position_model(where, 7)))


def _short() -> Scene:
    # The last chunk is one anchor, and has far fewer bytes than a sixteenth of the others' anchors.
    zero = np.zeros(SMALLEST.attribute_width, np.int64)
    networks = constant(SMALLEST, Numbers("outside-short"), zero, zero - 40)
    where, masks = lattice(Numbers("outside-short"), 601), np.zeros((601, 1), bool)
    made = placed("outside-short", where, chunk_size=600, networks=networks, masks=masks, lanes=Lanes(0, 0, 0))
    made = with_symbols(made, features=np.zeros((601, 1)), scalings=np.zeros((601, 6)), offsets=np.zeros((601, 1, 3)))
    t = Target(codec.emit(made))
    start, end = t.part(POSITIONS, 1)
    assert [len(chunk) for chunk in t.header.chunks] == [600, 1]
    assert ANCHORS_OF_A_BYTE * (end - start) < made.chunk_size
    return made


def _empty_packed() -> Scene:
    made = scene("empty-packed", 0)
    return packed_weights(replace(made, position_model=position_model(made.positions, 4096)))
