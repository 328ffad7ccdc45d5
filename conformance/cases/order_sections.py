"""Cases of clause 10.1 behind the directory: two faults of sections, chunks or substreams.

The first in the order of checks counts, wherever in the file it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

from refcodec.bitstream import codec
from refcodec.bitstream.directory import ATTRIBUTES
from refcodec.bitstream.entropy import STATE_MIN
from refcodec.bitstream.header import Lanes

from . import (
    chunks,
    directory,
    entropy_escapes,
    entropy_substreams,
    frame,
    networks,
    planes,
    positions,
    weights_packed,
    weights_raw,
)
from .book import Book
from .cells import placed
from .checksums import Depth
from .fault import Edit, Fault, Part, Refused, fault, several
from .numbers import Numbers
from .scenes import SMALLEST, lattice, packed_weights, scene, settled
from .target import Target
from .targets import ATTRIBUTES_0, far, grids, packed, plain
from .weights_raw import NOT_FINITE

Base = Callable[[], Target]


def add(book: Book) -> None:
    """Adds the vectors."""
    _sections(book)
    _tables(book)
    _parts(book)
    _weights(book)
    _layers(book)
    _ends(book)


def _also(first: Callable[[], Refused], second: Fault[...], *args: Any) -> Callable[[], Refused]:
    """What makes a file with a fault, and with another one that must not be told."""

    def made() -> Refused:
        refused = first()
        return replace(refused, data=second(Target(refused.data), *args).data)

    return made


# --- sections ---------------------------------------------------------------------------------------------------------


@fault("directory.offset")
def late_offset(t: Target) -> Edit:
    """The frame is one byte longer, entries 1 to 5 follow it, and entry 6 does not."""
    paths = ["directory[0].length", *(f"directory[{entry}].offset" for entry in range(1, 6))]
    return Edit(t.pack({path: t.value(path) + 1 for path in paths}), t.at("directory[6].offset"), Depth.SECTIONS)


def _sections(book: Book) -> None:
    title = "the offset of a late section, and the length of the frame"
    book.ordered("malformed-late-offset-and-frame-length", title, late_offset.of(plain), "R6.6-4 R6.6-5")
    number = frame.number.edit
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "malformed-section-crc-and-frame",
            "the CRC-32 of the attributes, and the frame's range",
            (
                directory.section_byte.edit(ATTRIBUTES, -3, 0x55),
                number("frame.matrix[0]", 1 << 20),
            ),
        ),
        (
            "invalid-frame-items",
            "a translation, and the bounds",
            (number("frame.translation[2]", 1 << 61), number("frame.low[0]", 1 << 18)),
        ),
        (
            "invalid-frame-axes",
            "high of the first axis, and low of the second",
            (number("frame.high[0]", 1 << 30), number("frame.low[1]", 1 << 30)),
        ),
        (
            "invalid-frame-low-and-high",
            "low and high of one axis",
            (number("frame.low[2]", -(1 << 30)), number("frame.high[2]", -(1 << 31))),
        ),
        (
            "invalid-frame-and-weights",
            "the frame, and the weights' scale",
            (number("frame.reserved", 1), weights_raw.scale.edit("plane_shift", 255)),
        ),
        (
            "invalid-scale-and-not-finite",
            "carm_shift, and a weight that is no number",
            (
                weights_raw.scale.edit("carm_shift[1]", 17),
                weights_raw.not_finite.edit("hyper.0", 0, 0, NOT_FINITE["not-a-number"]),
            ),
        ),
        (
            "invalid-not-finite-and-bound",
            "a rendering network's weight that is no number, and a row of F_h at no exponent",
            (
                weights_raw.not_finite.edit("colour.1", 0, 0, NOT_FINITE["infinite"]),
                networks.large_value.edit("hyper.0", 0, 0, 1e9),
            ),
        ),
        (
            "invalid-bound-and-planes",
            "a row of CARM at no exponent, and the lengths of the planes",
            (networks.large_value.edit("carm.1.1", 0, 0, 1e9), _first_sub_plane(lambda n: n | 0xFF)),
        ),
        (
            "malformed-planes-and-mask-model",
            "the lengths of the planes, and the mask model",
            (_first_sub_plane(lambda n: n ^ 0x55), chunks.mask_model.edit(0, 0)),
        ),
        (
            "invalid-plane-stream-and-mask-model",
            "the last symbol_crc of the planes, and the mask model",
            (_symbols("planes.r2.bottom_right"), chunks.mask_model.edit(0, 0)),
        ),
    ]
    for identifier, title, pair in rows:
        book.ordered(identifier, title, several(plain, *pair))


def _first_sub_plane(change: Callable[[int], int]) -> Part:
    """Another length of the first sub-plane."""

    def made(t: Target) -> Edit:
        old = t.value("planes.length[0]")
        return planes.sub_plane_lengths.edit({0: change(old) - old})(t)

    return made


def _symbols(path: str, bits: int = 0x55) -> Part:
    """Another symbol_crc."""
    return entropy_substreams.symbol_crc.edit(path, 0, bits)


def _length(chunk: int, part: str, value: int) -> Part:
    """Another length of a chunk's part."""

    def made(t: Target) -> Edit:
        old = t.value(f"chunk_table.entry[{chunk}].{part}_length")
        return chunks.lengths.edit({(chunk, part): value - old})(t)

    return made


