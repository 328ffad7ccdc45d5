"""How far the coded size is from the ideal, and why: float64 code lengths of a scene's symbols, cause by cause.

The ideal is the code length under the same networks with nothing rounded: the stored weights in float64, no integer
activations or outputs, sine and cosine and bilinear samples in float64, and continuous distributions integrated over a
symbol's bin. What limits a value without rounding it stays: activations in [0, 1023], scales of at least 2^-5.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.codec import Coding
from refcodec.bitstream.context import UNIT
from refcodec.bitstream.conventions import Int64, rshift_round
from refcodec.bitstream.entropy import SymbolName, placed
from refcodec.bitstream.frame import Frame
from refcodec.bitstream.networks import ACTIVATION_MAX, Layer, activation
from refcodec.bitstream.planes import PLANES, assemble_planes, code_planes
from refcodec.bitstream.positions import position_integers
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import PRECISION, SCALE_MIN, ModelSet
from refcodec.inspect.page.lengths import escape_bits, plain_bits

F64 = NDArray[np.float64]

# Units of means and scale indices (SPEC 7.7).
MEAN_UNIT, SCALE_UNIT = 16.0, 8.0
# Most bits that a symbol is charged in a capped code length: those of the least likely symbol of a model (SPEC A.4).
CAP = float(PRECISION)
# Anchors at once: a bound of memory.
BLOCK = 8192


def bin_bits(family: str, mean: F64, log2_scale: F64, symbol: F64) -> F64:
    """-log2 of the mass of [symbol - 1/2, symbol + 1/2].

    mean: in steps. log2_scale: of the deviation (gauss) or of b (laplace).
    """
    scale = np.exp2(log2_scale)
    away = np.abs(symbol - mean)
    near, far = (away - 0.5) / scale, (away + 0.5) / scale
    # log(U(near) - U(far)) without cancellation in the tail, where U is the upper tail.
    upper = (lambda t: log_ndtr(-t)) if family == "gauss" else _log_upper_laplace
    with np.errstate(divide="ignore"):
        log_near, log_far = upper(near), upper(far)
        mass = log_near + np.log(-np.expm1(np.minimum(log_far - log_near, 0)))
    # In the middle of a wide distribution the two tails agree to some digits only. It is harmless: 1e-12 at a scale of
    # 2^10.
    return np.asarray(-mass / np.log(2))


def _log_upper_laplace(t: F64) -> F64:
    return np.where(t >= 0, -t, np.log(2 - np.exp(-np.abs(t)))) - np.log(2)


def float_network(layers: list[Layer], inputs: F64) -> F64:
    """SPEC 7.2 without roundings: the stored weights in float64, hidden activations clamped to [0, 1023]."""
    x = inputs
    for i, (weight, bias) in enumerate(layers):
        x = x @ weight.astype(np.float64).T + bias.astype(np.float64)
        if i < len(layers) - 1:
            x = np.clip(x, 0, ACTIVATION_MAX)
    return x


def float_context(scene: Scene, planes: tuple[F64, F64], positions: NDArray[np.float16]) -> F64:
    """SPEC 7.5 without roundings, float64 [n, 2 ch + 2 L], in the integers' units."""
    if scene.frame is None:
        return np.zeros((len(positions), 0))
    u = _float_coordinates(scene.frame, position_integers(positions).astype(np.float64))
    parts = []
    for plane in planes if scene.dimensions.plane_channels else ():
        size = plane.shape[-1]
        grid = u[:, :2] * (size - 1)
        cell = np.minimum(grid.astype(np.int64), size - 2)
        (fj, fi), (j, i) = (grid - cell).T, cell.T
        value = plane[:, i, j] * ((1 - fj) * (1 - fi)) + plane[:, i, j + 1] * (fj * (1 - fi))
        value += plane[:, i + 1, j] * ((1 - fj) * fi) + plane[:, i + 1, j + 1] * (fj * fi)
        parts.append(np.clip(value.T * 2.0**scene.plane_shift, -ACTIVATION_MAX, ACTIVATION_MAX))
    angle = 2 * np.pi * (u[:, 2:] - 0.5) * 2.0 ** np.arange(scene.dimensions.frequency_count)
    gamma = ACTIVATION_MAX * np.stack([np.sin(angle), np.cos(angle)], axis=2)
    return np.concatenate([*parts, gamma.reshape(len(u), -1)], axis=1)


