"""Finds the trail of each requirement and clause of SPEC.md: its code in the three decoders, its tests and its vectors.

- The code of a requirement on files is where its error is raised.
- The code of a requirement on decoders or renderers is where its clause is cited.
- The tests of a requirement name it, by `pytest.mark.requirement`. Each error also has a case of test_fault.
- The vectors of a requirement name it in the manifest.
- The code and the tests of a clause cite it. Its vectors have a feature whose description in the manifest names it, or
  a section of its ancillary type.

Python code cites a clause by "SPEC" and its number, in a docstring or a comment. Code in C cites it in the comment
above the function.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from conformance.manifest import Manifest, Vector
from conformance.spec_decoder import program
from refcodec.bitstream.ancillary import TYPES
from refcodec.bitstream.errors import REGISTRY
from refcodec.bitstream.header import HEADER_LENGTH_MAX, PROLOGUE_BYTES
from refcodec.inspect.specification import Requirement, own_clauses
from refcodec.inspect.trail import CodePlace, Trail, TrailRecord

from .made import ROOT

# The decoders and their source files. The blocks of SPEC.md are the second decoder.
DECODERS = {
    "refcodec": ("refcodec/**/*.py",),
    "second decoder": ("SPEC.md", "conformance/spec_decoder/*.py"),
    "decoder in C": ("conformance/c/decoder.c",),
}
# Where the code of a requirement can be. That of a clause is anywhere.
DECODING = ("refcodec/bitstream/", "refcodec/rendering/", "refcodec/folder/", "SPEC.md", "conformance/")
# What also renders and writes files.
WRITES = ("refcodec",)
# Functions of SPEC.md that are also for clauses without a block, and these clauses.
CLAUSES = {
    "FRAME_COORDINATES": ("7.5.1",), "CONTRACT": ("7.5.2",), "RESCALE": ("7.5.3",),
    "DECODE_SYMBOL": ("8.2",), "DECODE_VALUES": ("8.6",), "WORLD": ("9.1",),
    "DECODE_ATTRIBUTES": ("7.7", "7.8", "7.9"), "DECODE_FILE": ("10.1", "15.4"), "CHECK_DIRECTORY": ("12.1", "13.1"),
}  # fmt: skip
# The test that has a case for each error.
FAULTS = ("tests/conformance/test_decoders.py", "test_fault")


@dataclass
class Mentions:
    """Places in the code of a decoder. raising: by name of the error. citing: by clause."""

    raising: dict[str, list[CodePlace]]
    citing: dict[str, list[CodePlace]]


def _cited(comment: str) -> Iterator[str]:
    """Yields the clauses that a line of a comment or docstring cites."""
    yield from re.findall(r"(?<![\w.])(?:\d+|[A-H]\.\d+)(?:\.\d+)*(?!\w)", comment)
    # An annex is a letter without a following word: "A value" does not cite one.
    yield from re.findall(r"(?:Annex |SPEC |, |and |/\* )([A-H])\b(?![ .]\w)", comment)


def _blocks(path: Path, mentions: Mentions) -> None:
    """Adds the functions and classes of the blocks of SPEC.md. Each cites the clause or the annex of its block."""
    text = path.read_text(encoding="utf-8")
    blocks = program.source(text)
    _python(path.name, blocks, mentions)
    clauses = [re.match(r"##+ (?:Annex )?([A-H]|[\d.]+)\b", line) for line in text.splitlines()]
    for node in ast.parse(blocks).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            own = next(match[1] for match in reversed(clauses[: node.lineno]) if match)
            for clause in (own, *CLAUSES.get(node.name, ())):
                mentions.citing[clause].append(CodePlace(path.name, node.name))


def _python(name: str, source: str, mentions: Mentions) -> None:
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
                    mentions.raising[str(part.value)].append(CodePlace(name, own))
            text = "\n".join(lines[first : child.end_lineno])
            for line in re.findall(r"SPEC [^\n]*", text):
                for clause in _cited(line):
                    mentions.citing[clause].append(CodePlace(name, own))
            visit(child, own)

    visit(ast.parse(source), "")


def _c(name: str, source: str, mentions: Mentions) -> None:
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
                mentions.citing[clause].append(CodePlace(name, function))
            comment = ""
        if function and line[:1].isspace():
            for word in re.findall(r"\b[A-Z]+_[A-Z_]+\b", line):
                if word in known:
                    mentions.raising[known[word]].append(CodePlace(name, function))


def _innermost(places: Iterable[CodePlace]) -> list[CodePlace]:
    """Returns each function once, without functions and classes that contain another one."""
    every = sorted(set(places))
    return [p for p in every if not any(o.path == p.path and o.name.startswith(f"{p.name}.") for o in every)]


def code() -> dict[str, Mentions]:
    """Returns the places in the code of each decoder."""
    every = {}
    for decoder, patterns in DECODERS.items():
        mentions = Mentions(defaultdict(list), defaultdict(list))
        for pattern in patterns:
            for path in sorted(ROOT.glob(pattern)):
                if path.suffix == ".md":
                    _blocks(path, mentions)
                else:
                    name, source = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
                    (_c if path.suffix == ".c" else _python)(name, source, mentions)
        every[decoder] = mentions
    return every


def proofs() -> tuple[dict[str, list[CodePlace]], dict[str, list[CodePlace]]]:
    """Returns the tests by the requirements that mark them, and by the clauses that they cite."""
    marked, citing = defaultdict(list), defaultdict(list)
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        name, source = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
        for node in ast.parse(source).body:
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
                continue
            place = CodePlace(name, node.name)
            for mark in node.decorator_list:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.requirement":
                    for argument in mark.args:
                        marked[ast.literal_eval(argument)].append(place)
            for line in re.findall(r"SPEC [^\n]*", "\n".join(source.splitlines()[node.lineno - 1 : node.end_lineno])):
                for clause in _cited(line):
                    citing[clause].append(place)
    return marked, citing


def by_name(suite: Manifest, names: Callable[[Vector], Iterable[str]]) -> dict[str, list[str]]:
    """Returns the ids of the vectors by name. names: returns the names of a vector."""
    ids = defaultdict(list)
    for vector in suite.vectors:
        for name in names(vector):
            ids[name].append(vector.id)
    return ids


def _clauses_of(suite: Manifest) -> Callable[[Vector], Iterator[str]]:
    """Returns a function that yields the clauses that a vector is for."""
    features = {name: list(_cited(text)) for name, text in suite.features.items()}

    def clauses(vector: Vector) -> Iterator[str]:
        header = suite.path(vector).read_bytes()[:HEADER_LENGTH_MAX]
        for entry in TYPES.values():
            if entry.type in header[: PROLOGUE_BYTES + int.from_bytes(header[12:16], "little")]:
                yield from (*entry.tables.values(), entry.clause)
        for feature in vector.features:
            yield from features[feature]

    return clauses


def trails(requirements: dict[str, Requirement], suite: Manifest) -> TrailRecord:
    """Returns the trails of the requirements, and of the clauses that these leave without one, with all vectors.

    Raises SystemExit if a test or a vector names a requirement that SPEC.md does not have.
    """
    places_in, (marked, citing), tried = code(), proofs(), by_name(suite, lambda v: v.requirements)
    strangers = [name for name in (*marked, *tried) if name not in requirements]
    if strangers:
        raise SystemExit(f"SPEC.md does not have {', '.join(sorted(set(strangers)))}")
    own = {}
    for name, r in requirements.items():
        decoders = WRITES if name[0] in "GE" else tuple(places_in)
        every = {d: places_in[d].raising[r.error] if r.error else places_in[d].citing[r.clause] for d in decoders}
        places = {d: _innermost(p for p in some if p.path.startswith(DECODING)) for d, some in every.items()}
        faults = [CodePlace(FAULTS[0], f"{FAULTS[1]}[{r.error}]")] if r.error else []
        own[name] = Trail(places, faults + marked[name], len(tried[name]), tried[name])
    stated, vectors = {r.clause for r in requirements.values()}, by_name(suite, _clauses_of(suite))
    others = {}
    for number in own_clauses():
        places = {decoder: _innermost(mentions.citing[number]) for decoder, mentions in places_in.items()}
        trail = Trail(places, citing[number], len(vectors[number]), vectors[number])
        if number not in stated and (any(places.values()) or trail.tests or trail.vectors):
            others[number] = trail
    return TrailRecord(own, others)
