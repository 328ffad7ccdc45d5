"""Drawing Gaussians as a function of torch's autograd: on the CPU with refcodec.rendering, on a GPU with gsplat."""

from __future__ import annotations

from typing import Any

import torch

from ..rendering.camera import Camera
from ..rendering.rasterise import Settings, rasterise, rasterise_backward
from .device import Drawn, check_one_device, draw_on_gpu


class Rasterise(torch.autograd.Function):
    """Rasterise.apply(mean, quaternion, scale, opacity, colour, camera, settings, screen).

    Returns image, transmittance and radius, which has no gradient. Shapes, units and errors are those of
    refcodec.rendering.rasterise.rasterise, whose arrays the results share. All tensors are on the CPU and are read as
    float32. settings may be None.

    screen, a tensor of shape [N] or None, takes no part in the image. Its gradient is Gradients.screen, so that
    screen.grad adds up densification's measure over the calls.
    """

    @staticmethod
    def forward(
        ctx: Any,
        mean: torch.Tensor,
        quaternion: torch.Tensor,
        scale: torch.Tensor,
        opacity: torch.Tensor,
        colour: torch.Tensor,
        camera: Camera,
        settings: Settings | None = None,
        screen: torch.Tensor | None = None,
    ) -> Drawn:
        inputs = (mean, quaternion, scale, opacity, colour)
        m, q, s, o, c = (v.detach().numpy() for v in inputs)
        rendering = rasterise(m, q, s, o, c, camera, settings)
        # Saved for torch's check that nobody changed them in place meanwhile; the rendering reads the same memory.
        ctx.save_for_backward(*inputs)
        ctx.rendering = rendering
        radius = torch.from_numpy(rendering.radius)
        ctx.mark_non_differentiable(radius)
        # The backward pass reads the transmittance, but not the image: only the first has to be safe from changes.
        return torch.from_numpy(rendering.image), torch.from_numpy(rendering.transmittance.copy()), radius

    @staticmethod
    def backward(
        ctx: Any, grad_image: torch.Tensor, grad_transmittance: torch.Tensor, _: torch.Tensor
    ) -> tuple[torch.Tensor | None, ...]:
        inputs = ctx.saved_tensors
        g = rasterise_backward(ctx.rendering, grad_image.numpy(), grad_transmittance.numpy())
        values = (g.mean, g.quaternion, g.scale, g.opacity, g.colour)
        gradients = tuple(torch.from_numpy(v).to(i.dtype) for v, i in zip(values, inputs, strict=True))
        screen = torch.from_numpy(g.screen) if ctx.needs_input_grad[7] else None
        return (*gradients, None, None, screen)


def draw(
    mean: torch.Tensor,
    quaternion: torch.Tensor,
    scale: torch.Tensor,
    opacity: torch.Tensor,
    colour: torch.Tensor,
    camera: Camera,
    settings: Settings | None = None,
    screen: torch.Tensor | None = None,
) -> Drawn:
    """Draws Gaussians on the tensors' device.

    Returns the image [H, W, 3] with the background, the transmittance [H, W] that reaches it, and radius [N] in pixels.
    Tensors on the CPU are drawn by Rasterise, which states shapes, units and what screen is, and those on a GPU by
    device.draw_on_gpu, which states how its images differ.

    Raises ValueError for tensors on different devices or on one that is neither, and as Rasterise does.
    """
    kind = check_one_device(mean, quaternion, scale, opacity, colour, *([] if screen is None else [screen]))
    if kind == "cpu":
        drawn: Drawn = Rasterise.apply(mean, quaternion, scale, opacity, colour, camera, settings, screen)
        return drawn
    return draw_on_gpu(mean, quaternion, scale, opacity, colour, camera, settings or Settings(), screen)
