"""Checks refcodec/inspect/meaning.py: what `inspect --near` and `explain` name for each element of a file.

A rule there cites clauses, and requirements on its elements. It must cite each requirement of these clauses, unless the
requirement names only other elements, or an exception here gives a reason. Each requirement of the chapters about files
is cited by a rule.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass

from refcodec.bitstream.syntax import SYNTAX
from refcodec.inspect import meaning
from refcodec.inspect.specification import own_clauses, own_requirements, text, unfolded

# Requirements that a rule need not cite, with the reason.
EXCEPTIONS = {
    "R6.1-1": "no byte that is there violates it; the signature, which may be cut, names it",
    "G6.5-1": "it is about render_model",
    "G6.5-2": "it is about the codes of colours",
    "D7.5.2-1": "the contraction reads no element",
    "D9.3-1": "a digest is of all elements",
}
# The same for a rule of this name, for those that cite this requirement, or for one render model.
OF_RULES = {
    ("LayerModel.exponent", "R6.8-4"): "it is about the exponents of 7.2",
    ("PositionModel.frequency", "R6.10-1"): "it is about the frequencies of the mask model",
    ("R6.8-3", "R6.8-8"): "it is about packed layers, whose values are symbols",
    ("model 0", "R6.8-4"): "the rendering networks of 14.3 are not integer networks",
    ("model 2", "R6.8-4"): "a later version states what the rendering networks of other render models are",
}
# The chapters about files.
_CHAPTERS = re.compile(r"[RDG](?:[5-9]|14)\b")
# What requirements name besides structs.
_FIELDS = {"row", "position", "cell", *(field for fields in SYNTAX.values() for field, _ in fields)}


@dataclass(frozen=True)
class Rule:
    """A rule: the table and the name of its element in requirements, and the clauses and requirements that it cites."""

    name: str
    table: str
    field: str
    cited: list[str]

    def is_named(self, words: set[str]) -> bool:
        """Whether a requirement may be about the element: it does not name only others. words: of the requirement."""
        tables, fields = words & set(SYNTAX), words & _FIELDS
        if self.table and tables and self.table not in tables:
            return False
        return self.field in fields if fields else not tables or self.table in tables


def rules() -> Iterator[Rule]:
    """Yields the rules of meaning.py: fields, payloads, and what is decoded."""
    for name, cited in meaning.FIELDS.items():
        table, field = name.split(".")
        yield Rule(name, table, field, [meaning.TABLE_CLAUSES[table], *cited.split()])
    for payload in meaning.PAYLOADS:
        field = "row" if "R6.8-3" in payload.cited else "position" if payload.pattern.startswith("positions") else ""
        models = [f"model {number}" for number in payload.models] if len(payload.models) == 1 else []
        yield Rule(f"{payload.words}, {payload.pattern}", "", field, [*payload.cited.split(), *models])
    for name, cited in meaning.DECODED.items():
        yield Rule(f"symbols of {name}", "", "cell" if name == "positions" else "", cited.split())


def _words() -> dict[str, set[str]]:
    """Returns the words of each requirement, with its list."""
    items = re.findall(r"^- \[([RDGE][^\]]+)\](.*(?:\n+  .*)*)", unfolded(text()), re.MULTILINE)
    return {name: set(re.findall(r"\w+", sentence)) for name, sentence in items}


def check() -> Iterator[str]:
    """Yields the faults of the rules, and exceptions that no rule needs."""
    words, cited, needed = _words(), set[str](), set[str | tuple[str, str]]()
    for rule in rules():
        cited |= set(rule.cited)
        for wrong in {item for item in rule.cited if " " not in item} - {*own_clauses(), *own_requirements()}:
            yield f"meaning.py: {rule.name}: {wrong} is not in SPEC.md"
        for name, requirement in own_requirements().items():
            missing = requirement.clause in rule.cited and name not in rule.cited and not name.startswith("E")
            # A rule that cites a clause on decoding or drawing cites all of it.
            if missing and (name[0] in "DG" or rule.is_named(words[name])):
                reasons = {(key, name) for key in (rule.name, *rule.cited)} & set(OF_RULES)
                needed |= reasons or {name}
                if not reasons and name not in EXCEPTIONS:
                    yield f"meaning.py: {rule.name}: it cites {requirement.clause}, but not {name}"
    for name in own_requirements():
        if _CHAPTERS.match(name) and name not in cited:
            needed.add(name)
            if name not in EXCEPTIONS:
                yield f"meaning.py: nothing cites {name}"
    for unneeded in {*EXCEPTIONS, *OF_RULES} - needed:
        yield f"meanings.py: no rule needs the exception {unneeded}"
