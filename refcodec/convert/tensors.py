"""Tensors of PyTorch files: state dicts, and TorchScript archives, whose code is never run.

Both are zip archives with a pickle that names tensors, whose bytes are in the archive. A pickle can call any function.
Here none can: every pickle is read opcode by opcode, and gives names and locations of tensors, not objects. A pickle of
state dicts that names any function but those that make tensors is refused.
"""

import contextlib
import io
import math
import pickle
import pickletools
import zipfile
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.text import printable
from ..folder.layout import SceneFolderError, there
from ..formats.archives import opened_zip, read_entry
from ..formats.common import ContentError, errors_in

AGAIN = "save it again with the program that made it"

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

# NumPy's type of the numbers of a storage. The upper half of a float32 is a bfloat16.
_BFLOAT16 = "BFloat16Storage"
_TYPES = {"HalfStorage": "<f2", "FloatStorage": "<f4", "DoubleStorage": "<f8", _BFLOAT16: "<u2"}
_REBUILD, _PARAMETER = "torch._utils _rebuild_tensor_v2", "torch._utils _rebuild_parameter"
_DICT = "collections OrderedDict"
_INTEGERS = ("BoolStorage", "ByteStorage", "CharStorage", "ShortStorage", "IntStorage", "LongStorage")
_STORAGES = {f"torch {storage}": storage for storage in (*_TYPES, *_INTEGERS)}
# The functions that a state dict names: they make tensors, and none of them takes a size.
_STATE_DICT = {_REBUILD, _PARAMETER, _DICT, *_STORAGES}
# What torch adds to the fields of a state dict.
_METADATA = "_metadata"
# The opcodes of torch's picklers, all of protocol 2.
_CONSTANTS: dict[str, Any] = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_VALUES = {"BINUNICODE", "BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT"}
_STACKED = {
    *("PROTO", "STOP", "GLOBAL", "BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET", "MARK", "EMPTY_TUPLE", "TUPLE"),
    *("TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_DICT", "EMPTY_LIST", "APPEND", "APPENDS", "SETITEM", "SETITEMS"),
    *("NEWOBJ", "REDUCE", "BUILD", "BINPERSID"),
}

Parameters = dict[str, NDArray[np.float32]]
# Returns the entry of an archive by its name and its maximum size in bytes.
Record = Callable[[str, int], bytes]


def read_state_dicts(file: Path, networks: Collection[str]) -> dict[str, Parameters]:
    """Returns the wanted state dicts of a torch.save file: float tensors by name, by network.

    networks: the wanted names. Raises SceneFolderError.
    """
    with _opened(file) as record:
        loaded = _Machine(classes=False).run(record("data.pkl", PICKLE_MAX))
        if not isinstance(loaded, dict):
            raise ContentError("it holds no state dicts by name")
        wanted = [name for name in loaded if isinstance(name, str) and name in networks]
        return {name: _parameters(record, f"{name}.", loaded[name]) for name in wanted}


def read_torchscript(file: Path) -> Parameters:
    """Returns the parameters of a TorchScript archive by name, such as 0.weight. None of its code is run.

    Raises SceneFolderError.
    """
    with _opened(file) as record:
        return _parameters(record, "", dict(_fields(_Machine(classes=True).run(record("data.pkl", PICKLE_MAX)))))


def _parameters(record: Record, network: str, values: Any) -> Parameters:
    """Returns the tensors of a state dict. network: the start of their names in errors. Raises ContentError."""
    named = {name: value for name, value in values.items() if name != _METADATA} if isinstance(values, dict) else None
    if named is None or len(named) > TENSORS_MAX:
        raise ContentError(f"{network or 'it'} does not have at most {TENSORS_MAX} tensors by name")
    return {str(name): _tensor(record, f"{network}{name}", value) for name, value in named.items()}


@contextlib.contextmanager
def _opened(file: Path) -> Iterator[Record]:
    """Yields what reads an entry of an archive, which must be uncompressed.

    Its arguments are the name of the entry without the archive's own folder, and its maximum size in bytes. Raises
    SceneFolderError, also for a ContentError inside.
    """
    if not there(file, AGAIN):
        raise SceneFolderError(file, "the file does not exist", AGAIN)
    with errors_in(file, AGAIN), opened_zip(io.FileIO(file), "zip archive, as torch writes since 1.6") as archive:
        entries = {entry.filename.partition("/")[2]: entry for entry in archive.infolist()}
        if len(entries) < len(archive.infolist()):
            # Readers differ in which of the two they use.
            raise ContentError("two of its entries have the same name")

        def record(name: str, most: int) -> bytes:
            entry, shown = entries.get(name), printable(name, 60)
            if entry is None:
                raise ContentError(f"it has no entry {shown}")
            if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > most:
                raise ContentError(f"its entry {shown} is compressed, or has more than {most} bytes")
            return read_entry(archive, entry.filename, most)

        if "byteorder" in entries and record("byteorder", 16) != b"little":
            raise ContentError("its tensors are not little-endian")
        yield record


