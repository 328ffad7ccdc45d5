"""Cases of clauses 5.14 and 6.11: chunks, their heads, and their entries.

The positions of a chunk are in positions.py, its masks and attributes in masks.py and attributes.py, and valid files
with several chunks in chunk_sizes.py.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.chunks import PARTS, emit_chunk
from refcodec.bitstream.directory import DATA, INDEX
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import PACKED, encode_positions
from refcodec.bitstream.scene import Scene

from .book import Book
from .cells import any_model, cuboid, of_cells, placed
from .checksums import Depth, repair, resized
from .fault import Draw, Drawn, Edit, Refused, Whole, fault, one_field
from .numbers import Numbers
from .scenes import MAIN_SMALLEST, lattice, packed_weights, scene, settled, silent
from .target import Target
from .targets import far, five_cells, packed, plain

# SPEC 5.14: the names of the parts' lengths in heads.
LENGTHS = {part: f"{part.removesuffix('s')}_length" for part in PARTS}


def _chunk(draw: Draw, t: Target) -> int | None:
    """Draws one of the chunks, if there are any."""
    return draw.integer(0, t.header.chunk_count - 1) if t.header.chunk_count else None


def _padding(t: Target, part: str, chunk: int) -> tuple[int, int]:
    """Returns the range of the padding after a part."""
    _, end = t.part(part, chunk)
    return end, end + -end % 4


# --- faults of the chunk's bytes --------------------------------------------------------------------------------------


@fault("section.truncated")
def cut_in_chunk(t: Target, chunk: int, more: int) -> Whole:
    """The file ends within a chunk. more: present bytes of the chunk; -1 is all but the last."""
    start = t.chunk_at(chunk)
    end = range(start, start + t.value(f"index.entry[{chunk}].length"))[more]
    return Whole(t.data[:end], end)


@cut_in_chunk.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, chunk, draw.integer(0, t.value(f"index.entry[{chunk}].length") - 1))


@fault("chunk.crc")
def crc(t: Target, chunk: int, bits: int) -> Edit:
    """Bits of a chunk's CRC-32 are flipped."""
    return Edit(t.flip(t.at(f"index.entry[{chunk}].crc"), bits), t.chunk_at(chunk), Depth.SECTIONS)


@crc.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, chunk, draw.integer(1, 255))


@fault("chunk.crc")
def byte(t: Target, chunk: int, at: int, bits: int) -> Edit:
    """Bits of a byte of a chunk are flipped, without its CRC-32. at: -1 is the last byte."""
    start = t.chunk_at(chunk)
    place = range(start, start + t.value(f"index.entry[{chunk}].length"))[at]
    return Edit(t.flip(place, bits), start, Depth.SECTIONS)


@byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    if chunk is None:
        return None
    return t, chunk, draw.integer(0, t.value(f"index.entry[{chunk}].length") - 1), draw.integer(1, 255)


# --- faults of heads --------------------------------------------------------------------------------------------------


@fault("chunk.reserved")
def reserved(t: Target, chunk: int, item: int, value: int) -> Edit:
    """A reserved byte of a chunk's head is not zero. The first of these bytes is reported."""
    path = f"chunk[{chunk}].reserved"
    return Edit(t.pack({f"{path}[{item}]": value}), t.at(f"{path}[0]"))


@reserved.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, chunk, draw.integer(0, 2), draw.integer(1, 255))


@fault("chunk.form")
def form(t: Target, chunk: int, value: int) -> Edit:
    """An unknown form, or the packed form without a model of positions."""
    return one_field(t, f"chunk[{chunk}].position_form", value)


@form.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, chunk, draw.integer(1 + t.sections[INDEX].mode, 255))


