"""Cases of clauses 5.1 to 5.5 and 6.1 to 6.5: prologue, header, position grid and render information.

Profile, level, dimensions and chunk_size are in limits.py.
"""

import math
import struct
import zlib
from dataclasses import replace
from functools import partial

import numpy as np

from refcodec.bitstream.header import ALPHA_MOST, HEADER_LENGTH_MAX, MAJOR, PROLOGUE_BYTES, PositionGrid, RenderInfo
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Scene

from .checksums import Depth, layout
from .fault import Draw, Edit, Whole, either, element, ends, fault, padding, wrong_value
from .samplers import drawn
from .scenes import SMALLEST, f16, scene
from .table import label_of, refused, valid
from .target import Target
from .targets import grids, main_file, target_of
from .weights import with_weights

SMALLEST_F32 = 2.0**-149
LARGEST_F32 = float(np.finfo(np.float32).max)
NAN, INFINITY = math.nan, math.inf
NOT_POSITIVE = [0.0, -1.0, NAN, INFINITY, -INFINITY]

# --- faults of the prologue -------------------------------------------------------------------------------------------

cut_in_prologue = ends("prologue.truncated", "cut_in_prologue", (0, PROLOGUE_BYTES - 1))


@fault("prologue.signature", (0, 7), lambda d, t, at: t.data[at] ^ d.integer(1, 255))
def signature_byte(t: Target, at: int, value: int) -> Edit:
    """A byte of the signature is wrong."""
    return Edit({at: bytes([value])}, 0)


@fault("prologue.crc", (8, PROLOGUE_BYTES - 1), (1, 255))
def prologue_byte(t: Target, at: int, bits: int) -> Edit:
    """Bits of the prologue after the signature are flipped, without its CRC-32."""
    return Edit(t.flip(at, bits), 16, Depth.NOTHING)


@fault("prologue.version", lambda d, t: (MAJOR + d.integer(1, 0xFFFF)) % (1 << 16), (0, 0xFFFF))
def version(t: Target, major: int, minor: int = 0) -> Edit:
    """The major version is not MAJOR."""
    return Edit(t.pack({"prologue.major": major, "prologue.minor": minor}), 8, Depth.PROLOGUE)


