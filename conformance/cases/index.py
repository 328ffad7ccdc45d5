"""Cases of clauses 5.12, 5.13 and 6.10: the model of positions, and the entries of chunks.

The mask model is in attributes.py. Faults of entries that contradict their chunk are in chunks.py.
"""

import struct
from functools import partial

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.directory import DATA, INDEX
from refcodec.bitstream.index import ANCHORS_OF_A_BYTE, CHUNK_HEAD_BYTES
from refcodec.bitstream.positions import CELL_INDEX, HALVES, POSITION_MODELS
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .checksums import resized
from .fault import Draw, Drawn, Edit, Spec, Whole, element, fault
from .samplers import drawn
from .scenes import SMALLEST, cheap, cuboid, f16, scene, sharp_model
from .table import More, refused, valid
from .target import Target
from .targets import far, packed, plain, target_of
from .weights import packed_weights

# f16 numbers that a bound of a chunk cannot be.
WRONG_F16 = {"infinite": 0x7C00, "minus-infinite": 0xFC00, "not-a-number": 0x7E01, "negative-zero": 0x8000}


def _of_models(numbers: range) -> Spec:
    """Returns a function that draws one of the numbers, if there are models of positions."""
    return lambda draw, t: draw.choice(numbers if t.sections[INDEX].mode else [])


_model = _of_models(range(POSITION_MODELS))


def _frequencies(t: Target, model: int) -> list[int]:
    """Returns the frequencies of a model."""
    return [t.value(f"index.position_model.frequency[{HALVES * model + i}]") for i in range(HALVES)]


def _with_frequencies(t: Target, model: int, values: list[int]) -> Edit:
    paths = [f"index.position_model.frequency[{HALVES * model + i}]" for i in range(HALVES)]
    return Edit(t.pack({path: value % (1 << 16) for path, value in zip(paths, values, strict=True)}), t.at(paths[0]))


reserved = element("index.reserved", "index.position_model.reserved[{}]", _of_models(range(3)), (1, 255))
cell_shift = element("index.position_model", "index.position_model.cell_shift", _of_models(range(CELL_INDEX + 1, 256)))


@fault("index.position_model", _model, lambda d, t, _: {d.integer(0, HALVES - 1): d.integer(1, 65535)})
def frequencies(t: Target, model: int, changes: dict[int | None, int]) -> Edit:
    """Frequencies have a wrong sum, or an impossible symbol has a frequency.

    changes: numbers to add, by symbol. None is the symbol with the largest frequency.
    """
    values = _frequencies(t, model)
    largest = int(np.argmax(values))
    for symbol, more in changes.items():
        values[largest if symbol is None else symbol] += more
    return _with_frequencies(t, model, values)


# Symbol 0 is impossible for an empty node, and has the frequency 0.
@fault("index.position_model", _model, lambda d, t, m: d.choice([n for n, f in enumerate(_frequencies(t, m)) if f]))
def no_frequency(t: Target, model: int, symbol: int) -> Edit:
    """A possible symbol has the frequency 0. Its frequency is added to the largest of the others."""
    values = _frequencies(t, model)
    other = max((n for n in range(HALVES) if n != symbol), key=lambda n: (values[n], -n))
    values[symbol], values[other] = 0, values[other] + values[symbol]
    return _with_frequencies(t, model, values)


# --- faults of entries ------------------------------------------------------------------------------------------------


def any_chunk(draw: Draw, t: Target) -> int:
    """Draws one of the chunks, if there are any."""
    return draw.choice(range(t.header.chunk_count))


def _path(chunk: int, field: str) -> str:
    """Returns the path of a field of a chunk's entry."""
    return f"index.entry[{chunk}].{field}"


def held(t: Target, chunk: int = 0) -> int:
    """Returns the most anchors that the bytes of a chunk allow."""
    return int(ANCHORS_OF_A_BYTE * (t.value(_path(chunk, "length")) - CHUNK_HEAD_BYTES))


def _bounds(draw: Draw, t: Target) -> Drawn:
    """Draws a bound of a chunk, and an f16 that is not finite, or -0."""
    number = draw.integer(0x7C00, 0x7FFF) | draw.choice([0, 0x8000])
    field = f"{draw.choice(['low', 'high'])}[{draw.integer(0, 2)}]"
    return any_chunk(draw, t), field, struct.pack("<H", draw.choice([0x8000, number]))


