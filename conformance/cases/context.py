"""Cases of clauses 5.7, 6.7 and 7.5: the frame, and from a position to its context.

The context has four steps: frame, contraction, samples of planes, encoding.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.frame import FRAME_RANGE_BOUND, MATRIX_BOUND, TRANSLATION_BOUND, Frame
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Scene

from .fault import Edit, fault, wrong_value
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import f16, frame_of, scene
from .table import More, label_of, refused, valid
from .target import Target
from .weights import observing, packed_weights


@fault("frame.range", lambda d, t: d.choice([axis for axis in range(3) if t.has(f"frame.low[{axis}]")]))
def empty_range(t: Target, axis: int) -> Edit:
    """The high of an axis is equal to its low."""
    path = f"frame.high[{axis}]"
    return Edit(t.pack({path: t.value(f"frame.low[{axis}]")}), t.at(path))


def _frame(matrix: int, translation: int, shift: int, low: int, high: int) -> Frame:
    """Returns a frame with the same number for all axes."""
    return Frame(np.full((3, 3), matrix), *(np.full(3, value) for value in (translation, shift, low, high)))


# Dimensions of scenes that show their context. Two plane channels and three frequencies give ten numbers, and all of
# them affect the sixteen channels of attributes.
SEEN = Dimensions(1, (4, 3), 2, 3, 5, (20,), (4,), (3,), 1)
ONES = np.eye(3, dtype=np.int64)
# SPEC 6.7: the largest numbers of a frame.
MATRIX, TRANSLATION, RANGE = MATRIX_BOUND - 1, TRANSLATION_BOUND - 1, FRAME_RANGE_BOUND


def shown(
    name: str, where: NDArray[np.float16], frame: Frame, d: Dimensions = SEEN, plane_shift: int = 8, **changes: Any
) -> Scene:
    """Returns a scene whose symbols depend on every bit of the context of each anchor."""
    numbers = Numbers(name)
    planes = numbers.integers(-3, 3, 5, d.plane_channels, d.plane_size, d.plane_size).astype(np.int16)
    fields = {"planes": planes, "networks": observing(d, numbers), "plane_shift": plane_shift, **changes}
    made = scene(name, len(where), d, positions=where, frame=frame, **fields)
    return sampled(made, Sampler(numbers, 0), planes=False)


def _packed(*args: Any, **fields: Any) -> Scene:
    """Returns the result of `shown`, with its weights in mode 1: nearly all of them are 0."""
    return packed_weights(shown(*args, **fields))


def _exponents() -> NDArray[np.float16]:
    """Returns positions with every exponent of f16."""
    bits = np.array([s | e << 10 | m for e in range(31) for s in (0, 0x8000) for m in (0, 1, 0x3FF)], np.uint16)
    bits = bits[(bits != 0) & (bits != 0x8000)]
    count = len(bits) // 3
    return bits[: 3 * count].reshape(3, count).T.copy().view(np.float16)


def _chosen() -> list[NDArray[np.float16]]:
    """Returns positions for frames and contractions, from one sequence of numbers."""
    numbers = Numbers("frames")
    return [
        f16(numbers.integers(-1023, 1023, 40, 3)),
        f16(numbers.chosen([2047 << 29, -(2047 << 29), 1 << 39, -(1 << 39), 0], 30, 3)),
        f16(numbers.chosen([1 << 30, -(1 << 30), 1 << 11, 1 << 12, -(1 << 12), 5, 0], 40, 3)),
        f16(numbers.chosen([0, 1 << 16, -(1 << 16), 1 << 15, -(1 << 15), 46336, -46336, 46368, 3 << 14], 60, 3)),
        f16(numbers.integers(-2047, 2047, 60, 3) << numbers.integers(0, 24, 60, 3)),
        f16(numbers.integers(-3, 3, 30, 3)),
    ]


def _sampled(shift: int, largest: int) -> Scene:
    """Returns a scene with planes of numbers up to a largest one."""
    planes = Numbers(f"query/{shift}").integers(-largest, largest, 5, 2, 5, 5).astype(np.int16)
    return shown(f"query-shift-{shift}", _WHERE, _BETWEEN, plane_shift=shift, planes=planes)


# fmt: off
number = wrong_value("frame.range", {
    **{f"frame.matrix[{i}]": [1 << 20, -(1 << 20), -(1 << 31)] for i in range(9)},
    **{f"frame.translation[{i}]": [1 << 61, -(1 << 61), -(1 << 63)] for i in range(3)},
    **{f"frame.shift[{i}]": [61, 255] for i in range(3)},
    **{f"frame.low[{i}]": [1 << 18, -(1 << 18) - 1] for i in range(3)},
    **{f"frame.high[{i}]": [(1 << 18) + 1, -(1 << 18)] for i in range(3)}})
reserved = wrong_value("frame.reserved", {"frame.reserved": [1, 255]})

_WIDEST, _MATRIX, _TRANSLATION = 1 << 18, (1 << 20) - 1, (1 << 61) - 1
_SUBNORMAL, _LARGE, _CLAMPED, _SPHERE, _FAR, _NEAR = _chosen()
# Positions between bounds in steps of one, so that u has all fractions.
_INSIDE = Numbers("queries").integers(-1000, 1000, 50, 3)
_WHERE = f16(np.concatenate([_INSIDE, [[-1000, -1000, -1000], [1000, 1000, 1000], [1000, -1000, 0]]]))
_BETWEEN = frame_of(ONES, low=(-1000,) * 3, high=(1000,) * 3)
_SMALL = {"low": (-600, -500, -700), "high": (650, 500, 700)}
_ENDS = f16(np.array([
    [-2000, 1500, 1001], [2000, -1500, -1000], [-2001, 1501, 1002], [2002, -1502, -1001], [0, 0, 0], [1, -1, 1],
    [-1999, 1499, 1000], [1999, -1499, -999], [2047, -2047, 2047]]))
# With these frames u = z + 2^15 for z in units of 1; 32 of them are half an entry of the sine table.
_Z = np.concatenate([np.arange(-40, 41), [-1024, -1000, 992, 1023, 31, 33, 95, 97], 16 * np.arange(-60, 60, 7)])
_TIES = f16(np.stack([0 * _Z, 0 * _Z, _Z], axis=1))
_TOP = f16(np.array([[0, 0, 9], [0, 0, 40], [3, 1, 8], [0, 0, -9]]))
# The square root of a length just below a whole number is rounded to it in binary64.
_SIDE = 44720
# A sum just below a tie, to which binary64 rounds it.
_SUM = (16384 << 45) + (1 << 44) - 1
CASES = [
    *refused("frame", "limit-off-by-one signed-limits", *(
        (f"frame-{label_of(field)}-{name}", f"{field} of the frame is {value}", number, f"frame.{field}", value)
        for field, value, name in (
            ("matrix[0]", 1 << 20, "too-large"), ("matrix[8]", -(1 << 20), "too-small"),
            ("matrix[4]", -(1 << 31), "least"), ("translation[0]", 1 << 61, "too-large"),
            ("translation[2]", -(1 << 61),
             "too-small"), ("translation[1]", -(1 << 63), "least"), ("shift[2]", 61, "too-large"),
            ("low[0]", 1 << 18, "too-large"), ("low[2]", -(1 << 18) - 1, "too-small"),
            ("high[0]", (1 << 18) + 1, "too-large"), ("high[2]", -(1 << 31), "below-low"),
            ("high[1]", -(1 << 18), "too-small")))),
    *refused("frame", "reserved-unchecked",
        ("frame-reserved-set", "reserved of the frame is 1", reserved, "frame.reserved", 1)),
    *refused("frame", "limit-off-by-one division-by-zero", ("frame-empty-range", "high is low", empty_range, 1)),
    *valid("frame", "limit-off-by-one sum-width", "R6.7-2 D7.5.1-1", *(
        (f"frame-bounds-{name}", f"numbers of the frame at their bounds, {name}",
         partial(drawn, "frame-bounds", 5, frame=_frame(*numbers)))
        for name, numbers in (
            ("least", (-_MATRIX, -_TRANSLATION, 0, -_WIDEST, 1 - _WIDEST)),
            ("largest", (_MATRIX, _TRANSLATION, 60, _WIDEST - 1, _WIDEST)),
            ("widest", (_MATRIX, _TRANSLATION, 60, -_WIDEST, _WIDEST))))),

    # The frame.
    *valid("raw-positions frame", "subnormals", "D7.4-1 D7.5.1-1 D7.5-1",
        ("f16-exponents", "positions with every exponent of f16, subnormal ones too", shown, "f16-exponents",
         _exponents(), frame_of(ONES * 9, shift=(20, 21, 22), low=(-300000 // 2,) * 3, high=(RANGE,) * 3))),
    *valid("frame", "", "D7.5.1-1 D7.5-1", *(
        (f"frame-{name}", title, shown, f"frame-{name}", where, frame, More(flags))
        for name, title, flags, where, frame in (
            ("rounding", "frame sums that are ties, of either sign", "frame-rounding", _SUBNORMAL,
             frame_of([3, 0, 1, 1, 5, 0, 0, 1, 7], (1, -1, 0), (1, 2, 3), (-1200, -900, -600), (1200, 900, 600))),
            ("no-shift", "no shift at all", "frame-rounding", _SUBNORMAL, frame_of(ONES, **_SMALL)),
            ("largest-shift", "the largest shift, and the largest sums", "sum-width", _LARGE,
             frame_of([MATRIX] * 3 + [-MATRIX] * 3 + [MATRIX, -MATRIX, MATRIX],
                      (TRANSLATION, -TRANSLATION, 1 - (1 << 60)), (60, 60, 59), (-4, -4, -4), (4, 4, 4))),
            ("clamp", "frame coordinates that are clamped", "frame-clamp", _CLAMPED,
             frame_of([MATRIX, 1, 0, 0, MATRIX, 1, -1, 0, MATRIX], (0, 5, -5), (0, 1, 2))),
            ("translation", "the largest translations", "sum-width", _SUBNORMAL,
             frame_of(ONES, (TRANSLATION, -TRANSLATION, TRANSLATION), (45, 46, 47))),
            ("axes", "a frame that swaps axes", "axes-swapped", _SUBNORMAL,
             frame_of([0, 1, 0, 0, 0, 1, 1, 0, 0], **_SMALL))))),
    # Anchors at 0, so that the frame's sum is the translation.
    *valid("frame contraction", "", "", *(
        (f"frame-exact-{name}", title, shown, f"planted-{name}", np.zeros((4, 3), np.float16),
         frame_of(ONES * 0, first, (shift, 0, 0), (low, -9, -9), (high, 9, 9)), More(flags, requirements))
        for name, title, first, shift, low, high, requirements, flags in (
            ("root", "a length whose square is just below a square", (_SIDE * _SIDE // 2, _SIDE, 0), 0, 131060, 131076,
             "D7.5.2-1 D7.5-1", "contraction-rounding"),
            ("sum", "a frame sum that needs more than 53 bits", (_SUM, 0, 0), 45, 16380, 16388, "D7.5.1-1 D7.5-1",
             "sum-width frame-rounding"),
            ("lowest", "a frame coordinate that is clamped from below, alone", (-(1 << 40), 0, 0), 0, -131076, -131060,
             "D7.5.1-1 D7.5-1", "frame-clamp")))),

    # Contraction and bounds.
    *valid("contraction", "", "D7.5.2-1 D7.5.3-1 D7.5-1", *(
        (f"contraction-{name}", title, shown, f"contraction-{name}", where, frame_of(ONES, low=low, high=high),
         More(flags))
        for name, title, flags, where, low, high in (
            ("boundary", "coordinates on and about the unit sphere", "contraction-rounding", _SPHERE,
             (-131072, -131071, -131072), (131072, 131072, 131071)),
            ("far", "coordinates from near the middle to far outside", "contraction-rounding contraction-missing", _FAR,
             (-131072, -131071, -131072), (131072, 131072, 131071)),
            ("scaled", "far coordinates, with bounds near the edge", "contraction-rounding", _FAR,
             (60000, -131072, 90000), (131000, -60000, 131072)),
            ("ends", "coordinates at and beyond both bounds", "rescale-ends", _ENDS, (-2000, -1500, -1000),
             (2000, 1500, 1001)),
            ("one-unit", "bounds that are one apart", "rescale-ends", _NEAR, (-1, 0, 1), (0, 1, 2)),
            ("widest", "the widest bounds", "rescale-ends", _FAR, (-RANGE,) * 3, (RANGE,) * 3),
            ("lowest", "bounds at the lower limit", "rescale-ends", _FAR, (-RANGE,) * 3, (1 - RANGE, -100000, 0)),
            ("highest", "bounds at the upper limit", "rescale-ends", _FAR, (RANGE - 1, 100000, 0), (RANGE,) * 3)))),

    # Samples of planes.
    *valid("query", "sample-rounding sample-clamp plane-axes quadrant-order", "D7.5.4-1 D7.5-1", *(
        (f"query-shift-{shift}", f"plane samples with plane_shift {shift}, clamped ones too", _sampled, shift, largest)
        for shift, largest in ((0, 32767), (1, 1 << 10), (5, 1 << 6), (10, 1)))),
    *valid("query", "edge-cell quadrant-order", "D7.5.4-1 D7.3-2", *(
        (f"query-size-{size}", f"planes of {size} points along a side, sampled at both edges", shown,
         f"query-size-{size}", _WHERE, _BETWEEN, replace(SEEN, plane_size=size)) for size in (2, 3, 32))),

    # The positional encoding.
    *valid("encoding", "phase-rounding sine-order", "D7.5.5-1 D7.5-1", *(
        (f"encoding-{count}", f"positional encoding of {count} frequencies", shown, f"encoding-{count}", _WHERE,
         _BETWEEN,
         replace(SEEN, frequency_count=count, plane_channels=1, hyper_width=(4 + 4 * count,), slices=(16, 16)))
        for count in (1, 10))),
    *valid("encoding", "phase-rounding sine-order", "D7.5.5-1 DA-1",
        ("encoding-ties", "phases halfway between entries of the sine table", shown, "encoding-ties", _TIES,
         frame_of(ONES, low=(-5, -5, -(1 << 15)), high=(5, 5, 1 << 15)),
         replace(SEEN, frequency_count=6, plane_channels=1, hyper_width=(28,), slices=(16, 16)))),
    *valid("encoding", "rescale-ends", "D7.5.3-1 D7.5.5-1",
        ("encoding-top", "anchors at the upper end of the third component, and ten frequencies", shown, "planted-top",
         _TOP, frame_of(ONES, low=(-9, -9, -9), high=(9, 9, 9)),
         replace(SEEN, slices=(16, 4), frequency_count=10, hyper_width=(48,)))),
    *valid("encoding main packed-weights", "phase-rounding sine-order", "D7.5.5-1 D7.5-1",
        ("encoding-16", "positional encoding of 16 frequencies, the most there can be",
         partial(_packed, "encoding-16", _WHERE, _BETWEEN, profile=MAIN, d=replace(
             SEEN, frequency_count=16, plane_channels=1, hyper_width=(68,), slices=(16, 24))))),

    # Planes only, the encoding only, and the most planes.
    *valid("query encoding dimensions packed-weights", "plane-axes sine-order", "D7.5-1 D7.5.4-1 D7.7-1", *(
        (f"context-{name}", title, partial(_packed, f"context-{name}", _WHERE, _BETWEEN, d, **fields))
        for name, title, d, fields in (
            ("planeless", "a context of the encoding alone",
             replace(SEEN, plane_channels=0, plane_size=0, sarm_width=(), hyper_width=(12,)), {"plane_shift": 0}),
            ("unencoded", "a context of planes alone", replace(SEEN, frequency_count=0, hyper_width=(8,)), {}),
            ("most-planes", "planes of 16 channels, the most there can be",
             replace(SEEN, plane_channels=16, hyper_width=(76,), slices=(16, 24)), {"profile": MAIN})))),
]
