"""References in plain Python integers and fractions, written from the clauses: each integer step, the order of symbols, rANS."""

from __future__ import annotations

import hashlib
import math
import random
import struct
import zlib
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from conformance.cases.scenes import MAIN_DIMENSIONS, TINY_DIMENSIONS, random_networks, random_scene, with_steps
from refcodec.bitstream import codec, conventions, masks, networks, planes, positions, reconstruction
from refcodec.bitstream import tables as tables_module
from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.context import context, contract, frame_coordinates, positional_encoding, query
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.entropy import Decoder, Encoder, parse_substream, select
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.frame import FRAME_RANGE_BOUND, MATRIX_BOUND, TRANSLATION_BOUND, Frame
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.networks import (
    ACCUMULATOR_BOUND,
    ACTIVATION_MAX,
    EXPONENT_MAX,
    WEIGHT_MAX,
    BoundError,
    IntLayer,
    IntNetwork,
    derive_layer,
)
from refcodec.bitstream.planes import assemble_planes
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables

INT63 = (1 << 63) - 1


def half_up(x: Fraction) -> int:
    return math.floor(x + Fraction(1, 2))


def column(values: list[int]) -> np.ndarray:
    return np.array(values, dtype=np.int64)


# --- operators --------------------------------------------------------------------------------------------------------


def test_isqrt_around_every_size_of_square() -> None:
    roots = [r + d for b in range(31) for r in (1 << b, 3 << max(b - 2, 0)) for d in (-1, 0, 1) if 0 < r + d < 1 << 31]
    values = [r * r + d for r in roots for d in (-1, 0, 1)]
    assert conventions.isqrt(column(values)).tolist() == [math.isqrt(v) for v in values]


def nearest_f32(x: Fraction) -> Fraction:
    """The binary32 nearest to x, ties to even, without any floating-point step; for normal results."""
    if x == 0:
        return x
    size = abs(x)
    e = size.numerator.bit_length() - size.denominator.bit_length()
    if Fraction(2) ** e > size:
        e -= 1
    assert -126 <= e <= 127, "the limits keep results normal"
    unit = Fraction(2) ** (e - 23)
    whole = math.floor(size / unit)
    rest = size / unit - whole
    if rest > Fraction(1, 2) or (rest == Fraction(1, 2) and whole % 2):
        whole += 1
    return whole * unit * (1 if x > 0 else -1)


@given(
    st.one_of(
        st.integers(-INT63, INT63),
        # A tie: 24 bits, then a one, then zeros.
        st.builds(
            lambda m, k, s: s * (2 * m + 1) << k,
            st.integers(1 << 23, (1 << 24) - 1),
            st.integers(0, 38),
            st.sampled_from([-1, 1]),
        ),
        # One beside a tie.
        st.builds(
            lambda m, k, d: ((2 * m + 1) << k) + d,
            st.integers(1 << 23, (1 << 24) - 1),
            st.integers(1, 38),
            st.sampled_from([-1, 1]),
        ),
    ),
    st.integers(-84, 48),
)
@example((1 << 24) + 1, 0)
@example((1 << 24) + 3, 0)
@example(INT63, 36)
@example(0, 5)
# Rounding to binary64 first would make this a tie and go down.
@example((1 << 62) + (1 << 38) + 1, 0)
def test_round_to_f32_rounds_once(n: int, exponent: int) -> None:
    found = conventions.round_to_f32(column([n]), exponent)
    assert found.dtype == np.float32
    assert Fraction(float(found[0])) == nearest_f32(n * Fraction(2) ** exponent)
    assert not (n == 0 and np.signbit(found[0]))


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
@example(0.0)
@example(-0.0)
@example(2.0**-149)
@example(2.0**60)
def test_f32_parts(x: float) -> None:
    m, e = conventions.f32_parts(x)
    assert m * Fraction(2) ** e == Fraction(x)
    assert m % 2 or (m, e) == (0, 0)
    assert abs(m) < 1 << 24


# --- networks ---------------------------------------------------------------------------------------------------------


def derive_row(weights: list[float], bias: float) -> tuple[list[int], int, int] | None:
    """The rule of the exponent in exact numbers."""
    for e in range(EXPONENT_MAX, -1, -1):
        w = [half_up(Fraction(x) * 2**e) for x in weights]
        b = half_up(Fraction(bias) * 2**e)
        if (
            max(map(abs, w)) <= WEIGHT_MAX
            and sum(map(abs, w)) * ACTIVATION_MAX + abs(b) + (1 << e) // 2 < ACCUMULATOR_BOUND
        ):
            return w, b, e
    return None


