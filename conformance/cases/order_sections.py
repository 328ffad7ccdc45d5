"""Cases of clause 10.1 after the directory: two faults of sections, chunks or substreams.

The order of checks is the order of the file: the first fault in this order must be reported. Two faults of the weights
are in order_weights.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

from refcodec.bitstream import codec
from refcodec.bitstream.directory import FRAME, INDEX, PLANES_SECTION, WEIGHTS
from refcodec.bitstream.entropy import STATE_MIN
from refcodec.bitstream.header import Lanes

from . import (
    chunks,
    directory,
    entropy_escapes,
    entropy_substreams,
    frame,
    index,
    masks,
    planes,
    positions,
    weights_raw,
)
from .book import Book
from .cells import placed
from .chain import Link, also, chain, other_symbols
from .fault import Refused, several
from .numbers import Numbers
from .scenes import lattice, scene
from .target import Target
from .targets import ATTRIBUTES_0, far, five_cells, grids, packed, plain, strewn
from .weights_raw import NOT_FINITE

Base = Callable[[], Target]
NONE = NOT_FINITE["not-a-number"]


def add(book: Book) -> None:
    """Adds the vectors."""
    _sections(book)
    _frame(book)
    _planes(book)
    _index(book)
    _entries(book)
    _chunk(book)
    _chunks(book)
    _cut(book)
    _ends(book)


# --- sections ---------------------------------------------------------------------------------------------------------


def _sections(book: Book) -> None:
    """The CRC-32 of a section is checked before its contents, and after those of earlier sections."""
    crc = directory.section_byte
    chain(
        book,
        plain,
        "sections",
        [
            Link("frame-crc", "the CRC-32 of the frame", crc, FRAME, 3, 0x55),
            Link("frame", "the frame's range", frame.number, "frame.matrix[0]", 1 << 20),
            Link("weights-crc", "the CRC-32 of the weights", crc, WEIGHTS, -1, 0x55),
            Link("weights", "plane_shift", weights_raw.scale, "plane_shift", 255),
            Link("planes-crc", "the CRC-32 of the planes", crc, PLANES_SECTION, -1, 0x55),
            Link("planes", "the lengths of the planes", planes.sub_plane_lengths, {3: 4}),
            Link("index-crc", "the CRC-32 of the index", crc, INDEX, -30, 0x55),
            Link("index", "the mask model", masks.mask_model, 0, 0),
            Link("chunk-crc", "the CRC-32 of chunk 0", chunks.crc, 0, 0x55),
        ],
        "R6.6-7",
    )
    note = strewn().sections[WEIGHTS].number - 1
    chain(
        book,
        strewn,
        "ancillary",
        [
            Link("frame", "the frame's shift", frame.number, "frame.shift[2]", 61),
            Link("crc", "the CRC-32 of an ancillary section behind the frame", directory.section_crc, note, 5),
            Link("weights", "carm_shift", weights_raw.scale, "carm_shift[0]", 17),
        ],
        "R6.6-7 D12.1-1",
    )
    weights = grids().sections[WEIGHTS].number
    chain(
        book,
        grids,
        "padding",
        [
            Link("crc", "the CRC-32 of the weights", directory.section_byte, WEIGHTS, 0, 0x55),
            Link("padding", "padding behind the weights", directory.padding_byte, weights, 0, 1),
            Link("weights", "carm_input_count", weights_raw.scale, "carm_input_count", 9),
        ],
        "R6.6-8",
    )


def _frame(book: Book) -> None:
    number = frame.number
    chain(
        book,
        plain,
        "frame",
        [
            Link("reserved", "the reserved byte", frame.reserved, "frame.reserved", 1),
            Link("matrix", "the last item of the matrix", number, "frame.matrix[8]", 1 << 20),
            Link("translation", "a translation", number, "frame.translation[2]", 1 << 61),
            Link("shift", "a shift", number, "frame.shift[0]", 61),
            Link("low-0", "low of the first axis", number, "frame.low[0]", 1 << 18),
            Link("high-0", "high of the first axis", number, "frame.high[0]", 1 << 30),
            Link("low-1", "low of the second axis", number, "frame.low[1]", 1 << 30),
            Link("high-2", "high of the last axis", number, "frame.high[2]", -(1 << 31)),
        ],
        "R6.7-1 R6.7-2",
    )


# --- planes and the index ---------------------------------------------------------------------------------------------


def _planes(book: Book) -> None:
    words = entropy_substreams.word_count
    chain(
        book,
        plain,
        "planes",
        [
            Link("length", "the lengths of the planes", planes.sub_plane_lengths, {1: 4}),
            Link("padding", "padding behind the second sub-plane", planes.padding, 1, 0, 1),
            Link("last-padding", "padding behind the last sub-plane", planes.padding, 4, 1, 1),
            other_symbols("planes.r1", "first-symbols", "symbol_crc of the first sub-plane"),
            Link("words", "word_count of the second one", words, "planes.r2.top_left", (1 << 32) - 1),
            Link("state", "a state of the second one", entropy_substreams.state, "planes.r2.top_left", 1, 0),
            other_symbols("planes.r2.bottom_right", "last-symbols", "symbol_crc of the last sub-plane"),
            Link("mask-model", "the mask model", masks.mask_model, 0, 0),
        ],
        "R6.9-1 R6.9-2",
    )


def _index(book: Book) -> None:
    chain(
        book,
        packed,
        "index",
        [
            Link("mask-model", "the mask model", masks.mask_model, 2, 0),
            Link("padding", "padding of the mask model", masks.padding, 0, 1),
            Link("reserved", "a reserved byte of the model of positions", index.reserved, 1, 1),
            Link("cell-shift", "cell_shift", index.cell_shift, 41),
            Link("frequency", "a frequency of 0 in the first model", index.no_frequency, 0, 9),
            Link("sum", "a wrong sum of the second model", index.frequencies, 1, {None: 1}),
            Link("entry", "the kept_count of an entry", index.kept_count, 1, 1),
            Link("anchors", "anchors that do not add up", index.anchors_amiss, 0, 1),
            Link("lengths", "lengths that do not add up", index.lengths_amiss, {3: 4}),
            Link("chunk", "a reserved byte of chunk 0", chunks.reserved, 0, 0, 1),
        ],
        "R6.10-1 R6.10-2 R6.10-3 R6.10-4 R6.10-5 R6.10-6",
    )


def _entries(book: Book) -> None:
    chain(
        book,
        plain,
        "entry",
        [
            Link("anchors", "anchor_count of entry 0", index.anchor_count, 0, 0),
            Link("length", "length of entry 0", index.length, 0, 2),
            Link("kept", "kept_count of entry 0", index.kept_count, 0, 1),
            Link("low", "low of entry 0", index.bound, 0, "low[2]", 0x7C00),
            Link("high", "high of entry 0", index.bound, 0, "high[0]", 0x8000),
            Link("low-above-high", "low above high in entry 0", index.low_above_high, 0, 2),
            Link("next-anchors", "anchor_count of entry 1", index.anchor_count, 1, 0),
            Link("last-length", "length of entry 2", index.length, 2, 0),
        ],
        "R6.10-5",
    )
    title = "a bound of the last axis that is -0, and low above high on the first"
    make = several(plain, index.bound.edit(1, "high[2]", 0x8000), index.low_above_high.edit(1, 0))
    book.ordered("invalid-entry-bound-and-low-above-high", title, make, "R6.10-5")


# --- chunks -----------------------------------------------------------------------------------------------------------


def _chunk(book: Book) -> None:
    """The checks of one chunk in order, including those of its entry's kept_count and bounds."""
    reserved, form = chunks.reserved, chunks.form
    chain(
        book,
        packed,
        "chunk",
        [
            Link("crc", "the CRC-32 of a chunk", chunks.crc, 2, 1),
            Link("reserved", "a reserved byte of its head", reserved, 2, 1, 1),
            Link("form", "its form", form, 2, 7),
            Link("length", "the lengths of its parts", chunks.lengths, 2, {"masks": 4}),
            Link("padding", "padding behind its positions", chunks.padding, 2, "positions", 0, 1),
            Link("last-padding", "padding behind its attributes", chunks.padding, 2, "attributes", 0, 1),
            Link("zero", "a position of -0", positions.negative_zero, 2, 1),
            Link("infinity", "an infinite position behind it", positions.not_finite, 2, 8, 0xFC00),
            Link("bounds", "its bounds", chunks.bound, 2, "high[1]", True),
            Link("mask-state", "a state of its masks", entropy_substreams.state, "masks[chunk 2]", 0, 0),
            other_symbols("masks[chunk 2]", "masks", "symbol_crc of its masks"),
            Link("kept", "its kept_count", chunks.kept_count, 2, 0),
            Link("words", "words of its attributes", entropy_substreams.word_count, "attributes[chunk 2]", 1 << 31),
            other_symbols("attributes[chunk 2]", "attributes", "symbol_crc of its attributes"),
            Link("next-crc", "the CRC-32 of the next chunk", chunks.crc, 3, 1),
        ],
        "R6.11-1 R6.11-2 R6.11-3 R6.11-4 R6.11-5 R6.11-10 R6.11-11",
    )
    chain(
        book,
        packed,
        "packed-chunk",
        [
            Link("padding", "padding behind the attributes of a packed chunk", chunks.padding, 1, "attributes", 0, 1),
            Link("state", "a state of its positions", entropy_substreams.state, "positions[chunk 1]", 1, 0),
            other_symbols("positions[chunk 1]", "positions", "symbol_crc of its positions"),
            Link("bounds", "its bounds", chunks.bound, 1, "low[0]", False),
            other_symbols("masks[chunk 1]", "masks", "symbol_crc of its masks"),
        ],
        "R6.11-10",
    )
    title = "a tree with a cell less than there are anchors, and bounds"
    make = also(positions.cell_less.of(five_cells), chunks.bound, 0, "high[2]", True)
    book.ordered("invalid-cells-and-bounds", title, make, "R6.11-8 R6.11-10")


