"""HAC++'s context within an anchor (Chen et al. 2025): features under mixtures of two Gaussian distributions.

The first is that of the hyperprior, the second also knows the slices of features before. HAC++ has five slices of ten
features and reads the hyperprior's distribution, too. Here the slices and widths are CARM's (SPEC 7.9), and the second
distribution is CARM's change of the first, so that only the mixture is new.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from refcodec.bitstream.attributes import SCALINGS
from refcodec.train.rate_model.bits import gauss_bits
from refcodec.train.rate_model.columns import Columns
from refcodec.train.rate_model.folded import FoldedMlp
from refcodec.train.rate_model.hyperprior import Hyperprior
from refcodec.train.rate_model.model import RateModel
from refcodec.train.rate_model.units import MEAN_UNIT, SCALE_UNIT
from refcodec.train.settings import EntropySettings


def mixed_bits(first: Tensor, second: Tensor, logit: Tensor) -> Tensor:
    """Bits under a mixture of two distributions, from the bits under each. logit: of the first one's weight."""
    weighed = [nn.functional.logsigmoid(sign * logit) - bits * math.log(2) for sign, bits in ((1, first), (-1, second))]
    return -torch.logsumexp(torch.stack(weighed), dim=0) / math.log(2)


class Mixture(RateModel):
    """An entropy model with a third output of CARM for each feature: the logit of the hyperprior's weight."""

    def __init__(
        self,
        hyperprior: Hyperprior,
        plane_size: int,
        width: int,
        mean: np.ndarray[Any, np.dtype[np.float64]],
        deviation: np.ndarray[Any, np.dtype[np.float64]],
        generator: torch.Generator,
        settings: EntropySettings,
        *,
        columns: Columns,
    ) -> None:
        """As RateModel."""
        super().__init__(hyperprior, plane_size, width, mean, deviation, generator, settings, columns=columns)
        unit = torch.tensor(2.0 ** np.round(np.log2(np.maximum(deviation, settings.deviation))), dtype=torch.float32)
        carm = []
        for done, own in self._later():
            outputs = torch.cat([unit[done : done + own] * MEAN_UNIT, torch.full((2 * own,), SCALE_UNIT)])
            carm.append(FoldedMlp([done, width, 3 * own], unit[:done], outputs, generator, 0.0, settings.bias))
        self.carm = nn.ModuleList(carm)

    def _later(self) -> list[tuple[int, int]]:
        """For each slice but the first, the features before it and its own."""
        slices = self.columns.slices
        return list(zip(accumulate(slices), slices[1:], strict=False))

    def attribute_bits(self, hidden: Tensor, symbols: Tensor, kept: Tensor) -> Tensor:
        """As RateModel."""
        of = self.columns
        out = self.hyper.outputs(hidden, slice(0, 2 * of.width))
        mean, scale = out[:, : of.width], out[:, of.width :]
        alone = gauss_bits(mean, scale, symbols, self.floor)
        parts = [alone[:, : of.slices[0]]]
        earlier = self.carm_inputs(symbols[:, : of.carm_inputs])
        for (done, own), network in zip(self._later(), self.carm, strict=True):
            change, place = network(earlier[:, :done]), slice(done, done + own)
            by_mean, by_scale, logit = change.split(own, dim=1)
            second = gauss_bits(mean[:, place] + by_mean, scale[:, place] + by_scale, symbols[:, place], self.floor)
            parts.append(mixed_bits(alone[:, place], second, logit / SCALE_UNIT))
        some = 1 - torch.prod(1 - kept, dim=1)
        place = slice(of.features, of.features + SCALINGS)
        offsets = (alone[:, place.stop :].reshape(len(alone), of.offsets, 3).sum(dim=2) * kept).sum(dim=1)
        scalings = alone[:, place].sum(dim=1)
        return torch.stack([torch.cat(parts, dim=1).sum(dim=1) * some, scalings * some, offsets], dim=1)
