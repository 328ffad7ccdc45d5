"""Tables of what was measured."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from ..results import machine, table, write_section
from .bounds import BOUNDS_FILE
from .bounds import HEAD as BOUNDS_HEAD
from .bounds import rows as bound_rows
from .moves import MOVES_FILE
from .questions import QUESTIONS
from .verdicts import COMMANDS, VERDICTS

# The measurements in a folder, one to a line.
FILE = "lengths.jsonl"
# Trainings that were noted.
TRAINED_FILE = "trained.jsonl"
# The parts of a training's estimate that are not shares of others.
PARTS = ("positions", "attributes", "masks", "planes", "weights")
HEAD = ["entropy model", "seeds", "sum, bytes", "sum", "A", "features", "scalings", "offsets", "P", "networks"]


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def _spread(values: list[float]) -> str:
    mean = f"{np.mean(values):,.0f}"
    return f"{mean} ± {np.std(values, ddof=1):,.0f}" if len(values) > 1 else mean


def _attributes(entry: dict[str, Any]) -> float:
    return float(entry["features"] + entry["scalings"] + entry["offsets"])


def _total(entry: dict[str, Any]) -> float:
    return float(_attributes(entry) + entry["planes"] + sum(entry["networks"].values()))


def change(entries: dict[int, dict[str, Any]], first: dict[int, dict[str, Any]]) -> str:
    """The sum against the reference's, in percent: mean and spread over the seeds that both have."""
    each = [100 * (_total(entries[s]) / _total(first[s]) - 1) for s in entries if s in first]
    if not each:
        return ""
    mean = f"{np.mean(each):+.2f}"
    return f"{mean} ± {np.std(each, ddof=1):.2f} %" if len(each) > 1 else f"{mean} %"


def rows(found: dict[str, dict[int, dict[str, Any]]], names: dict[str, str]) -> list[list[str]]:
    """A row for each entropy model that was measured. found: by variant and seed. names: variants by name."""
    reference = found.get(next(iter(names.values())), {})
    lines = []
    for name, variant in names.items():
        entries = found.get(variant, {})
        if not entries:
            continue
        every = list(entries.values())
        parts = [f"{np.mean([e[kind] for e in every]):,.0f}" for kind in ("features", "scalings", "offsets", "planes")]
        networks = f"{np.mean([sum(e['networks'].values()) for e in every]):,.0f}"
        sums = _spread([_total(e) for e in every])
        cells = [name, str(len(every)), sums, change(entries, reference), _spread([_attributes(e) for e in every])]
        lines.append([*cells, *parts, networks])
    return lines


def sections(work: Path) -> list[str]:
    """The tables of all questions."""
    entries = _lines(work / FILE)
    lines: list[str] = []
    for key, question in QUESTIONS.items():
        names = {name: repr(variant) for name, variant in question.variants.items()}
        found: dict[str, dict[str, dict[int, dict[str, Any]]]] = defaultdict(lambda: defaultdict(dict))
        facts: dict[str, dict[str, Any]] = {}
        # A model may be of several questions. Its row is in the table of a question that was asked of the scene.
        # Measurements that do not say their question are older.
        asked: dict[str, bool] = defaultdict(bool)
        for entry in entries:
            if entry["variant"] in names.values():
                asked[entry["scene"]] |= entry.get("question", key) == key
                found[entry["scene"]][entry["variant"]][entry["seed"]] = entry
                facts[entry["scene"]] = entry
        shown: list[str] = []
        for scene, of_scene in sorted(found.items(), key=lambda item: facts[item[0]]["anchors"]):
            body = rows(of_scene, names)
            if len(body) < 2 or not asked[scene]:
                continue
            fact = facts[scene]
            shown += ["", f"**{scene}**, {fact['anchors']:,} anchors:", "", *table(HEAD, body)]
        if shown:
            lines += ["", f"### {question.title}", *shown]
    return lines


def bounds(work: Path) -> list[str]:
    """The tables of benchmarks.lengths.bounds."""
    latest = {}
    for entry in _lines(work / BOUNDS_FILE):
        latest[entry["scene"]] = entry
    lines: list[str] = []
    for entry in sorted(latest.values(), key=lambda e: int(e["anchors"])):
        title = f"**{entry['scene']}**, {entry['anchors']:,} anchors:"
        lines += ["", title, "", *table(BOUNDS_HEAD, bound_rows(entry["found"]))]
    return ["", "### Contexts by linear prediction", *lines] if lines else []


def moves(work: Path) -> list[str]:
    """The table of benchmarks.lengths.moves."""
    latest = {(e["scene"], e["kinds"], e["least"]): e for e in _lines(work / MOVES_FILE)}
    cells = []
    for entry in latest.values():
        share = f"{100 * entry['saved'] / entry['file']:.2f} %"
        kind = {"f": "features", "s": "scalings", "o": "offsets"}[entry["kinds"]]
        lost = f"{max(entry['lost'], 0):.3f}"
        cells.append([entry["scene"], kind, f"{entry['least']:g}", f"{entry['moved']:,}", share, lost])
    head = ["scene", "symbols", "least bits of a move", "moves", "of the file saved", "dB lost"]
    return ["", "### Symbols moved towards their means", "", *table(head, cells)] if cells else []


def trained(work: Path) -> list[str]:
    """The table of the trainings that were noted: what grids of weights may be, and what came of it."""
    cells = []
    for entry in sorted(_lines(work / TRAINED_FILE), key=lambda e: (e["seed"], e["coarser"])):
        size = entry["bytes"]
        grids = [" to ".join(map(str, entry[key])) for key in ("coarser", "rendering_bits")]
        each = [f"{size['attributes']:,}", f"{size['weights']:,}", f"{sum(size[k] for k in PARTS):,}"]
        cells.append([entry["name"], str(entry["seed"]), *grids, *each, f"{entry['psnr']:.3f}"])
    head = ["training", "seed", "coarser", "rendering bits", "A, bytes", "weights, bytes", "sum, bytes", "PSNR, dB"]
    return ["", "### Coarser grids in training", "", *table(head, cells)] if cells else []


def note_training(work: Path, folder: Path) -> None:
    """Keeps what a trained folder reports of itself."""
    found = json.loads((folder / "training.json").read_text())
    weights = found["settings"]["weights"]
    entry = {"name": folder.name, "seed": found["settings"]["seed"], "psnr": found["psnr"], "bytes": found["bytes"]}
    entry |= {"coarser": weights["coarser"], "rendering_bits": weights["rendering_bits"]}
    with (work / TRAINED_FILE).open("a") as stream:
        stream.write(json.dumps(entry) + "\n")


def write(work: Path, results: bool) -> None:
    """Prints the tables, or writes them as a section of RESULTS.md."""
    lines = [*VERDICTS, *sections(work), *bounds(work), *trained(work), *moves(work)]
    if not results:
        print("\n".join(lines))
        return
    write_section("lengths", "Other entropy models, by code lengths", [*COMMANDS, "", machine("torch"), *lines])
