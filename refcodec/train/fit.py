"""The fitter: planes, F_h, SARM and CARM for a scene that has none, by rate alone (SPEC.md Annex B.5).

Steps are fixed before training (index 32 everywhere, multiplier one), so the symbols are too, and nothing but their code length is
minimised: bits of attributes over uniformly drawn anchors (the paper's USRO) and, every fourth step, bits of planes (A-RDO).
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from benchmarks.ideal import ideal_code_length

from ..bitstream.attributes import KINDS
from ..bitstream.batches import Progress
from ..bitstream.codec import derive_steps
from ..bitstream.context import contract, frame_coordinates, positional_encoding, rescale
from ..bitstream.conventions import rshift_round
from ..bitstream.dimensions import Dimensions
from ..bitstream.limits import MAIN, MAIN_SLICES
from ..bitstream.networks import Layer, activation
from ..bitstream.planes import PLANE_SYMBOL_MAX, PLANES
from ..bitstream.positions import position_integers
from ..bitstream.scene import Scene
from ..encoder.cloud import AnchorCloud
from ..encoder.frame import choose_frame
from ..encoder.positions import choose_grid
from ..encoder.quantise import carm_shifts, order_anchors, quantise
from ..encoder.quantise import symbols as to_symbols
from ..encoder.sizes import choose_plane_size, choose_width
from .rate_model import PLANE_SHIFT, STEP_ONE, PlaneSamples, RateModel
from .voxelise import display_networks

# Anchors of one step of training.
BATCH = 4096
# Largest learning rates of planes and of networks under the one-cycle schedule.
PLANE_RATE, NETWORK_RATE = 0.01, 0.008
# The paper's A-RDO: the plane term takes part in every fourth step; four times its bits keep the expectation right.
PLANE_PERIOD = 4
# Shares of the steps after which planes are rounded in place of noise, and activations as in the decoder.
ROUND_PLANES, ROUND_ACTIVATIONS = 0.6, 0.85
# Default steps: a third of the features' spread; 0.1 in a natural logarithm of a scaling; the paper's 0.2 for offsets.
FEATURE_SPREAD, SCALING_STEP, OFFSET_STEP = 1 / 3, 0.1, 0.2
# Seconds between two savings of the state.
SAVE_SECONDS = 30.0


@dataclass(frozen=True, eq=False)
class FitResult:
    """scene: ready for codec.emit; report: what was chosen and reached (seconds, steps, base_step, history, ...)."""

    scene: Scene
    report: dict[str, Any]


def ideal_bits(result: FitResult) -> dict[str, float]:
    """Code length in bits of `attributes` and `planes` under the float64 network that nothing rounds: see refcodec.fit.ideal."""
    return ideal_code_length(result.scene)


def default_base_step(cloud: AnchorCloud) -> tuple[float, float, float]:
    """Steps of features (a third of the channels' median spread), scalings (0.1) and offsets (0.2), each a float32 value."""
    spread = float(np.median(cloud.features.std(axis=0))) if len(cloud.features) else 0.0
    steps = (spread * FEATURE_SPREAD or 1.0, SCALING_STEP, OFFSET_STEP)
    return (float(np.float32(steps[0])), float(np.float32(steps[1])), float(np.float32(steps[2])))


def default_dimensions(cloud: AnchorCloud, plane_size: int) -> Dimensions:
    """Main's dimensions (SPEC 11.1, B.3). Raises ValueError if the cloud does not have 50 features and 10 offsets."""
    width = choose_width(len(cloud.positions))
    d = Dimensions(10, MAIN_SLICES, 8, 10, plane_size, (width,), (16, 16), (width,), 50)
    if cloud.features.shape[1] != d.features or cloud.masks.shape[1] != d.offset_count:
        raise ValueError(f"{cloud.features.shape[1]} features and {cloud.masks.shape[1]} offsets; Main has 50 and 10")
    return d


class _Data:
    """What training reads of the anchors, as tensors: samples of the planes, gamma, symbols, CARM's inputs, kept offsets."""

    def __init__(self, scene: Scene) -> None:
        d, a = scene.dimensions, scene.attributes
        u = rescale(scene.frame, contract(frame_coordinates(scene.frame, position_integers(scene.positions))))
        self.samples = PlaneSamples(u[:, :2], d.plane_size)
        self.gamma = torch.from_numpy(positional_encoding(u[:, 2], d.frequency_count).astype(np.float32))
        flat = [a.features, a.scalings, a.offsets.reshape(len(u), -1)]
        self.symbols = torch.from_numpy(np.concatenate(flat, axis=1).astype(np.float32))
        earlier = activation(
            rshift_round(a.features[:, : d.carm_inputs].astype(np.int64), scene.carm_shift.astype(np.int64))
        )
        self.earlier = torch.from_numpy(earlier.astype(np.float32))
        self.kept = torch.from_numpy(np.repeat(scene.masks, 3, axis=1).astype(np.float32))
        self.count = len(u)
        plane_symbols = PLANES * d.plane_channels * d.plane_size**2
        self.total = (d.features + 6) * len(u) + float(self.kept.sum()) + plane_symbols

    def context(self, symbols: torch.Tensor, rows: torch.Tensor, rounding: bool) -> torch.Tensor:
        """Inputs of F_h for the anchors `rows`."""
        return torch.cat([self.samples.query(symbols, rows, rounding), self.gamma[rows]], dim=1)


def _start(
    cloud: AnchorCloud, voxel: float | None, base_step: tuple[float, float, float], plane_size: int | None
) -> Scene:
    """A scene with symbols and empty planes and networks, anchors in order."""
    grid = choose_grid(cloud.positions, voxel)
    try:
        ordered, _ = order_anchors(cloud, grid)
    except ValueError:
        # Some anchors lie farther from the middle than fp16 reaches on the lattice.
        grid = choose_grid(cloud.positions)
        ordered, _ = order_anchors(cloud, grid)
    d = default_dimensions(cloud, plane_size or choose_plane_size(len(ordered.positions)))
    planes = np.zeros((PLANES, d.plane_channels, d.plane_size, d.plane_size), np.int16)
    networks: dict[str, list[Layer]] = {
        name: [(np.zeros(shape, np.float32), np.zeros(shape[0], np.float32)) for shape in shapes]
        for name, shapes in d.network_shapes().items()
    }
    networks["hyper"][-1][1][-len(KINDS) :] = STEP_ONE
    networks.update(display_networks(d))
    steps = np.full(len(ordered.features), STEP_ONE, np.uint8)
    shift = carm_shifts(to_symbols(ordered.features, steps, base_step[0]), d.carm_inputs)
    _, half = order_anchors(cloud, grid)
    return quantise(
        cloud,
        dimensions=d,
        networks=networks,
        frame=choose_frame(half),
        grid=grid,
        planes=planes,
        plane_shift=PLANE_SHIFT,
        carm_shift=shift,
        base_step=base_step,
        profile=MAIN,
    )


def _statistics(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and deviation of each channel's symbols, float64 [D]; a channel without symbols has 0 and 1."""
    a, width = scene.attributes, 3 * scene.dimensions.offset_count
    columns = np.concatenate([a.features, a.scalings, a.offsets.reshape(-1, width)], axis=1).astype(np.float64)
    weight = np.ones(columns.shape)
    weight[:, -width:] = np.repeat(scene.masks, 3, axis=1)
    count = weight.sum(axis=0)
    mean = (columns * weight).sum(axis=0) / np.maximum(count, 1)
    variance = ((columns - mean) ** 2 * weight).sum(axis=0) / np.maximum(count, 1)
    return mean, np.where(count > 0, np.sqrt(variance), 1.0)


def fit(
    cloud: AnchorCloud,
    *,
    voxel: float | None = None,
    steps: int = 4000,
    base_step: tuple[float, float, float] | None = None,
    seed: int = 0,
    plane_size: int | None = None,
    progress: Progress | None = None,
    state: str | Path | None = None,
) -> FitResult:
    """Fits the coding networks and planes of Main to a cloud (50 features, 10 offsets) and quantises it.

    voxel: the lattice of the positions, if they have one; base_step: None for default_base_step; plane_size: None for
    choose_plane_size; state: a file where training saves itself, and from which it goes on if it exists. An interrupt (Ctrl-C)
    ends training early and leaves a whole scene. Equal arguments and threads give equal results. Raises ValueError for a cloud
    that cannot be written, or a state of other settings.
    """
    base = base_step or default_base_step(cloud)
    base = (float(np.float32(base[0])), float(np.float32(base[1])), float(np.float32(base[2])))
    scene = _start(cloud, voxel, base, plane_size)
    started = time.perf_counter()
    model = RateModel(scene.dimensions, *_statistics(scene), scene.carm_shift, seed)
    history: list[tuple[int, float, float]] = []
    done = 0
    if scene.anchor_count and steps:
        data = _Data(scene)
        done = _train(model, data, steps, seed, history, progress, Path(state) if state else None)
        with torch.no_grad():
            symbols = model.symbols(None)
            everything = torch.arange(data.count)
            model.set_rounding(data.context(symbols, everything, False), data.earlier, symbols)
    with torch.no_grad():
        planes = model.symbols(None).numpy().clip(-PLANE_SYMBOL_MAX, PLANE_SYMBOL_MAX).astype(np.int16)
    fitted = replace(scene, planes=planes, networks={**scene.networks, **model.networks()})
    assert np.array_equal(derive_steps(fitted), scene.attributes.steps)
    report = {
        "seconds": time.perf_counter() - started,
        "steps": done,
        "seed": seed,
        "base_step": base,
        "plane_size": scene.dimensions.plane_size,
        "anchors": scene.anchor_count,
        "dropped": len(cloud.positions) - scene.anchor_count,
        "history": history,
    }
    return FitResult(fitted, report)


def _train(
    model: RateModel,
    data: _Data,
    steps: int,
    seed: int,
    history: list[tuple[int, float, float]],
    progress: Progress | None,
    state: Path | None,
) -> int:
    """Runs the steps; history gets (step, bits an attribute symbol, bits of all planes) now and then. Returns steps done."""
    networks = [p for name, p in model.named_parameters() if name != "latents"]
    optimiser = torch.optim.Adam([{"params": [model.latents]}, {"params": networks}])
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, [PLANE_RATE, NETWORK_RATE], total_steps=steps)
    draw = torch.Generator().manual_seed(seed)
    settings = {"steps": steps, "seed": seed, "anchors": data.count, "planes": list(model.latents.shape)}
    done = 0
    if state is not None and state.exists():
        done = _resume(state, settings, model, optimiser, schedule, draw, history)
    batch = min(BATCH, data.count)
    plane_symbols = model.latents.numel()
    plane_bits = 0.0
    saved = time.monotonic()
    try:
        while done < steps:
            if done >= int(steps * ROUND_ACTIVATIONS) and not model.hyper.rounding:
                _calibrate(model, data, draw)
            symbols = model.symbols(draw if done < int(steps * ROUND_PLANES) else None)
            rows = torch.randint(data.count, (batch,), generator=draw)
            context = data.context(symbols, rows, model.hyper.rounding)
            bits = model.attribute_bits(context, data.symbols[rows], data.earlier[rows], data.kept[rows])
            loss = bits * (data.count / batch)
            if done % PLANE_PERIOD == 0:
                plane_term = model.plane_bits(symbols)
                plane_bits = float(plane_term.detach())
                loss = loss + PLANE_PERIOD * plane_term
            optimiser.zero_grad(set_to_none=True)
            (loss / data.total).backward()
            torch.nn.utils.clip_grad_norm_(networks, 1.0)
            optimiser.step()
            schedule.step()
            done += 1
            if done % max(steps // 50, 1) == 0:
                history.append(
                    (done, float(bits.detach()) * data.count / batch / (data.total - plane_symbols), plane_bits)
                )
            if progress:
                progress("fit", done, steps)
            if state is not None and (done == steps or time.monotonic() - saved > SAVE_SECONDS):
                _save(state, settings, done, model, optimiser, draw, history)
                saved = time.monotonic()
    except KeyboardInterrupt:
        if state is not None:
            _save(state, settings, done, model, optimiser, draw, history)
    return done


@torch.no_grad()
def _calibrate(model: RateModel, data: _Data, draw: torch.Generator) -> None:
    """Switches to the decoder's activations, with units from a sample of the anchors."""
    symbols = model.symbols(None)
    rows = torch.randperm(data.count, generator=draw)[: 8 * BATCH]
    model.set_rounding(data.context(symbols, rows, False), data.earlier[rows], symbols)


def _save(
    path: Path,
    settings: dict[str, Any],
    done: int,
    model: RateModel,
    optimiser: torch.optim.Optimizer,
    draw: torch.Generator,
    history: list[tuple[int, float, float]],
) -> None:
    """Writes the state, a safetensors file, beside the old one first, so that a crash never leaves half of one."""
    tensors = {f"model.{name}": value.clone().contiguous() for name, value in model.state_dict().items()}
    for index, moments in optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{name}": value.clone().contiguous() for name, value in moments.items()}
    tensors["draw"] = draw.get_state()
    facts = {"settings": settings, "done": done, "rounding": model.hyper.rounding, "history": history}
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".new")
    save_file(tensors, beside, {"state": json.dumps(facts)})
    beside.replace(path)


def _resume(
    path: Path,
    settings: dict[str, Any],
    model: RateModel,
    optimiser: torch.optim.Optimizer,
    schedule: torch.optim.lr_scheduler.OneCycleLR,
    draw: torch.Generator,
    history: list[tuple[int, float, float]],
) -> int:
    """Restores a saved state. Returns the steps done. Raises ValueError if it is damaged, or was saved under other settings."""
    try:
        with safe_open(path, "pt") as file:
            facts = json.loads(file.metadata()["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dictionary)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"the saved state {path} cannot be read ({error}); delete it to start anew") from None
    if facts["settings"] != settings:
        raise ValueError(f"the saved state belongs to {facts['settings']}, not to {settings}")
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in tensors.items():
        if key.startswith("optimiser."):
            _, index, name = key.split(".")
            moments.setdefault(int(index), {})[name] = value
    model.load_state_dict({k.removeprefix("model."): v for k, v in tensors.items() if k.startswith("model.")})
    model.rounding(facts["rounding"])
    optimiser.load_state_dict({"state": moments, "param_groups": optimiser.state_dict()["param_groups"]})
    draw.set_state(tensors["draw"])
    history.extend((int(step), float(attributes), float(planes)) for step, attributes, planes in facts["history"])
    done = int(facts["done"])
    if done:
        # The schedule follows from the number of steps alone: this is its state after `done` of them.
        schedule.last_epoch = done - 1
        schedule._step_count = done
        schedule.step()
    return done
