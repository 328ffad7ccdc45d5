"""An experiment as a TOML file: scenes, methods, rates, seeds, steps. It is read strictly and within bounds."""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from ..files.text import printable
from ..photographs.photographs import PhotographError, parse_background, parse_size
from ..train.settings import PRESETS, TrainSettings
from ..train.settings_file import SettingsError, assigned, varied

T = TypeVar("T")

KINDS = ("train", "uncompressed")
DEVICES = ("cpu", "cuda")
# Bounds of what is read: bytes of the file, entries of a list, cells.
SIZE_MAX, LIST_MAX, CELLS_MAX = 1 << 20, 1000, 100_000
SEED_MAX = (1 << 63) - 1
# A name is a component of a path on every file system.
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,63}")
_VARIABLE = re.compile(r"\$\{([^}]*)\}")
# Settings that have a key of their own, which is the one to use.
_OWN_KEYS = {
    "rate.weight": "rates",
    "steps": "steps",
    "size": "the scene's size",
    "seed": "seeds",
    "background": "the scene's background",
    "holdout": "the scene's holdout",
}


class ExperimentError(ValueError):
    """An experiment that cannot be run as it is written. The text is one line."""


@dataclass(frozen=True)
class Scene:
    """Photographs to learn from.

    photographs: the folder as the file has it. A path that is not absolute begins at the file's folder, and ${NAME}
    stands for a variable of the environment. size, background, holdout: of `train`, None for the preset's. rates:
    lambda_r of this scene, empty for those of all. changes: NAME=VALUE for `train --set`. group: the data set that it
    belongs to.
    """

    name: str
    photographs: str
    size: str | None
    background: str | None
    holdout: int | None
    rates: tuple[float, ...]
    changes: tuple[str, ...]
    group: str


@dataclass(frozen=True)
class Method:
    """A way to train. kind: `train` at each rate, or `uncompressed`, once. changes: as a scene's, and applied after.

    scenes: names of the only ones that it is for, empty for all.
    """

    name: str
    kind: str
    preset: str
    changes: tuple[str, ...]
    scenes: tuple[str, ...]


@dataclass(frozen=True)
class Experiment:
    """What an experiment's file says. steps: None for the preset's. baseline: a method, or None for no BD-rates."""

    path: Path
    scenes: tuple[Scene, ...]
    methods: tuple[Method, ...]
    rates: tuple[float, ...]
    seeds: tuple[int, ...]
    steps: int | None
    device: str
    baseline: str | None

    def settings(self, scene: Scene, method: Method, rate: float, seed: int) -> TrainSettings:
        """All settings of one training, as the command that trains it has them. Raises ExperimentError."""
        options = {
            "rate.weight": rate,
            "steps": self.steps,
            "size": scene.size,
            "background": scene.background,
            "holdout": scene.holdout,
            "seed": seed,
        }
        try:
            settings = assigned(PRESETS[method.preset], (*scene.changes, *method.changes))
            return varied(settings, {name: value for name, value in options.items() if value is not None})
        except SettingsError as error:
            raise ExperimentError(f"method {method.name} of scene {scene.name}: {error}") from None

    def rates_of(self, scene: Scene, method: Method) -> tuple[float, ...]:
        """The rates at which a method trains a scene: 0 alone for an uncompressed one."""
        return (0.0,) if method.kind == "uncompressed" else scene.rates or self.rates

    def methods_of(self, scene: Scene) -> list[Method]:
        """The methods that are for a scene."""
        return [method for method in self.methods if not method.scenes or scene.name in method.scenes]

    def photographs(self, scene: Scene) -> Path:
        """The folder of a scene's photographs. Raises ExperimentError if a variable of its path is not set."""

        def value(match: re.Match[str]) -> str:
            if not os.environ.get(match[1]):
                raise ExperimentError(
                    f"the photographs of scene {scene.name} are in {scene.photographs}: set the variable {match[1]}"
                )
            return os.environ[match[1]]

        return (self.path.parent / _VARIABLE.sub(value, scene.photographs)).absolute()


# --- the file ---------------------------------------------------------------------------------------------------------


