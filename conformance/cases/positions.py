"""Cases of clauses 5.14, 6.11, 7.4 and 7.12: positions as f16, and as trees of cells.

An encoder chooses the form of each chunk. Faults of the form itself are in chunks.py.
"""

from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.entropy import Encoder
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import PACKED, RAW, cell_positions, chunk_codes, code_cells
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .fault import Draw, Drawn, Edit, Whole, fault
from .numbers import Int64, Numbers
from .samplers import drawn
from .scenes import MIDDLE, any_model, cuboid, f16, lattice, of_cells, placed, positions, sharp_model
from .table import NAME, More, Recipe, Row, refused, valid
from .target import Target
from .targets import SEEDS, five_cells, packed, target_of

# Morton codes: of the last cell along all axes, and of the position 0.
LAST_CODE, MIDDLE_CODE = (1 << 48) - 1, 7 << 45

# --- faults of raw positions ------------------------------------------------------------------------------------------


def _raw_number(draw: Draw, t: Target) -> Drawn:
    """Draws a raw chunk, and one of its numbers."""
    chunk = draw.choice([n for n in range(t.header.chunk_count) if t.value(f"chunk[{n}].position_form") == RAW])
    return chunk, draw.integer(0, 3 * t.value(f"index.entry[{chunk}].anchor_count") - 1)


@fault("positions.not_finite", _raw_number, lambda d, t, *_: d.integer(0x7C00, 0x7FFF) | d.choice([0, 0x8000]))
def not_finite(t: Target, chunk: int, number: int, bits: int) -> Edit:
    """A coordinate is not finite."""
    at = t.part("positions", chunk)[0] + 2 * number
    return Edit({at: bits.to_bytes(2, "little")}, at)


@fault("positions.negative_zero", _raw_number)
def negative_zero(t: Target, chunk: int, number: int) -> Edit:
    """A coordinate is -0."""
    at = t.part("positions", chunk)[0] + 2 * number
    return Edit({at: b"\0\x80"}, at)


# --- faults of trees --------------------------------------------------------------------------------------------------


def codes_of(t: Target) -> Int64:
    """Returns the Morton codes of the cells of a file with one packed chunk, int64 [anchors]."""
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    codes = chunk_codes(made.positions, made.position_model.cell_shift)
    assert codes is not None
    return codes


def with_cells(t: Target, code: Int64) -> bytes:
    """Returns the file with other cells in its first, packed chunk, validly coded with its model and lanes."""
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    encoder = Encoder(1, 1 << made.lanes.mask)
    code_cells(encoder, made.position_model.models(), [0], [len(code)], code)
    return t.with_part("positions", 0, encoder.finish()[0])


def _any_cells(draw: Draw, t: Target) -> Target:
    return five_cells(draw.integer(0, SEEDS - 1))


@fault("positions.count", base=_any_cells)
def cell_less(t: Target) -> Whole:
    """The tree has one cell fewer than anchors."""
    return Whole(with_cells(t, codes_of(t)[:-1]), t.part("positions", 0)[0])


@fault("positions.count", base=_any_cells)
def cell_more(t: Target) -> Whole:
    """The tree has an additional cell next to the last one. Only its last level has too many nodes."""
    code = codes_of(t)
    more = next(c for c in (int(code[-1]) ^ np.arange(1, 8)).tolist() if c not in code)
    return Whole(with_cells(t, np.unique(np.append(code, more))), t.part("positions", 0)[0])


@fault("positions.count", (1, 16), base=_any_cells)
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


def _unnamed(stream: int, index: int) -> str:
    return ""


@fault("positions.cell", [LAST_CODE], base=_any_cells)
def cell_of_no_number(t: Target, code: int) -> Whole:
    """The last cell of the tree does not represent an f16. code: its Morton code."""
    return Whole(with_cells(t, np.append(codes_of(t)[:-1], code)), t.part("positions", 0)[0])


# Three cells that are ranks of f16 numbers, of which the last is the largest; and two with the largest cell_shift of a
# lattice, 39, of which the second is at one unit of 2^39 along x.
_largest_index = target_of(
    lambda: _in_cells("refused-index", MIDDLE + np.array([[0, 0, 0], [1, 2, 3], [0x7BFF] * 3]), 40)
)
_coarsest = target_of(lambda: _in_cells("refused-overflow", MIDDLE + np.array([[0, 0, 0], [1, 0, 0]]), 39))


# Of the rank 0x7C00 on each axis, which would be infinity.
_INFINITE_CODE = ((1 << 18) - 1) << 30


@cache
def _lattice() -> NDArray[np.float16]:
    return lattice(Numbers("cells"), 60)


def _in_cells(name: str, cells: Int64, shift: int, **changes: Any) -> Scene:
    """Returns a scene at the positions of cells. changes: as of scene."""
    return placed(name, of_cells(cells, shift), shift=shift, **changes)


