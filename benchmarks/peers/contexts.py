"""Entropy models of others on the same trainer, by code lengths: no file can hold them.

- CAT-3DGS: planes over three pairs of axes (benchmarks.hyperpriors).
- HAC: tables of signs (hash_grid).
- HAC++: those, and mixtures of two distributions within an anchor (mixture).
- ContextGS: levels of anchors (levels), without its latents for each anchor.

HEMGS is not here. Its hyperprior has features of a network that was trained on other scenes, and its symbols are
decoded one neighbour after the other, for which the trainer has no order of anchors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from refcodec.photographs.photographs import PhotographSet
from refcodec.train.rate_model.hyperprior import Hyperprior, VectorMatrix
from refcodec.train.rate_model.model import RateModel
from refcodec.train.settings import TrainSettings
from refcodec.train.trainer import Trainer

from ..hyperpriors import HYPERPRIORS
from .hash_grid import HashGrid, Signs
from .levels import Levels, NoPlanes
from .mixture import Mixture


class _SignsMixture(Mixture, Signs):
    """HAC++: tables of signs, and mixtures within an anchor."""


class _FormatWithoutFile(VectorMatrix):
    """The format's hyperprior, for a model that no file can hold."""

    coded = False


@dataclass(frozen=True)
class Model:
    """What a training uses. changes: its settings that differ from the format's."""

    hyperprior: Callable[[], Hyperprior]
    model: type[RateModel] = RateModel
    changes: tuple[str, ...] = ()

    def trainer(self, photographs: PhotographSet, settings: TrainSettings) -> Trainer:
        """A training with it. Raises ValueError as Trainer, and for a lambda_r of 0, which has no rate."""
        hyperprior = self.hyperprior()
        trainer = Trainer(photographs, settings, hyperprior=hyperprior)
        if trainer.rate is None:
            raise ValueError("an entropy model takes part in a training with a rate alone: lambda_r must be above 0")
        trainer.rate.model_type = self.model
        if isinstance(hyperprior, Levels):
            hyperprior.rate = trainer.rate
        return trainer


# HAC adds the tables' bits in each step, with the weight of the attributes' (its code), and starts its latents near 0.
_HAC = ("rate.planes=1.0", "rate.plane_period=1", "entropy.planes=0.0001")

MODELS = {
    **{name: Model(lambda name=name: HYPERPRIORS[name]) for name in HYPERPRIORS},  # type: ignore[misc]
    "hac": Model(HashGrid, Signs, _HAC),
    "hac++": Model(HashGrid, _SignsMixture, _HAC),
    "contextgs": Model(Levels, NoPlanes),
    "vm-mixture": Model(_FormatWithoutFile, Mixture),
}
