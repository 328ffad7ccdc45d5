"""Cases of clauses 5.1 to 5.5 and 6.1 to 6.5: prologue, header, position grid and render information.

Profile, level, dimensions and chunk_size are in limits.py.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import replace
from functools import partial

import numpy as np

from refcodec.bitstream.header import PROLOGUE_BYTES, PositionGrid, RenderInfo

from .book import Book
from .checksums import Depth
from .fault import Draw, Drawn, Edit, Whole, fault, wrong_value
from .scenes import SMALLEST, f16, scene
from .target import Target
from .targets import plain

SMALLEST_F32 = 2.0**-149
LARGEST_F32 = float(np.finfo(np.float32).max)
NAN, INFINITY = math.nan, math.inf
NOT_POSITIVE = [0.0, -1.0, NAN, INFINITY, -INFINITY]


# --- faults of the prologue -------------------------------------------------------------------------------------------


@fault("prologue.truncated")
def cut_in_prologue(t: Target, length: int) -> Whole:
    """The file ends within its prologue."""
    return Whole(t.data[:length], length)


@cut_in_prologue.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, PROLOGUE_BYTES - 1)


@fault("prologue.signature")
def signature_byte(t: Target, at: int, value: int) -> Edit:
    """A byte of the signature is another one."""
    return Edit({at: bytes([value])}, 0)


@signature_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    at = draw.integer(0, 7)
    return t, at, t.data[at] ^ draw.integer(1, 255)


@fault("prologue.crc")
def prologue_byte(t: Target, at: int, bits: int) -> Edit:
    """Bits of the prologue behind the signature are turned, and its CRC-32 is the old one."""
    return Edit(t.flip(at, bits), 16, Depth.NOTHING)


@prologue_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(8, PROLOGUE_BYTES - 1), draw.integer(1, 255)


@fault("prologue.version")
def version(t: Target, value: int) -> Edit:
    """A version that is not 0."""
    return Edit(t.pack({"prologue.version": value}), 8, Depth.PROLOGUE)


@version.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(1, 0xFFFFFFFF)


@fault("prologue.header_length")
def header_length(t: Target, value: int) -> Edit:
    """A header_length that no header can have."""
    return Edit(t.pack({"prologue.header_length": value}), 12, Depth.PROLOGUE)


@header_length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, 3) if draw.flag() else draw.integer(65536, 0xFFFFFFFF)


# --- faults of the header as a whole ----------------------------------------------------------------------------------


@fault("header.truncated")
def cut_in_header(t: Target, left: int) -> Whole:
    """The file ends within its header. left: bytes of the header that are there; -1 is all but the last."""
    length = range(PROLOGUE_BYTES, t.header_end)[left]
    return Whole(t.data[:length], length)


@cut_in_header.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, t.header_end - PROLOGUE_BYTES - 1)


@fault("header.crc")
def header_byte(t: Target, at: int, bits: int) -> Edit:
    """Bits of a byte of the header are turned, and its CRC-32 is the old one.

    at: the byte, from the header's start, or from its end if it is negative.
    """
    return Edit(t.flip(range(PROLOGUE_BYTES, t.header_end)[at], bits), t.header_end - 4, Depth.NOTHING)


@header_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, t.header_end - PROLOGUE_BYTES - 1), draw.integer(1, 255)


@fault("header.syntax")
def fields_cut_or_padded(t: Target, length: int, alone: bool = False) -> Whole:
    """The header ends before its fields do, or there are zeros behind them.

    length: the header's bytes before its CRC-32. alone: the file ends with the header.
    """
    fields = t.data[PROLOGUE_BYTES : t.header_end - 4]
    head = fields[:length].ljust(length, b"\0")
    start = t.data[:12] + (length + 4).to_bytes(4, "little")
    made = start + struct.pack("<I", zlib.crc32(start)) + head + struct.pack("<I", zlib.crc32(head))
    told = PROLOGUE_BYTES + (len(fields) if length > len(fields) else length + 4)
    return Whole(made if alone else made + t.data[t.header_end :], told)


@fields_cut_or_padded.drawn
def _(draw: Draw, t: Target) -> Drawn:
    length = draw.integer(0, fields_length(t) + 40)
    return None if length == fields_length(t) else (t, length, draw.flag())


@fault("header.syntax")
def count_beyond_header(t: Target, path: str, count: int) -> Edit:
    """A list that is longer than the header."""
    return Edit(t.pack({path: count}), t.header_end)


@count_beyond_header.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, "section_count", draw.integer(200, 255)


def fields_length(t: Target) -> int:
    """Bytes of the header's fields but its CRC-32."""
    return t.header_end - 4 - PROLOGUE_BYTES


