"""Exposure: an affine colour of each photograph, by which its image differs from the scene's.

Cameras set exposure and white balance anew for each photograph. Otherwise a scene learns them as if its colours
depended on the view. The file has no exposures: they belong to photographs.
"""

from typing import Any

import torch
from torch import Tensor

from ..adam import ADAM_EPSILON
from ..optimisers import learning_rate, moments, restore_moments
from ..stage import Run, Stage, Step
from ..state import Saved


class Exposure(Stage):
    """Multiplies and moves the colours of a photograph's image before it is compared with the photograph.

    values: float32 [V, 6], for each of V photographs the logarithms of the factors of red, green and blue, and what is
    added, 1 for white. Their means over the photographs are 0, so that the scene keeps the exposure of all.
    """

    name = "exposure"
    values: Tensor

    def join(self, run: Run) -> None:
        super().join(run)
        self.values = torch.zeros(len(run.cameras), 6, device=run.device, requires_grad=True)
        self.optimiser = torch.optim.Adam([self.values], eps=ADAM_EPSILON)

    def photographed(self, step: Step, image: Tensor) -> Tensor:
        """The image as the camera of its photograph exposed it."""
        if self.mode == "off":
            return image
        factor, more = self.values[step.photograph].split(3)
        return image * factor.exp() + more

    def descend(self, step: Step) -> None:
        """A step of Adam."""
        if self.mode == "off":
            return
        self.optimiser.param_groups[0]["lr"] = learning_rate(self.run.settings.learning.exposure, self.run.clock.share)
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        with torch.no_grad():
            self.values -= self.values.mean(dim=0)

    def state(self) -> dict[str, Any]:
        """The values, and their moments."""
        return {"values": self.values.detach(), **moments(self.optimiser)}

    def restore(self, state: Saved) -> None:
        with torch.no_grad():
            self.values.copy_(state.tensor("values", self.values.shape))
        restore_moments(self.optimiser, state)
