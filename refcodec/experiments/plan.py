"""An experiment as a TOML file: scenes, methods, rates, seeds, steps. It is read strictly and within bounds."""

from __future__ import annotations

import math
import os
import re
import reprlib
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct, field

from ..files.text import printable
from ..photographs.photographs import PhotographError, parse_background, parse_size
from ..train.settings import PRESETS, STATIC_CHANGES, TrainSettings
from ..train.settings_file import SettingsError, assigned, varied

# Bounds of the input: bytes of the file, entries of a list, cells.
SIZE_MAX, LIST_MAX, CELLS_MAX = 1 << 20, 1000, 100_000
SEED_MAX = (1 << 63) - 1
_VARIABLE = re.compile(r"\$\{([^}]*)\}")
# Settings with their own key, which must be used instead.
OWN_KEYS = {
    "rate.lambda_r": "rates",
    "steps": "steps",
    "size": "the scene's size",
    "seed": "seeds",
    "background": "the scene's background",
    "holdout": "the scene's holdout",
}

_NAMES = "1 to 64 letters, digits and . _ + -, with a letter or digit first and no dot last,"
_RATES = f"a list of 1 to {LIST_MAX} numbers above 0 and at most 1, each once and of six digits at most,"
_CHANGES = f"a list of 1 to {LIST_MAX} texts NAME=VALUE"
# What each key allows, for messages.
_ALLOWED = {
    "name": _NAMES,
    "group": _NAMES,
    "photographs": "a folder",
    "size": "WIDTHxHEIGHT or the longest side",
    "background": "white, black or R,G,B",
    "holdout": "a whole number of 0 or more",
    "up": "+x, -x, +y, -y, +z or -z",
    "voxel": "a number above 0",
    "anchors": "a whole number of 1 or more",
    "rates": _RATES,
    "set": _CHANGES,
    "kind": "train or uncompressed",
    "preset": " or ".join(PRESETS),
    "static": "true or false",
    "scenes": f"a list of 1 to {LIST_MAX} tables [[scenes]], or of their names in a method,",
    "methods": f"a list of 1 to {LIST_MAX} tables [[methods]]",
    "seeds": f"a list of 1 to {LIST_MAX} whole numbers from 0 to {SEED_MAX}, each once,",
    "steps": "a whole number of 1 or more",
    "device": "cpu or cuda",
    "baseline": "the name of a method",
}

_LIST = Meta(min_length=1, max_length=LIST_MAX)
# A component of a path on every file system.
Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9](?:[A-Za-z0-9._+-]{0,62}[A-Za-z0-9_+-])?\Z")]
Text = Annotated[str, Meta(pattern=r"\A[^\0]+\Z")]
Whole = Annotated[int, Meta(ge=0, le=SEED_MAX)]
Positive = Annotated[int, Meta(ge=1, le=SEED_MAX)]
Rates = Annotated[tuple[Annotated[float, Meta(gt=0, le=1)], ...], _LIST]
Texts = Annotated[tuple[Text, ...], _LIST]


class ExperimentError(ValueError):
    """An experiment that cannot be run as it is written. The text is one line."""


def _distinct(key: str, values: tuple[Any, ...]) -> None:
    for i, value in enumerate(values):
        if value in values[:i]:
            raise ValueError(f"{key} has {value!r} twice")


def _exact(rates: tuple[float, ...]) -> None:
    """Raises ValueError for a lambda_r that its name in commands and folders does not state exactly."""
    _distinct("rates", rates)
    for rate in rates:
        if float(f"{rate:g}") != rate:
            raise ValueError(f"rates has {rate!r}: six digits at most are allowed")


def _settable(changes: tuple[str, ...]) -> None:
    _distinct("set", changes)
    for change in changes:
        name = change.partition("=")[0].strip()
        if name in OWN_KEYS:
            raise ValueError(f"use {OWN_KEYS[name]} instead of {name} in set")


