"""Clauses 6.13 and 7.7 to 7.10: the attributes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .conventions import Int64, clamp, rshift_round
from .dimensions import SCALINGS, Dimensions
from .entropy import Coder, ValueGroup
from .networks import IntNetwork, activation
from .tables import STEP_LENGTH, tables

# SPEC 6.13: the largest magnitude of an attribute symbol.
ATTRIBUTE_SYMBOL_MAX = (1 << 23) - 1
# SPEC 7.8: the kinds of attribute, in the order of their steps.
KINDS = ("features", "scalings", "offsets")


@dataclass(frozen=True)
class Attributes:
    """Symbols and step indices of some anchors.

    features: int32 [n, F].
    scalings: int32 [n, 6].
    offsets: int32 [n, K, 3], 0 where masked.
    steps: uint8 [n, 3], the step index of each kind, in the order of KINDS.
    """

    features: NDArray[np.int32]
    scalings: NDArray[np.int32]
    offsets: NDArray[np.int32]
    steps: NDArray[np.uint8]


@dataclass(frozen=True)
class EntropyModel:
    """The networks that predict the distributions of attributes.

    hyper: F_h. carm: the network of each slice from slice 1 on. carm_shift: int64 [CARM inputs]. slices: their widths.
    """

    hyper: IntNetwork
    carm: list[IntNetwork]
    carm_shift: Int64
    slices: tuple[int, ...]

    @classmethod
    def of(
        cls, networks: Mapping[str, IntNetwork], carm_shift: NDArray[np.uint8], slices: tuple[int, ...]
    ) -> EntropyModel:
        """Returns the model of the networks that derive_networks gives. carm_shift: uint8 [CARM inputs]."""
        carm = [networks[f"carm.{i}"] for i in range(1, len(slices))]
        return cls(networks["hyper"], carm, carm_shift.astype(np.int64), slices)

    def carm_correction(self, index: int, features: Int64) -> Int64:
        """SPEC 7.9: returns the outputs of CARM for a slice, means then scale indices, int64 [n, 2 * its channels].

        index: of the slice, from 1 on. features: the symbols of the slices before it, int64 [n, their channels].
        """
        earlier = activation(rshift_round(features, self.carm_shift[: features.shape[1]]))
        return self.carm[index - 1](earlier).astype(np.int64)


def step_indices(hyper: Int64) -> NDArray[np.uint8]:
    """SPEC 7.8: returns the step indices, uint8 [n, 3]. hyper: int64 [n, 2 D + 3], the outputs of F_h."""
    return clamp(hyper[:, -3:], 0, STEP_LENGTH - 1).astype(np.uint8)


def code_attributes(
    coder: Coder,
    model: EntropyModel,
    contexts: NDArray[np.int16],
    masks: NDArray[np.bool_],
    chunks: list[range],
    given: Attributes | None = None,
) -> Attributes:
    """SPEC 7.10: codes the attributes of some chunks, in either direction, and returns them.

    contexts: int16 [n, inputs of F_h]. masks: bool [n, K]. chunks: the anchors of each chunk, which has one substream.
    given: the attributes, for encoding. The returned steps are always those of the networks.
    """
    counts = [len(c) for c in chunks]
    n, offset_count = masks.shape
    width = sum(model.slices)
    total = width + SCALINGS + 3 * offset_count
    # SPEC 7.7: the outputs are the means of all channels, then all scale indices, then three step indices.
    hyper = model.hyper(contexts).astype(np.int64)
    mean, scale = hyper[:, :total], hyper[:, total : 2 * total]

    def stage(kind: str, first: int, columns: int, m: Int64, s: Int64, known: NDArray[np.int32] | None) -> Int64:
        def name(stream: int, index: int) -> str:
            anchor, column = divmod(index, columns)
            return f"attributes.{kind}[{chunks[stream][anchor]},{first + column}]"

        flat = None if known is None else known.reshape(-1).astype(np.int64)
        sizes = [c * columns for c in counts]
        group = ValueGroup(tables().gauss, m.reshape(-1), s.reshape(-1), sizes, ATTRIBUTE_SYMBOL_MAX, name, flat)
        return coder.values(group).reshape(n, columns)

    # SPEC 7.10: the scalings come first, then the offsets that the masks keep.
    part = slice(width, width + SCALINGS)
    scalings = stage("scalings", 0, SCALINGS, mean[:, part], scale[:, part], None if given is None else given.scalings)
    kept = np.flatnonzero(np.repeat(masks, 3, axis=1))
    columns = 3 * offset_count
    ends = np.cumsum(masks.sum(axis=1) * 3)
    first = np.cumsum([0, *counts])
    bounds = np.concatenate([[0], ends])[first]

    def offset_name(stream: int, index: int) -> str:
        anchor, column = divmod(int(kept[bounds[stream] + index]), columns)
        return f"attributes.offsets[{chunks[stream][anchor - first[stream]]},{column // 3},{column % 3}]"

    offsets = np.zeros(n * columns, dtype=np.int64)
    group = ValueGroup(
        tables().gauss,
        mean[:, width + SCALINGS :].reshape(-1)[kept],
        scale[:, width + SCALINGS :].reshape(-1)[kept],
        np.diff(bounds).tolist(),
        ATTRIBUTE_SYMBOL_MAX,
        offset_name,
        None if given is None else given.offsets.reshape(-1)[kept].astype(np.int64),
    )
    offsets[kept] = coder.values(group)
    # SPEC 7.10: then the feature slices.
    features = np.zeros((n, width), dtype=np.int64)
    done = 0
    for index, columns in enumerate(model.slices):
        part = slice(done, done + columns)
        m, s = mean[:, part], scale[:, part]
        if index:
            # SPEC 7.9: the outputs of CARM are added to those of F_h.
            correction = model.carm_correction(index, features[:, :done])
            m, s = m + correction[:, :columns], s + correction[:, columns:]
        features[:, part] = stage("features", done, columns, m, s, None if given is None else given.features[:, part])
        done += columns
    return Attributes(
        features.astype(np.int32),
        scalings.astype(np.int32),
        offsets.reshape(n, offset_count, 3).astype(np.int32),
        step_indices(hyper),
    )


def zero_attributes(d: Dimensions, anchors: int) -> Attributes:
    """Returns symbols and step indices of 0."""
    return Attributes(
        np.zeros((anchors, d.features), np.int32),
        np.zeros((anchors, SCALINGS), np.int32),
        np.zeros((anchors, d.offset_count, 3), np.int32),
        np.zeros((anchors, len(KINDS)), np.uint8),
    )


def join_attributes(parts: Iterable[Attributes], d: Dimensions) -> Attributes:
    every = [zero_attributes(d, 0), *parts]
    return Attributes(*(np.concatenate([getattr(part, name) for part in every]) for name in vars(every[0])))
