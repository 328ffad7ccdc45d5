"""Bits of all plane symbols (SPEC.md 7.3) with their gradients in one pass: the kernel of RateModel.plane_bits.

A plane is a row of numbers with a border of zeros: the contexts of 32 consecutive symbols are consecutive, too. SARM
and its gradient stay in the cache. Each plane sums its own gradients in one order, and no result depends on the number
of threads.
"""

from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from ...bitstream.networks import ACTIVATION_MAX
from ...bitstream.tables import SCALE_MIN
from ...rendering.compiled import compiled
from ...rendering.simd import WIDTH, fma, load, maximum, minimum, round_down, select, splat, store
from ..rate_model.units import MEAN_UNIT
from .layers import Plan, fold, unfold
from .likelihood import array, one_likelihood

F32 = NDArray[np.float32]

# Symbols that are taken at once: four lanes, whose sums do not wait for each other.
_BLOCK = 4 * WIDTH
_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)
_MOST, _LOW, _PER_SYMBOL = np.float32(ACTIVATION_MAX), np.float32(SCALE_MIN), np.float32(-MEAN_UNIT)


@compiled()
def _room(rows: int) -> F32:
    return np.empty((rows, _BLOCK), np.float32)


@compiled()
def _sums(weight: F32, bias: F32, x: F32, to: F32) -> None:
    """A layer's sums [out, 32] of x [in, 32]."""
    for o in range(weight.shape[0]):
        s0 = s1 = s2 = s3 = splat(bias[o])
        for i in range(weight.shape[1]):
            w, at = splat(weight[o, i]), i * _BLOCK
            s0, s1 = fma(w, load(x, at), s0), fma(w, load(x, at + WIDTH), s1)
            s2, s3 = fma(w, load(x, at + 2 * WIDTH), s2), fma(w, load(x, at + 3 * WIDTH), s3)
        at = o * _BLOCK
        store(to, at, s0)
        store(to, at + WIDTH, s1)
        store(to, at + 2 * WIDTH, s2)
        store(to, at + 3 * WIDTH, s3)


@compiled()
def _rectify(values: F32, inside: F32, rounding: bool) -> None:
    """Turns sums into activations. inside: 1 where they have a gradient, else 0."""
    zero, one, half, most = splat(_ZERO), splat(_ONE), splat(_HALF), splat(_MOST)
    for at in range(0, values.size, WIDTH):
        value = load(values, at)
        if rounding:
            store(inside, at, select((zero < value) & (value <= most), one, zero))
            store(values, at, round_down(minimum(maximum(value, zero), most) + half))
        else:
            store(inside, at, select(zero < value, one, zero))
            store(values, at, maximum(value, zero))


@compiled()
def _inputs_gradient(weight: F32, upstream: F32, inside: F32, to: F32) -> None:
    """Gradients of a layer's inputs [in, 32], by those of its sums [out, 32], where they are inside."""
    for i in range(weight.shape[1]):
        s0 = s1 = s2 = s3 = splat(_ZERO)
        for o in range(weight.shape[0]):
            w, at = splat(weight[o, i]), o * _BLOCK
            s0, s1 = fma(w, load(upstream, at), s0), fma(w, load(upstream, at + WIDTH), s1)
            s2, s3 = fma(w, load(upstream, at + 2 * WIDTH), s2), fma(w, load(upstream, at + 3 * WIDTH), s3)
        at = i * _BLOCK
        store(to, at, s0 * load(inside, at))
        store(to, at + WIDTH, s1 * load(inside, at + WIDTH))
        store(to, at + 2 * WIDTH, s2 * load(inside, at + 2 * WIDTH))
        store(to, at + 3 * WIDTH, s3 * load(inside, at + 3 * WIDTH))


@compiled()
def _add_gradients(upstream: F32, x: F32, inputs: int, outputs: int, to: F32) -> None:
    """Adds gradients of weights and biases, eight parts of each: to [out, in + 1, 8], the bias last."""
    for o in range(outputs):
        at, here = o * _BLOCK, o * (inputs + 1) * WIDTH
        u0, u1 = load(upstream, at), load(upstream, at + WIDTH)
        u2, u3 = load(upstream, at + 2 * WIDTH), load(upstream, at + 3 * WIDTH)
        for i in range(inputs):
            at = i * _BLOCK
            s = fma(u0, load(x, at), fma(u1, load(x, at + WIDTH), load(to, here)))
            store(to, here, fma(u2, load(x, at + 2 * WIDTH), fma(u3, load(x, at + 3 * WIDTH), s)))
            here += WIDTH
        store(to, here, load(to, here) + ((u0 + u1) + (u2 + u3)))


