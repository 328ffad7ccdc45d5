"""What the parts of the rasteriser share: the types of arrays, the sizes of tiles, and limits."""

import math

import numpy as np
from numpy.typing import NDArray

from .simd import WIDTH

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

# SPEC 14.5: an alpha below the first counts as 0. A pixel takes no Gaussian that would leave less than the second.
ALPHA_MIN, TRANSMITTANCE_MIN = 1 / 255, 1e-4
LEAST = np.float32(ALPHA_MIN)
LOG2_MIN = math.log2(ALPHA_MIN)
# The pixels that are added to spans. A span may hold too much, since alpha decides, but never too little.
SLACK = 0.01
# The half width that, with a minus sign, makes a span empty.
FAR = np.float32(1e18)
# The pixels of a block fill the lanes of a value. A tile has 8 x 8 blocks, as many as a uint64 has bits.
BLOCK_WIDTH, BLOCK_HEIGHT = 4, 2
BLOCKS_WIDE = 8
TILE_WIDTH, TILE_HEIGHT = BLOCKS_WIDE * BLOCK_WIDTH, 8 * BLOCK_HEIGHT
# The floats of a block in the state of a tile. They are eight planes, one after the other.
BLOCK = 8 * WIDTH
# The values of a pair's gradient. They are the sums of 1, u, v, u^2, uv and v^2, weighted with the gradient of
# log(alpha), and then the gradients of the three colours.
SUMS = 9
