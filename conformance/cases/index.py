"""Cases of clauses 5.12, 5.13 and 6.10: the model of positions, and the entries of chunks.

The mask model is in masks.py. Faults of entries that contradict their chunk are in chunks.py.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import cache, partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.directory import DATA, INDEX
from refcodec.bitstream.index import ANCHORS_OF_A_BYTE, CHUNK_HEAD_BYTES
from refcodec.bitstream.positions import CELL_INDEX, HALVES, POSITION_MODELS
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .cells import cheap, cuboid, sharp_model
from .checksums import resized
from .fault import Draw, Drawn, Edit, Whole, fault, one_field
from .samplers import drawn
from .scenes import SMALLEST, f16, packed_weights, scene
from .target import Target
from .targets import far, packed, plain

# f16 numbers that a bound of a chunk cannot be.
WRONG_F16 = {"infinite": 0x7C00, "minus-infinite": 0xFC00, "not-a-number": 0x7E01, "negative-zero": 0x8000}


def _path(chunk: int, field: str) -> str:
    """Returns the path of a field of a chunk's entry."""
    return f"index.entry[{chunk}].{field}"


def _chunk(draw: Draw, t: Target) -> int | None:
    """Draws one of the chunks, if there are any."""
    return draw.integer(0, t.header.chunk_count - 1) if t.header.chunk_count else None


# --- faults of the model of positions ---------------------------------------------------------------------------------


@fault("index.reserved")
def reserved(t: Target, item: int, value: int) -> Edit:
    """A reserved byte of the model of positions is not zero. The first of these bytes is reported."""
    path = "index.position_model.reserved"
    return Edit(t.pack({f"{path}[{item}]": value}), t.at(f"{path}[0]"))


@reserved.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (t, draw.integer(0, 2), draw.integer(1, 255)) if t.sections[INDEX].mode else None


@fault("index.position_model")
def cell_shift(t: Target, value: int) -> Edit:
    """The cell_shift is too large."""
    return one_field(t, "index.position_model.cell_shift", value)


@cell_shift.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (t, draw.integer(CELL_INDEX + 1, 255)) if t.sections[INDEX].mode else None


def _frequencies(t: Target, model: int) -> tuple[str, list[int]]:
    """Returns a model's path and its frequencies."""
    path = "index.position_model.frequency"
    return path, [t.value(f"{path}[{HALVES * model + i}]") for i in range(HALVES)]


def _with_frequencies(t: Target, model: int, values: list[int]) -> Edit:
    path, _ = _frequencies(t, model)
    packed_values = t.pack({f"{path}[{HALVES * model + i}]": value for i, value in enumerate(values)})
    return Edit(packed_values, t.at(f"{path}[{HALVES * model}]"))


@fault("index.position_model")
def frequencies(t: Target, model: int, changes: dict[int | None, int]) -> Edit:
    """Frequencies have a wrong sum, or an impossible symbol has a frequency.

    changes: numbers to add, by symbol. None is the symbol with the largest frequency.
    """
    _, values = _frequencies(t, model)
    largest = int(np.argmax(values))
    for symbol, more in changes.items():
        values[largest if symbol is None else symbol] += more
    return _with_frequencies(t, model, [value % (1 << 16) for value in values])


@frequencies.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if not t.sections[INDEX].mode:
        return None
    return t, draw.integer(0, POSITION_MODELS - 1), {draw.integer(0, HALVES - 1): draw.integer(1, 65535)}


@fault("index.position_model")
def no_frequency(t: Target, model: int, symbol: int) -> Edit:
    """A possible symbol has the frequency 0. Its frequency is added to the largest of the others."""
    _, values = _frequencies(t, model)
    other = max((n for n in range(HALVES) if n != symbol), key=lambda n: (values[n], -n))
    values[symbol], values[other] = 0, values[other] + values[symbol]
    return _with_frequencies(t, model, values)


@no_frequency.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if not t.sections[INDEX].mode:
        return None
    model, symbol = draw.integer(0, POSITION_MODELS - 1), draw.integer(0, HALVES - 1)
    # Symbol 0 is impossible for an empty node, and has the frequency 0.
    return (t, model, symbol) if _frequencies(t, model)[1][symbol] else None


