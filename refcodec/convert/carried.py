"""Restores a scene from the changes of export.scaffold for the Scaffold-GS code.

That code has no masks, no unit of distance, and networks whose width is the number of features. Values of networks and
features compensate for this. A trained model has no such values and is not changed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.dimensions import RENDERING
from ..bitstream.networks import Layer
from ..encoder.cloud import AnchorCloud
from ..export.scaffold import DROP

Networks = dict[str, list[Layer]]

# Bits of a weight that was divided and is multiplied again. Both round, and a weight on a grid has fewer bits.
BITS = 20


def without_carried(cloud: AnchorCloud, networks: Networks) -> tuple[AnchorCloud, Networks]:
    """Returns anchors and networks that draw the same, with masks instead of the features that drop offsets.

    Features and hidden units that are 0 and have only weights of 0 are removed, except for one of each.
    """
    switches = _switches(cloud.features, networks)
    masks = cloud.masks.copy()
    for feature, offset in switches.items():
        masks[:, offset] &= cloud.features[:, feature] == 0
    taken = (cloud.features != 0).any(axis=0)
    for name in RENDERING:
        taken |= (networks[name][0][0][:, : len(taken)] != 0).any(axis=0)
    taken[list(switches)] = False
    taken[0] |= not taken.any()
    kept = replace(cloud, features=np.ascontiguousarray(cloud.features[:, taken]), masks=masks)
    return kept, {name: _narrowed(networks[name], taken) for name in RENDERING}


def _switches(features: NDArray[np.float32], networks: Networks) -> dict[int, int]:
    """Returns the features that drop an offset, each with the number of its offset.

    Such a feature is 1 for dropped offsets, else 0. It is the only input of a unit of the opacity network that makes
    the opacity of one offset negative, regardless of the others.
    """
    (weight, bias), (last, _) = networks[RENDERING[0]]
    count = features.shape[1]
    binary = ((features == 0) | (features == 1)).all(axis=0)
    for name in RENDERING[1:]:
        binary &= ~networks[name][0][0][:, :count].any(axis=0)
    switches: dict[int, int] = {}
    entered, left = weight != 0, last != 0
    for unit in np.flatnonzero((entered.sum(axis=1) == 1) & (left.sum(axis=0) == 1) & (bias == 0)).tolist():
        feature, offset = int(entered[unit].argmax()), int(left[:, unit].argmax())
        alone = feature < count and binary[feature] and entered[:, feature].sum() == 1
        if alone and weight[unit, feature] == 1 and last[offset, unit] == -DROP:
            switches[feature] = offset
    return switches


def _narrowed(layers: list[Layer], taken: NDArray[np.bool_]) -> list[Layer]:
    """Returns a network of some of the features, without hidden units that are then 0, except for one."""
    (weight, bias), (last, end) = layers
    inputs = np.concatenate([taken, np.ones(weight.shape[1] - len(taken), bool)])
    weight = weight[:, inputs]
    units = weight.any(axis=1) | (bias != 0)
    units[0] |= not units.any()
    return [(weight[units], bias[units]), (np.ascontiguousarray(last[:, units]), end)]


def with_distance_unit(networks: Networks, unit: float) -> Networks:
    """Returns networks for distances in a unit instead of world units. unit: in world units."""

    def scaled(weight: NDArray[np.float32]) -> NDArray[np.float32]:
        fraction, exponent = np.frexp(weight[:, -1].astype(np.float64) * unit)
        rescaled = weight.copy()
        with np.errstate(over="ignore"):
            rescaled[:, -1] = np.ldexp(np.rint(fraction * (1 << BITS)), exponent - BITS)
        return rescaled

    return {name: [(scaled(first), bias), last] for name, ((first, bias), last) in networks.items()}
