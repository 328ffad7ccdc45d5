"""Coders that make symbols up. refcodec's decoding process runs with them, so the models are those of a decoder."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Any

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import ATTRIBUTE_SYMBOL_MAX, code_attributes
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.entropy import SymbolName, select
from refcodec.bitstream.planes import code_planes
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet

from .numbers import Int64, Numbers
from .scenes import TINY_DIMENSIONS, scene, settled

# One value in this many is escaped, of those that a scene's sampler draws.
ESCAPES = 40


class Sampler:
    """Takes each symbol of a model as often as another, any raw bits, and now and then an escape."""

    def __init__(self, numbers: Numbers, escapes: int = ESCAPES) -> None:
        """escapes: one value in so many, 0 for none."""
        self.numbers, self.escapes = numbers, escapes

    def distances(self, model: Int64, radius: Int64) -> Int64:
        """How far from the centre each value is, in units of 2^raw; farther than the radius is an escape."""
        found = self.numbers.integers(0, 1 << 40, len(model)) % (2 * radius + 1) - radius
        if self.escapes:
            far = radius + (1 << self.numbers.integers(0, 12, len(model)))
            sign = self.numbers.chosen([-1, 1], len(model))
            found = np.where(self.numbers.integers(1, self.escapes, len(model)) == 1, far * sign, found)
        return found

    def values(
        self,
        models: ModelSet,
        mean: Int64,
        scale: Int64,
        counts: list[int],
        limit: int,
        name: SymbolName,
        given: Int64 | None,
    ) -> Int64:
        """A group of values, within their limit."""
        model, centre, raw = select(mean, scale)
        distance = self.distances(model, models.radius.take(model))
        low = self.numbers.integers(0, (1 << 16) - 1, len(model)) & ((np.int64(1) << raw) - 1)
        return np.clip(((centre + distance) << raw) + low, -limit, limit)

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """No symbols of these kinds are drawn."""
        raise NotImplementedError


class Sweep(Sampler):
    """Takes the symbols of each model in turn: the escape first, then the ends, then the others."""

    def __init__(self, numbers: Numbers) -> None:
        super().__init__(numbers)
        self.next: dict[int, int] = defaultdict(int)

    def distances(self, model: Int64, radius: Int64) -> Int64:
        """As Sampler's."""
        found = []
        for m, r in zip(model.tolist(), radius.tolist(), strict=True):
            turn, self.next[m] = self.next[m] % (2 * r + 2), self.next[m] + 1
            order = (r + 1 + m % 3) * (-1 if m % 2 else 1)
            found.append(order if turn == 0 else -r if turn == 1 else r if turn == 2 else turn - 2 - r)
        return np.array(found, dtype=np.int64)


class Rare(Sampler):
    """Takes always the rarest symbol of a model that is no escape, at one end or the other."""

    def distances(self, model: Int64, radius: Int64) -> Int64:
        """As Sampler's."""
        return np.asarray(radius * self.numbers.chosen([-1, 1], len(model)))


def sampled(made: Scene, coder: Sampler, planes: bool = True) -> Scene:
    """The scene with attributes that the coder makes up, and with such planes if it has any and they are wanted."""
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


def drawn(name: str, anchors: int, d: Dimensions = TINY_DIMENSIONS, **changes: Any) -> Scene:
    """A scene whose symbols are drawn from its models. changes: as of scene."""
    return sampled(scene(name, anchors, d, **changes), Sampler(Numbers(f"{name}/symbols")))
