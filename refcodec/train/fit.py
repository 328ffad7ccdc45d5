"""The fitter: planes, F_h, SARM and CARM for a scene that has none, by its rate only (SPEC.md Annex B.5).

Steps are fixed before training (index 32 everywhere, multiplier one), so the symbols are too. Nothing but their code
length is minimised: bits of attributes over uniformly drawn anchors (the paper's USRO) and, every few steps, bits of
planes (A-RDO).
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from msgspec import Struct
from numpy.typing import NDArray
from torch import Tensor

from ..bitstream.attributes import KINDS
from ..bitstream.batches import Progress
from ..bitstream.codec import derive_steps
from ..bitstream.dimensions import RENDER_MODELS, RENDERING, STATIC, Dimensions
from ..bitstream.limits import MAIN, PROFILES, dimension_fault
from ..bitstream.networks import Layer
from ..bitstream.planes import PLANE_SYMBOL_MAX, PLANES
from ..bitstream.scene import Scene
from ..encoder.cloud import AnchorCloud
from ..encoder.frame import choose_frame
from ..encoder.positions import choose_grid
from ..encoder.quantise import carm_shifts, order_anchors, quantise, varying
from ..encoder.quantise import symbols as to_symbols
from ..encoder.sizes import choose_plane_size, choose_slices, choose_width
from .fit_input import Given
from .optimisers import moments, restore_moments
from .rate_model.columns import Columns
from .rate_model.hyperprior import contexts
from .rate_model.model import SARM_WIDTH, RateModel
from .rate_model.units import PLANE_SHIFT, STEP_ONE
from .rendering_networks import RENDER_WIDTH
from .settings import BASE_LAMBDA, EntropySettings, FitSettings, QuantisationSettings
from .settings_file import document
from .state import Keeper, Saved, is_saved, restore, run_steps
from .voxelise import display_networks

# Anchors of a block, whose temporary arrays are small; and the most anchors that give activations their units at last.
BLOCK, CALIBRATED = 1 << 16, 1 << 17
# The most anchors that a fit learns from, evenly along the Morton curve. A million have no fewer bytes with all.
SAMPLE = 1 << 18


@dataclass(frozen=True, eq=False)
class FitResult:
    """scene: ready for codec.emit. report: the choices and results (seconds, steps, base_step, history, ...)."""

    scene: Scene
    report: dict[str, Any]


def fit(
    given: Given,
    settings: FitSettings | None = None,
    *,
    progress: Progress | None = None,
    state: str | Path | None = None,
) -> FitResult:
    """Fits the coding networks and planes of Main to anchors, and quantises them.

    settings: None for the defaults. state: the file of the saved state, from which training continues if it exists.
    An interrupt (Ctrl-C) ends training early with a complete scene. Equal arguments give equal results, whatever
    the number of threads. Raises ValueError for anchors that cannot be written, or a state of other settings.
    """
    started, settings = time.perf_counter(), settings or FitSettings()
    scene, anchors = _start(given, settings), len(given.cloud.positions)
    # Its arrays need memory.
    del given
    threads = torch.get_num_threads()
    # The sums of torch depend on their number.
    torch.set_num_threads(1)
    try:
        fitting = _Fitting(scene, settings)
        if scene.anchor_count and settings.steps:
            fitting.run(progress, Path(state) if state else None)
        fitted = fitting.result()
    finally:
        torch.set_num_threads(threads)
    report = {
        "seconds": time.perf_counter() - started,
        "steps": fitting.done,
        "seed": settings.seed,
        "base_step": scene.base_step,
        "plane_size": scene.dimensions.plane_size,
        "anchors": scene.anchor_count,
        "dropped": anchors - scene.anchor_count,
        "history": fitting.history,
    }
    return FitResult(fitted, report)


# --- the scene before training ----------------------------------------------------------------------------------------


def base_steps(
    cloud: AnchorCloud, steps: QuantisationSettings, lambda_r: float = BASE_LAMBDA
) -> tuple[float, float, float]:
    """Base steps of features, scalings and offsets, each a float32 value.

    Of D + lambda_r R, the squared error D of a small step grows with its square, and the rate R falls
    with its logarithm. Thus the best step grows with the root of lambda_r.
    """
    spread = float(np.median(varying(cloud.features.std(axis=0)))) if len(cloud.features) else 0.0
    coarser = math.sqrt(lambda_r / BASE_LAMBDA)
    features, scalings, offsets = (
        float(np.float32(coarser * step)) for step in (spread * steps.features or 1.0, steps.scalings, steps.offsets)
    )
    return features, scalings, offsets


def fit_dimensions(cloud: AnchorCloud, settings: EntropySettings, render_width: int = RENDER_WIDTH) -> Dimensions:
    """The dimensions of a scene of some anchors (SPEC B.3).

    render_width: of the rendering networks. Raises ValueError for a scene that Main does not hold (SPEC 11.1).
    """
    count, features = cloud.features.shape
    slices = choose_slices(features, settings.slices) if features else ()
    planes, inputs = settings.channels > 0, settings.channels + settings.frequencies > 0
    hidden = (min(choose_width(count), settings.width),) * settings.layers
    d = Dimensions(
        offset_count=cloud.masks.shape[1],
        slices=slices,
        plane_channels=settings.channels,
        frequency_count=settings.frequencies,
        plane_size=choose_plane_size(count) if planes else 0,
        hyper_width=hidden if inputs else (),
        sarm_width=SARM_WIDTH if planes else (),
        carm_width=hidden if len(slices) > 1 else (),
        render_width=render_width,
    )
    fault = dimension_fault(PROFILES[MAIN], d, 0)
    if fault:
        field, value, allowed = fault
        raise ValueError(f"{field} would be {value}; allowed: {allowed} (SPEC.md 11.1)")
    return d


def _rendering(given: Given, d: Dimensions) -> dict[str, list[Layer]]:
    """The rendering networks. Raises ValueError for networks that do not fit the anchors."""
    if given.networks is None:
        return display_networks(d)
    shapes = d.network_shapes()
    for name in RENDERING:
        present = [weight.shape for weight, _ in given.networks[name]]
        if present != list(shapes[name]):
            raise ValueError(f"the rendering network {name} has layers {present}, but must have {list(shapes[name])}")
    return given.networks


def _render_width(given: Given) -> int:
    """The width of the rendering networks' hidden layer."""
    return len(given.networks[RENDERING[0]][0][1]) if given.networks else RENDER_WIDTH


