"""Cases of clauses 5.15, 8.1 to 8.3 and 8.8: states, lanes, words, raw bytes, and the end of a substream."""

import struct
from dataclasses import replace
from functools import partial

from refcodec.bitstream.entropy import STATE_MIN
from refcodec.bitstream.header import Lanes

from .entropy_symbols import CHANNEL, spread
from .fault import Draw, Edit, Whole, element, fault
from .numbers import Numbers
from .samplers import Rare, Sampler, drawn, on_lattice, sampled
from .scenes import only_symbols, scene
from .table import More, Recipe, Row, refused, valid
from .target import Substream, Target
from .targets import ATTRIBUTES_0, beyond, far, five_cells, grids, plain, target_of
from .weights import packed_weights


def _path(draw: Draw, t: Target) -> str:
    return draw.choice(list(t.substreams))


@fault("substream.length", _path, lambda d, t, p: d.integer(0, t.substreams[p].words_at - t.substreams[p].start - 1))
def cut(t: Target, path: str, left: int) -> Whole:
    """A substream ends within its head or its states. left: its bytes; -1 is all but the last byte of the states."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, t.data[s.start : range(s.start, s.words_at)[left]]), s.start)


def _counts(draw: Draw, t: Target, path: str) -> int:
    """Draws more words than there are bytes for."""
    s = t.substreams[path]
    return draw.choice([(s.end - s.words_at) // 2 + 1, s.words + (1 << 31), (1 << 32) - 1])


word_count = element(
    "substream.length", "{}.word_count", _path, _counts, reported=lambda t, path: t.at(f"{path}.symbol_crc")
)


@fault("substream.state", _path, lambda d, t, p: d.integer(0, t.substreams[p].lanes - 1), (0, STATE_MIN - 1))
def state(t: Target, path: str, lane: int, value: int) -> Edit:
    """The initial state of a lane is below 2^16. lane: -1 is the last one."""
    s = t.substreams[path]
    return Edit({s.state_at(lane): struct.pack("<I", value)}, s.start)


def with_words(t: Target, s: Substream, more: int) -> bytes:
    """Returns a substream with additional words of 0, or without its last words."""
    end = s.raw_at if more > 0 else s.raw_at + 2 * more
    words = t.data[s.start + 8 : end] + bytes(max(0, 2 * more))
    return t.data[s.start : s.start + 4] + struct.pack("<I", s.words + more) + words + t.data[s.raw_at : s.end]


@fault("substream.words", _path, (1, 3))
def more_words(t: Target, path: str, more: int) -> Whole:
    """There are words that no lane reads."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, with_words(t, s, more)), s.start)


@fault("substream.words", lambda d, t: d.choice([path for path, s in t.substreams.items() if s.words]))
def word_less(t: Target, path: str) -> Whole:
    """The last word is missing."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, with_words(t, s, -1)), s.start)


def _idle_paths(draw: Draw, t: Target) -> str:
    # A lane with symbols can also begin at 2^16. The last lane has none if masks have more lanes than anchors.
    counts = [t.value(f"index.entry[{n}].anchor_count") for n in range(t.header.chunk_count)]
    anchors = {f"masks[chunk {n}]": count for n, count in enumerate(counts)}
    return draw.choice([path for path, count in anchors.items() if t.substreams[path].lanes > count])


@fault("substream.final_state", _idle_paths, (STATE_MIN + 1, 0xFFFFFFFF))
def idle_lane(t: Target, path: str, value: int = STATE_MIN + 1) -> Edit:
    """The state of a last lane without symbols is not 2^16."""
    s = t.substreams[path]
    assert t.data[s.state_at(-1) : s.state_at(-1) + 4] == struct.pack("<I", STATE_MIN)
    return Edit({s.state_at(-1): struct.pack("<I", value)}, s.start)


@fault("substream.final_state")
def used_lane(t: Target, path: str, more: int) -> Edit:
    """The state of the first lane is increased, without an effect on the words that it reads."""
    s = t.substreams[path]
    assert s.words == 0
    (old,) = struct.unpack_from("<I", t.data, s.state_at(0))
    return Edit({s.state_at(0): struct.pack("<I", old + more)}, s.start)


@fault("substream.raw_length", _path, lambda d, t, _: d.content(1, 3))
def raw_bytes(t: Target, path: str, content: bytes = b"\0") -> Whole:
    """There are unused raw bytes."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, t.data[s.start : s.end] + content), s.start)


@fault("substream.raw_length")
def no_raw_bytes(t: Target, path: str) -> Whole:
    """There are no raw bytes for the raw bits of the symbols. Those bits must not be of escapes."""
    s = t.substreams[path]
    return Whole(t.with_substream(path, t.data[s.start : s.raw_at]), s.start)


@fault("substream.symbol_crc", _path, (0, 3), (1, 255))
def symbol_crc(t: Target, path: str, at: int, bits: int) -> Edit:
    """Bits of a byte of the CRC-32 of a substream's symbols are flipped."""
    s = t.substreams[path]
    return Edit(t.flip(s.start + at, bits), s.start)


# A file in which all substreams have lanes without symbols.
idle = target_of(lambda: drawn("refused-idle", 3, lanes=Lanes(6, 4, 8)))
# By kind of substream: a file with one, its path and its feature, and the path of the last one.
KINDS = {
    "planes": (plain, "planes.r1", "planes", "planes.r2.bottom_right"),
    "masks": (plain, "masks[chunk 0]", "masks", ""),
    "attributes": (plain, ATTRIBUTES_0, "attributes", "attributes[chunk 2]"),
    "positions": (five_cells, "positions[chunk 0]", "packed-positions", ""),
    "weights": (grids, "weights", "packed-weights", ""),
}


