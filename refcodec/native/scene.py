"""Scenes and chunks for the native kernel: converts arrays and bytes to the structures of kernel.h."""

import ctypes
import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .library import NO_MEMORY, PLANES, REFUSED, Kernel, KernelChunk, KernelDescription, KernelVerdict

F32 = NDArray[np.float32]
Layers = list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]


@dataclass(frozen=True)
class ChunkBytes:
    """SPEC 5.13 and 5.14: a chunk to decode.

    form: of its positions. parts: positions, masks, attributes. anchors: their number. kept, low, high: from its entry.
    low, high: float16 [3].
    """

    form: int
    parts: tuple[bytes, bytes, bytes]
    anchors: int
    kept: int
    low: NDArray[np.float16]
    high: NDArray[np.float16]


@dataclass(frozen=True)
class Anchors:
    """The numbers of some anchors, in C order.

    positions: float16 [n, 3]. masks: bool [n, K]. features, scalings, offsets: int32 [n, F], [n, 6], [n, K, 3].
    steps: uint8 [n, 3].
    """

    positions: NDArray[np.float16]
    masks: NDArray[np.bool_]
    features: NDArray[np.int32]
    scalings: NDArray[np.int32]
    offsets: NDArray[np.int32]
    steps: NDArray[np.uint8]


def _address(array: NDArray[Any] | None) -> int | None:
    return None if array is None else array.ctypes.data


def _flat(arrays: list[NDArray[np.int64]], kind: type) -> NDArray[Any]:
    return np.concatenate([np.zeros(0, np.int64), *(array.reshape(-1) for array in arrays)]).astype(kind)


def _joined(layers: Layers) -> list[NDArray[Any]]:
    """Returns the weights, biases and exponents of all layers, in the dtypes of kernel.h."""
    return [_flat([layer[i] for layer in layers], kind) for i, kind in enumerate((np.int16, np.int32, np.uint8))]


@cache
def _tables(kernel: Kernel, file: bytes) -> int:
    """Returns the kernel's tables from the shipped file. They are kept until the process ends."""
    tables = kernel.library.kernel_tables_new(file, len(file))
    if not tables:
        raise MemoryError("no memory for the tables of the native kernel")
    return int(tables)


