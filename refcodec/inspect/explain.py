"""Explains a key: an error, a requirement, a clause, a part, element or field of a file, or a name or word of SPEC.md.

The text comes from SPEC.md and the registry of errors. The code of each decoder, the tests and the vectors come from
the trail that `python -m spec` records.
"""

import difflib
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from itertools import islice

import msgspec

from ..bitstream.errors import REGISTRY, ErrorKind
from ..resources import find
from ..statuses import UsageError
from . import specification
from .meaning import FIELDS, PARTS, TABLE_CLAUSES, Meaning, is_path, meaning, of_field
from .specification import own_clauses, own_requirements
from .trail import CodePlace, Trail, record

# Columns of the printed text.
WIDTH = 112
# Packages that use what others define.
_OTHER = ("refcodec/api/", "refcodec/cli/", "refcodec/inspect/", "refcodec/viewer/", "refcodec/export/")
# Of each clause in a list, how many functions and tests are shown, and how many clauses in a list of those with a word.
_PLACES = 4
_CLAUSES = 8
# The chapters and annexes in which words are looked up.
_CHAPTERS = re.compile(r"(?:[5-9]|1[0-4]|[AB])\b")


class UnknownKeyError(UsageError):
    """Nothing is known under a key."""


class Reason(msgspec.Struct):
    """Why there is an error, and how files come to have it."""

    why: str
    how: str


@cache
def reasons() -> dict[str, Reason]:
    """Returns the reasons of the errors, by name."""
    return msgspec.toml.decode(find("data/explanations.toml").read_bytes(), type=dict[str, Reason])


def likely_cause(name: str) -> str:
    """Returns the first sentence of the causes of an error. name: of the error."""
    return reasons()[name].how.partition(". ")[0].rstrip(".") + "."


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


def _wrapped(text: str, label: str = "") -> Iterator[str]:
    """Yields a text in lines, behind a label if there is one."""
    indent = "  " + " " * len(label)
    yield from textwrap.wrap(text, WIDTH, initial_indent=f"  {label}", subsequent_indent=indent, break_on_hyphens=False)


def _clause_name(number: str) -> str:
    return f"{number} {own_clauses()[number].title}"


# --- trails -----------------------------------------------------------------------------------------------------------


def _trail_lines(trail: Trail, error: str = "", most: int = 999) -> Iterator[str]:
    """Yields the code and the tests of a trail. most: of each decoder and of the tests."""
    for title, places in (*trail.code.items(), ("tests", trail.tests)):
        for i, place in enumerate(places[:most]):
            yield f"  {title if i == 0 else '':<15} {_place(place.path, place.name, error)} {place.name}"
        if len(places) > most:
            yield f"  {'':<15} ... and {len(places) - most} more"


def _requirements_of(clause: str) -> list[str]:
    return [name for name, r in own_requirements().items() if r.clause == clause]


def _short_lines(number: str, about: str = "") -> Iterator[str]:
    """Yields a clause with some of its code, tests and vectors: its own, or those of its requirements together.

    about: what the vector that is named should be about, if there is one.
    """
    yield f"  {_clause_name(number)}"
    trails = {name: record().requirements[name] for name in _requirements_of(number)}
    if number in record().clauses:
        trails |= {"": record().clauses[number]}
    code: dict[str, list[CodePlace]] = {}
    for decoder in dict.fromkeys(decoder for trail in trails.values() for decoder in trail.code):
        places = dict.fromkeys(place for trail in trails.values() for place in trail.code.get(decoder, []))
        # The files with the most such functions are about the clause.
        files = Counter(place.path for place in places)
        ordered = sorted(places, key=lambda place: (place.path.startswith(_OTHER), -files[place.path]))
        first = [p for i, p in enumerate(ordered) if sum(q.path == p.path for q in ordered[:i]) < _PLACES - 1]
        code[decoder] = list(dict.fromkeys([*first, *ordered]))
    tests = list(dict.fromkeys(place for trail in trails.values() for place in trail.tests))
    yield from _trail_lines(Trail(code, tests, 0, []), most=_PLACES)
    name, most = max(trails.items(), key=lambda item: item[1].count, default=("", None))
    if most and most.count:
        example = min([v for v in most.vectors if about.replace("_", "-") in v] or most.vectors[:1], key=len)
        yield f"  {'vectors':<15} {most.count}{f' of {name}' if name else ''}, such as {example}"


