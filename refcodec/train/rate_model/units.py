"""The units of the entropy model in training, which are the codec's (SPEC.md 7, B.5), and roundings with a gradient.

Symbols are integers, means count in 1/16 symbol, scale indices and step indices in 1/8 octave.
"""

import torch
from torch import Tensor

from ...bitstream.tables import SCALE_END, STEP_LENGTH

# SPEC 7.7: the units of a mean per symbol, and those of a scale index per octave.
MEAN_UNIT, SCALE_UNIT = 16.0, 8.0
# The largest scale index that is worth training: sixteen octaves above the table.
SCALE_MOST = SCALE_END + 8 * 16
# SPEC 7.8: the step index whose multiplier is one.
STEP_ONE = STEP_LENGTH // 2
# SPEC 6.9: sixteen plane symbols are a latent of one.
LATENT_UNIT = 16.0
# SPEC 7.5.4: a plane symbol becomes 16 units of context, so that interpolation keeps four bits of fraction.
PLANE_SHIFT = 4
# SPEC 7.5.5: about the amplitude of the sine table.
GAMMA_UNIT = 1024.0


def round_through(x: Tensor) -> Tensor:
    """Rounding half up whose gradient is the identity's."""
    return x + (torch.floor(x + 0.5) - x).detach()


def grid_through(x: Tensor, step: Tensor) -> Tensor:
    """Rounding half up to multiples of a power of two, whose gradient is the identity's."""
    return x + (torch.floor(x / step + 0.5) * step - x).detach()
