"""Tensors of PyTorch files: state dicts, and TorchScript archives, whose code is never run.

Both are zip archives with a pickle that names tensors, whose bytes are in the archive. A pickle can call any function.
Here none can:

- Every pickle is read opcode by opcode, and gives names and locations of tensors, not objects. A pickle that names any
  function but those that make tensors is refused.
- A state dict is then loaded by torch.load(weights_only=True).
- A TorchScript archive is not loaded. Its tensors are read from the locations in its pickle.
"""

# torch is imported where it is used. TorchScript archives are read without it.
# ruff: noqa: PLC0415

from __future__ import annotations

import contextlib
import math
import pickle
import pickletools
import zipfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.text import printable
from ..folder.layout import SceneFolderError, there
from .archives import opened_zip

AGAIN = "save it again with the program that made it"

# A HAC checkpoint has a hash grid of some ten megabytes besides its networks.
FILE_MAX = 1 << 31
# The networks of a scene have some ten tensors, whose names are a kilobyte.
PICKLE_MAX = 1 << 20
# Maximum fields of a module, and the maximum length of their names.
FIELDS_MAX, NAME_MAX = 4096, 256
# A network has less than a megabyte, a camera embedding some kilobytes.
TENSOR_MAX = 1 << 24
TENSORS_MAX = 8
# Maximum depth of objects: a network has layers, which have tensors.
DEPTH_MAX = 8
# A weight has two dimensions. No tensor of a checkpoint has more than a 3D convolution.
SIDES_MAX = 5
# Sizes, strides and offsets are int64 in torch. Longer integers would cost more with each operation.
INTEGER_BITS = 63

_TYPES = {"HalfStorage": "<f2", "FloatStorage": "<f4", "DoubleStorage": "<f8"}
_REBUILD, _PARAMETER, _DICT = (
    "torch._utils _rebuild_tensor_v2",
    "torch._utils _rebuild_parameter",
    "collections OrderedDict",
)
_STORAGES = (
    *_TYPES,
    *("BFloat16Storage", "BoolStorage", "ByteStorage", "CharStorage", "ShortStorage", "IntStorage", "LongStorage"),
)
_STORAGE_NAMES = {f"torch {storage}": storage for storage in _STORAGES}
# The functions that a state dict names: they make tensors, and none of them takes a size.
_STATE_DICT = {_REBUILD, _PARAMETER, _DICT, *_STORAGE_NAMES}
# The opcodes of torch's picklers, all of protocol 2.
_CONSTANTS: dict[str, Any] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_VALUES = {"BINUNICODE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"}
_STACKED = {
    *("PROTO", "STOP", "GLOBAL", "BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET", "MARK", "EMPTY_TUPLE", "TUPLE"),
    *("TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_DICT", "EMPTY_LIST", "APPEND", "APPENDS", "SETITEM", "SETITEMS"),
    *("NEWOBJ", "REDUCE", "BUILD", "BINPERSID"),
}


def read_state_dicts(file: Path, networks: Collection[str]) -> dict[str, dict[str, NDArray[np.float32]]]:
    """Returns the wanted state dicts of a torch.save file: float tensors by name, by network.

    networks: the wanted names. Raises SceneFolderError.
    """
    import torch

    with _opened(file) as archive:
        for entry in archive.infolist():
            if entry.compress_type != zipfile.ZIP_STORED:
                raise SceneFolderError(file, f"its entry {printable(entry.filename)} is compressed", AGAIN)
        _Machine(file, classes=False).run(_operations(file, _pickle(file, archive)))
    try:
        # Memory-mapped, because the networks are a small part of a HAC checkpoint.
        loaded = torch.load(str(file), map_location="cpu", weights_only=True, mmap=True)
    except MemoryError:
        raise
    # torch raises many types for bad bytes.
    except Exception as error:
        raise SceneFolderError(file, f"it cannot be read ({_line(error)})", AGAIN) from None
    if not isinstance(loaded, dict):
        raise SceneFolderError(file, "it holds no state dicts by name", AGAIN)
    return {
        name: _floats(file, name, values)
        for name, values in loaded.items()
        if isinstance(name, str) and name in networks
    }


