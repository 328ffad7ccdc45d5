"""Bits of symbols under the distributions of SPEC.md A.3, with their gradients."""

import math
from typing import Any

import torch
from torch import Tensor

from ...bitstream.tables import SCALE_MIN
from .units import MEAN_UNIT, SCALE_MOST, SCALE_UNIT


class TorchBits(torch.autograd.Function):
    """TorchBits.apply(mean, scale, symbol, gauss, floor): -log2 of a probability, to which `floor` is added.

    mean, in 1/16 symbol, scale index, in 1/8 octave, and symbol have one shape, which is that of the result. gauss:
    for attributes (SPEC 7.7), not planes (SPEC 7.3). floor: see EntropySettings.
    """

    @staticmethod
    def forward(ctx: Any, mean: Tensor, scale: Tensor, symbol: Tensor, gauss: bool, floor: float) -> Tensor:
        deviation = torch.exp2(scale.clamp(SCALE_MIN, SCALE_MOST) / SCALE_UNIT)
        away = symbol - mean / MEAN_UNIT
        a = away.abs()
        t0, t1 = (a - 0.5) / deviation, (a + 0.5) / deviation
        tail = _gauss_tail if gauss else _laplace_tail
        p = tail(t0) - tail(t1)
        p = p.clamp_min(0) + floor
        ctx.save_for_backward(away, deviation, t0, t1, p, scale)
        ctx.gauss = gauss
        return -torch.log2(p)

    @staticmethod
    def backward(ctx: Any, *outputs: Tensor) -> tuple[Tensor | None, ...]:
        away, deviation, t0, t1, p, scale = ctx.saved_tensors
        if ctx.gauss:
            d0, d1 = (torch.exp(-t * t / 2) * (1 / math.sqrt(2 * math.pi)) for t in (t0, t1))
        else:
            d0, d1 = (torch.exp(-t.abs()) / 2 for t in (t0, t1))
        upstream = outputs[0] / p
        by_mean = upstream * torch.sign(away) * (d1 - d0) / deviation / (MEAN_UNIT * math.log(2))
        by_scale = upstream * (t1 * d1 - t0 * d0) / SCALE_UNIT
        # Past the table's smallest scale a gradient may lead back inside, no further out.
        by_scale = torch.where((scale <= SCALE_MIN) & (by_scale > 0), torch.zeros_like(by_scale), by_scale)
        symbol = -by_mean * MEAN_UNIT if ctx.needs_input_grad[2] else None
        return by_mean, by_scale, symbol, None, None


def _gauss_tail(t: Tensor) -> Tensor:
    """The share of a unit Gaussian distribution above t."""
    return torch.erfc(t * math.sqrt(0.5)) / 2


def _laplace_tail(t: Tensor) -> Tensor:
    """The share of a unit Laplace distribution above t."""
    tail = torch.exp(-t.abs()) / 2
    return torch.where(t >= 0, tail, 1 - tail)
