"""Integer networks by torch: the outputs, digests and errors of NumPy. A GPU is tested where there is one."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch

from conformance.manifest import Accepted, Rejected, load
from refcodec.bitstream.codec import parse
from refcodec.bitstream.errors import REGISTRY, BitstreamError
from refcodec.bitstream.networks import ACTIVATION_MAX, IntNetwork, derive_layer
from refcodec.bitstream.reconstruction import digest
from refcodec.train import exact_networks
from refcodec.train.exact_networks import DeviceNetwork, device_networks, products_are_exact

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
SUITE = load()
VECTORS = [v for v in SUITE.vectors if v.operation == "decode" and isinstance(v.expectation, Accepted)]
# Files with a row that keeps the bound at no exponent.
BROKEN = [
    v
    for v in SUITE.vectors
    if isinstance(v.expectation, Rejected) and v.expectation.code == REGISTRY["weights.bound"].code
]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("exact", [True, False])
def test_the_outputs_are_numpys(device: str, exact: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where float32 products are exact, and where they are not."""
    monkeypatch.setattr(exact_networks, "products_are_exact", lambda _: exact)
    rng = np.random.default_rng(0)
    shapes = [(37, 20), (20, 37), (11, 20)]
    layers = [
        derive_layer(rng.normal(0, 4, shape).astype(np.float32), rng.normal(0, 9, shape[0]).astype(np.float32))
        for shape in shapes
    ]
    inputs = rng.integers(-ACTIVATION_MAX, ACTIVATION_MAX + 1, (300, 20), np.int32)
    inputs[0], inputs[1] = ACTIVATION_MAX, -ACTIVATION_MAX
    network = IntNetwork(layers)
    other = DeviceNetwork(network, device)
    assert np.array_equal(other(inputs), network(inputs))
    found = other.forward(torch.from_numpy(inputs).to(device))
    assert (found.device.type, found.dtype) == (device, torch.int32)


@pytest.mark.parametrize("device", DEVICES)
def test_products_are_tested(device: str) -> None:
    assert products_are_exact(device)


@pytest.mark.slow
@pytest.mark.requirement("D9.3-1")
@pytest.mark.parametrize("device", DEVICES)
def test_the_digests_are_those_of_the_suite(device: str) -> None:
    derive = partial(device_networks, device=device)
    for vector in VECTORS:
        scene = parse(SUITE.path(vector).read_bytes(), derive=derive).scene
        assert isinstance(vector.expectation, Accepted)
        assert digest(scene)[0] == vector.expectation.digest, vector.id


def test_the_errors_are_those_of_the_suite() -> None:
    assert BROKEN
    for vector in BROKEN:
        with pytest.raises(BitstreamError) as caught:
            parse(SUITE.path(vector).read_bytes(), derive=partial(device_networks, device="cpu"))
        assert isinstance(vector.expectation, Rejected)
        assert caught.value.kind.code == vector.expectation.code