def _lengths(draw: Draw, t: Target, chunk: int) -> int:
    """Draws a length that is not a multiple of four, or too small for the anchors."""
    old = t.value(_path(chunk, "length"))
    return draw.choice([0, 4, 12, 16, old + 1, old - 1, old + 2, 0xFFFFFFFF])


def _axis(draw: Draw, t: Target, chunk: int) -> int:
    largest = np.finfo(np.float16).max
    return draw.choice([axis for axis in range(3) if t.value(_path(chunk, f"high[{axis}]")) != largest])


def _kept(t: Target, chunk: int, more: int) -> int:
    """Returns more kept offsets than offsets in a chunk, modulo 2^32."""
    return (t.header.dimensions.offset_count * t.value(_path(chunk, "anchor_count")) + more) % (1 << 32)


bound = element("index.chunk", "index.entry[{}].{}", _bounds)
length = element("index.chunk", "index.entry[{}].length", any_chunk, _lengths)
anchor_count = element(
    "index.chunk",
    "index.entry[{}].anchor_count",
    any_chunk,
    lambda d, t, _: d.choice([0, t.fields.chunk_size + 1, 1 << 31, 0xFFFFFFFF]),
)
kept_count = element(
    "index.chunk", "index.entry[{}].kept_count", any_chunk, lambda d, t, chunk: _kept(t, chunk, d.integer(1, 1 << 31))
)


# There are too many anchors for the chunk's bytes, each of which allows 16 after the head. The length is reported.
crowd = element(
    "index.chunk",
    "index.entry[{}].anchor_count",
    [0],
    lambda d, t, chunk: held(t, chunk) + d.integer(1, 999),
    name="crowd",
    reported="index.entry[{}].length",
    base=lambda draw, t: far(0),
)


@fault("index.chunk", any_chunk, _axis)
def low_above_high(t: Target, chunk: int, axis: int) -> Edit:
    """A lower bound is the next number above the upper one. The lower one is reported."""
    low = _path(chunk, f"low[{axis}]")
    high = np.array([t.value(_path(chunk, f"high[{axis}]"))], np.float16)
    above = np.nextafter(high, np.float16(np.inf))
    # The number above the smallest negative one is -0, which is a different fault.
    above[above == 0] = np.float16(2.0**-24)
    return Edit({t.at(low): above.tobytes()}, t.at(low))


# --- faults of sums ---------------------------------------------------------------------------------------------------


def _others(draw: Draw, t: Target, chunk: int) -> int:
    most, old = min(t.fields.chunk_size, held(t, chunk)), t.value(_path(chunk, "anchor_count"))
    return draw.choice([n for n in (1, old - 1, old + 1, most) if n != old and 1 <= n <= most])


@fault("index.length", any_chunk, _others)
def anchors_amiss(t: Target, chunk: int, value: int) -> Edit:
    """The anchors of a chunk are possible, but the sum is not N."""
    return Edit(t.pack({_path(chunk, "anchor_count"): value, _path(chunk, "kept_count"): 0}), t.start(INDEX))


@fault("index.length", lambda d, t: {any_chunk(d, t): d.choice([4, 400, 1 << 31])})
def lengths_amiss(t: Target, changes: dict[int, int]) -> Edit:
    """The sum of the chunks' lengths is not that of DATA. changes: numbers to add modulo 2^32, by chunk."""
    paths = {_path(chunk, "length"): more for chunk, more in changes.items()}
    return Edit(t.pack({path: (t.value(path) + more) % (1 << 32) for path, more in paths.items()}), t.start(INDEX))


def _contents(draw: Draw, t: Target) -> bytes:
    content = t.content(DATA)
    return content[: -draw.integer(1, 4)] if content and draw.flag() else content + draw.content(1, 5)


@fault("index.length", _contents)
def data_amiss(t: Target, content: bytes) -> Whole:
    """DATA is longer or shorter than the chunks. content: its new content."""
    return Whole(resized(t.data, DATA, content), t.start(INDEX))


# A file without anchors whose index has a model of positions.
without_anchors = target_of(lambda: scene("outside-empty", 0, SMALLEST, position_model=sharp_model()))
_far_0 = partial(far, 0)


