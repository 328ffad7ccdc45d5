"""Makes the matrix of requirements.

conformance/REQUIREMENTS.md    the code, the tests and the number of vectors of each requirement
conformance/VECTORS.md         the vectors of each requirement, error code, feature and flag
refcodec/data/trail.json       the code, the tests and the vectors of each requirement, for `refcodec explain`
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import astuple

from conformance.manifest import Manifest, Rejected, load
from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect.specification import anchor, clauses, requirements, text

from .made import ROOT, Made
from .trail import DECODERS, Place, Trail, by_name, trails

FOLDER = ROOT / "conformance"
HEAD = f"""# Requirements

Each requirement of [SPEC.md](../SPEC.md) with the code that meets it in each decoder, the tests that prove it, and the
[vectors](../vectors/README.md) that try it. `python -m spec` writes this page. `refcodec explain R6.10-2` prints the
same of one requirement.

`test_fault[...]` stands for generated files with that one fault. The decoders must refuse them with its code and
offset.

| requirement | what | {" | ".join(DECODERS)} | tests | vectors |
|{"---|" * (len(DECODERS) + 4)}
"""
VECTORS_HEAD = """# Vectors by what they are for

The [vectors](../vectors/README.md) of each requirement, error code, feature and flag. `python -m spec` writes this
page. `conformance run --select requirement:R6.10-2 -- ...` runs the vectors of one requirement.
"""
# The requirements that no file and its one result can show, and why.
NO_VECTOR = {
    "D10.2-2": "none: a mode of decoding that a runner does not ask for",
    "G14.5-1": "none: a runner does not compare images",
}


def _link(place: Place) -> str:
    """Returns a link to a place that works on a code host."""
    file = place.path.rpartition("/")[2].removesuffix(".py")
    return f"[{file}.{place.name}](../{place.path}#L{place.line})".replace("decoder.c.", "")


def holes(found: dict[str, Trail]) -> list[str]:
    """Returns in words which requirement has no code in a decoder, no test, or no vector.

    A requirement of NO_VECTOR must have none.
    """
    missing = []
    for name, trail in found.items():
        missing += [f"{name} has no code in {decoder}" for decoder, places in trail.code.items() if not places]
        missing += [f"{name} has no test"] if not trail.tests else []
        if bool(trail.vectors) == (name in NO_VECTOR):
            missing.append(f"{name} has a vector" if trail.vectors else f"{name} has no vector")
    return missing


def document(spec: str, found: dict[str, Trail]) -> str:
    """Returns REQUIREMENTS.md. spec: SPEC.md. Raises SystemExit if there is a hole."""
    if missing := holes(found):
        raise SystemExit(f"holes in the matrix: {'; '.join(missing)}")
    known, rows = clauses(spec), []
    for name, trail in found.items():
        clause = known[trail.requirement.clause]
        cells = [f"[{name}](../SPEC.md#{clause.anchor})", trail.requirement.text]
        cells += ["<br>".join(map(_link, trail.code[d])) if d in trail.code else "-" for d in DECODERS]
        cells.append("<br>".join(map(_link, trail.tests)))
        count = f"[{len(trail.vectors)}](VECTORS.md#{anchor(name)})"
        cells.append(NO_VECTOR.get(name, count))
        rows.append(f"| {' | '.join(cells)} |")
    share = f"{len(found) - len(NO_VECTOR)} of {len(found)} requirements have a vector."
    return HEAD + "\n".join(rows) + f"\n\n{share} No file and its one result can show the other {len(NO_VECTOR)}.\n"


def vector_lists(suite: Manifest, found: dict[str, Trail]) -> str:
    """Returns VECTORS.md. Raises SystemExit for an error code, a feature or a flag without a vector."""
    paths = {v.id: v.input.path for v in suite.vectors}
    refused = by_name(suite, lambda v: [v.expectation.name] if isinstance(v.expectation, Rejected) else [])
    having, catching = by_name(suite, lambda v: v.features), by_name(suite, lambda v: v.flags)
    groups: list[tuple[str, dict[str, tuple[str, list[str]]]]] = [
        ("Requirements", {name: (trail.requirement.text, trail.vectors) for name, trail in found.items()}),
        ("Error codes", {f"{k.code} {k.name}": (f"{k.text} ({k.clause})", refused[k.name]) for k in REGISTRY.values()}),
        ("Features", {name: (what, having[name]) for name, what in suite.features.items()}),
        ("Flags", {name: (what, catching[name]) for name, what in suite.flags.items()}),
    ]
    lines = [VECTORS_HEAD]
    for title, entries in groups:
        lines.append(f"## {title}\n")
        for name, (what, vectors) in entries.items():
            if not vectors and name not in NO_VECTOR:
                raise SystemExit(f"without a vector: {name}")
            links = ", ".join(f"[{v}](../vectors/{paths[v]})" for v in vectors)
            lines.append(f"### {name}\n\n{what}\n\n{len(vectors)}: {links or 'none'}\n")
    return "\n".join(lines)


def record(found: dict[str, Trail]) -> str:
    """Returns trail.json, with the places and the vectors of each requirement."""
    entries = {
        name: {
            "code": {decoder: [astuple(p) for p in places] for decoder, places in trail.code.items()},
            "tests": [astuple(p) for p in trail.tests],
            "vectors": trail.vectors,
        }
        for name, trail in found.items()
    }
    lines = [f" {json.dumps(name)}: {json.dumps(entry)}" for name, entry in entries.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def made() -> Iterator[Made]:
    """Yields the three files."""
    spec, suite = text(), load()
    found = trails(requirements(spec), suite)
    yield Made.text(FOLDER / "REQUIREMENTS.md", document(spec, found))
    yield Made.text(FOLDER / "VECTORS.md", vector_lists(suite, found))
    yield Made.text(ROOT / "refcodec" / "data" / "trail.json", record(found))
