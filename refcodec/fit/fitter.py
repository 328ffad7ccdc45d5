"""The fitter: frame, planes, F_h, SARM and CARM for frozen attributes, by rate alone (SPEC.md B.5)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors.torch
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..attributes import KINDS
from ..codec import PLANE_SHIFT_MAX
from ..geometry import UNIT, contract, frame_coordinates, position_integers, rescale
from ..limits import MAIN_SLICES
from ..networks import ACTIVATION_MAX
from ..planes import PLANE_SYMBOL_MAX
from ..quantise import (
    AnchorCloud,
    carm_shifts,
    choose_frame,
    choose_grid,
    choose_lanes,
    choose_plane_size,
    order_anchors,
    quantise,
    symbols,
)
from ..scene import Dimensions, RenderInfo, Scene
from .model import PLANE_UNIT, EntropyNet, gaussian_bits
from .voxelise import display_networks

# Anchors of one step, drawn from all alike (USRO).
BATCH = 4096
# The plane term is evaluated every so many steps (A-RDO), and then counts for all of them: here the rate is the whole loss.
PLANE_INTERVAL = 4
# Share of the steps with noise on the planes, before they are rounded; and before activations and outputs are.
NOISE_SHARE, FLOAT_SHARE = 0.5, 0.6
# Steps between two saved states.
SAVE_INTERVAL = 500
# Default steps of features, scalings (logarithms) and offsets at index 32.
BASE_STEP = (0.125, 0.0625, 0.125)

Progress = Callable[[int, int, float], None]


@dataclass(frozen=True, eq=False)
class FitResult:
    """The fitted scene, and the trained network that it came from."""

    scene: Scene
    net: EntropyNet
    bits_per_anchor: float


def main_dimensions(plane_size: int) -> Dimensions:
    """Profile Main with this B (SPEC 11.1)."""
    return Dimensions(10, MAIN_SLICES, 8, 10, plane_size, (100,), (16, 16), (100,), 50)


def _gamma(z: Tensor, frequencies: int) -> Tensor:
    """gamma(z'), [n, 2 L]: sine and cosine of each frequency in turn (equation of the paper). z [n] in -1..1."""
    phase = z[:, None] * (math.pi * 2.0 ** torch.arange(frequencies, dtype=z.dtype))
    return torch.stack([torch.sin(phase), torch.cos(phase)], 2).reshape(len(z), -1)


@dataclass(frozen=True, eq=False)
class _Data:
    """What a fit is trained on: u [n, 3] in -1..1, symbols [n, D] with 0 where masked, kept [n, D]."""

    u: Tensor
    symbols: Tensor
    kept: Tensor

    def context(self, net: EntropyNet, planes: Tensor, rows: Tensor | slice) -> Tensor:
        u = self.u[rows]
        return net.context(planes, u[:, :2], _gamma(u[:, 2], net.dimensions.frequency_count))

    def bits(self, net: EntropyNet, planes: Tensor, rows: Tensor | slice, rounded: bool) -> Tensor:
        """Bits of the kept attributes of some anchors, [rows, D], 0 where masked."""
        y = self.symbols[rows]
        mean, scale = net.parameters_of(self.context(net, planes, rows), y, rounded)
        return torch.where(self.kept[rows], gaussian_bits(y, mean, scale), torch.zeros((), dtype=y.dtype))


def _statistics(values: NDArray, kept: NDArray[np.bool_]) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (at least 1/4 step) of each channel over its kept symbols."""
    count = np.maximum(kept.sum(axis=0), 1)
    mean = np.where(kept, values, 0).sum(axis=0) / count
    spread = np.sqrt((np.where(kept, values - mean, 0) ** 2).sum(axis=0) / count)
    return torch.tensor(mean, dtype=torch.float32), torch.tensor(np.maximum(spread, 0.25), dtype=torch.float32)


def fit(
    cloud: AnchorCloud,
    *,
    voxel: float | None = None,
    steps: int = 3000,
    base_step: tuple[float, float, float] = BASE_STEP,
    seed: int = 0,
    plane_size: int | None = None,
    render: RenderInfo | None = None,
    networks: dict | None = None,
    state: Path | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Fits an entropy model to a cloud in profile Main and quantises it.

    voxel: the lattice of the positions, if they have one. networks: rendering networks (default: coloured points). state: a file that is
    written every 500 steps and on Ctrl-C; if it is there, the fit goes on from it. Ctrl-C ends the training early and leaves a usable
    result. The same seed, data and torch give the same scene. Raises ValueError for what cannot be quantised.
    """
    torch.manual_seed(seed)
    grid = choose_grid(cloud.positions, voxel)
    ordered, positions = order_anchors(cloud, grid)
    if len(positions) == 0:
        raise ValueError("no anchor keeps an offset")
    frame = choose_frame(positions)
    dimensions = main_dimensions(plane_size or choose_plane_size(len(positions)))
    base_step = tuple(float(np.float32(s)) for s in base_step)  # type: ignore[assignment]
    middle = np.full(len(positions), 32, np.uint8)
    coded = [symbols(getattr(ordered, kind), middle, base_step[i]).reshape(len(positions), -1) for i, kind in enumerate(KINDS)]
    everything = np.concatenate(coded, axis=1)
    kept = np.ones(everything.shape, dtype=bool)
    kept[:, -3 * dimensions.offset_count :] = np.repeat(ordered.masks, 3, axis=1)
    u = rescale(frame, contract(frame_coordinates(frame, position_integers(positions)))) * (2 / UNIT) - 1
    data = _Data(torch.tensor(u, dtype=torch.float32), torch.tensor(everything, dtype=torch.float32), torch.tensor(kept))
    net = EntropyNet(dimensions, *_statistics(everything, kept))
    _train(net, data, steps, state, progress)
    return _result(net, data, cloud, dimensions, voxel, base_step, render, networks, coded[0])


def _train(net: EntropyNet, data: _Data, steps: int, state: Path | None, progress: Progress | None) -> None:
    count, width = data.symbols.shape
    groups = [{"params": [net.planes], "lr": 0.02}, {"params": [p for n, p in net.named_parameters() if n != "planes"], "lr": 0.004}]
    optimiser = torch.optim.Adam(groups)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, [g["lr"] for g in groups], total_steps=max(steps, 2), pct_start=0.1)
    generator = torch.Generator().manual_seed(torch.initial_seed())
    start = 0
    if state is not None and state.exists():
        start = _load(state, net, optimiser, schedule, generator)
    step = start
    try:
        for step in range(start, steps):
            mode = "noise" if step < NOISE_SHARE * steps else "round"
            rounded = step >= FLOAT_SHARE * steps
            rows = torch.randint(count, (min(BATCH, count),), generator=generator)
            planes = net.coded_planes(mode)
            rate = data.bits(net, planes, rows, rounded).sum() / len(rows)
            if step % PLANE_INTERVAL == 0:
                rate = rate + PLANE_INTERVAL * net.plane_bits(planes, rounded).sum() / count
            optimiser.zero_grad()
            (rate / width).backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            if progress is not None:
                progress(step + 1, steps, float(rate.detach()))
            if state is not None and (step + 1) % SAVE_INTERVAL == 0:
                _save(state, step + 1, net, optimiser, generator)
    except KeyboardInterrupt:
        if state is not None:
            _save(state, step, net, optimiser, generator)


