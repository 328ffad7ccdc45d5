"""How far an image is from a photograph, in training: 3D Gaussian Splatting's 0.8 L1 + 0.2 (1 - SSIM), with its gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from .ssim import similarity, similarity_backward

SSIM_SHARE = 0.2


class Photometric(torch.autograd.Function):
    """Photometric.apply(image, photograph) -> loss, a scalar; both float32 [H, W, 3] on the CPU. Only the image has a gradient."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, photograph: Tensor) -> Tensor:
        ctx.similarity = similarity(image.detach().numpy(), photograph.numpy())
        away = image - photograph
        ctx.save_for_backward(away)
        return (1 - SSIM_SHARE) * away.abs().mean() + SSIM_SHARE * (1 - ctx.similarity.value)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, None]:
        (away,) = ctx.saved_tensors
        gradient = torch.sign(away).mul_((1 - SSIM_SHARE) / away.numel())
        gradient -= torch.from_numpy(similarity_backward(ctx.similarity, SSIM_SHARE))
        return gradient * upstream[0], None
