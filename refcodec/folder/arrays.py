"""Arrays of a safetensors file, read within bounds."""

# safetensors is imported where it is used. A decode that fails should not wait for it.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path

from numpy.typing import NDArray

from .layout import SceneFolderError

# A scene has at most a hundred arrays, each with a name, a shape and a place.
HEADER_MAX = 1 << 20


def read_arrays(file: Path, advice: str) -> dict[str, NDArray]:
    """Returns the arrays of a file by name.

    advice: what to do if it cannot be read. Raises SceneFolderError.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        with file.open("rb") as opened:
            header = int.from_bytes(opened.read(8), "little")
        if header > HEADER_MAX:
            raise SceneFolderError(file, f"its header has {header} bytes, {HEADER_MAX} are allowed", advice)
        return load_file(file)
    except SceneFolderError:
        raise
    # The safetensors package raises KeyError or TypeError for a dtype that NumPy does not have.
    except (SafetensorError, ValueError, KeyError, TypeError, OSError) as error:
        raise SceneFolderError(file, f"it cannot be read ({error})", advice) from None
