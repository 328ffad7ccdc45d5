"""What export.scaffold does to a scene for the code of Scaffold-GS, undone.

That code has no masks, no unit of distances, and networks as wide as there are features. Numbers of the networks and
features make up for it. A trained model has no such numbers and stays as it is.
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

# Of a weight that was divided and is multiplied again. Both round, and a weight on a grid has fewer (SPEC B.8).
BITS = 20


def without_carried(cloud: AnchorCloud, networks: Networks) -> tuple[AnchorCloud, Networks]:
    """Returns anchors and networks that draw the same, with masks in place of the features that drop offsets.

    Features and hidden units go that are 0 and have weights of 0 alone. One of each stays.
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
    """Returns the features that drop an offset where they are 1, each with the number of its offset.

    Such a feature is 0 or 1. It enters one unit of the opacity network, which nothing else enters, and which makes the
    opacity of one offset negative, whatever the others say.
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
    """Returns a network that takes some of the features. Hidden units go that are 0 then. One stays."""
    (weight, bias), (last, end) = layers
    inputs = np.concatenate([taken, np.ones(weight.shape[1] - len(taken), bool)])
    weight = weight[:, inputs]
    units = weight.any(axis=1) | (bias != 0)
    units[0] |= not units.any()
    return [(weight[units], bias[units]), (np.ascontiguousarray(last[:, units]), end)]


def with_distance_unit(networks: Networks, unit: float) -> Networks:
    """Returns networks of the distance in a unit, in place of that in world units. unit: world units."""

    def scaled(weight: NDArray[np.float32]) -> NDArray[np.float32]:
        fraction, exponent = np.frexp(weight[:, -1].astype(np.float64) * unit)
        rescaled = weight.copy()
        with np.errstate(over="ignore"):
            rescaled[:, -1] = np.ldexp(np.rint(fraction * (1 << BITS)), exponent - BITS)
        return rescaled

    return {name: [(scaled(first), bias), last] for name, ((first, bias), last) in networks.items()}