class NativeScene:
    """The kernel's form of a scene, which is freed with its object."""

    def __init__(
        self, kernel: Kernel, tables: bytes, numbers: dict[str, Any], layers: Layers, arrays: dict[str, NDArray[Any]]
    ) -> None:
        """numbers: the fields of KernelDescription that are not pointers. slice_width is a tuple.

        tables: the shipped file. layers: for each layer of F_h, SARM and CARM, weights, biases and exponents, int64.
        arrays: the other pointers of KernelDescription, with the dtypes of kernel.h. Missing ones are NULL. Raises
        MemoryError, and RuntimeError for numbers that the kernel does not accept.
        """
        self.kernel = kernel
        self._channels, self._size = numbers["plane_channels"], numbers["plane_size"]
        self._shape = numbers["offset_count"], sum(numbers["slice_width"])
        held = {
            "shape": np.array([weight.shape for weight, _, _ in layers], np.int32).reshape(-1),
            **dict(zip(("weight", "bias", "exponent"), _joined(layers), strict=True)),
            **{name: np.ascontiguousarray(array) for name, array in arrays.items()},
        }
        fields = {name: value for name, value in numbers.items() if name != "slice_width"}
        description = KernelDescription(**fields, **{name: _address(array) for name, array in held.items()})
        for i, width in enumerate(numbers["slice_width"]):
            description.slice_width[i] = width
        scene = kernel.library.kernel_scene_new(ctypes.byref(description), _tables(kernel, tables), kernel.variant)
        if not scene:
            raise RuntimeError("the native kernel refused a scene that SPEC.md allows: please report this bug")
        self._scene = scene
        weakref.finalize(self, kernel.library.kernel_scene_free, scene)

    def decode_planes(self, parts: list[bytes]) -> tuple[NDArray[np.int16], list[KernelVerdict]]:
        """SPEC 7.3: returns the sub-planes, int16 [5, ch, B, B], and the verdict on each."""
        planes = np.empty((PLANES, self._channels, self._size, self._size), np.int16)
        held = [np.frombuffer(part, np.uint8) for part in parts]
        pointers = (ctypes.c_void_p * PLANES)(*(array.ctypes.data for array in held))
        lengths = (ctypes.c_uint64 * PLANES)(*map(len, parts))
        verdicts = (KernelVerdict * PLANES)()
        self.kernel.library.kernel_decode_planes(
            self._scene, pointers, lengths, planes.ctypes.data, verdicts, self.kernel.threads
        )
        return planes, _checked(list(verdicts))

    def encode_planes(self, planes: NDArray[np.int16]) -> list[bytes]:
        """SPEC 7.3: returns the substreams of sub-planes, int16 [5, ch, B, B], with valid symbols."""
        given = np.ascontiguousarray(planes)
        pointers, lengths = (ctypes.c_void_p * PLANES)(), (ctypes.c_uint64 * PLANES)()
        verdicts = (KernelVerdict * PLANES)()
        self.kernel.library.kernel_encode_planes(
            self._scene, given.ctypes.data, pointers, lengths, verdicts, self.kernel.threads
        )
        parts = self._taken(pointers, lengths)
        _checked(list(verdicts))
        return parts

    def anchor_bytes(self) -> int:
        """Returns the number of bytes of an anchor in the arrays of `room`."""
        return sum(array.nbytes for array in vars(self.room(1)).values())

    def room(self, n: int) -> Anchors:
        """Returns uninitialised arrays for n anchors."""
        offsets, features = self._shape
        return Anchors(
            np.empty((n, 3), np.float16),
            np.empty((n, offsets), np.bool_),
            np.empty((n, features), np.int32),
            np.empty((n, 6), np.int32),
            np.empty((n, offsets, 3), np.int32),
            np.empty((n, 3), np.uint8),
        )

    def decode_chunks(self, chunks: list[ChunkBytes], to: Anchors, rows: list[int]) -> list[KernelVerdict]:
        """SPEC 10.1, CHUNKS: decodes some chunks, and returns the verdict on each.

        to: arrays of `room`. rows: the row of each chunk's first anchor in them. The chunks do not overlap.
        """
        jobs, held = (KernelChunk * len(chunks))(), []
        for job, chunk, first in zip(jobs, chunks, rows, strict=True):
            if not 0 <= first <= len(to.positions) - chunk.anchors:
                raise ValueError(f"{chunk.anchors} anchors from row {first} on do not fit {len(to.positions)} rows")
            own = [np.frombuffer(part, np.uint8) for part in chunk.parts]
            held.append(own)
            for i, part in enumerate(own):
                job.part[i], job.length[i] = part.ctypes.data, len(part)
            job.kept, job.form = chunk.kept, chunk.form
            for axis in range(3):
                job.low[axis] = int(chunk.low[axis].view(np.uint16))
                job.high[axis] = int(chunk.high[axis].view(np.uint16))
            self._place(job, to, first, chunk.anchors)
        self.kernel.library.kernel_decode_chunks(self._scene, jobs, len(chunks), self.kernel.threads)
        return _checked([job.verdict for job in jobs])

    def encode_chunks(
        self, anchors: Anchors, counts: list[int], forms: list[int] | None
    ) -> tuple[list[tuple[int, tuple[bytes, bytes, bytes]]], list[int]]:
        """SPEC 5.14: returns the form of positions and the parts of each chunk, and the status of each chunk.

        The status is DONE, REFUSED_FORM or REFUSED_STEPS. anchors: with valid symbols. counts: the anchors of each
        chunk. forms: None to pack the positions of every chunk whose positions can be packed.
        """
        held = Anchors(*(np.ascontiguousarray(array) for array in vars(anchors).values()))
        jobs, first = (KernelChunk * len(counts))(), 0
        for i, (job, count) in enumerate(zip(jobs, counts, strict=True)):
            job.form = -1 if forms is None else forms[i]
            self._place(job, held, first, count)
            first += count
        self.kernel.library.kernel_encode_chunks(self._scene, jobs, len(counts), self.kernel.threads)
        parts = [self._taken(job.part, job.length) for job in jobs]
        statuses = [verdict.status for verdict in _checked([job.verdict for job in jobs])]
        return [(job.form, (own[0], own[1], own[2])) for job, own in zip(jobs, parts, strict=True)], statuses

    @staticmethod
    def _place(job: KernelChunk, anchors: Anchors, first: int, count: int) -> None:
        """Sets a chunk's array pointers to its rows of `anchors`."""
        job.anchors = count
        for name, array in vars(anchors).items():
            setattr(job, name, array.ctypes.data + first * array.strides[0])

    def _taken(self, pointers: Any, lengths: Any) -> list[bytes]:
        """Returns the bytes that the kernel allocated, and frees them."""
        taken = []
        for pointer, length in zip(pointers, lengths, strict=True):
            taken.append(ctypes.string_at(pointer, length) if pointer else b"")
            self.kernel.library.kernel_free(pointer)
        return taken


