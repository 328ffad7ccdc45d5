"""What the parts of the rasteriser share: types of arrays, sizes of tiles, and limits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .simd import WIDTH

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

# SPEC 14.5: alphas below it count as 0; where less than the other would be left, a pixel takes no more.
ALPHA_MIN, TRANSMITTANCE_MIN = 1 / 255, 1e-4
LEAST = np.float32(ALPHA_MIN)
LOG2_MIN = math.log2(ALPHA_MIN)
# Pixels added to spans: a span may hold too much, since alpha decides, but never too little.
SLACK = 0.01
# A span's half width that makes it empty.
FAR = np.float32(1e18)
# Pixels of a block, whose values fill the lanes, and of a tile. A tile has 8 x 8 blocks: as many as a uint64 has bits.
BLOCK_WIDTH, BLOCK_HEIGHT = 4, 2
BLOCKS_WIDE = 8
TILE_WIDTH, TILE_HEIGHT = BLOCKS_WIDE * BLOCK_WIDTH, 8 * BLOCK_HEIGHT
# Floats of a block in a tile's state: eight planes of it, one behind the other.
BLOCK = 8 * WIDTH
# Values of a pair's gradient: 1, u, v, u^2, uv, v^2 weighted with dL/dlog(alpha), then the colour's three.
SUMS = 9