def _chunks(book: Book) -> None:
    """All checks of a chunk come before those of the next one, and before those after the chunks."""
    data = plain().sections[b"DATA"].number
    chain(
        book,
        plain,
        "chunks",
        [
            other_symbols(ATTRIBUTES_0, "first-attributes", "the attributes of chunk 0"),
            Link("second-positions", "a position of chunk 1", positions.not_finite, 1, 10, 0x7C00),
            Link("last-head", "the reserved byte of chunk 2", chunks.reserved, 2, 0, 1),
        ],
        "R6.11-1",
    )
    chain(
        book,
        plain,
        "last-chunk",
        [
            Link("second-kept", "kept_count of chunk 1", chunks.kept_count, 1, 0),
            Link("last-crc", "the CRC-32 of chunk 2", chunks.crc, 2, 0x55),
            Link("data-crc", "the CRC-32 of the data, which is not 0", directory.section_crc, data, 1),
            Link("behind-crc", "the CRC-32 of a section behind it", directory.section_crc, data + 1, 5),
        ],
        "R6.6-7",
    )
    rows: list[tuple[str, str, tuple[Link, Link]]] = [
        (
            "attributes-and-first-mask",
            "the first attributes, and the last masks",
            (
                Link("", "", entropy_substreams.state, ATTRIBUTES_0, 0, 0),
                other_symbols("masks[chunk 2]"),
            ),
        ),
        (
            "last-attributes-and-data-crc",
            "the last attributes, and the CRC-32 of the data, which is not 0",
            (other_symbols("attributes[chunk 2]"), Link("", "", directory.section_crc, data, 1)),
        ),
        (
            "masks-and-position",
            "the masks of chunk 0, and a position of chunk 1",
            (other_symbols("masks[chunk 0]"), Link("", "", positions.negative_zero, 1, 0)),
        ),
        (
            "bounds-and-next-crc",
            "the bounds of chunk 0, and the CRC-32 of chunk 1",
            (Link("", "", chunks.bound, 0, "high[2]", True), Link("", "", chunks.crc, 1, 1)),
        ),
    ]
    for name, title, (first, second) in rows:
        book.ordered(f"{first.klass}-{name}", title, several(plain, first.part, second.part))


