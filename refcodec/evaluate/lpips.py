"""LPIPS (Zhang et al. 2018), version 0.1: the difference of two images in the features of VGG16.

The user provides a weights file, made by refcodec.evaluate.lpips_weights. Nothing is downloaded.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor
from torch.nn import functional

from ..photographs.cameras import PhotographError

# The convolutions of VGG16 in each block. A maximum over 2 x 2 pixels is between blocks, and images are compared after
# each of them.
BLOCKS = (2, 2, 3, 3, 3)
# The smallest side that the last block accepts.
SIDE_MIN = 1 << (len(BLOCKS) - 1)
# Of values from -1 to 1: the mean and deviation of ImageNet's, moved to that range.
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


class Lpips:
    """The measure with the weights of a safetensors file.

    Raises ValueError, OSError.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            with safe_open(path, "pt") as file:
                network = (file.metadata() or {}).get("network")
                self.weights: dict[str, Any] = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except SafetensorError as error:
            raise ValueError(f"{path} is not a safetensors file ({error})") from None
        if network != "vgg":
            raise ValueError(
                f"{path} does not have LPIPS weights: make it with python -m refcodec.evaluate.lpips_weights"
            )
        needed = {f"conv{i}.{kind}" for i in range(sum(BLOCKS)) for kind in ("weight", "bias")}
        if missing := (needed | {f"linear{i}" for i in range(len(BLOCKS))}) - set(self.weights):
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
        do. Raises PhotographError for sides below SIDE_MIN.
        """
        if min(photograph.shape[:2]) < SIDE_MIN:
            height, width = photograph.shape[:2]
            text = f"the images have {width} x {height} pixels, but each side must have at least {SIDE_MIN}"
            raise PhotographError("LPIPS", text, "use a larger --size")
        both = np.stack([np.clip(np.asarray(made, np.float32), 0, 1), photograph.astype(np.float32) / 255])
        values = torch.from_numpy(both).permute(0, 3, 1, 2)
        return {"lpips": self._distance(2 * values - 1), "lpips_3dgs": self._distance(values)}

    def _distance(self, values: Tensor) -> float:
        values = (values - _column(_SHIFT)) / _column(_SCALE)
        total, number = 0.0, 0
        with torch.inference_mode():
            for block, convolutions in enumerate(BLOCKS):
                values = functional.max_pool2d(values, 2) if block else values
                for _ in range(convolutions):
                    weight, bias = self.weights[f"conv{number}.weight"], self.weights[f"conv{number}.bias"]
                    values, number = functional.conv2d(values, weight, bias, padding=1).relu(), number + 1
                total += self._difference(values, block)
        return total

    def _difference(self, values: Tensor, number: int) -> float:
        """Returns the weighted mean squared difference of the unit vectors of two images, [2, channels, h, w]."""
        unit = values / (values.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)
        squared = (unit[0] - unit[1]).square().mean(dim=(1, 2))
        return float(squared @ self.weights[f"linear{number}"])


def _column(values: tuple[float, ...]) -> Tensor:
    return torch.tensor(values)[:, None, None]
