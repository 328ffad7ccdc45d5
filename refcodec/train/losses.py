"""The image loss of training: L1 and 1 - SSIM, as in 3D Gaussian Splatting."""

from torch import Tensor

from .cpu.photometric import Photometric
from .device import has_kernel
from .ssim import ssim_torch


def photometric_torch(image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
    """The definition: (1 - ssim) L1 + ssim (1 - SSIM), a scalar, of two images, float32 [H, W, 3]."""
    return (1 - ssim) * (image - photograph).abs().mean() + ssim * (1 - ssim_torch(image, photograph))


def counted(image: Tensor, photograph: Tensor) -> tuple[Tensor, Tensor]:
    """Returns an image [H, W, 3] and a photograph (views.pixels), both black where the latter does not count."""
    return (image * photograph[..., 3:], photograph[..., :3]) if photograph.shape[2] > 3 else (image, photograph)


def squared_error(image: Tensor, photograph: Tensor) -> float:
    """The mean squared error of an image [H, W, 3] over the pixels of a photograph (views.pixels) that count."""
    one, other = counted(image, photograph)
    return float((one - other).square().mean() / (photograph[..., 3:].mean() if photograph.shape[2] > 3 else 1))


def photometric(image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
    """photometric_torch of what counts (views.pixels), in a kernel on CPUs. Only the image has a gradient."""
    image, photograph = counted(image, photograph)
    loss: Tensor = (Photometric.apply if has_kernel(image) else photometric_torch)(image, photograph, ssim)
    return loss
