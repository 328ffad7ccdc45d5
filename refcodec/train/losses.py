"""The image loss of training: L1 and 1 - SSIM, as in 3D Gaussian Splatting."""

from __future__ import annotations

from torch import Tensor

from .cpu.photometric import Photometric
from .device import has_kernel
from .ssim import ssim_torch


def photometric_torch(image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
    """The definition: (1 - ssim) L1 + ssim (1 - SSIM), a scalar, of two images, float32 [H, W, 3]."""
    return (1 - ssim) * (image - photograph).abs().mean() + ssim * (1 - ssim_torch(image, photograph))


def photometric(image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
    """photometric_torch, in a kernel on CPUs. Only the image has a gradient."""
    loss: Tensor = (Photometric.apply if has_kernel(image) else photometric_torch)(image, photograph, ssim)
    return loss