def _checked(verdicts: list[KernelVerdict]) -> list[KernelVerdict]:
    """Returns the verdicts. Raises MemoryError without memory, and RuntimeError for unchecked input."""
    statuses = [verdict.status for verdict in verdicts]
    if NO_MEMORY in statuses:
        raise MemoryError("no memory in the native kernel")
    if REFUSED in statuses:
        raise RuntimeError("the native kernel refused validated input: please report this bug")
    return verdicts


def weight_symbols(
    kernel: Kernel, tables: bytes, part: bytes, lanes: int, scale: NDArray[np.uint8], few: int
) -> tuple[NDArray[np.int32], KernelVerdict]:
    """SPEC 7.13, DECODE_WEIGHTS: returns the symbols of packed weights, int32 [symbols], and the verdict on them.

    tables: the shipped file. part: the substream. scale: uint8 [symbols]. few: the number of symbols of the first
    group.
    """
    given, bytes_ = np.ascontiguousarray(scale), np.frombuffer(part, np.uint8)
    symbols, verdict = np.empty(len(given), np.int32), KernelVerdict()
    kernel.library.kernel_decode_weights(
        _tables(kernel, tables),
        kernel.variant,
        bytes_.ctypes.data,
        len(bytes_),
        lanes,
        given.ctypes.data,
        few,
        len(given) - few,
        symbols.ctypes.data,
        ctypes.byref(verdict),
    )
    return symbols, _checked([verdict])[0]


def values(
    kernel: Kernel, symbols: NDArray[np.int32], steps: NDArray[np.uint8], table: NDArray[np.float32]
) -> NDArray[np.float32]:
    """SPEC 9.2: returns symbol * table[step], float32 of the shape of symbols, [n, ...].

    steps: uint8 [n], with any stride. table: float32 [64].
    """
    given, step = np.ascontiguousarray(symbols), np.ascontiguousarray(table)
    products = np.empty(given.shape, np.float32)
    rows = len(given)
    kernel.library.kernel_values(
        kernel.variant,
        given.ctypes.data,
        steps.ctypes.data,
        steps.strides[0],
        step.ctypes.data,
        rows,
        given.size // rows if rows else 0,
        products.ctypes.data,
    )
    return products


def splats(
    kernel: Kernel, layers: Layers, blocks: Iterable[Sequence[NDArray[Any]]], to: Sequence[F32], table: F32 | None
) -> None:
    """SPEC 9.4, SPLAT: sets the Gaussians of anchors.

    layers: for each layer of the rendering networks, weights, biases and exponents, int64. blocks: of anchors; each has
    positions, masks, features, scalings and offsets as in bitstream.splat.splat. With a table, float32 [3, 64] as in
    `values`, the last three are symbols, int32, and step indices follow, uint8 [n, 3]. to: arrays for the means,
    lengths, quaternions, logits and harmonics of all kept offsets, in C order, or columns of one. Raises MemoryError.
    """
    (width, inputs), k = layers[0][0].shape, len(layers[1][1])
    joined, colours = _joined(layers), len(layers[-1][1]) // k
    networks = kernel.library.kernel_splatter_new(kernel.variant, inputs, width, k, colours, *map(_address, joined))
    if not networks:
        raise MemoryError("no memory for the rendering networks in the native kernel")
    stride = 0 if all(array.flags.c_contiguous for array in to) else to[0].strides[0] // to[0].itemsize
    first, room = 0, len(to[0])
    try:
        for block in blocks:
            held = [np.ascontiguousarray(array) for array in block]
            given = [*map(_address, held), *([None] if table is None else []), _address(table)]
            places = [array.ctypes.data + first * array.strides[0] for array in to]
            sizes = room - first, stride
            count = kernel.library.kernel_splat(networks, len(held[0]), *given, *sizes, *places, kernel.threads)
            _checked([KernelVerdict(min(count, 0))])
            first += count
    finally:
        kernel.library.kernel_free(networks)
