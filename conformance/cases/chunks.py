"""Cases of clauses 5.14 and 6.11: chunks, their heads, and their entries.

The positions of a chunk are in positions.py, its masks and attributes in attributes.py.
"""

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.chunks import PARTS, emit_chunk
from refcodec.bitstream.directory import DATA, INDEX
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import PACKED, RAW, encode_positions
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .checksums import Depth, repair, resized
from .directory import cut
from .fault import Draw, Drawn, Edit, Whole, element, fault, padding
from .index import any_chunk
from .numbers import Numbers
from .samplers import drawn, on_lattice
from .scenes import MAIN_SMALLEST, any_model, cheap, cuboid, lattice, of_cells, placed, scene, settled
from .table import More, refused, valid
from .target import Target
from .targets import far, five_cells, packed, plain, target_of
from .weights import ALL, QUIET_SARM, packed_weights, with_weights

# SPEC 5.14: the names of the parts' lengths in heads.
LENGTHS = {part: f"{part.removesuffix('s')}_length" for part in PARTS}


@fault("chunk.crc", any_chunk, (1, 255))
def crc(t: Target, chunk: int, bits: int) -> Edit:
    """Bits of a chunk's CRC-32 are flipped."""
    return Edit(t.flip(t.at(f"index.entry[{chunk}].crc"), bits), t.chunk_at(chunk), Depth.SECTIONS)


@fault("chunk.crc", any_chunk, lambda d, t, n: d.integer(0, t.value(f"index.entry[{n}].length") - 1), (1, 255))
def byte(t: Target, chunk: int, at: int, bits: int) -> Edit:
    """Bits of a byte of a chunk are flipped, without its CRC-32. at: -1 is the last byte."""
    start = t.chunk_at(chunk)
    place = range(start, start + t.value(f"index.entry[{chunk}].length"))[at]
    return Edit(t.flip(place, bits), start, Depth.SECTIONS)


reserved = element("chunk.reserved", "chunk[{}].reserved[{}]", any_chunk, (0, 2), (1, 255))
# An unknown form, or the packed form without a model of positions.
form = element(
    "chunk.form", "chunk[{}].position_form", any_chunk, lambda d, t, _: d.integer(1 + t.sections[INDEX].mode, 255)
)


def _changes(draw: Draw, t: Target, chunk: int) -> dict[str, int]:
    part = draw.choice(PARTS)
    old = t.value(f"chunk[{chunk}].{LENGTHS[part]}")
    return {part: draw.choice([4, -4, 1 << 31, -old, 0xFFFFFFFF - old])}


@fault("chunk.length", any_chunk, _changes)
def lengths(t: Target, chunk: int, changes: dict[str, int]) -> Edit:
    """Parts that do not fill the chunk, or raw positions with a length other than six bytes per anchor.

    changes: added to the lengths of parts, modulo 2^32. With padding, lengths are multiples of four.
    """
    paths = {f"chunk[{chunk}].{LENGTHS[part]}": more for part, more in changes.items()}
    values = {path: (t.value(path) + more) % (1 << 32) for path, more in paths.items()}
    return Edit(t.pack(values), t.chunk_at(chunk))


@fault("chunk.length", any_chunk, lambda d, t, _: d.content(4, 4))
def bytes_behind(t: Target, chunk: int, content: bytes) -> Whole:
    """Additional bytes after the parts of a chunk. content: a multiple of four bytes."""
    start, path, whole = t.chunk_at(chunk), f"index.entry[{chunk}].length", t.content(DATA)
    old = t.value(path)
    end = start + old - t.start(DATA)
    out = t.with_values({path: old + len(content)}, Depth.NOTHING)
    return Whole(resized(out, DATA, whole[:end] + content + whole[end:]), start)


padding_byte = padding("chunk.padding", r"(positions|masks|attributes)\[chunk \d+\], padding")