def _start(given: Given, settings: FitSettings) -> Scene:
    """A scene with symbols, and with coding networks and planes of zeros, anchors in order."""
    cloud = given.cloud
    grid = given.grid or choose_grid(cloud.positions, given.voxel)
    try:
        ordered, half = order_anchors(cloud, grid)
    except ValueError:
        # Some anchors lie farther from the middle than fp16 reaches on the lattice.
        grid = choose_grid(cloud.positions)
        ordered, half = order_anchors(cloud, grid)
    d = fit_dimensions(ordered, settings.entropy, _render_width(given))
    if given.render.render_model == STATIC and given.networks:
        colours = len(given.networks[RENDERING[2]][-1][1]) // d.offset_count
        d = replace(d, view_inputs=RENDER_MODELS[STATIC][0], colour_outputs=colours)
    base_step = given.base_step or base_steps(
        cloud, settings.scene if given.networks else settings.quantisation, settings.lambda_r
    )
    networks: dict[str, list[Layer]] = {
        name: [(np.zeros(shape, np.float32), np.zeros(shape[0], np.float32)) for shape in shapes]
        for name, shapes in d.network_shapes().items()
    }
    networks["hyper"][-1][1][-len(KINDS) :] = STEP_ONE
    networks.update(_rendering(given, d))
    steps = np.full(len(ordered.features), STEP_ONE, np.uint8)
    shifts = carm_shifts(to_symbols(ordered.features, steps, base_step[0]), d.carm_inputs)
    # Its copies need memory.
    del ordered
    return quantise(
        cloud,
        dimensions=d,
        networks=networks,
        frame=choose_frame(half) if d.has_frame else None,
        grid=grid,
        planes=np.zeros((PLANES, d.plane_channels, d.plane_size, d.plane_size), np.int16),
        plane_shift=PLANE_SHIFT if d.plane_channels else 0,
        carm_shift=shifts,
        base_step=base_step,
        render=given.render,
        profile=MAIN,
        cameras=given.cameras,
    )


