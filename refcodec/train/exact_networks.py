"""Clause 7.2 by torch: integer networks for activations that are on a GPU.

Their outputs are those of refcodec.bitstream.networks, bit by bit, on any device: no partial sum reaches 2^24, so each
order of summation gives the same integers.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..bitstream.conventions import F32
from ..bitstream.networks import ACTIVATION_MAX, IntNetwork, Layer, derive_networks, is_exact


class DeviceNetwork(IntNetwork):
    """SPEC 7.2, NETWORK, on a device of torch."""

    def __init__(self, network: IntNetwork, device: str) -> None:
        """device: such as `cuda`. Its products are tested at the first use. float64 is used if they are not exact."""
        super().__init__(network.layers)
        self.device = device
        kind = torch.float32 if products_are_exact(device) else torch.float64
        self._layers = [
            tuple(torch.from_numpy(array).to(device, kind) for array in layer) for layer in self.float_layers()
        ]

    def forward(self, inputs: Tensor) -> Tensor:
        """Returns the outputs, int32 [rows, out], on the device. inputs: integers [rows, in], in [-1023, 1023]."""
        x = inputs.to(self._layers[0][0].dtype)
        for i, (weight, bias, unit) in enumerate(self._layers):
            x = torch.floor((x @ weight + bias) * unit)
            if i + 1 < len(self._layers):
                x = x.clamp(0, ACTIVATION_MAX)
        return x.to(torch.int32)

    def __call__(self, inputs: NDArray[np.signedinteger]) -> NDArray[np.int32]:
        """As IntNetwork: arrays of NumPy go to the device and come back."""
        given = torch.from_numpy(np.ascontiguousarray(inputs, np.int32)).to(self.device)
        return self.forward(given).cpu().numpy()


@cache
def products_are_exact(device: str) -> bool:
    """SPEC 13.3: whether float32 products of a device are exact."""

    def product(a: F32, w: F32) -> F32:
        sums: F32 = (torch.from_numpy(a).to(device) @ torch.from_numpy(w).to(device)).cpu().numpy()
        return sums

    return is_exact(product)


def device_networks(networks: Mapping[str, list[Layer]], device: str) -> dict[str, IntNetwork]:
    """SPEC 7.2: as derive_networks, on a device. `parse` and `Reader` take it, with its device, as `derive`."""
    return {name: DeviceNetwork(network, device) for name, network in derive_networks(networks).items()}
