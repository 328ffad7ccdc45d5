"""Cases of clauses 5.15, 8.1 to 8.3 and 8.8: states, lanes, words, raw bytes, and the end of a substream."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.entropy import STATE_MIN
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .entropy_values import WIDE, spread
from .fault import Draw, Drawn, Edit, Refused, Whole, fault
from .numbers import Numbers
from .samplers import Rare, Sampler, drawn, sampled
from .scenes import lattice, packed_weights, scene, with_symbols
from .target import Substream, Target
from .targets import ATTRIBUTES_0, far, five_cells, grids, plain, radius

# --- faults -----------------------------------------------------------------------------------------------------------


def _any_substream(draw: Draw, t: Target) -> str:
    return draw.choice(list(t.substreams))


@fault("substream.length")
def cut(t: Target, path: str, left: int) -> Whole:
    """A substream ends within its head or its states. left: its bytes; -1 is all but the last byte of the states."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, t.data[s.start : range(s.start, s.words_at)[left]]), s.start)


@cut.drawn
def _(draw: Draw, t: Target) -> Drawn:
    path = _any_substream(draw, t)
    s = t.substreams[path]
    return t, path, draw.integer(0, s.words_at - s.start - 1)


@fault("substream.length")
def word_count(t: Target, path: str, value: int) -> Edit:
    """There are more words than bytes for them."""
    return Edit(t.pack({f"{path}.word_count": value}), t.substreams[path].start)


