"""Steps of the decoding process against SPEC.md's blocks: operators, geometry, the order of symbols, their models."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from random_scenes import random_scene
from spec_numbers import f32_bits

from conformance.fuzz.strategies import frames
from refcodec.bitstream import conventions, planes, positions
from refcodec.bitstream.context import context, contract, frame_coordinates, positional_encoding, query, rescale
from refcodec.bitstream.entropy import select
from refcodec.bitstream.frame import MATRIX_BOUND, TRANSLATION_BOUND, Frame
from refcodec.bitstream.planes import assemble_planes

Spec = dict[str, Any]
INT63 = (1 << 63) - 1
UNIT = 1 << 16


def column(values: list[Any]) -> np.ndarray:
    return np.array(values, dtype=np.int64)


# --- operators --------------------------------------------------------------------------------------------------------


ROOTS = [r + d for b in range(31) for r in (1 << b, 3 << max(b - 2, 0)) for d in (-1, 0, 1) if 0 < r + d < 1 << 31]


@given(st.lists(st.integers(0, (1 << 62) - 1), min_size=1, max_size=20))
@example([0, 1, 2, 3, 4, (1 << 62) - 1])
@example([r * r + d for r in ROOTS for d in (-1, 0, 1)])
def test_isqrt(spec: Spec, values: list[int]) -> None:
    assert conventions.isqrt(column(values)).tolist() == [spec["ISQRT"](v) for v in values]


@given(st.integers(-(2**62), 2**62), st.integers(0, 60))
def test_rounding_shift(spec: Spec, a: int, s: int) -> None:
    rounded = int(conventions.rshift_round(column([a]), s)[0])
    assert rounded == spec["RSHIFT_ROUND"](a, s) == math.floor(Fraction(a, 1 << s) + Fraction(1, 2))


def is_nearest(x: np.float32, exact: Fraction) -> bool:
    """Whether no float32 is nearer to an exact number, and x is the even one of two that are as near."""
    away = abs(Fraction(float(x)) - exact)
    others = [abs(Fraction(float(np.nextafter(x, np.float32(end)))) - exact) for end in (-np.inf, np.inf)]
    return away < min(others) or (away == min(others) and int(x.view(np.uint32)) % 2 == 0)


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
@example(-(2**25) - 2, 0)
@example(INT63, 36)
@example(INT63, -84)
@example(0, 5)
@example((1 << 40) + (1 << 16), 3)
@example((1 << 40) + (1 << 16) + 1, 3)
# Rounding to binary64 first would make this a tie and go down.
@example((1 << 62) + (1 << 38) + 1, 0)
def test_round_to_f32_rounds_once(spec: Spec, n: int, exponent: int) -> None:
    rounded = conventions.round_to_f32(column([n]), exponent)[0]
    assert rounded.dtype == np.float32
    assert f32_bits(rounded) == spec["ROUND_F32"](n, exponent)
    assert is_nearest(rounded, n * Fraction(2) ** exponent)
    assert not (n == 0 and np.signbit(rounded))


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


# --- geometry ---------------------------------------------------------------------------------------------------------


def fields(frame: Frame) -> dict[str, list[int]]:
    """A frame as the blocks take it."""
    return {name: getattr(frame, name).reshape(-1).tolist() for name in Frame.__dataclass_fields__}


@pytest.mark.requirement("D7.4-1")
def test_every_half_precision_number(spec: Spec) -> None:
    bits = np.arange(1 << 16, dtype=np.uint16)
    finite = np.isfinite(bits.view(np.float16))
    integers = positions.position_integers(bits[finite].view(np.float16))
    assert integers.tolist() == [spec["POSITION_INTEGER"](b) for b in bits[finite].tolist()]
    assert integers.tolist() == [int(Fraction(float(x)) * 2**24) for x in bits[finite].view(np.float16)]
    # No file gives the other 2048 patterns, but they do not wrap either.
    rest = positions.position_integers(bits[~finite].view(np.float16))
    assert len(rest) == 2048
    assert np.abs(rest).max() < 1 << 42


COORDINATE = st.integers(-(2**40) + 2**29, 2**40 - 2**29)


@pytest.mark.requirement("D7.5.1-1", "D7.5.2-1", "D7.5.3-1")
@given(frames(), st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), min_size=1, max_size=8))
@example(
    Frame(
        np.full((3, 3), MATRIX_BOUND - 1),
        np.full(3, TRANSLATION_BOUND - 1),
        np.full(3, 60),
        np.full(3, -1),
        np.full(3, 1),
    ),
    [(65504 * 2**24,) * 3, (-65504 * 2**24,) * 3],
)
def test_affine_map_contraction_and_rescaling(spec: Spec, frame: Frame, points: list[tuple[int, int, int]]) -> None:
    """Python's integers do not wrap."""
    v = frame_coordinates(frame, np.array(points, dtype=np.int64))
    w = contract(v)
    u = rescale(frame, w)
    stated = fields(frame)
    assert v.tolist() == [spec["FRAME_COORDINATES"](stated, p) for p in points]
    assert w.tolist() == [spec["CONTRACT"](row) for row in v.tolist()]
    assert u.tolist() == [spec["RESCALE"](stated, row) for row in w.tolist()]