class Scene(Struct, forbid_unknown_fields=True, kw_only=True):
    """Photographs to learn from: a table [[scenes]].

    photographs: the folder as the file states it. A path that is not absolute begins at the file's folder, and ${NAME}
    stands for a variable of the environment. size, background, holdout, up: of `train`, None for its default. voxel,
    anchors: of the first anchors. rates: lambda_r of this scene, empty for those of all scenes. assignments: NAME=VALUE
    for `train --set`, the key `set`. group: the data set that it belongs to, its own name if the file has none.
    """

    name: Name
    photographs: Text
    size: str | int | None = None
    background: str | None = None
    holdout: Whole | None = None
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None = None
    voxel: Annotated[float, Meta(gt=0)] | None = None
    anchors: Positive | None = None
    rates: Rates = ()
    assignments: Texts = field(default=(), name="set")
    group: Name = ""

    def __post_init__(self) -> None:
        """Raises ValueError."""
        _exact(self.rates)
        _settable(self.assignments)
        if self.voxel == math.inf:
            raise ValueError(f"voxel is inf: {_ALLOWED['voxel']} is required")
        if self.voxel is not None and self.anchors is not None:
            raise ValueError("it has voxel and anchors: one of them is enough")
        self.group = self.group or self.name
        self.size = None if self.size is None else str(self.size)
        try:
            parse_size(self.size or "1")
        except PhotographError:
            raise ValueError(f"size is {self.size!r}: WIDTHxHEIGHT or the longest side is required") from None
        try:
            parse_background("white" if self.background is None else self.background)
        except PhotographError:
            raise ValueError(f"background is {self.background!r}: white, black or R,G,B is required") from None

    @property
    def changes(self) -> tuple[str, ...]:
        """NAME=VALUE of all its settings. Those of the first anchors come before those of `set`."""
        first = {"start.voxel": self.voxel, "start.anchors": self.anchors}
        return (*(f"{name}={value!r}" for name, value in first.items() if value is not None), *self.assignments)


class Method(Struct, forbid_unknown_fields=True, kw_only=True):
    """A way to train: a table [[methods]].

    kind: `train` at each rate, or `uncompressed`, once. static: as the option of `train`. changes: as `set` of a scene,
    and applied after. scenes: names of the only ones that it is for, empty for all.
    """

    name: Name
    kind: Literal["train", "uncompressed"] = "train"
    preset: str = "fast"
    static: bool = False
    changes: Texts = field(default=(), name="set")
    scenes: Texts = ()

    def __post_init__(self) -> None:
        """Raises ValueError."""
        _settable(self.changes)
        _distinct("scenes", self.scenes)
        if self.preset not in PRESETS:
            raise ValueError(f"preset is {self.preset!r}: {' or '.join(PRESETS)} is required")


class _File(Struct, forbid_unknown_fields=True, kw_only=True):
    """The whole file. steps: None for the preset's. baseline: a method, or None for no BD-rates."""

    scenes: Annotated[tuple[Scene, ...], _LIST]
    methods: Annotated[tuple[Method, ...], _LIST]
    rates: Rates = ()
    seeds: Annotated[tuple[Whole, ...], _LIST]
    steps: Positive | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    baseline: Text | None = None

    def __post_init__(self) -> None:
        """Raises ValueError."""
        _exact(self.rates)
        _distinct("seeds", self.seeds)
        for key, named in (("scenes", self.scenes), ("methods", self.methods)):
            # Some file systems do not distinguish capitals.
            names = [one.name.lower() for one in named]
            for i, name in enumerate(names):
                if name in names[:i]:
                    raise ValueError(f"two {key} are named {named[i].name}; capitals do not count")
        known = [scene.name for scene in self.scenes]
        for method in self.methods:
            for name in method.scenes:
                if name not in known:
                    raise ValueError(f"method {method.name} is for scene {name}: scenes are {', '.join(known)}")
        trained = [method.name for method in self.methods if method.kind == "train"]
        if self.baseline is not None and self.baseline not in trained:
            raise ValueError(f"baseline is {self.baseline}: methods of kind train are {', '.join(trained)}")


