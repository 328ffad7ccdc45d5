"""The method of other codecs of this family: float32 networks in torch, and entropy coding by constriction.

The networks have the weights of the file, and the same stages (SPEC 7.10). Each stage of a batch of anchors is computed
and then coded: constriction takes a mean and a standard deviation for each symbol.

Only the attributes are coded. Contexts, masks, positions and planes are given, and no value is multiplied by its step.
Thus this does less than a decoder. The symbols are those of the scene, which are encoded and decoded again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from refcodec.bitstream.attributes import Attributes
from refcodec.bitstream.codec import Coding
from refcodec.bitstream.dimensions import SCALINGS
from refcodec.bitstream.networks import ACTIVATION_MAX, Layer
from refcodec.bitstream.scene import Scene

from .compiled import MissingError

# Anchors of a batch: those of a chunk.
BATCH = 4096


# The coded symbols of a stage of a batch: their words, and their least and largest value.
Coded = tuple[NDArray[np.uint32], int, int]


class Constriction:
    """constriction: rANS with a quantised Gaussian for each symbol.

    All tensors are [symbols]. mean, deviation: of each, in steps.
    """

    def __init__(self) -> None:
        """Raises MissingError."""
        try:
            import constriction  # noqa: PLC0415
        except ImportError as error:
            raise MissingError(f"constriction: {error}") from None
        self._coder = constriction.stream.stack.AnsCoder
        self._family = constriction.stream.model.QuantizedGaussian

    @staticmethod
    def _parameters(mean: torch.Tensor, deviation: torch.Tensor) -> tuple[NDArray, NDArray]:
        return mean.numpy().astype(np.float64), deviation.numpy().astype(np.float64)

    def encode(self, symbols: torch.Tensor, mean: torch.Tensor, deviation: torch.Tensor) -> Coded:
        """Returns the code of int32 symbols."""
        # A distribution over a single symbol is not allowed.
        low, high = int(symbols.min()), int(symbols.max()) + 1
        coder = self._coder()
        coder.encode_reverse(symbols.numpy(), self._family(low, high), *self._parameters(mean, deviation))
        return coder.get_compressed(), low, high

    def decode(self, coded: Coded, mean: torch.Tensor, deviation: torch.Tensor) -> torch.Tensor:
        """Returns the int32 symbols of a code."""
        words, low, high = coded
        coder = self._coder(words)
        return torch.from_numpy(coder.decode(self._family(low, high), *self._parameters(mean, deviation)))


def module(layers: list[Layer]) -> torch.nn.Sequential:
    """Returns the float32 network of some layers, with ReLU between them."""
    parts: list[torch.nn.Module] = []
    for weight, bias in layers:
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
        linear.weight.data, linear.bias.data = torch.from_numpy(weight.copy()), torch.from_numpy(bias.copy())
        parts += [linear, torch.nn.ReLU()]
    return torch.nn.Sequential(*parts[:-1])


class Family:
    """Encodes and decodes the attributes of a scene by the family's method."""

    def __init__(self, scene: Scene) -> None:
        """Raises MissingError."""
        d, a, coding = scene.dimensions, scene.attributes, Coding(scene)
        self._scene, self._coder = scene, Constriction()
        self._hyper = module(scene.networks["hyper"])
        self._carm = [module(scene.networks[f"carm.{i}"]) for i in range(1, len(d.slices))]
        self._unit = torch.from_numpy(np.ldexp(np.float32(1), -scene.carm_shift.astype(int)).astype(np.float32))
        batches = [slice(at, at + BATCH) for at in range(0, scene.anchor_count, BATCH)]
        contexts = [coding.contexts(slice(rows.start, min(rows.stop, scene.anchor_count))) for rows in batches]
        self._contexts = [torch.from_numpy(each.astype(np.float32)) for each in contexts]
        self._kept = [torch.from_numpy(np.repeat(scene.masks[rows], 3, axis=1)) for rows in batches]
        self._given = [
            tuple(
                torch.from_numpy(np.ascontiguousarray(part[rows].reshape(len(scene.masks[rows]), -1)))
                for part in (a.features, a.scalings, a.offsets)
            )
            for rows in batches
        ]
        # A list for each batch, with an element for each stage.
        self._coded: list[list[Coded]] = []
        with torch.no_grad():
            for number in range(len(self._contexts)):
                stages: list[Coded] = []

                def code(mean: torch.Tensor, level: torch.Tensor, known: torch.Tensor, to: list[Coded] = stages) -> Any:
                    if len(known):
                        to.append(self._coder.encode(known, mean / 16, torch.exp2(level / 8)))
                    return known

                self._batch(number, code, self._given[number])
                self._coded.append(stages)

    def decode(self) -> Attributes:
        """Returns the symbols, with the steps of the scene."""
        found = []
        with torch.no_grad():
            for number, coded in enumerate(self._coded):
                stages = iter(coded)

                def code(mean: torch.Tensor, level: torch.Tensor, _: None, of: Any = stages) -> torch.Tensor:
                    if not len(mean):
                        return torch.zeros(0, dtype=torch.int32)
                    return self._coder.decode(next(of), mean / 16, torch.exp2(level / 8))

                found.append(self._batch(number, code, None))
        features, scalings, offsets = (torch.cat([part[i] for part in found]).numpy() for i in range(3))
        return Attributes(features, scalings, offsets.reshape(len(offsets), -1, 3).copy(), self._scene.attributes.steps)

    def _batch(
        self, number: int, code: Callable[..., torch.Tensor], given: tuple[torch.Tensor, ...] | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Codes a batch of anchors in either direction. Returns its features, scalings and offsets."""
        d, hyper, kept = self._scene.dimensions, self._hyper(self._contexts[number]), self._kept[number]
        rows, width, total = len(hyper), d.features, d.attribute_width
        mean, level = hyper[:, :total], hyper[:, total : 2 * total]

        def stage(columns: slice, m: torch.Tensor, s: torch.Tensor, known: torch.Tensor | None) -> torch.Tensor:
            flat = None if known is None else known[:, columns].reshape(-1)
            return code(m.reshape(-1), s.reshape(-1), flat).reshape(rows, -1)

        part = slice(width, width + SCALINGS)
        scalings = stage(slice(None), mean[:, part], level[:, part], given[1] if given else None)
        part = slice(width + SCALINGS, None)
        offsets = torch.zeros(kept.shape, dtype=torch.int32)
        offsets[kept] = code(mean[:, part][kept], level[:, part][kept], given[2][kept] if given else None)
        features = torch.zeros((rows, width), dtype=torch.int32)
        done = 0
        for index, columns in enumerate(d.slices):
            part = slice(done, done + columns)
            m, s = mean[:, part], level[:, part]
            if index:
                inputs = (features[:, :done] * self._unit[:done]).clamp(-ACTIVATION_MAX, ACTIVATION_MAX)
                change = self._carm[index - 1](inputs)
                m, s = m + change[:, :columns], s + change[:, columns:]
            features[:, part] = stage(part, m, s, given[0] if given else None)
            done += columns
        return features, scalings, offsets