# --- faults of entries ------------------------------------------------------------------------------------------------


@fault("index.chunk")
def anchor_count(t: Target, chunk: int, value: int) -> Edit:
    """A chunk has no anchors, or more than chunk_size."""
    return one_field(t, _path(chunk, "anchor_count"), value)


@anchor_count.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, chunk, draw.choice([0, t.fields.chunk_size + 1, 1 << 31, 0xFFFFFFFF]))


@fault("index.chunk")
def length(t: Target, chunk: int, value: int) -> Edit:
    """A length is not a multiple of four, or too small for the anchors."""
    return one_field(t, _path(chunk, "length"), value)


@length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    if chunk is None:
        return None
    old, few = t.value(_path(chunk, "length")), [0, 4, 12, 16]
    return t, chunk, draw.choice([*few, old + 1, old - 1, old + 2, 0xFFFFFFFF])


@fault("index.chunk")
def crowd(t: Target, chunk: int, more: int) -> Edit:
    """There are too many anchors for the chunk's bytes. The length is reported.

    more: the excess. Each byte after the head allows 16 anchors.
    """
    held = t.value(_path(chunk, "length")) - CHUNK_HEAD_BYTES
    count = ANCHORS_OF_A_BYTE * held + more
    assert count <= t.fields.chunk_size
    return Edit(t.pack({_path(chunk, "anchor_count"): count}), t.at(_path(chunk, "length")))


@crowd.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return far(0), 0, draw.integer(1, 999)


@fault("index.chunk")
def kept_count(t: Target, chunk: int, more: int) -> Edit:
    """There are more kept offsets than offsets in the chunk, modulo 2^32."""
    path = _path(chunk, "kept_count")
    most = t.header.dimensions.offset_count * t.value(_path(chunk, "anchor_count"))
    return Edit(t.pack({path: (most + more) % (1 << 32)}), t.at(path))


@kept_count.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, chunk, draw.integer(1, 1 << 31))


@fault("index.chunk")
def bound(t: Target, chunk: int, field: str, bits: int) -> Edit:
    """A bound of a chunk is not finite, or -0. field: such as `low[0]`."""
    at = t.at(_path(chunk, field))
    return Edit({at: struct.pack("<H", bits)}, at)


@bound.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    if chunk is None:
        return None
    number = draw.integer(0x7C00, 0x7FFF) | draw.choice([0, 0x8000])
    field = f"{draw.choice(['low', 'high'])}[{draw.integer(0, 2)}]"
    return t, chunk, field, draw.choice([0x8000, number])


@fault("index.chunk")
def low_above_high(t: Target, chunk: int, axis: int) -> Edit:
    """A lower bound is the next number above the upper one. The lower one is reported."""
    low = _path(chunk, f"low[{axis}]")
    high = np.array([t.value(_path(chunk, f"high[{axis}]"))], np.float16)
    above = np.nextafter(high, np.float16(np.inf))
    # The number above the smallest negative one is -0, which is a different fault.
    above[above == 0] = np.float16(2.0**-24)
    return Edit({t.at(low): above.tobytes()}, t.at(low))


@low_above_high.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk, axis = _chunk(draw, t), draw.integer(0, 2)
    if chunk is None or t.value(_path(chunk, f"high[{axis}]")) == np.finfo(np.float16).max:
        return None
    return t, chunk, axis


# --- faults of sums ---------------------------------------------------------------------------------------------------


@fault("index.length")
def anchors_amiss(t: Target, chunk: int, value: int) -> Edit:
    """The anchors of a chunk are possible, but the sum is not N."""
    return Edit(t.pack({_path(chunk, "anchor_count"): value, _path(chunk, "kept_count"): 0}), t.start(INDEX))