def _float_coordinates(frame: Frame, p: F64) -> F64:
    """SPEC 7.5.1 to 7.5.3 without roundings: [0, 1]^3."""
    v = (p @ frame.matrix.T.astype(np.float64) + frame.translation) / np.exp2(frame.shift) / UNIT
    norm = np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1.0)
    w = v * (2 - 1 / norm) / norm
    low, high = frame.low / UNIT, frame.high / UNIT
    return np.asarray(np.clip((w - low) / (high - low), 0, 1))


@dataclass
class BitCounter:
    """A coder (entropy.Coder) that codes nothing and adds up code lengths, float64 bits.

    integer: of continuous distributions with the integer means and scales, capped. table: of the frequency models, with
    escapes and raw bits. raw: of the raw low bits. escape: of what escapes send beside their model's symbol. symbols,
    escapes: how many there are.
    """

    integer: float = 0.0
    table: float = 0.0
    raw: float = 0.0
    escape: float = 0.0
    symbols: int = 0
    escapes: int = 0

    def values(
        self,
        models: ModelSet,
        mean: Int64,
        scale: Int64,
        counts: list[int],
        limit: int,
        name: SymbolName,
        given: Int64 | None,
    ) -> Int64:
        """As Encoder.values."""
        assert given is not None
        model, index, away, raw = placed(models, mean, scale, given)
        radius = models.radius.take(model)
        escaped = index > 2 * radius
        escape = float(escape_bits(away[escaped], radius[escaped]).sum())
        exact = bin_bits(models.family, mean / MEAN_UNIT, scale / SCALE_UNIT, given.astype(np.float64))
        self.integer += float(np.minimum(exact, CAP).sum())
        self.table += float(plain_bits(models, model, index).sum()) + float(raw.sum()) + escape
        self.raw += float(raw.sum())
        self.escape += escape
        self.symbols += len(given)
        self.escapes += int(escaped.sum())
        return given

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """As Encoder.plain."""
        assert given is not None
        self.table += float(plain_bits(models, index, given).sum())
        self.symbols += len(given)
        return given


@dataclass(frozen=True)
class CodeLength:
    """Bits of one part of a scene.

    ideal: nothing is rounded. capped: the same with no symbol above 14 bits. grid: outputs are rounded to 1/16 step and
    1/8 octave, too. integer: networks and contexts are integers, too. table: of the frequency models, with escapes and
    raw bits. escape, raw: of `table`, those of escapes and of raw bits. symbols, escapes: how many there are.
    """

    ideal: float
    capped: float
    grid: float
    integer: float
    table: float
    escape: float
    raw: float
    symbols: int
    escapes: int


def plane_code_length(scene: Scene) -> CodeLength:
    """The code lengths of the planes."""
    d, planes = scene.dimensions, scene.planes.astype(np.int64)
    counter, sarm = BitCounter(), Coding(scene).sarm
    if sarm is None:
        return _code_length(np.zeros(3), counter)
    code_planes(counter, sarm, d.plane_channels, d.plane_size, scene.planes)
    padded = np.pad(planes, ((0, 0), (0, 0), (1, 0), (1, 1)))
    size = d.plane_size
    near = [padded[..., i : i + size, j : j + size].reshape(-1) for i, j in ((0, 0), (0, 1), (0, 2), (1, 0))]
    out = float_network(scene.networks["sarm"], activation(np.stack(near, axis=1)).astype(np.float64))
    lengths = _float_lengths("laplace", out[:, 0], out[:, 1], planes.reshape(-1).astype(np.float64))
    return _code_length(lengths, counter)


