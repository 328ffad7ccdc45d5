"""The clauses, syntax tables and requirements of SPEC.md, for programs that explain them."""

import re
from dataclasses import dataclass
from functools import cache

from ..resources import find

# The number of a clause, such as 6.10, 7.5.4 or B.2. The annexes have letters.
CLAUSE = r"(?:\d+|[A-H])(?:\.\d+)*"


@dataclass(frozen=True)
class Clause:
    """A clause. text: its own Markdown, without that of its subclauses. anchor: the anchor of its heading in links."""

    number: str
    title: str
    text: str
    anchor: str


@dataclass(frozen=True)
class Requirement:
    """A requirement. text: its sentence, without the error and the final period. error: its error name, or empty."""

    id: str
    clause: str
    text: str
    error: str


@cache
def text() -> str:
    """Returns SPEC.md, from the checkout or the installed package."""
    return find("SPEC.md").read_text(encoding="utf-8")


def anchor(heading: str) -> str:
    """Returns the anchor that code hosts give a heading."""
    return re.sub(r"[^a-z0-9 _-]", "", heading.lower()).replace(" ", "-")


@cache
def clauses(spec: str) -> dict[str, Clause]:
    """Returns the clauses by number, in the order of SPEC.md."""
    # A line that begins with # in a code block is a Python comment, not a heading.
    bare = re.sub(r"^```.*?^```", lambda block: re.sub(r"^#", " ", block[0], flags=re.M), spec, flags=re.S | re.M)
    heads = list(re.finditer(rf"^#{{2,4}} ((?:Annex )?({CLAUSE}):? (.*))$", bare, re.MULTILINE))
    listed = {}
    for head, after in zip(heads, [*heads[1:], None], strict=True):
        end = after.start() if after else len(spec)
        title = head[3].removesuffix(" (normative)").removesuffix(" (informative)")
        listed[head[2]] = Clause(head[2], title, spec[head.end() : end].strip(), anchor(head[1]))
    return listed


@cache
def fields(spec: str) -> dict[str, tuple[str, str]]:
    """Returns (type, meaning) of each field of the syntax tables of chapter 5, by table.field."""
    listed = {}
    for clause in clauses(spec).values():
        if clause.number.startswith("5."):
            for field, kind, words in re.findall(r"^\| (\w+) \| ([^|]+) \| ([^|]*) \|$", clause.text, re.MULTILINE):
                listed[f"{clause.title}.{field}"] = kind, words
    return listed


def unfolded(spec: str) -> str:
    """Returns SPEC.md with each requirement in one line."""
    return re.sub(r"^- \[[RDGE].*(?:\n  \S.*)+", lambda item: item[0].replace("\n ", ""), spec, flags=re.MULTILINE)


@cache
def requirements(spec: str) -> dict[str, Requirement]:
    """Returns the requirements by identifier, in the order of SPEC.md."""
    pattern = rf"^- \[([RDGE]({CLAUSE})-\d+)\] (.*)$"
    listed = {}
    for name, clause, sentence in re.findall(pattern, unfolded(spec), re.MULTILINE):
        error = re.search(r" \(`([a-z_.]+)`\)", sentence)
        words = sentence[: error.start()] if error else sentence.rstrip(".")
        listed[name] = Requirement(name, clause, words, error[1] if error and name.startswith("R") else "")
    return listed


@cache
def terms(spec: str) -> dict[str, str]:
    """Returns the definitions of clause 3.2 by term, in small letters. A definition may have several terms."""
    items = re.findall(r"^- (\*\*.*(?:\n  .*)*)", clauses(spec)["3.2"].text, re.MULTILINE)
    return {
        term.lower(): re.sub(r"\s+", " ", item.replace("**", ""))
        for item in items
        for term in re.findall(r"\*\*([^*]+)\*\*", item)
    }


@cache
def functions(spec: str) -> dict[str, str]:
    """Returns the clause of each function of the blocks of SPEC.md, by name."""
    return {name: c.number for c in clauses(spec).values() for name in re.findall(r"^def (\w+)", c.text, re.MULTILINE)}


@cache
def constants(spec: str) -> dict[str, tuple[str, str, str]]:
    """Returns (value, clause, meaning) of each constant of clause 2.5, by name."""
    rows = re.findall(r"^\| ([A-Z][A-Z0-9_]+) \| (.+?) \| (.+?) \| (.+?) \|$", clauses(spec)["2.5"].text, re.MULTILINE)
    return {name: (value, clause, words) for name, value, clause, words in rows}


@cache
def own_clauses() -> dict[str, Clause]:
    """Returns the clauses of the SPEC.md that came with the program, by number."""
    return clauses(text())


@cache
def own_requirements() -> dict[str, Requirement]:
    """Returns the requirements of the SPEC.md that came with the program, by identifier."""
    return requirements(text())


def clause_of(requirement: str) -> str:
    """Returns the clause of a requirement, such as 7.5.5 of D7.5.5-1."""
    return requirement[1:].rpartition("-")[0]
