"""Trains an entropy model on fixed symbols, and counts what the file would spend."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch

from .model import Model
from .networks import choose_steps
from .scenes import Coded
from .variants import Variant

# Learning rates of the planes and of the networks, and the share of training after which all is rounded.
PLANE_RATE, NETWORK_RATE, ROUNDING = 0.01, 0.008, 0.7
# From one step that counts the planes' bits to the next (A-RDO), scaled up by as much.
PLANE_PERIOD = 4
# Anchors that are evaluated at once, and that judge the steps of weights which were not trained.
CHUNK, JUDGES = 4096, 4096


@dataclass(frozen=True)
class Lengths:
    """Bytes of what is coded: features, scalings, offsets; planes; each network. weights: how many there are."""

    features: float
    scalings: float
    offsets: float
    planes: float
    networks: dict[str, float]
    weights: int

    @property
    def attributes(self) -> float:
        """A."""
        return self.features + self.scalings + self.offsets

    @property
    def total(self) -> float:
        """A, P and the networks."""
        return self.attributes + self.planes + sum(self.networks.values())

    def document(self) -> dict[str, Any]:
        """For a file of results."""
        return asdict(self)


def fit(scene: Coded, variant: Variant, seed: int) -> Lengths:
    """Trains for `variant.steps` steps, and counts all anchors with rounded planes and weights."""
    generator = torch.Generator().manual_seed(seed)
    model = Model(scene, variant, generator)
    symbols_of_planes = model.latents.numel()
    steps_of = [network.steps for network in model.networks().values()]
    own = {id(p) for p in steps_of} | {id(model.latents)}
    rest = [p for p in model.parameters() if id(p) not in own and p.numel()]
    groups: list[dict[str, Any]] = [{"params": rest}]
    rates = [NETWORK_RATE]
    if variant.weighed:
        groups.append({"params": steps_of})
        rates.append(4 * NETWORK_RATE)
    if symbols_of_planes:
        groups.append({"params": [model.latents]})
        rates.append(PLANE_RATE)
    optimiser = torch.optim.Adam(groups, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rates, total_steps=variant.steps)
    batch = min(variant.batch, scene.count)
    size = scene.count * sum(scene.counts)
    for step in range(variant.steps):
        late = step >= ROUNDING * variant.steps
        spent = model.prepare(("round" if late else "noise") if variant.weighed else "float")
        planes = model.planes(late or variant.sharp)
        rows = torch.randperm(scene.count, generator=generator)[:batch]
        loss = model.attribute_bits(planes, rows).sum() * (scene.count / batch)
        if symbols_of_planes and step % PLANE_PERIOD == 0:
            loss = loss + PLANE_PERIOD * model.plane_bits(planes)
        if variant.weighed:
            loss = loss + sum(spent.values())
        optimiser.zero_grad(set_to_none=True)
        (loss / size).backward()
        torch.nn.utils.clip_grad_norm_(rest, 1.0)
        optimiser.step()
        schedule.step()
    return count(model, variant.weighed)


@torch.no_grad()
def count(model: Model, weighed: bool) -> Lengths:
    """Bytes of everything, with rounded planes and weights."""
    scene, planes = model.scene, model.planes(True)
    if not weighed:
        model.prepare("float")
        drawn = torch.randperm(scene.count, generator=model.generator)[:JUDGES]

        def bits_of() -> float:
            attributes = model.attribute_bits(planes, drawn).sum() * (scene.count / len(drawn))
            return float(attributes + model.plane_bits(planes))

        choose_steps(model.networks().values(), bits_of, model.generator)
    spent = model.prepare("round")
    rows = torch.arange(scene.count).split(CHUNK)
    each = torch.stack([model.attribute_bits(planes, r).sum(dim=0) for r in rows])
    features, scalings, offsets = (each.sum(dim=0) / 8).tolist()
    networks = {name: float(bits) / 8 for name, bits in spent.items()}
    total = sum(network.counted() for network in model.networks().values())
    return Lengths(features, scalings, offsets, float(model.plane_bits(planes)) / 8, networks, total)