def _ends(draw: Draw, t: Target) -> Drawn:
    # The length of raw positions is known, and is checked first.
    places = [(n, part) for n in range(t.header.chunk_count) for part in PARTS if f"{part}[chunk {n}]" in t.substreams]
    spans = [(n, part, *t.part(part, n)) for n, part in places]
    return draw.choice([(n, part) for n, part, start, end in spans if (end - start) % 4 != 1 and t.data[end - 1]])


@fault("chunk.padding", _ends)
def last_byte(t: Target, chunk: int, part: str) -> Edit:
    """A length that makes the last byte of a part, which is not zero, a padding byte."""
    start, end = t.part(part, chunk)
    assert (end - start) % 4 != 1
    assert t.data[end - 1]
    return Edit(t.pack({f"chunk[{chunk}].{LENGTHS[part]}": end - start - 1}), end - 1)


def _bounds(draw: Draw, t: Target) -> Drawn:
    chunk, axis, name = any_chunk(draw, t), draw.integer(0, 2), draw.choice(["low", "high"])
    low, high = (t.value(f"index.entry[{chunk}].{side}[{axis}]") for side in ("low", "high"))
    # A tighter bound needs room between low and high, a looser one a finite number.
    up = draw.flag() if low < high else name == "high"
    value, end = (low if name == "low" else high), float(np.finfo(np.float16).max)
    return draw.choice([] if value == (end if up else -end) else [(chunk, f"{name}[{axis}]", up)])


@fault("chunk.bounds", _bounds)
def bound(t: Target, chunk: int, field: str, up: bool) -> Edit:
    """A bound is one number above or below the right one. field: such as `low[0]`."""
    path = f"index.entry[{chunk}].{field}"
    old = np.array([t.value(path)], np.float16)
    new = np.nextafter(old, np.float16(np.inf if up else -np.inf))
    # The next number may be -0, which a bound cannot be.
    return Edit({t.at(path): (new + np.float16(0)).tobytes()}, t.chunk_at(chunk))


@fault("chunk.bounds")
def bounds_of_scene(t: Target, chunk: int) -> Edit:
    """A chunk has the bounds of all chunks."""
    values = {}
    for field in (f"{name}[{axis}]" for name in ("low", "high") for axis in range(3)):
        every = [t.value(f"index.entry[{c}].{field}") for c in range(t.header.chunk_count)]
        values[f"index.entry[{chunk}].{field}"] = min(every) if field.startswith("low") else max(every)
    assert any(t.value(path) != value for path, value in values.items())
    return Edit(t.pack(values), t.chunk_at(chunk))


@fault("chunk.bounds")
def bounds_of_many(t: Target) -> Whole:
    """The one chunk has 16384 packed anchors, and a wrong bound. Nothing after its positions is decoded."""
    model = codec.parse(t.data).scene.position_model
    where = of_cells(cuboid(16, 32, 32), 20)
    assert model is not None
    ((chosen, part),) = encode_positions(model, where, [len(where)], 1 << t.header.lanes.mask)
    assert chosen == PACKED
    nothing = bytes(4)
    content = emit_chunk(PACKED, (part, nothing, nothing))
    # Only the least coordinate of the entry is wrong.
    low, high = where.min(axis=0), where.max(axis=0)
    low[2] = np.nextafter(low[2], np.float16(-1))
    entry = struct.pack("<4I", len(content), 0, len(where), 0) + low.tobytes() + high.tobytes()
    data = bytearray(t.put(t.at("index.entry[0].length"), entry))
    struct.pack_into("<I", data, t.at("anchor_count"), len(where))
    return Whole(resized(repair(bytes(data)), DATA, content), t.start(DATA))


def _kept(draw: Draw, t: Target, chunk: int) -> int:
    entry = f"index.entry[{chunk}]"
    most, old = t.header.dimensions.offset_count * t.value(f"{entry}.anchor_count"), t.value(f"{entry}.kept_count")
    return draw.choice([value for value in {0, most, old - 1, old + 1} if value != old and 0 <= value <= most])


