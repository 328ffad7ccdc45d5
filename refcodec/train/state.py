"""The state of a training as one safetensors file, without pickles: tensors, and other values as JSON beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from .settings_file import differences


class Savable(Protocol):
    """What can be saved and can go on."""

    def fingerprint(self) -> dict[str, Any]:
        """What must be the same for it to go on, as values of JSON."""

    def state(self) -> dict[str, Any]:
        """All that it needs: tensors, and values of JSON."""

    def restore(self, state: dict[str, Any]) -> None:
        """Sets what `state` gave."""


def save(training: Savable, path: Path) -> None:
    """Writes the state, beside the old one first, so that a crash never leaves half of one."""
    found = training.state()
    tensors = {name: value for name, value in found.items() if isinstance(value, Tensor)}
    values = {name: value for name, value in found.items() if name not in tensors}
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".new")
    save_file(
        {name: value.detach().clone().contiguous() for name, value in tensors.items()},
        beside,
        {"of": json.dumps(training.fingerprint()), "values": json.dumps(values)},
    )
    beside.replace(path)


def restore(training: Savable, path: Path) -> None:
    """Makes a new training the one that was saved. Raises ValueError if the file is damaged, or of another training."""
    try:
        with safe_open(path, "pt") as file:
            notes = file.metadata()
            before, values = json.loads(notes["of"]), json.loads(notes["values"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dictionary)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"the saved state {path} cannot be read ({error}); start without --resume") from None
    for key, now in training.fingerprint().items():
        if before.get(key) != now:
            changes = (
                differences(before[key], now) if isinstance(now, dict) and isinstance(before.get(key), dict) else ()
            )
            raise ValueError("; ".join([f"the saved state {path} is of other {key}", *changes]))
    training.restore({**tensors, **values})
