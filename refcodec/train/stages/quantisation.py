"""Quantisation: noise or rounding in training, and the base steps of attributes (SPEC.md B.5)."""

import numpy as np
import torch
from torch import Tensor

from ...bitstream.attributes import KINDS
from ...encoder.quantise import varying
from ..cpu.residues import Symbols, WithResidues
from ..device import has_kernel
from ..stage import Sight, Stage, Step


class Quantisation(Stage):
    """Noise in place of rounding, or rounding, with the same gradients."""

    name = "quantisation"
    needs_rate = True

    @property
    def rounds(self) -> bool:
        """Whether attributes and planes are rounded."""
        return self.mode == "round"

    @property
    def noise(self) -> torch.Generator | None:
        """The source of the noise that stands for rounding; None where values are rounded."""
        return None if self.rounds else self.run.noise

    def base_steps(self) -> Tensor:
        """The base steps of features, scalings and offsets for the anchors as they are, float32 [3]."""
        settings, features = self.run.settings.quantisation, self.run.scaffold.tables["features"]
        # One anchor has no spread.
        deviations = features.std(dim=0).cpu().numpy() if len(features) > 1 else np.zeros(1, np.float32)
        spread = float(torch.from_numpy(varying(deviations)).median()) or 1.0
        steps = [spread * settings.features, settings.scalings, settings.offsets]
        return torch.tensor(steps, device=self.run.device)

    def residue(self, values: Tensor, step: Tensor) -> Tensor:
        """The number added to values [n, w] in place of rounding, in steps [n, 1]: at most a half. No gradient."""
        with torch.no_grad():
            if self.rounds:
                scaled = values / step
                return torch.floor(scaled + 0.5) - scaled
            return torch.rand(values.shape, generator=self.run.noise, device=values.device) - 0.5

    def symbols(self, values: list[Tensor], steps: Tensor) -> Tensor:
        """The symbols of k kinds of values, [n, w] each, with steps [n, k], noisy or rounded: [n, sum of w]."""
        if has_kernel(steps):
            rounded: Tensor = Symbols.apply(steps, self._seed(), *values)
            return rounded
        each = [(v, steps[:, i : i + 1]) for i, v in enumerate(values)]
        return torch.cat([v / size + self.residue(v, size) for v, size in each], dim=1)

    def _seed(self) -> int | None:
        """A seed of new noise; None where values are rounded."""
        return None if self.rounds else int(torch.randint((1 << 63) - 1, (1,), generator=self.run.noise))

    def prepare(self, step: Step) -> None:
        """Draws the image with the attributes that the decoder will have.

        values + residue * step passes the gradient of the distortion to the step, too, which straight-through rounding
        of the values would not.
        """
        if step.steps is None:
            return
        values = [step.leaves[kind] for kind in KINDS]
        if has_kernel(step.steps):
            shown = WithResidues.apply(step.steps, self._seed(), *values)
        else:
            each = [(v, step.steps[:, i : i + 1]) for i, v in enumerate(values)]
            shown = [v + self.residue(v, size) * size for v, size in each]
        step.values |= zip(KINDS, shown, strict=True)

    def show(self, sight: Sight) -> None:
        if sight.steps is not None and self.rounds:
            for i, kind in enumerate(KINDS):
                size = sight.steps[:, i : i + 1]
                sight.values[kind] = torch.floor(sight.values[kind] / size + 0.5) * size