kept_count = element("chunk.kept", "index.entry[{}].kept_count", any_chunk, _kept, reported=Target.chunk_at)


def _padded(part: str, make: Callable[[int], Scene]) -> Callable[[], Target]:
    """Returns a function that returns the first of several files whose first chunk has padding after a part."""

    def first() -> Target:
        files = (Target(codec.emit(make(n))) for n in range(20))
        return next(t for t in files if t.has(f"{part}[chunk 0], padding"))

    return first


# Files of one chunk with padding after its packed positions, and after its masks.
_odd_positions = _padded("positions", lambda n: placed(f"refused-odd-positions-{n}", lattice(Numbers("odd"), 5 + n)))
_odd_masks = _padded("masks", lambda n: scene(f"refused-odd-masks-{n}", 8 + n, lanes=Lanes(0, 0, 0)))


@target_of
def _many() -> Scene:
    """A file of profile Main that can have 16384 anchors in a packed chunk."""
    model = replace(any_model(Numbers("outside-crowd")), cell_shift=20)
    made = with_weights(scene("refused-many", 1, MAIN_SMALLEST, chunk_size=16384), ("*", ALL, 0, 0), QUIET_SARM[-1])
    return packed_weights(settled(replace(made, planes=np.zeros_like(made.planes), position_model=model)))


def _short() -> Scene:
    made = cheap("outside-short", cuboid(5, 11, 11)[:601], chunk_size=600)
    assert Target(codec.emit(made)).header.chunk_count == 2
    return made


def _chosen(*forms: int) -> Scene:
    where = lattice(Numbers("chunks-chosen"), 15)
    return placed("chunks-chosen", where, position_model(where, 4), chunk_size=4, position_forms=forms)


