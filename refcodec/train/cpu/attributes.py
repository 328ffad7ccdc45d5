"""Bits of attributes (SPEC.md 7.7 to 7.9), from F_h's last layer and CARM: the kernel of RateModel.attribute_bits."""

from typing import Any, NamedTuple

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...bitstream.tables import SCALE_MIN
from ...rendering.compiled import compiled
from ..rate_model.units import MEAN_UNIT
from .layers import Plan, layer_backward, layer_forward
from .likelihood import array, likelihood

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

_ZERO, _ONE, _LOW = np.float32(0), np.float32(1), np.float32(SCALE_MIN)


@compiled(parallel=True)
def _gather(out: F32, change: F32, columns: I64, width: int) -> Any:
    """Means and scales [n, D] of F_h's outputs [n, 2 D] and CARM's changes. columns [2, D]: in change, or -1."""
    mean, scale = np.empty((out.shape[0], width), np.float32), np.empty((out.shape[0], width), np.float32)
    for r in prange(out.shape[0]):
        for d in range(width):
            mean[r, d], scale[r, d] = out[r, d], out[r, width + d]
            if columns[0, d] >= 0:
                mean[r, d] += change[r, columns[0, d]]
                scale[r, d] += change[r, columns[1, d]]
    return mean, scale


@compiled(inline="always")
def _dropped(kept: F32, r: int, but: int) -> np.float32:
    """The product of one minus the mask over an anchor's offsets, except one of them."""
    product = _ONE
    for k in range(kept.shape[1]):
        if k != but:
            product *= _ONE - kept[r, k]
    return product


@compiled(parallel=True)
def _sums(bits: F32, kept: F32, features: int) -> Any:
    """Bits of features, scalings and offsets [n, 3], and those of each part without its mask: [n, 2 + K]."""
    offsets = kept.shape[1]
    begin = bits.shape[1] - 3 * offsets
    sums = np.empty((bits.shape[0], 3), np.float32)
    parts = np.zeros((bits.shape[0], 2 + offsets), np.float32)
    for r in prange(bits.shape[0]):
        for d in range(bits.shape[1]):
            part = 0 if d < features else (1 if d < begin else 2 + (d - begin) // 3)
            parts[r, part] += bits[r, d]
        some = _ONE - _dropped(kept, r, -1)
        sums[r, 0], sums[r, 1], sums[r, 2] = parts[r, 0] * some, parts[r, 1] * some, _ZERO
        for k in range(offsets):
            sums[r, 2] += parts[r, 2 + k] * kept[r, k]
    return sums, parts


@compiled(parallel=True)
def _sums_backward(upstream: F32, given: Any) -> Any:
    """Gradients of F_h's outputs, of CARM's changes [n, more], of symbols and of masks. given: of the forward pass."""
    parts, kept, features, scale, by_mean, by_scale, columns, more = given
    offsets, width = kept.shape[1], scale.shape[1]
    begin = width - 3 * offsets
    out, change = np.empty((scale.shape[0], 2 * width), np.float32), np.empty((scale.shape[0], more), np.float32)
    symbols, masks = np.empty(scale.shape, np.float32), np.empty(kept.shape, np.float32)
    for r in prange(scale.shape[0]):
        some = _ONE - _dropped(kept, r, -1)
        for d in range(width):
            weight = (
                upstream[r, 2] * kept[r, (d - begin) // 3] if d >= begin else upstream[r, int(d >= features)] * some
            )
            along, wider = weight * by_mean[r, d], weight * by_scale[r, d]
            # Past the table's smallest scale a gradient may lead back inside, no further out.
            if scale[r, d] <= _LOW and wider > 0:
                wider = _ZERO
            out[r, d], out[r, width + d] = along, wider
            symbols[r, d] = -along * np.float32(MEAN_UNIT)
            if columns[0, d] >= 0:
                change[r, columns[0, d]], change[r, columns[1, d]] = along, wider
        shared = upstream[r, 0] * parts[r, 0] + upstream[r, 1] * parts[r, 1]
        for k in range(offsets):
            masks[r, k] = upstream[r, 2] * parts[r, 2 + k] + shared * _dropped(kept, r, k)
    return out, change, symbols, masks


class Counting(NamedTuple):
    """The inputs of attribute_bits besides the values.

    rows: of F_h's last layer, which make means and scales. hyper: that layer. carm: the layers of each network of CARM.
    columns: int64 [2, D], those of CARM's outputs that each mean and scale adds, or -1. features: their number. floor:
    see EntropySettings.
    """

    rows: slice
    hyper: Plan
    carm: list[list[Plan]]
    columns: I64
    features: int
    floor: float


class AttributeBits(torch.autograd.Function):
    """AttributeBits.apply(counting, hidden, symbols, earlier, kept, *parameters) -> float32 [n, 3].

    It is RateModel.attribute_bits. hidden [n, .]. symbols [n, D]. kept [n, K]. earlier [n, .]: CARM's inputs. They have
    no gradient: the symbols have it where the two are the same. parameters: weights and biases of F_h's last layer,
    then those of CARM's layers.
    """

    @staticmethod
    def forward(
        ctx: Any,
        counting: Counting,
        hidden: Tensor,
        symbols: Tensor,
        earlier: Tensor,
        kept: Tensor,
        *parameters: Tensor,
    ) -> Tensor:
        weight, bias, *rest = parameters
        out, ctx.hyper = layer_forward(counting.hyper, hidden, weight[counting.rows], bias[counting.rows])
        ctx.carm, changes, layers = [], [], iter(rest)
        for plans in counting.carm:
            x, traces = earlier[:, : len(plans[0].before)], []
            for plan in plans:
                x, trace = layer_forward(plan, x, next(layers), next(layers))
                traces.append(trace)
            ctx.carm.append(traces)
            changes.append(x)
        # Without a second slice there is no CARM.
        change, masks = torch.cat([out.new_zeros(len(out), 0), *changes], dim=1), array(kept)
        mean, scale = _gather(array(out), array(change), counting.columns, symbols.shape[1])
        bits, by_mean, by_scale = likelihood(mean, scale, array(symbols), counting.floor)
        sums, parts = _sums(bits, masks, counting.features)
        ctx.given = parts, masks, counting.features, scale, by_mean, by_scale, counting.columns, change.shape[1]
        ctx.counting, ctx.inputs = counting, (symbols.detach(), earlier)
        ctx.shapes = weight.shape, bias.shape
        return torch.from_numpy(sums)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        out, change, by_symbols, by_kept = (torch.from_numpy(g) for g in _sums_backward(array(upstream[0]), ctx.given))
        hidden, *some = layer_backward(ctx.hyper, out, ctx.needs_input_grad[1])
        gradients = [torch.zeros(shape) for shape in ctx.shapes]
        for whole, part in zip(gradients, some, strict=True):
            whole[ctx.counting.rows] = part
        symbols, earlier = ctx.inputs
        same = (symbols[:, : earlier.shape[1]] == earlier).float() if ctx.needs_input_grad[2] else None
        at = 0
        for traces in ctx.carm:
            outputs = len(traces[-1].plan.after)
            along = change[:, at : at + outputs]
            by_carm: list[Tensor] = []
            for i in reversed(range(len(traces))):
                inputs, *own = layer_backward(traces[i], along, i > 0 or same is not None)
                by_carm[:0] = own
                if inputs is not None:
                    along = inputs
            if same is not None:
                by_symbols[:, : along.shape[1]].addcmul_(along, same[:, : along.shape[1]])
            gradients += by_carm
            at += outputs
        return None, hidden, by_symbols, None, by_kept, *gradients
