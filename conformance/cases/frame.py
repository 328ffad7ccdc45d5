"""Cases of clauses 5.7 and 6.7: the frame's limits. What it does to positions is in context.py."""

from __future__ import annotations

from functools import partial

from .book import Book
from .fault import Draw, Drawn, Edit, fault, wrong_value
from .header import label_of
from .target import Target
from .targets import plain

number = wrong_value(
    "frame.range",
    {
        **{f"frame.matrix[{i}]": [1 << 20, -(1 << 20), -(1 << 31)] for i in range(9)},
        **{f"frame.translation[{i}]": [1 << 61, -(1 << 61), -(1 << 63)] for i in range(3)},
        **{f"frame.shift[{i}]": [61, 255] for i in range(3)},
        "frame.reserved": [1, 255],
        **{f"frame.low[{i}]": [1 << 18, -(1 << 18) - 1] for i in range(3)},
        **{f"frame.high[{i}]": [(1 << 18) + 1, -(1 << 18)] for i in range(3)},
    },
)


@fault("frame.range")
def empty_range(t: Target, axis: int) -> Edit:
    """An axis whose high is its low."""
    path = f"frame.high[{axis}]"
    return Edit(t.pack({path: t.value(f"frame.low[{axis}]")}), t.at(path))


@empty_range.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (t, draw.integer(0, 2)) if t.header.dimensions.has_frame else None


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
        ("reserved", 1, "set"),
        ("low[0]", 1 << 18, "too-large"),
        ("low[2]", -(1 << 18) - 1, "too-small"),
        ("high[0]", (1 << 18) + 1, "too-large"),
        ("high[2]", -(1 << 31), "below-low"),
    ):
        title, make = f"{field} of the frame is {value}", number.of(plain, f"frame.{field}", value)
        add(f"invalid-frame-{label_of(field)}-{name}", title, make, flags="limit-off-by-one signed-limits")
    title, flags = "high is low", "limit-off-by-one division-by-zero"
    add("invalid-frame-empty-range", title, empty_range.of(plain, 1), flags=flags)