# --- faults of single fields ------------------------------------------------------------------------------------------

reserved = wrong_value(
    "header.reserved",
    {
        "reserved_0": [1, 255],
        "reserved_1": [1, 128],
        "position_grid.reserved": [1, 255],
        "directory[0].reserved": [1],
        "directory[6].reserved": [65535, 256],
    },
)
lanes = wrong_value("header.lanes", {f"{part}_lanes_log2": [9, 31, 32, 255] for part in ("plane", "mask", "attribute")})
base_step = wrong_value(
    "header.base_step", {f"base_step[{i}]": [0.0, -1.0, 2.0**-61, 2.0**61, NAN, INFINITY] for i in range(3)}
)
position_grid = wrong_value(
    "header.position_grid",
    {
        **{f"position_grid.origin[{i}]": [1 << 62, -(1 << 62), -(1 << 63)] for i in range(3)},
        "position_grid.scale_mantissa": [0],
        "position_grid.scale_exponent": [61, -61, -128, 127],
    },
)
render_info = wrong_value(
    "header.render_info",
    {
        "render_info.up_axis": [6, 255],
        "render_info.near_plane": NOT_POSITIVE,
        "render_info.distance_unit": NOT_POSITIVE,
        "render_info.alpha_max": [*NOT_POSITIVE, 1.0001],
        "render_info.low_pass": NOT_POSITIVE[1:],
        "render_info.camera_width": [0],
        "render_info.camera_height": [0],
        **{f"render_info.camera_focal[{i}]": NOT_POSITIVE for i in range(2)},
        **{f"render_info.camera_rotation[{i}]": NOT_POSITIVE[2:] for i in range(4)},
        **{f"render_info.camera_translation[{i}]": NOT_POSITIVE[2:] for i in range(3)},
    },
    # SPEC 10.2: an item of an array is told by its array.
    told=lambda path: path.partition("[")[0] + "[0]" if "[" in path else path,
)


@fault("header.render_info")
def rotation_of_zeros(t: Target, *signs: float) -> Edit:
    """A quaternion whose components are all 0. signs: four zeros, each of either sign."""
    path = "render_info.camera_rotation"
    return Edit(t.pack({f"{path}[{i}]": zero for i, zero in enumerate(signs)}), t.at(f"{path}[0]"))


@rotation_of_zeros.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, *(draw.choice([0.0, -0.0]) for _ in range(4))


# --- the suite's ------------------------------------------------------------------------------------------------------


def label_of(path: str) -> str:
    """The path of an element as a part of an identifier."""
    return path.replace("_", "-").replace(".", "-").replace("[", "-").replace("]", "")


def add(book: Book) -> None:
    """Adds the vectors."""
    _prologue(book)
    _header(book)
    _fields(book)
    _render_info(book)
    _position_grids(book)


def _prologue(book: Book) -> None:
    add = partial(book.add, features="prologue")
    for length in (0, 19):
        title = f"a file of {length} bytes"
        add(f"malformed-prologue-of-{length}-bytes", title, cut_in_prologue.of(plain, length), flags="truncation")
    for name, at, value in (("seven-bits", 0, 9), ("last-byte", 7, 13)):
        title, make = f"byte {at} of the signature is {value}", signature_byte.of(plain, at, value)
        add(f"malformed-prologue-signature-{name}", title, make, flags="signature-partly")
    for at, name in ((8, "version"), (15, "header-length"), (19, "itself")):
        title = f"the prologue's CRC-32 does not match: byte {at} is changed"
        add(f"malformed-prologue-crc-{name}", title, prologue_byte.of(plain, at, 0x40), flags="checksum-unchecked")
    for value in (1, 1 << 24):
        title = f"version {value}"
        add(f"unsupported-prologue-version-{value}", title, version.of(plain, value), flags="version-unchecked")
    for value in (3, 65536):
        title, make = f"header_length {value}", header_length.of(plain, value)
        add(f"malformed-prologue-header-length-{value}", title, make, flags="limit-off-by-one")


