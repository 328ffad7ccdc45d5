"""Cases of checks that a decoder may make in some files only, or of numbers that it may read with too few bits.

Each check of the blocks fails in a file of a later minor version. All but those of chunks fail in one without anchors.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from refcodec.bitstream.header import PositionGrid

from . import CHAPTERS, attributes, directory, header, index, limits, planes, positions, weights_packed
from . import entropy_substreams as substreams
from .samplers import drawn
from .scenes import SMALLEST, f16, scene
from .table import Row, again, label_of, refused, valid
from .target import Target
from .targets import ATTRIBUTES_0, bare, bare_packed, far, grids, later_main, plain

# The rows of the modules before this one.
_BEFORE = CHAPTERS[: CHAPTERS.index("elsewhere")]
_ROWS = [row for name in _BEFORE for row in import_module(f"{__package__}.{name}").CASES]
# The rows whose faults are also those of files of minor version 1, and of such files without anchors.
_NAMES = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))


def _above(path: str, bits: int) -> Callable[[Target], int]:
    """Returns a function that returns the value of an element with a bit more."""
    return lambda t: int(t.value(path)) + (1 << bits)


# fmt: off
# A fault, the bits of its field, the elements, and the part of their paths that the fault does not take.
_WIDE: tuple[tuple[Any, tuple[int, ...], str, str], ...] = (
    (header.header_length, (16, 24, 31), "", "prologue.header_length"),
    (limits.profile, (7,), "", "profile"),
    (limits.level, (7,), "", "level"),
    (header.count_beyond_header, (8, 15), "section_count", "{}"),
    (header.count_beyond_header, (7,), "dimensions.slice_count dimensions.hyper_layers dimensions.sarm_layers "
     "dimensions.carm_layers", "{}"),
    (limits.too_many_anchors, (24, 31), "", "anchor_count"),
    (header.chunk_count, (16, 24, 31), "", "chunk_count"),
    (limits.chunk_size, (24, 31), "", "chunk_size"),
    (header.lanes, (7,), "plane_lanes_log2 mask_lanes_log2 attribute_lanes_log2", "{}"),
    (header.reserved, (7,), "reserved position_grid.reserved render_info.reserved dimensions.reserved", "{}"),
    (header.render_info, (7,), "render_info.up_axis", "{}"),
    (limits.dimension, (7,), "offset_count plane_channels frequency_count view_inputs colour_outputs slice_width[0]",
     "dimensions.{}"),
    (limits.dimension, (15,), "plane_size render_width hyper_width[0] sarm_width[0] carm_width[0]", "dimensions.{}"),
    (attributes.mask_model, (15,), "0", "index.mask_model.frequency[{}]"),
    (index.anchor_count, (16, 24, 31), "0", "index.entry[{}].anchor_count"),
    (index.kept_count, (16, 24, 31), "0", "index.entry[{}].kept_count"))


def _wide() -> Iterator[Row]:
    """Yields a file for each highest bit of a stored integer that is set besides those of its value."""
    for broken, bits, names, where in _WIDE:
        for name, bit in ((name, bit) for name in names.split() or [""] for bit in bits):
            path = where.format(name)
            own = [int(name) if name.isdigit() else name] if name else []
            title = f"bit {bit} of {path} is set, too"
            yield f"bit-{bit}-of-{label_of(path)}", title, plain, broken, *own, _above(path, bit)


CASES = [
    *again(_ROWS, _NAMES["later-and-empty"], "later-and-empty", bare),
    *again(_ROWS, _NAMES["later-and-empty in mode 1"], "later-and-empty", bare_packed),
    *again(_ROWS, _NAMES["later-and-empty in Main"], "later-and-empty", later_main),
    *again(_ROWS, _NAMES["later"], "later"),
    *refused("directory", "padding-unchecked lengths-trusted",
        ("section-padding-later-and-empty", "padding behind a section that is not zero: later and empty", bare,
         directory.padding_byte, "noTE[5], padding", 0, 1),
        *((f"length-{entry}-later-and-empty", f"the length of section {entry}: later and empty", bare,
           directory.stated_length, entry, value) for entry, value in ((0, 92), (1, 4), (3, 8)))),

    # The last item, the first one, and a signature that is larger than the right one.
    *refused("directory", "mode-unchecked lengths-trusted",
        ("mode-of-last-section", "the mode of the last section", grids, directory.mode, 4, 1),
        ("length-of-last-section", "the length of the last section", directory.stated_length, 6, (1 << 48) + 1)),
    *refused("raw-positions", "half-limits",
        ("position-first-infinite", "the first number is infinite", positions.not_finite, 0, 0, 0x7C00)),
    *refused("prologue", "signature-partly",
        ("prologue-signature-above", "the last byte of the signature is 255", header.signature_byte, 7, 0xFF)),

    # Highest bits.
    *refused("header", "stored-width", *_wide(),
        ("bit-15-of-prologue-major", "bit 15 of prologue.major is set", header.version, 1 << 15),
        ("negative-alpha-max", "alpha_max has the sign bit", header.render_info, "render_info.alpha_max", -0.5)),
    *valid("header", "stored-width minor-version", "R6.1-4", *(
        (f"minor-of-bit-{bit}", f"minor version {1 << bit}, with fields that it adds to the header",
         lambda bit=bit: replace(drawn("minor-wide", 1, SMALLEST), minor=1 << bit, later=b"\1\2\3\4"))
        for bit in (8, 15))),
    *refused("substream", "stored-width lengths-trusted",
        ("words-beyond-16-bits", "65,536 words that no lane takes", substreams.more_words, ATTRIBUTES_0, 1 << 16)),
    *refused("packed-weights", "grid-exponent", (grids, weights_packed.difference),
        ("grids-exponent-beyond-16-bits", "a row whose exponent is 2^16 too large", "hyper.1", -1, 1 << 16),
        ("grids-exponent-beyond-24-bits", "a row whose exponent is 2^24 too large", "hyper.1", -1, (1 << 24) - 1)),

    # Nothing where something must be, and zeros that are sums.
    *refused("substream", "empty-substream",
        ("planes-of-nothing", "a section of planes that ends with lengths of 0", planes.of_nothing),
        ("weights-of-nothing", "a section that ends with the last LayerModel", grids, substreams.cut, "weights", 0),
        ("no-raw-bytes", "raw bits of symbols, and no raw byte", partial(far, 100, 60), substreams.no_raw_bytes,
         ATTRIBUTES_0)),
    *valid("reconstruction position-grid", "world-rounding", "D9.1-1",
        ("world-zeros", "coordinates that cancel, of origins with either sign", partial(
            scene, "world-zeros", 2, SMALLEST, positions=f16(np.array([[-1, 1, -1], [1, -1, 1]])),
            grid=PositionGrid((1, -1, 1), 1, 0)))),
]
