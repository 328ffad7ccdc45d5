"""Learning rates over a training, and the moments of torch's Adam in a saved state."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from .settings import Decay


def learning_rate(decay: Decay, share: float) -> float:
    """A learning rate after a share of its way: from one end to the other with constant ratios, once it is not held."""
    passed = max(share - decay.held, 0.0) / (1 - decay.held)
    return math.exp((1 - passed) * math.log(decay.start) + passed * math.log(decay.end))


def moments(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Adam's moments as a part's state."""
    found = optimiser.state_dict()["state"]
    return {f"adam.{i}.{key}": value for i, values in found.items() for key, value in values.items()}


def restore_moments(optimiser: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    """Sets what `moments` gave."""
    found: dict[int, dict[str, Tensor]] = {}
    for key, value in state.items():
        if key.startswith("adam."):
            _, index, moment = key.split(".")
            found.setdefault(int(index), {})[moment] = value
    optimiser.load_state_dict({"state": found, "param_groups": optimiser.state_dict()["param_groups"]})
