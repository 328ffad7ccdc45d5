"""Arrays of safetensors files: bounded reading of expected ones, networks, and writing by blocks of rows."""

# safetensors is imported where it is used, so that a decode that fails does not wait for it.
# ruff: noqa: PLC0415

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..bitstream.networks import Layer
from ..files.stage import new_file
from .layout import SCENE_FILE, SceneFolderError

# A scene has at most a hundred arrays, each with a name, a shape and offsets.
HEADER_MAX = 1 << 20


# The shape and the dtype of each expected array, by name.
Wanted = Mapping[str, tuple[tuple[int, ...], type[np.generic]]]


def read_arrays(file: Path, again: str) -> dict[str, NDArray[Any]]:
    """Returns the arrays of a file by name. again: the remedy in errors. Raises SceneFolderError."""
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        with file.open("rb") as opened:
            header = int.from_bytes(opened.read(8), "little")
        if header > HEADER_MAX:
            raise SceneFolderError(file, f"its header has {header} bytes, but at most {HEADER_MAX} are allowed", again)
        return load_file(file)
    except SceneFolderError:
        raise
    # The safetensors package raises KeyError or TypeError for a dtype that NumPy does not have.
    except (SafetensorError, ValueError, KeyError, TypeError, OSError) as error:
        raise SceneFolderError(file, f"it cannot be read ({error})", again) from None


def check_arrays(file: Path, arrays: Mapping[str, NDArray[Any]], wanted: Wanted, again: str) -> None:
    """Raises SceneFolderError if a file has other arrays than expected, or one of another shape or dtype, or with NaN.

    again: the remedy for a missing array, or one with a NaN or an infinity.
    """
    for name in sorted(wanted.keys() | arrays.keys()):
        if name not in arrays:
            raise SceneFolderError(file, f"the array {name} is missing", again)
        if name not in wanted:
            raise SceneFolderError(
                file, f"the array {name} is not known", f"remove it, or correct the dimensions in {SCENE_FILE}"
            )
        (shape, dtype), array = wanted[name], arrays[name]
        if array.shape != shape or array.dtype != dtype:
            problem = f"{name} is {array.dtype}{list(array.shape)}, but must be {np.dtype(dtype)}{list(shape)}"
            raise SceneFolderError(file, problem, f"correct the array, or {again}")
        if not np.isfinite(array).all():
            raise SceneFolderError(file, f"{name} has a NaN or an infinity", again)


def _layers(networks: Mapping[str, Sequence[Any]]) -> Iterator[tuple[str, str, int, int]]:
    """Yields the name of each weight and bias, its network, its layer, and 0 for a weight or 1 for a bias."""
    for network, layers in networks.items():
        for index in range(len(layers)):
            for kind, part in enumerate(("weight", "bias")):
                yield f"{network}.{index}.{part}", network, index, kind


def read_networks(
    file: Path, arrays: Mapping[str, NDArray[Any]], shapes: Mapping[str, Sequence[tuple[int, int]]], again: str
) -> dict[str, list[Layer]]:
    """Returns the networks of a file. shapes: [out, in] of each layer. arrays, again: as for check_arrays."""
    wanted = {name: (shapes[network][i][: 2 - kind], np.float32) for name, network, i, kind in _layers(shapes)}
    check_arrays(file, arrays, wanted, again)
    return {
        network: [(arrays[f"{network}.{i}.weight"], arrays[f"{network}.{i}.bias"]) for i in range(len(layers))]
        for network, layers in shapes.items()
    }


def write_networks(file: Path, networks: Mapping[str, list[Layer]]) -> None:
    """Writes networks to a new file. Raises OSError."""
    write_arrays(file, {name: networks[network][i][kind] for name, network, i, kind in _layers(networks)})


def write_arrays(file: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Writes arrays to a new file. Raises OSError."""
    from safetensors.numpy import save

    with new_file(file) as opened:
        opened.write(save({name: np.ascontiguousarray(array) for name, array in arrays.items()}))


# The dtype names in a header.
_DTYPES = {"uint8": "U8", "uint16": "U16", "int32": "I32"}


class RowsFile:
    """A safetensors file that is written by blocks of rows.

    The package writes only arrays that are whole in memory. The bytes are those that it writes for the same arrays.
    """

    def __init__(self, file: BinaryIO, arrays: Mapping[str, tuple[Any, tuple[int, ...]]], rows: int) -> None:
        """Writes the header.

        file: new and seekable.
        arrays: the dtype and the row shape of each array, by name.
        rows: the number of rows of every array.
        """
        # The package puts the arrays with the largest items first.
        order = sorted(arrays, key=lambda name: (-np.dtype(arrays[name][0]).itemsize, name))
        header: dict[str, Any] = {}
        starts, at = {}, 0
        for name in order:
            dtype, row = np.dtype(arrays[name][0]), arrays[name][1]
            starts[name], at = at, at + rows * math.prod(row) * dtype.itemsize
            header[name] = {"dtype": _DTYPES[dtype.name], "shape": [rows, *row], "data_offsets": [starts[name], at]}
        text = json.dumps(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 8)
        file.write(len(text).to_bytes(8, "little") + text)
        self._file = file
        self._places = {name: 8 + len(text) + start for name, start in starts.items()}

    def add(self, blocks: Mapping[str, NDArray[Any]]) -> None:
        """Writes the next rows of every array. Raises OSError."""
        for name, block in blocks.items():
            data = block.astype(block.dtype.newbyteorder("<"), copy=False).tobytes()
            self._file.seek(self._places[name])
            self._file.write(data)
            self._places[name] += len(data)