def _chosen() -> list[Any]:
    """Returns cells of each cell_shift, at both ends and by the index, and a model, from one sequence of numbers."""
    numbers = Numbers("cells")
    lattice(numbers, 60)
    choices: list[Any] = []
    for shift in (0, 1, 23, 39):
        # At most eleven bits of each cell, at both ends and around the middle.
        choices.append(numbers.chosen([0, 1, -1, 5, 2047, -2047, 1000, -33], 20, 3))
        if shift == 39:
            choices[-1] = numbers.chosen([0, 1, -1], 12, 3)
    choices.append(numbers.chosen([-32768, 32752, -32752, 16384, -16384, 32736, 16, -16, 2047, 0], 30, 3))
    choices.append(numbers.chosen([0x7BFF, -0x7BFF, 0, 1, -1, 1023, 1024, -1024, 0x3C00, -0x3C00], 40, 3))
    return [*(MIDDLE + cells for cells in choices), any_model(numbers)]


def _mixed() -> Scene:
    where = _lattice().copy()
    # Chunk 1 in another order, chunk 2 with a repeated position, chunk 4 with a position without a cell.
    where[10:20] = where[10:20][::-1]
    where[25] = where[24]
    where[44, 1] = np.float16(2.0**-24)
    return placed("cells-mixed", where, position_model(_lattice(), 10), chunk_size=10)


def _cells(flags: str, requirements: str, *rows: Row) -> list[Recipe]:
    """Returns files in mode 1."""
    return valid("packed-positions", flags, f"D7.12-1 D7.4-1 {requirements}", *rows)