def read_experiment(path: Path) -> Experiment:
    """The experiment of a file. Raises ExperimentError, whose text begins with the path, and OSError."""
    with path.open("rb") as file:
        data = file.read(SIZE_MAX + 1)
    try:
        if len(data) > SIZE_MAX:
            raise ExperimentError(f"it has more than {SIZE_MAX} bytes")
        try:
            document = tomllib.loads(data.decode("utf-8"))
        # tomllib calls itself for each level of lists, and int() has bounds of its own.
        except (ValueError, RecursionError) as error:
            raise ExperimentError(f"it is not TOML: {error}") from None
        return _experiment(path, document)
    except ExperimentError as error:
        raise ExperimentError(printable(f"{path}: {error}", 400)) from None


class _Table:
    """A table of the file. Whatever is wrong with it is an ExperimentError that begins with `where`."""

    def __init__(self, where: str, value: Any, keys: Sequence[str]) -> None:
        if not isinstance(value, Mapping):
            raise ExperimentError(f"{where} is not a table")
        for key in value:
            if key not in keys:
                raise ExperimentError(f"{where} has {key}: its keys are {', '.join(keys)}")
        self.where, self.value = where, value

    def wrong(self, key: str, value: Any, wanted: str) -> ExperimentError:
        return ExperimentError(f"{self.where}: {key} is {value!r}, {wanted} is required")

    def get(self, key: str, wanted: str, read: Callable[[Any], T | None], default: T | None = None) -> T:
        """A value that `read` makes of the one in the file, or the default. None is what no value may be."""
        if key not in self.value:
            if default is None:
                raise ExperimentError(f"{self.where} has no {key}: {wanted} is required")
            return default
        found = read(self.value[key])
        if found is None:
            raise self.wrong(key, self.value[key], wanted)
        return found

    def several(
        self, key: str, wanted: str, read: Callable[[Any], T | None], default: tuple[T, ...] | None = None
    ) -> tuple[T, ...]:
        """A list of such values, of which no two are equal."""
        if key not in self.value and default is not None:
            return default
        found = self.get(key, f"a list of {wanted}", lambda value: value if isinstance(value, list) else None)
        if not 1 <= len(found) <= LIST_MAX:
            raise ExperimentError(f"{self.where}: {key} has {len(found)} entries, 1 to {LIST_MAX} are allowed")
        values = []
        for i, entry in enumerate(found):
            value = read(entry)
            if value is None:
                raise self.wrong(f"{key}[{i}]", entry, wanted)
            if value in values:
                raise ExperimentError(f"{self.where}: {key} has {entry!r} twice")
            values.append(value)
        return tuple(values)


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value and "\0" not in value else None


def _name(value: Any) -> str | None:
    return value if isinstance(value, str) and _NAME.fullmatch(value) and not value.endswith(".") else None


def _one_of(choices: Sequence[str]) -> Callable[[Any], str | None]:
    return lambda value: value if isinstance(value, str) and value in choices else None


def _integer(low: int, high: int) -> Callable[[Any], int | None]:
    return lambda value: (
        value if isinstance(value, int) and not isinstance(value, bool) and low <= value <= high else None
    )


def _rate(value: Any) -> float | None:
    """A lambda_r that its name in commands and folders states exactly."""
    right = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and 0 < value <= 1
    return float(value) if right and float(f"{value:g}") == value else None


def _size(value: Any) -> str | None:
    """Of photographs: a text, or a number for the longest side."""
    text = str(value) if isinstance(value, int) and not isinstance(value, bool) else value
    try:
        parse_size(text if isinstance(text, str) else "")
    except PhotographError:
        return None
    return text


def _background(value: Any) -> str | None:
    try:
        parse_background(value if isinstance(value, str) else "")
    except PhotographError:
        return None
    return str(value)


def _length(value: Any) -> float | None:
    right = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value > 0
    return float(value) if right else None


def _first_anchors(table: _Table) -> tuple[str, ...]:
    """The settings of a scene's first anchors, which those of `set` and of methods come after."""
    changes = []
    if "voxel" in table.value:
        changes.append(f"start.voxel={table.get('voxel', 'a number above 0', _length)!r}")
    if "anchors" in table.value:
        changes.append(f"start.anchors={table.get('anchors', 'a whole number of 1 or more', _integer(1, SEED_MAX))}")
    if len(changes) > 1:
        raise ExperimentError(f"{table.where} has voxel and anchors: one of them is enough")
    return tuple(changes)


