"""The floor of decoding a scene: bare products, one bare rANS pass and one pass over the output (floor.c)."""

from __future__ import annotations

import ctypes
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.codec import Coding
from refcodec.bitstream.conventions import Int64
from refcodec.bitstream.dimensions import RENDERING, SCALINGS
from refcodec.bitstream.entropy import SymbolName, placed
from refcodec.bitstream.masks import code_masks, mask_models
from refcodec.bitstream.planes import PLANES, code_planes
from refcodec.bitstream.positions import chunk_codes, code_cells
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet

from .compiled import compiled
from .large import KEPT
from .results import processor

SOURCE = Path(__file__).with_name("floor.c")
LANES = 64
# Words past the end that a vector of lanes may read.
AFTER = 16
# Anchors whose symbols are recorded at once.
GROUP = 65536


def builds() -> dict[str, list[str]]:
    """Returns the flags of each build of the floor by name: for this processor, and for AVX2 if it has AVX-512."""
    found = {"native": ["-march=native"]}
    if "avx512f" in processor()["flags"]:
        found["AVX2"] = ["-march=x86-64-v3"]
    return found


class Recorder:
    """A coder that records the model and the index of each given symbol.

    One table holds the models of all families. sets: the start of each family's models, by the family's name.
    """

    def __init__(self) -> None:
        self.sets: dict[str, tuple[int, ModelSet]] = {}
        self.models: list[NDArray[np.uint16]] = []
        self.symbols: list[NDArray[np.uint8]] = []

    def _add(self, models: ModelSet, index: Int64, symbol: Int64) -> None:
        start = sum(len(other.offset) for _, other in self.sets.values())
        start, _ = self.sets.setdefault(models.family, (start, models))
        self.models.append((index + start).astype(np.uint16))
        self.symbols.append(symbol.astype(np.uint8))

    def values(
        self,
        models: ModelSet,
        mean: Int64,
        scale: Int64,
        counts: list[int],
        limit: int,
        name: SymbolName,
        given: Int64 | None,
    ) -> Int64:
        """Records a group, as Coder.values."""
        assert given is not None
        model, index, _, _ = placed(models, mean, scale, given)
        self._add(models, model, index)
        return given

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """Records a group, as SymbolCoder.plain."""
        assert given is not None
        self._add(models, index, given)
        return given


def record(scene: Scene) -> Recorder:
    """Returns the symbols of a scene: planes, and the cells, masks and attributes of each chunk."""
    recorder, coding, d, a = Recorder(), Coding(scene), scene.dimensions, scene.attributes
    if coding.sarm is not None:
        code_planes(recorder, coding.sarm, d.plane_channels, d.plane_size, scene.planes)
    masks, model = mask_models(scene.mask_model), scene.position_model
    for chunk in scene.chunks:
        code = chunk_codes(scene.positions[chunk.start : chunk.stop], model.cell_shift) if model else None
        if model and code is not None:
            code_cells(recorder, model.models(), [], [len(chunk)], code)
    for group in chunk_ranges(scene.anchor_count, GROUP):
        rows = slice(group.start, group.stop)
        code_masks(recorder, masks, d.offset_count, [group], scene.masks[rows])
        given = type(a)(a.features[rows], a.scalings[rows], a.offsets[rows], a.steps[rows])
        code_attributes(recorder, coding.model, coding.contexts(rows), scene.masks[rows], [group], given)
    return recorder


def layer_shapes(scene: Scene) -> NDArray[np.int64]:
    """Returns the rows, inputs and outputs of each layer that a decoder computes, int64 [layers, 3]."""
    d, found = scene.dimensions, []
    for name, layers in d.network_shapes().items():
        rows = PLANES * d.plane_channels * d.plane_size**2 if name == "sarm" else scene.anchor_count
        if name not in RENDERING:
            found += [(rows, inputs, outputs) for outputs, inputs in layers]
    return np.array(found, dtype=np.int64)


def output_bytes(scene: Scene) -> int:
    """Returns the bytes of the positions, features, scalings, offsets and masks of a scene."""
    d = scene.dimensions
    return scene.anchor_count * (4 * (3 + d.features + SCALINGS + 3 * d.offset_count) + d.offset_count)