# A file of two anchors with negative coordinates, and one with padding after the last part of a chunk.
_negative = target_of(
    lambda: drawn("refused-negative", 2, SMALLEST, positions=f16(np.array([[-5, -7, -9], [-6, -3, -1024]])))
)
_padded_end = partial(far, 1000)


def _unpadded(t: Target) -> bytes:
    row = t.element("attributes[chunk 0], padding")
    assert row.end == t.start(DATA) + t.sections[DATA].length
    return t.content(DATA)[: row.start - row.end]


def _fullest() -> Scene:
    # Cuboids of cells with suitable models. One of them has 16 anchors per byte, the maximum.
    made = (cheap("index-fullest", cuboid(8, 8, depth)) for depth in range(9, 40))
    return next(each for each in made if held(Target(codec.emit(each))) == each.anchor_count)


# fmt: off
_NONE = np.zeros((0, 3), np.float16)
_LARGEST = np.array([[65504, -65504, 2.0**-24], [-65504, 65504, -(2.0**-24)]], np.float16)
_ENDS = np.array([[65504] * 3, [-65504] * 3], np.float16)
CASES = [
    # The model of positions.
    *refused("packed-positions", "reserved-unchecked", *(
        (f"position-model-reserved-{item}", f"reserved byte {item} of the model of positions is not zero", packed,
         reserved, item, 1) for item in (0, 2))),
    *refused("packed-positions", "position-model limit-off-by-one", (packed,),
        ("position-model-sum-more", "frequencies that add up to one more", frequencies, 0, {None: 1}),
        ("position-model-sum-less", "frequencies that add up to one less", frequencies, 17, {None: -1}),
        ("position-model-zero", "a frequency of 0", no_frequency, 6, 9),
        ("position-model-zero-after-none", "a frequency of 0 after no children, not of symbol 0", no_frequency, 7, 9),
        ("position-model-empty-node", "a frequency above 0 for a node without children", frequencies, 13,
         {None: -1, 0: 1}),
        ("position-model-no-first-half", "a frequency of 0 for no children in the first half", no_frequency, 12, 0),
        # The sum is right modulo 2^16.
        ("position-model-sum-wraps", "frequencies that add up modulo 2^16", frequencies, 2, {3: 32768, 4: 32768})),
    *refused("packed-positions", "limit-off-by-one shift-overflow",
        ("cell-shift-41", "cell_shift 41", packed, cell_shift, 41)),

    # Entries.
    *refused("chunks", "limit-off-by-one lengths-trusted",
        ("index-anchors-none", "a chunk of no anchors", anchor_count, 1, 0),
        ("index-anchors-above-chunk-size", "a chunk of one anchor more than chunk_size", anchor_count, 0, 5),
        ("index-anchors-huge", "a chunk of 2^32 - 1 anchors", anchor_count, 2, (1 << 32) - 1),
        ("index-length-none", "a chunk of no bytes", length, 0, 0),
        ("index-length-head", "a chunk of its head alone", length, 1, CHUNK_HEAD_BYTES),
        ("index-length-odd", "a length that is no multiple of four", length, 2, 121),
        ("index-length-half", "a length that is a multiple of two and not of four", length, 0, 162),
        ("index-length-huge", "a length of 2^32 - 1", length, 2, (1 << 32) - 1),
        ("index-length-crowded", "one anchor more than a chunk's bytes stand for, 16 for each byte behind its head",
         _far_0, crowd, 0, lambda t: held(t) + 1),
        ("index-kept-one-more", "a chunk that keeps one offset more than its anchors have", kept_count, 0,
         lambda t: _kept(t, 0, 1)),
        ("index-kept-last", "a last chunk that keeps as many offsets as the others could", kept_count, 2,
         lambda t: _kept(t, 2, 2)),
        ("index-kept-huge", "a chunk that keeps 2^32 - 1 offsets", kept_count, 1, (1 << 32) - 1)),
    *refused("chunks", "limit-off-by-one",
        ("index-length-crowded", "as many anchors as a chunk's bytes stand for, which are more than there are", _far_0,
         anchors_amiss, 0, held)),
    *refused("chunks", "half-limits float-limits",
        *((f"index-bound-{side}-{name or wrong}", f"{side} of a chunk is {(name or wrong).replace('-', ' ')}",
           bound, chunk, f"{side}[{axis}]", struct.pack("<H", WRONG_F16[wrong]))
          for side, wrong, chunk, axis, name in (
              ("low", "minus-infinite", 0, 0, "infinite"), ("low", "not-a-number", 1, 2, ""),
              ("low", "negative-zero", 2, 1, ""), ("high", "infinite", 1, 1, ""), ("high", "not-a-number", 2, 2, ""),
              ("high", "negative-zero", 0, 0, ""), ("low", "infinite", 1, 1, "plus-infinite"),
              ("high", "minus-infinite", 2, 0, ""))),
        *((f"index-low-above-high-{name}", f"low of a chunk is the next number above high: {name.replace('-', ' ')}",
           base, low_above_high, chunk, axis)
          for name, base, chunk, axis in (("first", plain, 0, 0), ("last", plain, 2, 2), ("one-anchor", _far_0, 0, 1))),
        ("index-low-above-high-negative", "low and high of a chunk that are negative, low above high", _negative,
         low_above_high, 0, 0)),

    # Sums.
    *refused("chunks", "lengths-trusted last-chunk",
        ("index-anchors-less", "chunks of one anchor less than there are", anchors_amiss, 0, 3),
        ("index-anchors-more", "chunks of one anchor more than there are", anchors_amiss, 2, 4),
        ("index-lengths-more", "lengths of four bytes more than the section", lengths_amiss, {0: 4}),
        ("index-lengths-less", "lengths of four bytes less than the section", lengths_amiss, {2: -4}),
        ("index-lengths-huge", "a length of 2^31 more", lengths_amiss, {1: 1 << 31}),
        ("index-lengths-packed-more", "lengths of packed chunks of four bytes more than the section", packed,
         lengths_amiss, {3: 4}),
        ("data-longer", "a section of chunks that has four bytes more", data_amiss,
         lambda t: t.content(DATA) + bytes(4))),
    *refused("chunks", "lengths-trusted sum-wraps",
        ("index-lengths-wrap", "lengths that add up modulo 2^32", lengths_amiss, {0: 1 << 31, 2: 1 << 31})),
    *refused("chunks", "padding-unchecked canonical-form",
        ("data-without-last-padding", "a section of chunks without the padding of the last one", _padded_end,
         data_amiss, _unpadded)),
    *refused("empty chunks", "empty-sections", *(
        (f"empty-data-of-{count}", f"no anchors, and {count} bytes in the section of chunks", without_anchors,
         data_amiss, bytes(count)) for count in (1, 4)), requirements="R11.2-2"),

    # Valid files.
    *valid("chunks raw-positions", "half-limits", "R6.10-5 R6.11-10",
        *((f"index-bounds-{name}", title,
           partial(drawn, f"index-bounds-{name}", 2, SMALLEST, positions=f16(np.array(points))), More("subnormals"))
          for name, title, points in (
              ("zero", "bounds of 0", [[0, 0, 0], [0, 0, 0]]),
              ("negative", "bounds that are negative, where the larger number has the smaller bits",
               [[-5, -7, -9], [-6, -3, -1]]),
              ("both-signs", "bounds of either sign", [[-5, 7, 0], [6, -3, -1]]))),
        ("index-bounds-largest", "bounds that are the largest and the least numbers of f16",
         partial(drawn, "index-bounds-largest", 2, SMALLEST, positions=_LARGEST), More("subnormals")),
        ("index-bounds-at-the-ends", "two chunks, one of the largest numbers of f16, and one of the least",
         partial(drawn, "index-bounds-at-the-ends", 2, SMALLEST, positions=_ENDS, chunk_size=1))),
    *valid("chunks packed-positions", "limit-off-by-one allocates-first", "R6.10-5 D7.12-1",
        ("index-fullest", "a chunk of as many anchors as its bytes can stand for", _fullest)),
    *valid("empty", "empty-refused", "D7.3-1 R6.10-6", ("empty", "no anchors, and no chunks", scene, "empty", 0)),
    *valid("empty packed-positions packed-weights", "empty-refused", "D7.13-1 R6.10-4",
        ("empty-packed", "no anchors, in mode 1 of index and weights",
         lambda: packed_weights(scene("empty-packed", 0, position_model=position_model(_NONE, 4096))))),
]
