"""Cases of clauses 5.14, 6.11, 7.4 and 7.12: positions as f16, and as trees of cells.

An encoder chooses the form of each chunk. Faults of the form itself are in chunks.py.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.entropy import Encoder
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import PACKED, RAW, cell_positions
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .cells import MIDDLE, any_model, codes_of, cuboid, of_cells, placed, sharp_model, with_cells
from .fault import Draw, Drawn, Edit, Whole, fault
from .numbers import Int64, Numbers
from .samplers import drawn
from .scenes import f16, lattice, positions
from .target import Target
from .targets import SEEDS, five_cells, packed, plain

# Morton codes: of the last cell along all axes, and of the position 0.
LAST_CODE, MIDDLE_CODE = (1 << 48) - 1, 7 << 45


# --- faults of raw positions ------------------------------------------------------------------------------------------


def _coordinate(t: Target, chunk: int, number: int, bits: int) -> Edit:
    """Returns a raw chunk with another number."""
    at = t.part("positions", chunk)[0] + 2 * number
    return Edit({at: bits.to_bytes(2, "little")}, at)


def _draw_coordinate(draw: Draw, t: Target) -> tuple[int, int]:
    """Draws a raw chunk, and one of its numbers."""
    raw = [n for n in range(t.header.chunk_count) if t.value(f"chunk[{n}].position_form") == RAW]
    chunk = draw.choice(raw)
    return chunk, draw.integer(0, 3 * t.value(f"index.entry[{chunk}].anchor_count") - 1)


@fault("positions.not_finite")
def not_finite(t: Target, chunk: int, number: int, bits: int) -> Edit:
    """A coordinate is not finite."""
    return _coordinate(t, chunk, number, bits)


@not_finite.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, *_draw_coordinate(draw, t), draw.integer(0x7C00, 0x7FFF) | draw.choice([0, 0x8000])


@fault("positions.negative_zero")
def negative_zero(t: Target, chunk: int, number: int) -> Edit:
    """A coordinate is -0."""
    return _coordinate(t, chunk, number, 0x8000)


@negative_zero.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, *_draw_coordinate(draw, t)


# --- faults of trees --------------------------------------------------------------------------------------------------


def _any_cells(draw: Draw) -> Target:
    return five_cells(draw.integer(0, SEEDS - 1))


@fault("positions.count")
def cell_less(t: Target) -> Whole:
    """The tree has one cell fewer than anchors."""
    return Whole(with_cells(t, codes_of(t)[:-1]), t.part("positions", 0)[0])


@cell_less.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (_any_cells(draw),)


@fault("positions.count")
def cell_more(t: Target) -> Whole:
    """The tree has an additional cell next to the last one. Only its last level has too many nodes."""
    code = codes_of(t)
    more = next(c for c in (int(code[-1]) ^ np.arange(1, 8)).tolist() if c not in code)
    return Whole(with_cells(t, np.unique(np.append(code, more))), t.part("positions", 0)[0])


@cell_more.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return (_any_cells(draw),)


@fault("positions.count")
def overgrown(t: Target, levels: int) -> Whole:
    """The tree has all children of each node on several levels, and one child of each node below.

    Nodes beyond the number of anchors are not coded.
    """
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    anchors = t.value("index.entry[0].anchor_count")
    encoder, nodes, models = Encoder(1, 1 << made.lanes.mask), 1, made.position_model.models()
    for level in range(15, -1, -1):
        every = level > 15 - levels
        low = np.full(nodes, 15 if every else 1)
        first = 6 * min(level, 2)
        encoder.plain(models, np.full(nodes, first), [nodes], _unnamed, low)
        encoder.plain(models, np.full(nodes, first + (5 if every else 2)), [nodes], _unnamed, low if every else low - 1)
        nodes = min(8 * nodes, anchors) if every else nodes
    return Whole(t.with_part("positions", 0, encoder.finish()[0]), t.part("positions", 0)[0])


@overgrown.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return _any_cells(draw), draw.integer(1, 16)


def _unnamed(stream: int, index: int) -> str:
    return ""


@fault("positions.cell")
def cell_of_no_number(t: Target, code: int) -> Whole:
    """The last cell of the tree does not represent an f16. code: its Morton code."""
    return Whole(with_cells(t, np.append(codes_of(t)[:-1], code)), t.part("positions", 0)[0])


@cell_of_no_number.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return _any_cells(draw), LAST_CODE


# --- the suite's refused files ----------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    _refused(book)
    _refused_trees(book)
    _cells(book)
    _raw_chunks(book)


@cache
def _largest_index() -> Target:
    """Returns three cells that are ranks of f16 numbers. The last one is the largest."""
    cells = MIDDLE + np.array([[0, 0, 0], [1, 2, 3], [0x7BFF, 0x7BFF, 0x7BFF]])
    return Target(codec.emit(placed("refused-index", of_cells(cells, 40), shift=40)))


@cache
def _coarsest() -> Target:
    """Returns two cells with the largest cell_shift of a lattice, 39. The second is at one unit of 2^39 along x."""
    cells = MIDDLE + np.array([[0, 0, 0], [1, 0, 0]])
    return Target(codec.emit(placed("refused-overflow", of_cells(cells, 39), shift=39)))


def _along(axis: int, *values: float) -> NDArray[np.float16]:
    """Returns positions along an axis."""
    found = np.zeros((len(values), 3), np.float16)
    found[:, axis] = values
    return found


def _refused(book: Book) -> None:
    for base, before, features, chunk, number, rows in (
        (plain, "", "raw-positions", 1, 1, {"infinite": 0x7C00, "minus-infinite": 0xFC00, "not-a-number": 0x7E01}),
        (plain, "", "raw-positions", 2, 8, {"last-not-a-number": 0xFFFF}),
        (packed, "packed-", "packed-positions", 2, 2, {"infinite": 0x7C00}),
    ):
        for name, bits in rows.items():
            title, make = f"a position is {name.replace('-', ' ')}", not_finite.of(base, chunk, number, bits)
            book.add(f"invalid-{before}position-{name}", title, make, features=features, flags="half-limits")
    for base, before, features, chunk, number in (
        (plain, "", "raw-positions", 1, 1),
        (packed, "packed-", "packed-positions", 2, 2),
    ):
        title, make = "a position is negative zero", negative_zero.of(base, chunk, number)
        book.add(f"invalid-{before}position-negative-zero", title, make, features=features, flags="half-limits")


def _refused_trees(book: Book) -> None:
    add = partial(book.add, features="packed-positions")
    title = "a tree with a cell less than there are anchors"
    add("invalid-cells-count-one-less", title, cell_less.of(five_cells), flags="tree-count")
    title = "a tree with a cell more, at its last level"
    add("invalid-cells-count-one-more", title, cell_more.of(five_cells), flags="tree-count")
    title = "a tree with more nodes than anchors from its first levels on, which are dropped"
    make = overgrown.of(five_cells, 3)
    add("invalid-cells-count-many-more", title, make, flags="tree-count tree-dropped")
    title = "a cell whose integer has more bits than an f16"
    add("invalid-cells-cell-of-no-f16", title, cell_of_no_number.of(five_cells, LAST_CODE), flags="cell-ends")
    title, make = "a cell that counts to where infinity would be", cell_of_no_number.of(_largest_index, LAST_CODE)
    add("invalid-cells-cell-infinite", title, make, flags="cell-index half-limits")
    # Two units of 2^39 along x are one more than the largest f16.
    title, make = "a cell beyond the largest f16", cell_of_no_number.of(_coarsest, MIDDLE_CODE | 1 << 3)
    add("invalid-cells-cell-overflow", title, make, flags="cell-ends half-limits")
    title, make = "a cell beyond the largest f16 along z", cell_of_no_number.of(_coarsest, MIDDLE_CODE | 1 << 5)
    add("invalid-cells-cell-overflow-z", title, make, flags="cell-ends half-limits axes-swapped")


# --- the suite's valid files ------------------------------------------------------------------------------------------


@cache
def _lattice() -> NDArray[np.float16]:
    return lattice(Numbers("cells"), 60)


def _add_cells(
    book: Book, name: str, title: str, make: Callable[[], Scene], flags: str = "tree-order", requirements: str = ""
) -> None:
    """Adds a file in mode 1."""
    proved = f"D7.12-1 D7.4-1 {requirements}"
    book.valid(f"cells-{name}", title, make, features="packed-positions", requirements=proved, flags=flags)


def _cells(book: Book) -> None:
    book.valid(
        "packed-positions",
        "a lattice in four chunks",
        _four_chunks,
        features="packed-positions chunks",
        requirements="D7.12-1",
        flags="tree-order",
    )
    add = partial(_add_cells, book)

    def add_placed(name: str, title: str, cells: Int64, shift: int, *more: str, seed: str = "") -> None:
        make = partial(placed, f"cells-{seed or name}", of_cells(cells, shift), shift=shift)
        add(name, title, make, *more)

    # These positions continue the sequence of numbers.
    numbers = Numbers("cells")
    lattice(numbers, 60)
    for shift in (0, 1, 23, 39):
        # At most eleven bits of each cell, at both ends and around the middle.
        cells = MIDDLE + numbers.chosen([0, 1, -1, 5, 2047, -2047, 1000, -33], 20, 3)
        if shift == 39:
            cells = MIDDLE + numbers.chosen([0, 1, -1], 12, 3)
        title = f"cells of cell_shift {shift}"
        add_placed(f"shift-{shift}", title, cells, shift, "cell-shift tree-order", "R6.10-4")
    cells = MIDDLE + numbers.chosen([-32768, 32752, -32752, 16384, -16384, 32736, 16, -16, 2047, 0], 30, 3)
    add_placed("ends", "cells at both ends of each axis", cells, 12, "cell-ends tree-order")
    title = "cells that count f16 numbers, to the largest"
    cells = MIDDLE + numbers.chosen([0x7BFF, -0x7BFF, 0, 1, -1, 1023, 1024, -1024, 0x3C00, -0x3C00], 40, 3)
    add_placed("index", title, cells, 40, "cell-index tree-order", "R6.10-4")
    title, make = (
        "frequencies that fit no scene",
        partial(placed, "cells-any-model", _lattice(), any_model(numbers), 22),
    )
    add("any-model", title, make, "tree-model", "R6.10-4 D8.2-1")
    title, make = "frequencies of 1, and of all that is left", partial(placed, "cells-sharp-model", _lattice())
    add("sharp-model", title, partial(make, sharp_model(), 22), "tree-model limit-off-by-one", "R6.10-4 D8.2-1")
    title, make = "a cell_shift below the largest that would do", partial(placed, "cells-finer", _lattice(), shift=20)
    add("finer", title, make, "cell-shift", "R6.10-4")
    counted = np.arange(60).reshape(20, 3)
    cells = MIDDLE + np.where(counted % 2, 0x3400, -0x3400) + counted
    add_placed("index-of-lattice", "a lattice by the index of its f16 numbers", cells, 40, "cell-index")
    cells = cuboid(4, 4, 4) - 2
    make = partial(placed, "cells-full", of_cells(cells, 20))
    add("full", "a full cube of 64 cells about the middle", make, "tree-order tree-model")
    make = partial(placed, "cells-one", of_cells(np.array([[MIDDLE + 3, MIDDLE - 7, MIDDLE]]), 20))
    add("one", "a single cell", make)
    cells = np.array([[x, y, z] for x in (0, 65520) for y in (0, 65520) for z in (0, 65520)])
    add_placed("corners", "one cell in each of the root's children", cells, 10, "tree-order axes-swapped")
    cells = MIDDLE + np.array([[0, 0, 0], [0, 0, 1]])
    add_placed("siblings", "two cells that part at the last level", cells, 20, "tree-order axes-swapped")
    line = MIDDLE + np.stack([np.arange(-9, 9), np.zeros(18, int), np.zeros(18, int)], axis=1)
    for axis, name in enumerate("xyz"):
        cells = np.roll(line, axis, axis=1)
        add_placed(f"line-{name}", "cells along one axis", cells, 22, "axes-swapped tree-order", seed="line")
    where = np.unique(np.abs(Numbers("cells-subnormal").integers(-900, 900, 15, 3)), axis=0)
    make = partial(placed, "cells-subnormal", f16(where), shift=0)
    add("subnormal", "cells of the least numbers, packed or not", make, "subnormals")
    cells = cuboid(4, 7, 8)
    make = partial(placed, "cells-dense", of_cells(cells, 20), shift=20, lanes=Lanes(0, 0, 0))
    add("dense", "a full cuboid whose models know it: many anchors for each byte", make, "tree-model")


def _four_chunks() -> Scene:
    where = _lattice()
    return drawn("packed-positions", 60, positions=where, chunk_size=16, position_model=position_model(where, 16))


def _raw_chunks(book: Book) -> None:
    add = partial(_add_cells, book)
    title = "packed chunks, and raw ones that cannot be packed: in another order, a position twice, no cell"
    add("mixed", title, _mixed, "raw-chunk last-chunk", "R6.11-3 R6.11-4")
    model = any_model(Numbers("cells-raw-model"))
    make = partial(placed, "cells-raw", positions(Numbers("cells-raw"), 9), model, chunk_size=4)
    add("raw", "no chunk can be packed", make, "raw-chunk last-chunk", "R6.11-3 R6.11-4")
    make = partial(placed, "cells-single", _lattice()[:5], chunk_size=1)
    add("single-anchors", "packed chunks of one anchor", make, "raw-chunk", "R6.11-3")
    # In the order of x, y, z instead of the tree, which only MORTON reveals.
    where = cell_positions(MIDDLE + np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0]]), 22)[0]
    make = partial(placed, "cells-other-order", where, any_model(Numbers("cells-other-order")), 22)
    title = "positions in the order of x, which is not the tree's"
    add("other-order", title, make, "raw-chunk axes-swapped", "R6.11-3")
    beyond = _along(0, 0, 32)
    beyond[1, 1] = 2.0**-10
    make = partial(placed, "planted-beyond", beyond, any_model(Numbers("planted-beyond")), 14)
    title = "a coordinate just above the highest cell of a lattice: the chunk is raw"
    add("beyond", title, make, "cell-ends raw-chunk", "R6.11-3")
    # Each position of these cells is coded in both forms.
    steps = cell_positions(MIDDLE + np.array([[1, 0, 0], [0, 1, 0]]), 22)[0]
    one = of_cells(MIDDLE + np.array([[5, -3, 2]]), 22)
    for name, text, where, shift in (
        ("negative", "cells of negative numbers, counted", _along(0, -2, -1), 40),
        ("x-before-y", "a step along x before one along y", steps, 22),
        ("lowest", "the lowest cell of a lattice", _along(0, -32, -31), 14),
        ("one-anchor", "one cell", one, 22),
    ):
        model = any_model(Numbers(f"planted-{name}"))
        for chosen, form in (("packed", PACKED), ("raw", RAW)):
            make = partial(placed, f"planted-{name}", where, model, shift, position_forms=(form,))
            flags = "raw-chunk cell-ends cell-index axes-swapped"
            add(f"{name}-{chosen}", f"{text}, {chosen}", make, flags, "R6.11-3 R6.11-4")


def _mixed() -> Scene:
    where = _lattice().copy()
    # Chunk 1 in another order, chunk 2 with a repeated position, chunk 4 with a position without a cell.
    where[10:20] = where[10:20][::-1]
    where[25] = where[24]
    where[44, 1] = np.float16(2.0**-24)
    return placed("cells-mixed", where, position_model(_lattice(), 10), chunk_size=10)
