"""Estimates the bytes of a file from the current state of training."""

from __future__ import annotations

import math

import numpy as np
import torch

from ..bitstream.attributes import KINDS
from ..encoder.sizes import choose_lanes
from ..encoder.weights import quantise_rendering
from .export import position_bytes, weight_bytes
from .scaffold import Scaffold
from .stage import Run
from .stages.rate import Rate

# The final bits of attributes, masks and planes, per number of each anchor that exists before the rate, at some values
# of lambda_r. They are means over caliterra, snowmiku and playbot at 200 pixels and 4,000 steps, one seed each, with 50
# features. With 12 features caliterra and playbot have the same to 5 %.
LIKELY_BITS = ((0.001, 1.9), (0.004, 1.05), (0.015, 0.43), (0.04, 0.16))
# Bytes that no estimate counts: header, frame, index, heads of chunks, cameras. caliterra's file has 2,088 of them.
UNCOUNTED = 2100
# Bits of the largest weight of a layer before a grid is chosen: in the middle of the grids that are tried.
RENDERING_BITS = 8
# Bytes of all packed weights, per weight of the rendering networks, in the same training runs.
LIKELY_WEIGHT = 1.15


def estimate(run: Run) -> dict[str, float]:
    """Bytes of each part of the file as they are now: coded_bytes, or likely_bytes before the rate.

    Of an uncompressed scene they are those of its float32 numbers.
    """
    for rate in run.of(Rate):
        if rate.model is None:
            return likely_bytes(run.scaffold, run.settings.rate.lambda_r)
        return coded_bytes(run.scaffold, rate)
    return uncompressed_bytes(run.scaffold)


def uncompressed_bytes(scaffold: Scaffold) -> dict[str, float]:
    """Bytes of each part as float32 numbers."""
    n = scaffold.count
    weights = 4 * sum(p.numel() for p in scaffold.networks.parameters())
    return {"positions": 12 * n, "attributes": 4 * scaffold.columns.width * n, "weights": weights}


def likely_bytes(scaffold: Scaffold, lambda_r: float) -> dict[str, float]:
    """Estimates the bytes of each part of the file before there is an entropy model.

    Positions are packed. The rest follows from other files: LIKELY_BITS, LIKELY_WEIGHT.
    """
    lambdas, bits_at = np.log(np.array(LIKELY_BITS)).T
    bits = float(np.exp(np.interp(math.log(lambda_r), lambdas, bits_at)))
    return {
        "positions": position_bytes(scaffold.lattice, choose_lanes(scaffold.count, 2.0 * scaffold.columns.width)),
        "attributes": bits / 8 * scaffold.columns.width * scaffold.count,
        "weights": LIKELY_WEIGHT * sum(p.numel() for p in scaffold.networks.parameters()),
    }


@torch.no_grad()
def coded_bytes(scaffold: Scaffold, rate: Rate) -> dict[str, float]:
    """Bytes of each part of the file, and of each kind of attributes, without those of chunks and sections.

    Attributes and planes are ideal code lengths after rounding. Masks are counted as if each offset's were drawn with
    its own frequency. Positions and weights are packed, the rendering networks with RENDERING_BITS before they have a
    grid.
    """
    kept = rate.masks.decided()
    bits, planes = rate.bits(kept)
    some = kept.any(dim=1)
    share = kept[some].double().mean(dim=0).clamp(1e-9, 1 - 1e-9)
    entropy = -(share * share.log2() + (1 - share) * (1 - share).log2()).sum()
    lanes = choose_lanes(scaffold.count, 2.0 * scaffold.columns.width)
    layers = scaffold.networks.layers()
    if not scaffold.networks.gridded:
        layers = quantise_rendering(layers, RENDERING_BITS)
    kinds = dict(zip(KINDS, (bits / 8).tolist(), strict=True))
    return {
        "positions": position_bytes(scaffold.lattice[some.cpu().numpy()], lanes),
        "attributes": sum(kinds.values()),
        **kinds,
        "masks": float(entropy) * int(some.sum()) / 8,
        "planes": planes / 8,
        "weights": weight_bytes(rate.started(), scaffold.networks, layers, lanes),
    }
