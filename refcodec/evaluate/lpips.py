"""LPIPS (Zhang et al. 2018), version 0.1: the difference of two images in the features of a classification network.

The user provides a weights file, made by refcodec.evaluate.lpips_weights. Nothing is downloaded.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor
from torch.nn import functional

from ..photographs.cameras import PhotographError

# Layers of the networks up to the last that is compared: a convolution's stride and padding, or a maximum's size and
# stride. After the convolutions of COMPARED, in the order of the linear layers, images are compared.
_CONV, _POOL = {"stride": 1, "padding": 1}, {"kernel_size": 2, "stride": 2}
_ALEX_POOL = {"kernel_size": 3, "stride": 2}
LAYERS: dict[str, list[dict[str, int]]] = {
    "vgg": [_CONV, _CONV, _POOL, _CONV, _CONV, *[_POOL, _CONV, _CONV, _CONV] * 3],
    "alex": [{"stride": 4, "padding": 2}, _ALEX_POOL, {"stride": 1, "padding": 2}, _ALEX_POOL, _CONV, _CONV, _CONV],
}
COMPARED = {"vgg": (1, 3, 6, 9, 12), "alex": (0, 1, 2, 3, 4)}
# The smallest side that the deepest layers accept.
SIDE_MIN = 32
# Of values from -1 to 1: the mean and deviation of ImageNet's, moved to that range.
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


class Lpips:
    """The measure with the weights of a safetensors file, whose metadata names their network.

    Raises ValueError, OSError.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            with safe_open(path, "pt") as file:
                self.network: str = (file.metadata() or {}).get("network", "")
                self.weights: dict[str, Any] = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except SafetensorError as error:
            raise ValueError(f"{path} is not a safetensors file ({error})") from None
        if self.network not in LAYERS:
            raise ValueError(
                f"{path} does not have LPIPS weights: make it with python -m refcodec.evaluate.lpips_weights"
            )
        convolutions = sum("padding" in layer for layer in LAYERS[self.network])
        needed = {f"conv{i}.{kind}" for i in range(convolutions) for kind in ("weight", "bias")} | {
            f"linear{i}" for i in range(5)
        }
        if missing := needed - set(self.weights):
            raise ValueError(f"{path} lacks {', '.join(sorted(missing))}")
        black = np.zeros((SIDE_MIN, SIDE_MIN, 3), np.uint8)
        try:
            self.measures(black.astype(np.float32), black)
        # torch raises this for weights of other shapes.
        except (RuntimeError, TypeError, IndexError):
            raise ValueError(f"{path} has weights whose shapes are not those of LPIPS") from None

    def measures(self, made: NDArray[Any], photograph: NDArray[np.uint8]) -> dict[str, float]:
        """Returns the distance of an image from a photograph, 0 if they are equal.

        made: float [h, w, 3], 1 for white, cut to 0 to 1. photograph: uint8 [h, w, 3]. lpips uses values from -1 to 1,
        as its authors do. lpips_3dgs uses values from 0 to 1, as the code of 3D Gaussian Splatting and its successors
        do. Raises PhotographError for sides below 32 pixels.
        """
        if min(photograph.shape[:2]) < SIDE_MIN:
            height, width = photograph.shape[:2]
            raise PhotographError(
                "LPIPS",
                f"the images have {width} x {height} pixels, but each side must have at least {SIDE_MIN}",
                "use a larger --size",
            )
        both = np.stack([np.clip(np.asarray(made, np.float32), 0, 1), photograph.astype(np.float32) / 255])
        values = torch.from_numpy(both).permute(0, 3, 1, 2)
        return {"lpips": self._distance(2 * values - 1), "lpips_3dgs": self._distance(values)}

    def _distance(self, values: Tensor) -> float:
        values = (values - _column(_SHIFT)) / _column(_SCALE)
        total, number = 0.0, 0
        with torch.inference_mode():
            for layer in LAYERS[self.network]:
                if "padding" not in layer:
                    values = functional.max_pool2d(values, layer["kernel_size"], layer["stride"])
                    continue
                values = functional.conv2d(
                    values, self.weights[f"conv{number}.weight"], self.weights[f"conv{number}.bias"], **layer
                ).relu()
                if number in COMPARED[self.network]:
                    total += self._difference(values, COMPARED[self.network].index(number))
                number += 1
        return total

    def _difference(self, values: Tensor, number: int) -> float:
        """Returns the weighted mean squared difference of the unit vectors of two images, [2, channels, h, w]."""
        unit = values / (values.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)
        squared = (unit[0] - unit[1]).square().mean(dim=(1, 2))
        return float(squared @ self.weights[f"linear{number}"])


def _column(values: tuple[float, ...]) -> Tensor:
    return torch.tensor(values)[:, None, None]