class _Models(ctypes.Structure):
    _fields_ = [("offset", ctypes.c_void_p), ("entry", ctypes.c_void_p), ("first", ctypes.c_void_p)]


class Floor:
    """The floor of a scene. pairs: whether products are of int16 pairs; the faster way is chosen."""

    def __init__(self, scene: Scene, flags: list[str], kept: Path = KEPT) -> None:
        """flags: of the compiler. Raises MissingError without a compiler."""
        self._library = self._load(compiled(SOURCE, ["-std=gnu11", "-O3", *flags, "-shared", "-fPIC"], kept))
        self._shapes, self._bytes = layer_shapes(scene), output_bytes(scene)
        recorder = record(scene)
        self._model, self.symbols = np.concatenate(recorder.models), np.concatenate(recorder.symbols)
        self._arrays = self._tables(recorder)
        self._models = _Models(*(array.ctypes.data for array in self._arrays))
        self.found, room = np.empty_like(self.symbols), np.zeros(len(self._model) + AFTER, np.uint16)
        self._first_state = np.empty(LANES, np.uint32)
        self.words = int(
            self._library.encode(
                ctypes.byref(self._models),
                self._model.ctypes.data,
                self.symbols.ctypes.data,
                len(self._model),
                self._first_state.ctypes.data,
                room.ctypes.data,
            )
        )
        # `encode` puts the words at the end of the room, before the unused AFTER words.
        self._words = room[len(self._model) - self.words :].copy()
        self.pairs = False
        if self._library.has_pairs():
            times = [self._products_time(pairs) for _ in range(3) for pairs in (False, True)]
            self.pairs = min(times[1::2]) < min(times[::2])

    @staticmethod
    def _load(path: Path) -> Any:
        library, pointer, number = ctypes.CDLL(os.fspath(path)), ctypes.c_void_p, ctypes.c_int64
        library.products.argtypes = [pointer, number, ctypes.c_int]
        library.encode.argtypes = [pointer, pointer, pointer, number, pointer, pointer]
        library.decode.argtypes = [pointer, pointer, number, pointer, pointer, pointer]
        library.encode.restype = library.decode.restype = number
        library.output.argtypes = [number]
        return library

    @staticmethod
    def _tables(recorder: Recorder) -> list[NDArray]:
        """Returns the arrays of the models of all families in sequence, as floor.c expects them."""
        offset, entry, first = [], [], []
        start = 0
        for _, models in recorder.sets.values():
            offset.append(models.offset + start)
            # Only the null model's frequency, which is all slots, needs more than 14 bits.
            entry.append(models.lower | (models.upper - models.lower) << 16)
            first.append(models.first)
            start += len(models.lower)
        return [
            np.concatenate(offset).astype(np.uint32),
            np.concatenate(entry).astype(np.uint32),
            np.append(np.concatenate(first), np.zeros(3)).astype(np.uint8),
        ]

    def _products_time(self, pairs: bool) -> float:
        before = time.process_time()
        self._checked(self._library.products(self._shapes.ctypes.data, len(self._shapes), int(pairs)))
        return time.process_time() - before

    @staticmethod
    def _checked(status: int) -> None:
        if status:
            raise MemoryError

    def run(self) -> dict[str, float]:
        """Runs all three parts. Returns the processor seconds of each. Afterwards `found` has the decoded symbols."""
        spent = {"products": self._products_time(self.pairs)}
        before, state = time.process_time(), self._first_state.copy()
        taken = self._library.decode(
            ctypes.byref(self._models),
            self._model.ctypes.data,
            len(self._model),
            state.ctypes.data,
            self._words.ctypes.data,
            self.found.ctypes.data,
        )
        spent["rANS"] = time.process_time() - before
        before = time.process_time()
        self._checked(self._library.output(self._bytes))
        spent["output"] = time.process_time() - before
        if taken != self.words:
            raise AssertionError(f"the rANS pass took {taken} words of {self.words}")
        return spent