@dataclass(frozen=True)
class Experiment:
    """An experiment's file. steps: None for the preset's. baseline: a method, or None for no BD-rates.

    text: the content of the file.
    """

    path: Path
    scenes: tuple[Scene, ...]
    methods: tuple[Method, ...]
    rates: tuple[float, ...]
    seeds: tuple[int, ...]
    steps: int | None
    device: str
    baseline: str | None
    text: bytes = b""

    def settings(self, scene: Scene, method: Method, rate: float, seed: int) -> TrainSettings:
        """All settings of one training run, as its command has them. Raises ExperimentError."""
        options = {
            "rate.lambda_r": rate,
            "steps": self.steps,
            "size": scene.size,
            "background": scene.background,
            "holdout": scene.holdout,
            "seed": seed,
        }
        try:
            preset = PRESETS[method.preset]
            base = varied(preset, STATIC_CHANGES) if method.static else preset
            settings = assigned(base, (*scene.changes, *method.changes))
            return varied(settings, {name: value for name, value in options.items() if value is not None})
        except SettingsError as error:
            raise ExperimentError(f"method {method.name} of scene {scene.name}: {error}") from None

    def rates_of(self, scene: Scene, method: Method) -> tuple[float, ...]:
        """The rates at which a method trains a scene: only 0 for an uncompressed one."""
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
        return parse_experiment(path, file.read(SIZE_MAX + 1))


def parse_experiment(path: Path, data: bytes) -> Experiment:
    """The experiment of a file's content. path: its place and name. Raises ExperimentError, as read_experiment."""
    try:
        if len(data) > SIZE_MAX:
            raise ExperimentError(f"it has more than {SIZE_MAX} bytes")
        try:
            document = tomllib.loads(data.decode("utf-8"))
        # tomllib calls itself for each level of lists, and int() has bounds of its own.
        except (ValueError, RecursionError) as error:
            raise ExperimentError(f"it is not TOML: {error}") from None
        return replace(_experiment(path, document), text=data)
    except ExperimentError as error:
        raise ExperimentError(printable(f"{path}: {error}", 400)) from None


_TABLES: dict[str, type[Struct]] = {"": _File, "scenes": Scene, "methods": Method}


def _reason(error: msgspec.ValidationError, document: Any) -> str:
    """The place of a fault in a document, the value there, and the allowed values."""
    text, _, place = str(error).partition(" - at `$")
    place = place.rstrip("`").lstrip(".")
    where, table = place or "the file", _TABLES.get(place.partition("[")[0])
    named = re.fullmatch(r"Object (contains unknown|missing required) field `(.*)`", text, re.DOTALL)
    if named and named[1].startswith("missing"):
        return f"{where} has no {named[2]}: {_ALLOWED[named[2]]} is required"
    if named and table:
        return f"{where} has {named[2]}: its keys are {', '.join(f.encode_name for f in msgspec.structs.fields(table))}"
    value = document
    try:
        for step in re.findall(r"\w+", place):
            value = value[int(step) if isinstance(value, list) else step]
    # A key of the file may contain what separates text and place.
    except (KeyError, IndexError, TypeError, ValueError):
        return f"{where}: {text}"
    key = re.sub(r"\[\d+\]$", "", place).rpartition(".")[2]
    if error.__cause__ is not None or key not in _ALLOWED:
        return f"{where}: {text}"
    shown = f"a list of {len(value)} entries" if isinstance(value, list) else reprlib.repr(value)
    if place.endswith("]"):
        return f"{where} is {shown}: {key} must be {_ALLOWED[key].rstrip(',')}"
    return f"{where} is {shown}: {_ALLOWED[key]} is required"


def _experiment(path: Path, document: Any) -> Experiment:
    try:
        file = msgspec.convert(document, _File)
    except msgspec.ValidationError as error:
        raise ExperimentError(_reason(error, document)) from None
    experiment = Experiment(
        path=path,
        scenes=file.scenes,
        methods=file.methods,
        rates=tuple(sorted(file.rates)),
        seeds=file.seeds,
        steps=file.steps,
        device=file.device,
        baseline=file.baseline,
    )
    count = 0
    for scene in experiment.scenes:
        for method in experiment.methods_of(scene):
            rates = experiment.rates_of(scene, method)
            if not rates:
                raise ExperimentError(f"there are no rates for scene {scene.name}: give rates, here or in the scene")
            experiment.settings(scene, method, rates[0], experiment.seeds[0])
            count += len(rates) * len(experiment.seeds)
            if count > CELLS_MAX:
                raise ExperimentError(f"it has more than {CELLS_MAX} cells, the most that are allowed")
    return experiment
