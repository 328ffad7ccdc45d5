"""Static scenes (SPEC.md 9.4): the plain Gaussians against the text's blocks, and with each arithmetic."""

from typing import Any

import numpy as np
import pytest

from conformance.cases import static
from conformance.manifest import Accepted, load
from refcodec.bitstream import codec, reconstruction, splat
from refcodec.bitstream.dimensions import RENDERING
from refcodec.bitstream.networks import IntNetwork
from refcodec.bitstream.reconstruction import Reconstruction
from refcodec.bitstream.scene import take_anchors
from refcodec.native.library import kernel
from refcodec.native.scene import splats

SUITE = load()
FILES = [v for v in SUITE.vectors if "static" in v.features and isinstance(v.expectation, Accepted)]


@pytest.mark.requirement("D9.4-1")
@pytest.mark.parametrize("exact_float", [False, True])
def test_integers_and_float32_give_the_same_gaussians(exact_float: bool) -> None:
    assert len(FILES) >= 10
    for vector in FILES:
        scene = codec.parse(SUITE.path(vector).read_bytes()).scene
        networks = splat.derive_rendering(scene.networks)
        chosen = {name: IntNetwork(network.layers, exact_float, 5) for name, network in networks.items()}
        values = reconstruction.reconstruct(scene)
        floats = splat.splat(chosen, *vars(values).values(), scene.masks)
        assert floats.tobytes() == reconstruction.gaussians(scene).tobytes()
        assert floats.shape == (scene.masks.sum(), 11 + scene.dimensions.colour_outputs)
        assert np.isfinite(floats).all()
        assert not np.signbit(floats[:, splat.MEAN][floats[:, splat.MEAN] == 0]).any()


@pytest.mark.requirement("D9.4-1")
def test_any_values(spec: dict[str, Any]) -> None:
    """Features, scalings and offsets of any size that 9.2 allows: zero, or from 2^-64 to 2^87."""
    rng = np.random.default_rng(94)
    scene = codec.parse(static.of_degree(1)).scene
    count, d = 40, scene.dimensions

    def drawn(*shape: int) -> Any:
        sizes = np.ldexp(rng.uniform(1, 2, shape), rng.integers(-64, 86, shape)) * rng.choice([-1, 0, 1], shape)
        return sizes.astype(np.float32) + np.float32(0)

    values = Reconstruction(drawn(count, 3), drawn(count, d.features), drawn(count, 6), drawn(count, d.offset_count, 3))
    values.scalings[::2] = rng.uniform(-28, 28, (count // 2, 6))
    values.features[::2] = rng.uniform(-1100, 1100, (count // 2, d.features))
    masks = rng.random((count, d.offset_count)) < 0.7
    networks = splat.derive_rendering(scene.networks)
    floats = splat.splat(networks, *vars(values).values(), masks).view(np.uint32)
    rows: dict[str, list[Any]] = {name: [] for name in networks}
    for name, layer in ((name, layer) for name, network in networks.items() for layer in network.layers):
        rows[name].append([*zip(layer.weight.tolist(), layer.bias.tolist(), layer.exponent.tolist(), strict=True)])
    wanted: list[int] = []
    for n in range(count):
        bits = [getattr(values, kind)[n].reshape(-1).view(np.uint32).tolist() for kind in vars(values)]
        wanted += spec["SPLAT"](rows, *bits, masks[n].tolist())
    assert floats.reshape(-1).tolist() == wanted
    # The native kernel, where it is built.
    if (used := kernel()) is not None:
        drawn_by, (positions, *others) = np.zeros(floats.shape, np.float32), vars(values).values()
        layers = [(each.weight, each.bias, each.exponent) for name in RENDERING for each in networks[name].layers]
        splats(used, layers, [[positions, masks, *others]], [drawn_by[:, own] for own in splat.COLUMNS], None)
        assert drawn_by.tobytes() == floats.tobytes()


def test_the_exponential_is_near(spec: dict[str, Any]) -> None:
    t = np.arange(-splat.SCALING_BOUND, splat.SCALING_BOUND + 1, 9173)
    m, n = splat.exponential(t)
    assert [spec["EXPONENTIAL"](int(x)) for x in t[::50]] == list(zip(m[::50].tolist(), n[::50].tolist(), strict=True))
    assert np.abs(np.ldexp(m.astype(np.float64), n) / np.exp(t / 2.0**splat.SCALING_BITS) - 1).max() < 2.0**-26
    assert (m.min() >> 30, m.max() >> 30) == (1, 1)


def test_a_stream_of_chunks_has_the_same_digests() -> None:
    scene = codec.parse(static.of_degree(2)).scene
    stream = reconstruction.StreamDigest()
    for first in range(0, scene.anchor_count, 2):
        block = take_anchors(scene, slice(first, first + 2))
        stream.add(block)
    assert stream.finish_parts(scene) == reconstruction.digest(scene)