@word_count.drawn
def _(draw: Draw, t: Target) -> Drawn:
    path = _any_substream(draw, t)
    s = t.substreams[path]
    return t, path, draw.choice([(s.end - s.words_at) // 2 + 1, s.words + (1 << 31), (1 << 32) - 1])


@fault("substream.state")
def state(t: Target, path: str, lane: int, value: int) -> Edit:
    """The initial state of a lane is below 2^16. lane: -1 is the last one."""
    s = t.substreams[path]
    return Edit({s.state_at(lane): struct.pack("<I", value)}, s.start)


@state.drawn
def _(draw: Draw, t: Target) -> Drawn:
    path = _any_substream(draw, t)
    return t, path, draw.integer(0, t.substreams[path].lanes - 1), draw.integer(0, STATE_MIN - 1)


def with_words(t: Target, s: Substream, more: int) -> bytes:
    """Returns a substream with additional words of 0, or without its last words."""
    end = s.raw_at if more > 0 else s.raw_at + 2 * more
    words = t.data[s.start + 8 : end] + bytes(max(0, 2 * more))
    return t.data[s.start : s.start + 4] + struct.pack("<I", s.words + more) + words + t.data[s.raw_at : s.end]


@fault("substream.words")
def more_words(t: Target, path: str, more: int) -> Whole:
    """There are words that no lane reads."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, with_words(t, s, more)), s.start)


@more_words.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, _any_substream(draw, t), draw.integer(1, 3)


@fault("substream.words")
def word_less(t: Target, path: str) -> Whole:
    """The last word is missing."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, with_words(t, s, -1)), s.start)


@word_less.drawn
def _(draw: Draw, t: Target) -> Drawn:
    paths = [path for path, s in t.substreams.items() if s.words]
    return t, draw.choice(paths)


@fault("substream.final_state")
def idle_lane(t: Target, path: str, value: int) -> Edit:
    """The state of a last lane without symbols is not 2^16."""
    s = t.substreams[path]
    assert t.data[s.state_at(-1) : s.state_at(-1) + 4] == struct.pack("<I", STATE_MIN)
    return Edit({s.state_at(-1): struct.pack("<I", value)}, s.start)


@idle_lane.drawn
def _(draw: Draw, t: Target) -> Drawn:
    # A lane with symbols can also begin at 2^16. The last lane has none if masks have more lanes than anchors.
    counts = [t.value(f"index.entry[{n}].anchor_count") for n in range(t.header.chunk_count)]
    anchors = {f"masks[chunk {n}]": count for n, count in enumerate(counts)}
    idle = [path for path, count in anchors.items() if t.substreams[path].lanes > count]
    return t, draw.choice(idle), draw.integer(STATE_MIN + 1, 0xFFFFFFFF)


@fault("substream.final_state")
def used_lane(t: Target, path: str, more: int) -> Edit:
    """The state of the first lane is increased, without an effect on the words that it reads."""
    s = t.substreams[path]
    assert s.words == 0
    (old,) = struct.unpack_from("<I", t.data, s.state_at(0))
    return Edit({s.state_at(0): struct.pack("<I", old + more)}, s.start)


@fault("substream.raw_length")
def raw_bytes(t: Target, path: str, content: bytes) -> Whole:
    """There are unused raw bytes."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, t.data[s.start : s.end] + content), s.start)


@raw_bytes.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, _any_substream(draw, t), draw.content(1, 3)


@fault("substream.symbol_crc")
def symbol_crc(t: Target, path: str, at: int, bits: int) -> Edit:
    """Bits of a byte of the CRC-32 of a substream's symbols are flipped."""
    s = t.substreams[path]
    return Edit(t.flip(s.start + at, bits), s.start)


@symbol_crc.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, _any_substream(draw, t), draw.integer(0, 3), draw.integer(1, 255)


# --- the suite's refused files ----------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    for kind in BASES:
        _refused(book, kind)
    _refused_ends(book)
    _lanes(book)
    _words(book)


# By kind of substream: a file with one, its path and its feature.
BASES: dict[str, tuple[Callable[[], Target], str, str]] = {
    "planes": (plain, "planes.r1", "planes"),
    "masks": (plain, "masks[chunk 0]", "masks"),
    "attributes": (plain, ATTRIBUTES_0, "attributes"),
    "positions": (five_cells, "positions[chunk 0]", "packed-positions"),
    "weights": (grids, "weights", "packed-weights"),
}
LAST = {"planes": "planes.r2.bottom_right", "attributes": "attributes[chunk 2]"}


def _refused(book: Book, kind: str) -> None:
    """Adds the faults that every kind of substream can have."""
    base, path, feature = BASES[kind]

    def add(klass: str, name: str, text: str, make: Callable[[], Refused], flags: str) -> None:
        book.add(
            f"{klass}-{kind}-{name}",
            f"{text}, in the {kind}",
            make,
            features=f"substream {feature}",
            requirements="D8.8-1 D8.8-2",
            flags=flags,
        )

    add("malformed", "cut-in-states", "a substream that ends within its states", cut.of(base, path, -1), "truncation")
    add("invalid", "word-more", "a word that no lane takes", more_words.of(base, path, 1), "words-uncounted")
    add("invalid", "symbol-crc", "a CRC-32 of other symbols", symbol_crc.of(base, path, 3, 1), "symbol-crc")
    if kind != "masks":
        make = state.of(base, path, -1, STATE_MIN - 1)
        add("invalid", "state-below", "an initial state of 2^16 - 1", make, "limit-off-by-one initial-state")
        make = raw_bytes.of(base, path, b"\0")
        add("invalid", "raw-byte-more", "a raw byte that nothing reads", make, "raw-length-unchecked")
    if kind in LAST:
        flags = "lengths-trusted sum-wraps buffer-too-small"
        add("malformed", "words-beyond", "a word_count of 2^32 - 1", word_count.of(base, path, (1 << 32) - 1), flags)
        add("malformed", "cut-in-head", "a substream that ends within its head", cut.of(base, path, 7), "truncation")
        add("invalid", "word-less", "a word too few", word_less.of(base, path), "words-uncounted")
        text, make = "a CRC-32 of other symbols, of the last substream", symbol_crc.of(base, LAST[kind], 3, 1)
        add("invalid", "last-symbol-crc", text, make, "symbol-crc last-chunk")


@cache
def idle() -> Target:
    """Returns a file in which all substreams have lanes without symbols."""
    return Target(codec.emit(drawn("refused-idle", 3, lanes=Lanes(6, 4, 8))))


def _refused_ends(book: Book) -> None:
    title, make = "the file ends within the head of its last substream", cut.of(partial(far, 1000), ATTRIBUTES_0, 5)
    book.add("malformed-attributes-of-5-bytes", title, make, features="substream attributes", flags="truncation")
    title, make = "the file ends within symbol_crc of its last substream", cut.of(partial(far, 1000), ATTRIBUTES_0, 3)
    book.add("malformed-attributes-of-3-bytes", title, make, features="substream attributes", flags="truncation")
    title = "a word_count whose double is right modulo 2^32"
    book.add("malformed-words-wrap", title, _words_wrap, features="substream", flags="sum-wraps lengths-trusted")
    title = "words that end one byte behind their substream"
    book.add("malformed-words-by-one-byte", title, _word_of_one_byte, features="substream", flags="lengths-trusted")
    # The 16 bits of an escape fill two bytes. A third byte is unused.
    title, proved = "a raw byte after the last bit fills the one before", "D8.8-1 D8.8-2 D8.7-1"
    make = raw_bytes.of(partial(far, radius() + (1 << 7) + 3), ATTRIBUTES_0, b"\0")
    book.add(
        "invalid-raw-byte-of-nothing",
        title,
        make,
        features="raw-bits substream",
        requirements=proved,
        flags="raw-length-unchecked",
    )
    add = partial(book.add, features="lanes substream", requirements=proved)
    for path in ("planes.r1", "masks[chunk 0]", ATTRIBUTES_0):
        kind = path.partition(".")[0].partition("[")[0]
        title = f"a lane that no symbol uses is not at 2^16, in the {kind}"
        make = idle_lane.of(idle, path, STATE_MIN + 1)
        add(f"invalid-final-state-idle-{kind}", title, make, flags="final-state idle-lanes")
    # A lane whose symbols leave it above 2^16 without a word. Its final state is 2^14 larger.
    title, make = "a lane that ends above 2^16", used_lane.of(partial(far, 0), ATTRIBUTES_0, 2)
    add("invalid-final-state-used", title, make, flags="final-state")


def _words_wrap() -> Refused:
    t = plain()
    return word_count(t, ATTRIBUTES_0, t.substreams[ATTRIBUTES_0].words + (1 << 31))


def _word_of_one_byte() -> Refused:
    # The 18 bits of an escape have three bytes, and two words would have four.
    t = far(radius() + (1 << 8) + 3)
    return word_count(t, ATTRIBUTES_0, t.substreams[ATTRIBUTES_0].words + 2)


# --- the suite's valid files ------------------------------------------------------------------------------------------


def _lanes(book: Book) -> None:
    for part in ("plane", "mask", "attribute"):
        for log2 in (0, 3, 8):
            lanes = replace(Lanes(1, 2, 1), **{part: log2})
            book.valid(
                f"lanes-{part}-{log2}",
                f"{1 << log2} lanes of each substream of {part}s",
                partial(drawn, f"lanes-{part}-{log2}", 21, lanes=lanes, chunk_size=16),
                features="lanes substream",
                requirements="D8.2-1 D8.3-1",
                flags="lane-order idle-lanes group-continues",
            )
    book.valid(
        "lanes-positions",
        "substreams of positions have the lanes of masks",
        _lanes_of_positions,
        features="lanes packed-positions",
        requirements="D8.3-1 D7.12-1",
        flags="lanes-of-another-part",
    )
    book.valid(
        "lanes-weights",
        "the substream of weights has the lanes of attributes",
        lambda: packed_weights(drawn("lanes-weights", 3, lanes=Lanes(0, 1, 3))),
        features="lanes packed-weights",
        requirements="D8.3-1 D7.13-1",
        flags="lanes-of-another-part",
    )


def _lanes_of_positions() -> Scene:
    where = lattice(Numbers("lanes-positions"), 30)
    made = drawn("lanes-positions", 30, positions=where, lanes=Lanes(0, 3, 0))
    return replace(made, position_model=position_model(where, 4096))


def _words(book: Book) -> None:
    book.valid(
        "words-many",
        "symbols that nearly all take a word, in 16 lanes at once",
        _many_words,
        features="substream lanes",
        requirements="D8.2-1 D8.3-1 R8.8-1",
        flags="word-order lane-order",
    )
    book.valid(
        "words-none",
        "a substream without words",
        _no_words,
        features="substream",
        requirements="D8.2-1 R8.8-1 R8.8-2",
        flags="final-state",
    )
    book.valid(
        "substream-long",
        "one lane, thousands of symbols",
        lambda: sampled(scene("substream-long", 200, lanes=Lanes(0, 0, 0)), Sampler(Numbers("substream-long"), 15)),
        features="substream",
        requirements="D8.2-1 D8.3-1 R8.8-5",
        flags="symbol-crc group-continues",
    )


def _many_words() -> Scene:
    channel = np.arange(WIDE.attribute_width)
    coder = Rare(Numbers("words-many"))
    return spread("words-many", channel * 0 + 3, channel % 20, coder, 20, lanes=Lanes(0, 0, 4))


def _no_words() -> Scene:
    zero = np.zeros(WIDE.attribute_width, np.int64)
    made = spread("words-none", zero, zero - 40, Sampler(Numbers("words-none"), 0), 1, lanes=Lanes(0, 0, 0))
    return with_symbols(made, features=np.zeros((1, 16)), scalings=np.zeros((1, 6)), offsets=np.zeros((1, 10, 3)))