def _columns(scene: Scene, rows: slice) -> NDArray[np.float32]:
    """The symbols of all attributes of some anchors, float32 [n, D]."""
    a = scene.attributes
    offsets = a.offsets[rows].reshape(-1, 3 * scene.dimensions.offset_count)
    parts = a.features[rows], a.scalings[rows], offsets
    return np.concatenate(parts, axis=1, dtype=np.float32, casting="same_kind")


def _statistics(
    masks: NDArray[np.bool_], columns: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and deviation of each channel's symbols, float64 [D]. A channel without symbols has 0 and 1.

    masks: bool [n, K]. columns: as _columns.
    """
    kept = np.repeat(masks, 3, axis=1)
    blocks = [slice(begin, begin + BLOCK) for begin in range(0, len(columns), BLOCK)]

    def total(function: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Of large scenes, there is no copy in float64."""
        sums = np.zeros(columns.shape[1])
        for rows in blocks:
            values = function(columns[rows].astype(np.float64))
            values[:, -kept.shape[1] :] *= kept[rows]
            sums += values.sum(axis=0)
        return sums

    count = total(np.ones_like)
    mean = total(lambda values: values) / np.maximum(count, 1)
    variance = total(lambda values: (values - mean) ** 2) / np.maximum(count, 1)
    return mean, np.where(count > 0, np.sqrt(variance), 1.0)


# --- training ---------------------------------------------------------------------------------------------------------


class _Note(Struct, forbid_unknown_fields=True):
    """An entry of the history in a saved state."""

    step: int
    bits: float
    planes: float


class _Fitting:
    """A fit in progress (state.Savable).

    symbols: float32 [n, D], and kept: float32 [n, K], of the anchors that are drawn. total: the number of all anchors.
    history: step, bits of an attribute's symbol and bits of all planes, now and then.
    """

    def __init__(self, scene: Scene, settings: FitSettings) -> None:
        d, a = scene.dimensions, scene.attributes
        self.scene, self.settings = scene, settings
        self.total = scene.anchor_count
        rows = slice(None, None, -(-self.total // SAMPLE) or 1)
        self.symbols = torch.from_numpy(_columns(scene, rows))
        self.kept = torch.from_numpy(scene.masks[rows].astype(np.float32))
        self.count = len(self.kept)
        self.symbol_count = (d.features + a.scalings.shape[1]) * self.total + 3 * float(scene.masks.sum())
        start = torch.Generator().manual_seed(settings.seed)
        self.contexts = contexts(scene.frame, scene.positions[rows], d.plane_size, d.frequency_count)
        sizes = d.plane_size, min(choose_width(self.total), settings.entropy.width)
        columns = Columns(d.slices, d.offset_count)
        statistics = _statistics(scene.masks[rows], self.symbols.numpy())
        self.model = RateModel(*sizes, *statistics, start, settings.entropy, scene.carm_shift, columns)
        groups = [{"params": [self.model.latents]}, {"params": self.model.coding_parameters()}]
        self.optimiser = torch.optim.Adam(groups)
        rates = [settings.plane_learning_rate, settings.network_learning_rate]
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(self.optimiser, rates, total_steps=max(settings.steps, 1))
        self.draw = torch.Generator().manual_seed(settings.seed)
        self.done, self.plane_bits = 0, 0.0
        self.history: list[tuple[int, float, float]] = []

    def run(self, progress: Progress | None, state: Path | None) -> None:
        """Trains to the end, or until an interrupt (state.run_steps)."""
        if state is not None and is_saved(state):
            restore(self, state)
        keep, steps = Keeper(self, state) if state is not None else None, self.settings.steps

        def step() -> None:
            self._step()
            if progress:
                progress("fit", self.done, steps)

        run_steps(step, lambda: self.done == steps, keep, self.settings.save_seconds)

    def _step(self) -> None:
        settings, model = self.settings, self.model
        if self.done >= int(settings.steps * settings.integers) and not model.integers:
            drawn = torch.randperm(self.count, generator=self.draw)[: settings.calibration * settings.batch]
            self._calibrate(drawn)
        planes = model.symbols(self.draw if self.done < int(settings.steps * settings.rounding) else None)
        batch = min(settings.batch, self.count)
        rows = torch.randint(self.count, (batch,), generator=self.draw)
        hidden = model.activations(self.contexts.inputs(planes, rows, model.integers))
        bits = model.attribute_bits(hidden, self.symbols[rows], self.kept[rows]).sum()
        loss = bits * (self.total / batch)
        if self.done % settings.plane_period == 0:
            plane_bits = model.plane_bits(planes)
            self.plane_bits = float(plane_bits.detach())
            # Scaled up, so that the expectation is right.
            loss = loss + settings.plane_period * plane_bits
        self.optimiser.zero_grad(set_to_none=True)
        (loss / (self.symbol_count + planes.numel())).backward()
        torch.nn.utils.clip_grad_norm_(model.coding_parameters(), settings.clip)
        self.optimiser.step()
        self.schedule.step()
        self.done += 1
        if self.done % max(settings.steps // settings.notes, 1) == 0:
            each = float(bits.detach()) * self.total / batch / self.symbol_count
            self.history.append((self.done, each, self.plane_bits))

    @torch.no_grad()
    def _calibrate(self, rows: Tensor) -> None:
        """Switches to the decoder's activations, with units that fit some anchors."""
        planes, model = self.model.symbols(None), self.model
        earlier = model.carm_inputs(self.symbols[rows, : self.scene.dimensions.carm_inputs])
        model.calibrate(self.contexts.inputs(planes, rows, False), earlier, planes)

    @torch.no_grad()
    def result(self) -> Scene:
        """The scene with the planes and networks as they are."""
        if self.done:
            self._calibrate(torch.arange(0, self.count, -(-self.count // CALIBRATED)))
        planes = self.model.symbols(None).numpy().clip(-PLANE_SYMBOL_MAX, PLANE_SYMBOL_MAX).astype(np.int16)
        fitted = replace(self.scene, planes=planes, networks={**self.scene.networks, **self.model.networks()})
        assert np.array_equal(derive_steps(fitted), self.scene.attributes.steps)
        return fitted

    # --- the saved state ----------------------------------------------------------------------------------------------

    def fingerprint(self) -> dict[str, Any]:
        """As state.Savable."""
        return {"settings": document(self.settings), "anchors": self.total, "planes": list(self.model.latents.shape)}

    def state(self) -> dict[str, Any]:
        model = {f"model.{name}": value for name, value in self.model.state_dict().items()}
        values = {
            "done": self.done,
            "integers": self.model.integers,
            "history": [dict(zip(("step", "bits", "planes"), entry, strict=True)) for entry in self.history],
            "draw": self.draw.get_state(),
        }
        return {**model, **moments(self.optimiser), **values}

    def restore(self, state: Saved) -> None:
        state.module("model.", self.model)
        self.model.set_integers(state.value("integers", bool))
        restore_moments(self.optimiser, state)
        state.generator("draw", self.draw)
        self.history = [(note.step, note.bits, note.planes) for note in state.value("history", list[_Note])]
        self.done = state.integer("done", 0, self.settings.steps)
        if self.done:
            # The learning rates follow only from the number of steps: this is their state after `done` of them.
            self.schedule.last_epoch = self.done - 1
            self.schedule._step_count = self.done
            self.schedule.step()