@fault("chunk.length")
def lengths(t: Target, chunk: int, changes: dict[str, int]) -> Edit:
    """Parts that do not fill the chunk, or raw positions with a length other than six bytes per anchor.

    changes: added to the lengths of parts, modulo 2^32. With padding, lengths are multiples of four.
    """
    paths = {f"chunk[{chunk}].{LENGTHS[part]}": more for part, more in changes.items()}
    values = {path: (t.value(path) + more) % (1 << 32) for path, more in paths.items()}
    return Edit(t.pack(values), t.chunk_at(chunk))


@lengths.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    if chunk is None:
        return None
    part = draw.choice(PARTS)
    old = t.value(f"chunk[{chunk}].{LENGTHS[part]}")
    return t, chunk, {part: draw.choice([4, -4, 1 << 31, -old, 0xFFFFFFFF - old])}


@fault("chunk.length")
def bytes_behind(t: Target, chunk: int, content: bytes) -> Whole:
    """Additional bytes after the parts of a chunk. content: a multiple of four bytes."""
    start, old = t.chunk_at(chunk), t.value(f"index.entry[{chunk}].length")
    own = t.data[start : start + old]
    return Whole(with_chunk(t, chunk, own + content), start)


@bytes_behind.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, chunk, draw.content(4, 4))


def with_chunk(t: Target, chunk: int, content: bytes) -> bytes:
    """Returns the file with other bytes as one chunk, a multiple of four, and right lengths and checksums."""
    path = f"index.entry[{chunk}].length"
    start, base, old = t.chunk_at(chunk), t.start(DATA), t.value(path)
    out = t.with_values({path: len(content)}, Depth.NOTHING)
    whole = t.content(DATA)
    return resized(out, DATA, whole[: start - base] + content + whole[start - base + old :])


@fault("chunk.padding")
def padding(t: Target, chunk: int, part: str, at: int, value: int) -> Edit:
    """A byte of the padding after a part is not zero."""
    start, _ = _padding(t, part, chunk)
    return Edit({start + at: bytes([value])}, start)


@padding.drawn
def _(draw: Draw, t: Target) -> Drawn:
    places = [(n, part) for n in range(t.header.chunk_count) for part in PARTS]
    padded = [(n, part) for n, part in places if range(*_padding(t, part, n))]
    chunk, part = draw.choice(padded)
    return t, chunk, part, draw.integer(0, len(range(*_padding(t, part, chunk))) - 1), draw.integer(1, 255)


@fault("chunk.padding")
def last_byte(t: Target, chunk: int, part: str) -> Edit:
    """A length that makes the last byte of a part, which is not zero, a padding byte."""
    start, end = t.part(part, chunk)
    assert (end - start) % 4 != 1
    assert t.data[end - 1]
    return Edit(t.pack({f"chunk[{chunk}].{LENGTHS[part]}": end - start - 1}), end - 1)


@last_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    # The length of raw positions is known, and is checked first.
    substreams = [
        (n, part) for n in range(t.header.chunk_count) for part in PARTS if f"{part}[chunk {n}]" in t.substreams
    ]
    places = [(n, part, *t.part(part, n)) for n, part in substreams]
    right = [(n, part) for n, part, start, end in places if (end - start) % 4 != 1 and t.data[end - 1]]
    return t, *draw.choice(right)


# --- faults of entries that a chunk tells -----------------------------------------------------------------------------


@fault("chunk.bounds")
def bound(t: Target, chunk: int, field: str, up: bool) -> Edit:
    """A bound is one number above or below the right one. field: such as `low[0]`."""
    path = f"index.entry[{chunk}].{field}"
    old = np.array([t.value(path)], np.float16)
    new = np.nextafter(old, np.float16(np.inf if up else -np.inf))
    # The next number may be -0, which a bound cannot be.
    return Edit({t.at(path): (new + np.float16(0)).tobytes()}, t.chunk_at(chunk))


