"""Cases of clause 10.1, PROLOGUE to DIRECTORY: two faults of the prologue, the header or the directory.

The first in the order of checks must be reported, wherever it is in the file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

from . import directory, frame, header, limits
from .book import Book
from .checksums import Depth
from .fault import Edit, Fault, Part, Refused, several
from .header import INFINITY, NAN
from .target import Target
from .targets import grids, main_file, plain, planeless, strewn


def add(book: Book) -> None:
    """Adds the vectors."""
    _prologue(book)
    _neighbours(book)
    _header(book)
    _dimensions(book)
    _ends(book)


def _prologue(book: Book) -> None:
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "malformed-signature-and-crc",
            "signature, and the prologue's CRC-32",
            (header.signature_byte.edit(0, 0x88), header.prologue_byte.edit(16, 0x55)),
        ),
        (
            "malformed-crc-and-version",
            "the prologue's CRC-32, and the version",
            (
                header.prologue_byte.edit(8, 1),
                lambda t: Edit(t.pack({"prologue.header_length": 0}), 12, Depth.NOTHING),
            ),
        ),
        (
            "unsupported-version-and-header-length",
            "version 1, and a header_length of 0",
            (
                header.version.edit(1),
                header.header_length.edit(0),
                header.header_byte.edit(10, 0x55),
            ),
        ),
        (
            "malformed-header-crc-and-profile",
            "the header's CRC-32, and the profile",
            (header.header_byte.edit(-1, 0x55), limits.profile.edit("profile", 9)),
        ),
    ]
    for identifier, title, pair in rows:
        book.ordered(identifier, title, several(plain, *pair))


def _pairs(book: Book, base: Callable[[], Target], checks: list[Check]) -> None:
    for (klass, path, one, args), (_, other_path, other, other_args) in pairwise(checks):
        name = "-and-".join(made.error.partition(".")[2].replace("_", "-") for made in (one, other))
        make = several(base, one.edit(*args), other.edit(*other_args))
        book.ordered(f"{klass}-{name}", f"{path} and {other_path}", make)


# The class of its error, the element, the fault and its parameters.
Check = tuple[str, str, Fault[...], tuple[Any, ...]]


def _neighbours(book: Book) -> None:
    """Adds files with adjacent checks of the header and the directory."""
    reserved: Check = ("unsupported", "position_grid.reserved", header.reserved, ("position_grid.reserved", 1))
    render: Check = ("invalid", "render_info.low_pass", header.render_info, ("render_info.low_pass", -1.0))
    count: Check = ("invalid", "chunk_count", header.chunk_count, (50,))
    _pairs(
        book,
        grids,
        [
            ("malformed", "section_count", header.count_beyond_header, ("section_count", 0xFFFF)),
            ("malformed", "the padding of the dimensions", header.padding_byte, (0, 1)),
            reserved,
        ],
    )
    _pairs(
        book,
        plain,
        [
            reserved,
            ("unsupported", "profile", limits.profile, ("profile", 9)),
            ("unsupported", "level", limits.level, (9,)),
            ("invalid", "dimensions.render_width", limits.dimension, ("render_width", 0)),
            ("invalid", "anchor_count", limits.too_many_anchors, (5000,)),
            ("invalid", "chunk_size", limits.chunk_size, ("chunk_size", 0)),
            ("invalid", "attribute_lanes_log2", header.lanes, ("attribute_lanes_log2", 9)),
            ("invalid", "base_step[2]", header.base_step, ("base_step[2]", 0.0)),
            ("invalid", "position_grid.scale_exponent", header.position_grid, ("position_grid.scale_exponent", 61)),
            render,
            count,
            ("malformed", "directory[6].type", directory.type_byte, (6, 0, 0x2A)),
            ("unsupported", "directory[5].type", directory.unknown_section, (5, b"ZZZZ")),
            ("malformed", "directory[3].type", directory.types, ({3: b"FRAM"}, 3)),
            ("unsupported", "directory[2].mode", directory.mode, (2, 1)),
            ("malformed", "directory[1].length", directory.stated_length, (1, 3)),
        ],
    )
    # Only Main has files whose work is more than their level allows.
    _pairs(
        book, main_file, [render, ("invalid", "the work", limits.work_of_widths, ()), ("invalid", *count[1:3], (0,))]
    )


def _header(book: Book) -> None:
    info, grid = "render_info", "position_grid"
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "unsupported-reserved-and-profile-last-entry",
            "the last entry's reserved, and the profile",
            (header.reserved.edit("directory[6].reserved[2]", 1), limits.profile.edit("profile", 9)),
        ),
        (
            "unsupported-two-reserved",
            "the grid's reserved, and that of an entry",
            (header.reserved.edit(f"{grid}.reserved", 1), header.reserved.edit("directory[0].reserved[0]", 1)),
        ),
        (
            "invalid-two-grid-fields",
            "an origin, and scale_mantissa",
            (
                header.position_grid.edit(f"{grid}.origin[2]", 1 << 62),
                header.position_grid.edit(f"{grid}.scale_mantissa", 0),
            ),
        ),
        (
            "invalid-low-pass-and-near-plane",
            "low_pass is no number, near_plane is negative",
            (
                header.render_info.edit(f"{info}.low_pass", NAN),
                header.render_info.edit(f"{info}.near_plane", -1.0),
            ),
        ),
        (
            "invalid-alpha-and-unit",
            "alpha_max is no number, distance_unit is 0",
            (
                header.render_info.edit(f"{info}.alpha_max", NAN),
                header.render_info.edit(f"{info}.distance_unit", 0.0),
            ),
        ),
        (
            "malformed-late-type-and-early-unknown",
            "a type that is none at the end, and an unknown critical section at the beginning",
            (directory.type_byte.edit(6, 3, 0x5F), directory.unknown_section.edit(0, b"ZZZZ")),
        ),
        (
            "unsupported-unknown-and-early-order",
            "an unknown critical section at the end, and the order of the first ones",
            (directory.unknown_section.edit(6, b"MORE"), directory.types.edit({0: b"WGTS"}, 0)),
        ),
        (
            "unsupported-late-mode-and-early-length",
            "the mode of the data, and the length of the frame",
            (directory.mode.edit(4, 9), directory.stated_length.edit(0, 84)),
        ),
        (
            "malformed-two-lengths",
            "the lengths of the weights, and of an ancillary section",
            (directory.stated_length.edit(1, 4), directory.stated_length.edit(5, (1 << 64) - 1)),
        ),
    ]
    for identifier, title, pair in rows:
        book.ordered(identifier, title, several(plain, *pair))
    among: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "unsupported-reserved-and-grid",
            "reserved, and the grid's reserved",
            (header.reserved.edit("reserved", 1), header.reserved.edit(f"{grid}.reserved", 1)),
        ),
        (
            "unsupported-reserved-of-render-info-and-dimensions",
            "the render information's reserved, and that of the dimensions",
            tuple(header.reserved.edit(f"{struct}.reserved", 1) for struct in ("render_info", "dimensions")),
        ),
        (
            "invalid-view-inputs-and-colour-outputs",
            "view_inputs and colour_outputs of another render model",
            tuple(limits.dimension.edit(name, 1) for name in ("view_inputs", "colour_outputs")),
        ),
        ("invalid-two-lanes", "mask_lanes_log2 and attribute_lanes_log2", _lanes("mask", "attribute")),
        ("invalid-lanes-of-planes-and-masks", "plane_lanes_log2 and mask_lanes_log2", _lanes("plane", "mask")),
        (
            "invalid-alpha-and-low-pass",
            "alpha_max is 2, low_pass is negative",
            (header.render_info.edit(f"{info}.alpha_max", 2.0), header.render_info.edit(f"{info}.low_pass", -1.0)),
        ),
        ("invalid-lengths-infinite", "near_plane and distance_unit are infinite", _lengths(INFINITY)),
        ("invalid-lengths-zero", "near_plane and distance_unit are 0", _lengths(0.0)),
    ]
    for identifier, title, pair in among:
        book.ordered(identifier, title, several(plain, *pair), features="order header")


def _lanes(*names: str) -> tuple[Part, ...]:
    """Returns faults of the lane counts of some kinds."""
    return tuple(header.lanes.edit(f"{name}_lanes_log2", 9) for name in names)


def _lengths(value: float) -> tuple[Part, ...]:
    """Both lengths of the render information."""
    names = ("near_plane", "distance_unit")
    return tuple(header.render_info.edit(f"render_info.{name}", value) for name in names)


def _ends(book: Book) -> None:
    """Adds files with a wrong end and an earlier fault: the end is not checked first."""
    rows: list[tuple[str, str, Callable[[], Refused], int]] = [
        ("malformed-header-crc-and-end", "the header's CRC-32", header.header_byte.of(plain, 0, 1), 1),
        ("unsupported-profile-and-end", "the profile", limits.profile.of(plain, "profile", 9), 1),
        ("unsupported-unknown-and-end", "an unknown section", directory.unknown_section.of(plain, 0, b"ZZZZ"), 1),
        ("malformed-length-and-end", "the length of the frame", directory.stated_length.of(plain, 0, 92), 1),
        ("invalid-frame-and-end", "the frame", frame.number.of(plain, "frame.shift[0]", 61), 1),
        (
            "malformed-crc-and-end",
            "the CRC-32 of an ancillary section",
            directory.section_byte.of(strewn, b"moRE", 0, 1),
            1,
        ),
        ("malformed-last-crc-and-padding", "the last section's CRC-32", directory.section_crc.of(strewn, 10, 5), -1),
        ("malformed-last-crc-and-trailing", "the last section's CRC-32", directory.section_crc.of(strewn, 10, 5), -4),
        ("malformed-data-crc-and-trailing", "the CRC-32 of the data", directory.section_crc.of(plain, 4, 5), -4),
    ]
    for identifier, title, make, cut in rows:
        other = "bytes behind the file" if cut < 0 else "a file that is cut"
        other = "padding that is not zero" if cut == -1 else other
        book.ordered(identifier, f"{title}, and {other}", partial(_ended, make, cut))


def _ended(make: Callable[[], Refused], cut: int) -> Refused:
    """Returns the file without its last bytes, or with more if cut is negative; -1: with another last byte."""
    made = make()
    data = made.data[:-cut] if cut > 0 else made.data[:-1] + b"\1" if cut == -1 else made.data + bytes(-cut)
    return replace(made, data=data)


def _dimensions(book: Book) -> None:
    make = several(plain, limits.dimension.edit("offset_count", 0), limits.dimension.edit("plane_channels", 0))
    book.ordered("invalid-two-dimensions", "offset_count, and plane_channels", make)
    # Level 1 would suffice for the anchors and planes of main_file.
    level = limits.level_too_high.edit(2, 0, 2)
    make = several(main_file, limits.too_many_anchors.edit((1 << 20) + 1), level)
    book.ordered("invalid-anchors-and-level", "too many anchors, and a level that is too high", make)
    make = several(main_file, level, limits.chunk_size.edit("chunk_size", 1))
    book.ordered("invalid-level-and-chunk-size", "a level that is too high, and chunk_size", make)
    features = limits.many_features.edit(64, 63, 1, 1)
    many, size = "129 features", "a plane_size that the level does not allow"
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "channels-and-features",
            f"plane_channels, and {many}",
            (limits.dimension.edit("plane_channels", 17), features),
        ),
        (
            "render-width-and-slices",
            "render_width, and an item of slice_width",
            (limits.dimension.edit("render_width", 129), limits.dimension.edit("slice_width[0]", 65)),
        ),
        (
            "width-and-features",
            f"a width of CARM, and {many}",
            (limits.dimension.edit("carm_width[0]", 129), features),
        ),
        (
            "features-and-plane-size",
            f"{many}, and {size}",
            (features, limits.dimension.edit("plane_size", 200)),
        ),
        (
            "features-and-no-planes",
            f"{many}, and planes of no size",
            (features, limits.dimension.edit("plane_size", 0)),
        ),
        (
            "plane-size-and-anchors",
            f"{size}, and too many anchors",
            (limits.dimension.edit("plane_size", 200), limits.too_many_anchors.edit((1 << 17) + 1)),
        ),
    ]
    for name, title, pair in rows:
        book.ordered(f"invalid-{name}", title, several(main_file, *pair), "R11.1-2")
    nothing = (limits.dimension.edit("render_width", 0), limits.dimension.edit("plane_size", 2))
    make = several(planeless, *nothing)
    book.ordered("invalid-width-and-no-planes", "render_width, and planes of no channels", make, "R11.1-2")
