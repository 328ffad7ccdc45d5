"""From anchors and the outputs of the rendering networks to Gaussians (SPEC.md 9.4, 14.3, 14.6)."""

from typing import Any

import torch
from torch import Tensor

from .cpu.spawn import Spawn
from .device import has_kernel
from .harmonics import harmonics_torch

Gaussians = tuple[Tensor, Tensor, Tensor, Tensor]


def spawn_torch(
    chosen: Tensor,
    k: int,
    position: Tensor,
    offsets: Tensor,
    scalings: Tensor,
    covariance: Tensor,
    colour: Tensor,
    centre: Tensor | None = None,
) -> Gaussians:
    """The Gaussians of some offsets: mean [n, 3], quaternion [n, 4], lengths [n, 3] and rgb [n, 3], float32.

    Quaternions keep the length that the network gives them.

    Args:
        chosen: int64 [n], ascending, anchor * k + offset.
        k: offsets of an anchor.
        position: float32 [N, 3].
        offsets: float32 [N, 3 k], in units of exp(scalings[:, :3]).
        scalings: float32 [N, 6], natural logarithms.
        covariance: float32 [N, 7 k], network outputs: three lengths and a quaternion for each offset.
        colour: float32 [N, colour_outputs k], network outputs.
        centre: float32 [3], of the camera of a static scene; None for a view-dependent scene. The direction to a
            Gaussian has no gradient.
    """
    count = len(position)
    assert position.shape == (count, 3)
    assert offsets.shape == (count, 3 * k)
    assert scalings.shape == (count, 6)
    assert covariance.shape == (count, 7 * k)
    anchor, spread = chosen // k, torch.exp(scalings)
    shape = covariance.reshape(-1, 7)[chosen]
    mean = position[anchor] + offsets.reshape(-1, 3)[chosen] * spread[anchor, :3]
    coefficients = colour.reshape(count * k, -1, 3)[chosen]
    if centre is None:
        lengths = spread[anchor, 3:] * torch.sigmoid(shape[:, :3])
        return mean, shape[:, 3:], lengths, torch.sigmoid(coefficients[:, 0])
    basis = harmonics_torch(mean.detach() - centre, coefficients.shape[1])
    rgb = (0.5 + torch.einsum("nc,ncx->nx", basis, coefficients)).clamp_min(0)
    return mean, shape[:, 3:], torch.exp(scalings[anchor, 3:] + shape[:, :3]), rgb


def spawn(chosen: Tensor, k: int, position: Tensor, *arrays: Tensor | None) -> Gaussians:
    """spawn_torch, in a kernel on CPUs. Positions have no gradient."""
    make: Any = Spawn.apply if has_kernel(position) else spawn_torch
    gaussians: Gaussians = make(chosen, k, position, *arrays)
    return gaussians
