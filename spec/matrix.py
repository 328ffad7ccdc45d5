"""Writes conformance/REQUIREMENTS.md: for each requirement of SPEC.md the clause, the code of both decoders, the tests and the vectors;
for each error code, feature and flag the vectors.

A requirement on files is in the code where its error is raised, one on decoders where the code cites its clause. Tests name the
requirements that they prove (`pytest.mark.requirement`); an error's fault is tested under its name.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from conformance.blocks import CLAUSE, requirements
from conformance.manifest import Manifest, Rejected, Vector, load
from refcodec.bitstream.errors import REGISTRY

from .made import ROOT, Made

TARGET = ROOT / "conformance" / "REQUIREMENTS.md"
# The bitstream side; what only shows, writes folders or fits proves nothing about decoding.
FIRST = [*sorted((ROOT / "refcodec" / "bitstream").glob("*.py")), *sorted((ROOT / "refcodec" / "render").glob("*.py"))]
SECOND = [p for p in sorted((ROOT / "conformance" / "independent").glob("*.py")) if p.stem != "errors"]
HEAD = """# Requirements

Each requirement of [SPEC.md](../SPEC.md), where both decoders meet it, the tests that prove it, and how many
[vectors](../vectors/README.md) test it, with the first of them. Written by `python -m spec`. `test_fault[...]` stands for
generated files with that one fault, which both decoders must refuse with its code and offset.

| requirement | clause | what | refcodec | second decoder | tests | vectors |
|---|---|---|---|---|---|---|
"""
# What no file and its one result can show, and why.
NO_VECTOR = {
    "D10.1-2": "none: a mode of decoding that a runner does not ask for",
    "G14.5-1": "none: a runner does not compare images",
}


def _functions(path: Path) -> Iterator[tuple[str, str, ast.AST]]:
    """(qualified name, the comments above it and its own source, node) of each function and class of a module."""
    source = path.read_text(encoding="utf-8")
    lines = source.splitlines()

    def visit(node: ast.AST, scope: str) -> Iterator[tuple[str, str, ast.AST]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                first = child.lineno - 1
                while first > 0 and re.match(r"\s*[#@]", lines[first - 1]):
                    first -= 1
                name = f"{scope}.{child.name}"
                yield name, "\n".join(lines[first : child.end_lineno]), child
                yield from visit(child, name)

    yield from visit(ast.parse(source), path.stem)


def _innermost(found: list[str]) -> list[str]:
    """Without a class whose method is listed, or a function whose inner function is."""
    return [name for name in found if not any(other.startswith(name + ".") for other in found)]


def places(paths: list[Path]) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Functions by error name that they hold as a string, and by clause that they cite."""
    raising, citing = defaultdict(list), defaultdict(list)
    for path in paths:
        for name, text, node in _functions(path):
            for part in ast.walk(node):
                if (
                    isinstance(part, ast.Constant)
                    and isinstance(part.value, str)
                    and re.fullmatch(r"[a-z]+\.[a-z_]+", part.value)
                ):
                    raising[part.value].append(name)
            for line in re.findall(r"SPEC [^\n]*", text):
                for clause in re.findall(rf"(?<![\w.]){CLAUSE}(?![\w])", line):
                    citing[clause].append(name)
                citing["A"] += [name] if "Annex A" in line else []
    return raising, citing


def proofs() -> dict[str, list[str]]:
    """Tests by requirement."""
    found = defaultdict(list)
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.FunctionDef):
                continue
            for mark in node.decorator_list:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.requirement":
                    for argument in mark.args:
                        found[ast.literal_eval(argument)].append(f"{path.stem}.{node.name}")
    return found


def _cell(found: list[str]) -> str:
    """How many vectors, and the first of them."""
    return f"{len(found)}: {found[0]}" + (" ..." if len(found) > 1 else "")


def vectors(suite: Manifest, names: Callable[[Vector], Iterable[str]]) -> dict[str, list[str]]:
    """The vectors by each name that they have."""
    found = defaultdict(list)
    for vector in suite.vectors:
        for name in names(vector):
            found[name].append(vector.id)
    return found


def others(suite: Manifest) -> str:
    """The tables of error codes, features and flags. Raises SystemExit for one without a vector."""
    refused = vectors(suite, lambda v: [v.expectation.name] if isinstance(v.expectation, Rejected) else [])
    having, catching = vectors(suite, lambda v: v.features), vectors(suite, lambda v: v.flags)
    codes = {name: (f"{kind.code} {name}", kind.clause) for name, kind in REGISTRY.items()}
    text = ""
    for title, head, rows, found in (
        ("Error codes", "| code | clause | vectors |", codes, refused),
        (
            "Features",
            "| feature | what | vectors |",
            {name: (name, what) for name, what in suite.features.items()},
            having,
        ),
        (
            "Flags",
            "| flag | the bug that it stands for | vectors |",
            {name: (name, what) for name, what in suite.flags.items()},
            catching,
        ),
    ):
        if holes := [key for key in rows if not found[key]]:
            raise SystemExit(f"without a vector: {', '.join(holes)}")
        lines = [f"| {first} | {second} | {_cell(found[key])} |" for key, (first, second) in rows.items()]
        text += "\n".join(
            ["", f"## {title}", "", f"{len(rows)} of {len(rows)} have a vector.", "", head, "|---|---|---|", *lines, ""]
        )
    return text


def matrix(spec: str) -> str:
    """The document. Raises SystemExit for a requirement without code, test or vector, and for a test or vector of none."""
    (raise_1, cite_1), (raise_2, cite_2) = places(FIRST), places(SECOND)
    suite = load()
    tests, tried = proofs(), vectors(suite, lambda v: v.requirements)
    rows, names, holes = [], set(), []
    for name, clause, sentence, error in requirements(spec):
        names.add(name)
        cells = []
        for raising, citing in ((raise_1, cite_1), (raise_2, cite_2)):
            found = raising[error] if error else citing[clause]
            # The second decoder does not render.
            cells.append(["-"] if name.startswith("G") and citing is cite_2 else _innermost(sorted(set(found))))
        proved = [f"test_independent.test_fault[{error}]"] if error else []
        cells.append(proved + tests[name])
        cells.append([_cell(tried[name])] if tried[name] else [NO_VECTOR[name]] if name in NO_VECTOR else [])
        if not all(cells):
            holes.append(name)
        rows.append(f"| {name} | {clause} | {sentence} | " + " | ".join("<br>".join(cell) for cell in cells) + " |")
    holes += [
        f"{name}, which SPEC.md does not have"
        for name in (*tests, *tried)
        if name not in names and (tests[name] or tried[name])
    ]
    holes += [f"{name}, which has a vector" for name in NO_VECTOR if tried[name]]
    if holes:
        raise SystemExit(f"holes in the matrix: {', '.join(holes)}")
    shown = len(names) - len(NO_VECTOR)
    share = f"\n{shown} of {len(names)} requirements have a vector; no file and its one result can show the other {len(NO_VECTOR)}.\n"
    return HEAD + "\n".join(rows) + "\n" + share + others(suite)


def made() -> Iterator[Made]:
    """conformance/REQUIREMENTS.md."""
    yield Made.text(TARGET, matrix((ROOT / "SPEC.md").read_text(encoding="utf-8")))
