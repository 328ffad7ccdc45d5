"""Checks the citations of SPEC.md in code, tests and texts.

A citation names clauses, requirements, steps of 10.1 and functions of the clause's block: `SPEC 7.5, [R6.7-2]`,
`10.1, CHUNKS`, `SPEC 9.1, WORLD`. Each of them must exist. Code must also share a word with what it cites: the function
around the citation has a word of the requirement, or of the names in the clause's title, tables, rules and block.
Clauses without such names are not compared. A paragraph, in code and in texts, that names a whole chapter or annex must
share a word with its headings, first paragraphs or bold leads.
"""

import ast
import itertools
import re
import subprocess
from collections.abc import Iterator
from functools import cache

from refcodec.inspect.specification import own_clauses, own_requirements, text, unfolded

from .made import ROOT

_CLAUSE = r"(?:\d+|[A-H])(?:\.\d+)*(?![\w-])"
_REQUIREMENT = r"\[?[RDGE](?:\d+|[A-H])(?:\.\d+)*-\d+\]?"
_ITEM = rf"(?:{_REQUIREMENT}|{_CLAUSE}|[A-Z][A-Z0-9_]{{2,}}\b)"
_ITEMS = rf"{_ITEM}(?:(?:, | and | to |; ){_ITEM})*"
_KIND = r"(?:[Cc]lauses?|[Cc]hapters?|Annex(?:es)?) "
# Python and texts name SPEC.md, or a kind of place. A comment in C or JavaScript begins with the number.
_CITATION = re.compile(rf"(?:SPEC(?:\.md)? |(?<!\w){_KIND}|(?:^|\s)(?:/\*|//) (?=\d+\.|\[))(?:{_KIND})?({_ITEMS})")
# Clauses of other documents.
_OTHERS = re.compile(r"\b(?:RFC \d+|ITU-T \S+(?: \([\d/]+\))?|SPDX [^,]*), (?:clause|chapter|Annex) [\dA-H.]+")
_MARK = re.compile(r"(\[[RDGE](?:\d+|[A-H])(?:\.\d+)*-\d+\])")
# Files about wrong citations.
_LEFT_OUT = ("tests/", "conformance/mutants/")
# Chapters with clauses on specific parts of a file or of the decoding process.
_COMPARED = ("5.", "6.", "7.", "8.", "9.", "11.", "14.")
# Words without information on the subject.
_COMMON = set(
    re.findall(
        r"\w+",
        "the and that for with are not from all each other which this these its has have than only least most any one "
        "two three before after between whose none true false return def self int value number length size byte bit "
        "first last order list item name field rule must satisfy checked checks check file supported error code "
        "spec annex clause chapter",
    )
)


def words(prose: str) -> set[str]:
    """Returns the words of a text and of the names in it, in lower case and without a plural s, except common ones."""
    parts = {part.lower() for part in re.findall(r"[A-Z]?[a-z]{2,}|[A-Z]{3,}", prose) if len(part) > 2}
    return {part.removesuffix("s") if len(part) > 3 else part for part in parts} - _COMMON


@cache
def _clause_words(number: str) -> set[str]:
    """Returns the words of the names that a clause defines or uses, or nothing if the clause is not compared."""
    clause = own_clauses()[number]
    # A clause with a table or a block defines names. Without them it is too general to compare.
    defines = re.search(r"^```|^\| (\w+) \|", clause.text, re.MULTILINE)
    return words(f"{clause.title} {clause.text}") if defines and number.startswith(_COMPARED) else set()


def _stems(prose: str) -> set[str]:
    return {word[:6] for word in words(prose)}


@cache
def _subjects(chapter: str) -> set[str]:
    """Returns the stems of the headings of a chapter or an annex, of its first paragraphs and of its bold leads."""
    own = {number: c for number, c in own_clauses().items() if number == chapter or number.startswith(f"{chapter}.")}
    leads = [lead for clause in own.values() for lead in (clause.title, *re.findall(r"\*\*(.+?)\*\*", clause.text))]
    return _stems(" ".join([own[chapter].text, *leads]))


@cache
def _requirement_words(name: str) -> set[str]:
    """Returns the words of a requirement, with its list and its error."""
    sentence = re.search(rf"^- \[{name}\](.*)", unfolded(text()), re.MULTILINE)
    return words(sentence[1]) if sentence else set()


@cache
def steps() -> dict[str, set[str]]:
    """Returns the steps of 10.1 in order, each with the words of its requirements' errors."""
    steps_of: dict[str, set[str]] = {}
    for name, sentence in re.findall(r"^- ([A-Z]+)\b(.*?)(?=^- [A-Z]|^Each )", own_clauses()["10.1"].text, re.S | re.M):
        own = [own_requirements()[r].error.partition(".")[0] for r in re.findall(r"R[\d.]+-\d+", sentence)]
        # The CRC-32 of DATA and the place of a chunk are rules on sections, but CHUNKS is not about sections.
        steps_of[name] = words(" ".join([name, *own])) - ({"section"} if name == "CHUNKS" else set())
    return steps_of


