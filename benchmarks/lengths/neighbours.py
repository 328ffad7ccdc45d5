"""Anchors that a decoder knows before it decodes one: the nearest of those before, or of a coarser level."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from refcodec.bitstream.conventions import Int64

from .scenes import Coded

# Anchors of a block whose nearest ones before are looked for at once, and how many are looked at for it.
BLOCK = 512
# Share of a coarser level in the next finer one (ContextGS's code).
RATIO = 5


def nearest_before(cells: Int64, count: int) -> NDArray[np.int64]:
    """The `count` nearest anchors before each one in the order given, int64 [N, count]; -1 where there are fewer.

    Within a block of BLOCK anchors all of its pairs are compared, and the blocks before by a tree.
    """
    n = len(cells)
    found = np.full((n, count), -1, np.int64)
    points = cells.astype(np.float64)
    for start in range(0, n, BLOCK):
        stop = min(start + BLOCK, n)
        block = points[start:stop]
        inner = np.linalg.norm(block[:, None] - block[None], axis=2)
        inner[np.arange(stop - start)[:, None] <= np.arange(stop - start)[None]] = np.inf
        index = np.broadcast_to(np.arange(start, stop), inner.shape)
        if start:
            outer, at = cKDTree(points[:start]).query(block, k=list(range(1, min(count, start) + 1)))
            inner, index = np.hstack([outer, inner]), np.hstack([at, index])
        best = np.argsort(inner, axis=1, kind="stable")[:, :count]
        chosen = np.take_along_axis(index, best, axis=1)
        chosen[~np.isfinite(np.take_along_axis(inner, best, axis=1))] = -1
        found[start:stop, : chosen.shape[1]] = chosen
    return found


def nearest_coarser(cells: Int64, count: int) -> NDArray[np.int64]:
    """The `count` nearest anchors of the coarser levels, int64 [N, count]; -1 for anchors of the coarsest level.

    Every RATIO-th anchor of a level, in the order given, which is Morton's, is in the coarser one as well.
    """
    n = len(cells)
    found = np.full((n, count), -1, np.int64)
    points, level = cells.astype(np.float64), np.arange(n)
    while len(level) >= RATIO * 20:
        coarse = level[::RATIO]
        fine = np.setdiff1d(level, coarse, assume_unique=True)
        _, at = cKDTree(points[coarse]).query(points[fine], k=list(range(1, count + 1)))
        found[fine] = coarse[at]
        level = coarse
    return found


def nearest_of_all(cells: Int64, count: int) -> NDArray[np.int64]:
    """The `count` nearest other anchors, decoded or not, int64 [N, count]."""
    _, at = cKDTree(cells.astype(np.float64)).query(cells, k=list(range(1, count + 2)))
    own = at == np.arange(len(cells))[:, None]
    # An anchor that several share the cell with may be missing from its own list: the farthest goes instead.
    own[~own.any(axis=1), -1] = True
    return at[~own].reshape(len(cells), count)


def inputs(scene: Coded, what: str, unit: Tensor) -> Tensor:
    """The mean of the neighbours' symbols over `unit` and the logarithm of their distance, float32 [N, D + 2].

    The last column is 1 where there is a neighbour. what: as Variant.neighbours.
    """
    kind, _, number = what.partition(":")
    find = {"before": nearest_before, "levels": nearest_coarser, "oracle": nearest_of_all}[kind]
    index = find(scene.cells, int(number))
    some = torch.from_numpy(index >= 0).float()
    mean = torch.from_numpy(scene.statistics()[0].astype(np.float32))
    offsets = scene.kept.repeat_interleave(3, dim=1)
    deviation = (scene.symbols - mean) / unit
    deviation[:, -scene.counts[2] :] *= offsets
    at = torch.from_numpy(np.maximum(index, 0))
    share = some / some.sum(dim=1, keepdim=True).clamp_min(1)
    found = (deviation[at] * share[:, :, None]).sum(dim=1)
    away = np.linalg.norm(scene.cells[:, None] - scene.cells[np.maximum(index, 0)], axis=2)
    distance = (torch.from_numpy(np.log2(1 + away).astype(np.float32)) * share).sum(dim=1, keepdim=True) / 4
    return torch.cat([found, distance, some.max(dim=1, keepdim=True).values], dim=1)
