"""All that differs between training on the CPU and on an NVIDIA GPU. The rest of the package asks these functions.

On the CPU, kernels compute in place of definitions in torch (has_kernel), refcodec.rendering draws, and all random
numbers come from one generator. On a GPU the definitions run, gsplat draws, and noise has a generator of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..rendering.camera import Camera, check_camera

if TYPE_CHECKING:
    from ..rendering.rasterise import Settings

# Mean, quaternion, lengths, opacity and colour of some Gaussians.
Gaussians = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]
# An image, the transmittance that reaches the background, and radii in pixels.
Drawn = tuple[Tensor, Tensor, Tensor]


def training_device(name: str) -> torch.device:
    """The device of a training run. name: `cpu` or `cuda`. Raises ValueError without a GPU."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("there is no CUDA device")
    return torch.device(name)


def noise_generator(device: torch.device, random: torch.Generator, seed: int) -> torch.Generator:
    """The generator of noise on a device. random: that of the training, on the CPU, which is returned for the CPU."""
    return random if device.type == "cpu" else torch.Generator(device).manual_seed(seed)


def has_kernel(tensor: Tensor) -> bool:
    """Whether kernels of refcodec.train.cpu compute with a tensor: float32 on the CPU.

    Float64 tensors have no kernels, which lets tests compare both.
    """
    return tensor.device.type == "cpu" and tensor.element_size() == 4


def check_one_device(*tensors: Tensor) -> str:
    """The kind of device that all tensors are on: `cpu` or `cuda`. Raises ValueError for any other tensors."""
    devices = {tensor.device for tensor in tensors}
    kind = tensors[0].device.type
    if len(devices) > 1 or kind not in ("cpu", "cuda"):
        raise ValueError(
            f"the tensors are on {', '.join(sorted(map(str, devices)))}, but must all be on the CPU or on one GPU"
        )
    return kind


def draw_on_gpu(gaussians: Gaussians, camera: Camera, settings: Settings, screen: Tensor | None) -> Drawn:
    """splat.draw by gsplat 1.5.3, which is compiled for the GPU when it is first imported.

    Shapes and units are those of splat.draw. The image is that of refcodec.rendering except for these constants:

    - alpha_max is 0.999, regardless of the settings.
    - Projection is float32. Depths that are equal in float32 count as equal. Gaussians exactly at near_plane are
      drawn, those beyond a depth of 1e10 are not. Non-finite values are not detected.
    - A Gaussian ends a pixel if it would leave a transmittance of 1e-4 or less, not only if less.
    - radius is the larger half side, rounded up, of the box around the ellipse. On the CPU it is its larger half axis.
    - Gradients of many pixels are added in any order, so that the last bits differ from run to run.

    Raises ModuleNotFoundError without the extra `cuda`, and ValueError as refcodec.rendering does for a camera.
    """
    import gsplat  # noqa: PLC0415

    check_camera(camera)
    device, view, lens = gaussians[0].device, torch.eye(4), torch.eye(3)
    view[:3, :3], view[:3, 3] = torch.from_numpy(camera.rotation), torch.from_numpy(camera.translation)
    lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    image, covered, info = gsplat.rasterization(
        *(values.float() for values in gaussians),
        view[None].to(device),
        lens[None].to(device),
        camera.width,
        camera.height,
        near_plane=settings.near_plane,
        eps2d=settings.low_pass,
        packed=False,
        backgrounds=torch.tensor([settings.background], device=device),
        rasterize_mode="classic",
    )
    place = info["means2d"]
    if screen is not None and screen.requires_grad and place.requires_grad:
        # As Gradients.screen: in an image that is 2 wide and 2 high.
        half = torch.tensor([camera.width / 2, camera.height / 2], device=device)

        def add(gradient: Tensor) -> None:
            length = torch.linalg.vector_norm(gradient[0] * half, dim=-1).to(screen.dtype)
            screen.grad = length if screen.grad is None else screen.grad + length

        place.register_hook(add)
    return image[0], 1 - covered[0, ..., 0], info["radii"][0].amax(dim=-1).float()
