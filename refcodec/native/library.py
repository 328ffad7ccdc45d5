"""The library of the native kernel, loaded by ctypes, and the choice between it and NumPy.

Two environment variables are read whenever a file is opened or written:

- REFCODEC_PATH: `numpy`, `native`, or a variant of the kernel such as `avx2`. The default is the best variant that the
  machine can run, or NumPy without a kernel.
- REFCODEC_THREADS: the number of threads of the kernel. The default is the number of cores of this process.
"""

import ctypes
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ..statuses import UsageError

PATH_VARIABLE, THREADS_VARIABLE = "REFCODEC_PATH", "REFCODEC_THREADS"
NUMPY, NATIVE = "numpy", "native"
# The output of setup.py.
LIBRARY = Path(__file__).with_name("kernel.so")
THREADS_MAX = 256
# kernel.h: the version of its interface, its statuses that are not error codes, and its array lengths.
VERSION = 4
DONE, NO_MEMORY, REFUSED, REFUSED_FORM, REFUSED_STEPS = 0, -1, -2, -3, -4
SLICES_MAX, PARTS, PLANES, NUMBERS = 16, 3, 5, 2

Pointer = ctypes.c_void_p


def _fields(kind: Any, names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names.split()]


class KernelDescription(ctypes.Structure):
    """kernel.h: kernel_description."""

    _fields_ = (
        *_fields(ctypes.c_int32, "offset_count plane_channels plane_size frequency_count plane_shift slice_count"),
        ("slice_width", ctypes.c_int32 * SLICES_MAX),
        *_fields(ctypes.c_int32, "hyper_layers sarm_layers carm_layers"),
        *_fields(ctypes.c_int32, "plane_lanes mask_lanes attribute_lanes cell_shift"),
        *_fields(Pointer, "shape weight bias exponent carm_shift frame planes mask_model position_model"),
    )


class KernelVerdict(ctypes.Structure):
    """kernel.h: kernel_verdict."""

    _fields_ = (("status", ctypes.c_int32), ("part", ctypes.c_int32), ("number", ctypes.c_int64 * NUMBERS))


class KernelChunk(ctypes.Structure):
    """kernel.h: kernel_chunk."""

    _fields_ = (
        ("part", Pointer * PARTS),
        ("length", ctypes.c_uint64 * PARTS),
        *_fields(Pointer, "positions masks features scalings offsets steps"),
        ("anchors", ctypes.c_uint32),
        ("kept", ctypes.c_uint32),
        ("low", ctypes.c_uint16 * 3),
        ("high", ctypes.c_uint16 * 3),
        ("form", ctypes.c_int32),
        ("verdict", KernelVerdict),
    )


_INT32, _UINT32, _INT64, _UINT64 = ctypes.c_int32, ctypes.c_uint32, ctypes.c_int64, ctypes.c_uint64
# kernel.h: the result and the parameters of each function.
_FUNCTIONS = {
    "kernel_version": (_INT32, []),
    "kernel_variant_name": (ctypes.c_char_p, [_INT32]),
    "kernel_variant_runs": (_INT32, [_INT32]),
    "kernel_tables_new": (Pointer, [ctypes.c_char_p, _UINT64]),
    "kernel_tables_free": (None, [Pointer]),
    "kernel_scene_new": (Pointer, [ctypes.POINTER(KernelDescription), Pointer, _INT32]),
    "kernel_scene_free": (None, [Pointer]),
    "kernel_decode_weights": (
        None,
        [Pointer, _INT32, Pointer, _UINT64, _INT32, Pointer, _UINT64, _UINT64, Pointer, Pointer],
    ),
    "kernel_decode_planes": (None, [Pointer, Pointer, Pointer, Pointer, Pointer, _INT32]),
    "kernel_encode_planes": (None, [Pointer, Pointer, Pointer, Pointer, Pointer, _INT32]),
    "kernel_decode_chunks": (None, [Pointer, Pointer, _INT64, _INT32]),
    "kernel_encode_chunks": (None, [Pointer, Pointer, _INT64, _INT32]),
    "kernel_free": (None, [Pointer]),
    "kernel_splatter_new": (Pointer, [_INT32, *[_UINT32] * 4, Pointer, Pointer, Pointer]),
    "kernel_splat": (_INT32, [Pointer, _UINT32, *[Pointer] * 7, _UINT32, _UINT32, *[Pointer] * 5, _INT32]),
    "kernel_values": (None, [_INT32, Pointer, Pointer, _INT64, Pointer, _INT64, _INT64, Pointer]),
}


@dataclass(frozen=True)
class Kernel:
    """The selected kernel. library: with typed functions. name, variant: of the variant. threads: at least 1."""

    library: ctypes.CDLL
    name: str
    variant: int
    threads: int


@cache
def load(path: Path = LIBRARY) -> ctypes.CDLL | None:
    """Returns the library, or None if it cannot be loaded or has another version."""
    try:
        library = ctypes.CDLL(str(path))
        for name, (result, parameters) in _FUNCTIONS.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, parameters
    except (OSError, AttributeError):
        return None
    return library if library.kernel_version() == VERSION else None


def variants(library: ctypes.CDLL) -> Iterator[tuple[int, str]]:
    """Yields number and name of each variant that this machine can run, the best one last."""
    number = 0
    while name := library.kernel_variant_name(number):
        if library.kernel_variant_runs(number):
            yield number, name.decode()
        number += 1


def paths() -> list[str]:
    """Returns the values of REFCODEC_PATH that are allowed here."""
    library = load()
    return [NUMPY] if library is None else [NUMPY, NATIVE, *(name for _, name in variants(library))]


def threads() -> int:
    """Returns the number of threads of the kernel. Raises UsageError for an invalid number."""
    text = os.environ.get(THREADS_VARIABLE)
    if not text:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return min(cores, THREADS_MAX)
    if not (text.isascii() and text.isdigit() and 1 <= int(text[:4]) <= THREADS_MAX and len(text) <= 4):
        raise UsageError(f"{THREADS_VARIABLE} is {text!a}; it may be 1 to {THREADS_MAX}")
    return int(text)


def kernel() -> Kernel | None:
    """Returns the selected kernel, or None for NumPy. Raises UsageError for an unavailable path."""
    wanted, library, count = os.environ.get(PATH_VARIABLE), load(), threads()
    if wanted and wanted not in paths():
        there = ", ".join(paths())
        raise UsageError(f"{PATH_VARIABLE} is {wanted!a}; on this machine it must be one of {there}")
    if library is None or wanted == NUMPY:
        return None
    built = list(variants(library))
    number, name = built[-1] if not wanted or wanted == NATIVE else next(v for v in built if v[1] == wanted)
    return Kernel(library, name, number, count)


def faster() -> str | None:
    """Returns why a slower path is selected than the processor allows, or None. Raises UsageError."""
    used, library = kernel(), load()
    if library is None:
        return "the native kernel is not there; it is built if a C compiler is present at installation"
    *_, (best, name) = variants(library)
    return None if used and used.variant == best else f"{PATH_VARIABLE} excludes {name}, which is faster"


def describe() -> str:
    """Returns a description of the selected path. Raises UsageError."""
    used, reason = kernel(), faster()
    path = f"native kernel {used.name}, {used.threads} thread{'s' if used.threads > 1 else ''}" if used else "NumPy"
    return f"{path}; {reason}" if reason else path
