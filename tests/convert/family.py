"""Models of Scaffold-GS, HAC, HAC++ and CAT-3DGS with random numbers: their folders and their Gaussians.

The layouts are those that the programs' own code writes and reads: names, order and types of all properties, names of
networks, the inputs with the appearance, and the values that are logarithms.
"""

import json
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

F64 = NDArray[np.float64]
VOXEL = 0.25


@dataclass(frozen=True)
class Layout:
    """A program's folder. distance: whether opacity, covariance and colour take it. appearance: width, or 0.

    form: how the networks are stored: one file of state dicts by this name, or TorchScript for "split". masks: whether
    the anchors have logits of masks. more: the names of other networks in the file of state dicts.
    """

    form: str
    features: int = 32
    offsets: int = 10
    distance: tuple[bool, bool, bool] = (False, False, False)
    appearance: int = 0
    masks: bool = False
    more: tuple[str, ...] = ()


# The networks of the programs with hyperpriors, which all take the distance.
FAR, CODING = (True, True, True), ("encoding_xyz", "grid_mlp", "deform_mlp")
# HAC, HAC++ and CAT-3DGS write one layout.
LAYOUTS = {
    "scaffold, split": Layout("split", appearance=32),
    "scaffold, united": Layout("checkpoints.pth", appearance=16, distance=(True, False, True)),
    "scaffold, plain": Layout("split", features=20, offsets=5, distance=(False, True, False)),
    "hac": Layout("checkpoint.pth", features=50, distance=FAR, masks=True, more=CODING),
    "hac, small": Layout("checkpoint.pth", features=13, offsets=3, distance=FAR, masks=True, more=CODING),
}


class Embedding(nn.Module):
    """Scaffold-GS's appearance: a table behind a module."""

    def __init__(self, cameras: int, width: int) -> None:
        super().__init__()
        self.out_dim = width
        self.embedding = nn.Embedding(cameras, width)

    def forward(self, number: torch.Tensor) -> torch.Tensor:
        return self.embedding(number)


