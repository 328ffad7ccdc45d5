"""scene.json: its values, each checked where it is read."""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..bitstream.header import VERSION
from .layout import FORMAT, SceneFolderError

if TYPE_CHECKING:
    pass


_I32 = (-(1 << 31), (1 << 31) - 1)


class Document:
    """scene.json, field by field, each checked as it is read. Fields are named by dotted paths."""

    def __init__(self, file: Path) -> None:
        self.file = file
        try:
            self.root = json.loads(file.read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise SceneFolderError(file, f"it is not JSON ({error})", "restore it, or decode again") from None
        if not isinstance(self.root, dict) or self.root.get("format") != FORMAT:
            raise SceneFolderError(
                file, f'its "format" is not "{FORMAT}"', "give a folder that `refcodec decode` or `refcodec fit` wrote"
            )
        self.integer("version", VERSION, VERSION)

    def fault(self, name: str, problem: str) -> SceneFolderError:
        return SceneFolderError(self.file, f'"{name}" {problem}', "correct the field, or decode again")

    def value(self, name: str) -> Any:
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
            raise self.fault(name, f"is {value!r}, an integer from {low} to {high} is required")
        return value

    def integer(self, name: str, low: int, high: int) -> int:
        return self._checked(name, self.value(name), low, high)

    def _list(self, name: str, count: int | None) -> list[Any]:
        values = self.value(name)
        if not isinstance(values, list) or (count is not None and len(values) != count):
            raise self.fault(name, f"is not a list{'' if count is None else f' of {count}'}")
        return values

    def integers(self, name: str, count: int | None, low: int, high: int) -> list[int]:
        return [self._checked(f"{name}[{i}]", v, low, high) for i, v in enumerate(self._list(name, count))]

    def _float(self, name: str, value: Any) -> float:
        """A finite float32."""
        number = np.float32(np.nan)
        if isinstance(value, int | float) and not isinstance(value, bool):
            with np.errstate(over="ignore"), contextlib.suppress(OverflowError):
                number = np.float32(value)
        if not np.isfinite(number):
            raise self.fault(name, f"is {value!r}, a finite number is required")
        return float(number)

    def float(self, name: str) -> float:
        return self._float(name, self.value(name))

    def floats(self, name: str, count: int) -> list[Any]:
        return [self._float(f"{name}[{i}]", v) for i, v in enumerate(self._list(name, count))]
