"""Exactness: the integers are those of plain Python, and nothing about the machine changes a digest (SPEC.md 2, 7.2, 7.4, 7.5)."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from conformance.cases.scenes import MAIN_DIMENSIONS, random_scene
from conformance.fuzz.strategies import frames
from refcodec.bitstream import batches, codec, context, conventions, networks, positions, reconstruction
from refcodec.bitstream.entropy import select
from refcodec.bitstream.frame import MATRIX_BOUND, TRANSLATION_BOUND, Frame
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.planes import assemble_planes

# --- the same digest, whatever computes it ----------------------------------------------------------------------------

CHILD = """
import sys
from pathlib import Path
from refcodec.bitstream import batches, codec, networks, reconstruction
{change}
print(reconstruction.digest(codec.parse(Path(sys.argv[1]).read_bytes(){arguments}).scene)[0])
"""
# The codec's own limit of one BLAS thread is taken away; that BLAS then has the threads it was given is asserted.
OPEN_THREADS = """
import contextlib
import os
from threadpoolctl import threadpool_info
codec.threadpool_limits = lambda *a: contextlib.nullcontext()
blas = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
assert set(blas) <= {min(2, len(os.sched_getaffinity(0)))}, blas
"""
VARIANTS = {
    "as it is": ("", "", "1"),
    "two BLAS threads": (OPEN_THREADS, "", "2"),
    "groups of one chunk": ("batches.GROUP_CHUNKS = 1", "", "1"),
    "groups of few anchors": ("batches.GROUP_ANCHORS = 300", "", "1"),
    "blocks of 7 rows": ("networks.BLOCK_ROWS = 7", "", "1"),
    "blocks of all rows": ("networks.BLOCK_ROWS = 1 << 20", "", "1"),
    "int64": ("networks.float32_is_exact = lambda: False", "", "1"),
    "one chunk, int64": ("networks.float32_is_exact = lambda: False; batches.GROUP_CHUNKS = 1", "", "1"),
    "traced": ("", ", trace=lambda row: None", "1"),
}


@pytest.fixture(scope="module")
def main_file(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A file of profile Main with several chunks, and its digest from the encoder's side."""
    scene = random_scene(21, 1500, MAIN_DIMENSIONS, chunk_size=400, lanes=Lanes(3, 2, 3))
    path = tmp_path_factory.mktemp("exact") / "main.c3gs"
    path.write_bytes(codec.emit(scene))
    return path, reconstruction.digest(scene)[0]


