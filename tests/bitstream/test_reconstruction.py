"""Reconstruction (SPEC.md 9): each value is exact and rounded once; the digest is the same everywhere."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_scenes import random_scene
from spec_numbers import f32_bits

from conformance.fuzz.strategies import grids, positions, scenes
from refcodec.bitstream import reconstruction
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, KINDS
from refcodec.bitstream.header import PositionGrid
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables

Spec = dict[str, Any]


@pytest.mark.requirement("D9.1-1")
@given(grids(), positions(4))
def test_world_positions(spec: Spec, grid: PositionGrid, half: np.ndarray) -> None:
    world = reconstruction.world_positions(replace(random_scene(0, 4), grid=grid, positions=half))
    stated, bits = vars(grid), half.view(np.uint16).tolist()
    wanted = [[spec["WORLD"](stated, axis, spec["POSITION_INTEGER"](row[axis])) for axis in range(3)] for row in bits]
    assert f32_bits(world) == wanted


@pytest.mark.requirement("D9.2-1")
@given(
    st.lists(
        st.tuples(st.integers(-ATTRIBUTE_SYMBOL_MAX, ATTRIBUTE_SYMBOL_MAX), st.integers(0, 63)), min_size=1, max_size=9
    ),
    st.floats(2.0**-60, 2.0**60, width=32),
)
def test_attribute_values(spec: Spec, pairs: list[tuple[int, int]], base_step: float) -> None:
    symbols, steps = (np.array(x) for x in zip(*pairs, strict=True))
    values = reconstruction.dequantise(symbols.astype(np.int32), steps.astype(np.uint8), base_step)
    table = reconstruction.step_values(base_step)
    assert f32_bits(table) == [spec["STEP_VALUE"](index, f32_bits(base_step)) for index in range(len(table))]
    assert f32_bits(values) == [spec["VALUE"](symbol, f32_bits(table[index])) for symbol, index in pairs]
    for value, (symbol, index) in zip(values.tolist(), pairs, strict=True):
        # Each is rounded once, so within half a unit in the last place.
        step = Fraction(float(table[index]))
        exact = int(tables().step[index]) * Fraction(base_step) / 4096
        assert abs(step - exact) <= exact / (1 << 24)
        assert abs(Fraction(value) - symbol * step) <= abs(symbol * step) / (1 << 24)


@given(scenes())
@settings(max_examples=30)
def test_zeros_and_finiteness(scene: Scene) -> None:
    """No value is -0, NaN, infinite or subnormal; a masked offset is +0."""
    r = reconstruction.reconstruct(scene)
    for name in ("positions", *KINDS):
        values = getattr(r, name)
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
        assert not np.signbit(values[values == 0]).any()
        assert not ((values != 0) & (np.abs(values) < 2.0**-126)).any()
    assert (r.offsets[~scene.masks].view(np.uint32) == 0).all()


def test_each_part_changes_the_whole() -> None:
    """The digest sees a change of any part, and of where parts end."""
    scene = random_scene(3, 6)
    seen = {reconstruction.digest(scene)[0]}
    a = scene.attributes
    for array in (
        scene.positions.view(np.uint16),
        scene.masks,
        scene.planes,
        a.features,
        a.scalings,
        scene.networks["colour"][1][1],
    ):
        array.reshape(-1)[0] = not array.reshape(-1)[0] if array.dtype == bool else array.reshape(-1)[0] + 1
        seen.add(reconstruction.digest(scene)[0])
    a.offsets[scene.masks.nonzero()[0][0], scene.masks.nonzero()[1][0], 2] += 1
    seen.add(reconstruction.digest(scene)[0])
    assert len(seen) == 8
