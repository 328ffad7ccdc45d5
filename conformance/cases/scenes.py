"""Valid scenes and parts of them.

`scene` takes its numbers from SHAKE-256 of a name (numbers.py), and every float is an integer times a power of two.
Thus it is the same on every machine. The suite consists of such scenes. Their names are permanent, because another name
gives another file.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.dimensions import Dimensions, mask_contexts
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.limits import MAIN, TINY
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
from refcodec.encoder.positions import morton_order, position_model

from .numbers import Int64, Numbers
from .weights import constant, networks

# For both profiles, the usual dimensions, the smallest and the largest.
TINY_DIMENSIONS = Dimensions(2, (2, 3), 2, 2, 4, (6,), (4, 4), (5,), 3)
MAIN_DIMENSIONS = Dimensions(10, (5, 10, 15, 20), 8, 10, 16, (100,), (16, 16), (100,), 50)
SMALLEST = Dimensions(1, (1,), 1, 1, 2, (1,), (1,), (), 1)
LARGEST = Dimensions(10, (16, 16, 16, 16), 8, 10, 32, (64, 64), (16, 16), (64, 64), 64)
# Without planes, without a positional encoding, and without either.
PLANELESS = Dimensions(2, (2, 3), 0, 2, 0, (6,), (), (5,), 3)
UNENCODED = Dimensions(2, (2, 3), 2, 0, 4, (6,), (4, 4), (5,), 3)
CONSTANT = Dimensions(2, (2, 3), 0, 0, 0, (), (), (5,), 3)
MAIN_SMALLEST = Dimensions(10, (5, 10, 15, 20), 8, 10, 2, (16,), (16, 16), (16,), 50)


# --- whole scenes -----------------------------------------------------------------------------------------------------


def scene(name: str, anchors: int = 6, d: Dimensions = TINY_DIMENSIONS, seed: int = 0, **changes: Any) -> Scene:
    """Returns a valid scene of ordinary numbers. name, seed: of its Numbers. changes: given fields of Scene."""
    numbers = Numbers(name, seed)
    masks = numbers.integers(0, 4, anchors, d.offset_count) > 1
    offsets = numbers.centred(3, anchors, d.offset_count, 3).astype(np.int32)
    frame = None
    if d.has_frame:
        matrix = numbers.integers(1 - (1 << 20), (1 << 20) - 1, 3, 3)
        translation = numbers.integers(-(1 << 40), 1 << 40, 3)
        frame = Frame(matrix, translation, np.array([29, 30, 31]), *BOUNDS)
    drawn = {
        "frame": frame,
        "plane_shift": numbers.integer(1, 6) if d.plane_channels else 0,
        "carm_shift": numbers.integers(0, 2, d.carm_inputs).astype(np.uint8),
        "networks": networks(d, numbers),
        "planes": numbers.centred(3, 5, d.plane_channels, d.plane_size, d.plane_size).astype(np.int16),
        "mask_model": numbers.integers(2000, 14000, mask_contexts(d.offset_count)).astype(np.uint16),
        "positions": positions(numbers, anchors),
        "masks": masks,
        "attributes": Attributes(
            numbers.centred(3, anchors, d.features).astype(np.int32),
            numbers.centred(3, anchors, 6).astype(np.int32),
            offsets,
            np.zeros((anchors, 3), np.uint8),
        ),
    }
    return assembled(d, {**drawn, **changes})


# SPEC 5.7: low and high of the ordinary frames.
BOUNDS = (np.array([-131072, -100000, -70000]), np.array([131072, 90000, 70001]))


def assembled(d: Dimensions, fields: dict[str, Any]) -> Scene:
    """Returns a scene of these fields, usual other fields, and derived ones."""
    usual = {
        "profile": MAIN if d.features == 50 else TINY,
        "chunk_size": 4096,
        "lanes": Lanes(1, 1, 2),
        "base_step": (1.0, 0.03125, float(np.float32(0.2))),
        "grid": PositionGrid((-5, 1 << 40, 77), 40000, -15),
        "render": RenderInfo(),
    }
    return settled(Scene(dimensions=d, **{**usual, **fields}))


def settled(made: Scene) -> Scene:
    """Returns the scene with masked offsets at 0, and with the step indices of its networks."""
    a = made.attributes
    offsets = np.where(made.masks[:, :, None], a.offsets, 0).astype(np.int32)
    return with_steps(replace(made, attributes=replace(a, offsets=offsets)))


def with_steps(made: Scene) -> Scene:
    """Returns the scene with the step indices of its networks."""
    return replace(made, attributes=replace(made.attributes, steps=codec.derive_steps(made)))


def with_symbols(made: Scene, **symbols: NDArray[Any]) -> Scene:
    """Returns the scene with other symbols: features, scalings or offsets."""
    changes: dict[str, Any] = {kind: value.astype(np.int32) for kind, value in symbols.items()}
    return settled(replace(made, attributes=replace(made.attributes, **changes)))


def drawn_symbols(made: Scene, draw: Callable[..., NDArray[Any]]) -> Scene:
    """Returns the scene with other features, scalings and offsets. draw: returns those of a shape."""
    shapes = {kind: getattr(made.attributes, kind).shape for kind in ("features", "scalings", "offsets")}
    return with_symbols(made, **{kind: draw(*shape) for kind, shape in shapes.items()})


def only_symbols(made: Scene, **symbols: Any) -> Scene:
    """Returns the scene with these symbols, and 0 for all others."""
    zero = drawn_symbols(made, lambda *shape: np.zeros(shape, np.int64))
    return with_symbols(zero, **symbols)


# --- frames and positions ---------------------------------------------------------------------------------------------


def frame_of(
    matrix: Any, translation: Any = (0, 0, 0), shift: Any = (0, 0, 0), low: Any = None, high: Any = None
) -> Frame:
    """Returns a frame from lists. By default its range is -2 to 2, which is 2^17 of its units (SPEC 7.5.1)."""
    bounds = [np.full(3, -1 << 17) if low is None else low, np.full(3, 1 << 17) if high is None else high]
    return Frame(
        *(np.array(part, dtype=np.int64) for part in (np.reshape(matrix, (3, 3)), translation, shift, *bounds))
    )


def positions(numbers: Numbers, anchors: int) -> NDArray[np.float16]:
    """Returns finite f16 numbers of all magnitudes except -0."""
    bits = numbers.integers(0, 0x7BFF, anchors, 3) | numbers.chosen([0, 0x8000], anchors, 3)
    bits[bits == 0x8000] = 0
    return bits.astype(np.uint16).view(np.float16)


def f16(integers: Int64) -> NDArray[np.float16]:
    """Returns the positions whose P (SPEC 7.4) are these integers, which must be exact in f16."""
    halves = np.ldexp(integers.astype(np.float64), -24).astype(np.float16)
    assert (np.ldexp(halves.astype(np.float64), 24) == integers).all()
    halves[halves == 0] = 0
    return halves


def lattice(numbers: Numbers, anchors: int, spread: int = 12) -> NDArray[np.float16]:
    """Returns distinct points of a lattice with the unit 1/4, in the order of their cells."""
    codes: Int64 = np.zeros(0, np.int64)
    side = 2 * spread + 1
    while len(codes) < anchors:
        codes = np.unique(np.append(codes, numbers.integers(0, side**3 - 1, anchors)))
    points = np.stack([codes // side**2, codes // side % side, codes % side], axis=1) - spread
    halves = (points * 0.25).astype(np.float16)
    halves = halves[morton_order(halves)]
    return halves[np.linspace(0, len(halves) - 1, anchors).astype(int)] if len(halves) > anchors else halves


# --- positions as cells (SPEC 7.12) ---------------------------------------------------------------------------------

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
    placed, fits = cell_positions(ordered, cell_shift)
    assert fits.all()
    return placed


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
    masks, rare = np.zeros((len(where), 1), bool), np.array([1], np.uint16)
    fields = {
        "networks": constant(SMALLEST, Numbers(name)),
        "masks": masks,
        "mask_model": rare,
        "lanes": Lanes(0, 0, 0),
    }
    return only_symbols(placed(name, of_cells(where, 20), shift=20, **{**fields, **changes}))