@anchors_amiss.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    if chunk is None:
        return None
    held = ANCHORS_OF_A_BYTE * (t.value(_path(chunk, "length")) - CHUNK_HEAD_BYTES)
    most, old = min(t.fields.chunk_size, held), t.value(_path(chunk, "anchor_count"))
    others = [n for n in (1, old - 1, old + 1, most) if n != old and 1 <= n <= most]
    return t, chunk, draw.choice(others)


@fault("index.length")
def lengths_amiss(t: Target, changes: dict[int, int]) -> Edit:
    """The sum of the chunks' lengths is not that of DATA. changes: numbers to add modulo 2^32, by chunk."""
    values = {path: t.value(path) + more for path, more in ((_path(c, "length"), m) for c, m in changes.items())}
    return Edit(t.pack({path: value % (1 << 32) for path, value in values.items()}), t.start(INDEX))


@lengths_amiss.drawn
def _(draw: Draw, t: Target) -> Drawn:
    chunk = _chunk(draw, t)
    return None if chunk is None else (t, {chunk: draw.choice([4, 400, 1 << 31])})


@fault("index.length")
def data_amiss(t: Target, content: bytes) -> Whole:
    """DATA is longer or shorter than the chunks. content: its new content."""
    return Whole(resized(t.data, DATA, content), t.start(INDEX))


@data_amiss.drawn
def _(draw: Draw, t: Target) -> Drawn:
    content = t.content(DATA)
    if content and draw.flag():
        return t, content[: -draw.integer(1, 4)]
    return t, content + draw.content(1, 5)


@cache
def without_anchors() -> Target:
    """Returns a file without anchors whose index has a model of positions."""
    return Target(codec.emit(scene("outside-empty", 0, SMALLEST, position_model=sharp_model())))


# --- the suite's refused files ----------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _models(book)
    _entries(book)
    _bounds(book)
    _sums(book)
    _valid(book)


def _models(book: Book) -> None:
    add = partial(book.add, features="packed-positions", flags="position-model limit-off-by-one")
    for item in (0, 2):
        title, make = f"reserved byte {item} of the model of positions is not zero", reserved.of(packed, item, 1)
        add(f"unsupported-position-model-reserved-{item}", title, make, flags="reserved-unchecked")
    for name, title, make in (
        ("sum-more", "frequencies that add up to one more", frequencies.of(packed, 0, {None: 1})),
        ("sum-less", "frequencies that add up to one less", frequencies.of(packed, 17, {None: -1})),
        ("zero", "a frequency of 0", no_frequency.of(packed, 6, 9)),
        ("zero-after-none", "a frequency of 0 after no children, not of symbol 0", no_frequency.of(packed, 7, 9)),
        (
            "empty-node",
            "a frequency above 0 for a node without children",
            frequencies.of(packed, 13, {None: -1, 0: 1}),
        ),
        ("no-first-half", "a frequency of 0 for no children in the first half", no_frequency.of(packed, 12, 0)),
        # The sum is right modulo 2^16.
        ("sum-wraps", "frequencies that add up modulo 2^16", frequencies.of(packed, 2, {3: 32768, 4: 32768})),
    ):
        add(f"invalid-position-model-{name}", title, make)
    title, make = "cell_shift 41", cell_shift.of(packed, 41)
    flags = "limit-off-by-one shift-overflow"
    book.add("invalid-cell-shift-41", title, make, features="packed-positions", flags=flags)


