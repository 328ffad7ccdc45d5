"""An experiment as a TOML file: scenes, methods, lambdas, seeds, steps. It is read strictly and within bounds."""

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct, field

from ..files.documents import TOML_MAX, DocumentError, FieldError, checked, parse_toml
from ..files.text import printable
from ..photographs.photographs import PhotographError, parse_size
from ..statuses import UsageError
from ..train.settings import PRESETS, STATIC_CHANGES, TrainSettings
from ..train.settings_file import SettingsError, assigned, chosen_settings, varied

# Bounds of the input: entries of a list, cells.
LIST_MAX, CELLS_MAX = 1000, 100_000
SEED_MAX = (1 << 63) - 1
_VARIABLE = re.compile(r"\$\{([^}]*)\}")
# The methods of an experiment of one scene.
CODED, UNCOMPRESSED = "coded", "uncompressed"
# Settings with their own key, which must be used instead.
OWN_KEYS = {
    "rate.lambda_r": "lambdas",
    "steps": "steps",
    "size": "the scene's size",
    "seed": "seeds",
    "holdout": "the scene's holdout",
}
# A component of a path on every file system.
_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9._+-]{0,62}[A-Za-z0-9_+-])?")

_LIST = Meta(min_length=1, max_length=LIST_MAX)
Text = Annotated[str, Meta(pattern=r"\A[^\0]+\Z")]
Whole = Annotated[int, Meta(ge=0, le=SEED_MAX)]
Positive = Annotated[int, Meta(ge=1, le=SEED_MAX)]
Lambdas = Annotated[tuple[Annotated[float, Meta(gt=0, le=1)], ...], _LIST]
Texts = Annotated[tuple[Text, ...], _LIST]


class ExperimentError(UsageError):
    """An experiment that cannot be run as it is written. The text is one line."""


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        words = "1 to 64 letters, digits and . _ + -, with a letter or digit first and no dot last"
        raise ValueError(f"the name {name!r} is not {words}")


def _check_distinct(key: str, values: Iterable[Any]) -> None:
    known = []
    for value in values:
        if value in known:
            raise ValueError(f"{key} has {value!r} twice")
        known.append(value)


def _check_lambdas(lambdas: tuple[float, ...]) -> None:
    """Raises ValueError for a lambda_r that its name in commands and folders does not state exactly."""
    _check_distinct("lambdas", lambdas)
    for value in lambdas:
        if float(f"{value:g}") != value:
            raise ValueError(f"lambdas has {value!r}: six digits at most are allowed")


def _check_changes(changes: tuple[str, ...]) -> None:
    _check_distinct("set", changes)
    for change in changes:
        name = change.partition("=")[0].strip()
        if name in OWN_KEYS:
            raise ValueError(f"use {OWN_KEYS[name]} instead of {name} in set")


class Scene(Struct, forbid_unknown_fields=True, kw_only=True):
    """Photographs to learn from: a table [[scenes]].

    photographs: the folder as the file states it. A path that is not absolute begins at the file's folder, and ${NAME}
    stands for a variable of the environment. size, holdout, up: of `train`, None for its default. lambdas: lambda_r of
    this scene, empty for those of all scenes. changes: NAME=VALUE for `train --set`, the key `set`.
    """

    name: str
    photographs: Text
    size: str | int | None = None
    holdout: Whole | None = None
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None = None
    lambdas: Lambdas = ()
    changes: Texts = field(default=(), name="set")

    def __post_init__(self) -> None:
        """Raises ValueError."""
        _check_name(self.name)
        _check_lambdas(self.lambdas)
        _check_changes(self.changes)
        self.size = None if self.size is None else str(self.size)
        try:
            parse_size(self.size or "1")
        except PhotographError as error:
            raise ValueError(str(error)) from None


class Method(Struct, forbid_unknown_fields=True, kw_only=True):
    """A way to train: a table [[methods]].

    kind: `train` at each lambda_r, or `uncompressed`, once. static: as the option of `train`. changes: as `set` of a
    scene, and applied after. scenes: names of the only ones that it is for, empty for all.
    """

    name: str
    kind: Literal["train", "uncompressed"] = "train"
    preset: Literal["fast", "paper"] = "fast"
    static: bool = False
    changes: Texts = field(default=(), name="set")
    scenes: Texts = ()

    def __post_init__(self) -> None:
        """Raises ValueError."""
        _check_name(self.name)
        _check_changes(self.changes)
        _check_distinct("scenes", self.scenes)


class _File(Struct, forbid_unknown_fields=True, kw_only=True):
    """The whole file. steps: None for the preset's. baseline: a method, or None for no comparisons."""

    scenes: Annotated[tuple[Scene, ...], _LIST]
    methods: Annotated[tuple[Method, ...], _LIST]
    lambdas: Lambdas = ()
    seeds: Annotated[tuple[Whole, ...], _LIST]
    steps: Positive | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    baseline: Text | None = None

    def __post_init__(self) -> None:
        """Raises ValueError."""
        _check_lambdas(self.lambdas)
        _check_distinct("seeds", self.seeds)
        for key, tables in (("scenes", self.scenes), ("methods", self.methods)):
            # Some file systems do not distinguish capitals.
            _check_distinct(f"the names of {key}", (one.name.lower() for one in tables))
        known = [scene.name for scene in self.scenes]
        for method in self.methods:
            for name in method.scenes:
                if name not in known:
                    raise ValueError(f"method {method.name} is for scene {name}: scenes are {', '.join(known)}")
        trained = [method.name for method in self.methods if method.kind == "train"]
        if self.baseline is not None and self.baseline not in trained:
            raise ValueError(f"baseline is {self.baseline}: methods of kind train are {', '.join(trained)}")


