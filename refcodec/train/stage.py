"""The interface of a stage of the method: the calls that a training run makes to each of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from ..rendering.camera import Camera
from .state import Saved


@dataclass(eq=False)
class Sight:
    """The anchors in front of a camera.

    camera: in training units. rows: the n anchors that it may see, int64 [n], ascending. values: their features [n, F],
    offsets [n, 3 K], scalings [n, 6] and masks' logits [n, K], float32, which stages replace by the values to draw.
    steps: of features, scalings and offsets [n, 3]; None before there is an entropy model. masks: float32 [n, K], which
    multiply the opacities; None for ones.
    """

    camera: Camera
    rows: Tensor
    values: dict[str, Tensor]
    steps: Tensor | None = None
    masks: Tensor | None = None


@dataclass(eq=False)
class Step(Sight):
    """A step of training.

    leaves: the anchors' values as tensors with gradients, of which `values` are made. taken: all sets of rows whose
    leaves have a gradient in this step, those of the image first. The other fields are set once the image is drawn.
    chosen: the offsets that were drawn, int64 [m], ascending, row * K + offset. opacity: of all offsets [n, K]. screen:
    [m], whose gradient is that of the projected centres.
    """

    leaves: dict[str, Tensor] = field(default_factory=dict)
    taken: list[tuple[Tensor, dict[str, Tensor]]] = field(default_factory=list)
    chosen: Tensor | None = None
    opacity: Tensor | None = None
    screen: Tensor | None = None


class Stage:
    """A stage of the method. A training run calls its stages in their order at each of these points.

    A stage defines only the calls that it needs. name: its name in the phases of the settings and in saved states.
    """

    name = ""

    # --- of a step, in this order -------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Before a step: creates the objects that the phase requires, unless they exist."""

    def prepare(self, step: Step) -> None:
        """Before the image is drawn: changes the values to draw."""

    def loss(self, step: Step) -> Tensor | None:
        """The term that is added to the loss of the image, a scalar, or None."""

    def descend(self, step: Step) -> None:
        """After the gradients: updates parameters."""

    def end(self) -> None:
        """Between two steps, after the clock has counted this one."""

    # --- at other times -----------------------------------------------------------------------------------------------

    def show(self, sight: Sight) -> None:
        """Replaces the values to draw by those of the decoder, without gradients or random numbers."""

    def anchors_changed(self) -> None:
        """After anchors were added or removed."""

    def finish(self) -> None:
        """Before the result: creates the objects that a file needs, unless they exist."""

    def state(self) -> dict[str, Any]:
        """The values that a saved training needs: tensors, and values of JSON."""
        return {}

    def restore(self, state: Saved) -> None:
        """Restores the values of `state`. The anchors are restored before, the random numbers after all stages.

        Raises ValueError for values that cannot be a state of this stage.
        """