def _every_kind(kind: str) -> list[Recipe]:
    """Returns files with the faults that every kind of substream can have."""
    base, path, feature, last = KINDS[kind]
    rows: list[Row] = [
        ("cut-in-states", "a substream that ends within its states", cut, path, -1, More("truncation")),
        ("word-more", "a word that no lane takes", more_words, path, 1, More("words-uncounted")),
        ("symbol-crc", "a CRC-32 of other symbols", symbol_crc, path, 3, 1, More("symbol-crc")),
    ]
    if kind != "masks":
        limit = More("limit-off-by-one initial-state")
        rows += [
            ("state-below", "an initial state of 2^16 - 1", state, path, -1, STATE_MIN - 1, limit),
            ("raw-byte-more", "a raw byte that nothing reads", raw_bytes, path, More("raw-length-unchecked")),
        ]
    if last:
        wraps = More("lengths-trusted sum-wraps buffer-too-small")
        other = "a CRC-32 of other symbols, of the last substream"
        rows += [
            ("words-beyond", "a word_count of 2^32 - 1", word_count, path, (1 << 32) - 1, wraps),
            ("cut-in-head", "a substream that ends within its head", cut, path, 7, More("truncation")),
            ("word-less", "a word too few", word_less, path, More("words-uncounted")),
            ("last-symbol-crc", other, symbol_crc, last, 3, 1, More("symbol-crc last-chunk")),
        ]
    whole = [(f"{kind}-{name}", f"{title}, in the {kind}", base, *rest) for name, title, *rest in rows]
    return refused(f"substream {feature}", "", *whole, requirements="D8.8-1 D8.8-2")


# fmt: off
_END = "D8.8-1 D8.8-2 D8.7-1"
CASES = [
    *(case for kind in KINDS for case in _every_kind(kind)),
    *refused("substream attributes", "truncation", (partial(far, 1000),),
        ("attributes-of-5-bytes", "the file ends within the head of its last substream", cut, ATTRIBUTES_0, 5),
        ("attributes-of-3-bytes", "the file ends within symbol_crc of its last substream", cut, ATTRIBUTES_0, 3)),
    *refused("substream", "sum-wraps lengths-trusted",
        ("words-wrap", "a word_count whose double is right modulo 2^32", word_count, ATTRIBUTES_0,
         lambda t: t.substreams[ATTRIBUTES_0].words + (1 << 31))),
    # The 18 bits of an escape have three bytes, and two words would have four.
    *refused("substream", "lengths-trusted",
        ("words-by-one-byte", "words that end one byte behind their substream", partial(beyond, (1 << 8) + 3),
         word_count, ATTRIBUTES_0, lambda t: t.substreams[ATTRIBUTES_0].words + 2)),
    # The 16 bits of an escape fill two bytes. A third byte is unused.
    *refused("raw-bits substream", "raw-length-unchecked",
        ("raw-byte-of-nothing", "a raw byte after the last bit fills the one before", partial(beyond, (1 << 7) + 3),
         raw_bytes, ATTRIBUTES_0), requirements=_END),
    *refused("lanes substream", "final-state",
        *((f"final-state-idle-{kind}", f"a lane that no symbol uses is not at 2^16, in the {kind}", idle, idle_lane,
           path, More("idle-lanes"))
          for kind, path in (("planes", "planes.r1"), ("masks", "masks[chunk 0]"), ("attributes", ATTRIBUTES_0))),
        # A lane whose symbols leave it above 2^16 without a word. Its final state is 2^14 larger.
        ("final-state-used", "a lane that ends above 2^16", partial(far, 0), used_lane, ATTRIBUTES_0, 2),
        requirements=_END),

    *valid("lanes substream", "lane-order idle-lanes group-continues", "D8.2-1 D8.3-1", *(
        (f"lanes-{part}-{log2}", f"{1 << log2} lanes of each substream of {part}s",
         partial(drawn, f"lanes-{part}-{log2}", 21, lanes=replace(Lanes(1, 2, 1), **{part: log2}), chunk_size=16))
        for part in ("plane", "mask", "attribute") for log2 in (0, 3, 8))),
    *valid("lanes packed-positions", "lanes-of-another-part", "D8.3-1 D7.12-1",
        ("lanes-positions", "substreams of positions have the lanes of masks",
         partial(on_lattice, "lanes-positions", 30, lanes=Lanes(0, 3, 0)))),
    *valid("lanes packed-weights", "lanes-of-another-part", "D8.3-1 D7.13-1",
        ("lanes-weights", "the substream of weights has the lanes of attributes",
         lambda: packed_weights(drawn("lanes-weights", 3, lanes=Lanes(0, 1, 3))))),
    *valid("substream lanes", "word-order lane-order", "D8.2-1 D8.3-1 R8.8-1",
        ("words-many", "symbols that nearly all take a word, in 16 lanes at once",
         lambda: spread("words-many", CHANNEL * 0 + 3, CHANNEL % 20, 20, Rare(Numbers("words-many")), Lanes(0, 0, 4)))),
    *valid("substream", "final-state", "D8.2-1 R8.8-1 R8.8-2",
        ("words-none", "a substream without words",
         lambda: only_symbols(spread("words-none", CHANNEL * 0, CHANNEL * 0 - 40, 1, lanes=Lanes(0, 0, 0))))),
    *valid("substream", "symbol-crc group-continues", "D8.2-1 D8.3-1 R8.8-5",
        ("substream-long", "one lane, thousands of symbols",
         lambda: sampled(scene("substream-long", 200, lanes=Lanes(0, 0, 0)), Sampler(Numbers("substream-long"), 15)))),
]
