"""Cases of clause 9: values in f32. World positions are with the position grid in header.py."""

from __future__ import annotations

from functools import partial

import numpy as np

from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX
from refcodec.bitstream.conventions import round_to_f32
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables

from .book import Book
from .numbers import Int64, Numbers
from .samplers import Sampler, sampled
from .scenes import SMALLEST, constant, f16, frame_of, scene, with_symbols

FOUR = Dimensions(1, (4,), 1, 1, 2, (1,), (1,), (), 1)


def add(book: Book) -> None:
    """Adds the vectors."""
    tenth, third = float(np.float32(0.1)), float(np.float32(1 / 3))
    cases: list[tuple[str, str, tuple[float, float, float], str]] = [
        ("least", "the least base steps", (2.0**-60,) * 3, "limit-off-by-one"),
        ("largest", "the largest base steps", (2.0**60,) * 3, "limit-off-by-one"),
        (
            "ties",
            "values halfway between two f32",
            (1 + 2.0**-23, 1 + 3 * 2.0**-23, 1 + 5 * 2.0**-23),
            "value-rounding",
        ),
        ("long", "significands of 24 bits", (tenth, third, 2 - 2.0**-23), "value-rounding"),
    ]
    for name, title, base_step, flag in cases:
        # Step indices that are not 32 make long products.
        steps = (32, 32, 32) if name == "ties" else (3, 41, 63)
        book.valid(
            f"values-{name}",
            title,
            partial(_values, f"values-{name}", base_step, steps),
            features="reconstruction steps",
            requirements="D9.2-1 R6.2-7 R8.5-1",
            flags=f"{flag} symbol-limit",
        )
    book.valid(
        "values-table",
        "each entry of the step table",
        _table,
        features="steps reconstruction",
        requirements="D7.8-1 D9.2-1 DA-1",
        flags="step-clamp step-table",
    )
    book.valid(
        "values-of-rounded-steps",
        "values that are others if their step is not rounded to f32",
        _rounded_steps,
        features="reconstruction steps",
        requirements="D9.2-1",
        flags="value-rounding",
    )
    book.valid(
        "values-of-tied-steps",
        "steps halfway between two f32, of which the even one counts",
        _tied_steps,
        features="reconstruction steps",
        requirements="D9.2-1",
        flags="value-rounding",
    )


def _values(name: str, base_step: tuple[float, float, float], steps: tuple[int, int, int]) -> Scene:
    numbers, width = Numbers(name), FOUR.attribute_width
    found = constant(FOUR, numbers, np.zeros(width, np.int64), np.full(width, 60))
    masks = np.ones((12, 1), bool)
    made = scene(name, 12, FOUR, base_step=base_step, masks=masks, networks=found)
    made.networks["hyper"][-1][1][-3:] = steps
    largest = ATTRIBUTE_SYMBOL_MAX
    return with_symbols(
        made,
        features=numbers.chosen([3, -3, 5, 7, -9, 1, 0, largest, -largest, 1 << 20, 12345], 12, 4),
        scalings=numbers.chosen([3, -3, 5, 2, -7, 11, largest, -largest], 12, 6),
        offsets=numbers.chosen([3, -3, 5, 6, -1, 13, largest, -largest], 12, 1, 3),
    )


def _table() -> Scene:
    # 64 anchors, one for each step index. The planes select it, because the positional encoding cannot.
    d = Dimensions(1, (2,), 1, 1, 32, (2,), (1,), (), 1)
    numbers, zero = Numbers("values-table"), np.zeros(d.attribute_width, np.int64)
    found = constant(d, numbers, zero, zero)
    first, last = found["hyper"]
    first[0][0, 1], last[0][-3:, 0] = 1, 1
    last[1][-3:] = 0, 0, 0
    planes = np.zeros((5, 1, 32, 32), np.int16)
    for quadrant in range(1, 5):
        planes[quadrant, 0] = np.arange(32)[None, :] + (32 if quadrant in (2, 4) else 0)
    points = np.zeros((64, 3), np.int64)
    points[:, 0] = np.arange(64)
    made = scene(
        "values-table",
        64,
        d,
        positions=f16(points),
        planes=planes,
        plane_shift=0,
        frame=frame_of(np.eye(3, dtype=np.int64), low=(0, 0, 0), high=(63, 1, 1)),
        networks=found,
        masks=np.ones((64, 1), bool),
    )
    return sampled(made, Sampler(numbers, 0), planes=False)


def _with_step(name: str, index: int, base_step: tuple[float, ...], symbols: Int64) -> Scene:
    """Returns a scene with an anchor for each symbol, in all attributes. index: step index of all kinds."""
    numbers, zero, anchors = Numbers(name), np.zeros(SMALLEST.attribute_width, np.int64), len(symbols)
    networks, masks = constant(SMALLEST, numbers, zero, zero + 160), np.ones((anchors, 1), bool)
    made = scene(name, anchors, SMALLEST, networks=networks, masks=masks, base_step=base_step)
    made.networks["hyper"][-1][1][-3:] = index
    y = symbols[:, None]
    return with_symbols(made, features=y, scalings=y.repeat(6, axis=1), offsets=y.repeat(3, axis=1)[:, None, :])


def _rounded_steps() -> Scene:
    significand, index = 14832217, 63
    bases = tuple(significand * 2.0**-e for e in (24, 30, 20))
    exact = int(tables().step[index]) * significand
    symbols = np.arange(8388607, 8380000, -1234)
    values = round_to_f32(np.array([exact]), 0) * symbols.astype(np.float32)
    # Symbols whose value differs if the product of all three numbers is rounded once.
    other = symbols[values != round_to_f32(exact * symbols, 0)]
    assert len(other) >= 3
    return _with_step("values-of-rounded-steps", index, bases, np.concatenate([other, -other]))


def _tied_steps() -> Scene:
    # An odd number of 25 bits is a tie. Its half is even or odd.
    index = 1
    entry = int(tables().step[index])
    first = (1 << 24) // entry | 1
    odd = [k for k in range(first, first + 40, 2) if k * entry > 1 << 24]
    chosen = [next(k for k in odd if k * entry % 4 == rest) for rest in (1, 3)]
    bases = (chosen[0] * 2.0**-20, chosen[1] * 2.0**-20, chosen[1] * 2.0**-9)
    return _with_step("values-of-tied-steps", index, bases, np.array([1, -1, 3, -7, 8388607]))
