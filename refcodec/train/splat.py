"""Drawing Gaussians as a function of torch's autograd: on the CPU with refcodec.rendering, on a GPU with gsplat."""

from __future__ import annotations

from typing import Any

import torch

from ..rendering.camera import Camera, check_camera
from ..rendering.rasterise import Settings, rasterise, rasterise_backward

Drawn = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


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
    Tensors on the CPU are drawn by Rasterise, which states shapes, units and what screen is. Tensors on a GPU are drawn
    by gsplat 1.5.3, which is imported then (ModuleNotFoundError without the extra `cuda`). The two draw the same image
    except for these constants of gsplat:

    - alpha_max is 0.999, regardless of the settings.
    - Projection is float32. Depths that are equal in float32 count as equal. Gaussians exactly at near_plane are
      drawn, those beyond a depth of 1e10 are not. Non-finite values are not detected.
    - A Gaussian ends a pixel if it would leave a transmittance of 1e-4 or less, not only if less.
    - radius is the larger half side, rounded up, of the box around the ellipse. Rasterise gives its larger half axis.
    - Gradients of many pixels are added in any order, so that the last bits differ from run to run.

    Raises ValueError for tensors on different devices or on one that is neither, and as Rasterise does.
    """
    tensors = (
        (mean, quaternion, scale, opacity, colour)
        if screen is None
        else (mean, quaternion, scale, opacity, colour, screen)
    )
    devices = {tensor.device for tensor in tensors}
    kind = mean.device.type
    if len(devices) > 1 or kind not in ("cpu", "cuda"):
        raise ValueError(
            f"the tensors are on {', '.join(sorted(map(str, devices)))}, but must all be on the CPU or on one GPU"
        )
    if kind == "cpu":
        drawn: Drawn = Rasterise.apply(mean, quaternion, scale, opacity, colour, camera, settings, screen)
        return drawn
    return _draw_on_gpu(mean, quaternion, scale, opacity, colour, camera, settings or Settings(), screen)


def _draw_on_gpu(
    mean: torch.Tensor,
    quaternion: torch.Tensor,
    scale: torch.Tensor,
    opacity: torch.Tensor,
    colour: torch.Tensor,
    camera: Camera,
    settings: Settings,
    screen: torch.Tensor | None,
) -> Drawn:
    # Compiles for a GPU when it is imported; nothing but this needs it.
    import gsplat  # noqa: PLC0415

    check_camera(camera)
    view, lens = torch.eye(4), torch.eye(3)
    view[:3, :3], view[:3, 3] = torch.from_numpy(camera.rotation), torch.from_numpy(camera.translation)
    lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    image, covered, info = gsplat.rasterization(
        mean.float(),
        quaternion.float(),
        scale.float(),
        opacity.float(),
        colour.float(),
        view[None].to(mean.device),
        lens[None].to(mean.device),
        camera.width,
        camera.height,
        near_plane=settings.near_plane,
        eps2d=settings.low_pass,
        packed=False,
        backgrounds=torch.tensor([settings.background], device=mean.device),
        rasterize_mode="classic",
    )
    place = info["means2d"]
    if screen is not None and screen.requires_grad and place.requires_grad:
        # As Gradients.screen: in an image that is 2 wide and 2 high.
        half = torch.tensor([camera.width / 2, camera.height / 2], device=mean.device)

        def add(gradient: torch.Tensor) -> None:
            length = torch.linalg.vector_norm(gradient[0] * half, dim=-1).to(screen.dtype)
            screen.grad = length if screen.grad is None else screen.grad + length

        place.register_hook(add)
    return image[0], 1 - covered[0, ..., 0], info["radii"][0].amax(dim=-1).float()
