"""Cases of clause 10.1: two faults of a file, the first of which must be reported.

The order of checks is the order of the file, but for lengths and ends. A chain has the faults of neighbouring checks.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from refcodec.bitstream import codec
from refcodec.bitstream.directory import DATA, FRAME, INDEX, PLANES_SECTION, WEIGHTS
from refcodec.bitstream.header import MAJOR, Lanes
from refcodec.bitstream.scene import Scene

from . import attributes, chunks, context, directory, header, index, limits, networks, planes, positions, weights_packed
from . import entropy_substreams as substreams
from . import entropy_symbols as symbols
from .checksums import Depth, repair
from .fault import element
from .numbers import Numbers
from .scenes import SMALLEST, lattice, placed, scene, settled
from .table import chain, ordered, refused
from .target import Target
from .targets import (
    ATTRIBUTES_0,
    bare,
    bare_packed,
    far,
    five_cells,
    grids,
    later_main,
    main_file,
    packed,
    plain,
    planeless,
    strewn,
    target_of,
)
from .weights import packed_weights, with_weights

# The header_length is 0, and the prologue's CRC-32 is not repaired.
_no_header = element("prologue.header_length", "prologue.{}", right=Depth.NOTHING)
# A file whose substream of attributes has a lane without symbols, and one of five anchors in one packed chunk with 16.
_idle = target_of(lambda: scene("planted-idle", 3, lanes=Lanes(0, 0, 8)))
_idle_cells = target_of(
    lambda: placed("outside-cells", lattice(Numbers("outside-cells"), 5), chunk_size=5, lanes=Lanes(0, 4, 0))
)


@target_of
def _two_raw() -> Scene:
    """A file in mode 1 whose layers hyper.0 and opacity.0 are raw."""
    made = scene("outside-two-raw", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    return packed_weights(settled(with_weights(made, *((name, 0, None, -0.0) for name in ("hyper.0", "opacity.0")))))


def _put(data: bytes, at: int, value: int) -> bytes:
    """Returns a file with another byte."""
    return data[:at] + bytes([value]) + data[at + 1 :]


def _end(chunk: int) -> int:
    """Returns a place within a chunk of plain."""
    return plain().chunk_at(chunk) + 20


_pairs = partial(chain, "", joint=" and ")

# fmt: off
# --- the prologue, the header and the directory -----------------------------------------------------------------------

_COUNT = ("chunk-count", "chunk_count", header.chunk_count)
_RESERVED = ("reserved", "position_grid.reserved", header.reserved, "position_grid.reserved", 1)
_RENDER = ("render-info", "render_info.low_pass", header.render_info, "render_info.low_pass", -1.0)
_PROFILE, _LATE = (limits.profile, 9), (directory.unknown_section, 0, b"ZZZZ")
_MANY = (limits.many_features, 64, 63, 1, 1)
# Level 10 would suffice for the anchors and planes of main_file.
_LEVEL = (limits.level_too_high, 20, 0, 2)
_GRID = "position_grid.reserved"
_HEADER = [
    # Neighbours in the order of checks.
    *_pairs(grids, "",
        ("syntax", "section_count", header.count_beyond_header, "section_count", 0xFFFF),
        ("padding", "the padding of the dimensions", header.padding_byte, "dimensions.padding", 0, 1),
        _RESERVED),
    *_pairs(plain, "",
        _RESERVED,
        ("profile", "profile", limits.profile, 9),
        ("level", "level", limits.level, 9),
        ("dimension", "dimensions.render_width", limits.dimension, "render_width", 0),
        ("anchor-count", "anchor_count", limits.too_many_anchors, 5000),
        ("chunk-size", "chunk_size", limits.chunk_size, 0),
        ("lanes", "attribute_lanes_log2", header.lanes, "attribute_lanes_log2", 9),
        ("base-step", "base_step[2]", header.base_step, "base_step[2]", 0.0),
        ("position-grid", "position_grid.scale_exponent", header.position_grid, "position_grid.scale_exponent", 61),
        _RENDER,
        (*_COUNT, 50),
        ("type", "directory[6].type", directory.type_byte, 6, 0, 0x2A),
        ("unknown-critical", "directory[5].type", directory.unknown_section, 5, b"ZZZZ"),
        ("order", "directory[3].type", directory.types, {3: b"FRAM"}, 3),
        ("mode", "directory[2].mode", directory.mode, 2, 1),
        ("length", "directory[1].length", directory.stated_length, 1, 3)),
    # Only Main has files whose work is more than their level allows.
    *_pairs(main_file, "", _RENDER, ("work", "the work", limits.work_of_widths), (*_COUNT, 0)),

    # The prologue and the header.
    *ordered("",
        ("signature-and-crc", "signature, and the prologue's CRC-32", (header.signature_byte, 0, 0x88),
         (header.prologue_byte, 16, 0x55)),
        ("crc-and-version", "the prologue's CRC-32, and the version", (header.prologue_byte, 8, 1),
         (_no_header, "header_length", 0)),
        ("version-and-header-length", f"version {MAJOR + 1}, and a header_length of 0", (header.version, MAJOR + 1),
         (header.header_length, 0), (header.header_byte, 10, 0x55)),
        ("header-crc-and-profile", "the header's CRC-32, and the profile", (header.header_byte, -1, 0x55), _PROFILE),
        ("reserved-and-profile-last-entry", "the last entry's reserved, and the profile",
         (header.reserved, "directory[6].reserved[2]", 1), _PROFILE),
        ("two-reserved", "the grid's reserved, and that of an entry", (header.reserved, _GRID, 1),
         (header.reserved, "directory[0].reserved[0]", 1)),
        ("two-grid-fields", "an origin, and scale_mantissa", (header.position_grid, "position_grid.origin[2]", 1 << 62),
         (header.position_grid, "position_grid.scale_mantissa", 0)),
        ("low-pass-and-near-plane", "low_pass is no number, near_plane is negative",
         (header.render_info, "render_info.low_pass", header.NAN),
         (header.render_info, "render_info.near_plane", -1.0)),
        ("alpha-and-unit", "alpha_max is no number, distance_unit is 0",
         (header.render_info, "render_info.alpha_max", header.NAN),
         (header.render_info, "render_info.distance_unit", 0.0)),
        ("late-type-and-early-unknown",
         "a type that is none at the end, and an unknown critical section at the beginning",
         (directory.type_byte, 6, 3, 0x5F), _LATE),
        ("unknown-and-early-order", "an unknown critical section at the end, and the order of the first ones",
         (directory.unknown_section, 6, b"MORE"), (directory.types, {0: b"WGTS"}, 0)),
        ("late-mode-and-early-length", "the mode of the data, and the length of the frame", (directory.mode, 4, 9),
         (directory.stated_length, 0, 84)),
        ("two-lengths", "the lengths of the weights, and of an ancillary section", (directory.stated_length, 1, 4),
         (directory.stated_length, 5, (1 << 64) - 1))),
    *ordered("",
        ("reserved-and-grid", "reserved, and the grid's reserved", (header.reserved, "reserved", 1),
         (header.reserved, _GRID, 1)),
        ("reserved-of-render-info-and-dimensions", "the render information's reserved, and that of the dimensions",
         (header.reserved, "render_info.reserved", 1), (header.reserved, "dimensions.reserved", 1)),
        ("view-inputs-and-colour-outputs", "view_inputs and colour_outputs of another render model",
         (limits.dimension, "view_inputs", 1), (limits.dimension, "colour_outputs", 1)),
        ("two-lanes", "mask_lanes_log2 and attribute_lanes_log2", (header.lanes, "mask_lanes_log2", 9),
         (header.lanes, "attribute_lanes_log2", 9)),
        ("lanes-of-planes-and-masks", "plane_lanes_log2 and mask_lanes_log2", (header.lanes, "plane_lanes_log2", 9),
         (header.lanes, "mask_lanes_log2", 9)),
        ("alpha-and-low-pass", "alpha_max is 2, low_pass is negative",
         (header.render_info, "render_info.alpha_max", 2.0), (header.render_info, "render_info.low_pass", -1.0)),
        *((f"lengths-{name}", f"near_plane and distance_unit are {text}",
           (header.render_info, "render_info.near_plane",
            value), (header.render_info, "render_info.distance_unit", value))
          for name, text, value in (("infinite", "infinite", header.INFINITY), ("zero", "0", 0.0))),
        features="order header"),

    # Dimensions and limits.
    *ordered("",
        ("two-dimensions", "offset_count, and plane_channels", (limits.dimension, "offset_count", 0),
         (limits.dimension, "plane_channels", 0)),
        ("anchors-and-level", "too many anchors, and a level that is too high", main_file,
         (limits.too_many_anchors, (1 << 20) + 1), _LEVEL),
        ("level-and-chunk-size", "a level that is too high, and chunk_size", main_file, _LEVEL,
         (limits.chunk_size, 1))),
    *ordered("R11.1-2",
        ("channels-and-features", "plane_channels, and 129 features", main_file,
         (limits.dimension, "plane_channels", 17), _MANY),
        ("render-width-and-slices", "render_width, and an item of slice_width", main_file,
         (limits.dimension, "render_width", 129), (limits.dimension, "slice_width[0]", 65)),
        ("width-and-features", "a width of CARM, and 129 features", main_file, (limits.dimension, "carm_width[0]", 129),
         _MANY),
        ("features-and-plane-size", "129 features, and a plane_size that the level does not allow", main_file, _MANY,
         (limits.dimension, "plane_size", 200)),
        ("features-and-no-planes", "129 features, and planes of no size", main_file, _MANY,
         (limits.dimension, "plane_size", 0)),
        ("plane-size-and-anchors", "a plane_size that the level does not allow, and too many anchors", main_file,
         (limits.dimension, "plane_size", 200), (limits.too_many_anchors, (1 << 17) + 1)),
        ("width-and-no-planes", "render_width, and planes of no channels", planeless,
         (limits.dimension, "render_width", 0), (limits.dimension, "plane_size", 2))),
    # The rules on several fields, and fields that stand in another order in the file.
    *ordered("R11.1-2", *(
        (name, title, main_file, (limits.dimensions_at_once, name))
        for name, (title, *_) in limits.AT_ONCE.items())),
    *ordered("R6.2-5 R6.4-1 R6.5-1 R6.2-7",
        ("grid-and-render-reserved", "reserved of the grid, and of the render information", (header.reserved, _GRID, 1),
         (header.reserved, "render_info.reserved", 1)),
        ("step-and-origin", "a base step, and an origin", (header.base_step, "base_step[2]", 0.0),
         (header.position_grid, "position_grid.origin[0]", 1 << 62)),
        ("mantissa-and-exponent", "scale_mantissa and scale_exponent",
         (header.position_grid, "position_grid.scale_mantissa", 0),
         (header.position_grid, "position_grid.scale_exponent", 61)),
        ("exponent-and-up", "scale_exponent and up_axis", (header.position_grid, "position_grid.scale_exponent", 61),
         (header.render_info, "render_info.up_axis", 6)),
        ("up-and-near", "up_axis, and a near_plane that is no number", (header.render_info, "render_info.up_axis", 6),
         (header.render_info, "render_info.near_plane", header.NAN))),
    *ordered("R6.2-3 R6.2-4",
        ("more-bytes-and-padding", "bytes after the fields of the header, and padding of the dimensions", grids,
         (header.fields_cut_or_padded, lambda t: header.fields_length(t) + 4),
         lambda data: repair(_put(data, grids().at("dimensions.padding"), 1), Depth.HEADER))),
    *ordered("R6.1-1", ("length-and-signature", "19 bytes that do not begin as a C3GS file",
                        (header.cut_in_prologue, 19), lambda data: b"\0" + data[1:])),
    *ordered("R11.2-4", ("minor-and-level", "minor version 3, and a level that is too high", later_main, _LEVEL)),
    *ordered("R6.6-7", ("empty-data-crc", "the CRC-32 of DATA, which is not 0 though there are no anchors", main_file,
                        (directory.section_crc, 4, 5))),

    # A wrong end and an earlier fault: the end is not checked first.
    *ordered("",
        *((f"{name}-and-end", f"{title}, and a file that is cut", *faulty, lambda data: data[:-1])
          for name, title, *faulty in (
              ("header-crc", "the header's CRC-32", (header.header_byte, 0, 1)), ("profile", "the profile", _PROFILE),
              ("unknown", "an unknown section",
               _LATE), ("length", "the length of the frame", (directory.stated_length, 0, 92)),
              ("frame", "the frame", (context.number, "frame.shift[0]", 61)),
              ("crc", "the CRC-32 of an ancillary section", strewn, (directory.section_byte, b"moRE", 0, 1)))),
        ("last-crc-and-padding", "the last section's CRC-32, and padding that is not zero", strewn,
         (directory.section_crc, 10, 5), lambda data: data[:-1] + b"\1"),
        ("last-crc-and-trailing", "the last section's CRC-32, and bytes behind the file", strewn,
         (directory.section_crc, 10, 5), lambda data: data + bytes(4)),
        ("data-crc-and-trailing", "the CRC-32 of the data, and bytes behind the file", (directory.section_crc, 4, 5),
         lambda data: data + bytes(4))),
]

# --- sections, chunks and substreams ----------------------------------------------------------------------------------

_far_1000, _far_300 = partial(far, 1000), symbols.other_sign.target(partial(far, 300), 0)
_CELLS, _cell_less = "positions[chunk 0]", positions.cell_less.target(_idle_cells)
# A changed symbol_crc.
_OTHER = (0, 0x55)
_SECTIONS = [
    # The CRC-32 of a section is checked before its contents, and after those of earlier sections.
    *chain("sections-", plain, "R6.6-7",
        ("frame-crc", "the CRC-32 of the frame", directory.section_byte, FRAME, 3, 0x55),
        ("frame", "the frame's range", context.number, "frame.matrix[0]", 1 << 20),
        ("weights-crc", "the CRC-32 of the weights", directory.section_byte, WEIGHTS, -1, 0x55),
        ("weights", "plane_shift", networks.scale, "plane_shift", 255),
        ("planes-crc", "the CRC-32 of the planes", directory.section_byte, PLANES_SECTION, -1, 0x55),
        ("planes", "the lengths of the planes", planes.sub_plane_lengths, {3: 4}),
        ("index-crc", "the CRC-32 of the index", directory.section_byte, INDEX, -30, 0x55),
        ("index", "the mask model", attributes.mask_model, 0, 0),
        ("chunk-crc", "the CRC-32 of chunk 0", chunks.crc, 0, 0x55)),
    *chain("ancillary-", strewn, "R6.6-7 D12.1-1",
        ("frame", "the frame's shift", context.number, "frame.shift[2]", 61),
        ("crc", "the CRC-32 of an ancillary section behind the frame", directory.section_crc,
         lambda t: t.sections[WEIGHTS].number - 1, 5),
        ("weights", "carm_shift", networks.scale, "carm_shift[0]", 17)),
    *chain("padding-", grids, "R6.6-8",
        ("crc", "the CRC-32 of the weights", directory.section_byte, WEIGHTS, 0, 0x55),
        ("padding", "padding behind the weights", directory.padding_byte, "weights, padding", 0, 1),
        ("weights", "carm_input_count", networks.scale, "carm_input_count", 9)),

    # The frame, the planes and the index.
    *chain("frame-", plain, "R6.7-1 R6.7-2",
        ("reserved", "the reserved byte", context.reserved, "frame.reserved", 1),
        ("matrix", "the last item of the matrix", context.number, "frame.matrix[8]", 1 << 20),
        ("translation", "a translation", context.number, "frame.translation[2]", 1 << 61),
        ("shift", "a shift", context.number, "frame.shift[0]", 61),
        ("low-0", "low of the first axis", context.number, "frame.low[0]", 1 << 18),
        ("high-0", "high of the first axis", context.number, "frame.high[0]", 1 << 30),
        ("low-1", "low of the second axis", context.number, "frame.low[1]", 1 << 30),
        ("high-2", "high of the last axis", context.number, "frame.high[2]", -(1 << 31))),
    *chain("planes-", plain, "R6.9-1 R6.9-2",
        ("length", "the lengths of the planes", planes.sub_plane_lengths, {1: 4}),
        ("padding", "padding behind the second sub-plane", planes.padding_byte, "planes.r2.top_left, padding", 0, 1),
        ("last-padding", "padding behind the last sub-plane", planes.padding_byte, planes.LAST_PADDING, 1, 1),
        ("first-symbols", "symbol_crc of the first sub-plane", substreams.symbol_crc, "planes.r1", *_OTHER),
        ("words", "word_count of the second one", substreams.word_count, "planes.r2.top_left", (1 << 32) - 1),
        ("state", "a state of the second one", substreams.state, "planes.r2.top_left", 1, 0),
        ("last-symbols", "symbol_crc of the last sub-plane", substreams.symbol_crc, "planes.r2.bottom_right", *_OTHER),
        ("mask-model", "the mask model", attributes.mask_model, 0, 0)),
    *chain("index-", packed, "R6.10-1 R6.10-2 R6.10-3 R6.10-4 R6.10-5 R6.10-6",
        ("mask-model", "the mask model", attributes.mask_model, 2, 0),
        ("padding", "padding of the mask model", attributes.padding_byte, "index.mask_model.padding", 0, 1),
        ("reserved", "a reserved byte of the model of positions", index.reserved, 1, 1),
        ("cell-shift", "cell_shift", index.cell_shift, 41),
        ("frequency", "a frequency of 0 in the first model", index.no_frequency, 0, 9),
        ("sum", "a wrong sum of the second model", index.frequencies, 1, {None: 1}),
        ("entry", "the kept_count of an entry", index.kept_count, 1, 7),
        ("anchors", "anchors that do not add up", index.anchors_amiss, 0, 1),
        ("lengths", "lengths that do not add up", index.lengths_amiss, {3: 4}),
        ("chunk", "a reserved byte of chunk 0", chunks.reserved, 0, 0, 1)),
    *chain("entry-", plain, "R6.10-5",
        ("anchors", "anchor_count of entry 0", index.anchor_count, 0, 0),
        ("length", "length of entry 0", index.length, 0, 2),
        ("kept", "kept_count of entry 0", index.kept_count, 0, 9),
        ("low", "low of entry 0", index.bound, 0, "low[2]", b"\x00\x7c"),
        ("high", "high of entry 0", index.bound, 0, "high[0]", b"\x00\x80"),
        ("low-above-high", "low above high in entry 0", index.low_above_high, 0, 2),
        ("next-anchors", "anchor_count of entry 1", index.anchor_count, 1, 0),
        ("last-length", "length of entry 2", index.length, 2, 0)),
    *ordered("R6.10-5",
        ("entry-bound-and-low-above-high", "a bound of the last axis that is -0, and low above high on the first",
         (index.bound, 1, "high[2]", b"\x00\x80"), (index.low_above_high, 1, 0))),

    # One chunk, including its entry's kept_count and bounds.
    *chain("chunk-", packed, "R6.11-1 R6.11-2 R6.11-3 R6.11-4 R6.11-5 R6.11-10 R6.11-11",
        ("crc", "the CRC-32 of a chunk", chunks.crc, 2, 1),
        ("reserved", "a reserved byte of its head", chunks.reserved, 2, 1, 1),
        ("form", "its form", chunks.form, 2, 7),
        ("length", "the lengths of its parts", chunks.lengths, 2, {"masks": 4}),
        ("padding", "padding behind its positions", chunks.padding_byte, "positions[chunk 2], padding", 0, 1),
        ("last-padding", "padding behind its attributes", chunks.padding_byte, "attributes[chunk 2], padding", 0, 1),
        ("zero", "a position of -0", positions.negative_zero, 2, 1),
        ("infinity", "an infinite position behind it", positions.not_finite, 2, 8, 0xFC00),
        ("bounds", "its bounds", chunks.bound, 2, "high[1]", True),
        ("mask-state", "a state of its masks", substreams.state, "masks[chunk 2]", 0, 0),
        ("masks", "symbol_crc of its masks", substreams.symbol_crc, "masks[chunk 2]", *_OTHER),
        ("kept", "its kept_count", chunks.kept_count, 2, 0),
        ("words", "words of its attributes", substreams.word_count, "attributes[chunk 2]", 1 << 31),
        ("attributes", "symbol_crc of its attributes", substreams.symbol_crc, "attributes[chunk 2]", *_OTHER),
        ("next-crc", "the CRC-32 of the next chunk", chunks.crc, 3, 1)),
    *chain("packed-chunk-", packed, "R6.11-10",
        ("padding", "padding behind the attributes of a packed chunk", chunks.padding_byte,
         "attributes[chunk 1], padding", 0, 1),
        ("state", "a state of its positions", substreams.state, "positions[chunk 1]", 1, 0),
        ("positions", "symbol_crc of its positions", substreams.symbol_crc, "positions[chunk 1]", *_OTHER),
        ("bounds", "its bounds", chunks.bound, 1, "low[0]", False),
        ("masks", "symbol_crc of its masks", substreams.symbol_crc, "masks[chunk 1]", *_OTHER)),
    *ordered("R6.11-8 R6.11-10",
        ("cells-and-bounds", "a tree with a cell less than there are anchors, and bounds", five_cells,
         (positions.cell_less,), (chunks.bound, 0, "high[2]", True))),

    # All checks of a chunk come before those of the next one, and before those after the chunks.
    *chain("chunks-", plain, "R6.11-1",
        ("first-attributes", "the attributes of chunk 0", substreams.symbol_crc, ATTRIBUTES_0, *_OTHER),
        ("second-positions", "a position of chunk 1", positions.not_finite, 1, 10, 0x7C00),
        ("last-head", "the reserved byte of chunk 2", chunks.reserved, 2, 0, 1)),
    *chain("last-chunk-", plain, "R6.6-7",
        ("second-kept", "kept_count of chunk 1", chunks.kept_count, 1, 0),
        ("last-crc", "the CRC-32 of chunk 2", chunks.crc, 2, 0x55),
        ("data-crc", "the CRC-32 of the data, which is not 0", directory.section_crc, 4, 1),
        ("behind-crc", "the CRC-32 of a section behind it", directory.section_crc, 5, 5)),
    *ordered("",
        ("attributes-and-first-mask", "the first attributes, and the last masks",
         (substreams.state, ATTRIBUTES_0, 0, 0), (substreams.symbol_crc, "masks[chunk 2]", *_OTHER)),
        ("last-attributes-and-data-crc", "the last attributes, and the CRC-32 of the data, which is not 0",
         (substreams.symbol_crc, "attributes[chunk 2]", *_OTHER), (directory.section_crc, 4, 1)),
        ("masks-and-position", "the masks of chunk 0, and a position of chunk 1",
         (substreams.symbol_crc, "masks[chunk 0]", *_OTHER), (positions.negative_zero, 1, 0)),
        ("bounds-and-next-crc", "the bounds of chunk 0, and the CRC-32 of chunk 1", (chunks.bound, 0, "high[2]", True),
         (chunks.crc, 1, 1))),
    # A file ends within a chunk, after an earlier fault: the end is not checked first.
    *ordered("R6.6-6",
        *((f"{name}-and-cut", f"{title}, and a file that ends within chunk {chunk}", first,
           lambda data, chunk=chunk: data[: _end(chunk)])
          for name, title, first, chunk in (
              ("index", "the model of masks", (attributes.mask_model, 0, 0), 0),
              ("lengths", "lengths that do not add up", (index.lengths_amiss, {0: 4}), 1),
              ("crc", "the CRC-32 of chunk 0", (chunks.crc, 0, 1), 1),
              ("attributes", "the attributes of chunk 0", (substreams.symbol_crc, ATTRIBUTES_0, *_OTHER), 1),
              ("kept", "kept_count of chunk 1", (chunks.kept_count, 1, 0), 2))),
        ("cut-and-crc", "a file that ends within chunk 1, whose CRC-32 is wrong", chunks.crc.target(plain, 1, 1),
         (directory.cut, lambda t: _end(1)))),

    # The end of a substream.
    *refused("order substream", "order-of-checks",
        ("order-of-words-and-state", "a word that no lane takes, and a lane that does not end at 2^16",
         substreams.idle_lane.target(_idle, ATTRIBUTES_0), substreams.more_words, ATTRIBUTES_0,
         1), requirements="D8.8-2 D10.2-3"),
    *ordered("D8.8-2",
        ("words-and-escape", "a word too many, and an escape of zeros", symbols.escape_of_zeros.target(_far_1000, 320),
         (substreams.more_words, ATTRIBUTES_0, 1)),
        ("state-and-escape", "a final state, and an escape of zeros", symbols.escape_of_zeros.target(_far_1000, 48),
         (substreams.used_lane, ATTRIBUTES_0, 2)),
        ("escape-and-raw-length", "an escape of zeros, and raw bytes that nothing reads", _far_1000,
         (symbols.escape_of_zeros, 800)),
        ("range-and-raw-length", "a symbol out of range, and raw bytes that nothing reads", _far_1000,
         (symbols.far_escape, 23, 0, False, 800)),
        ("padding-and-crc", "a padding bit, and symbol_crc", _far_300, (symbols.padding_bit, 23)),
        ("raw-length-and-crc", "a raw byte more, and symbol_crc", _far_300, (substreams.raw_bytes, ATTRIBUTES_0)),
        features="order substream"),
    *ordered("R6.11-8 D8.8-2", *(
        (f"{name}-and-cells", f"{text}, and a cell less than there are anchors", _cell_less, fault)
        for name, text, fault in (
            ("words", "a word that no lane takes", (substreams.more_words, _CELLS, 1)),
            ("final-state", "a lane that does not end at 2^16", (substreams.idle_lane, _CELLS)),
            ("raw-length", "a raw byte that nothing reads", (substreams.raw_bytes, _CELLS)),
            ("symbol-crc", "a CRC-32 of other symbols", (substreams.symbol_crc, _CELLS, 0, 1))))),
]

# --- weights ----------------------------------------------------------------------------------------------------------

_NONE = (networks.not_finite, "hyper.0", 0, 0, networks.NOT_A_NUMBER)
_LATER_NONE = (networks.not_finite, "opacity.0", 0, 0, networks.NOT_A_NUMBER)
_BOUND = (networks.large_value, "hyper.0", 0, 0, 4096.0)
_PLANES = (planes.sub_plane_lengths, {0: 4})
_WEIGHTS = [
    # Mode 0.
    *chain("weights-", plain, "R6.8-1 R6.8-3 R6.8-4",
        ("plane-shift", "plane_shift", networks.scale, "plane_shift", 11),
        ("carm-input-count", "carm_input_count", networks.scale, "carm_input_count", 0),
        ("carm-shift", "a carm_shift", networks.scale, "carm_shift[0]", 17),
        ("later-carm-shift", "a later carm_shift", networks.scale, "carm_shift[1]", 255),
        ("not-finite", "a weight that is no number", *_NONE),
        ("later-not-finite", "a later one that is no number", networks.not_finite, "colour.1", 5, None,
         networks.NOT_A_NUMBER),
        ("bound", "a row of F_h at no exponent", networks.large_value, "hyper.0", 1, 0, 1e9),
        ("later-bound", "a row of CARM at no exponent", networks.large_value, "carm.1.1", 0, 0, 1e9),
        ("planes", "the lengths of the planes", *_PLANES)),
    *chain("weights-padding-", five_cells, "R6.8-1 R6.8-2 R6.8-3",
        ("plane-shift", "plane_shift", networks.scale, "plane_shift", 11),
        ("padding", "padding behind the table of scales", networks.padding_byte, "weights.padding", 0, 1),
        ("not-finite", "a weight that is no number", *_NONE)),

    # Mode 1.
    *chain("packed-weights-", grids, "R6.8-1 R6.8-2 R6.8-6 R6.8-7",
        ("scale", "plane_shift", networks.scale, "plane_shift", 11),
        ("padding", "padding behind the table of scales", networks.padding_byte, "weights.padding", 1, 1),
        ("reserved", "a reserved byte of the first layer", weights_packed.reserved, "hyper.0", 0, 1),
        ("form", "the form of the first layer", weights_packed.model_field, "hyper.0", "form", 2),
        ("reserved-1", "a reserved byte of the second layer", weights_packed.reserved, "hyper.1", 1, 1),
        ("form-1", "the form of the second layer", weights_packed.model_field, "hyper.1", "form", 255),
        ("exponent-1", "the exponent of the second layer", weights_packed.model_field, "hyper.1", "exponent", 150),
        ("last-form", "the form of the last layer", weights_packed.model_field, "colour.1", "form", 3),
        ("state", "a state of the weights", substreams.state, "weights", 0, 0),
        ("symbols", "symbol_crc of the weights", substreams.symbol_crc, "weights", 0, 0x55),
        ("not-finite", "a raw number that is none", *_NONE),
        ("planes", "the lengths of the planes", *_PLANES), features="order packed-weights"),
    *chain("raw-layer-", grids, "R6.8-7",
        ("exponent-outside", "an exponent of 150 in a raw layer", weights_packed.model_field, "hyper.0", "exponent",
         150),
        ("exponent-scale", "a scale of exponents", weights_packed.model_field, "hyper.0", "exponent_scale", 1),
        ("exponent", "an exponent of 5", weights_packed.model_field, "hyper.0", "exponent", 5),
        ("weight-scale", "a scale of weights", weights_packed.model_field, "hyper.0", "weight_scale", 1),
        ("bias-scale", "a scale of biases", weights_packed.model_field, "hyper.0", "bias_scale", 1),
        features="order packed-weights"),
    *ordered("R6.8-5", *(
        (name, f"{text}, and the section's end", grids, first, (weights_packed.cut, *end))
        for name, text, first, end in (
            ("scale-and-no-model", "plane_shift", (networks.scale, "plane_shift", 11), ("hyper.0", 0)),
            ("carm-input-count-and-no-model",
             "carm_input_count 255, by which the table would be longer than the section",
             (networks.scale, "carm_input_count", 255), (None, 4)),
            ("padding-and-no-model", "padding of the table", (networks.padding_byte, "weights.padding", 0, 1),
             ("hyper.0", 0)),
            ("reserved-and-values", "a reserved byte", (weights_packed.reserved, "hyper.0", 0, 1), ("hyper.0", 9)),
            ("form-and-later-model", "a form", (weights_packed.model_field, "hyper.0", "form", 2), ("sarm.1", 5)),
            ("raw-exponent-and-values", "exponent in a raw layer",
             (weights_packed.model_field, "hyper.0", "exponent", 5), ("hyper.0", 9)),
            ("raw-weight-scale-and-values", "weight_scale in a raw layer",
             (weights_packed.model_field, "hyper.0", "weight_scale", 5), ("hyper.0", 9)))),
        features="order packed-weights"),

    # Faults after the substream: those of layers in order, then bounds.
    *ordered("R6.8-3 R6.8-4 R6.8-8",
        ("layers-not-finite-and-exponent", "a raw layer with a number that is none, and an exponent of a later one",
         weights_packed.even_integers.target(_two_raw, "hyper.1"), _NONE),
        ("layers-exponent-and-not-finite", "an exponent, and a later raw layer with a number that is none", _two_raw,
         (weights_packed.even_integers, "hyper.1"), _LATER_NONE),
        ("layers-exponent-and-bound", "an exponent, and an earlier raw layer that breaks the bound", _two_raw,
         (weights_packed.even_integers, "colour.0"), _BOUND),
        ("layers-not-finite-and-bound",
         "a raw layer with a number that is none, and an earlier one that breaks the bound", _two_raw, _LATER_NONE,
         _BOUND),
        ("layers-bound-and-planes", "a raw layer that breaks the bound, and the lengths of the planes", _two_raw,
         _BOUND, _PLANES), features="order packed-weights"),
]

# --- neighbours that the chains do not have (spec/neighbours.py) ------------------------------------------------------

_far_idle = target_of(lambda: replace(codec.parse(far(1000).data).scene, lanes=Lanes(0, 0, 3)))
_EVEN, _LAST = weights_packed.even_integers, "planes.r2.bottom_right"
_HIGH, _ENTRY = (context.number, "frame.high[2]", -(1 << 31)), (index.anchor_count, 0, 0)
_PLANES_CRC = (directory.section_byte, PLANES_SECTION, -1, 0x55)


def _cut(base: Callable[[], Target], section: bytes, more: int) -> Callable[[bytes], bytes]:
    """Returns a function that cuts a file some bytes behind the start of a section."""
    return lambda data: data[: base().start(section) + more]


_NEIGHBOURS = [
    *ordered("",
        ("header-crc-and-section-count", "the header's CRC-32, and a section_count beyond the header",
         (header.header_byte, 3, 0x7F)),
        ("reserved-of-two-entries", "reserved of two entries", (header.reserved, "directory[0].reserved[0]", 1),
         (header.reserved, "directory[6].reserved[2]", 1)),
        ("two-base-steps", "two base steps", (header.base_step, "base_step[0]", 0.0),
         (header.base_step, "base_step[2]", 0.0)),
        ("two-origins", "two origins", (header.position_grid, "position_grid.origin[0]", 1 << 62),
         (header.position_grid, "position_grid.origin[2]", 1 << 62)),
        ("two-types", "the types of two sections", (directory.type_byte, 3, 0, 0x2A),
         (directory.type_byte, 6, 3, 0x5F)),
        ("two-unknown", "two unknown critical sections", (directory.unknown_section, 5, b"ZZZZ"),
         (directory.unknown_section, 6, b"MORE")),
        ("two-modes", "the modes of two sections", (directory.mode, 0, 1), (directory.mode, 2, 1)),
        ("no-data-and-mode", "no DATA, and the mode of the weights", (directory.few_sections, 4),
         lambda data: repair(_put(data, plain().at("directory[1].mode"), 9), Depth.HEADER)),
        features="order header directory"),
    *ordered("R6.7-2", *(
        (f"frame-two-of-{name}", f"two items of {name}", (context.number, f"frame.{name}[0]", value),
         (context.number, f"frame.{name}[2]", value))
        for name, value in (("matrix", 1 << 20), ("translation", 1 << 61), ("shift", 61)))),
    *ordered("R6.8-1 R6.8-2",
        ("shift-and-padding", "a carm_shift, and padding of the table of scales", bare,
         (networks.scale, "carm_shift[2]", 17), (networks.padding_byte, "weights.padding", 0, 1)),
        ("input-count-and-padding", "carm_input_count without CARM, and padding of the table of scales", five_cells,
         (networks.scale, "carm_input_count", 1), (networks.padding_byte, "weights.padding", 0, 1))),
    *ordered("R6.8-8",
        ("two-exponents", "exponents of two layers", grids, (_EVEN, "hyper.1 opacity.0")),
        ("weights-symbols-and-exponent", "symbol_crc of the weights, and an exponent", _EVEN.target(grids, "hyper.1"),
         (substreams.symbol_crc, "weights", *_OTHER))),
    *ordered("R6.9-2 R6.10-1 R6.10-2 R6.10-4 R6.10-5 R6.10-6",
        ("planes-padding-and-words", "padding behind the last sub-plane, and word_count of the first one",
         (planes.padding_byte, planes.LAST_PADDING, 1, 1), (substreams.word_count, "planes.r1", (1 << 32) - 1)),
        ("two-mask-models", "two frequencies of the mask model", (attributes.mask_model, 0, 0),
         (attributes.mask_model, 2, 0)),
        ("position-model-and-entry", "a sum of the model of positions, and anchor_count of an entry", packed,
         (index.frequencies, 1, {None: 1}), _ENTRY),
        ("index-padding-and-entry", "padding of the mask model, and anchor_count of an entry",
         (attributes.padding_byte, "index.mask_model.padding", 0, 1), _ENTRY),
        ("index-padding-and-lengths", "padding of the mask model, and data without chunks",
         index.data_amiss.target(bare, bytes(4)), (attributes.padding_byte, "index.mask_model.padding", 0, 1)),
        ("position-model-and-lengths", "a sum of the model of positions, and data without chunks",
         index.data_amiss.target(bare_packed, bytes(4)), (index.frequencies, 1, {None: 1})),
        ("lengths-and-data-crc", "data without chunks, and their CRC-32",
         directory.section_crc.target(bare, 4, 5), (index.data_amiss, bytes(4)))),
    *ordered("R6.11-5 R6.11-6 R6.11-7 D8.8-2",
        ("chunk-padding-and-words", "padding behind the attributes of a packed chunk, and word_count of its positions",
         packed, (chunks.padding_byte, "attributes[chunk 1], padding", 0, 1),
         (substreams.word_count, "positions[chunk 1]", 1 << 31)),
        ("chunk-padding-and-infinity", "padding behind the attributes, and an infinite position", packed,
         (chunks.padding_byte, "attributes[chunk 2], padding", 0, 1), (positions.not_finite, 2, 1, 0x7C00)),
        ("chunk-bounds-and-words", "its bounds, and word_count of its masks", packed,
         (chunks.bound, 2, "high[1]", True), (substreams.word_count, "masks[chunk 2]", 1 << 31)),
        ("infinity-and-zero", "an infinite position, and one of -0 behind it", packed,
         (positions.not_finite, 2, 1, 0x7C00), (positions.negative_zero, 2, 8)),
        ("idle-state-and-escape", "a final state of a lane without symbols, and an escape of zeros",
         symbols.escape_of_zeros.target(_far_idle, 48), (substreams.idle_lane, ATTRIBUTES_0)),
        ("raw-length-and-padding", "a raw byte more, of which all bits are set", _far_300,
         (substreams.raw_bytes, ATTRIBUTES_0, b"\xff"))),

    # A section, and the next one.
    *ordered("R6.6-6 R6.6-7 R6.6-8",
        ("frame-end-and-crc", "the last number of the frame, and the CRC-32 of the weights", _HIGH,
         (directory.section_byte, WEIGHTS, -1, 0x55)),
        ("frame-end-and-cut", "the last number of the frame, and a file that ends within the weights", _HIGH,
         _cut(plain, WEIGHTS, 8)),
        *((f"{name}-and-planes-{end}", f"{text}, and {title} the planes", base, first, second)
          for name, text, base, first in (
              ("bound", "a row at no exponent", plain, (networks.large_value, "carm.1.1", 0, 0, 1e9)),
              ("not-finite", "a weight that is no number", plain, _NONE),
              ("exponent", "an exponent", grids, (_EVEN, "hyper.1")))
          for end, title, second in (
              ("crc", "the CRC-32 of", _PLANES_CRC),
              ("cut", "a file that ends within", _cut(base, PLANES_SECTION, 8)))),
        ("planes-and-index-cut", "symbol_crc of the last sub-plane, and a file that ends within the index",
         (substreams.symbol_crc, _LAST, *_OTHER), _cut(plain, INDEX, 8)),
        ("index-and-cut", "anchors that do not add up, and a file that ends before the data", strewn,
         (index.anchors_amiss, 0, 1), _cut(strewn, DATA, -1)),
        ("two-crcs", "the CRC-32 of the frame, and of the weights", (directory.section_byte, FRAME, 3, 0x55),
         (directory.section_byte, WEIGHTS, -1, 0x55)),
        ("ancillary-crc-and-chunk-cut", "the CRC-32 of a section before the data, and a file that ends within them",
         strewn, (directory.section_crc, lambda t: t.sections[DATA].number - 1, 5), _cut(strewn, DATA, 8)),
        ("padding-and-weights-length", "padding behind weights, which are too short",
         weights_packed.cut.target(grids, None, 3), (directory.padding_byte, "weights, padding", 0, 1)),
        ("padding-and-planes-length", "padding behind planes, which are too short", planes.cut.target(plain, 19),
         (directory.padding_byte, "planes, padding", 0, 1)),
        *((f"padding-and-{name}", f"padding of an ancillary section, and {title}", strewn,
           (directory.padding_byte, path, 0, 1), other)
          for name, title, path, other in (
              ("chunk-cut", "a file that ends within the data", "noTE[8], padding", _cut(strewn, DATA, 8)),
              ("next-crc", "the next CRC-32", "noTE[2], padding", (directory.section_byte, WEIGHTS, -1, 0x55)),
              ("next-cut", "a file that ends within the next one", "noTE[2], padding", _cut(strewn, WEIGHTS, 8)),
              ("trailing", "bytes behind the file", "noTE[10], padding", lambda data: data + bytes(4))))),
]

CASES = [*_HEADER, *_SECTIONS, *_WEIGHTS, *_NEIGHBOURS]
