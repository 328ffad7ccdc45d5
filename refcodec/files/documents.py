"""JSON and TOML from outside, read within bounds: size, depth, encoding, numbers."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

# The largest document that people write by hand or programs write for people, in bytes.
SIZE_MAX = 64 << 20
# A file of settings.
TOML_MAX = 1 << 20
# Python's parser goes one call deeper for each level.
DEPTH_MAX = 64
# Of an integer's digits: enough for every 64-bit number, and for its neighbours to be told that they are too large.
DIGITS_MAX = 40

# What is not a bracket: strings, and all else.
_BRACKETS = re.compile(r'"(?:[^"\\]|\\.)*"?|[\[{]|[\]}]', re.DOTALL)


class DocumentError(ValueError):
    """A document that is not JSON, or not TOML, within the bounds. The text says what is wrong, but not where."""


def _depth(text: str) -> int:
    """Returns how deep brackets are nested."""
    depth = deepest = 0
    for found in _BRACKETS.finditer(text):
        first = found[0][0]
        if first in "[{":
            depth += 1
            deepest = max(deepest, depth)
        elif first in "]}":
            depth -= 1
    return deepest


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise DocumentError("a name stands twice in an object")
    return found


def _integer(text: str) -> int:
    if len(text) > DIGITS_MAX:
        raise DocumentError(f"a number has {len(text)} digits, at most {DIGITS_MAX} are allowed")
    return int(text)


def _real(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise DocumentError("a number is too large")
    return value


def _constant(text: str) -> float:
    raise DocumentError(f"{text} is no number of JSON")


def parse_json(data: bytes | str, most: int = SIZE_MAX) -> Any:
    """Returns the value of a JSON text.

    Args:
        data: UTF-8, or text.
        most: the most bytes that are looked at.

    Raises:
        DocumentError: too long, not UTF-8, nested deeper than 64, a name twice in one object, a number that is not
            finite or has more than 40 digits, or not JSON.
    """
    if len(data) > most:
        raise DocumentError(f"more than {most} bytes")
    try:
        text = data if isinstance(data, str) else data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise DocumentError(f"not UTF-8 (byte {error.start})") from None
    if _depth(text) > DEPTH_MAX:
        raise DocumentError(f"nested deeper than {DEPTH_MAX}")
    try:
        return json.loads(
            text, object_pairs_hook=_object, parse_int=_integer, parse_float=_real, parse_constant=_constant
        )
    except json.JSONDecodeError as error:
        raise DocumentError(f"not JSON ({error})") from None


def parse_toml(data: bytes | str, most: int = TOML_MAX) -> dict[str, Any]:
    """Returns the values of a TOML text.

    Args:
        data: UTF-8, or text.
        most: the most bytes that are looked at.

    Raises:
        DocumentError: too long, not UTF-8, nested deeper than 64, an integer of more than 40 digits, or not TOML.
    """
    if len(data) > most:
        raise DocumentError(f"more than {most} bytes")
    try:
        found = tomllib.loads(data if isinstance(data, str) else data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise DocumentError(f"not UTF-8 (byte {error.start})") from None
    # The parser goes a call deeper for each level. It gives a plain ValueError for an integer of thousands of digits.
    except (RecursionError, ValueError) as error:
        raise DocumentError(f"not TOML ({error})") from None
    level: list[Any] = [found]
    for _ in range(DEPTH_MAX):
        level = [inner for value in level for inner in _inner(value)]
        if any(type(value) is int and abs(value) >= 10**DIGITS_MAX for value in level):
            raise DocumentError(f"an integer has more than {DIGITS_MAX} digits")
    if level:
        raise DocumentError(f"nested deeper than {DEPTH_MAX}")
    return found


def _inner(value: Any) -> Iterable[Any]:
    """Returns the values in a table or an array."""
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def read_json(path: Path, most: int = SIZE_MAX) -> Any:
    """Returns the value of a JSON file. Raises DocumentError as parse_json, and OSError."""
    with path.open("rb") as file:
        return parse_json(file.read(most + 1), most)
