"""`python -m benchmarks decode`: each path of refcodec, compared with other codecs and the floor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .compiled import compiler_version
from .contenders import compared
from .large import KEPT, PAPER_ANCHORS, large
from .results import facts, facts_line, table
from .worker import WHOLE_OUTPUT

# Packages whose versions affect the figures.
PACKAGES = ("torch", "constriction")
# The decoding time of the paper, on a GPU, for a scene of PAPER_ANCHORS anchors.
PAPER_SECONDS = 13.1


def coding(trained: Path, anchors: int, rounds: int, kept: Path = KEPT) -> dict[str, Any]:
    """Returns the figures. Raises DisagreementError.

    trained: the scene whose symbols are coded. rounds: runs of each contender. kept: the folder of the scene.
    """
    machine = {**facts(*PACKAGES), "compiler": compiler_version()}
    scene = large(trained, anchors, kept)
    found = compared(scene.path, rounds, kept)
    return {"task": "decode", "machine": machine, "scene": scene.figures(), **found}


def coding_lines(figures: dict[str, Any]) -> list[str]:
    """Returns the figures as the lines of a section."""
    scene, rows = figures["scene"], []
    for row in figures["contenders"]:
        times = [f"{row['times'][clock]:.2f}" for clock in ("seconds", "processor")]
        rows.append([row["name"], f"{row['seconds']:.3f}", f"{row['processor']:.3f}", *times])
    planes = "5 x {1} x {2}^2".format(*scene["planes"])
    bits = scene["attribute_bits"]
    lines = [
        facts_line(figures["machine"]) + f" {figures['machine']['compiler'] or 'No compiler'}.",
        f"{scene['anchors']:,} anchors, {scene['bytes']:,} bytes, with the symbols of `{scene['trained']}`:",
        f"its anchors are repeated, and each copy has its own chunks. Planes are {planes}.",
        f"An anchor's attributes take {bits['large']:.2f} bits, and {bits['trained']:.2f} in the trained file.",
        "",
        *table(["contender", "seconds", "processor seconds", "times of seconds", "times of processor seconds"], rows),
        "",
        f"Medians of {figures['rounds']} rounds. In each round all contenders ran once, in this order. Times: the",
        f"median of the ratios to `{figures['base']}` in the same round. One thread each unless stated.",
        f"The digest of all results is {figures['digest'][:16]}.",
        f"The output is {WHOLE_OUTPUT}, unless stated below.",
        "",
    ]
    others = (row for row in figures["contenders"] if row["says"] != WHOLE_OUTPUT)
    lines += [f"- {row['name']}: {row['says']}{_parts(row)}." for row in others]
    lines += [f"- {each['name']} did not take part: {each['why']}." for each in figures["missing"]]
    if scene["anchors"] == PAPER_ANCHORS:
        lines += ["", f"The paper's own decoder takes {PAPER_SECONDS} s for a scene of this size, on a GPU."]
    return lines


def _parts(row: dict[str, Any]) -> str:
    """Returns the parts of a contender's processor seconds as the end of a sentence."""
    parts = [f"{name} {seconds:.3f}" for name, seconds in row.get("parts", {}).items()]
    return f"; {', '.join(parts)} processor seconds" if parts else ""