def _tables(book: Book) -> None:
    rows: list[tuple[str, str, Base, tuple[Part, ...], str]] = [
        (
            "invalid-mask-model-and-chunk-length",
            "the mask model, and a position_length",
            plain,
            (chunks.mask_model.edit(1, 0), _length(0, "position", 1)),
            "",
        ),
        (
            "invalid-position-model-and-chunk-length",
            "the model of positions, and a position_length",
            packed,
            (chunks.cell_shift.edit(41), _length(0, "position", 0)),
            "",
        ),
        (
            "malformed-chunk-lengths",
            "position_length of chunk 2, and the sum of the mask lengths",
            plain,
            (_length(2, "position", 1), _length(0, "mask", 0xFFFF)),
            "",
        ),
        (
            "invalid-frequency-and-later-sum",
            "a frequency of 0 in the first model, and a wrong sum of the second",
            packed,
            (chunks.no_frequency.edit(0, 9), chunks.frequencies.edit(1, {None: 1})),
            "R6.10-4",
        ),
    ]
    for identifier, title, base, pair, requirements in rows:
        book.ordered(identifier, title, several(base, *pair), requirements)
    for base, part, other in ((packed, "position", "mask"), (plain, "mask", "attribute")):
        make = chunks.lengths.of(base, {(0, part): 1, (0, other): 1})
        title = f"the lengths of the {part}s, and those of the {other}s"
        book.ordered(f"malformed-sum-of-{part}s-and-{other}s", title, make, "R6.10-2")


def _parts(book: Book) -> None:
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "position-and-chunk-crc",
            "a position of chunk 0, and the CRC-32 of chunk 1",
            (positions.not_finite.edit(0, 10, 0x7C00), chunks.crc.edit(1, "position", 1)),
        ),
        (
            "masks-and-chunk-crc",
            "the symbols of chunk 0 of the masks, and the CRC-32 of chunk 1",
            (_symbols("masks[chunk 0]", 1), chunks.crc.edit(1, "mask", 1)),
        ),
        (
            "attributes-and-chunk-crc",
            "the symbols of chunk 0, and the CRC-32 of chunk 1",
            (_symbols(ATTRIBUTES_0, 1), chunks.crc.edit(1, "attribute", 1)),
        ),
        (
            "zero-and-infinity",
            "a position of -0, and an infinite one behind it",
            (positions.negative_zero.edit(0, 3), positions.not_finite.edit(0, 4, 0xFC00)),
        ),
        (
            "last-position-and-first-mask",
            "a position of the last chunk, and the masks of the first",
            (positions.negative_zero.edit(2, 8), _symbols("masks[chunk 0]")),
        ),
        (
            "last-mask-and-first-attribute",
            "the masks of the last chunk, and the attributes of the first",
            (_symbols("masks[chunk 2]"), entropy_substreams.state.edit(ATTRIBUTES_0, 0, 0)),
        ),
        (
            "chunks",
            "symbol_crc of chunk 1, and the length of chunk 2",
            (_symbols("attributes[chunk 1]"), _words("attributes[chunk 2]", (1 << 32) - 1)),
        ),
        (
            "sub-planes",
            "symbol_crc of sub-plane 0, and the length of sub-plane 1",
            (_symbols("planes.r1"), _words("planes.r2.top_left", (1 << 32) - 1)),
        ),
    ]
    for name, title, pair in rows:
        book.ordered(f"invalid-{name}", title, several(plain, *pair))
    make = several(plain, _words(ATTRIBUTES_0, (1 << 31) - 1), entropy_substreams.state.edit(ATTRIBUTES_0, 0, 0))
    book.ordered("malformed-length-and-state", "the length of a substream, and its first state", make)
    title = "symbol_crc of a packed chunk, and the form of a raw one behind it"
    make = several(packed, _symbols("positions[chunk 0]"), positions.form.edit(2, 7))
    book.ordered("invalid-packed-and-raw-chunk", title, make)
    # The form of the raw chunk becomes 2.
    title, make = "the CRC-32 of a chunk of positions, and its form", chunks.part_byte.of(packed, 2, "position", 0, 2)
    book.ordered("malformed-chunk-crc-and-form", title, make, "R6.10-3 R6.11-3")