def _code_length(lengths: F64, counter: BitCounter) -> CodeLength:
    ideal, capped, grid = lengths.tolist()
    c = counter
    return CodeLength(ideal, capped, grid, c.integer, c.table, c.escape, c.raw, c.symbols, c.escapes)


def _float_lengths(family: str, mean: F64, scale: F64, symbol: F64) -> F64:
    """Bits with outputs as they are, the same capped, and capped with outputs rounded to their units: float64 [3]."""
    # SPEC 8.5's least scale is a part of the model: without it a few symbols could count for more than all others.
    scale = np.maximum(scale, SCALE_MIN)
    exact = bin_bits(family, mean / MEAN_UNIT, scale / SCALE_UNIT, symbol)
    rounded = bin_bits(family, np.floor(mean + 0.5) / MEAN_UNIT, np.floor(scale + 0.5) / SCALE_UNIT, symbol)
    return np.array([exact.sum(), np.minimum(exact, CAP).sum(), np.minimum(rounded, CAP).sum()])


def attribute_code_length(scene: Scene) -> CodeLength:
    """The code lengths of the attributes."""
    d, a = scene.dimensions, scene.attributes
    counter = BitCounter()
    coding, full = Coding(scene), assemble_planes(scene.planes)
    real = (full[0].astype(np.float64), full[1].astype(np.float64))
    lengths = np.zeros(3)
    width = d.attribute_width
    for block in chunk_ranges(scene.anchor_count, BLOCK):
        rows = slice(block.start, block.stop)
        given = type(a)(a.features[rows], a.scalings[rows], a.offsets[rows], a.steps[rows])
        code_attributes(counter, coding.model, coding.contexts(rows), scene.masks[rows], [range(len(block))], given)
        hyper = float_network(scene.networks["hyper"], float_context(scene, real, scene.positions[rows]))
        mean, scale = hyper[:, :width].copy(), hyper[:, width : 2 * width].copy()
        shift = scene.carm_shift.astype(np.int64)
        earlier = activation(rshift_round(given.features[:, : d.carm_inputs].astype(np.int64), shift)).astype(
            np.float64
        )
        bounds = np.cumsum(d.slices).tolist()
        for i, (done, end) in enumerate(pairwise(bounds), start=1):
            change = float_network(scene.networks[f"carm.{i}"], earlier[:, :done])
            mean[:, done:end] += change[:, : end - done]
            scale[:, done:end] += change[:, end - done :]
        symbols = np.concatenate(
            [given.features, given.scalings, given.offsets.reshape(len(block), -1)], axis=1
        ).astype(np.float64)
        coded = np.concatenate(
            [np.ones((len(block), d.features + 6), dtype=bool), np.repeat(scene.masks[rows], 3, axis=1)], axis=1
        )
        lengths += _float_lengths("gauss", mean[coded], scale[coded], symbols[coded])
    return _code_length(lengths, counter)


def order_zero_bits(scene: Scene) -> dict[str, float]:
    """Order-0 entropy in bits of the symbols, channel by channel: `attributes` (over the kept ones) and `planes`."""
    d, a = scene.dimensions, scene.attributes

    def entropy(values: NDArray) -> float:
        counts = np.unique(values, return_counts=True)[1].astype(np.float64)
        return float((counts * np.log2(counts.sum() / counts)).sum())

    attributes = sum(entropy(c) for kind in (a.features, a.scalings) for c in kind.T)
    attributes += sum(
        entropy(a.offsets[scene.masks[:, k], k, axis]) for k in range(d.offset_count) for axis in range(3)
    )
    planes = sum(entropy(scene.planes[p, c]) for p in range(PLANES) for c in range(d.plane_channels))
    return {"attributes": attributes, "planes": planes}