def test_contraction_is_the_real_one_within_a_unit() -> None:
    """Against the real function: at most 2^-13, from the floors."""
    rng = np.random.default_rng(5)
    v = (rng.normal(0, 1, (2000, 3)) * 10.0 ** rng.uniform(-2, 3, (2000, 1)) * UNIT).astype(np.int64)
    real = v / UNIT
    norm = np.linalg.norm(real, axis=1, keepdims=True)
    wanted = np.where(norm <= 1, real, (2 - 1 / np.maximum(norm, 1)) * real / np.maximum(norm, 1))
    assert np.abs(contract(v) / UNIT - wanted).max() < 2**-13


@pytest.mark.requirement("D7.5.4-1")
@given(
    st.integers(2, 9),
    st.integers(1, 3),
    st.integers(0, 10),
    st.integers(0, 99),
    st.lists(st.tuples(st.integers(0, UNIT), st.integers(0, UNIT)), min_size=1, max_size=6),
    st.sampled_from([3, 200, 32767]),
)
@example(2, 1, 0, 0, [(0, 0), (65536, 65536), (0, 65536), (65536, 0), (32768, 32768), (65535, 1)], 32767)
@example(9, 1, 10, 1, [(65536, 65535), (8192, 8191), (57344, 57343)], 32767)
def test_query(
    spec: Spec, size: int, channels: int, shift: int, seed: int, at: list[tuple[int, int]], largest: int
) -> None:
    plane = np.random.default_rng(seed).integers(-largest, largest + 1, (channels, size, size))
    samples = query(plane, column(at), shift)
    assert samples.tolist() == [spec["QUERY"](plane.tolist(), u, shift) for u in at]


def test_query_at_grid_points_and_edges() -> None:
    """At a grid point the sample is the symbol, both edges included; quadrants are where SPEC 7.3 says."""
    size = 5
    given_planes = np.arange(5 * 2 * size * size).reshape(5, 2, size, size).astype(np.int16)
    first, second = assemble_planes(given_planes)
    # u[0] chooses the column, u[1] the row.
    every = column([[j << 14, i << 14] for i in range(size) for j in range(size)])
    assert np.array_equal(query(first, every, 0), given_planes[0].reshape(2, -1).T)
    corners = column([[0, 0], [UNIT, 0], [0, UNIT], [UNIT, UNIT]])
    ends = [(0, 0), (0, size - 1), (size - 1, 0), (size - 1, size - 1)]
    wanted = [given_planes[quadrant, :, i, j].tolist() for quadrant, (i, j) in enumerate(ends, start=1)]
    assert query(second, corners, 0).tolist() == wanted


@pytest.mark.requirement("D7.5.5-1")
@given(st.lists(st.integers(0, UNIT), min_size=1, max_size=8), st.integers(1, 10))
@example([0, 1, 31, 32, 33, 32767, 32768, 32769, 65504, 65535, 65536], 10)
def test_positional_encoding(spec: Spec, u: list[int], frequencies: int) -> None:
    assert positional_encoding(column(u), frequencies).tolist() == [spec["GAMMA"](x, frequencies) for x in u]


