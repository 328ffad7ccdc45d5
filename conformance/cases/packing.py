"""Valid files in mode 1: positions as trees of cells, weights as integers on grids, and what stays raw there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.dimensions import Dimensions, layers_of
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import (
    CELL_INDEX,
    EMPTY_MODELS,
    HALVES,
    POSITION_MODELS,
    PositionModel,
    cell_positions,
    morton,
)
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import TOTAL
from refcodec.encoder.positions import position_model
from refcodec.encoder.weights import pack_weights

from .book import Book
from .decoding import f16
from .numbers import Int64, Numbers
from .sampling import Sampler, sampled
from .scenes import SMALL, SMALLEST, Networks, dyadic, lattice, packed_weights, positions, scales, scene
from .structure import drawn

MIDDLE = 1 << 15


def add(book: Book) -> None:
    """Adds the vectors."""
    _positions(book)
    _weights(book)


# --- positions --------------------------------------------------------------------------------------------------------


def any_model(numbers: Numbers, largest: int = 5000) -> PositionModel:
    """Frequencies that no one has observed."""
    counts = numbers.integers(1, largest, POSITION_MODELS, HALVES)
    for model, row in enumerate(counts):
        row[0] = 0 if model in EMPTY_MODELS else row[0]
        row[:] = np.where(row > 0, np.maximum(row * (TOTAL - 16) // row.sum(), 1), 0)
        row[int(np.argmax(row))] += TOTAL - row.sum()
    return PositionModel(CELL_INDEX, counts.astype(np.uint16))


def sharp_model(symbols: dict[int, int]) -> PositionModel:
    """Models in which one symbol is as likely as can be: by model its symbol, else the last one."""
    rows = np.ones((POSITION_MODELS, HALVES), np.int64)
    rows[list(EMPTY_MODELS), 0] = 0
    for model, row in enumerate(rows):
        row[symbols.get(model, 15)] += TOTAL - row.sum()
    return PositionModel(CELL_INDEX, rows.astype(np.uint16))


def of_cells(cells: Int64, cell_shift: int) -> NDArray[np.float16]:
    """The positions of cells, in the order of the tree, each once."""
    ordered = cells[np.unique(morton(cells), return_index=True)[1]]
    found, fits = cell_positions(ordered, cell_shift)
    assert fits.all()
    return found


def placed(
    name: str, where: NDArray[np.float16], model: PositionModel | None = None, shift: int | None = None, **changes: Any
) -> Scene:
    """A small scene at these positions, in mode 1."""
    chosen = model or position_model(where, 4096)
    if shift is not None:
        chosen = replace(chosen, cell_shift=shift)
    fields: dict[str, Any] = {"lanes": Lanes(0, 1, 0), "position_model": chosen, **changes}
    return scene(name, len(where), SMALLEST, positions=where, **fields)


def _positions(book: Book) -> None:
    numbers = Numbers("cells")
    grid = lattice(numbers, 60)

    def valid(
        name: str, text: str, make: Callable[[], Scene], flags: str = "tree-order", requirements: str = ""
    ) -> None:
        book.valid(
            f"cells-{name}",
            text,
            make,
            features="packed-positions",
            requirements=f"D7.12-1 D7.4-1 {requirements}",
            flags=flags,
        )

    book.valid(
        "packed-positions",
        "a lattice in four chunks",
        lambda: drawn("packed-positions", 60, positions=grid, chunk_size=16, position_model=position_model(grid, 16)),
        features="packed-positions chunks",
        requirements="D7.12-1",
        flags="tree-order",
    )
    for shift in (0, 1, 23, 39):
        # Eleven bits of each cell at most, at either end and about the middle.
        cells = MIDDLE + numbers.chosen([0, 1, -1, 5, 2047, -2047, 1000, -33], 20, 3)
        if shift == 39:
            cells = MIDDLE + numbers.chosen([0, 1, -1], 12, 3)
        valid(
            f"shift-{shift}",
            f"cells of cell_shift {shift}",
            lambda cells=cells, shift=shift: placed(  # type: ignore[misc]
                f"cells-shift-{shift}", of_cells(cells, shift), shift=shift
            ),
            "cell-shift tree-order",
            "R6.10-4",
        )
    far = MIDDLE + numbers.chosen([-32768, 32752, -32752, 16384, -16384, 32736, 16, -16, 2047, 0], 30, 3)
    valid(
        "ends",
        "cells at both ends of each axis",
        lambda: placed("cells-ends", of_cells(far, 12), shift=12),
        "cell-ends tree-order",
    )
    index = MIDDLE + numbers.chosen([0x7BFF, -0x7BFF, 0, 1, -1, 1023, 1024, -1024, 0x3C00, -0x3C00], 40, 3)
    valid(
        "index",
        "cells that count f16 numbers, to the largest",
        lambda: placed("cells-index", of_cells(index, 40), shift=40),
        "cell-index tree-order",
        "R6.10-4",
    )
    valid(
        "finer",
        "a cell_shift below the largest that would do",
        lambda: placed("cells-finer", grid, shift=20),
        "cell-shift",
        "R6.10-4",
    )
    valid(
        "index-of-lattice",
        "a lattice by the index of its f16 numbers",
        lambda: placed(
            "cells-index-of-lattice",
            of_cells(
                MIDDLE + np.where(np.arange(60).reshape(20, 3) % 2, 0x3400, -0x3400) + np.arange(60).reshape(20, 3), 40
            ),
            shift=40,
        ),
        "cell-index",
    )
    full = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + MIDDLE - 2
    valid(
        "full",
        "a full cube of 64 cells about the middle",
        lambda: placed("cells-full", of_cells(full, 20)),
        "tree-order tree-model",
    )
    valid(
        "one",
        "a single cell",
        lambda: placed("cells-one", of_cells(np.array([[MIDDLE + 3, MIDDLE - 7, MIDDLE]]), 20)),
        "tree-order",
    )
    corners = np.array([[x, y, z] for x in (0, 65520) for y in (0, 65520) for z in (0, 65520)])
    valid(
        "corners",
        "one cell in each of the root's children",
        lambda: placed("cells-corners", of_cells(corners, 10), shift=10),
        "tree-order axes-swapped",
    )
    pair = np.array([[MIDDLE, MIDDLE, MIDDLE], [MIDDLE, MIDDLE, MIDDLE + 1]])
    valid(
        "siblings",
        "two cells that part at the last level",
        lambda: placed("cells-siblings", of_cells(pair, 20), shift=20),
        "tree-order axes-swapped",
    )
    line = MIDDLE + np.stack([np.arange(-9, 9), np.zeros(18, int), np.zeros(18, int)], axis=1)
    for axis in range(3):
        valid(
            f"line-{'xyz'[axis]}",
            "cells along one axis",
            lambda axis=axis: placed(  # type: ignore[misc]
                "cells-line", of_cells(np.roll(line, axis, axis=1), 22), shift=22
            ),
            "axes-swapped tree-order",
        )
    valid(
        "any-model",
        "frequencies that fit no scene",
        lambda: placed("cells-any-model", grid, any_model(numbers), 22),
        "tree-model",
        "R6.10-4 D8.2-1",
    )
    valid(
        "sharp-model",
        "frequencies of 1, and of all that is left",
        lambda: placed("cells-sharp-model", grid, sharp_model({}), 22),
        "tree-model limit-off-by-one",
        "R6.10-4 D8.2-1",
    )

    def mixed() -> Scene:
        where = grid.copy()
        # Chunk 1 in another order, chunk 2 with a position twice, chunk 4 with one that has no cell.
        where[10:20] = where[10:20][::-1]
        where[25] = where[24]
        where[44, 1] = np.float16(2.0**-24)
        return placed("cells-mixed", where, position_model(grid, 10), chunk_size=10)

    valid("mixed", "packed chunks, and raw ones of each reason", mixed, "raw-chunk last-chunk", "R6.11-3 R6.11-4")
    unordered = positions(Numbers("cells-raw"), 9)
    valid(
        "raw",
        "no chunk can be packed",
        lambda: placed("cells-raw", unordered, any_model(Numbers("cells-raw-model")), chunk_size=4),
        "raw-chunk last-chunk",
        "R6.11-3 R6.11-4",
    )
    valid(
        "single-anchors",
        "chunks of one anchor, which always can be packed",
        lambda: placed("cells-single", grid[:5], chunk_size=1),
        "raw-chunk",
        "R6.11-4",
    )

    def swapped() -> Scene:
        # In the order of x, y, z and not of the tree: only MORTON tells.
        cells = MIDDLE + np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0]])
        return placed("cells-other-order", cell_positions(cells, 22)[0], any_model(Numbers("cells-other-order")), 22)

    valid(
        "other-order",
        "positions in the order of x, which is not the tree's",
        swapped,
        "raw-chunk axes-swapped",
        "R6.11-4",
    )

    def subnormal() -> Scene:
        return placed(
            "cells-subnormal",
            f16(np.unique(np.abs(Numbers("cells-subnormal").integers(-900, 900, 15, 3)), axis=0)),
            shift=0,
        )

    valid("subnormal", "cells of the least numbers, packed or not", subnormal, "subnormals")

    def dense() -> Scene:
        # A cuboid whose models know it: 16 anchors for each byte of the part, the most there can be.
        for anchors, size in (
            (240, (4, 4, 15)),
            (256, (4, 4, 16)),
            (272, (4, 4, 17)),
            (288, (4, 4, 18)),
            (256, (8, 8, 4)),
            (224, (4, 7, 8)),
        ):
            box = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1).reshape(-1, 3) + MIDDLE
            made = placed("cells-dense", of_cells(box, 20), shift=20, lanes=Lanes(0, 0, 0))
            from refcodec.bitstream.positions import encode_positions  # noqa: PLC0415

            part = encode_positions(made.position_model, made.positions, [range(anchors)], 1)[0]
            if 16 * len(part) == anchors:
                return made
        raise AssertionError("no cuboid has sixteen anchors for each byte")

    valid(
        "dense", "sixteen anchors for each byte of a chunk's positions", dense, "tree-model limit-off-by-one", "R6.10-2"
    )


# --- weights ----------------------------------------------------------------------------------------------------------


def _regular(name: str, change: Callable[[Networks], None], anchors: int = 3, d: Dimensions = SMALL) -> Scene:
    """A scene with changed networks, packed; the symbols are drawn after the change."""
    made = scene(name, anchors, d)
    change(made.networks)
    return sampled(packed_weights(made), Sampler(Numbers(f"{name}/symbols")))


def _weights(book: Book) -> None:
    def valid(name: str, text: str, make: Callable[[], Scene], flags: str, requirements: str = "") -> None:
        book.valid(
            f"grids-{name}",
            text,
            make,
            features="packed-weights",
            requirements=f"D7.13-1 R6.8-6 {requirements}",
            flags=flags,
        )

    book.valid(
        "packed-weights",
        "every layer packed",
        lambda: packed_weights(drawn("packed-weights", 4)),
        features="packed-weights",
        requirements="D7.13-1 D9.3-1",
        flags="grid-exponent",
    )
    book.valid(
        "packed-weights-chosen",
        "weights as the reference encoder packs them",
        lambda: pack_weights(drawn("packed-weights-chosen", 4)),
        features="packed-weights",
        requirements="D7.13-1",
        flags="grid-exponent",
    )

    def limits(n: Networks) -> None:
        # The least and the largest exponent of a row; integers at the limit.
        w, b = n["opacity"][0]
        w[0], b[0] = 0, np.float32(2.0**-149)
        w[1], b[1] = 2.0**104, 0
        w[2], b[2] = np.float32(2.0**-149 * ((1 << 24) - 1)), 0
        w, b = n["covariance"][0]
        w[0], b[0] = 1 - (1 << 24), (1 << 24) - 1
        w[1], b[1] = 2.0**104, -(2.0**127)
        w[2], b[2] = float(np.float32(2.0**104 * ((1 << 24) - 1))), 2.0**104

    valid(
        "limits",
        "exponents and integers at their limits",
        lambda: _regular("grids-limits", limits),
        "grid-exponent symbol-limit limit-off-by-one",
        "R6.8-5",
    )

    def zeros(n: Networks) -> None:
        for name, rows in (("opacity", [0, 1]), ("colour", [1]), ("covariance", [2])):
            w, b = n[name][0]
            w[rows], b[rows] = 0, 0
        # Whole layers.
        for name in ("opacity", "carm.1"):
            w, b = n[name][-1]
            w[:], b[:] = 0, 0

    valid(
        "zeros",
        "rows of zeros at the beginning, between and at the end of a layer, and layers of zeros",
        lambda: _regular("grids-zeros", zeros),
        "zero-rows",
    )

    def falling(n: Networks) -> None:
        for layers in n.values():
            for w, b in layers:
                e = (
                    np.array([(-1) ** r * (r % 23) for r in range(len(w))])[:, None]
                    if len(w) > 40
                    else np.arange(len(w))[:, None] * -3
                )
                w[:] = np.ldexp(w, np.clip(e, -20, 0))
                b[:] = np.ldexp(b, np.clip(e[:, 0], -20, 0))

    valid(
        "differences",
        "exponents that rise and fall from row to row",
        lambda: _regular("grids-differences", falling),
        "grid-exponent",
    )

    def biases(n: Networks) -> None:
        # The bias alone is odd, or alone has the row's exponent.
        for layers in n.values():
            w, b = layers[0]
            w[:] = np.round(w) * 2
            b[:] = np.round(b) + np.float32(0.5)
            b[::2] = 1

    valid(
        "biases", "rows whose exponent is that of the bias", lambda: _regular("grids-biases", biases), "grid-exponent"
    )

    for value in (0, 255):

        def extreme(value: int = value) -> Scene:
            made = scene(f"grids-scales-{value}", 2, SMALLEST)
            return replace(made, weight_scales=np.full((len(layers_of(SMALLEST)), 3), value, np.uint8))

        valid(f"scales-{value}", f"all scale indices {value}", extreme, "grid-scales raw-width", "D8.5-1 D8.7-1")

    def columns() -> Scene:
        made = packed_weights(scene("grids-scales", 2))
        rows = np.array([[40 + 13 * r % 90, 90 - 7 * r % 60, 60 + 5 * r % 50] for r in range(len(layers_of(SMALL)))])
        return replace(made, weight_scales=rows.astype(np.uint8))

    valid(
        "scales",
        "scale indices of their own for exponents, weights and biases of each layer",
        columns,
        "grid-scales",
        "D8.5-1",
    )

    def raw_one(n: Networks) -> None:
        n["hyper"][0][0][0, 0] = -0.0
        n["covariance"][1][1][3] = -0.0
        # An odd integer beyond the limit, exponents beyond theirs.
        n["opacity"][0][0][0, :2] = 2.0**24, 1
        n["opacity"][1][0][0, 0] = 2.0**105
        n["opacity"][1][0][0, 1:] = 0
        n["opacity"][1][1][0] = 0
        n["colour"][0][0][1, :2] = 3.0e38, 2.0**-149
        # A row of zeros in a raw layer.
        n["colour"][0][0][0], n["colour"][0][1][0] = 0, 0

    valid(
        "raw-layers",
        "layers that are raw: -0, integers and exponents beyond the limits",
        lambda: _regular("grids-raw-layers", raw_one),
        "raw-layer",
        "R6.8-4 R6.8-7",
    )

    def raw_all(n: Networks) -> None:
        for layers in n.values():
            for _, b in layers:
                b[0] = -0.0

    valid(
        "raw-all",
        "every layer raw, and a substream of no symbols",
        lambda: _regular("grids-raw-all", raw_all),
        "raw-layer empty-substream",
        "R6.8-4 R6.8-7",
    )

    def long(n: Networks) -> None:
        numbers = Numbers("grids-escapes")
        w, b = n["colour"][0]
        values = np.array([s * ((1 << z) | 1) for z in range(1, 24) for s in (1, -1)])
        w[:] = dyadic(numbers.chosen(values.tolist(), *w.shape), 0)
        b[:] = dyadic(numbers.chosen(values.tolist(), len(b)), 0)

    def escaped() -> Scene:
        made = _regular("grids-escapes", long)
        return replace(made, weight_scales=np.minimum(scales(made.networks), 60).astype(np.uint8))

    valid(
        "escapes",
        "integers of each length, far beyond their scale",
        escaped,
        "escape-prefix escape-sign raw-before-escapes",
        "D8.6-1 D8.7-1",
    )
    valid(
        "lanes",
        "a substream of 256 lanes",
        lambda: replace(_regular("grids-lanes", lambda n: None), lanes=Lanes(0, 0, 8)),
        "lane-order idle-lanes",
        "D8.3-1",
    )
