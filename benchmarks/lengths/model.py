"""An entropy model of a Variant: planes, F_h, SARM and the groups' networks, in floating point."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from refcodec.bitstream.context import positional_encoding
from refcodec.bitstream.planes import PLANES
from refcodec.encoder.sizes import choose_plane_size
from refcodec.train.rate_model.bits import gauss_bits, laplace_bits
from refcodec.train.rate_model.hyperprior import PlaneSamples, plane_neighbours
from refcodec.train.rate_model.units import GAMMA_UNIT, LATENT_UNIT, MEAN_UNIT, PLANE_SHIFT, SCALE_UNIT, round_through

from ..peers.mixture import mixed_bits
from .neighbours import inputs as neighbour_inputs
from .networks import Network
from .scenes import Coded
from .variants import Group, Variant

# Probability added to each symbol's, as in training.
FLOOR = 2.0**-20
LEAST_DEVIATION = 1 / 16


class Model(nn.Module):
    """What codes the symbols of one scene."""

    def __init__(self, scene: Coded, variant: Variant, generator: torch.Generator) -> None:
        super().__init__()
        mean, deviation = scene.statistics()
        octave = np.log2(np.maximum(deviation, LEAST_DEVIATION))
        self.scene, self.variant, self.generator = scene, variant, generator
        self.unit = torch.tensor(2.0 ** np.round(octave), dtype=torch.float32)
        self.normal = (scene.symbols - torch.tensor(mean, dtype=torch.float32)) / self.unit
        # An offset that is dropped is not known.
        self.normal[:, -scene.counts[2] :] *= scene.kept.repeat_interleave(3, dim=1)
        self.order = torch.arange(len(mean))
        if variant.order:
            by = np.argsort(octave[: scene.counts[0]] * (1 if variant.order == "rising" else -1), kind="stable")
            self.order[: scene.counts[0]] = torch.from_numpy(by)
        fixed = []
        self.samples: PlaneSamples | None = None
        if variant.frequencies:
            gamma = positional_encoding(scene.places[:, 2], variant.frequencies) / GAMMA_UNIT
            fixed.append(torch.from_numpy(gamma.astype(np.float32)))
        if variant.neighbours:
            fixed.append(neighbour_inputs(scene, variant.neighbours, self.unit))
        self.fixed = torch.cat(fixed, dim=1) if fixed else torch.zeros(scene.count, 0)
        read = self.fixed.shape[1]
        size = max(round(choose_plane_size(scene.count) * variant.size), 8)
        self.latents = nn.Parameter(torch.zeros(PLANES, variant.channels, size, size))
        if variant.channels:
            self.samples = PlaneSamples(scene.places[:, :2], size)
            read += 2 * variant.channels
            with torch.no_grad():
                self.latents.normal_(generator=generator).mul_(variant.start)
            if variant.sarm is not None:
                self.sarm = Network([4, *variant.sarm, 2], generator, 0.1)
        width = len(mean)
        hidden = list(variant.hyper) if read else []
        self.hyper = Network([read, *hidden, 2 * width], generator, 0.1, laplace=variant.laplace)
        with torch.no_grad():
            start = np.concatenate([mean / self.unit.numpy(), octave])
            self.hyper.biases[-1].copy_(torch.tensor(start, dtype=torch.float32))
        self._groups(variant, generator)

    def _columns(self, group: Group) -> Tensor:
        features, scalings, offsets = self.scene.counts
        first, last = {
            "f": (0, features),
            "s": (features, features + scalings),
            "o": (features + scalings, features + scalings + offsets),
        }[group.kind]
        stop = last if group.stop < 0 else first + group.stop
        return self.order[first + group.start : stop]

    def _groups(self, variant: Variant, generator: torch.Generator) -> None:
        """Which columns each group has and reads, and its network."""
        self.groups: list[tuple[Tensor, Tensor, bool]] = []
        outputs = 3 if variant.mixture else 2
        for i, group in enumerate(variant.groups):
            before = [self._columns(g) for g in variant.groups[:i] if g.kind in group.reads]
            read = torch.cat(before) if before else torch.zeros(0, dtype=torch.int64)
            self.groups.append((self._columns(group), read, "m" in group.reads))
        every = torch.sort(torch.cat([columns for columns, _, _ in self.groups])).values
        assert torch.equal(every, torch.arange(len(self.unit)))
        self.contexts = nn.ModuleDict()
        kept = self.scene.kept.shape[1]
        reading = [i for i, (_, read, masks) in enumerate(self.groups) if len(read) or masks]
        if not variant.shared:
            for i in reading:
                columns, read, masks = self.groups[i]
                widths = [len(read) + kept * masks, *variant.carm, outputs * len(columns)]
                self.contexts[str(i)] = Network(widths, generator, 0.0, laplace=variant.laplace)
        elif reading:
            # One hidden layer. Its units are dealt to the groups, and a unit reads what its group reads.
            (hidden,) = variant.carm
            owner = torch.arange(hidden) * len(reading) // hidden
            first = torch.zeros(hidden, len(self.unit), dtype=torch.bool)
            rows = []
            for j, i in enumerate(reading):
                first[owner == j] = torch.zeros(len(self.unit), dtype=torch.bool).index_fill(0, self.groups[i][1], True)
                rows.append((owner <= j).expand(outputs * len(self.groups[i][0]), hidden))
            widths = [len(self.unit), hidden, sum(map(len, rows))]
            self.contexts["shared"] = Network(widths, generator, 0.0, [first, torch.cat(rows)], variant.laplace)
        self.reading = reading

    def networks(self) -> dict[str, Network]:
        """F_h, SARM and the groups' networks by name."""
        found = {"hyper": self.hyper, **{f"carm.{k}": v for k, v in self.contexts.items()}}
        if self.samples is not None and self.variant.sarm is not None:
            found["sarm"] = self.sarm
        return found  # type: ignore[return-value]

    def prepare(self, mode: str) -> dict[str, Tensor]:
        """Sets the weights of the calls from now on (Network.prepare). Returns the bits of each network."""
        return {name: network.prepare(mode, self.generator) for name, network in self.networks().items()}

    def planes(self, rounded: bool) -> Tensor:
        """Plane symbols, with noise or rounded."""
        fine = self.latents * LATENT_UNIT
        return round_through(fine) if rounded else fine + torch.rand(fine.shape, generator=self.generator) - 0.5

    def plane_bits(self, symbols: Tensor) -> Tensor:
        """Bits of all plane symbols."""
        if self.samples is None or self.variant.sarm is None:
            return torch.zeros(())
        out = self.sarm(plane_neighbours(symbols) / LATENT_UNIT)
        mean, scale = out[:, 0] * LATENT_UNIT * MEAN_UNIT, out[:, 1] * SCALE_UNIT
        return laplace_bits(mean, scale, symbols.reshape(-1), FLOOR).sum()

    def attribute_bits(self, planes: Tensor, rows: Tensor) -> Tensor:
        """Bits of features, scalings and offsets of each anchor, [n, 3]."""
        read = [self.fixed[rows]]
        if self.samples is not None:
            read.append(self.samples.query(planes, rows, False) / (LATENT_UNIT * 2**PLANE_SHIFT))
        out, width = self.hyper(torch.cat(read, dim=1)), len(self.unit)
        mean, scale = out[:, :width], out[:, width:]
        symbols, known, kept = self.scene.symbols[rows], self.normal[rows], self.scene.kept[rows]
        changes = self._changes(known, kept)
        by_mean, by_scale = torch.zeros_like(mean), torch.zeros_like(mean)
        for columns, change in changes:
            by_mean = by_mean.index_add(1, columns, change[:, : len(columns)])
            by_scale = by_scale.index_add(1, columns, change[:, len(columns) : 2 * len(columns)])

        def bits_of(m: Tensor, s: Tensor) -> Tensor:
            return gauss_bits(m * self.unit * MEAN_UNIT, s * SCALE_UNIT, symbols, FLOOR)

        bits = bits_of(mean + by_mean, scale + by_scale)
        if self.variant.mixture:
            alone = bits_of(mean, scale)
            for columns, change in changes:
                mixed = mixed_bits(alone[:, columns], bits[:, columns], change[:, 2 * len(columns) :])
                bits = bits.index_copy(1, columns, mixed)
        features, scalings, _ = self.scene.counts
        offsets = bits[:, features + scalings :] * kept.repeat_interleave(3, dim=1)
        parts = (bits[:, :features], bits[:, features : features + scalings], offsets)
        return torch.stack([part.sum(dim=1) for part in parts], dim=1)

    def _changes(self, known: Tensor, kept: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Columns of each group that reads others, and what its network adds to their means and scales."""
        outputs = 3 if self.variant.mixture else 2
        if self.variant.shared and self.reading:
            counts = [outputs * len(self.groups[i][0]) for i in self.reading]
            parts = self.contexts["shared"](known).split(counts, dim=1)
            return [(self.groups[i][0], part) for i, part in zip(self.reading, parts, strict=True)]
        found = []
        for i in self.reading:
            columns, read, masks = self.groups[i]
            inputs = torch.cat([known[:, read], kept], dim=1) if masks else known[:, read]
            found.append((columns, self.contexts[str(i)](inputs)))
        return found