def test_positional_encoding_is_sine_and_cosine() -> None:
    """Half a table step of phase and half a unit of value away at most."""
    u = np.append(np.arange(0, UNIT, 37), UNIT)
    waves = positional_encoding(u, 10)
    z = u / (UNIT // 2) - 1
    for k in range(10):
        assert np.abs(waves[:, 2 * k] - 1023 * np.sin(2.0**k * np.pi * z)).max() < 3.7
        assert np.abs(waves[:, 2 * k + 1] - 1023 * np.cos(2.0**k * np.pi * z)).max() < 3.7


@pytest.mark.requirement("D7.5-1")
def test_context_puts_the_parts_in_order(spec: Spec) -> None:
    """Ordinary positions and any bits, one in five."""
    rng = np.random.default_rng(2)
    scene = random_scene(5, 200)
    both = assemble_planes(scene.planes)
    any_bits = rng.integers(0, 0x7C00, (200, 3)).astype(np.uint16)
    bits = np.where(rng.random((200, 3)) < 0.2, any_bits, scene.positions.view(np.uint16))
    contexts = context(scene.frame, both, scene.plane_shift, 3, bits.view(np.float16)).tolist()
    stated, listed = fields(scene.frame), scene.planes.tolist()
    assert contexts == [spec["CONTEXT"](stated, listed, scene.plane_shift, 3, p) for p in bits.tolist()]
    assert len({tuple(row) for row in contexts}) > 100, "the anchors see different contexts"


# --- the order of symbols, and their models ---------------------------------------------------------------------------


@pytest.mark.requirement("D7.3-2")
def test_quadrants_lie_as_they_are_named(spec: Spec) -> None:
    given_planes = (np.arange(5 * 2 * 3 * 3) - 40).reshape(5, 2, 3, 3).astype(np.int16)
    first, joined = assemble_planes(given_planes)
    assert np.array_equal(first, given_planes[0])
    assert joined.tolist() == spec["JOIN_QUADRANTS"](given_planes[1:].tolist())
    for sub, name in enumerate(planes.PLANE_NAMES[1:], start=1):
        rows, columns = slice(0, 3) if "top" in name else slice(3, 6), slice(0, 3) if "left" in name else slice(3, 6)
        assert np.array_equal(joined[:, rows, columns], given_planes[sub]), name


@pytest.mark.requirement("D7.3-1")
@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 8, 32])
def test_wavefronts_hold_each_point_once_after_its_neighbours(spec: Spec, size: int) -> None:
    fronts = []
    for t in range(3 * size - 2):
        rows, columns = planes.wavefront(t, size)
        fronts.append([(0, i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True)])
    assert fronts == spec["PLANE_GROUPS"](1, size)
    done = {(i, j): t for t, group in enumerate(fronts) for _, i, j in group}
    assert sum(map(len, fronts)) == len(done) == size * size
    for (i, j), t in done.items():
        for near in ((i - 1, j - 1), (i - 1, j), (i - 1, j + 1), (i, j - 1)):
            assert done.get(near, -1) < t


def selected(spec: Spec, mean: int, scale: int) -> tuple[int, int, int]:
    """Number of the model, centre and raw bits, by the text."""
    row, fraction, centre, raw = spec["SELECT"](mean, scale)
    return (row - spec["SCALE_MIN"]) * spec["FRACTIONS"] + fraction, centre, raw


@pytest.mark.requirement("D8.5-1")
@given(st.lists(st.tuples(st.integers(-(1 << 25), 1 << 25), st.integers(-(1 << 25), 1 << 25)), min_size=1, max_size=20))
@example([(mean, scale) for scale in (*range(-60, 170), -99, 900) for mean in range(-70, 70)])
@example([((1 << 25) - 1, 151), (8 * 65535, 152)])
def test_selection(spec: Spec, pairs: list[tuple[int, int]]) -> None:
    """The model is that of the text, and its mean the nearest to the true one."""
    chosen = np.stack(select(*column(pairs).T), axis=1).tolist()
    assert [tuple(row) for row in chosen] == [selected(spec, *pair) for pair in pairs]
    # What the choice is for: the mean of the part that is not sent raw, to half of a sixteenth.
    for (mean, _), (model, centre, raw) in zip(pairs, chosen, strict=True):
        true = (Fraction(mean, 16) - Fraction((1 << raw) - 1, 2)) / (1 << raw)
        assert abs(centre + Fraction(model % 16, 16) - Fraction(1, 2) - true) <= Fraction(1, 32)