def _save(state: Path, step: int, net: EntropyNet, optimiser: torch.optim.Adam, generator: torch.Generator) -> None:
    """The whole state of a training as one safetensors file, replaced at once."""
    tensors = {f"net.{k}": v.detach().clone() for k, v in net.state_dict().items()}
    for index, moments in optimiser.state_dict()["state"].items():
        tensors |= {f"adam.{index}.{k}": v.detach().clone() for k, v in moments.items()}
    tensors["generator"] = generator.get_state()
    tensors["global"] = torch.get_rng_state()
    tensors["step"] = torch.tensor(step)
    part = state.with_suffix(".part")
    safetensors.torch.save_file(tensors, part)
    part.replace(state)


def _load(
    state: Path,
    net: EntropyNet,
    optimiser: torch.optim.Adam,
    schedule: torch.optim.lr_scheduler.OneCycleLR,
    generator: torch.Generator,
) -> int:
    """Continues from a saved state; raises ValueError if it belongs to another scene."""
    tensors = safetensors.torch.load_file(state)
    try:
        net.load_state_dict({k.removeprefix("net."): v for k, v in tensors.items() if k.startswith("net.")})
    except RuntimeError as error:
        raise ValueError(f"{state} is the state of another fit ({error}); delete it to start anew") from None
    moments: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        if key.startswith("adam."):
            _, index, name = key.split(".")
            moments.setdefault(int(index), {})[name] = value
    optimiser.load_state_dict({"state": moments, "param_groups": optimiser.state_dict()["param_groups"]})
    generator.set_state(tensors["generator"])
    torch.set_rng_state(tensors["global"])
    step = int(tensors["step"])
    for _ in range(step):
        schedule.step()
    return step