def _header(book: Book) -> None:
    add = partial(book.add, features="header")
    title = "the file ends with its prologue"
    add("malformed-header-none", title, cut_in_header.of(plain, 0), flags="truncation")
    title = "the last byte of the header is missing"
    add("malformed-header-cut-by-one", title, cut_in_header.of(plain, -1), flags="truncation")
    for name, at in (("first", 0), ("last", -5)):
        title = f"the header's CRC-32 does not match: {name} byte changed"
        add(f"malformed-header-crc-{name}", title, header_byte.of(plain, at, 1), flags="checksum-unchecked")
    for more in (1, -1, -4):
        name, word = ("longer", "more") if more > 0 else ("shorter", "less")
        add(
            f"malformed-header-{name}-by-{abs(more)}",
            f"header_length is {abs(more)} {word} than the fields take",
            lambda more=more: fields_cut_or_padded(plain(), fields_length(plain()) + more),  # type: ignore[misc]
            flags="header-slack" if more > 0 else "truncation",
        )
    title, make = "a header that is its CRC-32 alone", fields_cut_or_padded.of(plain, 0, alone=True)
    add("malformed-header-of-crc-alone", title, make, flags="truncation")
    title = "the largest header_length, with zeros behind the fields"
    add("malformed-header-longest", title, fields_cut_or_padded.of(plain, 65531, alone=True), flags="header-slack")
    for path in ("dimensions.slice_count", "section_count"):
        name = path.rpartition(".")[2]
        title, make = f"{name} 255, more than the header holds", count_beyond_header.of(plain, path, 255)
        add(f"malformed-header-{label_of(name)}-255", title, make, flags="truncation buffer-too-small")


def _fields(book: Book) -> None:
    for path, value in (
        ("reserved_0", 1),
        ("reserved_1", 1),
        ("position_grid.reserved", 1),
        ("directory[0].reserved", 256),
        ("directory[8].reserved", 256),
    ):
        name, title, make = f"header-set-{label_of(path)}", f"{path} is {value}", reserved.of(plain, path, value)
        book.add(f"malformed-{name}", title, make, features="header", flags="reserved-unchecked")
    for part, values in (("plane", [9]), ("mask", [9, 32]), ("attribute", [9])):
        for value in values:
            path = f"{part}_lanes_log2"
            title, flags = f"{path} {value}", "limit-off-by-one shift-overflow"
            make = lanes.of(plain, path, value)
            book.add(f"invalid-{part}-lanes-{value}", title, make, features="header lanes", flags=flags)
    below, above = float.fromhex("0x1.fffffep-61"), float.fromhex("0x1.000002p+60")
    for item, step, name in (
        (0, below, "below-the-least"),
        (1, above, "above-the-largest"),
        (2, -1.0, "negative"),
        (1, NAN, "not-a-number"),
        (2, INFINITY, "infinite"),
    ):
        title, flags = f"base_step {item} is {name.replace('-', ' ')}", "float-limits limit-off-by-one"
        make = base_step.of(plain, f"base_step[{item}]", step)
        book.add(f"invalid-base-step-{item}-{name}", title, make, features="header steps", flags=flags)
    add = partial(book.add, features="position-grid")
    for item, number in ((0, 1 << 62), (1, -(1 << 62)), (2, -(1 << 63))):
        name = f"origin-{'minus' if number < 0 else 'plus'}-{item}-{abs(number).bit_length()}"
        title, flags = f"origin {item} is {number}", "limit-off-by-one signed-limits"
        add(f"invalid-{name}", title, position_grid.of(plain, f"position_grid.origin[{item}]", number), flags=flags)
    make = position_grid.of(plain, "position_grid.scale_mantissa", 0)
    add("invalid-scale-mantissa-0", "scale_mantissa 0", make, flags="limit-off-by-one")
    for number in (61, -61, -128):
        name = f"scale-exponent-{'minus' if number < 0 else 'plus'}-{abs(number)}"
        title, flags = f"scale_exponent {number}", "limit-off-by-one signed-limits"
        add(f"invalid-{name}", title, position_grid.of(plain, "position_grid.scale_exponent", number), flags=flags)