def _floats(file: Path, network: str, values: Any) -> dict[str, NDArray[np.float32]]:
    """Returns the tensors of a state dict. Raises SceneFolderError for a tensor that no network or embedding has."""
    import torch

    if not isinstance(values, dict) or len(values) > TENSORS_MAX:
        raise SceneFolderError(file, f"{network} is not a state dict of at most {TENSORS_MAX} tensors", AGAIN)
    for name, value in values.items():
        dense = isinstance(value, torch.Tensor) and value.layout == torch.strided and value.is_contiguous()
        if not dense or not value.is_floating_point() or 4 * value.numel() > TENSOR_MAX:
            problem = (
                f"{network}.{printable(str(name), 60)} is not a dense tensor of floats of at most {TENSOR_MAX} bytes"
            )
            raise SceneFolderError(file, problem, AGAIN)
    return {str(name): value.detach().to(torch.float32).numpy() for name, value in values.items()}


def read_torchscript(file: Path) -> dict[str, NDArray[np.float32]]:
    """Returns the parameters of a TorchScript archive by name, such as 0.weight. None of its code is run.

    Raises SceneFolderError.
    """
    with _opened(file) as archive:
        module = _Machine(file, classes=True).run(_operations(file, _pickle(file, archive)))
        stored = dict(_parameters(file, module))
        if len(stored) > TENSORS_MAX:
            raise SceneFolderError(
                file, f"it has {len(stored)} parameters, but at most {TENSORS_MAX} are allowed", AGAIN
            )
        return {name: _tensor(file, archive, name, tensor) for name, tensor in stored.items()}


# --- the archive ------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def _opened(file: Path) -> Iterator[zipfile.ZipFile]:
    """Yields the archive of a file. Raises SceneFolderError."""
    if not there(file, AGAIN):
        raise SceneFolderError(file, "the file does not exist", AGAIN)
    if file.stat().st_size > FILE_MAX:
        raise SceneFolderError(file, f"it has more than {FILE_MAX} bytes", "give a checkpoint of a scene")
    with opened_zip(file, "zip archive, as torch writes since 1.6", AGAIN) as archive:
        names = [entry.filename for entry in archive.infolist()]
        if len(set(names)) != len(names):
            # Readers differ in which of the two they use.
            raise SceneFolderError(file, "two of its entries have the same name", AGAIN)
        yield archive