def _python_unit(source: str) -> Iterator[tuple[int, int]]:
    """Yields the range of lines of each function and class, with the comments above it."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            first = node.lineno - 1
            while first > 0 and re.match(r"\s*[#@]", lines[first - 1]):
                first -= 1
            yield first, node.end_lineno or first


def _units(path: str, source: str) -> list[str]:
    """Returns for each line the text to compare with its citations.

    In Python it is the innermost function or class, otherwise the lines around it up to an empty one.
    """
    lines = source.splitlines()
    units = []
    for block in re.split(r"(?<=\n)(?=\n)", source + "\n"):
        units += [block] * block.count("\n")
    if path.endswith(".py"):
        # Outer functions come before inner ones.
        for first, end in sorted(_python_unit(source), key=lambda span: (span[0], -span[1])):
            units[first:end] = ["\n".join(lines[first:end])] * (end - first)
        docstring = ast.get_docstring(ast.parse(source), clean=False)
        if docstring:
            units[: docstring.count("\n") + 1] = [source] * (docstring.count("\n") + 1)
    return units


def _expanded(items: str) -> Iterator[str]:
    """Yields the items of a citation and of its ranges, such as `[R6.6-6] to [R6.6-8]` for a section."""
    known = [*own_clauses()], [*own_requirements()], [*steps()]
    for range_ in re.split(r", | and |; ", items):
        first, *last = (item.strip("[]") for item in range_.split(" to "))
        yield first
        for end in last:
            for names in known:
                if first in names and end in names:
                    yield from names[names.index(first) + 1 : names.index(end)]
            yield end


def _wrong(item: str, clause: str) -> str:
    """Returns why an item of a citation does not exist, or "". clause: the previous one in the citation."""
    if re.fullmatch(_CLAUSE, item):
        return "" if item in own_clauses() else "is not a clause of SPEC.md"
    if re.fullmatch(_REQUIREMENT, item):
        return "" if item in own_requirements() else "is not a requirement of SPEC.md"
    if clause == "10.1":
        return "" if item in steps() else "is not a step of 10.1"
    # A name after a clause is a function of its block. Other words in capitals are not citations.
    known = clause not in own_clauses() or re.search(rf"\b{item}\b", own_clauses()[clause].text)
    return "" if known else f"is not a name of {clause}"


def _wanted(item: str) -> set[str]:
    """Returns the words of an item, of which citing code must have one. The empty set: it is not compared."""
    if item in own_clauses():
        return _clause_words(item)
    return _requirement_words(item) if item in own_requirements() else steps().get(item, set())


def _paragraph(lines: list[str], number: int) -> str:
    """Returns the comment, or else the lines up to empty ones, around a line."""
    comment = lines[number].lstrip().startswith("#")

    def belongs(line: str) -> bool:
        return line.lstrip().startswith("#") if comment else bool(line.strip())

    above, below = itertools.takewhile(belongs, lines[number - 1 :: -1] if number else []), lines[number + 1 :]
    return "\n".join([*above, lines[number], *itertools.takewhile(belongs, below)])


def _off_subject(items: str, paragraph: str) -> bool:
    """Whether a paragraph cites one whole chapter or annex, says something, and shares no word with it."""
    own = _stems(paragraph.replace(items, ""))
    return items in own_clauses() and "." not in items and len(own) > 1 and not own & _subjects(items)


def faults(path: str, source: str, *, compare: bool = True) -> Iterator[str]:
    """Yields the faults of the citations of a file. compare: also whether they share words with the code."""
    lines = source.splitlines()
    units = _units(path, source) if compare else lines
    for number, line in enumerate(_OTHERS.sub("", line) for line in lines):
        for match in re.finditer(r"\b10\.1,? (?:in )?steps? \d", line):
            yield f"{path}:{number + 1}: {match[0]}: the steps of 10.1 have names"
        matches = {match.end(): match for match in (*_MARK.finditer(line), *_CITATION.finditer(line))}
        for match in matches.values():
            own = set[str]()
            if compare and units[number].strip() != line.strip():
                own = words(f"{units[number].replace(match[0], '')} {path.rpartition('/')[2]}")
            if path != "SPEC.md" and _off_subject(match[1], _paragraph(lines, number)):
                yield f"{path}:{number + 1}: {match[1]} is not about this text"
            clause, items = "", list(_expanded(match[1]))
            # A range is compared as a whole.
            whole = set().union(*map(_wanted, items)) if " to " in match[1] else set()
            for item in items:
                fault = _wrong(item, clause)
                clause = item if re.fullmatch(_CLAUSE, item) else clause
                wanted = set() if fault or not own else whole or _wanted(item)
                if wanted and not wanted & own:
                    fault = "is not about this code"
                if fault:
                    yield f"{path}:{number + 1}: {item} {fault}"


def check() -> list[str]:
    """Returns the faults of the citations in all files of the repository except tests, which also cite wrongly."""
    all_faults: list[str] = []
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    for name in names:
        if (
            name.endswith((".py", ".c", ".h", ".js", ".md"))
            and not name.startswith(_LEFT_OUT)
            and (ROOT / name).exists()
        ):
            all_faults += faults(name, (ROOT / name).read_text(encoding="utf-8"), compare=not name.endswith(".md"))
    return all_faults
