"""Cases of clauses 5.1 to 5.5 and 6.1 to 6.5: prologue, header, position grid and render information.

Profile, level, dimensions and chunk_size are in limits.py.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.header import HEADER_LENGTH_MAX, PROLOGUE_BYTES, PositionGrid, RenderInfo
from refcodec.bitstream.limits import MAIN

from .book import Book
from .checksums import Depth, layout
from .fault import Draw, Drawn, Edit, Whole, fault, wrong_value
from .samplers import drawn
from .scenes import SMALLEST, f16, scene
from .target import Target
from .targets import grids, main_file, plain

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
    """A byte of the signature is wrong."""
    return Edit({at: bytes([value])}, 0)


@signature_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    at = draw.integer(0, 7)
    return t, at, t.data[at] ^ draw.integer(1, 255)


@fault("prologue.crc")
def prologue_byte(t: Target, at: int, bits: int) -> Edit:
    """Bits of the prologue after the signature are flipped, without its CRC-32."""
    return Edit(t.flip(at, bits), 16, Depth.NOTHING)


@prologue_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(8, PROLOGUE_BYTES - 1), draw.integer(1, 255)


@fault("prologue.version")
def version(t: Target, major: int, minor: int = 0) -> Edit:
    """The major version is not 0."""
    return Edit(t.pack({"prologue.major": major, "prologue.minor": minor}), 8, Depth.PROLOGUE)


@version.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(1, 0xFFFF), draw.integer(0, 0xFFFF)


@fault("prologue.header_length")
def header_length(t: Target, value: int) -> Edit:
    """The header_length is too small, too large, or not a multiple of 4."""
    return Edit(t.pack({"prologue.header_length": value}), 12, Depth.PROLOGUE)


@header_length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    odd = 4 * draw.integer(1, HEADER_LENGTH_MAX // 4 - 1) + draw.integer(1, 3)
    return t, draw.choice([draw.integer(0, 3), odd, draw.integer(HEADER_LENGTH_MAX + 1, 0xFFFFFFFF)])


# --- faults of the header as a whole ----------------------------------------------------------------------------------


@fault("header.truncated")
def cut_in_header(t: Target, left: int) -> Whole:
    """The file ends within its header. left: present bytes of the header; -1 is all but the last."""
    length = range(PROLOGUE_BYTES, t.header_end)[left]
    return Whole(t.data[:length], length)


@cut_in_header.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, t.header_end - PROLOGUE_BYTES - 1)


@fault("header.crc")
def header_byte(t: Target, at: int, bits: int) -> Edit:
    """Bits of a byte of the header are flipped, without its CRC-32.

    at: the byte, from the header's start, or from its end if it is negative.
    """
    return Edit(t.flip(range(PROLOGUE_BYTES, t.header_end)[at], bits), t.header_end - 4, Depth.NOTHING)


@header_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, t.header_end - PROLOGUE_BYTES - 1), draw.integer(1, 255)


@fault("header.syntax")
def fields_cut_or_padded(t: Target, length: int, alone: bool = False, minor: int = 0) -> Whole:
    """The header ends before its fields, or zeros follow the fields in a file of minor version 0.

    length: bytes of the header before its CRC-32, a multiple of 4. alone: the file ends with the header.
    """
    fields = t.data[PROLOGUE_BYTES:][: fields_length(t)]
    head = fields[:length].ljust(length, b"\0")
    start = t.data[:10] + minor.to_bytes(2, "little") + (length + 4).to_bytes(4, "little")
    made = start + struct.pack("<I", zlib.crc32(start)) + head + struct.pack("<I", zlib.crc32(head))
    told = PROLOGUE_BYTES + (len(fields) if length > len(fields) else length + 4)
    return Whole(made if alone else made + t.data[t.header_end :], told)


@fields_cut_or_padded.drawn
def _(draw: Draw, t: Target) -> Drawn:
    length = 4 * draw.integer(0, fields_length(t) // 4 + 10)
    minor = draw.integer(0, 0xFFFF) if length < fields_length(t) else 0
    return None if length == fields_length(t) else (t, length, draw.flag(), minor)


@fault("header.syntax")
def count_beyond_header(t: Target, path: str, count: int) -> Edit:
    """A list is longer than the header."""
    return Edit(t.pack({path: count}), t.header_end)


@count_beyond_header.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, "section_count", draw.integer(200, 0xFFFF)


def fields_length(t: Target) -> int:
    """Returns the bytes of the header's known fields, without its CRC-32."""
    return layout(t.data)[1] - 4 - PROLOGUE_BYTES


# --- faults of single fields ------------------------------------------------------------------------------------------