# fmt: off
CASES = [
    *refused("chunks", "truncation", (cut,),
        ("chunk-cut-before", "the file ends where chunk 1 would begin", lambda t: t.chunk_at(1)),
        ("chunk-cut-in-head", "the file ends within the head of chunk 0", lambda t: t.chunk_at(0) + 15),
        ("chunk-cut-in-positions", "the file ends within the positions of chunk 1", lambda t: t.chunk_at(1) + 20),
        ("chunk-cut-last-byte", "the file ends before the last byte of the last chunk", lambda t: t.chunk_at(3) - 1)),
    *refused("chunks", "checksum-unchecked",
        ("chunk-crc-first", "the CRC-32 of the first chunk does not match", crc, 0, 1),
        ("chunk-crc-last", "the CRC-32 of the last chunk does not match", crc, 2, 0x80),
        ("chunk-crc-packed", "the CRC-32 of a packed chunk does not match", packed, crc, 1, 1),
        ("chunk-byte-head", "a bit of a chunk's head is turned", byte, 1, 12, 4),
        ("chunk-byte-positions", "a bit of a chunk's positions is turned", byte, 1, 17, 4),
        ("chunk-byte-end", "a bit of a chunk's last byte is turned", byte, 2, -1, 4)),
    *refused("chunks", "reserved-unchecked", *(
        (f"chunk-reserved-{name}", f"a reserved byte of a chunk is not zero: {name}", base, reserved, chunk, item, 1)
        for name, base, chunk, item in (("first", plain, 0, 0), ("last", plain, 2, 2), ("packed", packed, 1, 1)))),
    *refused("chunks", "form-unchecked",
        ("chunk-form-1-without-model", "a packed chunk, and no model of positions", form, 1, 1),
        ("chunk-form-2", "a chunk of form 2", five_cells, form, 0, 2),
        ("chunk-form-2-of-raw-length", "form 2, with as many bytes as a raw chunk has", packed, form, 2, 2),
        ("chunk-form-255", "a chunk of form 255, and no model of positions", form, 2, 255)),
    *refused("chunks", "padding-unchecked",
        *((f"chunk-padding-{name}", f"padding behind a chunk's part that is not zero: {name.replace('-', ', ')}", base,
           padding_byte, f"{part}[chunk {chunk}], padding", at, 1)
          for name, base, part, chunk, at in (
              ("positions", plain, "positions", 2, 0), ("positions-last-byte", plain, "positions", 2, 1),
              ("attributes", plain, "attributes", 0, 1), ("packed-positions", _odd_positions, "positions", 0, 0),
              ("masks", _odd_masks, "masks", 0, 0))),
        *((f"chunk-padding-of-{part}", f"the last byte of the {part} is where padding should be", base, last_byte, 0,
           part, More("lengths-trusted")) for base, part in ((packed, "positions"), (plain, "attributes")))),

    # The lengths of parts.
    *refused("chunks", "lengths-trusted",
        ("chunk-lengths-positions-more", "parts of four bytes more than the chunk", lengths, 1, {"positions": 4}),
        ("chunk-lengths-masks-less", "parts of four bytes less than the chunk", lengths, 0, {"masks": -4}),
        ("chunk-lengths-attributes-huge", "an attribute_length of 2^31 more", lengths, 2, {"attributes": 1 << 31}),
        ("chunk-lengths-packed", "parts of a packed chunk of four bytes more than it has", packed, lengths, 3,
         {"positions": 4}),
        ("chunk-lengths-raw-one-less", "raw positions of one byte less than six an anchor", lengths, 2,
         {"positions": -1}),
        ("chunk-lengths-raw-one-more", "raw positions of one byte more than six an anchor", lengths, 2,
         {"positions": 1}),
        ("chunk-lengths-raw-longer", "raw positions of four bytes more than six an anchor, and masks of four less",
         lengths, 1, {"positions": 4, "masks": -4}),
        ("chunk-lengths-raw-shorter", "raw positions of four bytes less than six an anchor, and masks of four more",
         lengths, 0, {"positions": -4, "masks": 4}),
        ("chunk-lengths-raw-in-mode-1", "raw positions of two bytes more than six an anchor, in a file with a model",
         packed, lengths, 2, {"positions": 2})),
    *refused("chunks", "lengths-trusted sum-wraps", (lengths,),
        ("chunk-lengths-wrap", "lengths that fill the chunk modulo 2^32", 1, {"masks": 1 << 31, "attributes": 1 << 31}),
        ("chunk-lengths-padding-wraps",
         "a length that is 0 modulo 2^32 with its padding, and one that makes good for it", 0,
         lambda t: {"masks": -t.value("chunk[0].mask_length") - 1, "attributes": t.value("chunk[0].mask_length")})),
    *refused("chunks", "lengths-trusted canonical-form",
        ("chunk-bytes-behind", "four bytes behind the attributes of a chunk", bytes_behind, 1, bytes(4)),
        ("chunk-bytes-behind-last", "four bytes behind the attributes of the last chunk", bytes_behind, 2, bytes(4))),

    # Entries that contradict their chunk.
    *refused("chunks", "entry-unchecked half-limits", (bound,),
        ("chunk-bounds-low-lower", "low of the first axis is the next number below the positions", 0, "low[0]", False),
        ("chunk-bounds-low-higher", "low of the second axis is the next number above the least position", 1, "low[1]",
         True),
        ("chunk-bounds-high-higher", "high of the last axis is the next number above the positions", 2, "high[2]",
         True),
        ("chunk-bounds-high-lower", "high of the first axis is the next number below the largest position", 1,
         "high[0]", False),
        (packed, bound),
        ("chunk-bounds-packed", "high of a packed chunk is the next number above its positions", 1, "high[1]", True),
        ("chunk-bounds-packed-low", "low of a packed chunk is the next number below its positions", 3, "low[2]", False),
        (partial(far, 0), bound),
        ("chunk-bounds-one-anchor", "high is above the position of the one anchor", 0, "high[1]", True)),
    *refused("chunks", "entry-unchecked",
        ("chunk-bounds-of-scene", "the bounds of a chunk that are those of the whole scene", bounds_of_scene, 1),
        ("chunk-kept-one-more", "a kept_count that is one more than the masks keep", kept_count, 1, 6),
        ("chunk-kept-one-less", "a kept_count that is one less than the masks keep", kept_count, 2, 2),
        ("chunk-kept-none", "a kept_count of 0, and masks that keep offsets", kept_count, 0, 0),
        ("chunk-kept-all", "a kept_count of all offsets, and masks that drop some", packed, kept_count, 1, 6)),
    *refused("packed-positions chunks main", "buffer-too-small entry-unchecked",
        ("chunk-of-16384-anchors",
         "a packed chunk of as many anchors as there can be, and bounds that are not those of its positions", _many,
         bounds_of_many), requirements="D7.12-1 R11.1-3"),

    # Valid files with chunks of any size, and positions of either form.
    *valid("chunks", "last-chunk", "D7.6-1 D7.10-1", *(
        (f"chunks-of-{size}", title, partial(drawn, f"chunks-{size}", anchors, chunk_size=size))
        for size, anchors, title in (
            (1, 4, "chunks of one anchor"), (3, 7, "the last chunk is shorter than the others"),
            (4, 8, "all chunks are full"), (65536, 5, "a chunk that could hold more than there is")))),
    *valid("chunks", "chunk-sizes last-chunk", "R6.10-5 R6.10-6 R6.2-8 D7.10-1", *(
        (f"chunks-{name}", title, partial(drawn, f"chunks-{name}", sum(counts), chunk_size=size, chunk_anchors=counts))
        for name, size, counts, title in (
            ("uneven", 4, (1, 4, 2, 4, 3), "chunks of one to four anchors, in no order"),
            ("rising", 8, (1, 2, 3, 8), "chunks that are longer one after the other"),
            ("each-anchor", 4096, (1,) * 7, "a chunk for each anchor, though one would hold all"),
            ("halves", 4096, (5, 5), "two chunks that are far from full")))),
    *valid("chunks", "chunk-sizes", "D9.3-1 R6.10-6", *(
        (f"chunks-same-scene-{name.split()[0]}", f"one scene that is coded in {name}: the digest is the same",
         lambda counts=counts: replace(drawn("chunks-same", 9), chunk_size=9, chunk_anchors=counts))
        for name, counts in (("one chunk", (9,)), ("three chunks", (4, 1, 4)), ("nine chunks", (1,) * 9)))),
    *valid("packed-positions chunks", "last-chunk chunk-sizes", "R6.10-5",
        ("cells-short-chunk", "a last chunk of one anchor, in far fewer bytes than the others", _short)),
    *valid("chunks packed-positions packed-weights", "last-chunk", "D7.12-1 D7.13-1",
        ("chunks-packed", "chunks of seven anchors, packed",
         lambda: packed_weights(on_lattice("packed-chunks", 50, 7, chunk_size=7, lanes=Lanes(0, 0, 0))))),
    *valid("chunks packed-positions raw-positions", "raw-chunk canonical-form", "R6.11-3 R6.11-4 D7.12-1", (_chosen,),
        ("chunks-raw-by-choice", "every second chunk raw, all of which could be packed", RAW, PACKED, RAW, PACKED),
        ("chunks-all-raw-by-choice", "all chunks raw, and a model of positions that none of them uses", *[RAW] * 4),
        ("chunks-packed-last", "the last chunk packed, the others raw", RAW, RAW, RAW, PACKED)),
    *valid("chunks packed-positions", "chunk-sizes raw-chunk", "R6.10-5 R6.11-3 D7.12-1",
        ("chunks-uneven-packed", "chunks of one to five anchors, packed but for one",
         partial(on_lattice, "chunks-uneven-packed", 15, 5, chunk_size=5, chunk_anchors=(2, 5, 1, 4, 3),
                 position_forms=(1, 1, 1, 0, 1)))),
]