class Model:
    """A model in memory: what its program would draw, in float64, and its folder."""

    def __init__(self, layout: Layout, count: int = 40, seed: int = 0, cameras: int = 3) -> None:
        rng = np.random.default_rng(seed)
        torch.manual_seed(seed)
        f, k = layout.features, layout.offsets
        self.layout, self.count = layout, count
        cells = np.unique(rng.integers(-20, 20, (count, 3)), axis=0)
        self.count = count = len(cells)
        self.anchor = (cells * VOXEL).astype(np.float32)
        self.offset = rng.normal(0, 1, (count, k, 3)).astype(np.float32)
        self.mask = rng.normal(-3, 3, (count, k)).astype(np.float32)
        self.feature = rng.normal(0, 1, (count, f)).astype(np.float32)
        self.scaling = rng.normal(-2, 0.5, (count, 6)).astype(np.float32)
        away = [int(taken) for taken in layout.distance]

        def network(inputs: int, outputs: int, last: nn.Module | None) -> nn.Sequential:
            return nn.Sequential(nn.Linear(inputs, f), nn.ReLU(True), nn.Linear(f, outputs), *([last] if last else []))

        self.networks = {
            "opacity_mlp": network(f + 3 + away[0], k, nn.Tanh()),
            "cov_mlp": network(f + 3 + away[1], 7 * k, None),
            "color_mlp": network(f + 3 + away[2] + layout.appearance, 3 * k, nn.Sigmoid()),
        }
        self.embedding = Embedding(cameras, layout.appearance) if layout.appearance else None

    # --- what its program draws ---------------------------------------------------------------------------------------

    def gaussians(self, centre: F64, code: F64 | None) -> dict[str, F64]:
        """What the program's networks say for a camera at `centre`: of each drawn offset, mean, lengths and so on.

        code: the appearance.
        """
        away = self.anchor.astype(np.float64) - centre
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        n, k = self.count, self.layout.offsets

        def output(name: str, far: bool, more: F64 | None = None) -> F64:
            parts = [self.feature.astype(np.float64), away / distance]
            parts += [distance] if far else []
            parts += [np.broadcast_to(more, (n, len(more)))] if more is not None else []
            with torch.no_grad():
                return self.networks[name].double()(torch.from_numpy(np.concatenate(parts, axis=1))).numpy()

        far = self.layout.distance
        opacity, covariance = output("opacity_mlp", far[0]), output("cov_mlp", far[1]).reshape(n, k, 7)
        colour = output("color_mlp", far[2], code).reshape(n, k, 3)
        kept = opacity > 0
        if self.layout.masks:
            kept &= 1 / (1 + np.exp(-self.mask.astype(np.float64))) > 0.01
        anchor, offset = np.nonzero(kept)
        lengths = np.exp(self.scaling.astype(np.float64))
        quaternion = covariance[anchor, offset, 3:]
        return {
            "mean": self.anchor[anchor] + self.offset[anchor, offset].astype(np.float64) * lengths[anchor, :3],
            "lengths": lengths[anchor, 3:] / (1 + np.exp(-covariance[anchor, offset, :3])),
            "quaternion": quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
            "opacity": opacity[anchor, offset],
            "colour": colour[anchor, offset],
            "anchor": anchor,
            "offset": offset,
        }

    def code(self, camera: int | None) -> F64 | None:
        """The appearance of a camera, or the mean of all."""
        if self.embedding is None:
            return None
        table = self.embedding.embedding.weight.detach().double().numpy()
        return table.mean(axis=0) if camera is None else table[camera]

    # --- its folder ---------------------------------------------------------------------------------------------------

    def properties(self) -> dict[str, NDArray[np.float32]]:
        """The columns of point_cloud.ply, in the order of the file."""
        layout, n = self.layout, self.count
        zeros = np.zeros(n, np.float32)
        columns = dict(zip("xyz", self.anchor.T, strict=True)) | dict.fromkeys(("nx", "ny", "nz"), zeros)
        # transpose(1, 2).flatten(start_dim=1): one axis after the other.
        offset = self.offset.transpose(0, 2, 1).reshape(n, 3 * layout.offsets)
        columns |= {f"f_offset_{i}": column for i, column in enumerate(offset.T)}
        if layout.masks:
            columns |= {f"f_mask_{i}": column for i, column in enumerate(self.mask.T)}
        columns |= {f"f_anchor_feat_{i}": column for i, column in enumerate(self.feature.T)}
        columns["opacity"] = zeros
        columns |= {f"scale_{i}": column for i, column in enumerate(self.scaling.T)}
        return columns | {f"rot_{i}": np.full(n, i == 0, np.float32) for i in range(4)}

    def write(self, folder: Path, iteration: int = 30000) -> Path:
        """Writes the folder of the model. Returns that of its iteration."""
        place = folder / "point_cloud" / f"iteration_{iteration}"
        place.mkdir(parents=True)
        columns = self.properties()
        header = ["ply", "format binary_little_endian 1.0", f"element vertex {self.count}"]
        header += [f"property float {name}" for name in columns] + ["end_header"]
        table = np.stack(list(columns.values()), axis=1).astype("<f4")
        (place / "point_cloud.ply").write_bytes(("\n".join(header) + "\n").encode() + table.tobytes())
        if self.layout.form == "split":
            self._write_scripts(place)
        else:
            torch.save(self.state_dicts(), place / self.layout.form)
        settings = {
            "sh_degree": 3,
            "feat_dim": self.layout.features,
            "n_offsets": self.layout.offsets,
            "voxel_size": VOXEL,
            "use_feat_bank": False,
            "white_background": True,
            "appearance_dim": self.layout.appearance,
            "source_path": "/data/scene",
        }
        text = ", ".join(f"{name}={value!r}" for name, value in settings.items())
        (folder / "cfg_args").write_text(f"Namespace({text})")
        turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        camera = {"id": 0, "img_name": "a", "width": 64, "height": 48, "fx": 60.0, "fy": 61.0}
        camera |= {"position": [1.0, -9.0, 2.0], "rotation": turn.tolist()}
        (folder / "cameras.json").write_text(json.dumps([camera]))
        return place

    def state_dicts(self) -> dict[str, object]:
        """What the file of state dicts holds."""
        states: dict[str, object] = {name: network.float().state_dict() for name, network in self.networks.items()}
        if self.embedding is not None:
            states["appearance"] = self.embedding.state_dict()
        coding = nn.Sequential(nn.Linear(9, 4), nn.ReLU(), nn.Linear(4, 2)).state_dict()
        return states | {name: {"params": torch.zeros(1000)} if "xyz" in name else coding for name in self.layout.more}

    def _write_scripts(self, place: Path) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            for name, network in self.networks.items():
                traced = torch.jit.trace(network.float().eval(), torch.rand(1, network[0].in_features))
                traced.save(str(place / f"{name}.pt"))
            if self.embedding is not None:
                number = torch.zeros(1, dtype=torch.long)
                torch.jit.trace(self.embedding.eval(), number).save(str(place / "embedding_appearance.pt"))
