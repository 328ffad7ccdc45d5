"""Finds the trail of each requirement of SPEC.md: its code in the three decoders, its tests and its vectors.

- The code of a requirement on files is where its error is raised.
- The code of a requirement on decoders or renderers is where its clause is cited.
- The tests of a requirement name it, by `pytest.mark.requirement`. Each error also has a case of test_fault.
- The vectors of a requirement name it in the manifest.

Python code cites a clause by "SPEC" and its number, in a docstring or a comment. Code in C cites it in the comment
above the function.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from conformance.manifest import Manifest, Vector
from conformance.spec_decoder import program
from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect.specification import Requirement

from .made import ROOT

# The decoders and their source files. The blocks of SPEC.md are the second decoder.
DECODERS = {
    "refcodec": ("refcodec/bitstream/*.py", "refcodec/rendering/*.py", "refcodec/folder/*.py"),
    "second decoder": ("SPEC.md", "conformance/spec_decoder/*.py"),
    "decoder in C": ("conformance/c/decoder.c",),
}
# What also renders and writes files.
RENDERS = WRITES = ("refcodec",)
# Functions of SPEC.md that are also for clauses without a block, and these clauses.
CLAUSES = {
    "DECODE_SYMBOL": ("8.2",), "DECODE_VALUES": ("8.6",), "WORLD": ("9.1",),
    "DECODE_ATTRIBUTES": ("7.7", "7.8", "7.9"), "DECODE_FILE": ("10.1", "15.4"), "CHECK_DIRECTORY": ("12.1", "13.1"),
}  # fmt: skip
# The test that has a case for each error.
FAULTS = ("tests/conformance/test_decoders.py", "test_fault")


@dataclass(frozen=True, order=True)
class Place:
    """A function, a class or a test of a file of the repository."""

    path: str
    name: str


@dataclass(frozen=True)
class Trail:
    """The trail of a requirement. code: by decoder. vectors: their ids."""

    requirement: Requirement
    code: dict[str, list[Place]]
    tests: list[Place]
    vectors: list[str]


@dataclass
class Found:
    """Places in the code of a decoder. raising: by name of the error. citing: by clause."""

    raising: dict[str, list[Place]]
    citing: dict[str, list[Place]]


def _cited(comment: str) -> Iterator[str]:
    """Yields the clauses that a line of a comment or docstring cites."""
    yield from re.findall(r"(?<![\w.])(?:\d+|[A-H]\.\d+)(?:\.\d+)*(?!\w)", comment)
    # An annex is a letter without a following word: "A value" does not cite Annex A.
    yield from re.findall(r"(?:Annex |SPEC |, |and |/\* )([A-H])\b(?![ .]\w)", comment)


def _blocks(path: Path, found: Found) -> None:
    """Adds the functions and classes of the blocks of SPEC.md. Each cites the clause or the annex of its block."""
    text = path.read_text(encoding="utf-8")
    blocks = program.source(text)
    _python(path.name, blocks, found)
    clauses = [re.match(r"##+ (?:Annex )?([A-H]|[\d.]+)\b", line) for line in text.splitlines()]
    for node in ast.parse(blocks).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            own = next(match[1] for match in reversed(clauses[: node.lineno]) if match)
            for clause in (own, *CLAUSES.get(node.name, ())):
                found.citing[clause].append(Place(path.name, node.name))


def _python(name: str, source: str, found: Found) -> None:
    """Adds the functions and classes of a Python module that raise errors or cite clauses.

    The comments above a function and its decorators belong to it.
    """
    lines = source.splitlines()

    def visit(node: ast.AST, scope: str) -> None:
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.FunctionDef | ast.ClassDef):
                continue
            own = f"{scope}.{child.name}" if scope else child.name
            first = child.lineno - 1
            while first > 0 and re.match(r"\s*[#@]", lines[first - 1]):
                first -= 1
            inner = {
                id(n) for c in ast.walk(child) if c is not child and isinstance(c, ast.FunctionDef) for n in ast.walk(c)
            }
            for part in ast.walk(child):
                if id(part) not in inner and isinstance(part, ast.Constant) and part.value in REGISTRY:
                    found.raising[str(part.value)].append(Place(name, own))
            text = "\n".join(lines[first : child.end_lineno])
            for line in re.findall(r"SPEC [^\n]*", text):
                for clause in _cited(line):
                    found.citing[clause].append(Place(name, own))
            visit(child, own)

    visit(ast.parse(source), "")


def _c(name: str, source: str, found: Found) -> None:
    """Adds the functions of the decoder in C that refuse files or cite clauses.

    A function cites the clauses in the first line of the comment above it.
    """
    known = {e.replace(".", "_").upper(): e for e in REGISTRY}
    function, comment = "", ""
    for line in source.splitlines():
        if line.startswith("/*"):
            comment = line
        head = re.match(r"(?:\w+ )*[\w *]*?\b([A-Z][A-Z0-9_]*)\(", line) if line[:1].isalpha() else None
        if head:
            function = head[1]
            for clause in _cited(comment):
                found.citing[clause].append(Place(name, function))
            comment = ""
        if function and line[:1].isspace():
            for word in re.findall(r"\b[A-Z]+_[A-Z_]+\b", line):
                if word in known:
                    found.raising[known[word]].append(Place(name, function))


def _innermost(places: Iterable[Place]) -> list[Place]:
    """Returns each function once, without functions and classes that contain another one."""
    every = sorted(set(places))
    return [p for p in every if not any(o.path == p.path and o.name.startswith(f"{p.name}.") for o in every)]


def code() -> dict[str, Found]:
    """Returns the places in the code of each decoder."""
    every = {}
    for decoder, patterns in DECODERS.items():
        found = Found(defaultdict(list), defaultdict(list))
        for pattern in patterns:
            for path in sorted(ROOT.glob(pattern)):
                if path.suffix == ".md":
                    _blocks(path, found)
                else:
                    name, source = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
                    (_c if path.suffix == ".c" else _python)(name, source, found)
        every[decoder] = found
    return every


def proofs() -> tuple[dict[str, list[Place]], Place]:
    """Returns the tests by requirement, and the test of all faults."""
    found = defaultdict(list)
    fault = None
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        name = path.relative_to(ROOT).as_posix()
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.FunctionDef):
                continue
            place = Place(name, node.name)
            if (name, node.name) == FAULTS:
                fault = place
            for mark in node.decorator_list:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.requirement":
                    for argument in mark.args:
                        found[ast.literal_eval(argument)].append(place)
    assert fault is not None, "the test of faults is missing"
    return found, fault


def by_name(suite: Manifest, names: Callable[[Vector], Iterable[str]]) -> dict[str, list[str]]:
    """Returns the ids of the vectors by name. names: returns the names of a vector."""
    found = defaultdict(list)
    for vector in suite.vectors:
        for name in names(vector):
            found[name].append(vector.id)
    return found


def trails(requirements: dict[str, Requirement], suite: Manifest) -> dict[str, Trail]:
    """Returns the trail of each requirement.

    Raises SystemExit if a test or a vector names a requirement that SPEC.md does not have.
    """
    found, (tests, fault), tried = code(), proofs(), by_name(suite, lambda v: v.requirements)
    strangers = [name for name in (*tests, *tried) if name not in requirements]
    if strangers:
        raise SystemExit(f"SPEC.md does not have {', '.join(sorted(set(strangers)))}")
    made = {}
    for name, r in requirements.items():
        places = {d: _innermost(f.raising[r.error] if r.error else f.citing[r.clause]) for d, f in found.items()}
        for letter, decoders in (("G", RENDERS), ("E", WRITES)):
            if name.startswith(letter):
                places = {decoder: places[decoder] for decoder in decoders}
        faults = [Place(fault.path, f"{fault.name}[{r.error}]")] if r.error else []
        made[name] = Trail(r, places, faults + tests[name], tried[name])
    return made