def _result(
    net: EntropyNet,
    data: _Data,
    cloud: AnchorCloud,
    dimensions: Dimensions,
    voxel: float | None,
    base_step: tuple[float, float, float],
    render: RenderInfo | None,
    networks: dict | None,
    features: NDArray[np.int32],
) -> FitResult:
    """The scene of a trained network."""
    with torch.no_grad():
        rounded = torch.floor(net.planes * PLANE_UNIT + 0.5).clamp(-PLANE_SYMBOL_MAX, PLANE_SYMBOL_MAX)
        net.planes.copy_(rounded / PLANE_UNIT)
        planes = rounded.numpy().astype(np.int16)
        bits = np.mean([float(data.bits(net, net.planes, rows, True).sum(1).mean()) for rows in _blocks(len(data.symbols))])
    plane_shift = PLANE_SHIFT_MAX
    while plane_shift and int(np.abs(planes.astype(np.int64)).max()) << plane_shift > ACTIVATION_MAX:
        plane_shift -= 1
    shifts = carm_shifts(features, dimensions.carm_inputs)
    coding = net.export(plane_shift, shifts)
    drawing = networks or display_networks(dimensions)
    half = choose_grid(cloud.positions, voxel)
    positions = order_anchors(cloud, half)[1]
    scene = quantise(
        cloud,
        dimensions=dimensions,
        networks={name: (coding | drawing)[name] for name in dimensions.network_shapes()},
        frame=choose_frame(positions),
        grid=half,
        planes=planes,
        plane_shift=plane_shift,
        carm_shift=shifts,
        base_step=base_step,
        render=render,
        lanes=choose_lanes(len(positions), float(bits)),
    )
    return FitResult(scene, net, float(bits))


def _blocks(count: int) -> list[slice]:
    return [slice(a, a + BATCH) for a in range(0, count, BATCH)]


def ideal_bits(result: FitResult) -> dict[str, float]:
    """Ideal code length, in bits, of attributes and planes under the float network in float64: no activation, weight, output, interpolation
    weight or sine is rounded, and the distributions are continuous ones integrated over each bin."""
    net = EntropyNet(result.net.dimensions, result.net.centre, result.net.spread).double()
    net.load_state_dict({k: v.double() for k, v in result.net.state_dict().items()})
    scene = result.scene
    u = rescale(scene.frame, contract(frame_coordinates(scene.frame, position_integers(scene.positions)))) * (2 / UNIT) - 1
    a = scene.attributes
    count = scene.anchor_count
    y = np.concatenate([a.features, a.scalings, a.offsets.reshape(count, -1)], axis=1)
    kept = np.ones(y.shape, dtype=bool)
    kept[:, -3 * scene.dimensions.offset_count :] = np.repeat(scene.masks, 3, axis=1)
    data = _Data(torch.tensor(u, dtype=torch.float64), torch.tensor(y, dtype=torch.float64), torch.tensor(kept))
    with torch.no_grad():
        attributes = sum(float(data.bits(net, net.planes, rows, False).sum()) for rows in _blocks(count))
        planes = float(net.plane_bits(net.planes, False).sum())
    return {"attributes": attributes, "planes": planes}