def _entries(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="limit-off-by-one lengths-trusted")
    for name, title, chunk, value in (
        ("none", "a chunk of no anchors", 1, 0),
        ("above-chunk-size", "a chunk of one anchor more than chunk_size", 0, 5),
        ("huge", "a chunk of 2^32 - 1 anchors", 2, (1 << 32) - 1),
    ):
        add(f"invalid-index-anchors-{name}", title, anchor_count.of(plain, chunk, value))
    for name, title, chunk, value in (
        ("none", "a chunk of no bytes", 0, 0),
        ("head", "a chunk of its head alone", 1, CHUNK_HEAD_BYTES),
        ("odd", "a length that is no multiple of four", 2, 121),
        ("half", "a length that is a multiple of two and not of four", 0, 162),
        ("huge", "a length of 2^32 - 1", 2, (1 << 32) - 1),
    ):
        add(f"invalid-index-length-{name}", title, length.of(plain, chunk, value))
    title = "one anchor more than a chunk's bytes stand for, 16 for each byte behind its head"
    add("invalid-index-length-crowded", title, crowd.of(partial(far, 0), 0, 1))
    title = "as many anchors as a chunk's bytes stand for, which are more than there are"
    make = anchors_amiss.of(partial(far, 0), 0, _held(far(0)))
    add("malformed-index-length-crowded", title, make, flags="limit-off-by-one")
    for name, title, chunk, more in (
        ("one-more", "a chunk that keeps one offset more than its anchors have", 0, 1),
        ("last", "a last chunk that keeps as many offsets as the others could", 2, 2),
        ("huge", "a chunk that keeps 2^32 - 1 offsets", 1, (1 << 32) - 9),
    ):
        add(f"invalid-index-kept-{name}", title, kept_count.of(plain, chunk, more))


def _held(t: Target) -> int:
    """Returns the most anchors that the bytes of the first chunk allow."""
    return int(ANCHORS_OF_A_BYTE * (t.value(_path(0, "length")) - CHUNK_HEAD_BYTES))


def _bounds(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="half-limits float-limits")
    for name, chunk, field, wrong in (
        ("low-infinite", 0, "low[0]", "minus-infinite"),
        ("low-not-a-number", 1, "low[2]", "not-a-number"),
        ("low-negative-zero", 2, "low[1]", "negative-zero"),
        ("high-infinite", 1, "high[1]", "infinite"),
        ("high-not-a-number", 2, "high[2]", "not-a-number"),
        ("high-negative-zero", 0, "high[0]", "negative-zero"),
        ("low-plus-infinite", 1, "low[1]", "infinite"),
        ("high-minus-infinite", 2, "high[0]", "minus-infinite"),
    ):
        field_name, _, what = name.partition("-")
        title = f"{field_name} of a chunk is {what.replace('-', ' ')}"
        add(f"invalid-index-bound-{name}", title, bound.of(plain, chunk, field, WRONG_F16[wrong]))
    for name, base, chunk, axis in (
        ("first", plain, 0, 0),
        ("last", plain, 2, 2),
        ("one-anchor", partial(far, 0), 0, 1),
    ):
        title = f"low of a chunk is the next number above high: {name.replace('-', ' ')}"
        add(f"invalid-index-low-above-high-{name}", title, low_above_high.of(base, chunk, axis))
    title, make = "low and high of a chunk that are negative, low above high", low_above_high.of(_negative, 0, 0)
    add("invalid-index-low-above-high-negative", title, make)


@cache
def _negative() -> Target:
    """Returns a file of two anchors with negative coordinates."""
    where = f16(np.array([[-5, -7, -9], [-6, -3, -1024]]))
    return Target(codec.emit(drawn("refused-negative", 2, SMALLEST, positions=where)))


def _sums(book: Book) -> None:
    add = partial(book.add, features="chunks", flags="lengths-trusted last-chunk")
    for name, title, chunk, value in (
        ("less", "chunks of one anchor less than there are", 0, 3),
        ("more", "chunks of one anchor more than there are", 2, 4),
    ):
        add(f"malformed-index-anchors-{name}", title, anchors_amiss.of(plain, chunk, value))
    for name, title, base, changes in (
        ("more", "lengths of four bytes more than the section", plain, {0: 4}),
        ("less", "lengths of four bytes less than the section", plain, {2: -4}),
        ("huge", "a length of 2^31 more", plain, {1: 1 << 31}),
        ("packed-more", "lengths of packed chunks of four bytes more than the section", packed, {3: 4}),
    ):
        add(f"malformed-index-lengths-{name}", title, lengths_amiss.of(base, changes))
    title, make = "lengths that add up modulo 2^32", lengths_amiss.of(plain, {0: 1 << 31, 2: 1 << 31})
    add("malformed-index-lengths-wrap", title, make, flags="lengths-trusted sum-wraps")
    content = plain().content(DATA)
    title, make = "a section of chunks that has four bytes more", data_amiss.of(plain, content + bytes(4))
    add("malformed-data-longer", title, make)
    title, make = "a section of chunks without the padding of the last one", data_amiss.of(_padded_end, _unpadded())
    add("malformed-data-without-last-padding", title, make, flags="padding-unchecked canonical-form")
    for count in (1, 4):
        book.add(
            f"malformed-empty-data-of-{count}",
            f"no anchors, and {count} bytes in the section of chunks",
            data_amiss.of(without_anchors, bytes(count)),
            features="empty chunks",
            requirements="R11.2-2",
            flags="empty-sections",
        )


