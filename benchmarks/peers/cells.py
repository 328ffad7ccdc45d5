"""Cells of an experiment (refcodec.experiments) as records of runs, for one table with the peers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from refcodec.experiments.cells import Result, read_result
from refcodec.experiments.tables import MARKDOWN

from .figures import Record

# The names of a coded and an uncompressed scene in the table.
CODED, PLAIN = "C3GS", "Scaffold-GS"
# The methods whose names add nothing to it.
USUAL = ("pro", "uncompressed")


def experiment_name(folder: Path) -> str:
    """Returns the name of the experiment of an output folder of `refcodec experiment`. Raises OSError."""
    return (folder / MARKDOWN).read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")


def results(folder: Path) -> Iterator[tuple[str, str, Result]]:
    """Yields scene, method and result of the complete cells of an output folder of `refcodec experiment`."""
    for place in sorted(folder.glob("cells/*/*/lambda-*/seed-*")):
        if (result := read_result(place)) is not None:
            yield place.parents[2].name, place.parents[1].name, result


def experiment_records(folder: Path) -> Iterator[Record]:
    """Returns the complete cells of an output folder of `refcodec experiment`.

    Seconds are the processor seconds of the whole command `train`.
    """
    for scene, method, result in results(folder):
        settings = result.definition["settings"]
        kind = CODED if settings["rate"]["lambda_r"] else PLAIN
        yield {
            "scene": scene,
            "method": method,
            "strength": settings["rate"]["lambda_r"],
            "seed": settings["seed"],
            "size": int(settings["size"]),
            "steps": settings["steps"],
            "changes": [],
            "seconds": result.processor_seconds["train"],
            "files": {
                kind if method in USUAL else f"{kind}, {method}": {
                    "bytes": result.bytes,
                    "psnr": result.mean.psnr,
                    "ssim": result.mean.ssim,
                }
            },
        }
