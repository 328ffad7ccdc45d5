"""What the parts of the method have in common: the calls that a training makes of each of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from ..render.camera import Camera
from .state import Saved


@dataclass(eq=False)
class Sight:
    """What is shown to a camera.

    camera: in training units. rows: the n anchors that it may see, int64 [n], ascending. values: their features [n, F],
    offsets [n, 3 K], scalings [n, 6] and masks' logits [n, K], float32, which parts replace by what is to be drawn.
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
    leaves have a gradient in this step, those of the image first. The rest is there once the image is drawn. chosen:
    the offsets that were drawn, int64 [m], ascending, row * K + offset. opacity: of all offsets [n, K]. screen: [m],
    whose gradient is that of the projected centres.
    """

    leaves: dict[str, Tensor] = field(default_factory=dict)
    taken: list[tuple[Tensor, dict[str, Tensor]]] = field(default_factory=list)
    chosen: Tensor | None = None
    opacity: Tensor | None = None
    screen: Tensor | None = None


class Part:
    """A part of the method: a training calls each of its parts in their order at each of these points.

    What a part has no use for, it does not define. name: its own in the phases of the settings and in saved states.
    """

    name = ""

    # --- of a step, in this order -------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Before a step: makes what the phase asks for and is not there yet."""

    def prepare(self, step: Step) -> None:
        """Before the image is drawn: changes what is shown."""

    def loss(self, step: Step) -> Tensor | None:
        """What is added to the loss of the image."""

    def descend(self, step: Step) -> None:
        """After the gradients: changes what has been learnt."""

    def end(self) -> None:
        """Between two steps, when the clock counts this one already."""

    # --- at other times -----------------------------------------------------------------------------------------------

    def show(self, sight: Sight) -> None:
        """Changes what is shown as the decoder would have it, without gradients or random numbers."""

    def anchors_changed(self) -> None:
        """After anchors came or went."""

    def finish(self) -> None:
        """Before the result: makes what a file needs and is not there yet."""

    def state(self) -> dict[str, Any]:
        """What a saved training needs: tensors, and values of JSON."""
        return {}

    def restore(self, state: Saved) -> None:
        """Sets what `state` gave. The anchors are restored before, the random numbers after all parts.

        Raises ValueError for what cannot be a state of this part.
        """
