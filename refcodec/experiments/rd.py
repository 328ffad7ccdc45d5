"""Rate and distortion of one scene: its experiment, and the difference of its curve from another one."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import statuses
from ..files.outputs import check_apart
from ..files.terminal import note, say
from .command import CURVES, Options, run_experiment
from .curves import write_curves
from .experiment import COPY, MARK
from .figures import BD_POINTS, compare
from .plan import Experiment, parse_experiment
from .runs import RunError
from .tables import CSV, MARKDOWN, Row

CODED, UNCOMPRESSED = "coded", "uncompressed"


def scene_name(photographs: Path) -> str:
    """The name of a scene: that of its folder, with - for all characters that a name cannot have."""
    return re.sub(r"[^A-Za-z0-9._+-]", "-", photographs.resolve().name).strip("._+-")[:64] or "scene"


def one_scene(
    scene: Mapping[str, Any], preset: str, rates: Sequence[float], uncompressed: bool, **others: Any
) -> Experiment:
    """The experiment of one scene at some rates. Raises ExperimentError.

    scene, others: keys of the table [[scenes]] and of the file; values that are None or empty are left out.
    """
    methods = [{"name": CODED, "preset": preset}]
    methods += [{"name": UNCOMPRESSED, "kind": "uncompressed", "preset": preset}] if uncompressed else []
    lines = [*_toml({"rates": rates, **others}), "", "[[scenes]]", *_toml(scene)]
    for method in methods:
        lines += ["", "[[methods]]", *_toml(method)]
    return parse_experiment(Path(f"{scene['name']}.toml"), ("\n".join(lines) + "\n").encode())


def _toml(table: Mapping[str, Any]) -> list[str]:
    """The lines of a table with texts, numbers and lists. Those of JSON are valid in TOML."""
    return [f"{key} = {json.dumps(value)}" for key, value in table.items() if value not in (None, [])]


def run_rd(experiment: Experiment, inputs: Sequence[Path], options: Options, against: Path | None) -> int:
    """Runs an experiment of one scene, and prints its table. Returns the exit status.

    inputs: the files of the photographs. against: a table whose curve is compared with it. Raises RunError for a curve
    that cannot be compared, UsageError if an output is an input, and as run_experiment.
    """
    other = read_curve(against) if against else None
    if other is not None and min(len(experiment.rates), len(other)) < BD_POINTS:
        raise RunError(
            f"BD-rate needs {BD_POINTS} rates above 0 or more in both curves: {len(experiment.rates)} here, "
            f"{len(other)} in {against}"
        )
    folder = options.folder
    outputs = [folder / name for name in (MARK, COPY, CSV, MARKDOWN)]
    check_apart(outputs, [against, *inputs])
    status = run_experiment(experiment, options)
    say((folder / MARKDOWN).read_text(encoding="utf-8"), lines=True)
    if status == statuses.DONE and other is not None:
        rows = _rows(folder / CSV, other, str(against))
        write_curves(folder / CURVES, rows)
        found = compare(other, [row for row in rows if row["method"] == CODED])
        say(f"BD-rate {found.rate:+.2f} %, BD-PSNR {found.psnr:+.3f} dB against {against}")
        if found.warning:
            note(f"refcodec: {found.warning}")
    return status


def _rows(path: Path, other: Sequence[Row], name: str) -> list[Row]:
    """The rows of a table for a chart, and after them those of another curve. name: of its line."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    own: list[Row] = [{**row, **{key: float(row[key]) for key in ("rate", "bytes", "psnr")}} for row in rows]
    return own + [{"scene": own[0]["scene"], "method": name, "rate": i + 1.0, **row} for i, row in enumerate(other)]


def read_curve(path: Path) -> list[Row]:
    """The points of a table with the columns bytes and psnr, without uncompressed ones. Raises RunError.

    Other columns are ignored.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        points = [
            {"bytes": float(row["bytes"]), "psnr": float(row["psnr"])}
            for row in rows
            if float(row.get("rate") or 1) > 0
        ]
    except OSError as error:
        raise RunError(f"{path}: {error.strerror}") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise RunError(f"{path} is not a table with numbers in the columns bytes and psnr") from None
    if not all(
        point["bytes"] > 0 and math.isfinite(point["bytes"]) and math.isfinite(point["psnr"]) for point in points
    ):
        raise RunError(f"{path} has sizes or PSNRs that no file has")
    return points
