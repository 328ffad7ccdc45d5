"""Explains a key: an error, a requirement, a clause, an element's path, a field, a term, or a function of SPEC.md.

The text comes from SPEC.md and the registry of errors. The code of each decoder, the tests and the vectors come from
the trail that `python -m spec` records.
"""

from __future__ import annotations

import difflib
import json
import re
import textwrap
import tomllib
from collections.abc import Iterator
from functools import cache
from typing import Any

from ..bitstream.errors import REGISTRY, ErrorKind
from ..resources import find
from . import specification
from .meaning import FIELDS, TABLE_CLAUSES, Meaning, is_path, meaning, of_field

# Columns of the printed text.
WIDTH = 112


class UnknownKeyError(KeyError):
    """Nothing is known under a key. The argument is a line that says so."""


@cache
def _trail() -> dict[str, Any]:
    data: dict[str, Any] = json.loads(find("data/trail.json").read_text(encoding="utf-8"))
    return data


@cache
def _reasons() -> dict[str, dict[str, str]]:
    return tomllib.loads(find("data/explanations.toml").read_text(encoding="utf-8"))


@cache
def _source(path: str) -> list[str]:
    try:
        return find(path).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return []


def _place(path: str, function: str, error: str) -> str:
    """Returns the path of a function, with its line if the source is here: that of the error if it raises the error."""
    name = function.partition("[")[0].rpartition(".")[2]
    begins = re.compile(rf"[A-Za-z].*\b{name}\((?!.*\);$)" if path.endswith(".c") else rf"\s*(def|class) {name}\b")
    raises = re.compile(rf"\b{error.replace('.', '_').upper()}\b" if path.endswith(".c") else f'"{re.escape(error)}"')
    starts = [number for number, line in enumerate(_source(path), start=1) if begins.match(line)]
    for start in starts if error else []:
        for number, line in enumerate(_source(path)[start:], start=start + 1):
            if begins.match(line) or (line[:1].isalpha() and not line.startswith("static")):
                break
            if raises.search(line):
                return f"{path}:{number}"
    return f"{path}:{starts[0]}" if starts else path


def _wrapped(text: str, indent: str = "  ") -> Iterator[str]:
    yield from textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."


def _clause_name(number: str) -> str:
    return f"{number} {specification.own_clauses()[number].title}"


# --- one kind of key each ---------------------------------------------------------------------------------------------


def _requirement_lines(name: str) -> Iterator[str]:
    """A requirement, its error, code, tests and vectors."""
    r, trail = specification.own_requirements()[name], _trail()[name]
    whose = {"R": "files", "D": "decoders", "G": "renderers", "E": "encoders and editors"}[name[0]]
    yield f"{name}, a requirement on {whose}, clause {_clause_name(r.clause)}"
    yield from _wrapped(f"{r.text}.")
    if r.error:
        kind = REGISTRY[r.error]
        yield f"  a file that violates it: error {kind.code} {kind.name}"
    for title, places in (*trail["code"].items(), ("tests", trail["tests"])):
        for i, (path, function) in enumerate(places):
            yield f"  {title if i == 0 else '':<15} {_place(path, function, r.error)} {function}"
    vectors, count = trail["vectors"], trail["count"]
    yield f"  {'vectors':<15} {count}"
    for vector in vectors:
        yield f"  {'':<15} {vector}"
    if count > len(vectors):
        yield f"  {'':<15} ... all of them: conformance run --select requirement:{name} -- YOUR DECODER"


def _error_lines(kind: ErrorKind) -> Iterator[str]:
    """An error: its meaning, why there is the rule, how files come to break it, and its requirement."""
    reason = _reasons()[kind.name]
    yield f"{kind.code} {kind.name}, {kind.klass}, clause {_clause_name(kind.clause)}, requirement {kind.requirement}"
    yield from _wrapped(_sentence(kind.text))
    yield from _wrapped(f"Its offset: {kind.where}.")
    yield f"  {'why':<5}{next(iter(_wrapped(reason['why'], '')))}"
    yield from _wrapped(" ".join(textwrap.wrap(reason["why"], WIDTH, break_on_hyphens=False)[1:]), "       ")
    yield f"  {'how':<5}{next(iter(_wrapped(reason['how'], '')))}"
    yield from _wrapped(" ".join(textwrap.wrap(reason["how"], WIDTH, break_on_hyphens=False)[1:]), "       ")
    yield "  next refcodec inspect FILE --near OFFSET"
    yield ""
    yield from _requirement_lines(kind.requirement)