reserved = wrong_value(
    "header.reserved",
    {
        "reserved": [1, 255],
        **{f"{struct}.reserved": [1, 255] for struct in ("position_grid", "render_info", "dimensions")},
        **{f"directory[{entry}].reserved[{i}]": [1, 128] for entry in (0, 4) for i in range(3)},
    },
    told=lambda path: path[: path.rindex("[")] + "[0]" if path.endswith("]") else path,
)


@fault("header.padding")
def padding_byte(t: Target, place: int, value: int) -> Edit:
    """A byte of the padding of the dimensions is not zero."""
    first = t.at("dimensions.padding")
    return Edit({first + place: bytes([value])}, first)


@padding_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if "header.dimensions.padding" not in t.elements:
        t = grids()
    return t, draw.integer(0, len(t.value("dimensions.padding")) - 1), draw.integer(1, 255)


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
    },
)


@fault("header.chunk_count")
def chunk_count(t: Target, value: int) -> Edit:
    """There are fewer chunks than the anchors need, or more than anchors."""
    return Edit(t.pack({"chunk_count": value}), t.at("chunk_count"))


@chunk_count.drawn
def _(draw: Draw, t: Target) -> Drawn:
    count, size = t.header.anchor_count, t.header.chunk_size
    least = -(-count // size)
    return t, draw.integer(0, least - 1) if least and draw.flag() else draw.integer(count + 1, 0xFFFFFFFF)


# --- the suite's ------------------------------------------------------------------------------------------------------


def label_of(path: str) -> str:
    """Returns the path of an element as part of an identifier."""
    return path.replace("_", "-").replace(".", "-").replace("[", "-").replace("]", "")


def add(book: Book) -> None:
    """Adds the vectors."""
    _prologue(book)
    _header(book)
    _fields(book)
    _paddings(book)
    _chunk_counts(book)
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
    for at, name in ((8, "version"), (10, "minor"), (15, "header-length"), (19, "itself")):
        title = f"the prologue's CRC-32 does not match: byte {at} is changed"
        add(f"malformed-prologue-crc-{name}", title, prologue_byte.of(plain, at, 0x40), flags="checksum-unchecked")
    for major, minor in ((1, 0), (256, 0), (65535, 1)):
        title, make = f"version {major}.{minor}", version.of(plain, major, minor)
        add(f"unsupported-prologue-version-{major}", title, make, flags="version-unchecked")
    for value in (0, 3, 65533, 65536):
        title, make = f"header_length {value}", header_length.of(plain, value)
        add(f"malformed-prologue-header-length-{value}", title, make, flags="limit-off-by-one")
    for more in (-2, 1, 2):
        add(
            f"malformed-prologue-header-length-{more:+}".replace("+", "plus-").replace("--", "-minus-"),
            f"header_length is no multiple of 4, {more:+} against what the fields take",
            lambda more=more: header_length(plain(), plain().header_end - PROLOGUE_BYTES + more),  # type: ignore[misc]
            flags="limit-off-by-one header-slack",
        )


def _header(book: Book) -> None:
    add = partial(book.add, features="header")
    title = "the file ends with its prologue"
    add("malformed-header-none", title, cut_in_header.of(plain, 0), flags="truncation")
    title = "the last byte of the header is missing"
    add("malformed-header-cut-by-one", title, cut_in_header.of(plain, -1), flags="truncation")
    for name, at in (("first", 0), ("last", -5)):
        title = f"the header's CRC-32 does not match: {name} byte changed"
        add(f"malformed-header-crc-{name}", title, header_byte.of(plain, at, 1), flags="checksum-unchecked")
    for more in (4, -4, -8):
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
    longest = HEADER_LENGTH_MAX - 4
    add("malformed-header-longest", title, fields_cut_or_padded.of(plain, longest, alone=True), flags="header-slack")
    for path, count in (("dimensions.slice_count", 255), ("section_count", 255), ("section_count", 65535)):
        name = path.rpartition(".")[2]
        title, make = f"{name} {count}, more than the header holds", count_beyond_header.of(plain, path, count)
        add(f"malformed-header-{label_of(name)}-{count}", title, make, flags="truncation buffer-too-small")


def _fields(book: Book) -> None:
    for path, value in (
        ("reserved", 1),
        ("position_grid.reserved", 128),
        ("render_info.reserved", 1),
        ("dimensions.reserved", 255),
        ("dimensions.reserved", 1),
        ("directory[0].reserved[0]", 1),
        ("directory[2].reserved[1]", 1),
        ("directory[6].reserved[2]", 128),
    ):
        title, make = f"{path} is {value}", reserved.of(plain, path, value)
        name = f"header-set-{label_of(path if (path, value) != ('dimensions.reserved', 1) else f'{path}.1')}"
        book.add(f"unsupported-{name}", title, make, features="header", flags="reserved-unchecked")
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


@cache
def _padded() -> Target:
    """Returns a file whose dimensions have three bytes of padding."""
    return Target(codec.emit(drawn("refused-padded", 2, replace(SMALLEST, slices=(1, 1, 1)))))


def _paddings(book: Book) -> None:
    for place, value in enumerate((1, 255, 128)):
        title, make = (
            f"byte {place} of the padding of the dimensions is {value}",
            padding_byte.of(_padded, place, value),
        )
        name = f"malformed-header-padding-{place}"
        book.add(name, title, make, features="header dimensions", flags="padding-unchecked")


def _chunk_counts(book: Book) -> None:
    add = partial(book.add, features="header chunks", flags="limit-off-by-one")
    for base, before, value, text in (
        (plain, "", 0, "no chunks, though there are anchors"),
        (plain, "", 2, "fewer chunks than 11 anchors need, 4 a chunk"),
        (plain, "", 12, "more chunks than there are anchors"),
        (plain, "", 0xFFFFFFFF, "as many chunks as a field can say"),
        (main_file, "empty-", 1, "a chunk, though there are no anchors"),
    ):
        add(f"invalid-chunk-count-{before}{value}", text, chunk_count.of(base, value))
    for name, text, sizes in (
        ("least", "as few chunks as the anchors need", (4, 4, 1)),
        ("most", "as many chunks as there are anchors, though one could hold four", (1,) * 9),
        ("uneven", "chunks that are not full, in no order", (1, 4, 2, 2)),
    ):
        book.valid(
            f"chunk-count-{name}",
            text,
            partial(drawn, "chunk-count", 9, chunk_size=4, chunk_anchors=sizes),
            features="header chunks",
            requirements="R6.2-8",
            flags="last-chunk limit-off-by-one",
        )


def _render_info(book: Book) -> None:
    add = partial(book.add, features="render-info")
    for field, value, text in (
        ("up_axis", 6, "6"),
        ("up_axis", 255, "255"),
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
        ("low_pass", -1.0, "minus-one"),
        ("distance_unit", -INFINITY, "infinite"),
        ("alpha_max", INFINITY, "infinite"),
        ("distance_unit", INFINITY, "plus-infinite"),
    ):
        title, make = f"{field} is {text.replace('-', ' ')}", render_info.of(plain, f"render_info.{field}", value)
        add(f"invalid-{label_of(field)}-{text}", title, make, flags="float-limits")
    least = RenderInfo((0, 0, 0), 0, SMALLEST_F32, SMALLEST_F32, SMALLEST_F32, 0.0)
    largest = RenderInfo((255, 255, 255), 5, LARGEST_F32, LARGEST_F32, 1.0, LARGEST_F32, 255, 255)
    zeros = replace(RenderInfo(), low_pass=-0.0)
    linear = replace(RenderInfo(), transfer_characteristics=8)
    codes = replace(RenderInfo(), colour_primaries=0, transfer_characteristics=0)
    rows = (
        ("least", least),
        ("largest", largest),
        ("negative-zeros", zeros),
        ("linear-light", linear),
        ("codes-of-0", codes),
    )
    for name, render in rows:
        book.valid(
            f"render-info-{name}",
            f"render information, {name.replace('-', ' ')}",
            partial(scene, "render-info", 2, SMALLEST, render=render),
            features="render-info",
            requirements="R6.5-1 D9.3-1",
            flags="limit-off-by-one",
        )
    for model, inputs, outputs in ((2, 4, 3), (3, 0, 1), (255, 8, 48)):
        book.valid(
            f"render-model-{model}",
            f"render model {model}, with {inputs} view inputs and {outputs} colour outputs",
            partial(
                scene,
                "render-model",
                2,
                replace(SMALLEST, view_inputs=inputs, colour_outputs=outputs),
                render=replace(RenderInfo(), render_model=model),
            ),
            features="render-info dimensions",
            requirements="R11.1-2 G6.5-1 D9.3-1",
            flags="limit-off-by-one render-model",
        )
    for model, title, inputs, outputs in (
        (2, "without view inputs", 0, 3),
        (3, "with one colour output", 4, 1),
        (255, "with 8 view inputs and 48 colour outputs", 8, 48),
    ):
        book.valid(
            f"main-render-model-{model}",
            f"render model {model} in Main, {title}",
            partial(
                scene,
                "render-model-main",
                1,
                replace(SMALLEST, view_inputs=inputs, colour_outputs=outputs),
                profile=MAIN,
                chunk_size=256,
                render=replace(RenderInfo(), render_model=model),
            ),
            features="render-info dimensions main",
            requirements="R11.1-2 G6.5-1",
            flags="limit-off-by-one render-model",
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