def _changes(table: _Table) -> tuple[str, ...]:
    changes = table.several("set", "texts NAME=VALUE", _text, ())
    for change in changes:
        name = change.partition("=")[0].strip()
        if name in _OWN_KEYS:
            raise ExperimentError(f"{table.where}: use {_OWN_KEYS[name]} instead of {name} in set")
    return changes


_RATES = "a number above 0 and at most 1, of six digits at most,"
_NAMES = "a name of 1 to 64 letters, digits and . _ + -, which begins with a letter or digit and ends with no dot,"


def _scene(where: str, value: Any) -> Scene:
    keys = ("name", "photographs", "size", "background", "holdout", "voxel", "anchors", "rates", "set", "group")
    table = _Table(where, value, keys)
    name = table.get("name", _NAMES, _name)
    return Scene(
        name=name,
        photographs=table.get("photographs", "a folder", _text),
        size=table.get("size", "WIDTHxHEIGHT or the longest side", _size) if "size" in table.value else None,
        background=table.get("background", "white, black or R,G,B", _background)
        if "background" in table.value
        else None,
        holdout=table.get("holdout", "a whole number of 0 or more", _integer(0, SEED_MAX))
        if "holdout" in table.value
        else None,
        rates=table.several("rates", _RATES, _rate, ()),
        changes=(*_first_anchors(table), *_changes(table)),
        group=table.get("group", _NAMES, _name, name),
    )


def _method(where: str, value: Any) -> Method:
    table = _Table(where, value, ("name", "kind", "preset", "set", "scenes"))
    return Method(
        name=table.get("name", _NAMES, _name),
        kind=table.get("kind", " or ".join(KINDS), _one_of(KINDS), "train"),
        preset=table.get("preset", " or ".join(PRESETS), _one_of(tuple(PRESETS)), "fast"),
        changes=_changes(table),
        scenes=table.several("scenes", "the name of a scene", _text, ()),
    )


def _tables(document: _Table, key: str, read: Callable[[str, Any], T], name: Callable[[T], str]) -> tuple[T, ...]:
    values = document.several(key, f"tables [[{key}]]", lambda value: value if isinstance(value, dict) else None)
    found = tuple(read(f"{key}[{i}]", value) for i, value in enumerate(values))
    # Some file systems do not tell capitals.
    names = [name(one).lower() for one in found]
    for i, one in enumerate(names):
        if one in names[:i]:
            raise ExperimentError(f"two {key} are named {name(found[i])}; capitals do not count")
    return found


def _experiment(path: Path, document: Any) -> Experiment:
    table = _Table("the file", document, ("scenes", "methods", "rates", "seeds", "steps", "device", "baseline"))
    scenes = _tables(table, "scenes", _scene, lambda scene: scene.name)
    methods = _tables(table, "methods", _method, lambda method: method.name)
    names = [scene.name for scene in scenes]
    for method in methods:
        for name in method.scenes:
            if name not in names:
                raise ExperimentError(f"method {method.name} is for scene {name}: scenes are {', '.join(names)}")
    experiment = Experiment(
        path=path,
        scenes=scenes,
        methods=methods,
        rates=table.several("rates", _RATES, _rate, ()),
        seeds=table.several("seeds", f"a whole number from 0 to {SEED_MAX}", _integer(0, SEED_MAX)),
        steps=table.get("steps", "a whole number of 1 or more", _integer(1, SEED_MAX)) if "steps" in document else None,
        device=table.get("device", " or ".join(DEVICES), _one_of(DEVICES), "cpu"),
        baseline=table.get("baseline", "the name of a method", _text) if "baseline" in document else None,
    )
    trained = [method.name for method in methods if method.kind == "train"]
    if experiment.baseline is not None and experiment.baseline not in trained:
        raise ExperimentError(f"baseline is {experiment.baseline}: methods of kind train are {', '.join(trained)}")
    count = 0
    for scene in scenes:
        for method in experiment.methods_of(scene):
            rates = experiment.rates_of(scene, method)
            if not rates:
                raise ExperimentError(f"there are no rates for scene {scene.name}: give rates, here or in the scene")
            experiment.settings(scene, method, rates[0], experiment.seeds[0])
            count += len(rates) * len(experiment.seeds)
            if count > CELLS_MAX:
                raise ExperimentError(f"it has more than {CELLS_MAX} cells")
    return replace(experiment, rates=tuple(sorted(experiment.rates)))