MAGNITUDES = st.one_of(
    st.floats(-2, 2, width=32),
    st.floats(-2000, 2000, width=32),
    st.floats(width=32, allow_nan=False, allow_infinity=False),
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


@given(
    st.integers(1, 6).flatmap(
        lambda n: st.lists(st.tuples(st.lists(MAGNITUDES, min_size=n, max_size=n), BIASES), min_size=1, max_size=4)
    )
)
@example([([1023.0], 0.0)])
@example([([1023.5], 0.0)])
@example([([-1023.5], 0.0)])
@example([([0.0], 16777215.0)])
@example([([0.0], 16777216.0)])
@example([([0.0, -0.0], 0.0)])
@example([([2.0**-149, -(2.0**-149)], -(2.0**-149))])
@example([([0.5, -0.5], 0.5)])
@example([([1.0], 0.0), ([3e38], 0.0)])
# The rounding term alone takes this row from exponent 20 to 19.
@pytest.mark.requirement("D7.2-1")
@example([([0.0], 15.75)])
def test_derive_layer_is_the_rule_in_exact_numbers(rows: list[tuple[list[float], float]]) -> None:
    weight = np.array([w for w, _ in rows], dtype=np.float32)
    bias = np.array([b for _, b in rows], dtype=np.float32)
    wanted = [derive_row([float(x) for x in w], float(b)) for w, b in zip(weight, bias, strict=True)]
    if None in wanted:
        with pytest.raises(BoundError) as caught:
            derive_layer(weight, bias)
        assert caught.value.row == wanted.index(None)
        return
    layer = derive_layer(weight, bias)
    assert [
        (w.tolist(), int(b), int(e)) for w, b, e in zip(layer.weight, layer.bias, layer.exponent, strict=True)
    ] == wanted


@pytest.mark.parametrize("value", [1023.5, -1024.0, 1e9, 3.4e38])
def test_a_weight_past_its_limit_is_refused(value: float) -> None:
    weight = np.zeros((3, 2), np.float32)
    weight[1, 1] = value
    with pytest.raises(BoundError) as caught:
        derive_layer(weight, np.zeros(3, np.float32))
    assert caught.value.row == 1


@pytest.mark.parametrize(("fan_in", "bias", "accepted"), [(16, 33023.0, True), (16, 33024.0, False), (17, 0.0, False)])
def test_the_bound_itself(fan_in: int, bias: float, accepted: bool) -> None:
    """16 weights of 1023 take 16,744,464 of 16,777,215, which leaves 32,751 for the bias; one more breaks the bound."""
    assert ACCUMULATOR_BOUND - 1 - 16 * 1023 * 1023 == 32751
    weight = np.full((1, fan_in), 1023, np.float32)
    biases = np.array([bias - 272 if fan_in == 16 else bias], np.float32)
    if accepted:
        layer = derive_layer(weight, biases)
        assert (int(layer.bias[0]), int(layer.exponent[0])) == (32751, 0)
    else:
        with pytest.raises(BoundError):
            derive_layer(weight, biases)


def test_derive_networks_names_the_layer_of_a_broken_row() -> None:
    nets = random_networks(TINY_DIMENSIONS, np.random.default_rng(0))
    nets["carm.1"][1][0][2, 0] = 2000
    with pytest.raises(BoundError) as caught:
        networks.derive_networks(nets)
    assert (caught.value.layer, caught.value.row) == ("carm.1.1", 2)


def evaluate(layers: list[IntLayer], row: list[int]) -> list[int]:
    """A network on one row, in Python integers, with the bound checked on the way."""
    for number, layer in enumerate(layers):
        out = []
        for w, b, e in zip(layer.weight.tolist(), layer.bias.tolist(), layer.exponent.tolist(), strict=True):
            total = b + sum(x * a for x, a in zip(w, row, strict=True))
            assert abs(total + (1 << e) // 2) < ACCUMULATOR_BOUND
            value = half_up(Fraction(total, 1 << e))
            out.append(value if number == len(layers) - 1 else min(max(value, 0), 1023))
        row = out
    return row


def adversarial_layers() -> list[IntLayer]:
    """Layers whose rows stand at the accumulator bound: few large weights, many small ones, a large bias, mixed signs."""
    rng = np.random.default_rng(7)
    found = []
    for fan_in in (1, 4, 16, 36, 100, 128):
        rows, biases = [], []
        for kind in range(12):
            w = rng.normal(0, 1, fan_in) if kind % 3 else rng.choice([-1.0, 1.0], fan_in)
            w *= [1.0, 1e-3, 30.0, 1e-6][kind % 4]
            low, high = 0.0, 1e9
            for _ in range(26):
                # The largest scale at which the row is accepted, to the last bit of the search.
                middle = (low + high) / 2
                row = (w * middle).astype(np.float32)
                try:
                    derive_layer(row[None], np.zeros(1, np.float32))
                    low = middle
                except BoundError:
                    high = middle
            row = (w * low).astype(np.float32)
            _, _, e = derive_row(row.tolist(), 0.0)
            left = (
                ACCUMULATOR_BOUND - 1 - 1023 * sum(abs(half_up(Fraction(float(x)) * 2**e)) for x in row) - (1 << e) // 2
            )
            bias = float(np.float32(min(left, (1 << 24) - 1) >> e)) * (-1) ** kind
            rows.append(row)
            biases.append(bias if derive_row(row.tolist(), bias) else 0.0)
        found.append(derive_layer(np.array(rows, np.float32), np.array(biases, np.float32)))
    return found


@pytest.fixture(scope="module")
def at_the_bound() -> list[IntLayer]:
    return adversarial_layers()


def test_no_sum_can_pass_the_bound(at_the_bound: list[IntLayer]) -> None:
    nearest = 0
    for layer in at_the_bound:
        for w, b, e in zip(layer.weight.tolist(), layer.bias.tolist(), layer.exponent.tolist(), strict=True):
            half = (1 << e) // 2
            worst = 1023 * sum(map(abs, w)) + abs(b) + half
            assert worst < ACCUMULATOR_BOUND
            nearest = max(nearest, worst)
            # The largest and the smallest sum that any input can give.
            for sign in (1, -1):
                assert abs(sign * 1023 * sum(map(abs, w)) + b + half) <= worst
    assert nearest > ACCUMULATOR_BOUND - 2048, "the layers do come close to the bound"


def test_float32_sums_are_exact_in_any_order(at_the_bound: list[IntLayer]) -> None:
    shuffle = random.Random(3)
    for layer in at_the_bound:
        for w, b, e in zip(layer.weight, layer.bias, layer.exponent, strict=True):
            for sign in (1, -1):
                terms = [*(w * (sign * 1023 * np.where(w < 0, -1, 1))).tolist(), int(b), (1 << int(e)) // 2]
                for _ in range(3):
                    shuffle.shuffle(terms)
                    partial = np.cumsum(np.array(terms, np.float32), dtype=np.float32)
                    assert partial.tolist() == np.cumsum(terms).tolist()


@pytest.mark.parametrize("exact_float", [True, False])
def test_networks_at_the_bound(at_the_bound: list[IntLayer], exact_float: bool) -> None:
    rng = np.random.default_rng(5)
    for layer in at_the_bound:
        inputs = rng.integers(-1023, 1024, (30, layer.weight.shape[1]))
        inputs[: len(layer.weight)] = 1023 * np.where(layer.weight < 0, -1, 1)
        inputs[12:24] = -inputs[:12]
        network = IntNetwork([layer], exact_float)
        assert network(inputs).tolist() == [evaluate([layer], row) for row in inputs.tolist()]


@pytest.mark.requirement("D7.2-2")
@pytest.mark.parametrize("exact_float", [True, False])
@pytest.mark.parametrize("name", ["hyper", "sarm", "carm.1", "carm.3"])
@pytest.mark.parametrize("gain", [0.01, 1.0, 30.0])
def test_networks_against_python_integers(name: str, exact_float: bool, gain: float) -> None:
    layers = random_networks(MAIN_DIMENSIONS, np.random.default_rng(4), min(gain, 4.0))[name]
    derived = [derive_layer(*layer) for layer in layers]
    inputs = np.random.default_rng(1).integers(-1023, 1024, (9, layers[0][0].shape[1]))
    inputs[0], inputs[1], inputs[2] = 1023, -1023, 0
    assert IntNetwork(derived, exact_float)(inputs).tolist() == [evaluate(derived, row) for row in inputs.tolist()]


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


# --- geometry ---------------------------------------------------------------------------------------------------------


def clamp(a: int, low: int, high: int) -> int:
    return min(max(a, low), high)


def frame_by_hand(frame: Frame, p: list[int]) -> list[int]:
    """Matrix, translation, shift and clamp; the sum must fit 64 bits."""
    out = []
    for row, t, s in zip(frame.matrix.tolist(), frame.translation.tolist(), frame.shift.tolist(), strict=True):
        total = sum(a * x for a, x in zip(row, p, strict=True)) + t
        assert abs(total) + (1 << s) <= INT63
        out.append(clamp(half_up(Fraction(total, 1 << s)), -(2**30) + 1, 2**30 - 1))
    return out


def contract_by_hand(v: list[int]) -> list[int]:
    """v within the unit ball, else (2 - 1/|v|) v/|v| with floors; in units of 2^-16."""
    q = sum(x * x for x in v)
    if q <= 1 << 32:
        return v
    n = math.isqrt(q)
    f = math.floor(Fraction((2 * n - 65536) * 65536, n))
    return [math.floor(Fraction(x * f, n)) for x in v]


def rescale_by_hand(frame: Frame, w: list[int]) -> list[int]:
    bounds = zip(w, frame.low.tolist(), frame.high.tolist(), strict=True)
    return [clamp(math.floor(Fraction((x - a) * 65536, b - a)), 0, 65536) for x, a, b in bounds]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("shift", [0, 1, 31, 59, 60])
def test_nothing_wraps_at_the_extremes(sign: int, shift: int) -> None:
    """The largest position, matrix, translation and rounding term together stay within 64 bits."""
    matrix = np.full((3, 3), sign * (MATRIX_BOUND - 1), dtype=np.int64)
    translation = np.full(3, sign * (TRANSLATION_BOUND - 1), dtype=np.int64)
    bound = np.full(3, FRAME_RANGE_BOUND, dtype=np.int64)
    frame = Frame(matrix, translation, np.full(3, shift), -bound, bound)
    p = positions.position_integers(np.array([[65504.0] * 3, [-65504.0] * 3, [65504.0, -65504.0, 65504.0]], np.float16))
    v = frame_coordinates(frame, p)
    assert v.tolist() == [frame_by_hand(frame, row) for row in p.tolist()]
    assert contract(v).tolist() == [contract_by_hand(row) for row in v.tolist()]


COORDINATES = st.one_of(
    st.integers(-70000, 70000),
    st.integers(-(1 << 30) + 1, (1 << 30) - 1),
    st.sampled_from([0, 65535, 65536, 65537, -65536, (1 << 30) - 1]),
)


@given(st.lists(st.tuples(COORDINATES, COORDINATES, COORDINATES), min_size=1, max_size=8))
@example([(65536, 0, 0), (65536, 1, 0), (0, 0, -65537), (0, 0, 0)])
@example([((1 << 30) - 1,) * 3, (1 - (1 << 30),) * 3])
def test_contraction_stays_within_two_units(rows: list[tuple[int, int, int]]) -> None:
    found = contract(column(rows)).tolist()
    assert found == [contract_by_hand(list(row)) for row in rows]
    assert all(sum(x * x for x in row) <= (2 * 65536 + 2) ** 2 for row in found)


def query_by_hand(plane: list, u: tuple[int, int], plane_shift: int) -> list[int]:
    """Bilinear, corners aligned, weights of 8 bits; u[0] runs along columns."""
    size = len(plane[0])
    cell, weight = [], []
    for x in u:
        g = x * (size - 1)
        c = min(g // 65536, size - 2)
        cell.append(c)
        weight.append(half_up(Fraction(g - c * 65536, 256)))
    (j, i), (fj, fi) = cell, weight
    out = []
    for y in plane:
        top = y[i][j] * (256 - fj) + y[i][j + 1] * fj
        bottom = y[i + 1][j] * (256 - fj) + y[i + 1][j + 1] * fj
        total = top * (256 - fi) + bottom * fi
        assert abs(total) < 1 << 31
        out.append(clamp(half_up(Fraction(total * 2**plane_shift, 65536)), -1023, 1023))
    return out


@pytest.mark.requirement("D7.5.4-1")
@given(
    st.integers(2, 9),
    st.integers(1, 3),
    st.integers(0, 10),
    st.integers(0, 99),
    st.lists(st.tuples(st.integers(0, 65536), st.integers(0, 65536)), min_size=1, max_size=6),
    st.sampled_from([3, 200, 32767]),
)
@example(2, 1, 0, 0, [(0, 0), (65536, 65536), (0, 65536), (65536, 0), (32768, 32768), (65535, 1)], 32767)
@example(9, 1, 10, 1, [(65536, 65535), (8192, 8191), (57344, 57343)], 32767)
def test_query(size: int, channels: int, shift: int, seed: int, at: list[tuple[int, int]], largest: int) -> None:
    plane = np.random.default_rng(seed).integers(-largest, largest + 1, (channels, size, size))
    found = query(plane, column(at), shift)
    assert found.tolist() == [query_by_hand(plane.tolist(), u, shift) for u in at]


def test_query_at_a_corner_is_the_corner() -> None:
    plane = np.arange(2 * 5 * 5).reshape(2, 5, 5) * 7 - 90
    for i in range(5):
        for j in range(5):
            # u[0] chooses the column, u[1] the row.
            assert query(plane, column([[j * 16384, i * 16384]]), 0)[0].tolist() == plane[:, i, j].tolist()


def gamma_by_hand(u: int, frequencies: int) -> list[int]:
    sine = tables().sine.tolist()
    out = []
    for k in range(frequencies):
        phase = ((u - 32768) * 2**k) % 65536
        turn = half_up(Fraction(phase, 64))
        out += [sine[turn % 1024], sine[(turn + 256) % 1024]]
    return out


@pytest.mark.requirement("D7.5.5-1")
@given(st.lists(st.integers(0, 65536), min_size=1, max_size=8), st.integers(1, 10))
@example([0, 1, 31, 32, 33, 32767, 32768, 32769, 65504, 65535, 65536], 10)
def test_positional_encoding(u: list[int], frequencies: int) -> None:
    found = positional_encoding(column(u), frequencies)
    assert found.tolist() == [gamma_by_hand(x, frequencies) for x in u]
    for row, x in zip(found.tolist(), u, strict=True):
        z = 2 * x / 65536 - 1
        for k in range(frequencies):
            # Half a table step of phase and half a unit of value.
            assert abs(row[2 * k] - 1023 * math.sin(2**k * math.pi * z)) < 3.7
            assert abs(row[2 * k + 1] - 1023 * math.cos(2**k * math.pi * z)) < 3.7


def test_sine_table() -> None:
    sine = tables().sine
    assert sine[[0, 256, 512, 768]].tolist() == [0, 1023, 0, -1023]
    assert all(abs(s - 1023 * math.sin(2 * math.pi * j / 1024)) <= 0.5 + 1e-9 for j, s in enumerate(sine.tolist()))


@pytest.mark.requirement("D7.3-2")
def test_quadrants_lie_as_they_are_named() -> None:
    given_planes = (np.arange(5 * 2 * 3 * 3) - 40).reshape(5, 2, 3, 3).astype(np.int16)
    first, joined = assemble_planes(given_planes)
    assert np.array_equal(first, given_planes[0])
    assert joined.shape == (2, 6, 6)
    for sub, name in enumerate(planes.PLANE_NAMES[1:], start=1):
        top, left = "top" in name, "left" in name
        for c, i, j in np.ndindex(2, 3, 3):
            assert joined[c, i if top else i + 3, j if left else j + 3] == given_planes[sub, c, i, j], name


@pytest.mark.requirement("D7.5-1")
def test_context_puts_the_parts_in_order() -> None:
    scene = random_scene(3, 40)
    full = assemble_planes(scene.planes)
    found = context(scene.frame, full, scene.plane_shift, 2, scene.positions)
    wanted = []
    for p in positions.position_integers(scene.positions).tolist():
        u = rescale_by_hand(scene.frame, contract_by_hand(frame_by_hand(scene.frame, p)))
        both = [query_by_hand(plane.tolist(), u[:2], scene.plane_shift) for plane in full]
        wanted.append([*both[0], *both[1], *gamma_by_hand(u[2], 2)])
    assert found.tolist() == wanted
    assert len({tuple(row) for row in wanted}) > 10, "the anchors see different contexts"


# --- the order of symbols, and their models ---------------------------------------------------------------------------


@given(st.integers(-(1 << 25), 1 << 25), st.integers(-(1 << 25), 1 << 25))
@example(0, 23)
@example(0, 24)
@example(-1, 31)
@example(7, 32)
@example(-8, -40)
@example(-9, -41)
@example((1 << 25) - 1, 151)
@example(8 * 65535, 152)
@example(1, 144)
def test_select(mean: int, scale: int) -> None:
    k = clamp(math.floor(Fraction(scale - 24, 8)) + 1, 0, 16)
    row = clamp(scale - 8 * k, -40, 23)
    h = half_up(Fraction(mean - 8 * (2**k - 1), 2**k)) + 8
    model, centre, raw = (int(x[0]) for x in select(column([mean]), column([scale])))
    assert (model, centre, raw) == ((row + 40) * 16 + h % 16, h // 16, k)
    # What the choice is for: the mean of the part that is not sent raw, to half of a sixteenth.
    wanted = (Fraction(mean, 16) - Fraction(2**k - 1, 2)) / 2**k
    assert abs(centre + Fraction(model % 16 - 8, 16) - wanted) <= Fraction(1, 32)


@pytest.mark.parametrize("scale", range(-60, 170))
def test_select_for_every_scale(scale: int) -> None:
    means = range(-40, 40)
    model, _, raw = select(column(list(means)), column([scale] * 80))
    assert set(raw.tolist()) == {min(max((scale - 24) // 8 + 1, 0), 16)}
    assert set((model // 16 - 40).tolist()) == {min(max(scale - 8 * int(raw[0]), -40), 23)}


@pytest.mark.requirement("D7.3-1")
@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 8, 32])
def test_wavefronts_hold_each_point_once_after_its_neighbours(size: int) -> None:
    done: dict[tuple[int, int], int] = {}
    for t in range(3 * size - 2):
        rows, columns = planes.wavefront(t, size)
        assert rows.tolist() == sorted(rows.tolist())
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True):
            assert j + 2 * i == t
            assert (i, j) not in done
            done[i, j] = t
    assert set(done) == {(i, j) for i in range(size) for j in range(size)}
    for (i, j), t in done.items():
        for near in ((i - 1, j - 1), (i - 1, j), (i - 1, j + 1), (i, j - 1)):
            assert done.get(near, -1) < t


class Recorder:
    """A coder that codes nothing: notes the models that it is asked for, and gives back what is given."""

    def __init__(self) -> None:
        self.calls: list[tuple] = []

    def values(
        self, models: object, mean: np.ndarray, scale: np.ndarray, counts: list, limit: int, name: object, given: object
    ) -> object:
        self.calls.append((models, mean.copy(), scale.copy(), list(counts), limit, name))
        return given

    def plain(self, models: object, index: np.ndarray, counts: list, name: object, given: object) -> object:
        self.calls.append((models, index.copy(), None, list(counts), None, name))
        return given


@pytest.mark.requirement("D7.3-1")
def test_plane_contexts_are_the_four_neighbours() -> None:
    """Each point's mean is a code of its context, made by a network that weighs the four inputs apart."""
    channels, size = 2, 4
    given_planes = np.random.default_rng(0).integers(-5, 6, (5, channels, size, size)).astype(np.int16)
    code = np.array([[1, 20, 400, 0], [0, 0, 1, 1000]], dtype=np.int64)

    def sarm(near: np.ndarray) -> np.ndarray:
        return near @ code.T

    recorder = Recorder()
    assert np.array_equal(planes.code_planes(recorder, sarm, channels, size, given_planes), given_planes)
    assert len(recorder.calls) == 3 * size - 2
    seen = 0
    for t, (models, mean, scale, counts, limit, name) in enumerate(recorder.calls):
        assert models is tables().laplace
        assert limit == 32767
        points = [
            (p, c, i, t - 2 * i)
            for p in range(5)
            for c in range(channels)
            for i in range(size)
            if 0 <= t - 2 * i < size
        ]
        assert counts == [len(points) // 5] * 5
        for n, (p, c, i, j) in enumerate(points):
            y = np.pad(given_planes[p, c].astype(int), 1)
            near = [y[i, j], y[i, j + 1], y[i, j + 2], y[i + 1, j]]
            assert (mean[n], scale[n]) == tuple(int(row @ near) for row in code)
            assert name(p, n - p * counts[0]) == f"planes.{planes.PLANE_NAMES[p]}[{c},{i},{j}]"
            seen += 1
    assert seen == given_planes.size


@pytest.mark.requirement("D7.6-1")
def test_mask_contexts() -> None:
    given_masks = np.random.default_rng(1).random((7, 4)) < 0.5
    recorder = Recorder()
    models = masks.mask_models(np.arange(1, 11, dtype=np.uint16))
    assert np.array_equal(masks.code_masks(recorder, models, 4, [range(3), range(3, 7)], given_masks), given_masks)
    for k, (_, index, _, counts, _, name) in enumerate(recorder.calls):
        assert counts == [3, 4]
        assert index.tolist() == [k * (k + 1) // 2 + int(row[:k].sum()) for row in given_masks]
        assert name(1, 2) == f"masks[5,{k}]"
    # The frequency of a context is that of a kept offset: of its last symbol.
    for number in range(10):
        at = int(models.offset[number])
        assert int(models.upper[at + 1]) - int(models.lower[at + 1]) == number + 1
        assert int(models.upper[at]) == (1 << 14) - number - 1


# --- rANS, one symbol at a time ---------------------------------------------------------------------------------------


def models_of(family: tables_module.ModelSet) -> list[list[int]]:
    """The frequencies of each model."""
    ends = [*family.offset.tolist()[1:], len(family.lower)]
    spans = zip(family.offset.tolist(), ends, strict=True)
    frequencies = (family.upper.astype(np.int64) - family.lower.astype(np.int64)).tolist()
    return [frequencies[a:b] for a, b in spans]


GAUSS = models_of(tables().gauss)


def decode_by_hand(
    data: bytes, lanes: int, groups: list[list[tuple[int, int]]], limit: int
) -> tuple[list[list[int]], str | None]:
    """A substream of Gaussian values, and the first of the checks at its end that fails. groups: (mean, scale) of each value."""
    crc, count = struct.unpack_from("<II", data)
    states = list(struct.unpack_from(f"<{lanes}I", data, 8))
    words = list(struct.unpack_from(f"<{count}H", data, 8 + 4 * lanes))
    raw = data[8 + 4 * lanes + 2 * count :]
    bits = [byte >> i & 1 for byte in raw for i in range(8)]
    taken = read = 0
    faults = set()

    def take(k: int) -> int:
        nonlocal read
        field = [bits[at] if at < len(bits) else 0 for at in range(read, read + k)]
        read += k
        return sum(b << i for i, b in enumerate(field))

    out, everything = [], b""
    for group in groups:
        found = []
        for i, (mean, scale) in enumerate(group):
            model, centre, k = (int(v[0]) for v in select(column([mean]), column([scale])))
            state, slot = states[i % lanes], states[i % lanes] % (1 << 14)
            symbol = low = 0
            while low + GAUSS[model][symbol] <= slot:
                low += GAUSS[model][symbol]
                symbol += 1
            state = GAUSS[model][symbol] * (state >> 14) + slot - low
            if state < 1 << 16:
                state = state << 16 | (words[taken] if taken < count else 0)
                taken += 1
            states[i % lanes] = state
            found.append((symbol, len(GAUSS[model]) // 2 - 1, centre, k))
        low_bits = [take(k) for *_, k in found]
        values = []
        for (symbol, radius, centre, k), low in zip(found, low_bits, strict=True):
            away = symbol - radius
            if symbol == 2 * radius + 1:
                sign, prefix = take(1), 0
                while prefix <= 25 and not take(1):
                    prefix += 1
                if prefix > 25:
                    faults.add("substream.escape")
                size = 1 if prefix > 25 else (1 << prefix) + take(prefix)
                away = -(radius + size) if sign else radius + size
            value = ((centre + away) << k) + low
            if abs(value) > limit:
                faults.add("substream.symbol_range")
                value = 0
            values.append(value)
            everything += struct.pack("<i", value)
        out.append(values)
    checks = [
        ("substream.words", taken != count),
        ("substream.final_state", any(s != 1 << 16 for s in states)),
        ("substream.escape", "substream.escape" in faults),
        ("substream.symbol_range", "substream.symbol_range" in faults),
        ("substream.raw_length", len(raw) != (read + 7) // 8),
        ("substream.raw_padding", any(bits[read:])),
        ("substream.symbol_crc", zlib.crc32(everything) != crc),
    ]
    return out, next((name for name, broken in checks if broken), None)


def no_name(stream: int, index: int) -> str:
    return ""


def coded(groups: list[list[tuple[int, int]]], values: list[list[int]], lanes: int, limit: int) -> bytes:
    encoder = Encoder(1, lanes)
    for group, value in zip(groups, values, strict=True):
        mean, scale = column([m for m, _ in group]), column([s for _, s in group])
        encoder.values(tables().gauss, mean, scale, [len(group)], limit, no_name, column(value))
    return encoder.finish()[0]


def decoded(
    data: bytes, groups: list[list[tuple[int, int]]], lanes: int, limit: int
) -> tuple[list[list[int]], str | None]:
    try:
        decoder = Decoder([parse_substream(data, 0, len(data), lanes, "test")])
    except BitstreamError as error:
        return [], error.kind.name
    out = []
    for group in groups:
        mean, scale = column([m for m, _ in group]), column([s for _, s in group])
        out.append(decoder.values(tables().gauss, mean, scale, [len(group)], limit, no_name).tolist())
    verdict = decoder.finish()[0]
    return out, verdict.kind.name if verdict else None


WIDE = (1 << 31) - 1


def substream(seed: int, lanes: int) -> tuple[list[list[tuple[int, int]]], list[list[int]], bytes]:
    """Three groups and an empty one: near values, escapes and raw bits."""
    rng = np.random.default_rng(seed)
    groups, values = [], []
    for size in (5, 0, 9, 7):
        group = [
            (int(m), int(s)) for m, s in zip(rng.integers(-200, 200, size), rng.integers(-40, 70, size), strict=True)
        ]
        groups.append(group)
        values.append(
            [m // 16 + int(rng.normal(0, 1) * 2 ** (s / 8)) + int(rng.integers(0, 8) == 0) * 300 for m, s in group]
        )
    return groups, values, coded(groups, values, lanes, WIDE)


@pytest.mark.requirement("D8.2-1", "D8.3-1", "D8.5-1")
@pytest.mark.parametrize("lanes", [1, 2, 4])
@pytest.mark.parametrize("seed", range(4))
def test_decoder_by_hand(seed: int, lanes: int) -> None:
    groups, values, data = substream(seed, lanes)
    assert decode_by_hand(data, lanes, groups, WIDE) == (values, None)
    assert decoded(data, groups, lanes, WIDE) == (values, None)


@pytest.mark.requirement("D8.8-2")
@pytest.mark.parametrize("repaired", [False, True])
@pytest.mark.parametrize("lanes", [1, 2])
def test_each_changed_bit_has_the_verdict_of_the_reference(lanes: int, repaired: bool) -> None:
    """Values and verdict of every substream with one changed bit; with the symbols' CRC-32 made right, an accepted one is canonical."""
    groups, _, data = substream(7, lanes)
    seen = set()
    for bit in range(8 * len(data)):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        # A changed word count or a state below its bound is refused before any symbol is decoded.
        if 32 <= bit < 64 or any(s < 1 << 16 for s in struct.unpack_from(f"<{lanes}I", changed, 8)):
            continue
        if repaired:
            values, _ = decode_by_hand(bytes(changed), lanes, groups, 5000)
            changed[:4] = zlib.crc32(b"".join(struct.pack("<i", v) for group in values for v in group)).to_bytes(
                4, "little"
            )
        wanted = decode_by_hand(bytes(changed), lanes, groups, 5000)
        assert decoded(bytes(changed), groups, lanes, 5000) == wanted
        if wanted[1] is None:
            assert coded(groups, wanted[0], lanes, 5000) == bytes(changed)
        seen.add(wanted[1])
    assert {"substream.words", "substream.final_state", "substream.raw_padding"} <= seen
    assert ("substream.symbol_crc" in seen) is not repaired
    assert (None in seen) is repaired, "a changed raw bit is another valid substream"


@pytest.mark.requirement("D8.7-1")
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("prefix", range(26))
def test_escapes_of_every_prefix(prefix: int, sign: int) -> None:
    """The first and the last size of each prefix: its bits are a sign, `prefix` zeros, a one and `prefix` bits."""
    radius = len(GAUSS[0]) // 2 - 1
    for size in {1 << prefix, (2 << prefix) - 1}:
        # The mean is -1/2 step for this model: column 0 of row -40, centre 0.
        value = sign * (radius + size)
        groups, values = [[(-8, -40)]], [[value]]
        data = coded(groups, values, 1, WIDE)
        assert decoded(data, groups, 1, WIDE) == (values, None)
        assert decode_by_hand(data, 1, groups, WIDE) == (values, None)
        word_count = struct.unpack_from("<I", data, 4)[0]
        field = (sign < 0) | 1 << (prefix + 1) | (size - (1 << prefix)) << (prefix + 2)
        assert data[12 + 2 * word_count :] == field.to_bytes((2 * prefix + 2 + 7) // 8, "little")


def test_a_prefix_of_26_zeros_is_too_long() -> None:
    groups, values = [[(-8, -40)]], [[1 << 25]]
    data = coded(groups, values, 1, WIDE)
    word_count = struct.unpack_from("<I", data, 4)[0]
    for zeros, wanted in ((25, "substream.symbol_crc"), (26, "substream.escape"), (27, "substream.escape")):
        raw = (1 << (zeros + 1)).to_bytes(16, "little")[: (2 * zeros + 9) // 8 if zeros < 26 else 4]
        changed = data[: 12 + 2 * word_count] + raw
        assert decoded(changed, groups, 1, WIDE)[1] == decode_by_hand(changed, 1, groups, WIDE)[1] == wanted


@pytest.mark.requirement("D8.6-1")
@pytest.mark.parametrize("width", range(17))
def test_raw_bits_of_every_width(width: int) -> None:
    scale = 16 + 8 * width if width else -40
    n = 9
    groups = [[(40 * i - 100, scale) for i in range(n)]]
    assert {int(select(column([m]), column([s]))[2][0]) for m, s in groups[0]} == {width}
    values = [[(i * 2654435761) % (1 << width) + (((40 * i - 100) // 16) >> width << width) for i in range(n)]]
    data = coded(groups, values, 2, WIDE)
    assert decoded(data, groups, 2, WIDE) == decode_by_hand(data, 2, groups, WIDE) == (values, None)


@pytest.mark.parametrize("family", ["gauss", "laplace"])
def test_lookup_finds_the_symbol_of_each_slot(family: str) -> None:
    """The starting symbol that the lookup gives is never past the right one."""
    models = getattr(tables(), family)
    starts = models.first.reshape(len(models.offset), 256)
    for index, frequencies in enumerate(models_of(models)):
        ends = np.cumsum(frequencies)
        assert ends[-1] == 1 << 14
        assert min(frequencies) >= 1
        assert starts[index].tolist() == np.searchsorted(ends, np.arange(256) * 64, side="right").tolist()


# --- a fixed scene ----------------------------------------------------------------------------------------------------


def pattern(shape: tuple[int, ...], multiplier: int, modulus: int) -> np.ndarray:
    """Integers in [0, modulus) by arithmetic alone, so that they are the same everywhere."""
    return (np.arange(int(np.prod(shape)), dtype=np.int64) * multiplier + 7) % modulus


def fixed_scene() -> Scene:
    """Several slices, layers and chunks, escapes and raw bits; no random generator."""
    d = Dimensions(3, (2, 1, 3), 2, 3, 5, (7, 6), (5,), (4,), 3)
    n = 23

    def numbers(shape: tuple[int, ...], multiplier: int, modulus: int) -> np.ndarray:
        return pattern(shape, multiplier, modulus).reshape(shape) - modulus // 2

    nets = {}
    for at, (name, shapes) in enumerate(d.network_shapes().items()):
        layers = []
        for out, fan_in in shapes:
            weight = (numbers((out, fan_in), 37 + 2 * at, 61) / np.float32(64 * 8)).astype(np.float32)
            layers.append((weight, (numbers((out,), 29, 97) / np.float32(4)).astype(np.float32)))
        nets[name] = layers
    nets["hyper"][-1][1][-3:] += 32
    kept = numbers((n, 3), 5, 7) > -2
    offsets = numbers((n, 3, 3), 11, 41).astype(np.int32)
    offsets[~kept] = 0
    features = numbers((n, 6), 13, 29).astype(np.int32)
    features[3, 2], features[4, 5] = (1 << 23) - 1, -(1 << 23) + 1
    scene = Scene(
        profile=0,
        dimensions=d,
        chunk_size=6,
        lanes=Lanes(1, 0, 2),
        base_step=(1.5, 0.0625, 0.75),
        grid=PositionGrid((-1234567, 0, 1 << 50), 12345, -9),
        render=RenderInfo(),
        frame=Frame(
            numbers((3, 3), 12345, 1 << 18),
            numbers((3,), 987654321, 1 << 39),
            column([27, 28, 29]),
            column([-131072, -90000, -65536]),
            column([131072, 90001, 65537]),
        ),
        plane_shift=6,
        carm_shift=np.array([0, 1, 2], np.uint8),
        networks=nets,
        planes=numbers((5, 2, 5, 5), 17, 23).astype(np.int16),
        mask_model=(pattern((6,), 2711, 16383) + 1).astype(np.uint16),
        positions=(numbers((n, 3), 31, 101) / np.float32(32) + np.float32(1 / 64)).astype(np.float16),
        masks=kept,
        attributes=Attributes(features, numbers((n, 6), 19, 31).astype(np.int32), offsets, np.zeros((n, 3), np.uint8)),
        extensions=((9, 2, b"fixed"),),
    )
    return with_steps(scene)


# Measured once. A change of either is a change of the format.
FIXED_FILE = "a835e207441c2b8e7088bea7fb80457923751b8166c29139e6e4c24e91a4eb24"
FIXED_DIGEST = "7df38d91bd440aa064df57ee60e13885149d9df0c4da48b8eb12c8b44cefe368"


def test_the_fixed_scene_has_the_same_bytes_everywhere() -> None:
    """Encoder and decoder share their code, so only a value kept from before sees a change made to both."""
    scene = fixed_scene()
    data = codec.emit(scene)
    found = codec.parse(data).scene
    assert reconstruction.digest(found)[0] == reconstruction.digest(scene)[0] == FIXED_DIGEST
    assert hashlib.sha256(data).hexdigest() == FIXED_FILE
