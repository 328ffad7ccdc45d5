"""Coders that invent symbols. They run in refcodec's decoding process, so the models are those of a decoder."""

from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, code_attributes
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.entropy import SymbolName, ValueGroup, select
from refcodec.bitstream.planes import code_planes
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet
from refcodec.encoder.positions import position_model

from .numbers import Int64, Numbers
from .scenes import TINY_DIMENSIONS, lattice, scene, settled

# A scene's sampler escapes one value in this many.
ESCAPES = 40


class Sampler:
    """Draws symbols of a model uniformly, any raw bits, and sometimes an escape."""

    def __init__(self, numbers: Numbers, escapes: int = ESCAPES) -> None:
        """escapes: one value in this many is escaped, 0 for none."""
        self.numbers, self.escapes = numbers, escapes

    def distances(self, model: Int64, radius: Int64) -> Int64:
        """Returns the distances of values from the centre, in units of 2^raw. Beyond the radius they are escapes."""
        away = self.numbers.integers(0, 1 << 40, len(model)) % (2 * radius + 1) - radius
        if self.escapes:
            far = radius + (1 << self.numbers.integers(0, 12, len(model)))
            sign = self.numbers.chosen([-1, 1], len(model))
            away = np.where(self.numbers.integers(1, self.escapes, len(model)) == 1, far * sign, away)
        return away

    def values(self, group: ValueGroup) -> Int64:
        """Returns a group of values within their limit."""
        model, centre, raw = select(group.mean, group.scale)
        distance = self.distances(model, group.models.radius.take(model))
        low = self.numbers.integers(0, (1 << 16) - 1, len(model)) & ((np.int64(1) << raw) - 1)
        return np.clip(((centre + distance) << raw) + low, -group.limit, group.limit)

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """Draws no symbols of these kinds."""
        raise NotImplementedError


class Sweep(Sampler):
    """Uses the symbols of each model in turn: the escape, then the ends, then the others."""

    def __init__(self, numbers: Numbers) -> None:
        super().__init__(numbers)
        self.next: dict[int, int] = defaultdict(int)

    def distances(self, model: Int64, radius: Int64) -> Int64:
        """As Sampler's."""
        away = []
        for m, r in zip(model.tolist(), radius.tolist(), strict=True):
            turn, self.next[m] = self.next[m] % (2 * r + 2), self.next[m] + 1
            order = (r + 1 + m % 3) * (-1 if m % 2 else 1)
            away.append(order if turn == 0 else -r if turn == 1 else r if turn == 2 else turn - 2 - r)
        return np.array(away, dtype=np.int64)


class Rare(Sampler):
    """Always uses the rarest symbol of a model except the escape, at either end."""

    def distances(self, model: Int64, radius: Int64) -> Int64:
        """As Sampler's."""
        return np.asarray(radius * self.numbers.chosen([-1, 1], len(model)))


def sampled(made: Scene, coder: Sampler, planes: bool = True) -> Scene:
    """Returns the scene with attributes from the coder, and with planes from it if wanted."""
    d = made.dimensions
    sarm = codec.Coding(made).sarm
    if planes and sarm is not None:
        made = replace(made, planes=code_planes(coder, sarm, d.plane_channels, d.plane_size))
    coding, chunks = codec.Coding(made), made.chunks
    attributes = (
        code_attributes(coder, coding.model, coding.contexts(), made.masks, chunks) if chunks else made.attributes
    )
    assert np.abs(attributes.features).max(initial=0) <= ATTRIBUTE_SYMBOL_MAX
    return settled(replace(made, attributes=attributes))


def on_lattice(name: str, anchors: int, chunk: int = 4096, **changes: Any) -> Scene:
    """Returns a drawn scene of positions on a lattice, packed. chunk: for how many anchors. changes: as of scene."""
    where = lattice(Numbers(name), anchors)
    return drawn(name, anchors, positions=where, position_model=position_model(where, chunk), **changes)


def drawn(name: str, anchors: int, d: Dimensions = TINY_DIMENSIONS, **changes: Any) -> Scene:
    """Returns a scene whose symbols are drawn from its models. changes: as of scene."""
    return sampled(scene(name, anchors, d, **changes), Sampler(Numbers(f"{name}/symbols")))
