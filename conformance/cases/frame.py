"""Cases of clauses 5.7 and 6.7: the frame's limits. Its effect on positions is in context.py."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from refcodec.bitstream.frame import Frame

from .book import Book
from .fault import Draw, Drawn, Edit, fault, wrong_value
from .header import label_of
from .samplers import drawn
from .target import Target
from .targets import plain

number = wrong_value(
    "frame.range",
    {
        **{f"frame.matrix[{i}]": [1 << 20, -(1 << 20), -(1 << 31)] for i in range(9)},
        **{f"frame.translation[{i}]": [1 << 61, -(1 << 61), -(1 << 63)] for i in range(3)},
        **{f"frame.shift[{i}]": [61, 255] for i in range(3)},
        **{f"frame.low[{i}]": [1 << 18, -(1 << 18) - 1] for i in range(3)},
        **{f"frame.high[{i}]": [(1 << 18) + 1, -(1 << 18)] for i in range(3)},
    },
)

reserved = wrong_value("frame.reserved", {"frame.reserved": [1, 255]})


@fault("frame.range")
def empty_range(t: Target, axis: int) -> Edit:
    """The high of an axis is equal to its low."""
    path = f"frame.high[{axis}]"
    return Edit(t.pack({path: t.value(f"frame.low[{axis}]")}), t.at(path))


@empty_range.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (t, draw.integer(0, 2)) if t.has("frame.low[0]") else None


def add(book: Book) -> None:
    """Adds the vectors."""
    add = partial(book.add, features="frame")
    for field, value, name in (
        ("matrix[0]", 1 << 20, "too-large"),
        ("matrix[8]", -(1 << 20), "too-small"),
        ("matrix[4]", -(1 << 31), "least"),
        ("translation[0]", 1 << 61, "too-large"),
        ("translation[2]", -(1 << 61), "too-small"),
        ("translation[1]", -(1 << 63), "least"),
        ("shift[2]", 61, "too-large"),
        ("low[0]", 1 << 18, "too-large"),
        ("low[2]", -(1 << 18) - 1, "too-small"),
        ("high[0]", (1 << 18) + 1, "too-large"),
        ("high[2]", -(1 << 31), "below-low"),
        ("high[1]", -(1 << 18), "too-small"),
    ):
        title, make = f"{field} of the frame is {value}", number.of(plain, f"frame.{field}", value)
        add(f"invalid-frame-{label_of(field)}-{name}", title, make, flags="limit-off-by-one signed-limits")
    title, make = "reserved of the frame is 1", reserved.of(plain, "frame.reserved", 1)
    add("unsupported-frame-reserved-set", title, make, flags="reserved-unchecked")
    title, flags = "high is low", "limit-off-by-one division-by-zero"
    add("invalid-frame-empty-range", title, empty_range.of(plain, 1), flags=flags)
    widest = 1 << 18
    least = Frame(
        np.full((3, 3), 1 - (1 << 20)),
        np.full(3, 1 - (1 << 61)),
        np.zeros(3, np.int64),
        np.full(3, -widest),
        np.full(3, 1 - widest),
    )
    largest = Frame(
        np.full((3, 3), (1 << 20) - 1),
        np.full(3, (1 << 61) - 1),
        np.full(3, 60),
        np.full(3, widest - 1),
        np.full(3, widest),
    )
    wide = replace(largest, low=np.full(3, -widest), high=np.full(3, widest))
    for name, frame in (("least", least), ("largest", largest), ("widest", wide)):
        book.valid(
            f"frame-bounds-{name}",
            f"numbers of the frame at their bounds, {name}",
            partial(drawn, "frame-bounds", 5, frame=frame),
            features="frame",
            requirements="R6.7-2 D7.5.1-1",
            flags="limit-off-by-one sum-width",
        )