class Experiment(_File, kw_only=True):
    """An experiment's file, whose content is `text`."""

    path: Path
    text: bytes = b""

    def settings(self, scene: Scene, method: Method, lambda_r: float, seed: int) -> TrainSettings:
        """All settings of one training run, as its command has them. Raises ExperimentError."""
        options: dict[str, Any] = {"rate.lambda_r": lambda_r, "steps": self.steps, "size": scene.size}
        options |= {"holdout": scene.holdout, "seed": seed}
        try:
            preset = PRESETS[method.preset]
            base = varied(preset, STATIC_CHANGES) if method.static else preset
            settings = assigned(base, (*scene.changes, *method.changes))
            return varied(settings, {name: value for name, value in options.items() if value is not None})
        except SettingsError as error:
            raise ExperimentError(f"method {method.name} of scene {scene.name}: {error}") from None

    def lambdas_of(self, scene: Scene, method: Method) -> tuple[float, ...]:
        """The lambda_r at which a method trains a scene, ascending: only 0 for an uncompressed one."""
        return (0.0,) if method.kind == "uncompressed" else tuple(sorted(scene.lambdas or self.lambdas))

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


def read_experiment(path: Path) -> Experiment:
    """The experiment of a file. Raises ExperimentError, whose text begins with the path, and OSError."""
    with path.open("rb") as file:
        return parse_experiment(path, file.read(TOML_MAX + 1))


def parse_experiment(path: Path, data: bytes) -> Experiment:
    """The experiment of a file's content. path: its place and name. Raises ExperimentError, as read_experiment."""
    try:
        file = checked(parse_toml(data), _File)
        experiment = Experiment(**msgspec.structs.asdict(file), path=path, text=data)
        _check_cells(experiment)
    except (DocumentError, ExperimentError) as error:
        hint = "; `refcodec experiment --help` has the keys and their values" if isinstance(error, FieldError) else ""
        hint = "; rates is now named lambdas, as it lists lambda_r" if str(error).startswith("rates ") else hint
        raise ExperimentError(printable(f"{path}: {error}{hint}", 400)) from None
    return experiment


def one_scene(
    photographs: Path, words: Mapping[str, Any], lambdas: Sequence[float], uncompressed: bool, device: str | None
) -> Experiment:
    """The experiment of one scene at some lambda_r. Raises SettingsError and ExperimentError.

    words: options of `train`, which become keys of the file and settings of the scene. uncompressed: whether there is a
    method of this kind, too.
    """
    chosen, preset = chosen_settings(words), words.get("preset", "fast")
    options = {"background": None if chosen.background == "auto" else chosen.background}
    options |= {"start.voxel": words.get("voxel"), "start.anchors": words.get("anchors"), "degree": words.get("degree")}
    given = {name: value for name, value in options.items() if value is not None}
    changes = [one for one in words.get("set", ()) if one.partition("=")[0].strip() not in {*OWN_KEYS, *given}]
    scene = {
        **{"name": scene_name(photographs), "photographs": str(photographs.absolute())},
        **{"size": chosen.size, "holdout": chosen.holdout, "up": words.get("up")},
        "set": [*(f"{name}={value}" for name, value in given.items()), *changes],
    }
    methods = [{"name": CODED, "preset": preset, "static": words.get("static", False)}]
    methods += [{"name": UNCOMPRESSED, "kind": UNCOMPRESSED, "preset": preset}] if uncompressed else []
    lines = _toml({"lambdas": lambdas, "seeds": [chosen.seed], "steps": chosen.steps, "device": device})
    for key, tables in (("scenes", [scene]), ("methods", methods)):
        lines += [line for one in tables for line in (f"[[{key}]]", *_toml(one))]
    return parse_experiment(Path(f"{scene['name']}.toml"), ("\n".join(lines) + "\n").encode())


def scene_name(photographs: Path) -> str:
    """The name of a scene: that of its folder, with - for all characters that a name cannot have."""
    return re.sub(r"[^A-Za-z0-9._+-]", "-", photographs.resolve().name).strip("._+-")[:64] or "scene"


def _toml(table: Mapping[str, Any]) -> list[str]:
    """The lines of a table with texts, numbers and lists, those of JSON, without values that are None or empty."""
    return [f"{key} = {json.dumps(value)}" for key, value in table.items() if value not in (None, [])]


def _check_cells(experiment: Experiment) -> None:
    """Raises ExperimentError for a scene without lambdas, for too many cells, and for settings that are not allowed."""
    count = 0
    for scene in experiment.scenes:
        for method in experiment.methods_of(scene):
            lambdas = experiment.lambdas_of(scene, method)
            if not lambdas:
                raise ExperimentError(f"there are no lambdas for scene {scene.name}: give them, here or in the scene")
            experiment.settings(scene, method, lambdas[0], experiment.seeds[0])
            count += len(lambdas) * len(experiment.seeds)
            if count > CELLS_MAX:
                raise ExperimentError(f"it has more than {CELLS_MAX} cells, the most that are allowed")