def _render_info(book: Book) -> None:
    add = partial(book.add, features="render-info")
    for field, value, text in (
        ("up_axis", 6, "6"),
        ("near_plane", NAN, "not-a-number"),
        ("near_plane", INFINITY, "infinite"),
        ("near_plane", 0.0, "zero"),
        ("near_plane", -1.0, "negative"),
        ("distance_unit", NAN, "not-a-number"),
        ("distance_unit", 0.0, "zero"),
        ("distance_unit", -1.0, "negative"),
        ("alpha_max", NAN, "not-a-number"),
        ("alpha_max", -0.0, "minus-zero"),
        ("alpha_max", float.fromhex("0x1.000002p+0"), "above-one"),
        ("low_pass", NAN, "not-a-number"),
        ("low_pass", INFINITY, "infinite"),
        ("low_pass", -SMALLEST_F32, "negative"),
        ("camera_width", 0, "zero"),
        ("camera_height", 0, "zero"),
        ("camera_focal[0]", NAN, "not-a-number"),
        ("camera_focal[1]", INFINITY, "infinite"),
        ("camera_focal[1]", 0.0, "zero"),
        ("camera_focal[0]", -1.0, "negative"),
        ("camera_rotation[0]", -INFINITY, "infinite"),
        ("camera_rotation[3]", NAN, "not-a-number"),
        ("camera_translation[0]", NAN, "not-a-number"),
        ("camera_translation[2]", -INFINITY, "infinite"),
    ):
        title, make = f"{field} is {text.replace('-', ' ')}", render_info.of(plain, f"render_info.{field}", value)
        add(f"invalid-{label_of(field)}-{text}", title, make, flags="float-limits")
    make = rotation_of_zeros.of(plain, -0.0, 0.0, -0.0, 0.0)
    add("invalid-camera-rotation-zeros", "camera_rotation of zeros", make, flags="float-limits")
    least = RenderInfo(
        background=(0, 0, 0),
        up_axis=0,
        near_plane=SMALLEST_F32,
        distance_unit=SMALLEST_F32,
        alpha_max=SMALLEST_F32,
        low_pass=0.0,
        camera_width=1,
        camera_height=1,
        camera_focal=(SMALLEST_F32, SMALLEST_F32),
        camera_rotation=(0.0, 0.0, 0.0, SMALLEST_F32),
        camera_translation=(-LARGEST_F32,) * 3,
    )
    largest = RenderInfo(
        background=(255, 255, 255),
        up_axis=5,
        near_plane=LARGEST_F32,
        distance_unit=LARGEST_F32,
        alpha_max=1.0,
        low_pass=LARGEST_F32,
        camera_width=65535,
        camera_height=65535,
        camera_focal=(LARGEST_F32, LARGEST_F32),
        camera_rotation=(LARGEST_F32,) * 4,
        camera_translation=(LARGEST_F32,) * 3,
    )
    zeros = replace(RenderInfo(), low_pass=-0.0, camera_rotation=(-0.0, 1.0, -0.0, 0.0), camera_translation=(-0.0,) * 3)
    for name, render in (("least", least), ("largest", largest), ("negative-zeros", zeros)):
        book.valid(
            f"render-info-{name}",
            f"render information, {name.replace('-', ' ')}",
            partial(scene, "render-info", 2, SMALLEST, render=render),
            features="render-info",
            requirements="R6.5-1",
            flags="limit-off-by-one",
        )


def _position_grids(book: Book) -> None:
    bits = [[0, 1, 2], [0x8001, 0x3C00, 0xBC00], [0x7BFF, 0xFBFF, 0], [3, 5, 0x8007], [0x3C00, 0, 0x0400]]
    where = np.array(bits, np.uint16).view(np.float16)
    for name, grid in (
        ("least", PositionGrid((1 - (1 << 62),) * 3, 1, -60)),
        ("largest", PositionGrid(((1 << 62) - 1,) * 3, 65535, 60)),
        ("ties", PositionGrid(((1 << 24) + 1, (1 << 24) + 3, -(1 << 24) - 1), 1, 0)),
        ("more-ties", PositionGrid(((1 << 25) - 1, -(1 << 25) + 1, -(1 << 24) - 3), 3, 5)),
        ("cancelled", PositionGrid((-(7 << 24), 5, 0), 7, -24)),
    ):
        book.valid(
            f"position-grid-{name}",
            f"a position grid: {name.replace('-', ' ')}",
            partial(scene, "position-grid", 5, SMALLEST, grid=grid, positions=where),
            features="position-grid reconstruction",
            requirements="R6.4-1 D9.1-1 D7.4-1",
            flags="limit-off-by-one world-rounding",
        )
    tie = (1 << 61) + (1 << 37)
    book.valid(
        "position-grid-long",
        "world positions that are ties but for their last bit",
        partial(
            scene,
            "planted-world",
            2,
            SMALLEST,
            grid=PositionGrid((tie + 1, -tie - 1, tie - 1), 1, 0),
            positions=f16(np.array([[0, 0, 0], [1, -1, 2]])),
        ),
        features="position-grid reconstruction",
        requirements="D9.1-1",
        flags="world-rounding",
    )
