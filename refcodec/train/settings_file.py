"""Settings as text: printed with their documentation (TOML), read from a file, changed by name.

Any fault of a name or a value is a SettingsError of one line.
"""

import json
import math
import os
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import Field, fields, is_dataclass, replace
from pathlib import Path
from types import GenericAlias
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from msgspec import Meta, to_builtins

from ..files.documents import DocumentError, FieldError, checked, parse_toml, read_toml
from ..statuses import UsageError
from .settings import PRESETS, STATIC_CHANGES, Phase, TrainSettings

T = TypeVar("T")


class SettingsError(UsageError):
    """A setting that does not exist, or a value that it cannot have."""


# --- out --------------------------------------------------------------------------------------------------------------


def document(settings: Any) -> dict[str, Any]:
    """Settings as JSON has them: dictionaries, lists, numbers and texts. merged() makes the settings again."""
    plain: dict[str, Any] = json.loads(json.dumps(to_builtins(settings)))
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
            groups += ["", f"# {str(type(value).__doc__).partition(chr(10))[0]}", f"[{entry.name}]"]
            for inner in fields(value):
                groups += [*_note(inner), f"{inner.name} = {_toml(getattr(value, inner.name))}"]
        elif entry.name == "phases":
            groups += [
                "",
                "# The phases in their order. Each changes the modes of some parts, from a share of the steps on.",
            ]
            for phase in value:
                groups += ["[[phases]]", *(f"{key} = {_toml(inner)}" for key, inner in to_builtins(phase).items())]
        else:
            lines += [*_note(entry), f"{entry.name} = {_toml(value)}"]
    return "\n".join([*lines, *groups]) + "\n"


def _note(entry: Field[Any]) -> list[str]:
    """The documentation of a setting, as comments."""
    notes = entry.metadata
    words = [notes["meaning"][0].upper() + notes["meaning"][1:]]
    if notes["unit"]:
        words.append(f"Unit: {notes['unit']}")
    if notes["choices"]:
        words.append(f"One of {', '.join(notes['choices'])}")
    low, high = notes["low"], notes["high"]
    if math.isfinite(low):
        words.append(f"Range: {low:g} to {high:g}" if math.isfinite(high) else f"Range: {low:g} or more")
    text = ". ".join([*words, f"Source: {notes['source']}"]) + "."
    return textwrap.wrap(text, 118, initial_indent="# ", subsequent_indent="#   ")


def _toml(value: Any) -> str:
    """A value in TOML's notation. Floats are written so that they read back as they are."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if is_dataclass(value):
        value = to_builtins(value)
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {_toml(inner)}' for key, inner in value.items())}}}"
    return repr(value)


# --- in ---------------------------------------------------------------------------------------------------------------


def from_toml(path: Path, base: T) -> T:
    """The settings of a file, with those of `base` for missing ones. Raises SettingsError and OSError."""
    try:
        return merged(base, read_toml(path))
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


def chosen_settings(words: Mapping[str, Any], file: str | os.PathLike[str] | None = None) -> TrainSettings:
    """The settings of a preset, changed by a file, by `static` and `set`, and then by single words.

    words: those of `train`; None stands for one that is not given. Raises SettingsError, and OSError for the file.
    """
    anchors = words.get("anchors")
    if anchors and words.get("voxel"):
        raise SettingsError("--voxel is not allowed with --anchors")
    base = PRESETS[words.get("preset") or "fast"]
    base = base if file is None else from_toml(Path(file), base)
    base = assigned(varied(base, STATIC_CHANGES) if words.get("static") else base, words.get("set") or ())
    given = {name: words.get(name) for name in ("steps", "size", "seed", "background", "holdout", "degree")}
    # With a number of anchors, the voxel size follows from it.
    given |= {"start.anchors": anchors, "start.voxel": 0.0 if anchors else words.get("voxel")}
    given["rate.lambda_r"] = words.get("lambda_r")
    chosen = varied(base, {name: value for name, value in given.items() if value is not None})
    if words.get("degree") is not None and not chosen.static:
        raise SettingsError("--degree is that of a static scene: add --static")
    return chosen


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
            updates[key] = _value(name, value, _kind(hints[key], known[key].metadata))
    try:
        return replace(base, **updates)  # type: ignore[type-var]
    except SettingsError:
        raise
    except ValueError as error:
        raise SettingsError(str(error)) from None


def _kind(hint: Any, notes: Mapping[str, Any]) -> Any:
    """The type of a setting with its bounds, as msgspec checks them."""
    if get_origin(hint) is tuple:
        inner = tuple(each if each is Ellipsis else _kind(each, notes) for each in get_args(hint))
        kind = GenericAlias(tuple, inner)
        return Annotated[kind, Meta(min_length=1)] if Ellipsis in inner else kind
    if notes["choices"]:
        return Literal[notes["choices"]]
    bounds = {name: value for name, value in (("ge", notes["low"]), ("le", notes["high"])) if math.isfinite(value)}
    return Annotated[hint, Meta(**bounds)]


def _value(name: str, value: Any, kind: Any) -> Any:
    """A value of a setting's type. Raises SettingsError."""
    # A size of photographs is a text that may be all digits.
    if get_args(kind)[:1] == (str,) and type(value) is int:
        value = str(value)
    try:
        return checked(value, kind)
    except FieldError as error:
        problem = error.problem
        if get_origin(kind) is Literal:
            problem = f"is {value!r}: one of {', '.join(get_args(kind))} is required"
        raise SettingsError(f"{name}{'.' if error.name[:1].isalpha() else ''}{error.name} {problem}") from None


def _phases(now: tuple[Phase, ...], changes: Any) -> tuple[Phase, ...]:
    """All phases, of a list; or those that there are, with changes by their names. Raises SettingsError."""
    if not isinstance(changes, Mapping):
        phases: tuple[Phase, ...] = _value("phases", changes, tuple[Phase, ...])
        return phases
    names = [phase.name for phase in now]
    if unknown := [name for name in changes if name not in names]:
        raise SettingsError(f"there is no phase {unknown[0]}; phases are {', '.join(names)}")
    return tuple(_changed(phase, changes.get(phase.name, {})) for phase in now)


def _changed(phase: Phase, changes: Any) -> Phase:
    name, document = f"phases.{phase.name}", to_builtins(phase)
    if not isinstance(changes, Mapping):
        raise SettingsError(f"{name} is {changes!r}: a table of {', '.join(document)} is required")
    changed = document | changes
    if isinstance(modes := changed["modes"], Mapping):
        changed["modes"] = document["modes"] | modes
    phase = _value(name, changed, Phase)
    return phase