@cache
def _padded_end() -> Target:
    """Returns a file with padding after the last part of a chunk."""
    found = next(t for t in map(far, range(1000, 1600, 100)) if t.elements.get("attributes[chunk 0], padding"))
    assert found.element("attributes[chunk 0], padding").end == found.start(DATA) + found.sections[DATA].length
    return found


def _unpadded() -> bytes:
    t = _padded_end()
    row = t.element("attributes[chunk 0], padding")
    return t.content(DATA)[: row.start - row.end]


# --- the suite's valid files ------------------------------------------------------------------------------------------


def _valid(book: Book) -> None:
    signs = [
        ("zero", "bounds of 0", [[0, 0, 0], [0, 0, 0]]),
        (
            "negative",
            "bounds that are negative, where the larger number has the smaller bits",
            [[-5, -7, -9], [-6, -3, -1]],
        ),
        ("both-signs", "bounds of either sign", [[-5, 7, 0], [6, -3, -1]]),
    ]
    for name, title, points in signs:
        book.valid(
            f"index-bounds-{name}",
            title,
            partial(drawn, f"index-bounds-{name}", 2, SMALLEST, positions=f16(np.array(points))),
            features="chunks raw-positions",
            requirements="R6.10-5 R6.11-10",
            flags="half-limits subnormals",
        )
    largest = np.array([[65504, -65504, 2.0**-24], [-65504, 65504, -(2.0**-24)]], np.float16)
    book.valid(
        "index-bounds-largest",
        "bounds that are the largest and the least numbers of f16",
        partial(drawn, "index-bounds-largest", 2, SMALLEST, positions=largest),
        features="chunks raw-positions",
        requirements="R6.10-5 R6.11-10",
        flags="half-limits subnormals",
    )
    book.valid(
        "index-bounds-at-the-ends",
        "two chunks, one of the largest numbers of f16, and one of the least",
        partial(
            drawn,
            "index-bounds-at-the-ends",
            2,
            SMALLEST,
            positions=np.array([[65504] * 3, [-65504] * 3], np.float16),
            chunk_size=1,
        ),
        features="chunks raw-positions",
        requirements="R6.10-5 R6.11-10",
        flags="half-limits",
    )
    book.valid(
        "index-fullest",
        "a chunk of as many anchors as its bytes can stand for",
        _fullest,
        features="chunks packed-positions",
        requirements="R6.10-5 D7.12-1",
        flags="limit-off-by-one allocates-first",
    )
    book.valid(
        "empty",
        "no anchors, and no chunks",
        partial(scene, "empty", 0),
        features="empty",
        requirements="D7.3-1 R6.10-6",
        flags="empty-refused",
    )
    book.valid(
        "empty-packed",
        "no anchors, in mode 1 of index and weights",
        _empty_packed,
        features="empty packed-positions packed-weights",
        requirements="D7.13-1 R6.10-4",
        flags="empty-refused",
    )


def _fullest() -> Scene:
    # Cuboids of cells with suitable models. One of them has 16 anchors per byte, the maximum.
    for size in ((8, 8, depth) for depth in range(9, 40)):
        made = cheap("index-fullest", cuboid(*size))
        t = Target(codec.emit(made))
        if _held(t) == made.anchor_count:
            return made
    raise AssertionError("no cuboid has sixteen anchors for each byte")


def _empty_packed() -> Scene:
    made = scene("empty-packed", 0)
    return packed_weights(replace(made, position_model=position_model(made.positions, 4096)))
