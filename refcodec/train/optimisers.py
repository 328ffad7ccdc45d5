"""Learning rates over a training run, and the moments of torch's Adam in a saved state."""

import math

import torch
from torch import Tensor

from .settings import Decay
from .state import Saved


def learning_rate(decay: Decay, share: float) -> float:
    """A learning rate after a share of its way: after it is held, it falls from start to end with constant ratios."""
    passed = max(share - decay.held, 0.0) / (1 - decay.held)
    return math.exp((1 - passed) * math.log(decay.start) + passed * math.log(decay.end))


def moments(optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Adam's moments as a part's state."""
    state = optimiser.state_dict()["state"]
    return {f"adam.{i}.{key}": value for i, values in state.items() for key, value in values.items()}


def restore_moments(optimiser: torch.optim.Optimizer, state: Saved) -> None:
    """Restores the values of `moments`. Raises ValueError.

    A parameter that never had a gradient has no moments.
    """
    restored: dict[int, dict[str, Tensor]] = {}
    names = set(state.names())
    parameters = [value for group in optimiser.param_groups for value in group["params"]]
    for i, value in enumerate(parameters):
        if any(f"adam.{i}.{moment}" in names for moment in ("step", "exp_avg", "exp_avg_sq")):
            restored[i] = {
                "step": state.tensor(f"adam.{i}.step", (), low=0),
                "exp_avg": state.tensor(f"adam.{i}.exp_avg", value.shape),
                "exp_avg_sq": state.tensor(f"adam.{i}.exp_avg_sq", value.shape, low=0),
            }
    optimiser.load_state_dict({"state": restored, "param_groups": optimiser.state_dict()["param_groups"]})
