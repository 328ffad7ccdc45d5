"""Arrays of safetensors files: bounded reading, and writing by blocks of rows."""

# safetensors is imported where it is used, so that a decode that fails does not wait for it.
# ruff: noqa: PLC0415

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .layout import SceneFolderError

# A scene has at most a hundred arrays, each with a name, a shape and offsets.
HEADER_MAX = 1 << 20


def read_arrays(file: Path, advice: str) -> dict[str, NDArray[Any]]:
    """Returns the arrays of a file by name. advice: the remedy in errors. Raises SceneFolderError."""
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        with file.open("rb") as opened:
            header = int.from_bytes(opened.read(8), "little")
        if header > HEADER_MAX:
            raise SceneFolderError(file, f"its header has {header} bytes, but at most {HEADER_MAX} are allowed", advice)
        return load_file(file)
    except SceneFolderError:
        raise
    # The safetensors package raises KeyError or TypeError for a dtype that NumPy does not have.
    except (SafetensorError, ValueError, KeyError, TypeError, OSError) as error:
        raise SceneFolderError(file, f"it cannot be read ({error})", advice) from None


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