def _clause_lines(number: str) -> Iterator[str]:
    """A clause: its text, and its requirements."""
    clause = specification.own_clauses()[number]
    yield f"{number} {clause.title}, SPEC.md#{clause.anchor}"
    yield ""
    yield from clause.text.splitlines()
    for name, r in specification.own_requirements().items():
        if r.clause == number:
            yield ""
            yield from _requirement_lines(name)


def _term_lines(term: str, definition: str) -> Iterator[str]:
    """A term of 3.2: its definition, and the clauses of chapters 5 to 9 that use it, with their code."""
    yield f"{term}, a term of clause {_clause_name('3.2')}"
    yield from _wrapped(definition)
    for number, clause in specification.own_clauses().items():
        used = re.search(rf"\b{re.escape(term)}s?\b", f"{clause.title}\n{clause.text}", re.IGNORECASE)
        if number[0] in "56789" and used:
            yield f"  {_clause_name(number)}"
            required = [name for name, r in specification.own_requirements().items() if r.clause == number]
            places = [tuple(place) for name in required for place in _trail()[name]["code"].get("refcodec", [])]
            for path, function in dict.fromkeys(places):
                yield f"  {'':<15} {_place(path, function, '')} {function}"


def _field_lines(table: str, field: str) -> Iterator[str]:
    """The row of a field in its syntax table."""
    kind, words = specification.fields(specification.text())[f"{table}.{field}"]
    yield f"  {kind}, {words} ({table}, {TABLE_CLAUSES[table]})"


def element_lines(path: str) -> Iterator[str]:
    """Yields lines with the meaning and the clauses of an element. Raises KeyError for an unknown path."""
    found = meaning(path)
    yield path
    if found.table:
        yield from _field_lines(found.table, found.field)
    else:
        yield f"  {found.words}"
    yield f"  clauses      {', '.join(_clause_name(number) for number in found.clauses)}"


def requirement_lines(found: Meaning) -> Iterator[str]:
    """Yields lines with the requirements on an element, in words."""
    for i, name in enumerate(found.requirements):
        text = textwrap.wrap(
            f"{name}: {specification.own_requirements()[name].text}", WIDTH - 15, break_on_hyphens=False
        )
        yield f"  {'requirements' if i == 0 else '':<12} {text[0]}"
        yield from (f"  {'':<12} {line}" for line in text[1:])


def _path_lines(path: str) -> Iterator[str]:
    yield from element_lines(path)
    yield f"  requirements {', '.join(meaning(path).requirements)}"
    for name in meaning(path).requirements:
        yield ""
        yield from _requirement_lines(name)


# --- any key ----------------------------------------------------------------------------------------------------------


def _parts(key: str) -> Iterator[Iterator[str]]:
    """Yields the explanations of a key. There can be two: prologue.signature is an error and an element."""
    codes = {str(kind.code): kind for kind in REGISTRY.values()}
    name = key.strip("[]")
    clause = name.removeprefix("Annex ").removeprefix("clause ")
    if key in codes or key in REGISTRY:
        yield _error_lines(codes.get(key) or REGISTRY[key])
    if name in specification.own_requirements():
        yield _requirement_lines(name)
    if clause in specification.own_clauses():
        yield _clause_lines(clause)
    terms, functions = specification.terms(specification.text()), specification.functions(specification.text())
    if key.lower() in terms:
        yield _term_lines(key, terms[key.lower()])
    if key in functions:
        yield _clause_lines(functions[key])
    table, _, field = key.partition(".")
    if key in FIELDS:
        yield _table_field_lines(table, field)
    if is_path(key):
        yield _path_lines(key)


def explain(key: str) -> Iterator[str]:
    """Yields the lines that explain a key. Raises UnknownKeyError."""
    parts = list(_parts(key))
    if not parts:
        raise UnknownKeyError(_unknown(key))
    for i, part in enumerate(parts):
        if i:
            yield ""
        yield from part


def _table_field_lines(table: str, field: str) -> Iterator[str]:
    yield f"{table}.{field}"
    yield from _field_lines(table, field)
    found = of_field(table, field)
    yield f"  clauses      {', '.join(_clause_name(number) for number in found.clauses)}"
    yield from requirement_lines(found)


def _unknown(key: str) -> str:
    known = [
        *map(str, (k.code for k in REGISTRY.values())),
        *REGISTRY,
        *specification.own_requirements(),
        *specification.own_clauses(),
        *FIELDS,
        *specification.terms(specification.text()),
        *specification.functions(specification.text()),
    ]
    near = difflib.get_close_matches(key, known, 3)
    hint = f"; did you mean {', '.join(near)}" if near else ""
    return (
        f"{key} is not an error, requirement, clause, path of an element, term or function of SPEC.md, such as 432, "
        f"R6.10-2, 6.10, frame.low[1], CARM or QUERY{hint}"
    )
