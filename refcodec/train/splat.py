"""Drawing Gaussians as a function of torch's autograd: on the CPU with refcodec.rendering, on a GPU with gsplat."""

from typing import Any

import torch

from ..rendering.camera import Camera
from ..rendering.rasterise import Settings, rasterise, rasterise_backward
from .device import Drawn, Gaussians, check_one_device, draw_on_gpu


class Rasterise(torch.autograd.Function):
    """Rasterise.apply(camera, settings, screen, mean, quaternion, scale, opacity, colour).

    Returns image, transmittance and radius, which has no gradient. Shapes, units and errors are those of
    refcodec.rendering.rasterise.rasterise, whose arrays the results share. All tensors are on the CPU and are read as
    float32. settings may be None.

    screen, a tensor of shape [N] or None, takes no part in the image. Its gradient is Gradients.screen, so that
    screen.grad adds up densification's measure over the calls.
    """

    @staticmethod
    def forward(
        ctx: Any, camera: Camera, settings: Settings | None, screen: torch.Tensor | None, *gaussians: torch.Tensor
    ) -> Drawn:
        mean, quaternion, scale, opacity, colour = (v.detach().numpy() for v in gaussians)
        rendering = rasterise(mean, quaternion, scale, opacity, colour, camera, settings)
        # Saved for torch's check that nobody changed them in place meanwhile; the rendering reads the same memory.
        ctx.save_for_backward(*gaussians)
        ctx.rendering = rendering
        radius = torch.from_numpy(rendering.radius)
        ctx.mark_non_differentiable(radius)
        # The backward pass reads the transmittance, but not the image: only the first has to be safe from changes.
        return torch.from_numpy(rendering.image), torch.from_numpy(rendering.transmittance.copy()), radius

    @staticmethod
    def backward(
        ctx: Any, grad_image: torch.Tensor, grad_transmittance: torch.Tensor, _: torch.Tensor
    ) -> tuple[torch.Tensor | None, ...]:
        g = rasterise_backward(ctx.rendering, grad_image.numpy(), grad_transmittance.numpy())
        values = (g.mean, g.quaternion, g.scale, g.opacity, g.colour)
        gradients = (torch.from_numpy(v).to(i.dtype) for v, i in zip(values, ctx.saved_tensors, strict=True))
        return None, None, torch.from_numpy(g.screen) if ctx.needs_input_grad[2] else None, *gradients


def draw(
    gaussians: Gaussians, camera: Camera, settings: Settings | None = None, screen: torch.Tensor | None = None
) -> Drawn:
    """Draws Gaussians on the tensors' device.

    Returns the image [H, W, 3] with the background, the transmittance [H, W] that reaches it, and radius [N] in pixels.
    Tensors on the CPU are drawn by Rasterise, which states shapes, units and what screen is, and those on a GPU by
    device.draw_on_gpu, which states how its images differ.

    Raises ValueError for tensors on different devices or on one that is neither, and as Rasterise does.
    """
    if check_one_device(*gaussians, *([] if screen is None else [screen])) == "cpu":
        drawn: Drawn = Rasterise.apply(camera, settings, screen, *gaussians)
        return drawn
    return draw_on_gpu(gaussians, camera, settings or Settings(), screen)
