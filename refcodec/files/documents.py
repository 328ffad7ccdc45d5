"""JSON and TOML documents from outside, within bounds of size, depth, encoding and numbers, as typed values."""

import json
import math
import re
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from .text import printable

# The maximum bytes of a JSON document and of a file of settings.
SIZE_MAX = 64 << 20
TOML_MAX = 1 << 20
# The maximum number of nested lists, objects and tables.
DEPTH_MAX = 64
# The maximum digits of an integer: more than any 64-bit number has, so that range checks report their own error.
DIGITS_MAX = 40

# What msgspec calls the types of values, and the most characters that an error repeats of a value.
_WORDS = {
    **{"int": "an integer", "float": "a number", "str": "a text", "bool": "true or false", "array": "a list"},
    **{"object": "an object", "null": "null"},
}
_SHOWN = 60


class DocumentError(ValueError):
    """A document that is not JSON or TOML within the bounds. The text states the problem, without the file's name."""


class FieldError(DocumentError):
    """A value of a document that is missing, not known or not allowed.

    name: its path in the document, such as grid.origin[0]. problem: the predicate, such as "is missing".
    """

    def __init__(self, name: str, problem: str) -> None:
        self.name, self.problem = name, problem
        super().__init__(f"{name or 'it'} {problem}")


def parse_json(data: bytes | str, most: int = SIZE_MAX) -> Any:
    """Returns the value of a JSON text.

    Args:
        data: UTF-8, or text.
        most: the maximum length of the data.

    Raises:
        DocumentError: too long, not UTF-8, nested deeper than 64, a duplicate name in an object, a number that is not
            finite or has more than 40 digits, or not JSON.
    """
    return _parsed("JSON", partial(json.loads, object_pairs_hook=_object), data, most)


def parse_toml(data: bytes | str, most: int = TOML_MAX) -> dict[str, Any]:
    """Returns the values of a TOML text. Arguments and errors: as for parse_json."""
    values: dict[str, Any] = _parsed("TOML", tomllib.loads, data, most)
    return values


def read_json(path: Path, most: int = SIZE_MAX) -> Any:
    """Returns the value of a JSON file. Raises DocumentError as parse_json, and OSError."""
    with path.open("rb") as file:
        return parse_json(file.read(most + 1), most)


def read_toml(path: Path, most: int = TOML_MAX) -> dict[str, Any]:
    """Returns the values of a TOML file. Raises DocumentError as parse_json, and OSError."""
    with path.open("rb") as file:
        return parse_toml(file.read(most + 1), most)


def checked(value: Any, kind: Any) -> Any:
    """Returns a value of a document as a type of msgspec: a Struct, a dataclass, or one with the bounds of a Meta.

    Raises FieldError, whose problem states the value and what is required.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        text, own = str(error), error.__cause__ is not None
    if of_key := re.fullmatch(r"(.*) - at `key` in `\$\.?(.*)`", text, re.DOTALL):
        raise FieldError(of_key[2], f"has a name that is not allowed: {printable(of_key[1], _SHOWN)}")
    problem, _, path = text.partition(" - at `$")
    name = path.removesuffix("`").removeprefix(".")
    if own:  # of a check of the type's own
        raise FieldError(name, f"is not right: {problem}")
    if absent := re.fullmatch(r"Object (missing required|contains unknown) field `(.*)`", problem):
        raise FieldError(f"{name}.{absent[2]}".lstrip("."), "is missing" if absent[1][0] == "m" else "is not known")
    # A key of a dictionary is "...".
    for key, index in re.findall(r"(\w+)|\[(\d+)\]", name.partition("[...]")[0]):
        value = value[key] if key else value[int(index)]
    required = problem.removeprefix("Expected ").partition(", got ")[0]
    required = re.sub(r"`([^`]+)`", lambda kind: re.sub(r"\w+", lambda w: _WORDS.get(w[0], w[0]), kind[1]), required)
    raise FieldError(name, f"is {printable(repr(value), _SHOWN)}: {required} is required")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) != len(pairs):
        raise DocumentError("a name stands twice in an object")
    return members


def _parsed(kind: str, parse: Callable[[str], Any], data: bytes | str, most: int) -> Any:
    if len(data) > most:
        raise DocumentError(f"more than {most} bytes")
    try:
        parsed = parse(data if isinstance(data, str) else data.decode("utf-8"))
    except DocumentError:
        raise
    except UnicodeDecodeError as error:
        raise DocumentError(f"not UTF-8 (byte {error.start})") from None
    # The parsers call themselves for each level. Python gives a plain ValueError for an integer of thousands of digits.
    except RecursionError:
        raise DocumentError(f"nested deeper than {DEPTH_MAX}") from None
    except ValueError as error:
        raise DocumentError(f"not {kind} ({error})") from None
    depth, level = 0, [parsed]
    while level:
        inner: list[Any] = []
        for value in level:
            if isinstance(value, int) and abs(value) >= 10**DIGITS_MAX:
                raise DocumentError(f"an integer has more than {DIGITS_MAX} digits")
            if isinstance(value, float) and not math.isfinite(value):
                raise DocumentError(f"a number is {value}; only finite numbers are allowed")
            if isinstance(value, dict | list):
                if depth == DEPTH_MAX:
                    raise DocumentError(f"nested deeper than {DEPTH_MAX}")
                inner += value.values() if isinstance(value, dict) else value
        depth, level = depth + 1, inner
    return parsed
