"""Tables of what was measured."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from ..results import machine, table, write_section
from .questions import QUESTIONS

# The measurements in a folder, one to a line.
FILE = "lengths.jsonl"
HEAD = ["entropy model", "seeds", "sum, bytes", "sum", "A", "features", "scalings", "offsets", "P", "networks"]


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
    entries = [json.loads(line) for line in (work / FILE).read_text().splitlines()]
    lines: list[str] = []
    for question in QUESTIONS.values():
        names = {name: repr(variant) for name, variant in question.variants.items()}
        found: dict[str, dict[str, dict[int, dict[str, Any]]]] = defaultdict(lambda: defaultdict(dict))
        facts: dict[str, dict[str, Any]] = {}
        for entry in entries:
            if entry["variant"] in names.values():
                found[entry["scene"]][entry["variant"]][entry["seed"]] = entry
                facts[entry["scene"]] = entry
        shown: list[str] = []
        for scene, of_scene in sorted(found.items(), key=lambda item: facts[item[0]]["anchors"]):
            body = rows(of_scene, names)
            if len(body) < 2:
                continue
            fact = facts[scene]
            shown += ["", f"**{scene}**, {fact['anchors']:,} anchors:", "", *table(HEAD, body)]
        if shown:
            lines += ["", f"### {question.title}", *shown]
    return lines


def write(work: Path, results: bool) -> None:
    """Prints the tables, or writes them as a section of RESULTS.md."""
    lines = sections(work)
    if not results:
        print("\n".join(lines))
        return
    write_section("lengths", "Other entropy models, by code lengths", ["", machine("torch"), *lines])
