"""Cases of clauses 5.10, 6.9 and 7.3: sub-planes. The faults of their substreams are in entropy_substreams.py."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.directory import PLANES_SECTION
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.planes import PLANE_NAMES, PLANES
from refcodec.bitstream.scene import Scene

from .book import Book
from .checksums import resized
from .fault import Draw, Drawn, Edit, Refused, Whole, fault
from .numbers import Numbers
from .samplers import Sampler, sampled
from .scenes import SMALLEST, TINY_DIMENSIONS, networks, scene, with_symbols
from .target import Target
from .targets import plain


@fault("planes.length")
def cut_in_table(t: Target, length: int) -> Whole:
    """The section ends within or after its table."""
    return Whole(resized(t.data, PLANES_SECTION, t.content(PLANES_SECTION)[:length]), t.start(PLANES_SECTION))


@cut_in_table.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (t, draw.integer(0, 4 * PLANES)) if PLANES_SECTION in t.sections else None


@fault("planes.length")
def sub_plane_lengths(t: Target, changes: dict[int, int]) -> Edit:
    """The sum of the lengths is not that of the section. changes: numbers to add modulo 2^32, by sub-plane.

    With padding, lengths are multiples of four bytes.
    """
    values = {f"planes.length[{n}]": (t.value(f"planes.length[{n}]") + more) % (1 << 32) for n, more in changes.items()}
    return Edit(t.pack(values), t.start(PLANES_SECTION))


@sub_plane_lengths.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if PLANES_SECTION not in t.sections:
        return None
    plane = draw.integer(0, PLANES - 1)
    if draw.flag():
        return t, {plane: draw.choice([4, -4, 1 << 31])}
    # The sum is right modulo 2^32.
    return t, {plane: 1 << 31, (plane + 1) % PLANES: 1 << 31}


@fault("planes.length")
def last_padding(t: Target, less: int) -> Whole:
    """The section ends within the padding of its last substream. less: missing bytes."""
    content = t.content(PLANES_SECTION)
    padding = t.element(_padding(PLANES - 1))
    assert 0 < less <= padding.end - padding.start
    return Whole(resized(t.data, PLANES_SECTION, content[:-less]), t.start(PLANES_SECTION))


@last_padding.drawn
def _(draw: Draw, t: Target) -> Drawn:
    row = t.elements.get(_padding(PLANES - 1))
    return None if row is None else (t, draw.integer(1, row.end - row.start))


@fault("planes.padding")
def padding(t: Target, plane: int, at: int, value: int) -> Edit:
    """A byte of the padding after a substream is not zero."""
    start = t.at(_padding(plane))
    return Edit({start + at: bytes([value])}, start)


@padding.drawn
def _(draw: Draw, t: Target) -> Drawn:
    padded = [n for n in range(PLANES) if _padding(n) in t.elements]
    plane = draw.choice(padded)
    row = t.element(_padding(plane))
    return t, plane, draw.integer(0, row.end - row.start - 1), draw.integer(1, 255)


def _padding(plane: int) -> str:
    """Returns the path of the padding after a substream."""
    return f"planes.{PLANE_NAMES[plane]}, padding"


@cache
def _without_anchors() -> Target:
    return Target(codec.emit(scene("planted-empty", 0, SMALLEST)))


def add(book: Book) -> None:
    """Adds the vectors."""
    title = "a section of planes that ends within its table"
    book.add("malformed-planes-cut", title, cut_in_table.of(plain, 19), features="planes", flags="truncation")
    title, make = "three bytes of planes, and few bytes behind them", cut_in_table.of(_without_anchors, 3)
    book.add("malformed-planes-of-3-bytes", title, make, features="planes empty", flags="truncation")
    title, make = "a section of planes of the table's length", cut_in_table.of(plain, 20)
    book.add("malformed-planes-of-table", title, make, features="planes", flags="truncation lengths-trusted")
    for number, change, name in ((0, 4, "four-more"), (4, -4, "four-less"), (2, 1 << 31, "huge"), (0, 1, "one-more")):
        title = f"the length of sub-plane {number} is {name.replace('-', ' ')}"
        identifier, make = f"malformed-planes-length-{number}-{name}", sub_plane_lengths.of(plain, {number: change})
        book.add(identifier, title, make, features="planes", flags="lengths-trusted")
    title, make = "lengths that add up modulo 2^32", sub_plane_lengths.of(plain, {0: 1 << 31, 1: 1 << 31})
    book.add("malformed-planes-length-wraps", title, make, features="planes", flags="lengths-trusted sum-wraps")
    title, make = "lengths that add up modulo 2^32 with their padding", _padded_to_wrap
    book.add("malformed-planes-padding-wraps", title, make, features="planes", flags="lengths-trusted sum-wraps")
    title, make = "a section that ends before the padding of its last substream", last_padding.of(plain, 2)
    flags = "padding-unchecked canonical-form lengths-trusted"
    book.add("malformed-planes-without-last-padding", title, make, features="planes", flags=flags)
    for plane, at, name in ((1, 0, "second"), (2, 0, "one-byte"), (4, 1, "last")):
        title, make = f"padding behind sub-plane {plane} that is not zero", padding.of(plain, plane, at, 1)
        book.add(f"malformed-planes-padding-{name}", title, make, features="planes", flags="padding-unchecked")
    for name, title, size, channels in (
        ("context", "a context of four neighbours that all count", 9, 2),
        ("square", "many channels", 6, 8),
    ):
        book.valid(
            f"planes-{name}",
            title,
            partial(_neighbours, f"planes-{name}", size, channels),
            features="planes",
            requirements="D7.3-1 D7.3-2",
            flags="wavefront-order context-order",
        )
    book.valid(
        "planes-far",
        "the largest symbols, and neighbours about the largest activation",
        _far,
        features="planes escapes",
        requirements="D7.3-1 R8.5-1 D8.7-1",
        flags="activation-clamp symbol-limit",
    )
    book.valid("planes-zero", "planes of zeros", _zero, features="planes", requirements="D7.3-1")


def _padded_to_wrap() -> Refused:
    """Adds a length of 2^32 - 1, which is 0 in 32 bits with its padding, and one that compensates for it."""
    t = plain()
    first = t.value("planes.length[0]")
    return sub_plane_lengths(t, {0: -first - 1, 1: first})


def _neighbours(name: str, size: int, channels: int) -> Scene:
    d = replace(TINY_DIMENSIONS, plane_size=size, plane_channels=channels, sarm_width=(8,))
    numbers = Numbers(name)
    found = networks(d, numbers)
    # Each neighbour has a different weight, with both signs.
    first = np.concatenate([np.eye(4), -np.eye(4)]).astype(np.float32)
    last = np.array([[5, 7, -3, 4, -5, -7, 3, -4], [0.5, 0.25, -0.5, 0.75, 0.25, 0.5, 0.5, 0.25]], np.float32)
    found["sarm"] = [(first, np.zeros(8, np.float32)), (last, np.array([3, -9], np.float32))]
    return sampled(scene(name, 2, d, networks=found, lanes=Lanes(2, 0, 0)), Sampler(numbers, 0))


def _far() -> Scene:
    values = [32767, -32767, 1023, 1024, -1023, -1024, 0, 1, -1, 16384]
    planes = Numbers("planes-far").chosen(values, 5, 2, 6, 6).astype(np.int16)
    return scene("planes-far", 3, replace(TINY_DIMENSIONS, plane_size=6), planes=planes, plane_shift=0)


def _zero() -> Scene:
    made = scene("planes-zero", 3)
    return with_symbols(replace(made, planes=np.zeros_like(made.planes)))
