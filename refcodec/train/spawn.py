"""From anchors and the outputs of the rendering networks to Gaussians (SPEC.md 9.4, 14.3, 14.6)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from ..render.harmonics import ZERO, degree_of, rest_harmonics
from .cpu.dispatch import has_kernel
from .cpu.spawn import Spawn

Gaussians = tuple[Tensor, Tensor, Tensor, Tensor]


def spawn_torch(
    chosen: Tensor, k: int, position: Tensor, offsets: Tensor, scalings: Tensor, covariance: Tensor, colour: Tensor
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
        colour: float32 [N, 3 k], network outputs.
    """
    count = len(position)
    assert position.shape == (count, 3)
    assert offsets.shape == colour.shape == (count, 3 * k)
    assert scalings.shape == (count, 6)
    assert covariance.shape == (count, 7 * k)
    anchor, spread = chosen // k, torch.exp(scalings)
    shape = covariance.reshape(-1, 7)[chosen]
    mean = position[anchor] + offsets.reshape(-1, 3)[chosen] * spread[anchor, :3]
    lengths = spread[anchor, 3:] * torch.sigmoid(shape[:, :3])
    return mean, shape[:, 3:], lengths, torch.sigmoid(colour.reshape(-1, 3)[chosen])


def spawn(
    chosen: Tensor, k: int, position: Tensor, offsets: Tensor, scalings: Tensor, covariance: Tensor, colour: Tensor
) -> Gaussians:
    """spawn_torch, in a kernel on CPUs. Positions have no gradient."""
    if has_kernel(position):
        gaussians: Gaussians = Spawn.apply(chosen, k, position, offsets, scalings, covariance, colour)
        return gaussians
    return spawn_torch(chosen, k, position, offsets, scalings, covariance, colour)


def spawn_static(
    chosen: Tensor,
    k: int,
    position: Tensor,
    offsets: Tensor,
    scalings: Tensor,
    covariance: Tensor,
    colour: Tensor,
    centre: Tensor,
) -> Gaussians:
    """SPEC 9.4 and 14.6 in floating point: as spawn_torch, for a static scene and a camera at `centre` [3].

    colour: float32 [N, 3 (degree + 1)^2 k]. The direction to a Gaussian has no gradient.
    """
    anchor, spread = chosen // k, torch.exp(scalings)
    shape = covariance.reshape(-1, 7)[chosen]
    mean = position[anchor] + offsets.reshape(-1, 3)[chosen] * spread[anchor, :3]
    lengths = torch.exp(scalings[anchor, 3:] + shape[:, :3])
    coefficients = colour.reshape(len(position) * k, -1, 3)[chosen]
    rgb = 0.5 + ZERO * coefficients[:, 0]
    if coefficients.shape[1] > 1:
        direction = functional.normalize(mean.detach() - centre, dim=1)
        values = rest_harmonics(direction.T, degree_of(coefficients.shape[1] - 1))
        rgb = rgb + torch.einsum("nc,ncx->nx", torch.stack(values, dim=1), coefficients[:, 1:])
    return mean, shape[:, 3:], lengths, rgb.clamp_min(0)
