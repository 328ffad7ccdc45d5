"""The state of a training as one safetensors file: all that going on exactly where it stopped needs. No pickle."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from ..bitstream.frame import Frame

if TYPE_CHECKING:
    from .trainer import Trainer

_STATISTICS = ("gradient", "drawn", "opacity", "seen")
_FRAME = ("matrix", "translation", "shift", "low", "high")


def _moments(name: str, optimiser: torch.optim.Optimizer) -> dict[str, Tensor]:
    return {
        f"{name}.{i}.{key}": value
        for i, found in optimiser.state_dict()["state"].items()
        for key, value in found.items()
    }


def _restore_moments(name: str, tensors: dict[str, Tensor], optimiser: torch.optim.Optimizer) -> None:
    found: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        if key.startswith(name + "."):
            _, index, moment = key.split(".")
            found.setdefault(int(index), {})[moment] = value
    optimiser.load_state_dict({"state": found, "param_groups": optimiser.state_dict()["param_groups"]})


def fingerprint(trainer: Trainer) -> dict[str, Any]:
    """What must be the same for a training to go on: settings, photographs and their sizes."""
    photographs = [[p.camera.name, p.camera.width, p.camera.height] for p in trainer.photographs.train]
    return {"settings": asdict(trainer.settings), "photographs": photographs}


def save(trainer: Trainer, path: Path) -> None:
    """Writes the state, beside the old one first, so that a crash never leaves half of one."""
    scaffold = trainer.scaffold
    tensors: dict[str, Tensor] = {}
    for kind, tables in (("tables", scaffold.tables), ("first", scaffold.first), ("second", scaffold.second)):
        tensors |= {f"{kind}.{name}": value for name, value in tables.items()}
    tensors |= {f"statistics.{name}": torch.from_numpy(getattr(scaffold, name)) for name in _STATISTICS}
    tensors["lattice"] = torch.from_numpy(scaffold.lattice)
    tensors |= {f"networks.{name}": value for name, value in scaffold.networks.state_dict().items()}
    tensors |= _moments("optimiser", trainer.optimiser)
    tensors |= {"frequency": trainer.frequency, "bits": trainer.bits, "random": trainer.random.get_state()}
    if trainer.rate is not None:
        tensors |= {f"rate.{name}": value for name, value in trainer.rate.state_dict().items()}
        tensors |= _moments("coding", trainer.coding)
        tensors["base_step"] = trainer.base_step
        tensors |= {f"frame.{name}": torch.from_numpy(np.asarray(getattr(trainer.frame, name))) for name in _FRAME}
    facts = {
        **fingerprint(trainer),
        "done": trainer.done,
        "seconds": trainer.seconds,
        "order": trainer.order,
        "recent": trainer.recent,
        "plane_bits": trainer.plane_bits,
        "history": trainer.history,
        "rounding": trainer.rate is not None and trainer.rate.hyper.rounding,
        "gridded": scaffold.networks.gridded,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".new")
    save_file(
        {name: value.detach().clone().contiguous() for name, value in tensors.items()},
        beside,
        {"state": json.dumps(facts)},
    )
    beside.replace(path)


def restore(trainer: Trainer, path: Path) -> None:
    """Makes a new Trainer the one that was saved. Raises ValueError if the file is damaged, or of another training."""
    try:
        with safe_open(path, "pt") as file:
            facts = json.loads(file.metadata()["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dictionary)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"the saved state {path} cannot be read ({error}); start without --resume") from None
    for key, value in json.loads(json.dumps(fingerprint(trainer))).items():
        if facts[key] != value:
            raise ValueError(f"the saved state {path} is of other {key}: {facts[key]}, not {value}")
    scaffold = trainer.scaffold
    scaffold.lattice = tensors["lattice"].numpy()
    for kind, tables in (("tables", scaffold.tables), ("first", scaffold.first), ("second", scaffold.second)):
        for name in tables:
            tables[name] = tensors[f"{kind}.{name}"]
    scaffold.forget()
    for name in _STATISTICS:
        setattr(scaffold, name, tensors[f"statistics.{name}"].numpy())
    scaffold.networks.load_state_dict(
        {k.removeprefix("networks."): v for k, v in tensors.items() if k.startswith("networks.")}
    )
    scaffold.networks.gridded = facts["gridded"]
    _restore_moments("optimiser", tensors, trainer.optimiser)
    trainer.frequency, trainer.bits = tensors["frequency"], tensors["bits"]
    if "base_step" in tensors:
        arrays = [tensors[f"frame.{name}"].numpy() for name in _FRAME]
        trainer.make_rate(Frame(*arrays), tensors["base_step"], tensors["rate.latents"].shape[-1])
        assert trainer.rate is not None
        trainer.rate.load_state_dict({k.removeprefix("rate."): v for k, v in tensors.items() if k.startswith("rate.")})
        trainer.rate.rounding(facts["rounding"])
        trainer.rate.gridded(facts["gridded"])
        _restore_moments("coding", tensors, trainer.coding)
    trainer.done, trainer.seconds, trainer.order, trainer.recent = (
        facts["done"],
        facts["seconds"],
        facts["order"],
        facts["recent"],
    )
    trainer.plane_bits, trainer.history = facts["plane_bits"], facts["history"]
    trainer.fit_buffers()
    trainer.random.set_state(tensors["random"])