def _words(path: str, value: int) -> Part:
    return entropy_substreams.word_count.edit(path, value)


# --- weights ----------------------------------------------------------------------------------------------------------


def _weights(book: Book) -> None:
    for field, value in (("plane_shift", 11), ("carm_input_count", 0)):
        make = several(plain, weights_raw.scale.edit(field, value), weights_raw.scale.edit("carm_shift[0]", 17))
        identifier = f"invalid-{field.replace('_', '-')}-and-carm-shift"
        book.ordered(identifier, f"{field} and carm_shift", make, "R6.8-1")
    rows: list[tuple[str, str, tuple[Part, ...]]] = [
        (
            "weight-stream-and-raw-layer",
            "symbol_crc of the weights, and a raw layer's number that is none",
            (
                _symbols("weights"),
                weights_raw.not_finite.edit("hyper.0", 0, 0, NOT_FINITE["not-a-number"]),
            ),
        ),
        (
            "layer-and-weight-stream",
            "the last layer's form, and the first state of the weights",
            (
                weights_packed.model_field.edit("colour.1", "form", 3),
                entropy_substreams.state.edit("weights", 0, 0),
            ),
        ),
        # The -0 is there, and keeps the layer raw.
        ("raw-layer-twice", "a raw layer with a number that is none, and a -0", (_other_bits,)),
    ]
    for name, title, pair in rows:
        book.ordered(f"invalid-{name}", title, several(grids, *pair))
    for name, text, field, value in (
        ("exponent", "an exponent of 5", "exponent", 5),
        ("large-exponent", "an exponent of 999", "exponent", 999),
        ("weight-scale", "a scale of weights", "weight_scale", 5),
    ):
        make = _also(weights_packed.model_field.of(grids, "hyper.0", field, value), weights_packed.cut, "hyper.0", 9)
        title = f"{text} in a raw layer, and the end within its values"
        book.ordered(f"invalid-raw-{name}-and-values", title, make, "R6.8-4 R6.8-5")


def _other_bits(t: Target) -> Edit:
    """The first weight of a raw layer as a NaN that has its lowest bits."""
    at = t.weight_at("hyper.0", 0, 0)
    return weights_raw.not_finite.edit("hyper.0", 0, 0, t.data[at : at + 1] + b"\0\xc0\x7f")(t)


