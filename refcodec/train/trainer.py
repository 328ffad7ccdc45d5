"""Training: photographs to a scene, by Scaffold-GS and CAT-3DGS Pro's rate-distortion optimisation.

The loss of a step is L_Scaffold + lambda_r L_rate + lambda_m L_m (the paper's equation 4). Milestones are shares of the steps:

    growth          anchors grow and are pruned
    masks           the masks' loss takes part
    rate            the frame and the size of the planes are fixed; noise stands for rounding; bits take part in the loss
    rounding        attributes and planes are rounded, with the identity's gradient
    integers        activations of the coding networks are rounded and cut as in the decoder
    weights         weights of all networks are rounded to grids, chosen by rate and distortion
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..bitstream.attributes import KINDS
from ..bitstream.frame import Frame
from ..bitstream.reconstruction import reconstruct
from ..bitstream.scene import Scene
from ..encoder.frame import choose_frame
from ..encoder.sizes import choose_lanes, choose_plane_size, choose_width
from ..encoder.weights import quantise_rendering
from ..folder.uncompressed import Uncompressed
from ..photographs.photographs import PhotographSet
from ..render.camera import Camera
from ..render.rasterise import Settings
from .adam import adam_rows, gather_rows
from .export import coded_scene, position_bytes, render_info, rounded, uncompressed, weight_bytes
from .losses import Photometric
from .rate import HYPERPRIORS, WIDTH, Contexts, LearnedRate
from .scaffold import COLUMNS, NEAR, Scaffold, lattice_positions
from .splat import draw
from .state import save

GROWTH = (0.03, 0.4)
MASKS, RATE, ROUNDING, INTEGERS, WEIGHTS = 0.25, 0.4, 0.6, 0.8, 0.85
# Grids of the weights that are tried: bits of a rendering network's largest weight, and by how many bits those of the coding networks are
# coarser than the integers of SPEC 7.2; grids coarser than these cost held-out images more than the few judges see. Training images that
# judge.
RENDER_BITS, COARSER = range(8, 13), range(4)
JUDGES = 5
# What estimates take for the rendering networks before their grids are chosen.
LIKELY_BITS = 8
# Steps between two growths: statistics need views.
GROWTH_PERIOD = 100
# Weight of the Gaussians' volume, in training units.
VOLUME = 0.01
# The paper: weight of the planes' bits against the attributes'; weight of the masks against lambda_r.
LAMBDA_TRI = 10.0
MASK_LEAST, MASK_SHARE = 1e-3, 0.3
# Anchors whose bits are counted in a step: the paper's share of all, but not fewer.
SAMPLE_SHARE, SAMPLE_LEAST = 0.05, 512
# Looks at held-out images during a training, and images of a look; seconds between two savings of the state.
LOOKS, LOOK_IMAGES, SAVE_SECONDS = 40, 5, 30.0
# Learning rates in the beginning and at the end.
RATES = {"features": (0.01, 0.001), "offsets": (0.01, 1e-4), "scalings": (0.01, 0.001), "masks": (0.1, 0.01)}
# Share of the training in which the first of them is held.
HELD = {"features": 0.6, "offsets": 0.0, "scalings": 0.6, "masks": 0.6}
NETWORK_RATES = {"opacity": (0.004, 2e-4), "covariance": (0.004, 0.002), "colour": (0.008, 5e-4)}
PLANE_RATE, CODING_RATE = (0.0075, 0.001), (0.005, 0.0005)
# A feature's first step, in spreads of the features; the first steps of scalings and offsets (SPEC B.5).
FEATURE_STEP, SCALING_STEP, OFFSET_STEP = 1 / 3, 0.1, 0.2


@dataclass(frozen=True)
class TrainSettings:
    """rate: lambda_r, 0 for an uncompressed Scaffold-GS; steps: of training; seed: of all random numbers; hyperprior: of HYPERPRIORS;
    uniform: bits of all anchors alike (USRO), not of visible ones (ViSRO); plane_period: steps between two with the planes' bits
    (A-RDO); masks: whether offsets may be masked; epsilon: share below which they are (the paper: 0.01, 0.0004 for concentrated views);
    anchors: in the beginning (Scaffold); most_anchors: at any time."""

    rate: float = 0.004
    steps: int = 4000
    seed: int = 0
    hyperprior: str = "vm"
    uniform: bool = True
    plane_period: int = 4
    masks: bool = True
    epsilon: float = 0.01
    anchors: int = 5000
    most_anchors: int = 40000


Watch = Callable[["Trainer"], None]


def _between(share: float, ends: tuple[float, float], held: float = 0.0) -> float:
    """From one end to the other with constant ratios; the first is held for a share of the way."""
    passed = max(share - held, 0.0) / (1 - held)
    return math.exp((1 - passed) * math.log(ends[0]) + passed * math.log(ends[1]))


class Trainer:
    """A training in progress."""

    def __init__(self, photographs: PhotographSet, settings: TrainSettings, device: str = "cpu") -> None:
        """Raises ValueError for photographs that cannot be learnt from, and for a device that is not there."""
        if device == "cuda" and not torch.cuda.is_available():
            raise ValueError("there is no CUDA device")
        self.settings, self.photographs, self.device = settings, photographs, device
        self.random = torch.Generator().manual_seed(settings.seed)
        self.scaffold = Scaffold(photographs, settings.anchors, self.random)
        units = self.scaffold.units
        self.cameras = [units.camera(p.camera) for p in photographs.train]
        red, green, blue = photographs.background
        self.rasterising = Settings(near_plane=NEAR, background=(red / 255, green / 255, blue / 255))
        self.images: dict[int, Tensor] = {}
        self.optimiser = torch.optim.Adam(
            [
                {
                    "params": [p for n, p in self.scaffold.networks.named_parameters() if n.startswith(name)],
                    "ends": ends,
                }
                for name, ends in NETWORK_RATES.items()
            ],
            eps=1e-15,
            fused=True,
        )
        self.rate: LearnedRate | None = None
        self.frequency = torch.ones(self.scaffold.count)
        self.done, self.seconds = 0, 0.0
        # Seconds of a step, lately.
        self.pace = 0.0
        self.order: list[int] = []
        self.recent: list[float] = []
        self.bits = torch.zeros(3)
        self.plane_bits = 0.0
        self.history: list[dict[str, Any]] = []
        self.fit_buffers()

    # --- the parts of a step ------------------------------------------------------------------------------------------

    @property
    def share(self) -> float:
        """How much of the training is done."""
        return self.done / self.settings.steps

    @property
    def rounds(self) -> bool:
        """Whether attributes and planes are rounded."""
        return self.share >= ROUNDING

    def fit_buffers(self) -> None:
        """Arrays of all anchors' size that are used again in each step."""
        n = self.scaffold.count
        self._place = np.full(n, -1, np.int64)
        self._found = np.zeros(n, np.int64)
        self._total = {name: np.zeros((n, columns), np.float32) for name, columns in COLUMNS.items()}

    def image(self, number: int) -> Tensor:
        """A training photograph, float32 [H, W, 3]."""
        if number not in self.images:
            self.images[number] = torch.from_numpy(self.photographs.train[number].image.astype(np.float32) / 255)
        return self.images[number]

    def _kept(self, logits: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Masks of 0 and 1 with the gradient of their logits' shares [n, K], and the shares."""
        share = torch.sigmoid(logits)
        hard = (share * self.frequency[rows, None] > self.settings.epsilon).float()
        return share + (hard - share).detach(), share

    def _rounded(self, values: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
        """What the decoder will have in place of the values [n, w], and its symbols; step [n, 1]. Noise stands for rounding at first;
        both have the same gradients."""
        with torch.no_grad():
            if self.rounds:
                residue = values / step
                residue = torch.floor(residue + 0.5) - residue
            else:
                residue = torch.rand(values.shape, generator=self.random) - 0.5
        return values + residue * step, residue

    def _leaves(self, rows: Tensor) -> dict[str, Tensor]:
        return {name: table[rows].requires_grad_() for name, table in self.scaffold.tables.items()}

    def step(self) -> None:
        """One step of training."""
        settings, scaffold = self.settings, self.scaffold
        began = time.perf_counter()
        if settings.rate and self.rate is None and self.share >= RATE:
            self._start_rate()
        if self.rate is not None and self.share >= INTEGERS and not self.rate.hyper.rounding:
            self._round_activations()
        if self.rate is not None and self._writable and self.share >= WEIGHTS and not self.scaffold.networks.gridded:
            self._round_weights()
        if not self.order:
            self.order = torch.randperm(len(self.cameras), generator=self.random).tolist()
        number = self.order.pop()
        camera, photograph = self.cameras[number], self.image(number)
        rows = scaffold.visible(camera)
        seen = self._leaves(rows)
        masks, shares = self._kept(seen["masks"], rows) if self._masking else (None, None)
        values: dict[str, Tensor] = {kind: seen[kind] for kind in KINDS}
        loss = torch.zeros(())
        sampled, sampled_leaves = None, {}
        if self.rate is not None:
            plane_symbols = self.rate.symbols(None if self.rounds else self.random)
            sampled = self._sample(rows)
            both = torch.cat([rows, sampled])
            hidden = self.rate.hyper.activations(self.contexts.inputs(plane_symbols, both, self.rate.hyper.rounding))
            steps = self.rate.steps(hidden) * self.base_step
            for i, kind in enumerate(KINDS):
                values[kind], _ = self._rounded(seen[kind], steps[: len(rows), i : i + 1])
            sampled_leaves = self._leaves(sampled)
            loss = loss + settings.rate * self._rate(
                sampled_leaves, sampled, hidden[len(rows) :], steps[len(rows) :], plane_symbols
            )
        chosen, gaussians, opacity = scaffold.gaussians(
            rows, camera, values["features"], values["offsets"], values["scalings"], masks
        )
        screen = torch.zeros(len(chosen), requires_grad=True)
        image = self._drawn(gaussians, camera, screen)
        loss = loss + Photometric.apply(image, photograph)
        if len(chosen):
            loss = loss + VOLUME * gaussians[2].prod(dim=1).mean()
        if shares is not None and self.share >= MASKS:
            loss = loss + max(MASK_LEAST, MASK_SHARE * settings.rate) * shares.mean()
        loss.backward()
        self._descend(rows, seen, sampled, sampled_leaves)
        self.recent = [
            *self.recent[-49:],
            -10 * math.log10(float((image.detach() - photograph).square().mean()) + 1e-12),
        ]
        if self.share < GROWTH[1]:
            moved = screen.grad if screen.grad is not None else screen.detach()
            scaffold.observe(rows.numpy(), chosen.numpy(), opacity, moved.numpy())
        self.done += 1
        self._grow()
        spent = time.perf_counter() - began
        self.seconds += spent
        # The first step compiles; it says nothing of those to come.
        if self.done > 1:
            self.pace = 0.98 * self.pace + 0.02 * spent if self.pace else spent

    @property
    def _masking(self) -> bool:
        return bool(self.settings.rate) and self.settings.masks and self.share >= MASKS

    def _sample(self, visible: Tensor) -> Tensor:
        """The anchors whose bits this step counts: of all (USRO), or of the visible ones (ViSRO)."""
        count = self.scaffold.count if self.settings.uniform else len(visible)
        some = min(max(int(SAMPLE_SHARE * count), SAMPLE_LEAST), count)
        drawn = torch.randperm(count, generator=self.random)[:some]
        return drawn if self.settings.uniform else visible[drawn]

    def _rate(
        self, leaves: dict[str, Tensor], rows: Tensor, hidden: Tensor, steps: Tensor, plane_symbols: Tensor
    ) -> Tensor:
        """L_rate (the paper's equation 5): bits of an attribute's parameter, and the planes' share of it."""
        assert self.rate is not None
        symbols = []
        for i, kind in enumerate(KINDS):
            step = steps[:, i : i + 1]
            _, residue = self._rounded(leaves[kind], step)
            symbols.append(leaves[kind] / step + residue)
        masks = self._kept(leaves["masks"], rows)[0] if self._masking else torch.ones(len(rows), COLUMNS["masks"])
        bits = self.rate.attribute_bits(hidden, torch.cat(symbols, dim=1), masks).mean(dim=0)
        self.bits = 0.98 * self.bits + 0.02 * bits.detach() if self.bits.any() else bits.detach()
        loss = bits.sum() / WIDTH
        if self.done % self.settings.plane_period == 0:
            planes = self.rate.plane_bits(plane_symbols)
            self.plane_bits = float(planes.detach())
            # A-RDO: the term is not scaled up for the steps that lack it.
            loss = loss + LAMBDA_TRI * planes / (self.scaffold.count * WIDTH)
        return loss

    def _descend(
        self, rows: Tensor, seen: dict[str, Tensor], sampled: Tensor | None, leaves: dict[str, Tensor]
    ) -> None:
        """A step of every optimiser along the gradients."""
        scaffold = self.scaffold
        for group in self.optimiser.param_groups:
            group["lr"] = _between(self.share, group["ends"])
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        if self.rate is not None:
            torch.nn.utils.clip_grad_norm_(self.rate.coding_parameters(), 1.0)
            after = (self.share - RATE) / (1 - RATE)
            for group in self.coding.param_groups:
                group["lr"] = _between(after, group["ends"])
            self.coding.step()
            self.coding.zero_grad(set_to_none=True)
        count = 0
        for name in COLUMNS:
            gradient = seen[name].grad
            if gradient is None:
                continue
            self._place[self._found[:count]] = -1
            count = gather_rows(rows.numpy(), gradient.numpy(), self._total[name], self._place, self._found, 0)
            if sampled is not None and (more := leaves[name].grad) is not None:
                count = gather_rows(sampled.numpy(), more.numpy(), self._total[name], self._place, self._found, count)
            touched = self._found[:count]
            adam_rows(
                scaffold.tables[name].numpy(),
                scaffold.first[name].numpy(),
                scaffold.second[name].numpy(),
                self.done + 1,
                touched,
                self._total[name],
                np.float32(_between(self.share, RATES[name], HELD[name])),
            )
        self._place[self._found[:count]] = -1

    # --- milestones ---------------------------------------------------------------------------------------------------

    def _grow(self) -> None:
        """Lets the anchors grow when it is time."""
        if GROWTH[0] <= self.share <= GROWTH[1] and self.done % GROWTH_PERIOD == 0 and self.rate is None:
            self.scaffold.grow(self.settings.most_anchors, self.random)
            self.fit_buffers()
            self.frequency = self.scaffold.views(self.cameras)

    def _start_rate(self) -> None:
        """Fixes the frame and the planes' size, and starts the rate model from the attributes' statistics."""
        scaffold = self.scaffold
        self.frequency = scaffold.views(self.cameras)
        spread = float(scaffold.tables["features"].std(dim=0).median()) or 1.0
        base_step = torch.tensor([spread * FEATURE_STEP, SCALING_STEP, OFFSET_STEP])
        frame = choose_frame(lattice_positions(scaffold.lattice))
        self.make_rate(frame, base_step, choose_plane_size(scaffold.count))

    def make_rate(self, frame: Frame, base_step: Tensor, plane_size: int) -> None:
        """A rate model for the anchors as they are. frame: SPEC 7.5.1; base_step: float32 [3]; plane_size: B."""
        scaffold = self.scaffold
        self.frame, self.base_step = frame, base_step
        hyperprior = HYPERPRIORS[self.settings.hyperprior]
        symbols = torch.cat([scaffold.tables[kind] / base_step[i] for i, kind in enumerate(KINDS)], dim=1).double()
        mean, deviation = symbols.mean(dim=0).numpy(), symbols.std(dim=0).numpy()
        self.rate = LearnedRate(hyperprior, plane_size, choose_width(scaffold.count), mean, deviation, self.random)
        self.contexts = Contexts(hyperprior, frame, lattice_positions(scaffold.lattice), plane_size)
        self.coding = torch.optim.Adam(
            [
                {"params": [self.rate.latents], "ends": PLANE_RATE},
                {"params": self.rate.coding_parameters(), "ends": CODING_RATE},
            ],
            eps=1e-15,
            fused=True,
        )

    def _round_activations(self) -> None:
        """Switches to the decoder's activations, with units from all anchors."""
        assert self.rate is not None
        symbols = self.rate.symbols(None)
        rows = torch.arange(self.scaffold.count)
        with torch.no_grad():
            inputs = self.contexts.inputs(symbols, rows, False)
            features = self.scaffold.tables["features"] / (
                self.rate.steps(self.rate.hyper.activations(inputs))[:, :1] * self.base_step[0]
            )
        self.rate.set_rounding(inputs, features, symbols)

    @property
    def _writable(self) -> bool:
        """Whether the format has this hyperprior."""
        return self.settings.hyperprior == "vm"

    @torch.no_grad()
    def _round_weights(self) -> None:
        """Puts the weights on grids, from which training goes on: those of the least loss, the weights' own bits counted as L_rate counts
        those of attributes."""
        assert self.rate is not None
        networks, rate = self.scaffold.networks, self.rate
        judges = self.photographs.train[:: max(len(self.cameras) // JUDGES, 1)][:JUDGES]
        images = [torch.from_numpy(p.image.astype(np.float32) / 255) for p in judges]

        def loss() -> float:
            shown = sum(
                float(Photometric.apply(self.draw(p.camera), image)) for p, image in zip(judges, images, strict=True)
            )
            parts = self.estimate()
            bits = 8 * (parts["attributes"] + parts["weights"] + LAMBDA_TRI * parts["planes"])
            return shown / len(judges) + self.settings.rate * bits / (self.scaffold.count * WIDTH)

        for grid, choices in ((networks.set_grid, RENDER_BITS), (rate.set_grid, COARSER)):
            losses = []
            for choice in choices:
                grid(choice)
                losses.append(loss())
            grid(choices[int(np.argmin(losses))])

    # --- the loop -----------------------------------------------------------------------------------------------------

    def run(self, watch: Watch, state: Path | None = None) -> bool:
        """Trains to the end, or until an interrupt (Ctrl-C), after which the step at hand is still finished. Returns whether it came to
        the end. watch: told of each step; state: a file to save the training in, now and then and when it ends early."""
        stop = threading.Event()
        main = threading.current_thread() is threading.main_thread()
        before = signal.signal(signal.SIGINT, lambda *_: stop.set()) if main else None
        saved = time.monotonic()
        period = max(self.settings.steps // LOOKS, 1)
        try:
            while self.done < self.settings.steps and not stop.is_set():
                self.step()
                if self.done % period == 0 or self.done == self.settings.steps:
                    self._look()
                watch(self)
                if state is not None and (stop.is_set() or time.monotonic() - saved > SAVE_SECONDS):
                    save(self, state)
                    saved = time.monotonic()
        finally:
            if main:
                signal.signal(signal.SIGINT, before)
        return self.done == self.settings.steps

    def _look(self) -> None:
        """Adds to the history how good some held-out images are, and how many bytes the file would have."""
        began = time.perf_counter()
        some = self.photographs.test[:: max(len(self.photographs.test) // LOOK_IMAGES, 1)] or self.photographs.train[:1]
        errors = [
            float((self.draw(p.camera) - torch.from_numpy(p.image.astype(np.float32) / 255)).square().mean())
            for p in some
        ]
        self.seconds += time.perf_counter() - began
        self.history.append(
            {
                "step": self.done,
                "seconds": round(self.seconds, 2),
                "psnr": float(np.mean([-10 * math.log10(e + 1e-12) for e in errors])),
                "anchors": self.scaffold.count,
                "bytes": round(sum(v for name, v in self.estimate().items() if name not in KINDS)),
            }
        )

    @torch.no_grad()
    def draw(self, camera: Camera) -> Tensor:
        """What a camera of the world sees of the training as it is, rounded if it is being rounded: float32 [H, W, 3]."""
        camera = self.scaffold.units.camera(camera)
        rows = self.scaffold.visible(camera)
        values = {name: table[rows] for name, table in self.scaffold.tables.items()}
        masks = self._kept(values["masks"], rows)[0] if self._masking else None
        if self.rate is not None and self.rounds:
            steps = self._steps(rows)
            for i, kind in enumerate(KINDS):
                values[kind] = torch.floor(values[kind] / steps[:, i : i + 1] + 0.5) * steps[:, i : i + 1]
        _, gaussians, _ = self.scaffold.gaussians(
            rows, camera, values["features"], values["offsets"], values["scalings"], masks
        )
        return self._drawn(gaussians, camera, None).clamp(0, 1)

    @torch.no_grad()
    def show(self, scene: Scene, camera: Camera) -> Tensor:
        """What a camera of the world sees of the result, drawn as training draws: its own networks, units and rasteriser, and every
        anchor. float32 [H, W, 3]."""
        held = copy(self.scaffold)
        held.lattice = scene.positions.astype(np.int64)
        held.position = torch.from_numpy((held.lattice * held.units.cell).astype(np.float32))
        values = reconstruct(scene)
        features, scalings = torch.from_numpy(values.features), torch.from_numpy(values.scalings)
        offsets = torch.from_numpy(values.offsets.reshape(scene.anchor_count, -1))
        camera, rows = held.units.camera(camera), torch.arange(scene.anchor_count)
        _, gaussians, _ = held.gaussians(
            rows, camera, features, offsets, scalings, torch.from_numpy(scene.masks).float()
        )
        return self._drawn(gaussians, camera, None).clamp(0, 1)

    def _drawn(self, gaussians: tuple[Tensor, ...], camera: Camera, screen: Tensor | None) -> Tensor:
        """The image of some Gaussians, drawn on the training's device: float32 [H, W, 3] on the CPU. screen: draw's, on the CPU."""
        mean, quaternion, lengths, opacity, colour = (g.to(self.device) for g in gaussians)
        moved = None if screen is None else screen.to(self.device)
        return draw(mean, quaternion, lengths, opacity, colour, camera, self.rasterising, moved)[0].cpu()

    def _steps(self, rows: Tensor) -> Tensor:
        """The steps of some anchors with rounded planes [n, 3]."""
        assert self.rate is not None
        inputs = self.contexts.inputs(self.rate.symbols(None), rows, self.rate.hyper.rounding)
        return self.rate.steps(self.rate.hyper.activations(inputs)) * self.base_step

    # --- results ------------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def estimate(self) -> dict[str, float]:
        """Bytes of each part of the file as they are now, without those of chunks and sections.

        Ideal code lengths, after rounding, of attributes and planes; masks as if each offset's were drawn with its own frequency;
        positions and weights packed, the weights as they are going to be (0 where the format has no such hyperprior).
        Uncompressed: of the float32 numbers.
        """
        scaffold, n = self.scaffold, self.scaffold.count
        if self.rate is None:
            weights = 4 * sum(p.numel() for p in scaffold.networks.parameters())
            return {"positions": 12 * n, "attributes": 4 * WIDTH * n, "weights": weights}
        planes = self.rate.symbols(None)
        bits = torch.zeros(3)
        rows = torch.arange(n)
        kept = self._hard_masks()
        for block in rows.split(8192):
            hidden = self.rate.hyper.activations(self.contexts.inputs(planes, block, self.rate.hyper.rounding))
            steps = self.rate.steps(hidden) * self.base_step
            symbols = [
                torch.floor(scaffold.tables[kind][block] / steps[:, i : i + 1] + 0.5) for i, kind in enumerate(KINDS)
            ]
            bits += self.rate.attribute_bits(hidden, torch.cat(symbols, dim=1), kept[block].float()).sum(dim=0)
        some = kept.any(dim=1)
        share = kept[some].double().mean(dim=0).clamp(1e-9, 1 - 1e-9)
        entropy = -(share * share.log2() + (1 - share) * (1 - share).log2()).sum()
        lanes = choose_lanes(n, 2.0 * WIDTH)
        rendering = scaffold.networks.layers()
        if not scaffold.networks.gridded:
            rendering = quantise_rendering(rendering, LIKELY_BITS)
        weights = (
            weight_bytes(self.rate.networks(), rendering, planes.shape[1], planes.shape[2], lanes)
            if self._writable
            else 0
        )
        parts = dict(zip(KINDS, (bits / 8).tolist(), strict=True))
        return {
            "positions": position_bytes(scaffold.lattice[some.numpy()], lanes),
            "attributes": sum(parts.values()),
            **parts,
            "masks": float(entropy) * int(some.sum()) / 8,
            "planes": float(self.rate.plane_bits(planes)) / 8,
            "weights": weights,
        }

    def _hard_masks(self) -> Tensor:
        """Which offsets are kept, bool [N, K]."""
        if not self._masking:
            return torch.ones(self.scaffold.tables["masks"].shape, dtype=torch.bool)
        return self._kept(self.scaffold.tables["masks"], torch.arange(self.scaffold.count))[0] > 0.5

    def result(self) -> Scene | Uncompressed:
        """What has been learnt, as it can be written: integers, or floats without a rate, and rounded floats where the format has no such
        hyperprior. A rate model that has not begun yet begins now. Raises ValueError."""
        render = render_info(self.scaffold, [p.camera for p in self.photographs.train], self.photographs.background)
        if not self.settings.rate:
            return uncompressed(self.scaffold, render)
        if self.rate is None:
            self._start_rate()
        assert self.rate is not None
        if not self.rate.hyper.rounding:
            self._round_activations()
        if not self._writable:
            return rounded(self.scaffold, render, self._steps(torch.arange(self.scaffold.count)), self._hard_masks())
        if not self.scaffold.networks.gridded:
            self._round_weights()
        planes = self.rate.symbols(None).detach().numpy()
        features, scalings, offsets = self.base_step.tolist()
        kept = self._hard_masks().numpy()
        return coded_scene(
            self.scaffold, self.rate.networks(), self.frame, planes, (features, scalings, offsets), kept, render
        )
