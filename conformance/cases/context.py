"""Cases of clause 7.5, from a position to its context: frame, contraction, samples of planes, encoding."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.frame import FRAME_RANGE_BOUND, MATRIX_BOUND, TRANSLATION_BOUND, Frame
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Scene

from .book import Book
from .numbers import Int64, Numbers
from .samplers import Sampler, sampled
from .scenes import f16, frame_of, observing, packed_weights, scene

# Dimensions of scenes that show their context. Two plane channels and three frequencies give ten numbers, and all of
# them affect the sixteen channels of attributes.
SEEN = Dimensions(1, (4, 3), 2, 3, 5, (20,), (4,), (3,), 1)
ONES = np.eye(3, dtype=np.int64)
# SPEC 6.7: the largest numbers of a frame.
MATRIX, TRANSLATION, RANGE = MATRIX_BOUND - 1, TRANSLATION_BOUND - 1, FRAME_RANGE_BOUND


def add(book: Book) -> None:
    """Adds the vectors."""
    numbers = Numbers("frames")
    _frames(book, numbers)
    # These frames continue the sequence of numbers.
    _contractions(book, numbers)
    _exact_frames(book)
    _queries(book)
    _encodings(book)
    _parts_of_context(book)


def shown(
    name: str, where: NDArray[np.float16], frame: Frame, d: Dimensions = SEEN, plane_shift: int = 8, **changes: Any
) -> Scene:
    """Returns a scene whose symbols depend on every bit of the context of each anchor."""
    numbers = Numbers(name)
    planes = numbers.integers(-3, 3, 5, d.plane_channels, d.plane_size, d.plane_size).astype(np.int16)
    fields = {"planes": planes, "networks": observing(d, numbers), "plane_shift": plane_shift, **changes}
    made = scene(name, len(where), d, positions=where, frame=frame, **fields)
    return sampled(made, Sampler(numbers, 0), planes=False)


def _frames(book: Book, numbers: Numbers) -> None:
    bits = np.array([s | e << 10 | m for e in range(31) for s in (0, 0x8000) for m in (0, 1, 0x3FF)], np.uint16)
    bits = bits[(bits != 0) & (bits != 0x8000)]
    count = len(bits) // 3
    every = bits[: 3 * count].reshape(3, count).T.copy().view(np.float16)
    book.valid(
        "f16-exponents",
        "positions with every exponent of f16, subnormal ones too",
        partial(
            shown,
            "f16-exponents",
            every,
            frame_of(ONES * 9, shift=(20, 21, 22), low=(-300000 // 2,) * 3, high=(RANGE,) * 3),
        ),
        features="raw-positions frame",
        requirements="D7.4-1 D7.5.1-1 D7.5-1",
        flags="subnormals",
    )
    subnormal = f16(numbers.integers(-1023, 1023, 40, 3))
    small = {"low": (-600, -500, -700), "high": (650, 500, 700)}
    frames: list[tuple[str, str, Frame, NDArray[np.float16], str]] = [
        (
            "rounding",
            "frame sums that are ties, of either sign",
            frame_of([3, 0, 1, 1, 5, 0, 0, 1, 7], (1, -1, 0), (1, 2, 3), (-1200, -900, -600), (1200, 900, 600)),
            subnormal,
            "frame-rounding",
        ),
        ("no-shift", "no shift at all", frame_of(ONES, **small), subnormal, "frame-rounding"),
        (
            "largest-shift",
            "the largest shift, and the largest sums",
            frame_of(
                [MATRIX] * 3 + [-MATRIX] * 3 + [MATRIX, -MATRIX, MATRIX],
                (TRANSLATION, -TRANSLATION, 1 - (1 << 60)),
                (60, 60, 59),
                (-4, -4, -4),
                (4, 4, 4),
            ),
            f16(numbers.chosen([2047 << 29, -(2047 << 29), 1 << 39, -(1 << 39), 0], 30, 3)),
            "sum-width",
        ),
        (
            "clamp",
            "frame coordinates that are clamped",
            frame_of([MATRIX, 1, 0, 0, MATRIX, 1, -1, 0, MATRIX], (0, 5, -5), (0, 1, 2)),
            f16(numbers.chosen([1 << 30, -(1 << 30), 1 << 11, 1 << 12, -(1 << 12), 5, 0], 40, 3)),
            "frame-clamp",
        ),
        (
            "translation",
            "the largest translations",
            frame_of(ONES, (TRANSLATION, -TRANSLATION, TRANSLATION), (45, 46, 47)),
            subnormal,
            "sum-width",
        ),
        ("axes", "a frame that swaps axes", frame_of([0, 1, 0, 0, 0, 1, 1, 0, 0], **small), subnormal, "axes-swapped"),
    ]
    for name, title, frame, where, flags in frames:
        make = partial(shown, f"frame-{name}", where, frame)
        book.valid(f"frame-{name}", title, make, features="frame", requirements="D7.5.1-1 D7.5-1", flags=flags)


def _exact_frames(book: Book) -> None:
    """Adds anchors at 0, so that the frame's sum is the translation."""
    # A length just below a whole number, to which binary64 rounds its square root.
    side = 44720
    # A sum just below a tie, to which binary64 rounds it, and one below the clamp, where the limits of 31 bits differ.
    for name, title, first, shift, low, high, requirement, flags in (
        (
            "root",
            "a length whose square is just below a square",
            (side * side // 2, side, 0),
            (0, 0, 0),
            (131060, -9, -9),
            (131076, 9, 9),
            "D7.5.2-1",
            "contraction-rounding",
        ),
        (
            "sum",
            "a frame sum that needs more than 53 bits",
            ((16384 << 45) + (1 << 44) - 1, 0, 0),
            (45, 0, 0),
            (16380, -9, -9),
            (16388, 9, 9),
            "D7.5.1-1",
            "sum-width frame-rounding",
        ),
        (
            "lowest",
            "a frame coordinate that is clamped from below, alone",
            (-(1 << 40), 0, 0),
            (0, 0, 0),
            (-131076, -9, -9),
            (-131060, 9, 9),
            "D7.5.1-1",
            "frame-clamp",
        ),
    ):
        frame = frame_of(ONES * 0, first, shift, low, high)
        book.valid(
            f"frame-exact-{name}",
            title,
            partial(shown, f"planted-{name}", np.zeros((4, 3), np.float16), frame),
            features="frame contraction",
            requirements=f"{requirement} D7.5-1",
            flags=flags,
        )


def _contractions(book: Book, numbers: Numbers) -> None:
    sphere = f16(numbers.chosen([0, 1 << 16, -(1 << 16), 1 << 15, -(1 << 15), 46336, -46336, 46368, 3 << 14], 60, 3))
    far = f16(numbers.integers(-2047, 2047, 60, 3) << numbers.integers(0, 24, 60, 3))
    near = f16(numbers.integers(-3, 3, 30, 3))
    wide = frame_of(ONES, low=(-131072, -131071, -131072), high=(131072, 131072, 131071))
    narrow = frame_of(ONES, low=(-2000, -1500, -1000), high=(2000, 1500, 1001))
    ends = [
        [-2000, 1500, 1001],
        [2000, -1500, -1000],
        [-2001, 1501, 1002],
        [2002, -1502, -1001],
        [0, 0, 0],
        [1, -1, 1],
        [-1999, 1499, 1000],
        [1999, -1499, -999],
        [2047, -2047, 2047],
    ]
    contractions: list[tuple[str, str, Frame, NDArray[np.float16], str]] = [
        ("boundary", "coordinates on and about the unit sphere", wide, sphere, "contraction-rounding"),
        (
            "far",
            "coordinates from near the middle to far outside",
            wide,
            far,
            "contraction-rounding contraction-missing",
        ),
        (
            "scaled",
            "far coordinates, with bounds near the edge",
            frame_of(ONES, low=(60000, -131072, 90000), high=(131000, -60000, 131072)),
            far,
            "contraction-rounding",
        ),
        ("ends", "coordinates at and beyond both bounds", narrow, f16(np.array(ends)), "rescale-ends"),
        ("one-unit", "bounds that are one apart", frame_of(ONES, low=(-1, 0, 1), high=(0, 1, 2)), near, "rescale-ends"),
        ("widest", "the widest bounds", frame_of(ONES, low=(-RANGE,) * 3, high=(RANGE,) * 3), far, "rescale-ends"),
        (
            "lowest",
            "bounds at the lower limit",
            frame_of(ONES, low=(-RANGE,) * 3, high=(1 - RANGE, -100000, 0)),
            far,
            "rescale-ends",
        ),
        (
            "highest",
            "bounds at the upper limit",
            frame_of(ONES, low=(RANGE - 1, 100000, 0), high=(RANGE,) * 3),
            far,
            "rescale-ends",
        ),
    ]
    for name, title, frame, where, flags in contractions:
        book.valid(
            f"contraction-{name}",
            title,
            partial(shown, f"contraction-{name}", where, frame),
            features="contraction",
            requirements="D7.5.2-1 D7.5.3-1 D7.5-1",
            flags=flags,
        )


# --- samples of planes, and the encoding ------------------------------------------------------------------------------


def _within() -> tuple[NDArray[np.float16], Frame]:
    """Returns positions between bounds in steps of one, so that u has all fractions, and their frame."""
    inside = Numbers("queries").integers(-1000, 1000, 50, 3)
    where = f16(np.concatenate([inside, [[-1000, -1000, -1000], [1000, 1000, 1000], [1000, -1000, 0]]]))
    return where, frame_of(ONES, low=(-1000,) * 3, high=(1000,) * 3)


def _queries(book: Book) -> None:
    where, frame = _within()
    for shift, largest in ((0, 32767), (1, 1 << 10), (5, 1 << 6), (10, 1)):
        planes = Numbers(f"query/{shift}").integers(-largest, largest, 5, 2, 5, 5).astype(np.int16)
        book.valid(
            f"query-shift-{shift}",
            f"plane samples with plane_shift {shift}, clamped ones too",
            partial(shown, f"query-shift-{shift}", where, frame, plane_shift=shift, planes=planes),
            features="query",
            requirements="D7.5.4-1 D7.5-1",
            flags="sample-rounding sample-clamp plane-axes quadrant-order",
        )
    for size in (2, 3, 32):
        book.valid(
            f"query-size-{size}",
            f"planes of {size} points along a side, sampled at both edges",
            partial(shown, f"query-size-{size}", where, frame, replace(SEEN, plane_size=size)),
            features="query",
            requirements="D7.5.4-1 D7.3-2",
            flags="edge-cell quadrant-order",
        )


def _encodings(book: Book) -> None:
    where, frame = _within()
    for count in (1, 10):
        d = replace(SEEN, frequency_count=count, plane_channels=1, hyper_width=(4 + 4 * count,), slices=(16, 16))
        book.valid(
            f"encoding-{count}",
            f"positional encoding of {count} frequencies",
            partial(shown, f"encoding-{count}", where, frame, d),
            features="encoding",
            requirements="D7.5.5-1 D7.5-1",
            flags="phase-rounding sine-order",
        )
    # u = z + 2^15 for z in units of 1; 32 of them are half an entry of the sine table.
    z: Int64 = np.concatenate(
        [np.arange(-40, 41), np.array([-1024, -1000, 992, 1023, 31, 33, 95, 97]), 16 * np.arange(-60, 60, 7)]
    )
    points = np.zeros((len(z), 3), np.int64)
    points[:, 2] = z
    d = replace(SEEN, frequency_count=6, plane_channels=1, hyper_width=(28,), slices=(16, 16))
    ties = frame_of(ONES, low=(-5, -5, -(1 << 15)), high=(5, 5, 1 << 15))
    book.valid(
        "encoding-ties",
        "phases halfway between entries of the sine table",
        partial(shown, "encoding-ties", f16(points), ties, d),
        features="encoding",
        requirements="D7.5.5-1 DA-1",
        flags="phase-rounding sine-order",
    )
    top = f16(np.array([[0, 0, 9], [0, 0, 40], [3, 1, 8], [0, 0, -9]]))
    d = replace(SEEN, slices=(16, 4), frequency_count=10, hyper_width=(48,))
    book.valid(
        "encoding-top",
        "anchors at the upper end of the third component, and ten frequencies",
        partial(shown, "planted-top", top, frame_of(ONES, low=(-9, -9, -9), high=(9, 9, 9)), d),
        features="encoding",
        requirements="D7.5.3-1 D7.5.5-1",
        flags="rescale-ends",
    )
    d = replace(SEEN, frequency_count=16, plane_channels=1, hyper_width=(68,), slices=(16, 24))
    book.valid(
        "encoding-16",
        "positional encoding of 16 frequencies, the most there can be",
        partial(_packed, "encoding-16", where, frame, d, profile=MAIN),
        features="encoding main packed-weights",
        requirements="D7.5.5-1 D7.5-1",
        flags="phase-rounding sine-order",
    )


def _packed(*args: Any, **fields: Any) -> Scene:
    """Returns the result of `shown`, with its weights in mode 1: nearly all of them are 0."""
    return packed_weights(shown(*args, **fields))


def _parts_of_context(book: Book) -> None:
    """Adds contexts with planes only, with the encoding only, and with the most planes."""
    where, frame = _within()
    rows: list[tuple[str, str, dict[str, Any], dict[str, Any]]] = [
        (
            "planeless",
            "a context of the encoding alone",
            {"plane_channels": 0, "plane_size": 0, "sarm_width": (), "hyper_width": (12,)},
            {"plane_shift": 0},
        ),
        ("unencoded", "a context of planes alone", {"frequency_count": 0, "hyper_width": (8,)}, {}),
        (
            "most-planes",
            "planes of 16 channels, the most there can be",
            {"plane_channels": 16, "hyper_width": (76,), "slices": (16, 24)},
            {"profile": MAIN},
        ),
    ]
    for name, title, changes, fields in rows:
        book.valid(
            f"context-{name}",
            title,
            partial(_packed, f"context-{name}", where, frame, replace(SEEN, **changes), **fields),
            features="query encoding dimensions packed-weights",
            requirements="D7.5-1 D7.5.4-1 D7.7-1",
            flags="plane-axes sine-order",
        )
