"""Readers of scene.json and render.json, which check every value."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..files.documents import DocumentError, read_json
from ..files.text import printable
from .layout import FORMAT, SceneFolderError


def _shown(value: Any) -> str:
    return printable(repr(value), 60)


class Document:
    """The values of scene.json or render.json. A field is named by its path, such as grid.origin or frame.matrix[0].

    Every method raises SceneFolderError for a field that is missing or not allowed.
    """

    file: Path
    again: str
    root: Any

    def __init__(self, file: Path, form: str = FORMAT, again: str = "decode again") -> None:
        """Reads the file. form: the required value of "format". again: the last remedy in every message.

        Raises SceneFolderError if it is not JSON, or has another format.
        """
        self.file, self.again = file, again
        try:
            self.root = read_json(file)
        except DocumentError as error:
            raise SceneFolderError(file, f"it is not JSON ({error})", f"restore it, or {again}") from None
        if not isinstance(self.root, dict) or self.root.get("format") != form:
            raise SceneFolderError(file, f'its "format" is not "{form}"', f"give a folder of refcodec, or {again}")

    def fault(self, name: str, problem: str) -> SceneFolderError:
        """Returns the error about a field. problem: its predicate, such as "is missing"."""
        return SceneFolderError(self.file, f'"{name}" {problem}', f"correct the field, or {self.again}")

    def value(self, name: str) -> Any:
        """Returns the JSON value of a field."""
        found = self.root
        for key, index in re.findall(r"(\w+)|\[(\d+)\]", name):
            if isinstance(found, dict) and key in found:
                found = found[key]
            elif isinstance(found, list) and index and int(index) < len(found):
                found = found[int(index)]
            else:
                raise self.fault(name, "is missing")
        return found

    def _checked(self, name: str, value: Any, low: int, high: int) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.fault(name, f"is {_shown(value)}, but must be an integer from {low} to {high}")
        return value

    def integer(self, name: str, low: int, high: int) -> int:
        """Returns an integer from low to high."""
        return self._checked(name, self.value(name), low, high)

    def _list(self, name: str, count: int | None) -> list[Any]:
        values = self.value(name)
        if not isinstance(values, list) or (count is not None and len(values) != count):
            raise self.fault(name, f"is not a list{'' if count is None else f' of {count}'}")
        return values

    def integers(self, name: str, count: int | None, low: int, high: int) -> list[int]:
        """Returns a list of integers from low to high. count: its length, or None for any length."""
        return [self._checked(f"{name}[{i}]", v, low, high) for i, v in enumerate(self._list(name, count))]

    def _float(self, name: str, value: Any) -> float:
        """Returns the nearest float32 of a value, which must be finite."""
        number = np.float32(np.nan)
        if isinstance(value, int | float) and not isinstance(value, bool):
            with np.errstate(over="ignore"), contextlib.suppress(OverflowError):
                number = np.float32(value)
        if not np.isfinite(number):
            raise self.fault(name, f"is {_shown(value)}, but must be a finite number")
        return float(number)

    def float(self, name: str) -> float:
        """Returns a finite number, rounded to float32."""
        return self._float(name, self.value(name))

    def floats(self, name: str, count: int) -> list[Any]:
        """Returns a list of `count` finite numbers, rounded to float32."""
        return [self._float(f"{name}[{i}]", v) for i, v in enumerate(self._list(name, count))]
