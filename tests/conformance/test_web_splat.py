"""splat.c, compiled for this machine with sanitizers: the numbers of refcodec, and no fault for any numbers."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from c_program import COMPILER, SANITIZERS
from hypothesis import given, settings
from hypothesis import strategies as st

from refcodec.bitstream.dimensions import RENDERING
from refcodec.bitstream.networks import IntLayer, IntNetwork
from refcodec.bitstream.splat import splat

REFUSED = -2
EXTREME = [0.0, -0.0, 1e-45, -1e30, 3e38, -3e38, np.inf, -np.inf, np.nan]

pytestmark = [pytest.mark.no_cover, pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("splat") / "splat"
    source = Path(__file__).with_name("splat_web.c")
    flags = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-Wno-psabi", "-ffp-contract=off"]
    for more in (SANITIZERS, []):
        command = [str(COMPILER), *flags, *more, str(source), "-o", str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return path
    raise AssertionError(done.stderr)


class Case:
    """Networks and anchors of random numbers, whose features fill the range of activations."""

    def __init__(self, seed: int, features: int, width: int, offsets: int, colours: int, anchors: int) -> None:
        self.sizes = features, width, offsets, colours
        rng = np.random.default_rng(seed)

        def layer(outputs: int, inputs: int) -> IntLayer:
            exponent = rng.integers(0, 12, outputs)
            return IntLayer(rng.integers(-100, 100, (outputs, inputs)), rng.integers(-9999, 9999, outputs), exponent)

        counts = dict(zip(RENDERING, (1, 7, colours), strict=True))
        self.layers = {name: [layer(width, features), layer(n * offsets, width)] for name, n in counts.items()}
        shapes = ((3,), (features,), (6,), (offsets, 3))
        self.positions, self.features, self.scalings, self.offsets = (
            rng.normal(0, 1, (anchors, *shape)).astype("<f4") for shape in shapes
        )
        self.features *= np.float32(600)
        self.scalings *= np.float32(12)
        self.masks = rng.random((anchors, offsets)) < 0.6

    def run(self, program: Path, rows: bool = True, room: int | None = None) -> tuple[int, np.ndarray]:
        """Returns the status or the count, and the numbers of each Gaussian."""
        own = [layer for layers in self.layers.values() for layer in layers]
        weight, bias, exponent = (
            np.concatenate([getattr(layer, name).ravel() for layer in own]).astype(kind)
            for name, kind in (("weight", "<i2"), ("bias", "<i4"), ("exponent", "u1"))
        )
        count = int(self.masks.sum()) if room is None else room
        head = struct.pack("<9I", *self.sizes, len(weight), len(bias), len(self.positions), count, rows)
        arrays = (self.positions, self.masks.astype("u1"), self.features, self.scalings, self.offsets)
        data = head + b"".join(array.tobytes() for array in (weight, bias, exponent, *arrays))
        done = subprocess.run([program], input=data, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr.decode()
        found = np.frombuffer(done.stdout, "<f4", offset=4).reshape(-1, 11 + self.sizes[3])
        return struct.unpack_from("<i", done.stdout)[0], found


@settings(max_examples=25)
@given(st.data())
def test_the_numbers_are_those_of_refcodec(program: Path, data: st.DataObject) -> None:
    sizes = st.integers(1, 9) | st.sampled_from([16, 50, 128])
    colours = st.sampled_from([3, 12, 27, 48])
    case = Case(
        data.draw(st.integers(0, 99)),
        data.draw(sizes),
        data.draw(sizes),
        data.draw(st.integers(1, 16)),
        data.draw(colours),
        data.draw(st.integers(0, 5)),
    )
    networks = {name: IntNetwork(layers) for name, layers in case.layers.items()}
    right = splat(networks, case.positions, case.features, case.scalings, case.offsets, case.masks)
    count, found = case.run(program, data.draw(st.booleans()))
    assert count == len(right)
    assert found.tobytes() == right.astype("<f4").tobytes()


@settings(max_examples=25)
@given(st.data())
def test_no_numbers_do_harm(program: Path, data: st.DataObject) -> None:
    case = Case(data.draw(st.integers(0, 99)), 5, 7, 3, 12, 4)
    for _ in range(data.draw(st.integers(1, 6))):
        array = data.draw(st.sampled_from([case.positions, case.features, case.scalings, case.offsets]))
        array.ravel()[data.draw(st.integers(0, array.size - 1))] = data.draw(st.sampled_from(EXTREME))
    count, found = case.run(program)
    assert count == case.masks.sum() == len(found)


def test_what_does_not_fit_is_refused(program: Path) -> None:
    case = Case(1, 5, 7, 3, 12, 6)
    assert case.run(program, room=int(case.masks.sum()) - 1)[0] == REFUSED


@pytest.mark.parametrize(
    "sizes", [(0, 7, 3, 3), (129, 7, 3, 3), (5, 0, 3, 3), (5, 7, 0, 3), (5, 7, 17, 3), (5, 7, 3, 49)]
)
def test_sizes_that_no_file_has_are_refused(program: Path, sizes: tuple[int, int, int, int]) -> None:
    assert Case(1, *sizes, 0).run(program)[0] == REFUSED
