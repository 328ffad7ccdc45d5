"""Estimates the bytes of a file from the current state of training."""

import torch

from ..bitstream.attributes import KINDS
from ..encoder.sizes import choose_lanes
from ..encoder.weights import quantise_rendering
from .export import position_bytes, weight_bytes
from .scaffold import Scaffold
from .stage import Run
from .stages.rate import Rate

# Bytes that no estimate counts: header, frame, index, heads of chunks, cameras. caliterra's file has 2,088 of them.
UNCOUNTED = 2100
# Bits of the largest weight of a layer before a grid is chosen: in the middle of the grids that are tried.
RENDERING_BITS = 8


def estimate(run: Run) -> dict[str, float]:
    """Bytes of each part of the file as they are now; none before the rate, when nothing counts them.

    Of an uncompressed scene they are those of its float32 numbers.
    """
    for rate in run.of(Rate):
        return coded_bytes(run.scaffold, rate) if rate.model is not None else {}
    return uncompressed_bytes(run.scaffold)


def uncompressed_bytes(scaffold: Scaffold) -> dict[str, float]:
    """Bytes of each part as float32 numbers."""
    n = scaffold.count
    weights = 4 * sum(p.numel() for p in scaffold.networks.parameters())
    return {"positions": 12 * n, "attributes": 4 * scaffold.columns.width * n, "weights": weights}


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
