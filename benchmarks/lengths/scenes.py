"""Scenes whose symbols are coded: those of a file or of a saved training, or of its anchors that lie together."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from torch import Tensor

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import KINDS
from refcodec.bitstream.context import UNIT_BITS
from refcodec.bitstream.conventions import Int64
from refcodec.bitstream.frame import Frame
from refcodec.encoder.positions import morton_order
from refcodec.inspect.elements import outline_of
from refcodec.inspect.parts import part_bytes
from refcodec.train.rate_model.columns import Columns
from refcodec.train.rate_model.hyperprior import VectorMatrix, scene_coordinates
from refcodec.train.rate_model.model import OFFSETS, RateModel
from refcodec.train.settings import EntropySettings
from refcodec.train.start import lattice_positions


@dataclass(frozen=True, eq=False)
class Coded:
    """The symbols of a scene, with what its file spends on them.

    symbols: float32 [N, D], features, scalings and offsets. kept: float32 [N, K]. places: int64 [N, 3], in [0, 2^16]
    along the principal axes. cells: int64 [N, 3], of the lattice. Anchors are in the order of the file, which is
    Morton's. counts: features, scalings, components of offsets. slices: features of each. sizes: bytes of each section;
    whole: of the file.
    """

    name: str
    symbols: Tensor
    kept: Tensor
    places: Int64
    cells: Int64
    counts: tuple[int, int, int]
    slices: tuple[int, ...]
    sizes: dict[str, int] = field(default_factory=dict)
    whole: int = 0

    @property
    def count(self) -> int:
        """N."""
        return len(self.symbols)

    def together(self, count: int, seed: int) -> Coded:
        """The `count` anchors that lie nearest to one that is drawn. Their places fill the range of all places."""
        at = np.random.default_rng(seed).integers(self.count)
        away = ((self.cells - self.cells[at]) ** 2).sum(axis=1)
        rows = np.sort(np.argsort(away, kind="stable")[:count])
        places = self.places[rows]
        low, high = places.min(axis=0), places.max(axis=0)
        places = (places - low << UNIT_BITS) // np.maximum(high - low, 1)
        index = torch.from_numpy(rows)
        return replace(
            self,
            name=f"{self.name}, {len(rows):,} of its anchors",
            symbols=self.symbols[index],
            kept=self.kept[index],
            places=places,
            cells=self.cells[rows],
        )

    def statistics(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean and deviation of each channel's symbols, [D]; offsets that are not kept do not count."""
        columns = self.symbols.numpy().astype(np.float64)
        weight = np.ones(columns.shape)
        weight[:, -self.counts[2] :] = np.repeat(self.kept.numpy(), 3, axis=1)
        total = np.maximum(weight.sum(axis=0), 1)
        mean = (columns * weight).sum(axis=0) / total
        return mean, np.sqrt(((columns - mean) ** 2 * weight).sum(axis=0) / total)


def read(path: Path) -> Coded:
    """The symbols of a file, or of a training's state. Anchors without a kept offset have none, and are left out."""
    if path.suffix == ".train-state":
        return _of_training(path)
    data = path.read_bytes()
    scene = codec.parse(data).scene
    a, some = scene.attributes, scene.masks.any(axis=1)
    columns = [a.features, a.scalings, a.offsets.reshape(scene.anchor_count, 3 * scene.dimensions.offset_count)]
    symbols = np.concatenate(columns, axis=1).astype(np.float32)[some]
    if scene.frame is None:
        raise ValueError(f"{path} has no hyperprior")
    return Coded(
        name=path.stem,
        symbols=torch.from_numpy(symbols),
        kept=torch.from_numpy(scene.masks[some].astype(np.float32)),
        places=scene_coordinates(scene.frame, scene.positions)[some],
        cells=scene.positions[some].astype(np.int64),
        counts=(columns[0].shape[1], columns[1].shape[1], columns[2].shape[1]),
        slices=scene.dimensions.slices,
        sizes=part_bytes(data, outline_of(data)),
        whole=len(data),
    )


def _of_training(path: Path) -> Coded:
    """The symbols that a training, saved after its planes were rounded, would write with its steps as they are."""
    with safe_open(path, "pt") as found:
        state = {name: found.get_tensor(name) for name in found.keys()}  # noqa: SIM118
        settings = json.loads(found.metadata()["of"])["settings"]
    frame = Frame(*(state[f"rate/frame.{field.name}"].numpy() for field in fields(Frame)))
    positions, latents = lattice_positions(state["scaffold/lattice"].numpy()), state["rate/model.latents"]
    hyperprior, width = VectorMatrix(), len(state["rate/model.hyper.biases.0"])
    size = latents.shape[-1]
    columns = Columns(tuple(settings["entropy"]["slices"]), OFFSETS)
    likely = np.zeros(columns.width), np.ones(columns.width)
    model = RateModel(hyperprior, size, width, *likely, torch.Generator(), EntropySettings(), columns=columns)
    model.load_state_dict({k[len("rate/model.") :]: v for k, v in state.items() if k.startswith("rate/model.")})
    kept = torch.sigmoid(state["scaffold/tables.masks"]) * state["masks/weight"][:, None] > settings["masks"]["epsilon"]
    some = kept.any(dim=1)
    order = torch.from_numpy(morton_order(positions))
    rows = order[some[order]]
    with torch.no_grad():
        contexts = hyperprior.contexts(frame, positions, size)
        steps = model.steps(model.activations(contexts.inputs(model.symbols(None), rows, True)))
    parts = []
    for i, kind in enumerate(KINDS):
        step = steps[:, i : i + 1] * state["rate/base_step"][i]
        parts.append(torch.floor(state[f"scaffold/tables.{kind}"][rows] / step + 0.5))
    parts[2] *= kept[rows].repeat_interleave(3, dim=1)
    return Coded(
        name=path.stem,
        symbols=torch.cat(parts, dim=1),
        kept=kept[rows].float(),
        places=scene_coordinates(frame, positions)[rows.numpy()],
        cells=positions[rows.numpy()].astype(np.int64),
        counts=(parts[0].shape[1], parts[1].shape[1], parts[2].shape[1]),
        slices=columns.slices,
    )