@bound.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    if chunk is None:
        return None
    axis, name = draw.integer(0, 2), draw.choice(["low", "high"])
    low, high = (t.value(f"index.entry[{chunk}].{side}[{axis}]") for side in ("low", "high"))
    # A tighter bound needs room between low and high, a looser one a finite number.
    up = draw.flag() if low < high else name == "high"
    value, end = (low if name == "low" else high), float(np.finfo(np.float16).max)
    return None if value == (end if up else -end) else (t, chunk, f"{name}[{axis}]", up)


@fault("chunk.kept")
def kept_count(t: Target, chunk: int, value: int) -> Edit:
    """A wrong number of kept offsets."""
    return Edit(t.pack({f"index.entry[{chunk}].kept_count": value}), t.chunk_at(chunk))


@kept_count.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    if chunk is None:
        return None
    entry = f"index.entry[{chunk}]"
    most, old = t.header.dimensions.offset_count * t.value(f"{entry}.anchor_count"), t.value(f"{entry}.kept_count")
    return (
        t,
        chunk,
        draw.choice([value for value in {0, most, old - 1, old + 1} if value != old and 0 <= value <= most]),
    )


# --- the suite's refused files ----------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _bytes(book)
    _heads(book)
    _lengths(book)
    _entries(book)


def _bytes(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="truncation")
    for name, title, chunk, more in (
        ("before", "the file ends where chunk 1 would begin", 1, 0),
        ("in-head", "the file ends within the head of chunk 0", 0, 15),
        ("in-positions", "the file ends within the positions of chunk 1", 1, 20),
        ("last-byte", "the file ends before the last byte of the last chunk", 2, -1),
    ):
        add(f"malformed-chunk-cut-{name}", title, cut_in_chunk.of(plain, chunk, more))
    add = partial(book.add, features="chunks", flags="checksum-unchecked")
    for name, title, base, chunk, bits in (
        ("first", "the CRC-32 of the first chunk does not match", plain, 0, 1),
        ("last", "the CRC-32 of the last chunk does not match", plain, 2, 0x80),
        ("packed", "the CRC-32 of a packed chunk does not match", packed, 1, 1),
    ):
        add(f"malformed-chunk-crc-{name}", title, crc.of(base, chunk, bits))
    for name, title, chunk, at in (
        ("head", "a bit of a chunk's head is turned", 1, 12),
        ("positions", "a bit of a chunk's positions is turned", 1, 17),
        ("end", "a bit of a chunk's last byte is turned", 2, -1),
    ):
        add(f"malformed-chunk-byte-{name}", title, byte.of(plain, chunk, at, 4))


def _heads(book: Book) -> None:
    add = partial(book.add, features="chunks")
    places: list[tuple[str, Callable[[], Target], int, int]] = [
        ("first", plain, 0, 0),
        ("last", plain, 2, 2),
        ("packed", packed, 1, 1),
    ]
    for name, base, chunk, item in places:
        title, make = f"a reserved byte of a chunk is not zero: {name}", reserved.of(base, chunk, item, 1)
        add(f"unsupported-chunk-reserved-{name}", title, make, flags="reserved-unchecked")
    for name, title, base, chunk, value in (
        ("1-without-model", "a packed chunk, and no model of positions", plain, 1, 1),
        ("2", "a chunk of form 2", five_cells, 0, 2),
        ("2-of-raw-length", "form 2, with as many bytes as a raw chunk has", packed, 2, 2),
        ("255", "a chunk of form 255, and no model of positions", plain, 2, 255),
    ):
        add(f"malformed-chunk-form-{name}", title, form.of(base, chunk, value), flags="form-unchecked")
    rows: list[tuple[str, Callable[[], Target], int, str, int]] = [
        ("positions", plain, 2, "positions", 0),
        ("positions-last-byte", plain, 2, "positions", 1),
        ("attributes", plain, 0, "attributes", 1),
        ("packed-positions", _odd_positions, 0, "positions", 0),
        ("masks", _odd_masks, 0, "masks", 0),
    ]
    for name, base, chunk, part, at in rows:
        title, make = f"padding behind a chunk's part that is not zero: {name}", padding.of(base, chunk, part, at, 1)
        add(f"malformed-chunk-padding-{name}", title.replace("-", ", "), make, flags="padding-unchecked")
    for base, part in ((packed, "positions"), (plain, "attributes")):
        title, make = f"the last byte of the {part} is where padding should be", last_byte.of(base, 0, part)
        add(f"malformed-chunk-padding-of-{part}", title, make, flags="padding-unchecked lengths-trusted")