@cache
def _two_raw() -> Target:
    """A file in mode 1 whose layers hyper.0 and opacity.0 are raw."""
    made = scene("outside-two-raw", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    for name in ("hyper", "opacity"):
        made.networks[name][0][1][0] = -0.0
    return Target(codec.emit(packed_weights(settled(made))))


def _layers(book: Book) -> None:
    """Faults that are found behind the substream: those of layers layer after layer, and bounds after them all."""

    none, raw = NOT_FINITE["not-a-number"], weights_packed.packable.edit
    no_number = {layer: weights_raw.not_finite.edit(layer, 0, 0, none) for layer in ("hyper.0", "opacity.0")}
    rows: list[tuple[str, str, Base, tuple[Part, ...]]] = [
        (
            "raw-and-not-finite",
            "a raw layer that can be packed, and a later one with a number that is none",
            _two_raw,
            (raw("hyper.0"), no_number["opacity.0"]),
        ),
        (
            "not-finite-and-raw",
            "a raw layer with a number that is none, and a later one that can be packed",
            _two_raw,
            (no_number["hyper.0"], raw("opacity.0")),
        ),
        (
            "not-finite-and-exponent",
            "a raw layer with a number that is none, and an exponent of a later one",
            weights_packed.even_integers.target(_two_raw, "hyper.1"),
            (no_number["hyper.0"],),
        ),
        (
            "raw-and-bound",
            "a raw layer that can be packed, and an earlier one that breaks the bound",
            _two_raw,
            (raw("opacity.0"), networks.large_value.edit("hyper.0", 0, 0, 4096.0)),
        ),
    ]
    proved = "R6.8-2 R6.8-3 R6.8-6 R6.8-7"
    for name, title, base, pair in rows:
        book.ordered(f"invalid-layers-{name}", title, several(base, *pair), proved)
    title = "an exponent, and a later raw layer with a number that is none"
    first = weights_packed.even_integers.of(_two_raw, "hyper.1")
    make = _also(first, weights_raw.not_finite, "opacity.0", 0, 0, none)
    book.ordered("invalid-layers-exponent-and-not-finite", title, make, proved)
    title = "an exponent, and an earlier raw layer that breaks the bound"
    first = weights_packed.even_integers.of(_two_raw, "colour.0")
    make = _also(first, networks.large_value, "hyper.0", 0, 0, 4096.0)
    book.ordered("invalid-layers-exponent-and-bound", title, make, proved)


# --- the end of a substream -------------------------------------------------------------------------------------------


@cache
def _idle() -> Target:
    """A file whose substream of attributes has a lane without symbols."""
    return Target(codec.emit(scene("planted-idle", 3, lanes=Lanes(0, 0, 8))))


@cache
def _idle_cells() -> Target:
    """A file of five anchors in one packed chunk of 16 lanes."""
    where = lattice(Numbers("outside-cells"), 5)
    return Target(codec.emit(placed("outside-cells", where, chunk_size=5, lanes=Lanes(0, 4, 0))))


def _ends(book: Book) -> None:
    words, raw_bytes = entropy_substreams.more_words, entropy_substreams.raw_bytes
    idle_lane, zeros = entropy_substreams.idle_lane, entropy_escapes.escape_of_zeros
    usual = partial(far, 1000)
    other_sign = entropy_escapes.other_sign.target(partial(far, 300))
    book.add(
        "invalid-order-of-words-and-state",
        "a word that no lane takes, and a lane that does not end at 2^16",
        words.of(idle_lane.target(_idle, ATTRIBUTES_0, STATE_MIN + 1), ATTRIBUTES_0, 1),
        features="order substream",
        requirements="D8.8-2 D10.1-1",
        flags="order-of-checks",
    )
    rows: list[tuple[str, str, Callable[[], Refused]]] = [
        (
            "words-and-escape",
            "a word too many, and an escape of zeros",
            words.of(zeros.target(usual, 320), ATTRIBUTES_0, 1),
        ),
        (
            "state-and-escape",
            "a final state, and an escape of zeros",
            entropy_substreams.used_lane.of(zeros.target(usual, 48), ATTRIBUTES_0, 2),
        ),
        ("escape-and-raw-length", "an escape of zeros, and raw bytes that nothing reads", zeros.of(usual, 800)),
        (
            "range-and-raw-length",
            "a symbol out of range, and raw bytes that nothing reads",
            entropy_escapes.far_escape.of(usual, 24, 0, bits=800),
        ),
        ("padding-and-crc", "a padding bit, and symbol_crc", entropy_escapes.padding_bit.of(other_sign, 23)),
        ("raw-length-and-crc", "a raw byte more, and symbol_crc", raw_bytes.of(other_sign, ATTRIBUTES_0, b"\0")),
    ]
    for name, title, make in rows:
        book.ordered(f"invalid-{name}", title, make, "D8.8-2", "order substream")
    path, cell_less = "positions[chunk 0]", positions.cell_less.target(_idle_cells)
    for name, text, make in (
        ("words", "a word that no lane takes", words.of(cell_less, path, 1)),
        ("final-state", "a lane that does not end at 2^16", idle_lane.of(cell_less, path, STATE_MIN + 1)),
        ("raw-length", "a raw byte that nothing reads", raw_bytes.of(cell_less, path, b"\0")),
        ("symbol-crc", "a CRC-32 of other symbols", entropy_substreams.symbol_crc.of(cell_less, path, 0, 1)),
    ):
        title = f"{text}, and a cell less than there are anchors"
        book.ordered(f"invalid-{name}-and-cells", title, make, "R6.11-5 D8.8-2")
