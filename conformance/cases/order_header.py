"""Cases of clause 10.1, steps 1 to 3: two faults of the prologue, the header or the directory.

The first in the order of checks counts, wherever in the file it is.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from . import directory, header, limits
from .book import Book
from .checksums import Depth
from .fault import Edit, Fault, Part, several
from .header import INFINITY, NAN
from .targets import main_file, plain


def add(book: Book) -> None:
    """Adds the vectors."""
    _prologue(book)
    _neighbours(book)
    _header(book)
    _dimensions(book)


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


def _neighbours(book: Book) -> None:
    """Each check of the header with the one after it."""
    checks: list[tuple[str, str, Fault[...], tuple[Any, ...]]] = [
        ("malformed", "position_grid.reserved", header.reserved, ("position_grid.reserved", 1)),
        ("unsupported", "profile", limits.profile, ("profile", 9)),
        ("unsupported", "level", limits.level, ("level", 9)),
        ("invalid", "dimensions.render_width", limits.dimension, ("render_width", 0)),
        ("invalid", "anchor_count", limits.too_many_anchors, (5000,)),
        ("invalid", "chunk_size", limits.chunk_size, ("chunk_size", 0)),
        ("invalid", "attribute_lanes_log2", header.lanes, ("attribute_lanes_log2", 9)),
        ("invalid", "base_step[2]", header.base_step, ("base_step[2]", 0.0)),
        ("invalid", "position_grid.scale_exponent", header.position_grid, ("position_grid.scale_exponent", 61)),
        ("invalid", "render_info.camera_height", header.render_info, ("render_info.camera_height", 0)),
        ("unsupported", "directory[8].type", directory.unknown_section, (8, 0xC5)),
        ("malformed", "directory[7].type", directory.types, ({7: 0}, 7)),
        ("unsupported", "directory[4].mode", directory.mode, (4, 2)),
        ("malformed", "directory[1].offset", directory.offset, (1, 3)),
    ]
    for (klass, path, one, args), (_, other_path, other, other_args) in pairwise(checks):
        name = "-and-".join(made.error.partition(".")[2].replace("_", "-") for made in (one, other))
        make = several(plain, one.edit(*args), other.edit(*other_args))
        book.ordered(f"{klass}-{name}", f"{path} and {other_path}", make)


def _header(book: Book) -> None:
    info, grid = "render_info", "position_grid"
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "malformed-reserved-and-profile-last-entry",
            "the last entry's reserved, and the profile",
            (header.reserved.edit("directory[8].reserved", 1), limits.profile.edit("profile", 9)),
        ),
        (
            "malformed-two-reserved",
            "reserved_1, and the grid's reserved and that of an entry",
            (header.reserved.edit("reserved_1", 1), header.reserved.edit("directory[0].reserved", 1)),
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
            "invalid-translation-and-focal",
            "camera_translation is no number, camera_focal is negative",
            (
                header.render_info.edit(f"{info}.camera_translation[2]", NAN),
                header.render_info.edit(f"{info}.camera_focal[0]", -1.0),
            ),
        ),
        (
            "invalid-size-and-focal",
            "camera_height is 0, camera_focal is no number",
            (
                header.render_info.edit(f"{info}.camera_height", 0),
                header.render_info.edit(f"{info}.camera_focal[0]", NAN),
            ),
        ),
        (
            "unsupported-unknown-and-early-order",
            "an unknown critical section at the end, and the order of the first ones",
            (directory.unknown_section.edit(8, 0x90), directory.types.edit({0: 0x82}, 0)),
        ),
    ]
    for identifier, title, pair in rows:
        book.ordered(identifier, title, several(plain, *pair))
    among: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "malformed-reserved-and-grid",
            "reserved_0, and the grid's reserved",
            (header.reserved.edit("reserved_0", 1), header.reserved.edit(f"{grid}.reserved", 1)),
        ),
        (
            "invalid-width-and-height",
            "camera_width and camera_height are 0",
            (
                header.render_info.edit(f"{info}.camera_width", 0),
                header.render_info.edit(f"{info}.camera_height", 0),
            ),
        ),
        ("invalid-lengths-infinite", "near_plane and distance_unit are infinite", _lengths(INFINITY)),
        ("invalid-lengths-zero", "near_plane and distance_unit are 0", _lengths(0.0)),
    ]
    for identifier, title, pair in among:
        book.ordered(identifier, title, several(plain, *pair), features="order header")


def _lengths(value: float) -> tuple[Part, ...]:
    """Both lengths of the render information."""
    names = ("near_plane", "distance_unit")
    return tuple(header.render_info.edit(f"render_info.{name}", value) for name in names)


def _dimensions(book: Book) -> None:
    make = several(plain, limits.dimension.edit("offset_count", 0), limits.dimension.edit("plane_channels", 0))
    book.ordered("invalid-two-dimensions", "offset_count, and plane_channels", make)
    # With so few anchors and planes as main_file has, level 1 would do.
    level = limits.level_too_high.edit(2, 0, 2)
    make = several(main_file, limits.too_many_anchors.edit((1 << 20) + 1), level)
    book.ordered("invalid-anchors-and-level", "too many anchors, and a level that is too high", make)
    make = several(main_file, level, limits.chunk_size.edit("chunk_size", 1))
    book.ordered("invalid-level-and-chunk-size", "a level that is too high, and chunk_size", make)
    other_slices = limits.slices_of_main.edit(5, 10, 15, 19)
    slices, size = "slices that are not those of Main", "a plane_size that the level does not allow"
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "channels-and-slices",
            f"plane_channels, and {slices}",
            (limits.dimension.edit("plane_channels", 7), other_slices),
        ),
        (
            "render-width-and-slices",
            f"render_width, and {slices}",
            (limits.dimension.edit("render_width", 49), other_slices),
        ),
        (
            "render-width-and-plane-size",
            f"render_width, and {size}",
            (limits.dimension.edit("render_width", 49), limits.dimension.edit("plane_size", 200)),
        ),
        (
            "slices-and-plane-size",
            f"{slices}, and {size}",
            (other_slices, limits.dimension.edit("plane_size", 200)),
        ),
    ]
    for name, title, pair in rows:
        book.ordered(f"invalid-{name}", title, several(main_file, *pair), "R11.1-2")