@cache
def _odd_positions() -> Target:
    """Returns a file of one packed chunk with padding after its positions."""
    return _padded("positions", lambda n: placed(f"refused-odd-positions-{n}", lattice(Numbers("odd"), 5 + n)))


@cache
def _odd_masks() -> Target:
    """Returns a file of one chunk with padding after its masks."""
    return _padded("masks", lambda n: scene(f"refused-odd-masks-{n}", 8 + n, lanes=Lanes(0, 0, 0)))


def _padded(part: str, make: Callable[[int], Scene]) -> Target:
    """Returns the first of several files whose first chunk has padding after a part."""
    found = (Target(codec.emit(make(n))) for n in range(20))
    return next(t for t in found if range(*_padding(t, part, 0)))


def _lengths(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="lengths-trusted")
    rows: list[tuple[str, str, Callable[[], Target], int, dict[str, int]]] = [
        ("positions-more", "parts of four bytes more than the chunk", plain, 1, {"positions": 4}),
        ("masks-less", "parts of four bytes less than the chunk", plain, 0, {"masks": -4}),
        ("attributes-huge", "an attribute_length of 2^31 more", plain, 2, {"attributes": 1 << 31}),
        ("packed", "parts of a packed chunk of four bytes more than it has", packed, 3, {"positions": 4}),
        ("raw-one-less", "raw positions of one byte less than six an anchor", plain, 2, {"positions": -1}),
        ("raw-one-more", "raw positions of one byte more than six an anchor", plain, 2, {"positions": 1}),
        (
            "raw-longer",
            "raw positions of four bytes more than six an anchor, and masks of four less",
            plain,
            1,
            {"positions": 4, "masks": -4},
        ),
        (
            "raw-shorter",
            "raw positions of four bytes less than six an anchor, and masks of four more",
            plain,
            0,
            {"positions": -4, "masks": 4},
        ),
        (
            "raw-in-mode-1",
            "raw positions of two bytes more than six an anchor, in a file with a model",
            packed,
            2,
            {"positions": 2},
        ),
    ]
    for name, title, base, chunk, changes in rows:
        add(f"malformed-chunk-lengths-{name}", title, lengths.of(base, chunk, changes))
    add = partial(book.add, features="chunks", flags="lengths-trusted sum-wraps")
    make = lengths.of(plain, 1, {"masks": 1 << 31, "attributes": 1 << 31})
    add("malformed-chunk-lengths-wrap", "lengths that fill the chunk modulo 2^32", make)
    title = "a length that is 0 modulo 2^32 with its padding, and one that makes good for it"
    add("malformed-chunk-lengths-padding-wraps", title, _padding_wraps)
    for name, chunk, title in (
        ("behind", 1, "four bytes behind the attributes of a chunk"),
        ("behind-last", 2, "four bytes behind the attributes of the last chunk"),
    ):
        make = bytes_behind.of(plain, chunk, bytes(4))
        book.add(
            f"malformed-chunk-bytes-{name}",
            title,
            make,
            features="chunks",
            flags="lengths-trusted canonical-form",
        )


def _padding_wraps() -> Refused:
    t = plain()
    old = t.value("chunk[0].mask_length")
    return lengths(t, 0, {"masks": -old - 1, "attributes": old})