@pytest.mark.requirement("D9.3-1")
@pytest.mark.parametrize("variant", VARIANTS)
def test_one_digest(main_file: tuple[Path, str], variant: str) -> None:
    change, arguments, threads = VARIANTS[variant]
    code = CHILD.format(change=change, arguments=arguments)
    environment = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": threads,
        "OMP_NUM_THREADS": threads,
        "MKL_NUM_THREADS": threads,
    }
    done = subprocess.run(
        [sys.executable, "-c", code, str(main_file[0])], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == main_file[1]


def test_encoding_is_the_same_in_small_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = random_scene(22, 90, chunk_size=10)
    data = codec.emit(scene)
    monkeypatch.setattr(batches, "GROUP_CHUNKS", 2)
    assert codec.emit(scene) == data


# --- integer networks -------------------------------------------------------------------------------------------------


def exact_row(weights: list[float], bias: float) -> tuple[list[int], int, int] | None:
    """SPEC 7.2 in fractions."""
    for e in range(20, -1, -1):
        w = [math.floor(Fraction(x) * 2**e + Fraction(1, 2)) for x in weights]
        b = math.floor(Fraction(bias) * 2**e + Fraction(1, 2))
        if max(map(abs, w)) <= 1023 and sum(map(abs, w)) * 1023 + abs(b) + (2**e >> 1) < 2**24:
            return w, b, e
    return None


F32 = st.one_of(
    st.floats(width=32, allow_nan=False, allow_infinity=False),
    st.floats(-2000, 2000, width=32),
    st.floats(-1, 1, width=32),
    st.integers(-1024, 1024).map(lambda n: n + 0.5),
)


@pytest.mark.requirement("D7.2-1")
@given(st.lists(F32, min_size=1, max_size=128), F32)
@example([1023.0], 0.0)
@example([1023.5], 0.0)
@example([-1023.5], 0.0)
@example([0.0] * 128, float(2**24 - 1))
@example([0.0], float(2**24))
@example([128.0] * 128, 0.0)
@example([128.0] * 128, float(2**24 - 128 * 128 * 1023 - 1))
@example([128.0] * 128, float(2**24 - 128 * 128 * 1023))
@example([0.5, -0.5, 1.5, -1.5], -0.5)
@example([1e-45] * 3, -1e-45)
@example([3.4e38], 1.0)
def test_derived_rows(weights: list[float], bias: float) -> None:
    """The derived row is that of exact arithmetic, and no input and no order of summation takes it past 2^24."""
    w32, b32 = np.array([weights], np.float32), np.array([bias], np.float32)
    wanted = exact_row(w32[0].tolist(), float(b32[0]))
    if wanted is None:
        with pytest.raises(networks.BoundError):
            networks.derive_layer(w32, b32)
        return
    layer = networks.derive_layer(w32, b32)
    assert (layer.weight[0].tolist(), int(layer.bias[0]), int(layer.exponent[0])) == wanted
    # Every partial sum is at most the sum of magnitudes at the extreme inputs, with bias and rounding term.
    worst = int(np.abs(layer.weight).sum()) * 1023 + abs(int(layer.bias[0])) + ((1 << wanted[2]) >> 1)
    assert worst < 1 << 24


@pytest.mark.requirement("D7.2-2")
@given(st.integers(0, 2**32 - 1), st.integers(1, 128), st.integers(1, 40), st.sampled_from(["random", "worst"]))
def test_float32_equals_int64(seed: int, fan_in: int, rows: int, kind: str) -> None:
    """At the bound, with inputs that reach it, in any order of the inputs, in any order of the rows."""
    rng = np.random.default_rng(seed)
    limit = min(1023, ((1 << 24) - 1) // (1023 * fan_in))
    out = 5
    weight = (
        rng.integers(-limit, limit + 1, (out, fan_in))
        if kind == "random"
        else limit * rng.choice([-1, 1], (out, fan_in))
    )
    layers = [networks.derive_layer(weight.astype(np.float32), np.zeros(out, np.float32))]
    inputs = rng.integers(-1023, 1024, (rows, fan_in))
    inputs[0] = 1023 * np.sign(weight[0])
    wanted = networks.IntNetwork(layers, exact_float=False)(inputs)
    assert np.array_equal(networks.IntNetwork(layers, exact_float=True)(inputs), wanted)
    assert np.array_equal(networks.IntNetwork(layers, exact_float=True, block_rows=3)(inputs), wanted)
    order, columns = rng.permutation(rows), rng.permutation(fan_in)
    assert np.array_equal(networks.IntNetwork(layers, exact_float=True)(inputs[order]), wanted[order])
    turned = [networks.IntLayer(layers[0].weight[:, columns], layers[0].bias, layers[0].exponent)]
    assert np.array_equal(networks.IntNetwork(turned, exact_float=True)(inputs[:, columns]), wanted)


def test_the_self_test_sees_a_reduced_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    """A product that rounds its inputs to bfloat16 fails the self-test; this machine's product passes it."""
    assert networks.float32_is_exact()

    class Rounded(np.ndarray):
        def __matmul__(self, other: np.ndarray) -> np.ndarray:
            cut = [(np.asarray(a).view(np.uint32) & np.uint32(0xFFFF0000)).view(np.float32) for a in (self, other)]
            return cut[0] @ cut[1]

    kept = np.random.Generator.integers

    class Generator:
        def __init__(self, bits: object) -> None:
            self.inner = np.random.default_rng(0)

        def integers(self, low: int, high: int, shape: tuple) -> np.ndarray:
            class Wrapped(np.ndarray):
                def astype(self, dtype: object, *a: object, **k: object) -> np.ndarray:
                    cast = np.asarray(self).astype(dtype)
                    return cast.view(Rounded) if dtype is np.float32 else cast

            return kept(self.inner, low, high, shape).view(Wrapped)

    monkeypatch.setattr(np.random, "Generator", Generator)
    assert not networks.float32_is_exact.__wrapped__()


# --- geometry ---------------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, (1 << 62) - 1), min_size=1, max_size=20))
@example([0, 1, 2, 3, 4, (1 << 62) - 1])
@example([r * r + d for r in (2**26, 2**27 + 1, 2**31 - 1) for d in (-1, 0, 1)])
def test_isqrt(values: list[int]) -> None:
    assert conventions.isqrt(np.array(values, dtype=np.int64)).tolist() == [math.isqrt(v) for v in values]


@pytest.mark.requirement("D7.4-1")
def test_every_half_precision_number() -> None:
    bits = np.arange(1 << 16, dtype=np.uint16)
    finite = np.isfinite(bits.view(np.float16))
    found = positions.position_integers(bits[finite].view(np.float16))
    assert found.tolist() == [int(Fraction(float(x)) * 2**24) for x in bits[finite].view(np.float16)]
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
def test_geometry_in_plain_integers(frame: Frame, points: list[tuple[int, int, int]]) -> None:
    """Affine map, contraction and rescaling against Python's integers, which do not wrap."""
    unit, top = 1 << 16, (1 << 30) - 1
    v = context.frame_coordinates(frame, np.array(points, dtype=np.int64))
    w = context.contract(v)
    u = context.rescale(frame, w)
    for n, p in enumerate(points):
        wanted = []
        for r in range(3):
            t = sum(int(a) * x for a, x in zip(frame.matrix[r], p, strict=True)) + int(frame.translation[r])
            s = int(frame.shift[r])
            assert abs(t + ((1 << s) >> 1)) < 1 << 63
            wanted.append(min(max((t + ((1 << s) >> 1)) >> s, -top), top))
        assert v[n].tolist() == wanted
        square = sum(x * x for x in wanted)
        root = math.isqrt(square)
        near = wanted if square <= unit * unit else [x * ((2 * root - unit) * unit // root) // root for x in wanted]
        assert w[n].tolist() == near
        lows, highs = frame.low.tolist(), frame.high.tolist()
        assert u[n].tolist() == [
            min(max((x - a) * unit // (b - a), 0), unit) for x, a, b in zip(near, lows, highs, strict=True)
        ]


def test_contraction_is_the_real_one_within_a_unit() -> None:
    """Against the real function: at most 2^-13, from the floors."""
    rng = np.random.default_rng(5)
    v = (rng.normal(0, 1, (2000, 3)) * 10.0 ** rng.uniform(-2, 3, (2000, 1)) * 65536).astype(np.int64)
    real = v / 65536
    norm = np.linalg.norm(real, axis=1, keepdims=True)
    wanted = np.where(norm <= 1, real, (2 - 1 / np.maximum(norm, 1)) * real / np.maximum(norm, 1))
    assert np.abs(context.contract(v) / 65536 - wanted).max() < 2**-13


def test_contexts_do_not_depend_on_the_order_of_anchors() -> None:
    scene = random_scene(23, 300)
    full = assemble_planes(scene.planes)
    contexts = context.context(scene.frame, full, scene.plane_shift, 2, scene.positions)
    order = np.random.default_rng(0).permutation(300)
    assert np.array_equal(
        context.context(scene.frame, full, scene.plane_shift, 2, scene.positions[order]), contexts[order]
    )


def test_query_at_grid_points_and_edges() -> None:
    """At a grid point the sample is the symbol, both edges included; quadrants are where SPEC 7.3 says."""
    size = 5
    planes = np.arange(5 * size * size).reshape(5, 1, size, size).astype(np.int16)
    first, second = assemble_planes(planes)
    ends = np.array([[0, 0], [1 << 16, 0], [0, 1 << 16], [1 << 16, 1 << 16]])
    assert context.query(first, ends, 0)[:, 0].tolist() == [
        planes[0, 0, i, j] for i, j in ((0, 0), (0, 4), (4, 0), (4, 4))
    ]
    assert context.query(second, ends, 0)[:, 0].tolist() == [
        planes[1, 0, 0, 0],
        planes[2, 0, 0, 4],
        planes[3, 0, 4, 0],
        planes[4, 0, 4, 4],
    ]
    third = np.array([[k << 14, m << 14] for m in range(size) for k in range(size)])
    assert context.query(first, third, 0)[:, 0].tolist() == planes[0].reshape(-1).tolist()


def test_positional_encoding_is_sine_and_cosine() -> None:
    u = np.arange(0, (1 << 16) + 1, 37)
    found = context.positional_encoding(u, 10) / 1023
    z = u / 32768 - 1
    for k in range(10):
        assert np.abs(found[:, 2 * k] - np.sin(2.0**k * np.pi * z)).max() < 0.005
        assert np.abs(found[:, 2 * k + 1] - np.cos(2.0**k * np.pi * z)).max() < 0.005


# --- rounding ---------------------------------------------------------------------------------------------------------


def exact_f32(n: int, e: int) -> Fraction:
    """The float32 nearest to n * 2^e, ties to even, in fractions."""
    if n == 0:
        return Fraction(0)
    unit = max(abs(n).bit_length() - 24, 0)
    low, rest = divmod(abs(n), 1 << unit)
    twice = 2 * rest
    low += twice > 1 << unit or (twice == 1 << unit and low & 1)
    return (-1 if n < 0 else 1) * Fraction(low) * Fraction(2) ** (unit + e)


@given(st.integers(1 - 2**63, 2**63 - 1), st.integers(-60, 30))
@example(2**24 + 1, 0)
@example(2**24 + 3, 0)
@example(-(2**25) - 2, 0)
@example(2**63 - 1, -84)
@example((1 << 40) + (1 << 16), 3)
@example((1 << 40) + (1 << 16) + 1, 3)
def test_one_rounding_to_float32(n: int, e: int) -> None:
    assert Fraction(float(conventions.round_to_f32(np.array([n], dtype=np.int64), e)[0])) == exact_f32(n, e)


@given(st.integers(-(2**62), 2**62), st.integers(0, 60))
def test_rounding_shift(a: int, s: int) -> None:
    assert int(conventions.rshift_round(np.array([a], dtype=np.int64), s)[0]) == math.floor(
        Fraction(a, 1 << s) + Fraction(1, 2)
    )


@pytest.mark.requirement("D8.5-1")
@given(st.integers(-(2**25), 2**25), st.integers(-(2**25), 2**25))
@example(0, 24)
@example(-8, 23)
@example(7, 151)
def test_selection(mean: int, scale: int) -> None:
    """The selected model's mean is the nearest to the true one, and its row that of the scale less eight for each raw bit."""
    model, centre, raw = (int(x[0]) for x in select(np.array([mean]), np.array([scale])))
    row, column = divmod(model, 16)
    k = min(max(-(-(scale - 23) // 8), 0), 16)
    assert raw == k
    assert row - 40 == min(max(scale - 8 * k, -40), 23)
    true = (Fraction(mean, 16) - Fraction((1 << k) - 1, 2)) / (1 << k)
    assert abs(centre + Fraction(column, 16) - Fraction(1, 2) - true) <= Fraction(1, 32)
