"""Integer networks (SPEC.md 7.2): rows and outputs equal those of the text in float32 and int64, up to the bound."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from random_scenes import random_networks
from spec_numbers import f32_bits

from conformance.cases.scenes import MAIN_DIMENSIONS, TINY_DIMENSIONS
from refcodec.bitstream import networks
from refcodec.bitstream.networks import BoundError, IntLayer, IntNetwork, derive_layer

Spec = dict[str, Any]
Row = tuple[list[float], float]


# --- rows -------------------------------------------------------------------------------------------------------------

MAGNITUDES = st.one_of(
    st.floats(-2, 2, width=32),
    st.floats(-2000, 2000, width=32),
    st.floats(width=32, allow_nan=False, allow_infinity=False),
    st.integers(-1024, 1024).map(lambda n: n + 0.5),
    # Ties of the rounding at some exponent, and their neighbours.
    st.builds(lambda k, e: math.ldexp(2 * k + 1, -e - 1), st.integers(-1100, 1100), st.integers(0, 20)),
    st.sampled_from(
        [0.0, -0.0, 2.0**-149, -(2.0**-149), 2.0**-126, 1023.0, 1023.5, -1023.5, -1024.0, 1022.9999389648438]
    ),
)
BIASES = st.one_of(
    MAGNITUDES,
    st.floats(-(2.0**25), 2.0**25, width=32),
    st.sampled_from([16777215.0, 16777214.0, -16777215.0, 16777216.0]),
)


def layers(fan_in: st.SearchStrategy[int], rows: int) -> st.SearchStrategy[list[Row]]:
    """Up to so many rows of one length."""
    return fan_in.flatmap(
        lambda n: st.lists(st.tuples(st.lists(MAGNITUDES, min_size=n, max_size=n), BIASES), min_size=1, max_size=rows)
    )


@pytest.mark.requirement("D7.2-1")
@settings(max_examples=120)
@given(st.one_of(layers(st.integers(1, 6), 4), layers(st.integers(1, 128), 1)))
@example([([1023.0], 0.0)])
@example([([1023.0] * 16, 33023.0 - 272)])
@example([([1023.0] * 16, 33024.0 - 272)])
@example([([1023.0] * 17, 0.0)])
@example([([1023.5], 0.0)])
@example([([-1023.5], 0.0)])
@example([([0.0], 16777215.0)])
@example([([0.0], 16777216.0)])
@example([([0.0] * 128, float(2**24 - 1))])
@example([([128.0] * 128, 0.0)])
@example([([128.0] * 128, float(2**24 - 128 * 128 * 1023 - 1))])
@example([([128.0] * 128, float(2**24 - 128 * 128 * 1023))])
@example([([0.5, -0.5, 1.5, -1.5], -0.5)])
@example([([1e-45] * 3, -1e-45)])
@example([([3.4e38], 1.0)])
@example([([0.0, -0.0], 0.0)])
@example([([2.0**-149, -(2.0**-149)], -(2.0**-149))])
@example([([0.5, -0.5], 0.5)])
@example([([1.0], 0.0), ([3e38], 0.0)])
# The rounding term alone takes this row from exponent 20 to 19.
@example([([0.0], 15.75)])
def test_derived_rows(spec: Spec, rows: list[Row]) -> None:
    """Those of the text. Its proof (spec/proofs.py) says that no input and no order of summation passes 2^24."""
    weight = np.array([w for w, _ in rows], dtype=np.float32)
    bias = np.array([b for _, b in rows], dtype=np.float32)
    wanted = [spec["DERIVE_ROW"](w, b) for w, b in zip(f32_bits(weight), f32_bits(bias), strict=True)]
    if None in wanted:
        with pytest.raises(BoundError) as caught:
            derive_layer(weight, bias)
        assert caught.value.row == wanted.index(None)
        return
    layer = derive_layer(weight, bias)
    assert list(zip(layer.weight.tolist(), layer.bias.tolist(), layer.exponent.tolist(), strict=True)) == wanted


def test_derive_networks_names_the_layer_of_a_broken_row() -> None:
    nets = random_networks(TINY_DIMENSIONS, np.random.default_rng(0))
    nets["carm.1"][1][0][2, 0] = 2000
    with pytest.raises(BoundError) as caught:
        networks.derive_networks(nets)
    assert (caught.value.layer, caught.value.row) == ("carm.1.1", 2)


# --- outputs ----------------------------------------------------------------------------------------------------------


@pytest.mark.requirement("D7.2-2")
@pytest.mark.parametrize("exact_float", [True, False])
@pytest.mark.parametrize("name", ["hyper", "sarm", "carm.1", "carm.3"])
@pytest.mark.parametrize("gain", [0.01, 1.0, 4.0])
def test_networks_are_those_of_the_text(spec: Spec, name: str, exact_float: bool, gain: float) -> None:
    layers = random_networks(MAIN_DIMENSIONS, np.random.default_rng(4), gain)[name]
    stated = [
        [spec["DERIVE_ROW"](w, b) for w, b in zip(f32_bits(weight), f32_bits(bias), strict=True)]
        for weight, bias in layers
    ]
    inputs = np.random.default_rng(1).integers(-1023, 1024, (9, layers[0][0].shape[1]))
    inputs[0], inputs[1], inputs[2] = 1023, -1023, 0
    outputs = IntNetwork([derive_layer(*layer) for layer in layers], exact_float)(inputs)
    assert outputs.tolist() == [spec["NETWORK"](stated, row) for row in inputs.tolist()]


@pytest.mark.parametrize("exact_float", [True, False])
@pytest.mark.parametrize("block_rows", [1, 7, 4096])
def test_a_row_does_not_depend_on_its_place(exact_float: bool, block_rows: int) -> None:
    rng = np.random.default_rng(2)
    layers = [derive_layer(*layer) for layer in random_networks(MAIN_DIMENSIONS, rng)["hyper"]]
    inputs = rng.integers(-1023, 1024, (260, layers[0].weight.shape[1]))
    network = IntNetwork(layers, exact_float, block_rows)
    whole = IntNetwork(layers)(inputs)
    order = rng.permutation(len(inputs))
    assert np.array_equal(network(inputs[order]), whole[order])
    assert np.array_equal(network(inputs[5:6]), whole[5:6])
    assert np.array_equal(network(np.asfortranarray(inputs)), whole)
    assert network(inputs[:0]).shape == (0, whole.shape[1])


@pytest.mark.requirement("D7.2-2")
@given(st.integers(0, 2**32 - 1), st.integers(1, 128), st.integers(1, 40), st.sampled_from(["random", "worst"]))
def test_float32_equals_int64(seed: int, fan_in: int, rows: int, kind: str) -> None:
    """At the bound, with inputs that reach it, in any order of the inputs, in any order of the rows."""
    rng = np.random.default_rng(seed)
    limit = min(1023, ((1 << 24) - 1) // (1023 * fan_in))
    out = 5
    weight = rng.integers(-limit, limit + 1, (out, fan_in))
    if kind == "worst":
        weight = limit * rng.choice([-1, 1], (out, fan_in))
    layers = [derive_layer(weight.astype(np.float32), np.zeros(out, np.float32))]
    inputs = rng.integers(-1023, 1024, (rows, fan_in))
    inputs[0] = 1023 * np.sign(weight[0])
    wanted = IntNetwork(layers, exact_float=False)(inputs)
    assert np.array_equal(IntNetwork(layers, exact_float=True)(inputs), wanted)
    assert np.array_equal(IntNetwork(layers, exact_float=True, block_rows=3)(inputs), wanted)
    order, columns = rng.permutation(rows), rng.permutation(fan_in)
    assert np.array_equal(IntNetwork(layers, exact_float=True)(inputs[order]), wanted[order])
    turned = [IntLayer(layers[0].weight[:, columns], layers[0].bias, layers[0].exponent)]
    assert np.array_equal(IntNetwork(turned, exact_float=True)(inputs[:, columns]), wanted)


def test_the_self_test_sees_a_reduced_precision() -> None:
    """A product that rounds its inputs to bfloat16 fails the self-test; this machine's product passes it."""
    assert networks.float32_is_exact()

    def rounded(*factors: np.ndarray) -> np.ndarray:
        a, w = ((f.view(np.uint32) & np.uint32(0xFFFF0000)).view(np.float32) for f in factors)
        return a @ w

    assert not networks.is_exact(rounded)