def _requirement_lines(name: str) -> Iterator[str]:
    """Yields a requirement, its error, code, tests and vectors."""
    r, trail = own_requirements()[name], record().requirements[name]
    whose = {"R": "files", "D": "decoders", "G": "renderers", "E": "encoders and editors"}[name[0]]
    yield f"{name}, a requirement on {whose}, clause {_clause_name(r.clause)}"
    yield from _wrapped(f"{r.text}.")
    if r.error:
        yield f"  a file that violates it: error {REGISTRY[r.error].code} {r.error}"
    yield from _trail_lines(trail, r.error)
    yield f"  {'vectors':<15} {trail.count}"
    yield from (f"  {'':<15} {vector}" for vector in trail.vectors)
    if trail.count > len(trail.vectors):
        yield f"  {'':<15} ... all of them: conformance run --select requirement:{name} -- YOUR DECODER"


# --- one kind of key each ---------------------------------------------------------------------------------------------


def _error_lines(kind: ErrorKind) -> Iterator[str]:
    """Yields an error: its meaning, why there is the rule, how files come to break it, and its requirement."""
    reason = reasons()[kind.name]
    yield f"{kind.code} {kind.name}, {kind.klass}, clause {_clause_name(kind.clause)}, requirement {kind.requirement}"
    yield from _wrapped(f"{kind.text[0].upper()}{kind.text[1:]}.")
    yield from _wrapped(f"Its offset: {kind.where}.")
    yield from _wrapped(reason.why, "why  ")
    yield from _wrapped(reason.how, "how  ")
    yield "  next refcodec inspect FILE --near OFFSET"
    yield ""
    yield from _requirement_lines(kind.requirement)


def _clause_lines(number: str) -> Iterator[str]:
    """Yields a clause: its text, its requirements, and otherwise its own trail."""
    clause = own_clauses()[number]
    yield f"{number} {clause.title}, SPEC.md#{clause.anchor}"
    if clause.text:
        yield ""
        yield from clause.text.splitlines()
    for name in _requirements_of(number):
        yield ""
        yield from _requirement_lines(name)
    if number in record().clauses:
        yield ""
        # Without the name of the clause.
        yield from islice(_short_lines(number), 1, None)


def _part_lines(name: str) -> Iterator[str]:
    """Yields a part of a file: the clauses about it."""
    kind, clauses = PARTS[name]
    yield f"{name}, {f'the section {kind}' if kind else 'a part of a file'}"
    for number in clauses.split():
        yield from _short_lines(number)


def _word_lines(key: str, definition: str = "") -> Iterator[str]:
    """Yields the clauses that have each of some words, or another term of its definition: first those about them."""
    terms, words = specification.terms(specification.text()), key.lower().split()
    alike = [[term for term, text in terms.items() if text == terms.get(word)] or [word] for word in words]
    patterns = [re.compile(rf"\b(?:{'|'.join(map(re.escape, some))})s?\b", re.IGNORECASE) for some in alike]
    scores = {}
    for number, clause in own_clauses().items():
        met = [(bool(p.search(clause.title)), len(p.findall(clause.text))) for p in patterns]
        if _CHAPTERS.match(number) and all(map(any, met)):
            scores[number] = sum(title for title, _ in met), min(count for _, count in met)
    listed = sorted(scores, key=scores.__getitem__, reverse=True)
    if listed or definition:
        yield f"{key}, a term of clause {_clause_name('3.2')}" if definition else f"{key}, in these clauses"
        yield from _wrapped(definition)
    for number in listed[:_CLAUSES]:
        yield from _short_lines(number)
    if listed[_CLAUSES:]:
        yield from _wrapped(f"and in {', '.join(listed[_CLAUSES:])}")


def _field_line(name: str) -> str:
    """Returns the row of a field in its syntax table."""
    table = name.partition(".")[0]
    kind, words = specification.fields(specification.text())[name]
    return f"  {kind}, {words} ({table}, {TABLE_CLAUSES[table]})"


def element_lines(path: str, element: Meaning) -> Iterator[str]:
    """Yields lines with the meaning and the clauses of an element. element: its meaning."""
    yield path
    yield _field_line(f"{element.table}.{element.field}") if element.table else f"  {element.words}"
    yield f"  clauses      {', '.join(map(_clause_name, element.clauses))}"


def requirement_lines(element: Meaning) -> Iterator[str]:
    """Yields lines with the requirements on an element, in words."""
    for i, name in enumerate(element.requirements):
        yield from _wrapped(f"{name}: {own_requirements()[name].text}", f"{'' if i else 'requirements':<13}")


