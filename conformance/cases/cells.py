"""Positions as cells of a lattice (SPEC 7.12), models that no encoder would choose, and files with changed cells."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.entropy import Encoder
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import (
    CELL_INDEX,
    EMPTY_MODELS,
    HALVES,
    POSITION_MODELS,
    PositionModel,
    cell_positions,
    chunk_codes,
    code_cells,
    morton,
)
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import TOTAL
from refcodec.encoder.positions import position_model

from .numbers import Int64, Numbers
from .scenes import SMALLEST, constant, scene, with_symbols
from .target import Target

# The cell of the position 0 along each axis.
MIDDLE = 1 << 15


def any_model(numbers: Numbers, largest: int = 5000) -> PositionModel:
    """Returns arbitrary frequencies."""
    counts = numbers.integers(1, largest, POSITION_MODELS, HALVES)
    for model, row in enumerate(counts):
        row[0] = 0 if model in EMPTY_MODELS else row[0]
        row[:] = np.where(row > 0, np.maximum(row * (TOTAL - 16) // row.sum(), 1), 0)
        row[int(np.argmax(row))] += TOTAL - row.sum()
    return PositionModel(CELL_INDEX, counts.astype(np.uint16))


def sharp_model() -> PositionModel:
    """Returns models with the largest frequency for the last symbol."""
    rows = np.ones((POSITION_MODELS, HALVES), np.int64)
    rows[list(EMPTY_MODELS), 0] = 0
    rows[:, -1] += TOTAL - rows.sum(axis=1)
    return PositionModel(CELL_INDEX, rows.astype(np.uint16))


def of_cells(cells: Int64, cell_shift: int) -> NDArray[np.float16]:
    """Returns the positions of cells in the order of the tree, without duplicates."""
    ordered = cells[np.unique(morton(cells), return_index=True)[1]]
    found, fits = cell_positions(ordered, cell_shift)
    assert fits.all()
    return found


def placed(
    name: str, where: NDArray[np.float16], model: PositionModel | None = None, shift: int | None = None, **changes: Any
) -> Scene:
    """Returns a small scene at these positions, in mode 1. shift: cell_shift. changes: as of scene."""
    chosen = model or position_model(where, 4096)
    if shift is not None:
        chosen = replace(chosen, cell_shift=shift)
    fields: dict[str, Any] = {"lanes": Lanes(0, 1, 0), "position_model": chosen, **changes}
    return scene(name, len(where), SMALLEST, positions=where, **fields)


def cuboid(*size: int) -> Int64:
    """Returns the cells of a cuboid that begins in the middle."""
    return np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1).reshape(-1, 3) + MIDDLE


def cheap(name: str, where: Int64, **changes: Any) -> Scene:
    """Returns a scene of cells whose masks and attributes take almost no bits. where: cells, with cell_shift 20."""
    zero, anchors = np.zeros(SMALLEST.attribute_width, np.int64), len(where)
    networks = constant(SMALLEST, Numbers(name), zero, zero - 40)
    masks, rare = np.zeros((anchors, 1), bool), np.array([1], np.uint16)
    fields: dict[str, Any] = {
        "networks": networks,
        "masks": masks,
        "mask_model": rare,
        "lanes": Lanes(0, 0, 0),
        **changes,
    }
    made = placed(name, of_cells(where, 20), shift=20, **fields)
    return with_symbols(
        made, features=np.zeros((anchors, 1)), scalings=np.zeros((anchors, 6)), offsets=np.zeros((anchors, 1, 3))
    )


def codes_of(t: Target) -> Int64:
    """Returns the Morton codes of the cells of a file with one packed chunk, int64 [anchors]."""
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    found = chunk_codes(made.positions, made.position_model.cell_shift)
    assert found is not None
    return found


def with_cells(t: Target, code: Int64) -> bytes:
    """Returns the file with other cells in its first, packed chunk, validly coded with its model and lanes."""
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    encoder = Encoder(1, 1 << made.lanes.mask)
    code_cells(encoder, made.position_model.models(), [0], [len(code)], code)
    return t.with_part("positions", 0, encoder.finish()[0])
