"""Weights in mode 1 (SPEC.md 5.8, 6.8, 7.13): grids against the text, round trips, the choice of grids."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from random_scenes import random_scene
from spec_numbers import f32_bits

from conformance.cases.scenes import MAIN_DIMENSIONS
from refcodec.bitstream import codec, directory, weights
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.conventions import f32_parts
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.networks import IntNetwork, derive_layer
from refcodec.encoder.quantise import packed
from refcodec.encoder.weights import RENDERING, exact_networks, pack_weights, quantise_rendering

FINITE = st.floats(width=32, allow_nan=False, allow_infinity=False)
GRID = st.tuples(st.integers(-weights.WEIGHT_SYMBOL_MAX, weights.WEIGHT_SYMBOL_MAX), st.integers(-149, 104)).map(
    lambda p: math.ldexp(*p)
)


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype == np.float32 and np.array_equal(a.view(np.uint32), b.view(np.uint32))


def on_grids(rows: list[list[float]]) -> bool:
    """Whether each row, with its bias, is integers of the limited size times a power of two, and no value is -0."""
    for row in rows:
        if any(x == 0 and math.copysign(1, x) < 0 for x in row):
            return False
        parts = [f32_parts(x) for x in row if x]
        if not parts:
            continue
        least = max(-e for _, e in parts)
        if not weights.WEIGHT_EXPONENT_MIN <= least <= weights.WEIGHT_EXPONENT_MAX:
            return False
        if max(abs(m) << (e + least) for m, e in parts) > weights.WEIGHT_SYMBOL_MAX:
            return False
    return True


@pytest.mark.requirement("D7.13-1")
@given(
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=5),
        elements=st.one_of(
            FINITE, GRID, st.integers(-50, 50).map(float), st.sampled_from([0.0, -0.0, 2.0**-149, -(2.0**127)])
        ),
        fill=st.just(np.float32(0)),
    )
)
def test_grids(spec: dict, values: np.ndarray) -> None:
    """A layer is packed if its rows lie on grids, comes back bit for bit, and is the text's."""
    layer = (np.ascontiguousarray(values[:, :-1]), np.ascontiguousarray(values[:, -1]))
    grid = weights.to_grid(layer)
    assert (grid is not None) == on_grids(values.tolist())
    if grid is None:
        return
    back = weights.from_grid(grid)
    assert back is not None
    assert all(same_bits(a, b) for a, b in zip(back, layer, strict=True))
    text = spec["PACKED_LAYER"](grid.exponent, grid.difference.tolist(), grid.weight.tolist(), grid.bias.tolist())
    assert text == (f32_bits(layer[0]), f32_bits(layer[1]))


@given(st.data())
def test_exponents_that_are_not_the_least(spec: dict, data: st.DataObject) -> None:
    """What the text refuses, and nothing else, is refused."""
    rows = data.draw(st.integers(1, 4))
    small = st.integers(-3, 3)
    exponent = data.draw(st.sampled_from([0, 0, 5, -104, 149]))
    shapes = rows, (rows, 2), rows
    difference, weight, bias = (data.draw(hnp.arrays(np.int64, shape, elements=small)) for shape in shapes)
    text = spec["PACKED_LAYER"](exponent, difference.tolist(), weight.tolist(), bias.tolist())
    grid = weights.GridLayer(exponent, difference, weight, bias)
    layer = weights.from_grid(grid)
    assert (layer is None) == (text is None)
    if layer is not None:
        again = weights.to_grid(layer)
        assert again.exponent == exponent
        assert np.array_equal(again.difference, difference)


def test_the_integers_change_no_output() -> None:
    """exact_networks: the same outputs for any inputs, also where the integers could be doubled."""
    rng = np.random.default_rng(1)
    for seed in range(5):
        networks = random_scene(seed, 1, MAIN_DIMENSIONS, gain=[0.01, 0.5, 1, 3, 8][seed]).networks
        exact = exact_networks(networks)
        for name, layers in networks.items():
            if name in RENDERING:
                assert exact[name] is layers
                continue
            before, after = (IntNetwork([derive_layer(*layer) for layer in n[name]]) for n in (networks, exact))
            inputs = rng.integers(-1023, 1024, (100, layers[0][0].shape[1]))
            assert np.array_equal(before(inputs), after(inputs))
            assert all(weights.to_grid(layer) is not None for layer in exact[name])


@pytest.mark.parametrize("bits", [2, 6, 8, 12])
def test_rendering_networks_on_a_grid(bits: int) -> None:
    networks = random_scene(2, 1, MAIN_DIMENSIONS).networks
    coarse = quantise_rendering(networks, bits)
    for name, layers in networks.items():
        for (weight, bias), (grid_weight, grid_bias) in zip(layers, coarse[name], strict=True):
            if name not in RENDERING:
                assert grid_weight is weight
                continue
            grid = weights.to_grid((grid_weight, grid_bias))
            step = np.abs(weight).max() / ((1 << (bits - 1)) - 0.5)
            assert np.abs(weight - grid_weight).max() <= step
            assert np.abs(bias - grid_bias).max() <= step
            assert np.abs(grid.weight).max() < 1 << (bits - 1)


def test_a_scene_of_grids() -> None:
    """Its weights take less than a third of mode 0, and every symbol stays."""
    scene = random_scene(3, 20, MAIN_DIMENSIONS, chunk_size=256)
    small = pack_weights(replace(scene, networks=quantise_rendering(scene.networks, 6)))
    data, raw = codec.emit(small), codec.emit(scene)
    sections, before = (parse_container(d).section(directory.WEIGHTS) for d in (data, raw))
    assert (sections.mode, before.mode) == (1, 0)
    assert 3 * (sections.end - sections.start) < before.end - before.start
    parsed = codec.parse(data).scene
    assert codec.emit(parsed) == data
    for kind in ("features", "scalings", "offsets", "steps"):
        assert np.array_equal(getattr(parsed.attributes, kind), getattr(scene.attributes, kind))
    for name, layers in small.networks.items():
        for x, y in zip(layers, parsed.networks[name], strict=True):
            assert all(same_bits(a, b) for a, b in zip(x, y, strict=True))
    assert packed(parsed, "raw", None).weight_scales is parsed.weight_scales
    assert packed(scene, "raw", "raw").weight_scales is None
    assert packed(scene, "raw", None).weight_scales is not None


def test_scales_that_cannot_be_written() -> None:
    scene = pack_weights(random_scene(5, 2))
    raw = next(i for i, (name, _, _) in enumerate(layers_of(scene.dimensions)) if name == "opacity.0")
    assert not scene.weight_scales[raw].any(), "float32 of a training framework is on no grid"
    wrong = scene.weight_scales.copy()
    wrong[raw, 1] = 3
    with pytest.raises(ValueError, match="outside its limits"):
        codec.emit(replace(scene, weight_scales=wrong))
    with pytest.raises(ValueError, match="weight_scales is"):
        codec.emit(replace(scene, weight_scales=wrong[1:]))