def _cut(book: Book) -> None:
    """A file ends within a chunk, after an earlier fault: the end is not checked first."""
    rows: list[tuple[str, Link, int]] = [
        ("index-and-cut", Link("", "the model of masks", masks.mask_model, 0, 0), 0),
        ("lengths-and-cut", Link("", "lengths that do not add up", index.lengths_amiss, {0: 4}), 1),
        ("crc-and-cut", Link("", "the CRC-32 of chunk 0", chunks.crc, 0, 1), 1),
        ("attributes-and-cut", other_symbols(ATTRIBUTES_0, text="the attributes of chunk 0"), 1),
        ("kept-and-cut", Link("", "kept_count of chunk 1", chunks.kept_count, 1, 0), 2),
    ]
    for name, link, chunk in rows:
        title = f"{link.text}, and a file that ends within chunk {chunk}"
        make = partial(_ended, link.broken.of(plain, *link.args), chunk)
        book.ordered(f"{link.klass}-{name}", title, make, "R6.6-6")
    make = partial(_ended, chunks.crc.of(plain, 1, 1), 1)
    told = chunks.cut_in_chunk
    title = "a file that ends within chunk 1, whose CRC-32 is wrong"
    book.ordered("malformed-cut-and-crc", title, lambda: replace(make(), name=told.error, offset=_end(1)), "R6.6-6")


def _end(chunk: int) -> int:
    """Returns the end of a file that is cut within a chunk."""
    return plain().chunk_at(chunk) + 20


def _ended(make: Callable[[], Refused], chunk: int) -> Refused:
    """Returns the file cut within a chunk."""
    made = make()
    return replace(made, data=made.data[: _end(chunk)])


# --- the end of a substream -------------------------------------------------------------------------------------------


@cache
def _idle() -> Target:
    """Returns a file whose substream of attributes has a lane without symbols."""
    return Target(codec.emit(scene("planted-idle", 3, lanes=Lanes(0, 0, 8))))


@cache
def _idle_cells() -> Target:
    """Returns a file of five anchors in one packed chunk with 16 lanes."""
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
        requirements="D8.8-2 D10.2-3",
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
            entropy_escapes.far_escape.of(usual, 23, 0, bits=800),
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
        book.ordered(f"invalid-{name}-and-cells", title, make, "R6.11-8 D8.8-2")