# --- the pickle -------------------------------------------------------------------------------------------------------


def _names(what: str) -> ContentError:
    problem = f"its pickle names {printable(what, 80)}, which is not a tensor: nothing of it was run"
    return ContentError(problem, "give a checkpoint that torch.save wrote of state dicts")


def _operations(data: bytes) -> Iterator[tuple[str, Any]]:
    """Returns the opcodes of a pickle with arguments. Raises ContentError for those that torch does not write."""
    try:
        for operation, argument, _ in pickletools.genops(data):
            name = operation.name
            if name not in _STACKED and name not in _VALUES and name not in _CONSTANTS:
                raise ContentError(f"its pickle has the opcode {name}, which torch does not write")
            yield name, argument
    except ContentError:
        raise
    # pickletools raises several types for bad bytes.
    except (ValueError, pickle.UnpicklingError, IndexError, OverflowError) as error:
        line = printable(str(error).partition("\n")[0], 120)
        raise ContentError(f"its pickle is damaged ({line})") from None


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

    def __init__(self, classes: bool) -> None:
        self.classes = classes
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}
        self.moved = 0

    def run(self, data: bytes) -> Any:
        """Returns the object that a pickle describes. Raises ContentError."""
        try:
            for name, argument in _operations(data):
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
            if isinstance(error, ContentError):
                raise
            raise ContentError("its pickle is damaged") from None

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
                raise _names(argument)
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
        return _STORAGES.get(storage.name, ""), key

    def _called(self, function: Any, arguments: Any) -> Any:
        if not isinstance(function, _Name) or function.name not in _STATE_DICT:
            raise _names(function.name if isinstance(function, _Name) else "no function")
        if function.name == _DICT:
            return {}
        if function.name == _PARAMETER:
            return arguments[0]
        if function.name != _REBUILD:
            raise _names(function.name)
        (storage, key), offset, shape, stride = arguments[:4]
        if len(shape) > SIDES_MAX:
            raise ContentError(
                f"its pickle has a tensor of {len(shape)} dimensions, but at most {SIDES_MAX} are allowed"
            )
        if len(shape) != len(stride) or not all(type(v) is int and v >= 0 for v in (offset, *shape, *stride)):
            raise ValueError
        return _Stored(storage, key, offset, tuple(shape), tuple(stride))


def _fields(module: Any) -> Iterator[tuple[str, _Stored]]:
    """Returns the tensors of a module by name, such as part.tensor. Raises ContentError."""
    left: list[tuple[str, Any, int]] = [("", module, 0)]
    looked = 0
    while left:
        prefix, fields, depth = left.pop()
        if not isinstance(fields, dict):
            continue
        for name, value in fields.items():
            looked += 1
            if looked > FIELDS_MAX or (isinstance(name, str) and len(name) > NAME_MAX):
                raise ContentError(
                    f"its module has more than {FIELDS_MAX} fields, or a name of more than {NAME_MAX} characters"
                )
            if isinstance(value, _Stored):
                yield f"{prefix}{name}", value
            elif depth < DEPTH_MAX:
                left.append((f"{prefix}{name}.", value, depth + 1))


def _tensor(record: Record, name: str, stored: Any) -> NDArray[np.float32]:
    """Returns a tensor, which must be contiguous. Raises ContentError."""
    name = printable(name, 60)
    kind = _TYPES.get(stored.storage) if isinstance(stored, _Stored) else None
    if kind is None or not _is_dense(stored):
        raise ContentError(f"{name} is not a dense tensor of floats of at most {TENSOR_MAX} bytes")
    count, size = math.prod(stored.shape), np.dtype(kind).itemsize
    data = record(f"data/{stored.key}", TENSOR_MAX) if count else b""
    start = stored.offset * size if count else 0
    if len(data) < start + count * size:
        raise ContentError(f"{name} has fewer bytes than its shape needs")
    values = np.frombuffer(data, kind, count, start) if count else np.zeros(0)
    if stored.storage == _BFLOAT16:
        values = (values.astype("<u4") << 16).view("<f4")
    return values.astype(np.float32).reshape(stored.shape)


def _is_dense(stored: _Stored) -> bool:
    """Whether the numbers of a tensor follow each other, the last side first, and are at most TENSOR_MAX bytes."""
    sides, count = stored.shape, math.prod(stored.shape)
    wanted = [math.prod(sides[number + 1 :]) for number in range(len(sides))]
    in_order = all(side == 1 or own == w for side, own, w in zip(sides, stored.stride, wanted, strict=True))
    return 4 * count <= TENSOR_MAX and (in_order or not count)
