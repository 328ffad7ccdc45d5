"""Positions in mode 1 (SPEC.md 5.12, 6.11, 7.12): cells and trees against the text, round trips, choice of packing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_scenes import random_scene

from conformance.cases.scenes import MAIN_DIMENSIONS, with_steps
from conformance.cases.target import Target
from conformance.fuzz.strategies import position_models, positions, some_positions
from refcodec.bitstream import codec
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.positions import (
    CELL_INDEX,
    PACKED,
    cell_positions,
    cells,
    chunk_codes,
    encode_positions,
    morton,
    position_integers,
)
from refcodec.encoder.positions import choose_cells, morton_order, pack_positions, position_model
from refcodec.encoder.quantise import packed

EVERY = np.array([b for b in range(1 << 16) if b & 0x7C00 != 0x7C00 and b != 0x8000], dtype=np.uint16)


def lattice_scene(seed: int, anchors: int, d=MAIN_DIMENSIONS, **more):
    """A scene on a surface of a lattice, anchors in no order, one on a cell."""
    rng = np.random.default_rng(seed)
    side = 8 + int(anchors**0.5)
    at = rng.permutation(side * side)[:anchors]
    x, y = at % side - side // 2, at // side - side // 2
    where = np.stack([x, y, (3 * np.sin(x / 5) + y / 9).astype(np.int64)], axis=1).astype(np.float16)
    where[where == 0] = 0
    return with_steps(replace(random_scene(seed, anchors, d, **more), positions=where))


@pytest.mark.requirement("D7.12-1")
@pytest.mark.parametrize("shift", [0, 1, 9, 23, 24, 28, 29, 39, CELL_INDEX])
def test_cells(spec: dict, shift: int) -> None:
    """Every fp16 and every cell by the text, and back."""
    bits = np.resize(EVERY, (len(EVERY) // 3 + 1, 3))
    numbered = cells(bits.view(np.float16), shift)
    numbers = [spec["CELL_NUMBER"](c, shift) for c in range(1 << 16)]
    cell_of = {number: c for c, number in enumerate(numbers) if number is not None}
    assert numbered.reshape(-1).tolist() == [cell_of.get(b, -1) for b in bits.reshape(-1).tolist()]
    right = (numbered >= 0).all(axis=1)
    back, fits = cell_positions(numbered[right], shift)
    assert fits.all()
    assert np.array_equal(back.view(np.uint16), bits[right])
    some = np.random.default_rng(shift).integers(0, 1 << 16, (3000, 3))
    values, fits = cell_positions(some, shift)
    for cell, value, fit in zip(some.tolist(), values.view(np.uint16).tolist(), fits.tolist(), strict=True):
        text = [numbers[c] for c in cell]
        assert fit == (None not in text)
        assert not fit or value == text


def test_morton() -> None:
    """The number of a cell has the bits of x, y and z in turn, x the lowest, as children are numbered."""
    some = np.random.default_rng(1).integers(0, 1 << 16, (300, 3))
    wanted = [
        sum((c >> bit & 1) << (3 * bit + axis) for bit in range(16) for axis, c in enumerate(cell))
        for cell in some.tolist()
    ]
    assert morton(some).tolist() == wanted


@given(st.data())
def test_round_trip(spec: dict, data: st.DataObject) -> None:
    """Any positions, in any order, with any model: the same bits, and the parts that the text decodes."""
    count = data.draw(st.integers(1, 30))
    where = data.draw(some_positions(count))
    chunk_size = data.draw(st.integers(1, 40))
    model = data.draw(position_models(where, chunk_size)) or position_model(where, chunk_size)
    chunks = chunk_ranges(count, chunk_size)
    parts = encode_positions(model, where, [len(chunk) for chunk in chunks], 2)
    frequency = [f.tolist() for f in model.frequency]
    for (form, part), chunk in zip(parts, chunks, strict=True):
        decoded, verdict = spec["DECODE_POSITIONS"](part, form, model.cell_shift, frequency, len(chunk), 2)
        assert verdict is None
        mine = where[chunk.start : chunk.stop]
        assert decoded == mine.view(np.uint16).tolist()
        assert (form == PACKED) == (chunk_codes(mine, model.cell_shift) is not None)


@given(st.integers(0, 20).flatmap(positions))
def test_the_choice_of_cells(where: np.ndarray) -> None:
    shift = choose_cells(where)
    assert (cells(where, shift) >= 0).all()
    if shift < CELL_INDEX - 1:
        p = position_integers(where)
        assert not p.any() or (p >> shift & 1).any(), "a larger shift would do"
    codes = morton(cells(where, shift))[morton_order(where)]
    assert (codes[1:] >= codes[:-1]).all()


def test_a_surface_is_small() -> None:
    """Positions take less than an eighth of mode 0, and nothing else changes but the order."""
    scene = lattice_scene(3, 3000, chunk_size=1024)
    small = packed(scene, None, "raw")
    data, raw = codec.emit(small), codec.emit(packed(small, "raw", "raw"))
    target = Target(data)
    assert [s.mode for s in target.header.sections] == [0, 0, 0, 1, 0]
    spans = [target.part("positions", chunk) for chunk in range(3)]
    assert 8 * sum(end - start for start, end in spans) < 6 * 3000
    assert len(data) < len(raw) - 5 * 3000
    parsed = codec.parse(data)
    assert codec.emit(parsed.scene) == data
    assert np.array_equal(parsed.scene.positions, scene.positions[morton_order(scene.positions)])
    assert packed(parsed.scene, None, "raw").positions is parsed.scene.positions
    # The form is a coding parameter: what could be packed may be raw.
    mixed = replace(parsed.scene, position_forms=(1, 0, 1))
    assert codec.parse(codec.emit(mixed)).scene.position_forms == (1, 0, 1)
    assert packed(replace(scene, profile=0), None, "raw").position_model is None


def test_models_that_cannot_be_written() -> None:
    scene = pack_positions(lattice_scene(6, 300, chunk_size=256))
    model = scene.position_model
    for bad in (
        replace(model, cell_shift=41),
        replace(model, frequency=model.frequency.astype(np.int64)),
        replace(model, frequency=np.zeros_like(model.frequency)),
    ):
        with pytest.raises(ValueError, match=r"position_model|cell_shift|model of positions"):
            codec.emit(replace(scene, position_model=bad))
