"""SPEC.md E.2, as tests compare it with refcodec/web. benchmarks at commit 82b0d075 have the pictures of parts."""

from dataclasses import replace

import numpy as np

from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Scene
from refcodec.rendering.gaussians import Gaussians


def enlarged(g: Gaussians, scene: Scene, there: int) -> Gaussians:
    """SPEC E.2: returns the Gaussians of the first chunks of a scene, longer where others are missing."""
    positions, found, mean = reconstruct(scene).positions, np.zeros((2, len(g.mean))), g.mean.astype(np.float64)
    for number, chunk in enumerate(scene.chunks):
        own = positions[chunk.start : chunk.stop].astype(np.float64)
        low, high = own.min(axis=0), own.max(axis=0)
        sides = np.maximum(high - low, (high - low).max() * 1e-3 or 1)
        within = ((mean >= low) & (mean <= high)).all(axis=1)
        found[:, within] += np.array([[number < there], [1]]) * (len(chunk) / sides.prod())
    share = np.divide(found[0], found[1], out=np.zeros(len(mean)), where=found[1] > 0)
    share = np.maximum(share, scene.chunks[there - 1].stop / scene.anchor_count)
    area = np.sort(g.lengths.astype(np.float64), axis=1)[:, 1:].prod(axis=1)
    middle = np.sort(area)[len(area) // 2]
    factor = np.sqrt(1 + (share**-0.5 - 1) * np.sqrt(np.divide(middle, area, out=np.zeros_like(area), where=area > 0)))
    return replace(g, lengths=g.lengths * factor.astype(np.float32)[:, None])
