"""How far an image is from a photograph, in training: L1 and 1 - SSIM (3D Gaussian Splatting), with the gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from .ssim import similarity, similarity_anywhere, similarity_backward


class Photometric(torch.autograd.Function):
    """Photometric.apply(image, photograph, ssim) -> loss, a scalar: (1 - ssim) L1 + ssim (1 - SSIM).

    Both images are float32 [H, W, 3] on the CPU. Only the first has a gradient.
    """

    @staticmethod
    def forward(ctx: Any, image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
        ctx.similarity, ctx.ssim = similarity(image.detach().numpy(), photograph.numpy()), ssim
        away = image - photograph
        ctx.save_for_backward(away)
        return (1 - ssim) * away.abs().mean() + ssim * (1 - ctx.similarity.value)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, None, None]:
        (away,) = ctx.saved_tensors
        gradient = torch.sign(away).mul_((1 - ctx.ssim) / away.numel())
        gradient -= torch.from_numpy(similarity_backward(ctx.similarity, ctx.ssim))
        return gradient * upstream[0], None, None


def photometric(image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
    """Photometric.apply on the CPU. On any other device the same with torch, differentiated by autograd."""
    if image.device.type == "cpu":
        loss: Tensor = Photometric.apply(image, photograph, ssim)
        return loss
    return photometric_anywhere(image, photograph, ssim)


def photometric_anywhere(image: Tensor, photograph: Tensor, ssim: float) -> Tensor:
    """What Photometric takes, with torch on the device of the images."""
    return (1 - ssim) * (image - photograph).abs().mean() + ssim * (1 - similarity_anywhere(image, photograph))
