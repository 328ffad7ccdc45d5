"""Settings as text: printed with their documentation (TOML), read from a file, changed by name.

Any fault of a name or a value is a SettingsError of one line.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from ..files.documents import TOML_MAX, DocumentError, parse_toml
from .settings import Phase, TrainSettings

T = TypeVar("T")

_WORDS = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}


class SettingsError(ValueError):
    """A setting that does not exist, or a value that it cannot have."""


# --- out --------------------------------------------------------------------------------------------------------------


def document(settings: Any) -> dict[str, Any]:
    """Settings as JSON has them: dictionaries, lists, numbers and texts. merged() makes the settings again."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(settings)))
    return plain


def differences(one: Mapping[str, Any], two: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Where two documents differ, in words: a line for each setting."""
    for key in sorted({*one, *two}):
        name, a, b = f"{prefix}{key}", *(_by_name(document.get(key)) for document in (one, two))
        if isinstance(a, dict) and isinstance(b, dict):
            yield from differences(a, b, name + ".")
        elif a != b:
            yield f"{name} is {a}, not {b}"


def _by_name(value: Any) -> Any:
    """Phases by their names, anything else as it is."""
    named = isinstance(value, list) and all(isinstance(entry, dict) and "name" in entry for entry in value)
    return {entry["name"]: entry for entry in value} if named else value


def to_toml(settings: TrainSettings) -> str:
    """Settings as a TOML file that from_toml reads, with each one's meaning, unit, source and range above it."""
    lines = ["# Settings of `refcodec train`: --settings reads this file, and --set NAME=VALUE changes one of them."]
    groups = []
    for entry in fields(settings):
        value = getattr(settings, entry.name)
        if is_dataclass(value):
            groups += ["", f"# {_first_line(value)}", f"[{entry.name}]"]
            for inner in fields(value):
                groups += [*_note(inner), f"{inner.name} = {_toml(getattr(value, inner.name))}"]
        elif entry.name == "phases":
            groups += [
                "",
                "# The phases in their order. Each changes the modes of some parts, from a share of the steps on.",
            ]
            for phase in value:
                groups.append("[[phases]]")
                groups += [f"{inner.name} = {_toml(getattr(phase, inner.name))}" for inner in fields(phase)]
        else:
            lines += [*_note(entry), f"{entry.name} = {_toml(value)}"]
    return "\n".join([*lines, *groups]) + "\n"


def _first_line(group: Any) -> str:
    return str(type(group).__doc__).split("\n", 1)[0]


def _note(entry: Field[Any]) -> list[str]:
    """The documentation of a setting, as comments."""
    notes = entry.metadata
    words = [notes["meaning"][0].upper() + notes["meaning"][1:]]
    if notes["unit"]:
        words.append(f"Unit: {notes['unit']}")
    if notes["choices"]:
        words.append(f"One of {', '.join(notes['choices'])}")
    if (bounds := _bounds(notes)) != "any":
        words.append(f"Range: {bounds}")
    text = ". ".join([*words, f"Source: {notes['source']}"]) + "."
    return textwrap.wrap(text, 118, initial_indent="# ", subsequent_indent="#   ")


def _bounds(notes: Mapping[str, Any]) -> str:
    low, high = notes["low"], notes["high"]
    if math.isinf(low) and math.isinf(high):
        return "any"
    return f"{low:g} or more" if math.isinf(high) else f"{low:g} to {high:g}"


def _toml(value: Any) -> str:
    """A value in TOML's notation. Floats are written so that they read back as they are."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {_toml(inner)}' for key, inner in value.items())}}}"
    return repr(value)


# --- in ---------------------------------------------------------------------------------------------------------------


def from_toml(path: Path, base: T) -> T:
    """The settings of a file, with those of `base` for missing ones. Raises SettingsError and OSError."""
    try:
        with path.open("rb") as file:
            return merged(base, parse_toml(file.read(TOML_MAX + 1)))
    except DocumentError as error:
        raise SettingsError(f"{path} cannot be read: {error}") from None
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None


def assigned(base: T, assignments: Iterable[str]) -> T:
    """Settings with some of them changed, as `--set NAME=VALUE` does.

    A value is in TOML's notation; texts need no quotes. Raises SettingsError.
    """
    changes: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise SettingsError(f"{assignment!r} is not NAME=VALUE")
        try:
            changes[name.strip()] = parse_toml(f"value = {text}")["value"]
        except DocumentError:
            changes[name.strip()] = text
    return varied(base, changes)


def varied(base: T, changes: Mapping[str, Any]) -> T:
    """Settings with some of them changed, by dotted names: varied(settings, {"growth.gradient": 1e-4}).

    A phase is named by its own name: "phases.rate.begin". Only all changes together have to make sense. Raises
    SettingsError.
    """
    nested: dict[str, Any] = {}
    for name, value in changes.items():
        *groups, last = name.split(".")
        inner = nested
        for key in groups:
            if not isinstance(inner.get(key), dict):
                inner[key] = {}
            inner = inner[key]
        inner[last] = value
    return merged(base, nested)


def merged(base: T, changes: Mapping[str, Any], prefix: str = "") -> T:
    """Settings with those of a nested document in place of their own. A list of phases replaces all phases.

    Raises SettingsError.
    """
    known, hints = {entry.name: entry for entry in fields(base)}, get_type_hints(type(base))  # type: ignore[arg-type]
    updates: dict[str, Any] = {}
    for key, value in changes.items():
        name = prefix + key
        if key not in known:
            among = f"{prefix[:-1]} has" if prefix else "there are"
            raise SettingsError(f"there is no setting {name}; {among} {', '.join(known)}")
        now = getattr(base, key)
        if is_dataclass(now):
            if not isinstance(value, Mapping):
                raise SettingsError(f"{name} is a group: set one of {', '.join(e.name for e in fields(now))}")
            updates[key] = merged(now, value, name + ".")
        elif key == "phases":
            updates[key] = _phases(now, value)
        else:
            updates[key] = _checked(name, value, hints[key], known[key].metadata)
    try:
        return replace(base, **updates)  # type: ignore[type-var]
    except SettingsError:
        raise
    except ValueError as error:
        raise SettingsError(str(error)) from None


def _checked(name: str, value: Any, kind: Any, notes: Mapping[str, Any]) -> Any:
    """A value of the type that a setting has. Raises SettingsError."""
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        count = None if Ellipsis in inner else len(inner)
        if not isinstance(value, list | tuple) or not value or len(value) != (count or len(value)):
            raise SettingsError(f"{name} is {value!r}: a list of {count or 'one or more'} is required")
        return tuple(_checked(f"{name}[{i}]", element, inner[0], notes) for i, element in enumerate(value))
    # A size of photographs is a text that may be all digits.
    if kind is str and isinstance(value, int) and not isinstance(value, bool):
        value = str(value)
    right = isinstance(value, int | float if kind is float else kind) and (kind is bool or not isinstance(value, bool))
    if not right:
        raise SettingsError(f"{name} is {value!r}: {_WORDS[kind]} is required")
    if kind is str:
        if notes["choices"] and value not in notes["choices"]:
            raise SettingsError(f"{name} is {value!r}: one of {', '.join(notes['choices'])} is required")
    elif kind is not bool and not (math.isfinite(value) and notes["low"] <= value <= notes["high"]):
        raise SettingsError(f"{name} is {value!r}: {_bounds(notes)} is required")
    return kind(value)


def _phases(now: tuple[Phase, ...], value: Any) -> tuple[Phase, ...]:
    """All phases, of a list; or those that there are, with changes by their names."""
    if isinstance(value, list):
        return tuple(_phase(f"phases[{i}]", None, entry) for i, entry in enumerate(value))
    names = [phase.name for phase in now]
    if not isinstance(value, Mapping):
        raise SettingsError(f"phases is {value!r}: a list of phases is required")
    for name in value:
        if name not in names:
            raise SettingsError(f"there is no phase {name}; phases are {', '.join(names)}")
    return tuple(_phase(f"phases.{p.name}", p, value[p.name]) if p.name in value else p for p in now)


def _phase(where: str, now: Phase | None, value: Any) -> Phase:
    keys = [entry.name for entry in fields(Phase)]
    given = dict(value) if isinstance(value, Mapping) else None
    if given is None or not set(given) <= set(keys) or (now is None and set(given) != set(keys)):
        raise SettingsError(f"{where} is {value!r}: a table of {', '.join(keys)} is required")
    values = {**vars(now), **given} if now else given
    if now and isinstance(given.get("modes"), Mapping):
        values["modes"] = {**now.modes, **given["modes"]}
    name, begin, modes = (values[key] for key in keys)
    if not isinstance(name, str):
        raise SettingsError(f"{where}.name is {name!r}: a text is required")
    if isinstance(begin, bool) or not isinstance(begin, int | float) or not math.isfinite(begin):
        raise SettingsError(f"{where}.begin is {begin!r}: a number is required")
    if not isinstance(modes, Mapping) or not all(isinstance(mode, str) for mode in modes.values()):
        raise SettingsError(f"{where}.modes is {modes!r}: the modes of parts by their names are required")
    return Phase(name, float(begin), dict(modes))
