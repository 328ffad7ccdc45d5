"""Rate and distortion of one scene: its experiment, and the difference of its curve from another one."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..files.outputs import check_apart
from ..files.terminal import note, say
from ..statuses import DONE
from .command import COPY, MARK, Options, run_experiment
from .jobs import RunError
from .plan import Experiment, parse_experiment
from .tables import BD_POINTS, CSV, CURVES, MARKDOWN, Row, compare, write_curves

CODED, UNCOMPRESSED = "coded", "uncompressed"
# The settings of options of `train`.
_SETTINGS = {"background": "background", "voxel": "start.voxel", "anchors": "start.anchors", "degree": "degree"}


def scene_name(photographs: Path) -> str:
    """The name of a scene: that of its folder, with - for all characters that a name cannot have."""
    return re.sub(r"[^A-Za-z0-9._+-]", "-", photographs.resolve().name).strip("._+-")[:64] or "scene"


def one_scene(
    scene: Mapping[str, Any],
    preset: str,
    lambdas: Sequence[float],
    uncompressed: bool,
    static: bool = False,
    **others: Any,
) -> Experiment:
    """The experiment of one scene at some lambda_r. Raises ExperimentError.

    scene: keys of the table [[scenes]], and `voxel`, `anchors`, `background` and `degree` as for train, as is static.
    others: keys of the file. Values that are None or empty are left out.
    """
    table = {key: value for key, value in scene.items() if key not in _SETTINGS}
    given = {name: scene[key] for key, name in _SETTINGS.items() if scene.get(key) is not None}
    changes = [change for change in scene["set"] if change.partition("=")[0].strip() not in given]
    changes = [*(f"{name}={value}" for name, value in given.items()), *changes]
    lines = [*_toml({"lambdas": lambdas, **others}), "[[scenes]]", *_toml({**table, "set": changes})]
    lines += ["[[methods]]", *_toml({"name": CODED, "preset": preset, "static": static})]
    if uncompressed:
        lines += ["[[methods]]", *_toml({"name": UNCOMPRESSED, "kind": UNCOMPRESSED, "preset": preset})]
    return parse_experiment(Path(f"{scene['name']}.toml"), ("\n".join(lines) + "\n").encode())


def _toml(table: Mapping[str, Any]) -> list[str]:
    """The lines of a table with texts, numbers and lists. Those of JSON are valid in TOML."""
    return [f"{key} = {json.dumps(value)}" for key, value in table.items() if value not in (None, [])]


def run_rd(experiment: Experiment, inputs: Sequence[Path], options: Options, against: Path | None) -> int:
    """Runs an experiment of one scene, and prints its table. Returns the exit status.

    inputs: the files of the photographs. against: a table whose curve is compared with it. Raises RunError for a curve
    that cannot be compared, UsageError if an output is an input, and as run_experiment.
    """
    other = [point for point in _read(against) if point["lambda_r"]] if against else None
    if other is not None and (least := min(len(experiment.lambdas), len(other))) < BD_POINTS:
        raise RunError(f"BD-rate needs {BD_POINTS} points or more, here and in {against}: there are {least}")
    folder = options.folder
    check_apart([folder / name for name in (MARK, COPY, CSV, MARKDOWN)], [against, *inputs])
    status = run_experiment(experiment, options)
    say((folder / MARKDOWN).read_text(encoding="utf-8"), lines=True)
    if status == DONE and other is not None:
        own = _read(folder / CSV)
        reference = [{**point, "scene": own[0]["scene"], "method": str(against)} for point in other]
        write_curves(folder / CURVES, own + reference)
        found = compare(other, [point for point in own if point["method"] == CODED])
        say(f"BD-rate {found.rate:+.2f} %, BD-PSNR {found.psnr:+.3f} dB against {against}")
        if found.warning:
            note(f"refcodec: {found.warning}")
    return status


def _read(path: Path) -> list[Row]:
    """The points of a table with the columns bytes and psnr. Raises RunError.

    Without the column lambda_r, the number of a point stands for it.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = [*csv.DictReader(file)]
        numbers = [{"lambda_r": number, **line} for number, line in enumerate(lines, 1)]
        rows: list[Row] = [
            {**line, **{key: float(line[key]) for key in ("bytes", "psnr", "lambda_r")}} for line in numbers
        ]
    except OSError as error:
        raise RunError(f"{path}: {error.strerror}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise RunError(f"{path} is not a table with numbers in the columns bytes and psnr") from None
    if not all(row["bytes"] > 0 and math.isfinite(row["bytes"]) and math.isfinite(row["psnr"]) for row in rows):
        raise RunError(f"{path} has sizes or PSNRs that no file has")
    return rows