def _element_lines(path: str, element: Meaning) -> Iterator[str]:
    """Yields an element, the trails of its requirements, and those of its clauses without requirements."""
    yield from element_lines(path, element)
    yield f"  requirements {', '.join(element.requirements)}"
    for number in element.clauses:
        if number in record().clauses:
            yield ""
            yield from _short_lines(number, element.field)
    for name in element.requirements:
        yield ""
        yield from _requirement_lines(name)


def _fields_lines(names: list[str]) -> Iterator[str]:
    """Yields the field of this name, or the fields of several tables, each with the key of its explanation."""
    if len(names) == 1:
        yield from _element_lines(names[0], of_field(*names[0].split(".")))
        return
    yield f"{names[0].partition('.')[2]}, a field of {len(names)} tables"
    for name in names:
        yield f"refcodec explain {name}"
        yield _field_line(name)


def _constant_lines(name: str) -> Iterator[str]:
    value, clause, words = specification.constants(specification.text())[name]
    yield f"{name} = {value}, {words} ({clause}), a constant of clause {_clause_name('2.5')}"
    yield from list(_word_lines(name))[1:]


# --- any key ----------------------------------------------------------------------------------------------------------


def _loose(name: str) -> str:
    return re.sub(r"[\W_]", "", name).lower()


@cache
def _exact() -> Mapping[str, Callable[[], Iterator[str]]]:
    """Returns what is explained by its exact name, except errors, terms and paths."""
    text = specification.text()
    exact: dict[str, Callable[[], Iterator[str]]] = {}
    for name in own_requirements():
        exact[name] = exact[f"[{name}]"] = partial(_requirement_lines, name)
    for number in own_clauses():
        for form in (number, f"clause {number}", f"chapter {number}", f"Annex {number}"):
            exact[form] = partial(_clause_lines, number)
    for name, number in (*specification.functions(text).items(), *TABLE_CLAUSES.items()):
        exact[name] = partial(_clause_lines, number)
    for name in specification.constants(text):
        exact[name] = partial(_constant_lines, name)
    for name, (kind, _) in PARTS.items():
        exact[name] = partial(_part_lines, name)
        exact |= {kind: exact[name]} if kind else {}
    return exact


@cache
def _fields() -> dict[str, list[str]]:
    """Returns the fields of all tables by their names, alone and with their tables."""
    fields: dict[str, list[str]] = {}
    for name in FIELDS:
        for form in (name, name.partition(".")[2]):
            fields.setdefault(form, []).append(name)
    return fields


def _explanations(key: str) -> list[Iterator[str]]:
    """Returns the explanations of a key. There can be several: prologue.signature is an error and an element."""
    codes = {str(kind.code): kind for kind in REGISTRY.values()}
    terms = specification.terms(specification.text())
    parts = []
    if key in codes or key in REGISTRY:
        parts.append(_error_lines(codes.get(key) or REGISTRY[key]))
    if key in _exact():
        parts.append(_exact()[key]())
    if key.lower() in terms:
        parts.append(_word_lines(key, terms[key.lower()]))
    if key in _fields():
        parts.append(_fields_lines(_fields()[key]))
    elif is_path(key):
        parts.append(_element_lines(key, meaning(key)))
    alike = next((names for name, names in _fields().items() if not parts and _loose(name) == _loose(key)), None)
    return [_fields_lines(alike)] if alike else parts


def explain(*keys: str) -> Iterator[str]:
    """Yields the lines that explain keys. Words that are not keys are looked up together. Raises UnknownKeyError."""
    known = {key: _explanations(key) for key in keys}
    phrase = " ".join(keys)
    together = _explanations(phrase) if len(keys) > 1 else []
    if together:
        known = {phrase: together}
    elif not all(known.values()) and re.fullmatch(r"[A-Za-z][\w -]*", phrase):
        words = [*_word_lines(phrase)]
        known = {phrase: [iter(words)]} if words else known
    for i, (key, parts) in enumerate(known.items()):
        if not parts:
            raise UnknownKeyError(_unknown(key))
        for j, part in enumerate(parts):
            yield from [""] if i or j else []
            yield from part


def _unknown(key: str) -> str:
    known = {str(kind.code) for kind in REGISTRY.values()}
    known = known.union(REGISTRY, _exact(), _fields(), specification.terms(specification.text()))
    near = difflib.get_close_matches(key, sorted(known), 3)
    hint = f"; did you mean {', '.join(near)}" if near else ""
    return (
        f"{key} is not an error, requirement, clause, path of an element, field, name or word of SPEC.md, such as 432, "
        f"R6.10-2, 6.10, frame.low[1], low_pass, CARM or QUERY{hint}"
    )
