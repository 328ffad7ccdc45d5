"""The rate: bits of some anchors' attributes and of the planes in the loss (the paper's equation 5).

It starts once, when its phase begins: then the frame, the size of the planes and the widths of the networks are fixed.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...bitstream.attributes import KINDS
from ...bitstream.frame import FRAME_RANGE_BOUND, FRAME_SHIFT_MAX, MATRIX_BOUND, TRANSLATION_BOUND, Frame
from ...encoder.frame import choose_frame
from ...encoder.sizes import choose_plane_size, choose_width
from ..adam import ADAM_EPSILON
from ..optimisers import learning_rate, moments, restore_moments
from ..rate_model.hyperprior import Contexts, contexts
from ..rate_model.model import RateModel
from ..stage import Run, Sight, Stage, Step
from ..start import lattice_positions
from ..state import Saved
from .masks import Masks
from .quantisation import Quantisation

# SPEC 6.7: the fields of a frame in a saved state, with their shapes and bounds.
_FRAME: dict[str, tuple[tuple[int, ...], float, float]] = {
    "matrix": ((3, 3), 1 - MATRIX_BOUND, MATRIX_BOUND - 1),
    "translation": ((3,), 1 - TRANSLATION_BOUND, TRANSLATION_BOUND - 1),
    "shift": ((3,), 0, FRAME_SHIFT_MAX),
    "low": ((3,), -FRAME_RANGE_BOUND, FRAME_RANGE_BOUND - 1),
    "high": ((3,), 1 - FRAME_RANGE_BOUND, FRAME_RANGE_BOUND),
}
# The least base step that float32 has at full precision. Symbols are attributes over it.
BASE_STEP_MIN = float(np.finfo(np.float32).tiny)
# The header counts anchors in 32 bits.
ANCHORS_MAX = (1 << 32) - 1
# Anchors at once where all are counted: a bound of memory.
BLOCK = 8192


class Rate(Stage):
    """L_rate, and the entropy model that it trains.

    After its start it has the model, the frame (SPEC 7.5.1) or None if F_h has no inputs, base_step
    (float32 [3]), the contexts of all anchors, and the optimiser.
    """

    name = "rate"
    needs_rate = True
    model: RateModel | None
    masks: Masks
    quantisation: Quantisation
    frame: Frame | None
    base_step: Tensor
    optimiser: torch.optim.Adam
    contexts: Contexts

    def join(self, run: Run) -> None:
        super().join(run)
        self.settings, self.scaffold, self.model = run.settings, run.scaffold, None
        self.masks, self.quantisation = next(run.of(Masks)), next(run.of(Quantisation))

    # --- milestones ---------------------------------------------------------------------------------------------------

    def before_step(self) -> None:
        """Starts the entropy model, and later rounds its activations."""
        mode = self.mode
        if mode != "off" and self.model is None:
            self.start()
        if mode == "integers" and self.model is not None and not self.model.integers:
            self.round_activations()

    def start(self) -> None:
        """Fixes the frame and the planes' size, and starts the entropy model from the attributes' statistics."""
        self.masks.anchors_changed()
        count = self.scaffold.count
        frame = choose_frame(lattice_positions(self.scaffold.lattice)) if self._has_inputs else None
        plane_size = choose_plane_size(count) if self.settings.entropy.channels else 0
        self._make(frame, self.quantisation.base_steps(), plane_size, choose_width(count))

    @property
    def _has_inputs(self) -> bool:
        """Whether F_h has inputs from an anchor's position."""
        return self.settings.entropy.channels + self.settings.entropy.frequencies > 0

    def _make(self, frame: Frame | None, base_step: Tensor, plane_size: int, width: int) -> RateModel:
        """An entropy model for the anchors as they are. plane_size: B. width: of the hidden layers of F_h and CARM."""
        scaffold, learning = self.scaffold, self.settings.learning
        symbols = torch.cat([scaffold.tables[kind] / base_step[i] for i, kind in enumerate(KINDS)], dim=1).double()
        # One anchor has no deviation.
        spread = symbols.std(dim=0) if len(symbols) > 1 else torch.ones_like(symbols[0])
        mean, deviation = symbols.mean(dim=0).cpu().numpy(), spread.cpu().numpy()
        entropy = self.settings.entropy
        model = RateModel(plane_size, width, mean, deviation, self.run.random, entropy, columns=scaffold.columns)
        model.to(self.run.device)
        self.model, self.frame, self.base_step = model, frame, base_step
        self._place()
        groups = [
            {"params": [model.latents], "decay": learning.planes},
            {"params": model.coding_parameters(), "decay": learning.coding},
        ]
        self.optimiser = torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)
        return model

    def anchors_changed(self) -> None:
        """Computes the contexts of the remaining anchors. The frame and the planes stay."""
        if self.model is not None:
            self._place()

    def _place(self) -> None:
        cells, plane_size = lattice_positions(self.scaffold.lattice), self.started().latents.shape[-1]
        with self.run.device:
            self.contexts = contexts(self.frame, cells, plane_size, self.settings.entropy.frequencies)

    def round_activations(self) -> None:
        """Switches to the decoder's activations, with units from all anchors."""
        model = self.started()
        symbols, rows = model.symbols(None), torch.arange(self.scaffold.count, device=self.run.device)
        with torch.no_grad():
            inputs = self.contexts.inputs(symbols, rows, False)
            step = model.steps(model.activations(inputs))[:, :1] * self.base_step[0]
            features = self.scaffold.tables["features"] / step
        model.calibrate(inputs, features, symbols)

    def finish(self) -> None:
        if self.model is None:
            self.start()
        if not self.started().integers:
            self.round_activations()

    def started(self) -> RateModel:
        """The entropy model, which must exist."""
        assert self.model is not None
        return self.model

    # --- a step -------------------------------------------------------------------------------------------------------

    def prepare(self, step: Step) -> None:
        """Draws the anchors whose bits count, and finds the steps of these and of the visible ones."""
        if self.model is None:
            return
        model = self.model
        planes = model.symbols(self.quantisation.noise)
        rows = self._sample(step.rows)
        hidden = model.activations(self.contexts.inputs(planes, torch.cat([step.rows, rows]), model.integers))
        steps = model.steps(hidden) * self.base_step
        visible = len(step.rows)
        step.steps = steps[:visible]
        self._sampled = (rows, hidden[visible:], steps[visible:], planes)

    def _sample(self, visible: Tensor) -> Tensor:
        """The anchors whose bits a step counts: of all (USRO), or of the visible ones (ViSRO)."""
        sampling, everyone = self.settings.sampling, self.settings.sampling.among == "all"
        count = self.scaffold.count if everyone else len(visible)
        some = min(max(int(sampling.share * self.scaffold.count), sampling.least), count)
        drawn = torch.randperm(count, generator=self.run.noise, device=visible.device)[:some]
        return drawn if everyone else visible[drawn]

    def loss(self, step: Step) -> Tensor | None:
        """lambda_r L_rate: bits of an attribute's parameter, and the planes' share of it."""
        if self.model is None:
            return None
        settings = self.settings.rate
        rows, hidden, steps, planes = self._sampled
        leaves = self.scaffold.leaves(rows)
        step.taken.append((rows, leaves))
        symbols = self.quantisation.symbols([leaves[kind] for kind in KINDS], steps)
        kept = self.masks.kept(leaves["masks"], rows)
        bits = self.model.attribute_bits(hidden, symbols, kept).mean(dim=0)
        # N includes the dropped anchors: the weight of the others' bits does not change when some are dropped.
        symbols_of_all = self.masks.total * self.scaffold.columns.width
        loss = bits.sum() * self.scaffold.count / symbols_of_all
        if self.run.clock.done % settings.plane_period == 0:
            # A-RDO: the term is not scaled up for the steps that lack it.
            loss = loss + settings.planes * self.model.plane_bits(planes) / symbols_of_all
        return settings.lambda_r * loss

    def descend(self, step: Step) -> None:
        """A step of Adam for planes and coding networks."""
        if self.model is None:
            return
        self.model.hold_scalings()
        torch.nn.utils.clip_grad_norm_(self.model.coding_parameters(), self.settings.learning.clip)
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(group["decay"], self.run.clock.since(self.name))
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)

    # --- looking ------------------------------------------------------------------------------------------------------

    def show(self, sight: Sight) -> None:
        if self.model is not None:
            sight.steps = self.steps(sight.rows)

    @torch.no_grad()
    def steps(self, rows: Tensor) -> Tensor:
        """The steps of some anchors with rounded planes [n, 3]."""
        model = self.started()
        inputs = self.contexts.inputs(model.symbols(None), rows, model.integers)
        return model.steps(model.activations(inputs)) * self.base_step

    @torch.no_grad()
    def bits(self, kept: Tensor) -> tuple[Tensor, float]:
        """Ideal code lengths with everything rounded: of features, scalings and offsets [3], and of the planes.

        kept: which offsets are, bool [N, K].
        """
        model = self.started()
        planes, bits = model.symbols(None), torch.zeros(3, device=kept.device)
        for rows in torch.arange(self.scaffold.count, device=kept.device).split(BLOCK):
            hidden = model.activations(self.contexts.inputs(planes, rows, model.integers))
            steps = model.steps(hidden) * self.base_step
            symbols = [
                torch.floor(self.scaffold.tables[kind][rows] / steps[:, i : i + 1] + 0.5)
                for i, kind in enumerate(KINDS)
            ]
            bits += model.attribute_bits(hidden, torch.cat(symbols, dim=1), kept[rows].float()).sum(dim=0)
        return bits, float(model.plane_bits(planes))

    # --- the saved state ----------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """The frame, the base steps, the model with its moments, and whether it is rounded."""
        if self.model is None:
            return {}
        frame = {}
        if self.frame is not None:
            frame = {f"frame.{name}": torch.from_numpy(np.asarray(getattr(self.frame, name))) for name in _FRAME}
        model = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        more = {"base_step": self.base_step, "integers": self.model.integers}
        return {**frame, **model, **moments(self.optimiser), **more}

    def restore(self, state: Saved) -> None:
        if not state.names():
            return
        frame = self._restored_frame(state) if self._has_inputs else None
        base_step = state.tensor("base_step", (len(KINDS),), low=BASE_STEP_MIN).to(self.run.device)
        # The plane size and the width follow from the number of anchors when the rate began, which may have changed.
        latents = state.tensor("model.latents", (None,) * 4)
        plane_size, width = latents.shape[-1], choose_width(0)
        sizes = [("model.latents", plane_size, choose_plane_size)] if self.settings.entropy.channels else []
        # A network with a hidden layer of that width, if there is one.
        wide = "hyper" if self._has_inputs else "carm.0" if len(self.settings.entropy.slices) > 1 else None
        if self.settings.entropy.layers and wide:
            name = f"model.{wide}.biases.0"
            width = state.tensor(name, (None,)).shape[0]
            sizes.append((name, width, choose_width))
        for name, size, choose in sizes:
            if not choose(0) <= size <= choose(ANCHORS_MAX):
                raise state.fault(name, f"must have a size of {choose(0)} to {choose(ANCHORS_MAX)}, but has {size}")
        model = self._make(frame, base_step, plane_size if self.settings.entropy.channels else 0, width)
        state.module("model.", model)
        model.set_integers(state.value("integers", bool))
        restore_moments(self.optimiser, state)

    @staticmethod
    def _restored_frame(state: Saved) -> Frame:
        """The frame of a saved state. Raises ValueError."""
        arrays = [
            state.tensor(f"frame.{name}", shape, torch.int64, low, high).numpy()
            for name, (shape, low, high) in _FRAME.items()
        ]
        frame = Frame(*arrays)
        if (frame.high <= frame.low).any():
            raise state.fault("frame.high", "is not above frame.low")
        return frame
