"""Valid files for the decoding process: geometry, networks, planes, masks, attributes and reconstruction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.dimensions import Dimensions, mask_contexts
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.networks import Layer
from refcodec.bitstream.scene import Scene

from .book import Book
from .numbers import Int64, Numbers
from .sampling import Sampler, sampled
from .scenes import SMALL, constant, dyadic, networks, observing, scene, with_symbols
from .structure import drawn

# Of the scenes that show their context: two channels, L of 3, so that F_h has ten inputs, and sixteen channels see all of them.
SEEN = Dimensions(1, (4, 3), 2, 3, 5, (20,), (4,), (3,), 1)
UNIT = 1 << 16
# SPEC 6.7
MATRIX, TRANSLATION, RANGE = (1 << 20) - 1, (1 << 61) - 1, 1 << 18


def add(book: Book) -> None:
    """Adds the vectors."""
    _frames(book)
    _queries(book)
    _networks(book)
    _planes(book)
    _masks(book)
    _attributes(book)
    _values(book)


def frame(
    matrix: Any, translation: Any = (0, 0, 0), shift: Any = (0, 0, 0), low: Any = None, high: Any = None
) -> Frame:
    """A frame from lists."""
    bounds = [np.full(3, -2 * UNIT) if low is None else low, np.full(3, 2 * UNIT) if high is None else high]
    return Frame(
        *(np.array(part, dtype=np.int64) for part in (np.reshape(matrix, (3, 3)), translation, shift, *bounds))
    )


def f16(integers: Int64) -> NDArray[np.float16]:
    """The positions whose P are these integers, which f16 holds."""
    found = np.ldexp(integers.astype(np.float64), -24).astype(np.float16)
    assert (np.ldexp(found.astype(np.float64), 24) == integers).all()
    found[found == 0] = 0
    return found


def shown(
    name: str, where: NDArray[np.float16], change: Frame, d: Dimensions = SEEN, plane_shift: int = 8, **changes: Any
) -> Scene:
    """A scene whose symbols depend on every bit of the context of each anchor."""
    numbers = Numbers(name)
    planes = numbers.integers(-3, 3, 5, d.plane_channels, d.plane_size, d.plane_size).astype(np.int16)
    fields = {
        "planes": planes,
        "networks": observing(d, numbers),
        "plane_shift": plane_shift,
        "frame": change,
        **changes,
    }
    made = scene(name, len(where), d, positions=where, **fields)
    return sampled(made, Sampler(numbers, 0), planes=False)


# --- 7.4 and 7.5 ------------------------------------------------------------------------------------------------------


def _frames(book: Book) -> None:
    ones = np.eye(3, dtype=np.int64)
    numbers = Numbers("frames")
    subnormal = f16(numbers.integers(-1023, 1023, 40, 3))

    def every() -> Scene:
        bits = np.array(
            [s | e << 10 | m for e in range(31) for s in (0, 0x8000) for m in (0, 1, 0x3FF) if s | e | m], np.uint16
        )
        bits = bits[bits != 0x8000]
        count = len(bits) // 3
        where = np.stack([bits[:count], bits[count : 2 * count], bits[2 * count : 3 * count]], axis=1).view(np.float16)
        return shown(
            "f16-exponents", where, frame(ones * 9, shift=(20, 21, 22), low=(-300000 // 2,) * 3, high=(RANGE,) * 3)
        )

    book.valid(
        "f16-exponents",
        "positions with every exponent of f16, subnormal ones too",
        every,
        features="raw-positions frame",
        requirements="D7.4-1 D7.5.1-1 D7.5-1",
        flags="subnormals",
    )
    small = {"low": (-600, -500, -700), "high": (650, 500, 700)}
    frames: list[tuple[str, str, Frame, NDArray[np.float16], str]] = [
        (
            "rounding",
            "frame sums that are ties, of either sign",
            frame([3, 0, 1, 1, 5, 0, 0, 1, 7], (1, -1, 0), (1, 2, 3), (-1200, -900, -600), (1200, 900, 600)),
            subnormal,
            "frame-rounding",
        ),
        ("no-shift", "no shift at all", frame(ones, **small), subnormal, "frame-rounding"),
        (
            "largest-shift",
            "the largest shift, and the largest sums",
            frame(
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
            frame([MATRIX, 1, 0, 0, MATRIX, 1, -1, 0, MATRIX], (0, 5, -5), (0, 1, 2)),
            f16(numbers.chosen([1 << 30, -(1 << 30), 1 << 11, 1 << 12, -(1 << 12), 5, 0], 40, 3)),
            "frame-clamp",
        ),
        (
            "translation",
            "the largest translations",
            frame(ones, (TRANSLATION, -TRANSLATION, TRANSLATION), (45, 46, 47)),
            subnormal,
            "sum-width",
        ),
        ("axes", "a frame that swaps axes", frame([0, 1, 0, 0, 0, 1, 1, 0, 0], **small), subnormal, "axes-swapped"),
    ]
    for name, text, change, where, flag in frames:

        def make(name: str = name, change: Frame = change, where: NDArray[np.float16] = where) -> Scene:
            return shown(f"frame-{name}", where, change)

        book.valid(f"frame-{name}", text, make, features="frame", requirements="D7.5.1-1 D7.5-1", flags=flag)
    sphere = f16(numbers.chosen([0, 1 << 16, -(1 << 16), 1 << 15, -(1 << 15), 46336, -46336, 46368, 3 << 14], 60, 3))
    far = f16(numbers.integers(-2047, 2047, 60, 3) << numbers.integers(0, 24, 60, 3))
    wide = {"low": (-131072, -131071, -131072), "high": (131072, 131072, 131071)}
    narrow = {"low": (-2000, -1500, -1000), "high": (2000, 1500, 1001)}
    contractions: list[tuple[str, str, Frame, NDArray[np.float16], str]] = [
        ("boundary", "coordinates on and about the unit sphere", frame(ones, **wide), sphere, "contraction-rounding"),
        (
            "far",
            "coordinates from near the middle to far outside",
            frame(ones, **wide),
            far,
            "contraction-rounding contraction-missing",
        ),
        (
            "scaled",
            "far coordinates, with bounds near the edge",
            frame(ones, low=(60000, -131072, 90000), high=(131000, -60000, 131072)),
            far,
            "contraction-rounding",
        ),
        (
            "ends",
            "coordinates at and beyond both bounds",
            frame(ones, **narrow),
            f16(
                np.array(
                    [
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
                )
            ),
            "rescale-ends",
        ),
        (
            "one-unit",
            "bounds that are one apart",
            frame(ones, low=(-1, 0, 1), high=(0, 1, 2)),
            f16(numbers.integers(-3, 3, 30, 3)),
            "rescale-ends",
        ),
        ("widest", "the widest bounds", frame(ones, low=(-RANGE,) * 3, high=(RANGE,) * 3), far, "rescale-ends"),
        (
            "lowest",
            "bounds at the lower limit",
            frame(ones, low=(-RANGE,) * 3, high=(1 - RANGE, -100000, 0)),
            far,
            "rescale-ends",
        ),
        (
            "highest",
            "bounds at the upper limit",
            frame(ones, low=(RANGE - 1, 100000, 0), high=(RANGE,) * 3),
            far,
            "rescale-ends",
        ),
    ]
    for name, text, change, where, flag in contractions:

        def contracted(name: str = name, change: Frame = change, where: NDArray[np.float16] = where) -> Scene:
            return shown(f"contraction-{name}", where, change)

        book.valid(
            f"contraction-{name}",
            text,
            contracted,
            features="contraction",
            requirements="D7.5.2-1 D7.5.3-1 D7.5-1",
            flags=flag,
        )


def _queries(book: Book) -> None:
    ones = np.eye(3, dtype=np.int64)
    # The coordinates go from bound to bound in steps of one, so that u has every kind of fraction.
    numbers = Numbers("queries")
    where = f16(
        np.concatenate(
            [numbers.integers(-1000, 1000, 50, 3), [[-1000, -1000, -1000], [1000, 1000, 1000], [1000, -1000, 0]]]
        )
    )
    change = frame(ones, low=(-1000,) * 3, high=(1000,) * 3)
    for shift in (0, 1, 5, 10):

        def make(shift: int = shift) -> Scene:
            largest = 32767 if shift == 0 else (1 << (11 - shift)) if shift < 10 else 1
            planes = Numbers(f"query/{shift}").integers(-largest, largest, 5, 2, 5, 5).astype(np.int16)
            return shown(f"query-shift-{shift}", where, change, plane_shift=shift, planes=planes)

        book.valid(
            f"query-shift-{shift}",
            f"plane samples with plane_shift {shift}, clamped ones too",
            make,
            features="query",
            requirements="D7.5.4-1 D7.5-1",
            flags="sample-rounding sample-clamp plane-axes quadrant-order",
        )
    for size in (2, 3, 32):

        def sized(size: int = size) -> Scene:
            return shown(f"query-size-{size}", where, change, replace(SEEN, plane_size=size))

        book.valid(
            f"query-size-{size}",
            f"planes of {size} points along a side, sampled at both edges",
            sized,
            features="query",
            requirements="D7.5.4-1 D7.3-2",
            flags="edge-cell quadrant-order",
        )
    for count in (1, 10):
        d = replace(SEEN, frequency_count=count, plane_channels=1, hyper_width=(4 + 4 * count,), slices=(16, 16))

        def encoded(d: Dimensions = d) -> Scene:
            return shown(f"encoding-{d.frequency_count}", where, change, d)

        book.valid(
            f"encoding-{count}",
            f"positional encoding of {count} frequencies",
            encoded,
            features="encoding",
            requirements="D7.5.5-1 D7.5-1",
            flags="phase-rounding sine-order",
        )

    def phases() -> Scene:
        # u = z + 2^15 for z in units of 1; 32 of them are half an entry of the sine table.
        z = np.concatenate(
            [np.arange(-40, 41), np.array([-1024, -1000, 992, 1023, 31, 33, 95, 97]), 16 * np.arange(-60, 60, 7)]
        )
        points = np.zeros((len(z), 3), np.int64)
        points[:, 2] = z
        d = replace(SEEN, frequency_count=6, plane_channels=1, hyper_width=(28,), slices=(16, 16))
        return shown("encoding-ties", f16(points), frame(ones, low=(-5, -5, -(1 << 15)), high=(5, 5, 1 << 15)), d)

    book.valid(
        "encoding-ties",
        "phases halfway between entries of the sine table",
        phases,
        features="encoding",
        requirements="D7.5.5-1 DA-1",
        flags="phase-rounding sine-order",
    )


# --- 7.2 --------------------------------------------------------------------------------------------------------------

# Of the scenes about rows: F_h reads ten numbers, and its sixteen hidden units are those of the row at the bound.
ROWS = Dimensions(1, (6, 2), 2, 3, 4, (16,), (4,), (16,), 1)


def _with_hyper(name: str, change: Callable[[list[Layer]], None], anchors: int = 24, d: Dimensions = ROWS) -> Scene:
    """A scene whose F_h is changed; its means depend on all of it."""
    numbers = Numbers(name)
    found = networks(d, numbers)
    layers = [(w.copy(), b.copy()) for w, b in found["hyper"]]
    change(layers)
    made = scene(name, anchors, d, networks={**found, "hyper": layers})
    return sampled(made, Sampler(numbers, 0))


def _networks(book: Book) -> None:
    total = ROWS.attribute_width

    def halves(layers: list[Layer]) -> None:
        # Exponents from 0 to 9: each sum is a tie as often as not.
        numbers = Numbers("network-ties")
        w, b = layers[-1]
        for r in range(total):
            w[r] = dyadic(numbers.integers(-500, 500, w.shape[1]) | 1, 1 + r % 3)
            b[r] = float(numbers.integer(-2000, 2000)) / 2

    def limits(layers: list[Layer]) -> None:
        w, b = layers[-1]
        for r, value in enumerate(
            (1023.0, 1023.4375, -1023.0, -1023.5, 511.75, -511.75, 1023.25 / 1024, -1023.5 / 1024, 1023.5 / 2048)
        ):
            w[r], b[r] = 0, r - 4
            w[r, r] = value

    def rounding(layers: list[Layer]) -> None:
        # The largest weight sets the exponent; the others lie halfway between integers then.
        w, b = layers[-1]
        for r in range(total):
            e = r % 11
            w[r] = dyadic((2 * Numbers("weight-ties").integers(-60, 60, w.shape[1]) + 1), 1 + e)
            w[r, r % w.shape[1]] = 1000.0 / 2**e
            b[r] = (2 * r - 15) / 2.0 ** (1 + e)

    def bound(layers: list[Layer]) -> None:
        # 16 weights of 1023 times 1023, and a bias that leaves nothing, or takes half of it.
        w, b = layers[-1]
        spare = (1 << 24) - 1 - 16 * 1023 * 1023
        w[:6] = 1023
        w[1] = -1023
        b[:6] = spare, -spare, spare - 1, 0, 1, -1
        # At the exponent 1 the rounding term counts; one more than what it leaves makes it 0.
        w[6:10] = 511.5
        b[6:10] = (spare - 1) / 2, spare / 2, (1 - spare) / 2, -spare / 2
        w[10], b[10] = 0, (1 << 24) - 1
        w[11], b[11] = 0, 1 - (1 << 24)

    def exponents(layers: list[Layer]) -> None:
        w, b = layers[-1]
        for r in range(total):
            w[r] = np.ldexp(np.float32(600 - r), -min(r, 30))
            w[r, ::2] *= -1
            b[r] = 3 - r
        w[3], b[3] = 0, 0
        w[4], b[4] = 0, 2.0**-21
        w[5], b[5] = 2.0**-149, -(2.0**-149)

    def saturated(layers: list[Layer]) -> None:
        # Hidden units below 0, above 1023 and at both.
        w, b = layers[0]
        w[:] = dyadic(Numbers("saturated").integers(-900, 900, *w.shape), 5)
        b[:] = [0, 1023, 1022.5, 1024, -1, -0.5, 0.5, 0.25, 2000, -2000, 1, 2, 3, 1023.5, 511, 512]
        w[:8] = 0

    for name, text, change, flags in (
        ("ties", "sums of rows that are ties", halves, "network-rounding"),
        ("weight-limit", "weights that round to 1023 and to 1024", limits, "weight-limit"),
        ("weight-ties", "weights and biases halfway between integers", rounding, "weight-rounding"),
        ("accumulator", "rows at the accumulator bound", bound, "accumulator-bound rounding-term"),
        (
            "exponents",
            "exponents of rows from 0 to 20, zero rows and subnormal weights",
            exponents,
            "exponent-limit subnormals",
        ),
        ("saturated", "hidden units below 0 and above 1023", saturated, "activation-clamp"),
    ):

        def make(name: str = name, change: Callable[[list[Layer]], None] = change) -> Scene:
            return _with_hyper(f"network-{name}", change)

        book.valid(
            f"network-{name}", text, make, features="networks raw-weights", requirements="D7.2-1 D7.2-2", flags=flags
        )

    def rendering() -> Scene:
        made = drawn("weights-any", 2)
        for name in ("opacity", "covariance", "colour"):
            for w, b in made.networks[name]:
                flat = w.reshape(-1)
                flat[: min(6, flat.size)] = np.array(
                    [3.4028234663852886e38, -3.4028234663852886e38, -0.0, 2.0**-149, -(2.0**-126), 1 / 3], np.float32
                )[: min(6, flat.size)]
                b[0] = -0.0
        return made

    book.valid(
        "weights-any",
        "rendering networks with any finite f32, which decide no symbol",
        rendering,
        features="raw-weights",
        requirements="R6.8-2 D9.3-1",
        flags="weight-bits",
    )

    def negative_zeros() -> Scene:
        made = drawn("weights-negative-zero", 3)
        for layers in made.networks.values():
            layers[0][0][0, 0] = -0.0
            layers[-1][1][0] = -0.0
        return sampled(made, Sampler(Numbers("weights-negative-zero/again")))

    book.valid(
        "weights-negative-zero",
        "weights and biases of -0, which stay as they are",
        negative_zeros,
        features="raw-weights networks",
        requirements="D7.2-1 D9.3-1",
        flags="weight-bits",
    )


# --- 7.3 --------------------------------------------------------------------------------------------------------------


def _planes(book: Book) -> None:
    for name, text, size, channels in (
        ("context", "a context of four neighbours that all count", 9, 2),
        ("square", "many channels", 6, 8),
    ):

        def make(name: str = name, size: int = size, channels: int = channels) -> Scene:
            d = replace(SMALL, plane_size=size, plane_channels=channels, sarm_width=(8,))
            numbers = Numbers(f"planes-{name}")
            found = networks(d, numbers)
            # Each neighbour has a weight of its own, of either sign.
            first = np.concatenate([np.eye(4), -np.eye(4)]).astype(np.float32)
            last = np.array([[5, 7, -3, 4, -5, -7, 3, -4], [0.5, 0.25, -0.5, 0.75, 0.25, 0.5, 0.5, 0.25]], np.float32)
            found["sarm"] = [(first, np.zeros(8, np.float32)), (last, np.array([3, -9], np.float32))]
            return sampled(scene(f"planes-{name}", 2, d, networks=found, lanes=Lanes(2, 0, 0)), Sampler(numbers, 0))

        book.valid(
            f"planes-{name}",
            text,
            make,
            features="planes",
            requirements="D7.3-1 D7.3-2",
            flags="wavefront-order context-order",
        )

    def far() -> Scene:
        d = replace(SMALL, plane_size=6)
        numbers = Numbers("planes-far")
        planes = numbers.chosen([32767, -32767, 1023, 1024, -1023, -1024, 0, 1, -1, 16384], 5, 2, 6, 6).astype(np.int16)
        return scene("planes-far", 3, d, planes=planes, plane_shift=0)

    book.valid(
        "planes-far",
        "the largest symbols, and neighbours about the largest activation",
        far,
        features="planes escapes",
        requirements="D7.3-1 R8.5-1 D8.7-1",
        flags="activation-clamp symbol-limit",
    )

    def quiet() -> Scene:
        made = scene("planes-zero", 3)
        return with_symbols(replace(made, planes=np.zeros_like(made.planes)))

    book.valid("planes-zero", "planes of zeros", quiet, features="planes", requirements="D7.3-1")


# --- 7.6 --------------------------------------------------------------------------------------------------------------


def _masks(book: Book) -> None:
    for name, text, bits in (("none", "no offset is kept", 0), ("all", "every offset is kept", 1)):

        def make(bits: int = bits) -> Scene:
            d = replace(SMALL, offset_count=4)
            return drawn(f"masks-{bits}", 9, d, masks=np.full((9, 4), bits == 1), chunk_size=5)

        book.valid(
            f"masks-{name}",
            text,
            make,
            features="masks attributes",
            requirements="D7.6-1 D7.10-1",
            flags="masked-offsets",
        )

    def every() -> Scene:
        bits = np.array([[n >> k & 1 for k in range(6)] for n in range(64)], dtype=bool)
        return drawn("masks-every", 64, replace(SMALL, offset_count=6, slices=(1,), carm_width=()), masks=bits)

    book.valid(
        "masks-every",
        "every mask of six offsets",
        every,
        features="masks",
        requirements="D7.6-1 D7.10-1",
        flags="mask-context masked-offsets",
    )

    def extreme() -> Scene:
        d = replace(SMALL, offset_count=5)
        numbers = Numbers("mask-model-extreme")
        model = numbers.chosen([1, 2, (1 << 14) - 1, (1 << 14) - 2, 1 << 13], mask_contexts(5)).astype(np.uint16)
        return drawn("mask-model-extreme", 40, d, mask_model=model)

    book.valid(
        "mask-model-extreme",
        "the least and the largest frequencies of a mask bit",
        extreme,
        features="masks",
        requirements="D7.6-1 R6.10-1 D8.2-1",
        flags="mask-context limit-off-by-one",
    )

    def middle() -> Scene:
        d = replace(SMALL, offset_count=10, slices=(1,), carm_width=())
        model = np.arange(1, mask_contexts(10) + 1).astype(np.uint16) * 280
        return drawn("mask-contexts", 60, d, mask_model=model)

    book.valid(
        "mask-contexts",
        "a frequency of its own for each of 55 contexts",
        middle,
        features="masks",
        requirements="D7.6-1",
        flags="mask-context",
    )


# --- 7.7 to 7.10 ------------------------------------------------------------------------------------------------------


def _attributes(book: Book) -> None:
    d = Dimensions(2, (3, 4, 2, 3), 1, 1, 3, (8,), (3,), (12,), 2)

    def carm(name: str, shift: Int64, spread: int) -> Scene:
        numbers = Numbers(name)
        found = networks(d, numbers)
        for network, layers in found.items():
            if network.startswith("carm"):
                w, b = layers[-1]
                w[:] = dyadic(numbers.integers(-100, 100, *w.shape), 7)
                b[:] = dyadic(numbers.integers(-40, 40, len(b)), 1)
        mean = numbers.integers(-spread, spread, d.attribute_width)
        found = {
            **constant(d, numbers, mean, numbers.integers(-10, 20, d.attribute_width)),
            **{n: v for n, v in found.items() if "carm" in n},
        }
        return sampled(scene(name, 25, d, networks=found, carm_shift=shift.astype(np.uint8)), Sampler(numbers, 30))

    numbers = Numbers("carm")
    book.valid(
        "carm",
        "slices that depend on each other",
        lambda: carm("carm", np.zeros(9, np.int64), 100),
        features="carm attributes",
        requirements="D7.9-1 D7.10-1 D7.7-1",
        flags="carm-ignored carm-slices stage-order",
    )
    book.valid(
        "carm-shifts",
        "inputs of CARM that are shifted, ties of either sign",
        lambda: carm("carm-shifts", numbers.integers(1, 4, 9), 600),
        features="carm",
        requirements="D7.9-1",
        flags="carm-rounding",
    )
    book.valid(
        "carm-largest-shift",
        "the largest carm_shift",
        lambda: carm("carm-largest-shift", np.full(9, 16), 1 << 20),
        features="carm",
        requirements="D7.9-1 R6.8-1",
        flags="carm-rounding limit-off-by-one",
    )
    book.valid(
        "carm-clamp",
        "inputs of CARM beyond the largest activation",
        lambda: carm("carm-clamp", np.zeros(9, np.int64), 40000),
        features="carm",
        requirements="D7.9-1",
        flags="activation-clamp",
    )

    def channels() -> Scene:
        numbers = Numbers("channel-order")
        mean = 160 * np.arange(d.attribute_width) - 1500
        return sampled(
            scene("channel-order", 12, d, networks=constant(d, numbers, mean, np.arange(d.attribute_width) - 20)),
            Sampler(numbers, 0),
        )

    book.valid(
        "channel-order",
        "a mean and a scale of its own for each channel",
        channels,
        features="attributes",
        requirements="D7.7-1 D7.10-1 D8.5-1",
        flags="channel-order stage-order",
    )

    def steps() -> Scene:
        numbers = Numbers("steps")
        found = networks(d, numbers)
        w, b = found["hyper"][-1]
        w[-3:] = dyadic(numbers.integers(-90, 90, 3, w.shape[1]), 3)
        b[-3:] = 0, 32, 63
        return sampled(scene("steps", 60, d, networks=found), Sampler(numbers, 0))

    book.valid(
        "steps",
        "step indices from one end of the table to the other, and beyond",
        steps,
        features="steps",
        requirements="D7.8-1 D9.2-1 DA-1",
        flags="step-clamp step-kinds",
    )


# --- 9 ----------------------------------------------------------------------------------------------------------------


def _values(book: Book) -> None:
    d = Dimensions(1, (4,), 1, 1, 2, (1,), (1,), (), 1)
    cases: list[tuple[str, str, tuple[float, float, float], str]] = [
        ("least", "the least base steps", (2.0**-60,) * 3, "limit-off-by-one"),
        ("largest", "the largest base steps", (2.0**60,) * 3, "limit-off-by-one"),
        (
            "ties",
            "values halfway between two f32",
            (1 + 2.0**-23, 1 + 3 * 2.0**-23, 1 + 5 * 2.0**-23),
            "value-rounding",
        ),
        (
            "long",
            "significands of 24 bits",
            (float(np.float32(0.1)), float(np.float32(1 / 3)), 2 - 2.0**-23),
            "value-rounding",
        ),
    ]
    for name, text, base_step, flag in cases:

        def make(name: str = name, base_step: tuple[float, float, float] = base_step) -> Scene:
            numbers = Numbers(f"values-{name}")
            made = scene(
                f"values-{name}",
                12,
                d,
                base_step=base_step,
                masks=np.ones((12, 1), bool),
                networks=constant(d, numbers, np.zeros(d.attribute_width, np.int64), np.full(d.attribute_width, 60)),
            )
            if name != "ties":
                # Step indices that are not 32, so that products are long.
                made.networks["hyper"][-1][1][-3:] = 3, 41, 63
            largest = (1 << 23) - 1
            given = {
                "features": numbers.chosen([3, -3, 5, 7, -9, 1, 0, largest, -largest, 1 << 20, 12345], 12, 4),
                "scalings": numbers.chosen([3, -3, 5, 2, -7, 11, largest, -largest], 12, 6),
                "offsets": numbers.chosen([3, -3, 5, 6, -1, 13, largest, -largest], 12, 1, 3),
            }
            return with_symbols(made, **given)

        book.valid(
            f"values-{name}",
            text,
            make,
            features="reconstruction steps",
            requirements="D9.2-1 R6.2-6 R8.5-1",
            flags=f"{flag} symbol-limit",
        )

    def table() -> Scene:
        # 64 anchors, one for each step index, which the positional encoding cannot give: the planes do.
        d = Dimensions(1, (2,), 1, 1, 32, (2,), (1,), (), 1)
        numbers = Numbers("values-table")
        made = constant(d, numbers, np.zeros(d.attribute_width, np.int64), np.zeros(d.attribute_width, np.int64))
        first, last = made["hyper"]
        first[0][0, 1], last[0][-3:, 0] = 1, 1
        last[1][-3:] = 0, 0, 0
        planes = np.zeros((5, 1, 32, 32), np.int16)
        for quadrant in range(1, 5):
            planes[quadrant, 0] = np.arange(32)[None, :] + (32 if quadrant in (2, 4) else 0)
        points = np.zeros((64, 3), np.int64)
        points[:, 0] = np.arange(64)
        change = frame(np.eye(3, dtype=np.int64), low=(0, 0, 0), high=(63, 1, 1))
        fields: dict[str, Any] = {
            "planes": planes,
            "plane_shift": 0,
            "frame": change,
            "networks": made,
            "masks": np.ones((64, 1), bool),
        }
        return sampled(scene("values-table", 64, d, positions=f16(points), **fields), Sampler(numbers, 0), planes=False)

    book.valid(
        "values-table",
        "each entry of the step table",
        table,
        features="steps reconstruction",
        requirements="D7.8-1 D9.2-1 DA-1",
        flags="step-clamp step-table",
    )