# Too small, not a multiple of 4, or too large.
header_length = element(
    "prologue.header_length",
    "prologue.header_length",
    either((0, 3), lambda d, t: 4 * d.integer(1, HEADER_LENGTH_MAX // 4 - 1) + d.integer(1, 3), (65537, 0xFFFFFFFF)),
    right=Depth.PROLOGUE,
)

# --- faults of the header as a whole ----------------------------------------------------------------------------------

cut_in_header = ends("header.truncated", "cut_in_header", lambda d, t: d.integer(PROLOGUE_BYTES, t.header_end - 1))


@fault("header.crc", lambda d, t: d.integer(0, t.header_end - PROLOGUE_BYTES - 1), (1, 255))
def header_byte(t: Target, at: int, bits: int) -> Edit:
    """Bits of a byte of the header are flipped, without its CRC-32.

    at: the byte, from the header's start, or from its end if it is negative.
    """
    return Edit(t.flip(range(PROLOGUE_BYTES, t.header_end)[at], bits), t.header_end - 4, Depth.NOTHING)


def fields_length(t: Target) -> int:
    """Returns the bytes of the header's known fields, without its CRC-32."""
    return layout(t.data)[1] - 4 - PROLOGUE_BYTES


@fault(
    "header.syntax",
    lambda d, t: d.choice([n for n in range(0, fields_length(t) + 44, 4) if n != fields_length(t)]),
    [False, True],
    lambda d, t, length, alone: d.integer(0, 0xFFFF) if length < fields_length(t) else 0,
)
def fields_cut_or_padded(t: Target, length: int, alone: bool = False, minor: int = 0) -> Whole:
    """The header ends before its fields, or zeros follow the fields in a file of minor version 0.

    length: bytes of the header before its CRC-32, a multiple of 4. alone: the file ends with the header.
    """
    fields = t.data[PROLOGUE_BYTES:][: fields_length(t)]
    head = fields[:length].ljust(length, b"\0")
    start = t.data[:10] + minor.to_bytes(2, "little") + (length + 4).to_bytes(4, "little")
    made = start + struct.pack("<I", zlib.crc32(start)) + head + struct.pack("<I", zlib.crc32(head))
    reported = PROLOGUE_BYTES + (len(fields) if length > len(fields) else length + 4)
    return Whole(made if alone else made + t.data[t.header_end :], reported)


@fault("header.syntax", ["section_count"], (200, 0xFFFF))
def count_beyond_header(t: Target, path: str, count: int) -> Edit:
    """A list is longer than the header."""
    return Edit(t.pack({path: count}), t.header_end)


def _chunk_counts(draw: Draw, t: Target) -> int:
    """Draws fewer chunks than the anchors need, or more than anchors."""
    least = -(-t.header.anchor_count // t.header.chunk_size)
    return draw.integer(0, least - 1) if least and draw.flag() else draw.integer(t.header.anchor_count + 1, 0xFFFFFFFF)


# A file whose dimensions have three bytes of padding.
_padded = target_of(lambda: drawn("refused-padded", 2, replace(SMALLEST, slices=(1, 1, 1))))
# Base steps next to the limits.
_BELOW, _ABOVE = float.fromhex("0x1.fffffep-61"), float.fromhex("0x1.000002p+60")
# The f32 above 0.99, the limit of alpha_max.
_ABOVE_LIMIT = float.fromhex("0x1.fae14ap-1")
_HALVES = np.array(
    [[0, 1, 2], [0x8001, 0x3C00, 0xBC00], [0x7BFF, 0xFBFF, 0], [3, 5, 0x8007], [0x3C00, 0, 0x0400]], np.uint16
).view(np.float16)
_TIE = (1 << 61) + (1 << 37)


def _modelled(model: int, inputs: int, outputs: int, name: str = "render-model", size: int = 2, **more: int) -> Scene:
    """Returns a scene of a render model, with view inputs and colour outputs. size: in anchors. more: as of scene."""
    d, render = replace(SMALLEST, view_inputs=inputs, colour_outputs=outputs), RenderInfo(render_model=model)
    return scene(name, size, d, render=render, **more)


# fmt: off
# Faults of single fields: the values that are drawn, by element.
reserved = wrong_value("header.reserved", {
    "reserved": [1, 255],
    **{f"{struct}.reserved": [1, 255] for struct in ("position_grid", "render_info", "dimensions")},
    **{f"directory[{entry}].reserved[{i}]": [1, 128] for entry in (0, 4) for i in range(3)}})
padding_byte = padding("header.padding", r"header\.dimensions\.padding",
                       lambda draw, t: t if t.has("dimensions.padding") else grids())
lanes = wrong_value("header.lanes", {f"{part}_lanes_log2": [9, 31, 32, 255] for part in ("plane", "mask", "attribute")})
base_step = wrong_value(
    "header.base_step", {f"base_step[{i}]": [0.0, -1.0, 2.0**-61, 2.0**61, NAN, INFINITY] for i in range(3)})
position_grid = wrong_value("header.position_grid", {
    **{f"position_grid.origin[{i}]": [1 << 62, -(1 << 62), -(1 << 63)] for i in range(3)},
    "position_grid.scale_mantissa": [0], "position_grid.scale_exponent": [61, -61, -128, 127]})
render_info = wrong_value("header.render_info", {
    "render_info.up_axis": [6, 255], "render_info.near_plane": NOT_POSITIVE, "render_info.distance_unit": NOT_POSITIVE,
    "render_info.alpha_max": [*NOT_POSITIVE, 0.9901], "render_info.low_pass": NOT_POSITIVE[1:]})
chunk_count = element("header.chunk_count", "chunk_count", _chunk_counts)

CASES = [
    # The prologue.
    *refused("prologue", "truncation",
        ("prologue-of-0-bytes", "a file of 0 bytes", cut_in_prologue, 0),
        ("prologue-of-19-bytes", "a file of 19 bytes", cut_in_prologue, 19)),
    *refused("prologue", "signature-partly",
        ("prologue-signature-seven-bits", "byte 0 of the signature is 9", signature_byte, 0, 9),
        ("prologue-signature-last-byte", "byte 7 of the signature is 13", signature_byte, 7, 13)),
    *refused("prologue", "checksum-unchecked", *(
        (f"prologue-crc-{name}", f"the prologue's CRC-32 does not match: byte {at} is changed", prologue_byte, at, 0x40)
        for at, name in ((8, "version"), (10, "minor"), (15, "header-length"), (19, "itself")))),
    # The version before, if there is one, and later ones.
    *refused("prologue", "version-unchecked", *(
        (f"prologue-version-{major}", f"version {major}.{minor}", version, major, minor)
        for major, minor in ((MAJOR + 1, 0), (256, 0), (65535, 1), *[(MAJOR - 1, 0)][: MAJOR]))),
    *refused("prologue", "limit-off-by-one", *(
        (f"prologue-header-length-{value}", f"header_length {value}", header_length, value)
        for value in (0, 3, 65533, 65536))),
    *refused("prologue", "limit-off-by-one header-slack", *(
        (f"prologue-header-length-{name}", f"header_length is no multiple of 4, {more:+} against what the fields take",
         header_length, lambda t, more=more: t.header_end - PROLOGUE_BYTES + more)
        for name, more in (("minus-2", -2), ("plus-1", 1), ("plus-2", 2)))),

    # The header as a whole.
    *refused("header", "truncation",
        ("header-none", "the file ends with its prologue", cut_in_header, PROLOGUE_BYTES),
        ("header-cut-by-one", "the last byte of the header is missing", cut_in_header, lambda t: t.header_end - 1),
        (fields_cut_or_padded,),
        ("header-shorter-by-4", "header_length is 4 less than the fields take", lambda t: fields_length(t) - 4),
        ("header-shorter-by-8", "header_length is 8 less than the fields take", lambda t: fields_length(t) - 8),
        ("header-of-crc-alone", "a header that is its CRC-32 alone", 0, True)),
    *refused("header", "checksum-unchecked",
        ("header-crc-first", "the header's CRC-32 does not match: first byte changed", header_byte, 0, 1),
        ("header-crc-last", "the header's CRC-32 does not match: last byte changed", header_byte, -5, 1)),
    *refused("header", "header-slack", (fields_cut_or_padded,),
        ("header-longer-by-4", "header_length is 4 more than the fields take", lambda t: fields_length(t) + 4),
        ("header-longest", "the largest header_length, with zeros behind the fields", HEADER_LENGTH_MAX - 4, True)),
    *refused("header", "truncation buffer-too-small", (count_beyond_header,),
        ("header-slice-count-255", "slice_count 255, more than the header holds", "dimensions.slice_count", 255),
        *((f"header-section-count-{count}", f"section_count {count}, more than the header holds", "section_count",
           count) for count in (255, 65535))),

    # Its fields.
    *refused("header", "reserved-unchecked", *(
        (f"header-set-{label_of(name or path)}", f"{path} is {value}", reserved, path, value)
        for path, value, name in (
            ("reserved", 1, ""), ("position_grid.reserved", 128, ""), ("render_info.reserved", 1, ""),
            ("dimensions.reserved", 255, ""), ("dimensions.reserved", 1, "dimensions.reserved.1"),
            ("directory[0].reserved[0]", 1, ""), ("directory[2].reserved[1]", 1, ""),
            ("directory[6].reserved[2]", 128, "")))),
    *refused("header lanes", "limit-off-by-one shift-overflow", *(
        (f"{part}-lanes-{value}", f"{part}_lanes_log2 {value}", lanes, f"{part}_lanes_log2", value)
        for part, value in (("plane", 9), ("mask", 9), ("mask", 32), ("attribute", 9)))),
    *refused("header steps", "float-limits limit-off-by-one", *(
        (f"base-step-{item}-{name}", f"base_step {item} is {name.replace('-', ' ')}", base_step, f"base_step[{item}]",
         step)
        for item, step, name in (
            (0, _BELOW, "below-the-least"), (1, _ABOVE, "above-the-largest"), (2, -1.0, "negative"),
            (1, NAN, "not-a-number"), (2, INFINITY, "infinite")))),
    *refused("position-grid", "limit-off-by-one signed-limits", *(
        (f"origin-{name}", f"origin {item} is {value}", position_grid, f"position_grid.origin[{item}]", value)
        for item, value, name in (
            (0, 1 << 62, "plus-0-63"), (1, -(1 << 62), "minus-1-63"), (2, -(1 << 63), "minus-2-64"))),
        *((f"scale-exponent-{name}", f"scale_exponent {value}", position_grid, "position_grid.scale_exponent",
           value)
          for value, name in ((61, "plus-61"), (-61, "minus-61"), (-128, "minus-128")))),
    *refused("position-grid", "limit-off-by-one",
        ("scale-mantissa-0", "scale_mantissa 0", position_grid, "position_grid.scale_mantissa", 0)),
    *refused("header dimensions", "padding-unchecked", *(
        (f"header-padding-{place}", f"byte {place} of the padding of the dimensions is {value}", _padded, padding_byte,
         "dimensions.padding", place, value)
        for place, value in enumerate((1, 255, 128)))),
    *refused("header chunks", "limit-off-by-one",
        ("chunk-count-0", "no chunks, though there are anchors", chunk_count, 0),
        ("chunk-count-2", "fewer chunks than 11 anchors need, 4 a chunk", chunk_count, 2),
        ("chunk-count-12", "more chunks than there are anchors", chunk_count, 12),
        ("chunk-count-4294967295", "as many chunks as a field can say", chunk_count, 0xFFFFFFFF),
        ("chunk-count-empty-1", "a chunk, though there are no anchors", main_file, chunk_count, 1)),
    *valid("header chunks", "last-chunk limit-off-by-one", "R6.2-8", *(
        (f"chunk-count-{name}", text, partial(drawn, "chunk-count", 9, chunk_size=4, chunk_anchors=sizes))
        for name, text, sizes in (
            ("least", "as few chunks as the anchors need", (4, 4, 1)),
            ("most", "as many chunks as there are anchors, though one could hold four", (1,) * 9),
            ("uneven", "chunks that are not full, in no order", (1, 4, 2, 2))))),

    # The render information.
    *refused("render-info", "float-limits", *(
        (f"{label_of(field)}-{text}", f"{field} is {text.replace('-', ' ')}", render_info, f"render_info.{field}",
         value)
        for field, value, text in (
            ("up_axis", 6, "6"), ("up_axis", 255, "255"),
            ("near_plane", NAN, "not-a-number"), ("near_plane", INFINITY, "infinite"),
            ("near_plane", 0.0, "zero"), ("near_plane", -1.0, "negative"),
            ("distance_unit", NAN, "not-a-number"), ("distance_unit", 0.0, "zero"), ("distance_unit", -1.0, "negative"),
            ("distance_unit", -INFINITY, "infinite"), ("distance_unit", INFINITY, "plus-infinite"),
            ("alpha_max", NAN,
             "not-a-number"), ("alpha_max", -0.0, "minus-zero"), ("alpha_max", _ABOVE_LIMIT, "above-limit"),
            ("alpha_max", INFINITY, "infinite"),
            ("low_pass", NAN, "not-a-number"), ("low_pass", INFINITY, "infinite"),
            ("low_pass", -SMALLEST_F32, "negative"), ("low_pass", -1.0, "minus-one")))),
    *valid("render-info", "limit-off-by-one", "R6.5-1 D9.3-1", *(
        (f"render-info-{name}", f"render information, {name.replace('-', ' ')}",
         partial(scene, "render-info", 2, SMALLEST, render=render))
        for name, render in (
            ("least", RenderInfo((0, 0, 0), 0, SMALLEST_F32, SMALLEST_F32, SMALLEST_F32, 0.0)),
            ("largest", RenderInfo((255, 255, 255), 5, LARGEST_F32, LARGEST_F32, ALPHA_MOST, LARGEST_F32, 255, 255)),
            ("negative-zeros", RenderInfo(low_pass=-0.0)),
            ("linear-light", RenderInfo(transfer_characteristics=8)),
            ("codes-of-0", RenderInfo(colour_primaries=0, transfer_characteristics=0))))),
    *valid("render-info dimensions", "limit-off-by-one render-model", "R11.1-2 G6.5-1 D9.3-1", *(
        (f"render-model-{model}", f"render model {model}, with {inputs} view inputs and {outputs} colour outputs",
         _modelled, model, inputs, outputs)
        for model, inputs, outputs in ((2, 4, 3), (3, 0, 1), (255, 8, 48), (128, 0, 3), (129, 4, 1)))),
    *valid("render-info dimensions", "render-model accumulator-bound", "R6.5-1 D7.2-1",
        ("render-model-2-large-weight", "render model 2 without view inputs, and weights beyond those of static scenes",
         lambda: with_weights(_modelled(2, 0, 3), ("opacity.0", 0, 0, 4096.0)))),
    *valid("render-info dimensions main", "limit-off-by-one render-model", "R11.1-2 G6.5-1", *(
        (f"main-render-model-{model}", f"render model {model} in Main, {title}",
         partial(_modelled, model, inputs, outputs, "render-model-main", 1, profile=MAIN, chunk_size=256))
        for model, title, inputs, outputs in (
            (2, "without view inputs", 0, 3), (3, "with one colour output", 4, 1),
            (255, "with 8 view inputs and 48 colour outputs", 8, 48)))),

    # The position grid.
    *valid("position-grid reconstruction", "limit-off-by-one world-rounding", "R6.4-1 D9.1-1 D7.4-1", *(
        (f"position-grid-{name}", f"a position grid: {name.replace('-', ' ')}",
         partial(scene, "position-grid", 5, SMALLEST, grid=PositionGrid(*grid), positions=_HALVES))
        for name, grid in (
            ("least", ((1 - (1 << 62),) * 3, 1, -60)),
            ("largest", (((1 << 62) - 1,) * 3, 65535, 60)),
            ("ties", (((1 << 24) + 1, (1 << 24) + 3, -(1 << 24) - 1), 1, 0)),
            ("more-ties", (((1 << 25) - 1, -(1 << 25) + 1, -(1 << 24) - 3), 3, 5)),
            ("cancelled", ((-(7 << 24), 5, 0), 7, -24))))),
    *valid("position-grid reconstruction", "world-rounding", "D9.1-1",
        ("position-grid-long", "world positions that are ties but for their last bit",
         partial(scene, "planted-world", 2, SMALLEST, grid=PositionGrid((_TIE + 1, -_TIE - 1, _TIE - 1), 1, 0),
                 positions=f16(np.array([[0, 0, 0], [1, -1, 2]]))))),
]