def _entries(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="entry-unchecked")
    rows: list[tuple[str, str, Callable[[], Target], int, str, bool]] = [
        ("low-lower", "low of the first axis is the next number below the positions", plain, 0, "low[0]", False),
        ("low-higher", "low of the second axis is the next number above the least position", plain, 1, "low[1]", True),
        ("high-higher", "high of the last axis is the next number above the positions", plain, 2, "high[2]", True),
        (
            "high-lower",
            "high of the first axis is the next number below the largest position",
            plain,
            1,
            "high[0]",
            False,
        ),
        ("packed", "high of a packed chunk is the next number above its positions", packed, 1, "high[1]", True),
        ("packed-low", "low of a packed chunk is the next number below its positions", packed, 3, "low[2]", False),
        ("one-anchor", "high is above the position of the one anchor", partial(far, 0), 0, "high[1]", True),
    ]
    for name, title, base, chunk, field, up in rows:
        add(
            f"invalid-chunk-bounds-{name}", title, bound.of(base, chunk, field, up), flags="entry-unchecked half-limits"
        )
    title = "the bounds of a chunk that are those of the whole scene"
    add("invalid-chunk-bounds-of-scene", title, bounds_of_scene.of(plain, 1))
    for name, title, base, chunk, value in (
        ("one-more", "a kept_count that is one more than the masks keep", plain, 1, 6),
        ("one-less", "a kept_count that is one less than the masks keep", plain, 2, 2),
        ("none", "a kept_count of 0, and masks that keep offsets", plain, 0, 0),
        ("all", "a kept_count of all offsets, and masks that drop some", packed, 1, 6),
    ):
        add(f"invalid-chunk-kept-{name}", title, kept_count.of(base, chunk, value))
    book.add(
        "invalid-chunk-of-16384-anchors",
        "a packed chunk of as many anchors as there can be, and bounds that are not those of its positions",
        bounds_of_many,
        features="packed-positions chunks main",
        requirements="D7.12-1 R11.1-3",
        flags="buffer-too-small entry-unchecked",
    )


@fault("chunk.bounds")
def bounds_of_scene(t: Target, chunk: int) -> Edit:
    """A chunk has the bounds of all chunks."""
    fields = [f"{name}[{axis}]" for name in ("low", "high") for axis in range(3)]
    values = {}
    for field in fields:
        every = [t.value(f"index.entry[{c}].{field}") for c in range(t.header.chunk_count)]
        values[f"index.entry[{chunk}].{field}"] = min(every) if field.startswith("low") else max(every)
    assert any(t.value(path) != value for path, value in values.items())
    return Edit(t.pack(values), t.chunk_at(chunk))


def bounds_of_many() -> Refused:
    """A file of profile Main with one packed chunk of 16384 anchors. Nothing after its positions is decoded."""
    made = scene("refused-many", 1, MAIN_SMALLEST, chunk_size=16384)
    model = replace(any_model(Numbers("outside-crowd")), cell_shift=20)
    networks = {name: silent(layers) for name, layers in made.networks.items()}
    networks["sarm"][-1][1][1] = -40
    made = replace(made, networks=networks, planes=np.zeros_like(made.planes), position_model=model)
    t = Target(codec.emit(packed_weights(settled(made))))
    where = of_cells(cuboid(16, 32, 32), 20)
    ((chosen, part),) = encode_positions(model, where, [len(where)], 1 << t.header.lanes.mask)
    assert chosen == PACKED
    nothing = bytes(4)
    content = emit_chunk(PACKED, (part, nothing, nothing))
    # Only the least coordinate of the entry is wrong.
    low, high = where.min(axis=0), where.max(axis=0)
    low[2] = np.nextafter(low[2], np.float16(-1))
    at = t.at("index.entry[0].length")
    entry = struct.pack("<4I", len(content), 0, len(where), 0) + low.tobytes() + high.tobytes()
    data = t.put(at, entry)
    at = t.at("header.anchor_count")
    data = data[:at] + struct.pack("<I", len(where)) + data[at + 4 :]
    return Refused(resized(repair(data), DATA, content), "chunk.bounds", t.start(DATA))