def _record(file: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Returns an entry of an archive, which must be uncompressed and have at most `most` bytes.

    name: without the archive's own folder. Raises SceneFolderError.
    """
    entries = [entry for entry in archive.infolist() if entry.filename.partition("/")[2] == name]
    if len(entries) != 1:
        raise SceneFolderError(file, f"it has {len(entries)} entries {printable(name)}, but must have exactly 1", AGAIN)
    if entries[0].compress_type != zipfile.ZIP_STORED or entries[0].file_size > most:
        raise SceneFolderError(file, f"its entry {printable(name)} is compressed, or has more than {most} bytes", AGAIN)
    try:
        with archive.open(entries[0]) as opened:
            return opened.read(most + 1)
    # zipfile raises several types for bad bytes.
    except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, RuntimeError, OSError) as error:
        raise SceneFolderError(file, f"its entry {printable(name)} is damaged ({_line(error)})", AGAIN) from None


def _pickle(file: Path, archive: zipfile.ZipFile) -> bytes:
    if any(entry.filename.partition("/")[2] == "byteorder" for entry in archive.infolist()):
        order = _record(file, archive, "byteorder", 16)
        if order != b"little":
            raise SceneFolderError(file, "its tensors are not little-endian", AGAIN)
    return _record(file, archive, "data.pkl", PICKLE_MAX)


def _line(error: Exception) -> str:
    return printable(str(error).partition("\n")[0], 120)


# --- the pickle -------------------------------------------------------------------------------------------------------


def _names(file: Path, what: str) -> SceneFolderError:
    problem = f"its pickle names {printable(what, 80)}, which is not a tensor: nothing of it was run"
    return SceneFolderError(file, problem, "give a checkpoint that torch.save wrote of state dicts")


def _operations(file: Path, data: bytes) -> Iterator[tuple[str, Any]]:
    """Returns the opcodes of a pickle with arguments. Raises SceneFolderError for those that torch does not write."""
    try:
        for operation, argument, _ in pickletools.genops(data):
            name = operation.name
            if name not in _STACKED and name not in _VALUES and name not in _CONSTANTS:
                raise SceneFolderError(file, f"its pickle has the opcode {name}, which torch does not write", AGAIN)
            yield name, argument
    except SceneFolderError:
        raise
    # pickletools raises several types for bad bytes.
    except (ValueError, pickle.UnpicklingError, IndexError, OverflowError) as error:
        raise SceneFolderError(file, f"its pickle is damaged ({_line(error)})", AGAIN) from None


@dataclass(frozen=True)
class _Stored:
    """A tensor named by a pickle. storage: its type. key: of the entry with its bytes."""

    storage: str
    key: str
    offset: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]


@dataclass(frozen=True)
class _Name:
    """A class or function that a pickle names. It is never looked up."""

    name: str


class _Machine:
    """A torch pickle, as dictionaries of fields, and locations of tensors.

    classes: whether it may name any classes. They become dictionaries of their fields.
    """

    def __init__(self, file: Path, classes: bool) -> None:
        self.file, self.classes = file, classes
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}
        self.moved = 0

    def run(self, operations: Iterator[tuple[str, Any]]) -> Any:
        """Returns the object that the pickle describes. Raises SceneFolderError."""
        try:
            for name, argument in operations:
                if name in _CONSTANTS:
                    self.stack.append(_CONSTANTS[name])
                elif name in _VALUES:
                    if type(argument) is int and argument.bit_length() > INTEGER_BITS:
                        raise ValueError
                    self.stack.append(argument)
                elif name not in ("PROTO", "STOP"):
                    self._step(name, argument)
            return self.stack.pop()
        # An opcode without operands, or with unexpected ones.
        except (IndexError, KeyError, TypeError, ValueError, AttributeError) as error:
            if isinstance(error, SceneFolderError):
                raise
            raise SceneFolderError(self.file, "its pickle is damaged", AGAIN) from None

    def _marked(self) -> list[Any]:
        mark = self.marks.pop()
        values = self.stack[mark:]
        # In place: a copy of the rest would cost the whole stack for each mark.
        del self.stack[mark:]
        return values

    def _step(self, name: str, argument: Any) -> None:
        stack = self.stack
        if name == "GLOBAL":
            if not self.classes and argument not in _STATE_DICT:
                raise _names(self.file, argument)
            stack.append(_Name(argument))
        elif name in ("BINPUT", "LONG_BINPUT"):
            self.memo[argument] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(self.memo[argument])
        elif name == "MARK":
            self.marks.append(len(stack))
        elif name in ("EMPTY_DICT", "EMPTY_LIST", "EMPTY_TUPLE"):
            stack.append({"EMPTY_DICT": {}, "EMPTY_LIST": [], "EMPTY_TUPLE": ()}[name])
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            count = int(name[-1])
            stack[-count:] = [tuple(stack[-count:])]
        elif name == "BINPERSID":
            stack.append(self._storage(stack.pop()))
        elif name in ("NEWOBJ", "REDUCE"):
            arguments, function = stack.pop(), stack.pop()
            stack.append({} if name == "NEWOBJ" else self._called(function, arguments))
        elif name == "BUILD":
            state = stack.pop()
            self._move(2 * len(state))
            self._put(stack[-1], [part for pair in state.items() for part in pair])
        elif name in ("SETITEM", "APPEND"):
            values = [stack.pop() for _ in range(2 if name == "SETITEM" else 1)][::-1]
            self._put(stack[-1], values)
        else:
            values = self._marked()
            if name == "TUPLE":
                self.stack.append(tuple(values))
            else:
                self._put(self.stack[-1], values)

    def _move(self, count: int) -> None:
        """Counts the fields that BUILD adds to objects, which repeated BUILD could grow without bound."""
        self.moved += count
        if self.moved > PICKLE_MAX:
            raise ValueError

    @staticmethod
    def _put(into: Any, values: list[Any]) -> None:
        if isinstance(into, list):
            into.extend(values)
            return
        # Hashing nested tuples could take forever.
        if not all(isinstance(key, str | int) for key in values[::2]):
            raise TypeError
        into.update(zip(values[::2], values[1::2], strict=True))

    def _storage(self, named: Any) -> tuple[str, str]:
        kind, storage, key, _, _ = named
        if kind != "storage" or not isinstance(storage, _Name) or not isinstance(key, str):
            raise ValueError
        # One of few strings, because the name may be as long as the pickle. Tensors of other types are not used.
        return _STORAGE_NAMES.get(storage.name, ""), key

    def _called(self, function: Any, arguments: Any) -> Any:
        if not isinstance(function, _Name) or function.name not in _STATE_DICT:
            raise _names(self.file, function.name if isinstance(function, _Name) else "no function")
        if function.name == _DICT:
            return {}
        if function.name == _PARAMETER:
            return arguments[0]
        if function.name != _REBUILD:
            raise _names(self.file, function.name)
        (storage, key), offset, shape, stride = arguments[:4]
        if len(shape) > SIDES_MAX:
            problem = f"its pickle has a tensor of {len(shape)} dimensions, but at most {SIDES_MAX} are allowed"
            raise SceneFolderError(self.file, problem, AGAIN)
        if len(shape) != len(stride) or not all(type(v) is int and v >= 0 for v in (offset, *shape, *stride)):
            raise ValueError
        return _Stored(storage, key, offset, tuple(shape), tuple(stride))


def _parameters(file: Path, module: Any) -> Iterator[tuple[str, _Stored]]:
    """Returns the tensors of a module by name, such as part.tensor. Raises SceneFolderError."""
    left: list[tuple[str, Any, int]] = [("", module, 0)]
    looked = 0
    while left:
        prefix, fields, depth = left.pop()
        if not isinstance(fields, dict):
            continue
        for name, value in fields.items():
            looked += 1
            if looked > FIELDS_MAX or (isinstance(name, str) and len(name) > NAME_MAX):
                problem = f"its module has more than {FIELDS_MAX} fields, or a name of more than {NAME_MAX} characters"
                raise SceneFolderError(file, problem, AGAIN)
            if isinstance(value, _Stored):
                yield f"{prefix}{name}", value
            elif depth < DEPTH_MAX:
                left.append((f"{prefix}{name}.", value, depth + 1))


def _tensor(file: Path, archive: zipfile.ZipFile, name: str, stored: _Stored) -> NDArray[np.float32]:
    """Returns a tensor, which must be contiguous. Raises SceneFolderError."""
    kind = _TYPES.get(stored.storage)
    packed, stride = 1, []
    for side in reversed(stored.shape):
        stride.append(packed)
        packed *= side
    in_order = all(side == 1 or s == t for side, s, t in zip(stored.shape, stored.stride, stride[::-1], strict=True))
    count = math.prod(stored.shape)
    if kind is None or not in_order or not 0 < 4 * count <= TENSOR_MAX:
        problem = (
            f"its parameter {printable(name, 60)} is not a contiguous tensor of floats of at most {TENSOR_MAX} bytes"
        )
        raise SceneFolderError(file, problem, AGAIN)
    data = _record(file, archive, f"data/{stored.key}", TENSOR_MAX)
    size = np.dtype(kind).itemsize
    if len(data) < (stored.offset + count) * size:
        raise SceneFolderError(file, f"its parameter {printable(name, 60)} has fewer bytes than its shape needs", AGAIN)
    return np.frombuffer(data, kind, count, stored.offset * size).astype(np.float32).reshape(stored.shape)