# fmt: off
_SHIFT_0, _SHIFT_1, _SHIFT_23, _SHIFT_39, _AT_ENDS, _BY_INDEX, _ANY_MODEL = _chosen()
_SMALL = np.unique(np.abs(Numbers("cells-subnormal").integers(-900, 900, 15, 3)), axis=0)
_COUNTED = np.arange(60).reshape(20, 3)
_LINE = MIDDLE + np.stack([np.arange(-9, 9), np.zeros(18, int), np.zeros(18, int)], axis=1)
_CORNERS = np.array([[x, y, z] for x in (0, 65520) for y in (0, 65520) for z in (0, 65520)])
_BEYOND = np.array([[0, 0, 0], [32, 2.0**-10, 0]], np.float16)
# In the order of x, y, z instead of the tree, which only MORTON reveals.
_OTHER_ORDER = cell_positions(MIDDLE + np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0]]), 22)[0]
CASES = [
    # Refused files.
    *refused("raw-positions", "half-limits",
        ("position-infinite", "a position is infinite", not_finite, 1, 1, 0x7C00),
        ("position-minus-infinite", "a position is minus infinite", not_finite, 1, 1, 0xFC00),
        ("position-not-a-number", "a position is not a number", not_finite, 1, 1, 0x7E01),
        ("position-last-not-a-number", "a position is last not a number", not_finite, 2, 8, 0xFFFF),
        ("position-negative-zero", "a position is negative zero", negative_zero, 1, 1)),
    *refused("packed-positions", "",
        ("packed-position-infinite", "a position is infinite", packed, not_finite, 2, 2, 0x7C00, More("half-limits")),
        ("packed-position-negative-zero", "a position is negative zero", packed, negative_zero, 2, 2,
         More("half-limits")),
        ("cells-count-one-less", "a tree with a cell less than there are anchors", five_cells, cell_less,
         More("tree-count")),
        ("cells-count-one-more", "a tree with a cell more, at its last level", five_cells, cell_more,
         More("tree-count")),
        ("cells-count-many-more", "a tree with more nodes than anchors from its first levels on, which are dropped",
         five_cells, overgrown, 3, More("tree-count tree-dropped")),
        ("cells-cell-of-no-f16", "a cell whose integer has more bits than an f16", five_cells, cell_of_no_number,
         LAST_CODE, More("cell-ends")),
        ("cells-cell-infinite", "a cell whose rank is that of infinity", _largest_index, cell_of_no_number,
         _INFINITE_CODE, More("cell-index half-limits")),
        ("cells-cell-not-a-number", "a cell whose rank is the last one", _largest_index, cell_of_no_number, LAST_CODE,
         More("cell-index half-limits"))),
    # Two units of 2^39 along x are one more than the largest f16.
    *refused("packed-positions", "cell-ends half-limits", (_coarsest, cell_of_no_number),
        ("cells-cell-overflow", "a cell beyond the largest f16", MIDDLE_CODE | 1 << 3),
        ("cells-cell-overflow-z", "a cell beyond the largest f16 along z", MIDDLE_CODE | 1 << 5, More("axes-swapped"))),

    # Trees.
    *valid("packed-positions chunks", "tree-order", "D7.12-1",
        ("packed-positions", "a lattice in four chunks",
         lambda: drawn("packed-positions", 60, positions=_lattice(), chunk_size=16,
                       position_model=position_model(_lattice(), 16)))),
    *_cells("cell-shift tree-order", "R6.10-4", *(
        (f"cells-shift-{shift}", f"cells of cell_shift {shift}", _in_cells, f"cells-shift-{shift}", cells, shift)
        for shift, cells in ((0, _SHIFT_0), (1, _SHIFT_1), (23, _SHIFT_23), (39, _SHIFT_39)))),
    *_cells("cell-ends tree-order", "",
        ("cells-ends", "cells at both ends of each axis", _in_cells, "cells-ends", _AT_ENDS, 12)),
    *_cells("cell-index tree-order", "R6.10-4",
        ("cells-index", "cells that count f16 numbers, to the largest", _in_cells, "cells-index", _BY_INDEX, 40)),
    *_cells("tree-model", "R6.10-4 D8.2-1",
        ("cells-any-model", "frequencies that fit no scene",
         lambda: placed("cells-any-model", _lattice(), _ANY_MODEL, 22))),
    *_cells("tree-model limit-off-by-one", "R6.10-4 D8.2-1",
        ("cells-sharp-model", "frequencies of 1, and of all that is left",
         lambda: placed("cells-sharp-model", _lattice(), sharp_model(), 22))),
    *_cells("cell-shift", "R6.10-4",
        ("cells-finer", "a cell_shift below the largest that would do",
         lambda: placed("cells-finer", _lattice(), shift=20))),
    *_cells("cell-index", "",
        ("cells-index-of-lattice", "a lattice by the index of its f16 numbers", _in_cells, "cells-index-of-lattice",
         MIDDLE + np.where(_COUNTED % 2, 0x3400, -0x3400) + _COUNTED, 40)),
    *_cells("tree-order tree-model", "",
        ("cells-full", "a full cube of 64 cells about the middle", placed, "cells-full",
         of_cells(cuboid(4, 4, 4) - 2, 20))),
    *_cells("tree-order", "",
        ("cells-one", "a single cell", placed, "cells-one", of_cells(MIDDLE + np.array([[3, -7, 0]]), 20))),
    *_cells("tree-order axes-swapped", "", (_in_cells, NAME),
        ("cells-corners", "one cell in each of the root's children", _CORNERS, 10),
        ("cells-siblings", "two cells that part at the last level", MIDDLE + np.array([[0, 0, 0], [0, 0, 1]]), 20)),
    *_cells("axes-swapped tree-order", "", *(
        (f"cells-line-{name}", "cells along one axis", _in_cells, "cells-line", np.roll(_LINE, axis, axis=1), 22)
        for axis, name in enumerate("xyz"))),
    *_cells("subnormals", "", ("cells-subnormal", "cells of the least numbers, packed or not",
         lambda: placed("cells-subnormal", f16(_SMALL), shift=0))),
    *_cells("tree-model", "",
        ("cells-dense", "a full cuboid whose models know it: many anchors for each byte",
         partial(_in_cells, "cells-dense", cuboid(4, 7, 8), 20, lanes=Lanes(0, 0, 0)))),

    # Raw chunks beside packed ones.
    *_cells("raw-chunk last-chunk", "R6.11-3 R6.11-4",
        ("cells-mixed",
         "packed chunks, and raw ones that cannot be packed: in another order, a position twice, no cell", _mixed),
        ("cells-raw", "no chunk can be packed",
         partial(placed, "cells-raw", positions(Numbers("cells-raw"), 9), any_model(Numbers("cells-raw-model")),
                 chunk_size=4))),
    *_cells("raw-chunk", "R6.11-3",
        ("cells-single-anchors", "packed chunks of one anchor",
         lambda: placed("cells-single", _lattice()[:5], chunk_size=1))),
    *_cells("raw-chunk axes-swapped", "R6.11-3",
        ("cells-other-order", "positions in the order of x, which is not the tree's", placed, "cells-other-order",
         _OTHER_ORDER, any_model(Numbers("cells-other-order")), 22)),
    *_cells("cell-ends raw-chunk", "R6.11-3",
        ("cells-beyond", "a coordinate just above the highest cell of a lattice: the chunk is raw", placed,
         "planted-beyond", _BEYOND, any_model(Numbers("planted-beyond")), 14)),
    # Each position of these cells is coded in both forms.
    *_cells("raw-chunk cell-ends cell-index axes-swapped", "R6.11-3 R6.11-4", *(
        (f"cells-{name}-{chosen}", f"{text}, {chosen}",
         partial(placed, f"planted-{name}", where, any_model(Numbers(f"planted-{name}")), shift,
                 position_forms=(form,)))
        for name, text, where, shift in (
            ("negative", "cells of negative numbers, counted", np.array([[-2, 0, 0], [-1, 0, 0]], np.float16), 40),
            ("x-before-y", "a step along x before one along y",
             cell_positions(MIDDLE + np.array([[1, 0, 0], [0, 1, 0]]), 22)[0], 22),
            ("lowest", "the lowest cell of a lattice", np.array([[-32, 0, 0], [-31, 0, 0]], np.float16), 14),
            ("one-anchor", "one cell", of_cells(MIDDLE + np.array([[5, -3, 2]]), 22), 22))
        for chosen, form in (("packed", PACKED), ("raw", RAW)))),
]