@compiled(parallel=True)
def _plane_bits(
    symbols: F32, weights: Any, biases: Any, rounding: bool, floor: np.float32, gradient: F32, by_layer: Any
) -> F32:
    """Probabilities of the symbols [planes, B, B], and ones beside.

    weights, biases: tuples, of SARM's three layers. Sets gradients of the bits' sum: gradient [planes, B, B], and those
    of each layer, [planes, out, in + 1, 8], as _add_gradients.
    """
    (w0, w1, w2), (b0, b1, b2), (g0, g1, g2) = weights, biases, by_layer
    planes, size = symbols.shape[0], symbols.shape[1]
    # A plane with its border, row by row: one row above, and one number at either side of each row.
    stride = size + 2
    begin, count = stride + 1, (size * stride + _BLOCK - 1) // _BLOCK * _BLOCK
    valid = np.zeros(count, np.float32)
    for i in range(size):
        valid[i * stride : i * stride + size] = _ONE
    chances = np.empty((planes, count), np.float32)
    ways = (-stride - 1, -stride, -stride + 1, -1)
    for p in prange(planes):
        plane, by_plane = np.zeros(begin + count, np.float32), np.zeros(begin + count, np.float32)
        for i in range(size):
            at = begin + i * stride
            plane[at : at + size] = symbols[p, i]
        # Values, where they have gradients, and their gradients.
        x, in_x, by_x = _room(w0.shape[1]), _room(w0.shape[1]), _room(w0.shape[1])
        h0, in_0, by_0 = _room(w0.shape[0]), _room(w0.shape[0]), _room(w0.shape[0])
        h1, in_1, by_1 = _room(w1.shape[0]), _room(w1.shape[0]), _room(w1.shape[0])
        out, by_out = _room(w2.shape[0]), _room(w2.shape[0])
        zero, one, most = splat(_ZERO), splat(_ONE), splat(_MOST)
        for block in range(0, count, _BLOCK):
            for c in range(4):
                for t in range(0, _BLOCK, WIDTH):
                    value = load(plane, begin + block + t + ways[c])
                    cut = minimum(maximum(value, zero - most), most)
                    store(x, c * _BLOCK + t, cut)
                    store(in_x, c * _BLOCK + t, select((cut <= value) & (value <= cut), one, zero))
            _sums(w0, b0, x, h0)
            _rectify(h0, in_0, rounding)
            _sums(w1, b1, h0, h1)
            _rectify(h1, in_1, rounding)
            _sums(w2, b2, h1, out)
            for t in range(0, _BLOCK, WIDTH):
                at, exists = begin + block + t, load(valid, block + t)
                scale = load(out, _BLOCK + t)
                chance, along, wider = one_likelihood(load(out, t), scale, load(plane, at), False, floor)
                along, wider = along * exists, wider * exists
                # Past the table's smallest scale a gradient may lead back inside, no further out.
                wider = select((scale <= splat(_LOW)) & (zero < wider), zero, wider)
                store(chances, p * count + block + t, select(zero < exists, chance, one))
                store(by_out, t, along)
                store(by_out, _BLOCK + t, wider)
                store(by_plane, at, fma(along, splat(_PER_SYMBOL), load(by_plane, at)))
            _add_gradients(by_out, h1, w2.shape[1], w2.shape[0], g2[p])
            _inputs_gradient(w2, by_out, in_1, by_1)
            _add_gradients(by_1, h0, w1.shape[1], w1.shape[0], g1[p])
            _inputs_gradient(w1, by_1, in_0, by_0)
            _add_gradients(by_0, x, w0.shape[1], w0.shape[0], g0[p])
            _inputs_gradient(w0, by_0, in_x, by_x)
            for c in range(4):
                for t in range(0, _BLOCK, WIDTH):
                    at = begin + block + t + ways[c]
                    store(by_plane, at, load(by_plane, at) + load(by_x, c * _BLOCK + t))
        for i in range(size):
            at = begin + i * stride
            gradient[p, i] = by_plane[at : at + size]
    return chances


class PlaneBits(torch.autograd.Function):
    """PlaneBits.apply(plans, symbols, floor, *parameters) -> bits of all symbols, RateModel.plane_bits.

    plans: of SARM's three layers. symbols: float32 [planes, ch, B, B]. floor: see EntropySettings. parameters: weights
    and biases of each layer. The bits are part of a loss, thus their factor is not negative.
    """

    @staticmethod
    def forward(ctx: Any, plans: list[Plan], symbols: Tensor, floor: float, *parameters: Tensor) -> Tensor:
        pairs = list(zip(parameters[::2], parameters[1::2], strict=True))
        folded = [fold(array(w), array(b), *plan[:4]) for plan, (w, b) in zip(plans, pairs, strict=True)]
        flat = array(symbols).reshape(-1, *symbols.shape[2:])
        gradient = np.empty(flat.shape, np.float32)
        parts = [np.zeros((len(flat), w.shape[0], w.shape[1] + 1, WIDTH), np.float32) for w, _ in folded]
        weights, biases = zip(*folded, strict=True)
        chances = _plane_bits(flat, weights, biases, plans[0].rounding, np.float32(floor), gradient, tuple(parts))
        ctx.gradients = [torch.from_numpy(gradient).reshape(symbols.shape)]
        for plan, part in zip(plans, parts, strict=True):
            both = part.sum(axis=(0, 3))
            weight, bias = both[:, :-1].copy(), both[:, -1].copy()
            unfold(weight, bias, plan.before, plan.after)
            ctx.gradients += [torch.from_numpy(weight), torch.from_numpy(bias)]
        return -torch.from_numpy(chances).log2_().sum()

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        symbols, *parameters = (upstream[0] * gradient for gradient in ctx.gradients)
        return None, symbols, None, *parameters
