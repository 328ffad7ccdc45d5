"""draw.c, compiled for this machine with sanitizers: right numbers, and no fault for any numbers."""

import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_program import COMPILER, SANITIZERS
from hypothesis import given, settings
from hypothesis import strategies as st

REFUSED = -2
# What the Gaussians of an anchor take: outputs of opacity, covariance and colour for an offset (SPEC 14.3).
OUTPUTS = (1, 7, 3)
ARRAYS = [("<f4", 3), ("<f4", 3), ("<f4", 4), ("<f4", 3), ("<f4", 1), ("<u4", 1), ("u1", 1)]
EXTREME = [0.0, -0.0, 1e-45, -1e30, 3e38, -3e38, np.inf, -np.inf, np.nan]

pytestmark = [pytest.mark.no_cover, pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("draw") / "draw"
    source = Path(__file__).with_name("draw_web.c")
    flags = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-Wno-psabi", "-ffp-contract=off", "-D_GNU_SOURCE"]
    for more in (SANITIZERS, []):
        command = [str(COMPILER), *flags, *more, str(source), "-lm", "-o", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return path
    raise AssertionError(done.stderr)


class Case:
    """Networks and anchors of random numbers."""

    def __init__(self, seed: int, features: int, width: int, offsets: int, anchors: int) -> None:
        self.features, self.width, self.offsets, self.anchors = features, width, offsets, anchors
        rng = np.random.default_rng(seed)
        inputs = features + 4
        layers = [shape for n in OUTPUTS for shape in ((width, inputs), (width,), (n * offsets, width), (n * offsets,))]
        self.values = np.concatenate([rng.normal(0, 0.5, shape).ravel() for shape in layers]).astype("<f4")
        shapes = ((3,), (features,), (6,), (offsets, 3))
        self.positions, self.features_of, self.scalings, self.offsets_of = (
            rng.normal(0, 1, (anchors, *shape)).astype("<f4") for shape in shapes
        )
        self.masks = (rng.random((anchors, offsets)) < 0.6).astype(np.uint8)

    def numbers(self) -> list[Any]:
        """The arrays that extreme numbers can be put in."""
        return [self.values, self.positions, self.features_of, self.scalings, self.offsets_of]

    def run(self, program: Path, **changes: Any) -> tuple[int, list[Any]]:
        """Returns the status or the count, and the arrays."""
        kept = int(self.masks.sum())
        head = {
            "features": self.features,
            "width": self.width,
            "offsets": self.offsets,
            "values": len(self.values),
            "anchors": self.anchors,
            "kept": kept,
            "start": 0,
            "end": self.anchors,
            "room": kept,
            "distance_unit": 2.0,
        } | changes
        order = (self.values, self.positions, self.masks, self.features_of, self.scalings, self.offsets_of)
        data = struct.pack("<9If", *head.values()) + b"".join(array.tobytes() for array in order)
        place = np.array([0.25, -1.0, 3.0]).tobytes()
        done = subprocess.run([program], input=data + place, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr.decode()
        (count,) = struct.unpack_from("<i", done.stdout)
        at, drawn = 4, []
        for kind, width in ARRAYS if count > 0 else []:
            array = np.frombuffer(done.stdout, kind, count * width, at).reshape(count, width)
            drawn.append(array)
            at += array.nbytes
        assert at == len(done.stdout)
        return count, drawn


@settings(max_examples=25)
@given(st.data())
def test_no_numbers_do_harm(program: Path, data: st.DataObject) -> None:
    """Whatever the numbers are, those that come out are finite, in their ranges, and belong to kept offsets."""
    sizes = st.integers(1, 9) | st.sampled_from([16, 50, 128])
    case = Case(
        data.draw(st.integers(0, 99)),
        data.draw(sizes),
        data.draw(sizes),
        data.draw(st.integers(1, 16)),
        data.draw(st.integers(0, 5)),
    )
    for _ in range(data.draw(st.integers(0, 6))):
        array = data.draw(st.sampled_from(case.numbers()))
        if array.size:
            array.ravel()[data.draw(st.integers(0, array.size - 1))] = data.draw(st.sampled_from(EXTREME))
    count, arrays = case.run(program)
    assert 0 <= count <= case.masks.sum()
    if not count:
        return
    assert all(np.isfinite(array).all() for array in arrays)
    _, scales, rotations, colours, opacities, anchors, offsets = arrays
    assert (scales >= 0).all()
    assert np.allclose(np.linalg.norm(rotations.astype(np.float64), axis=1), 1, atol=1e-6)
    assert ((colours >= 0) & (colours <= 1)).all()
    assert ((opacities > 0) & (opacities <= 1)).all()
    assert case.masks[anchors[:, 0], offsets[:, 0]].all()


def test_what_does_not_fit_is_refused(program: Path) -> None:
    case = Case(1, 5, 7, 3, 6)
    kept = int(case.masks.sum())
    assert case.run(program)[0] > 0
    part = int(case.masks[2:4].sum())
    assert case.run(program, start=2, end=4, room=part)[0] >= 0
    wrong = [
        {"kept": kept - 1},
        {"room": kept - 1},
        {"end": 7},
        {"start": 4, "end": 3},
        {"start": 2, "end": 4, "room": part - 1},
        {"end": 0xFFFFFFFF},
    ]
    for changes in wrong:
        assert case.run(program, **changes)[0] == REFUSED


@pytest.mark.parametrize("sizes", [(0, 7, 3), (129, 7, 3), (5, 0, 3), (5, 129, 3), (5, 7, 0), (5, 7, 17)])
def test_sizes_that_no_file_has_are_refused(program: Path, sizes: tuple[int, int, int]) -> None:
    assert Case(1, *sizes, 0).run(program)[0] == REFUSED


def test_a_wrong_number_of_values_is_refused(program: Path) -> None:
    case = Case(1, 5, 7, 3, 0)
    for values in (case.values[1:], np.append(case.values, case.values[:1])):
        case.values = values
        assert case.run(program)[0] == REFUSED


def test_extreme_outputs_of_the_networks(program: Path) -> None:
    """tanh and the logistic function near 0 and far from it, against binary64.

    The second layers have no weights, so that their biases are the outputs.
    """
    outputs = np.array([1e-4, 3e-3, 0.02, 0.3, 0.499999, 0.5, 0.7, 2, 9, 40, 100, 1e30], "<f4")
    case = Case(3, 2, 4, len(outputs), 1) if len(outputs) <= 16 else None
    assert case is not None
    k, first = len(outputs), 4 * (2 + 4) + 4
    case.masks[:] = 1
    case.scalings[:] = 0
    at = 0
    signs = np.array([1, -1] * (k // 2))
    for n, values in zip(OUTPUTS, (outputs, np.tile(outputs * signs, 7), np.tile(-outputs * signs, 3)), strict=True):
        at += first
        case.values[at : at + n * k * 4] = 0
        at += n * k * 4
        # The outputs of an offset lie together.
        case.values[at : at + n * k] = values.reshape(n, k).T.ravel()
        at += n * k
    count, (_, scales, rotations, colours, opacities, _, _) = case.run(program)
    assert count == k
    wide = outputs.astype(np.float64)
    with np.errstate(over="ignore"):
        logistic = 1 / (1 + np.exp(-wide * signs))
        other = 1 / (1 + np.exp(wide * signs))
    assert np.allclose(opacities[:, 0], np.tanh(wide), rtol=1e-6, atol=0)
    # Below 2^-126 float32 has fewer digits.
    assert np.allclose(scales, np.tile(logistic[:, None], 3), rtol=1e-6, atol=2e-38)
    assert np.allclose(colours, np.tile(other[:, None], 3), rtol=1e-6, atol=2e-38)
    assert np.allclose(rotations, np.tile(signs[:, None] / 2, 4), rtol=1e-6)
