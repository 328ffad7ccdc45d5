"""Makes the matrix of requirements.

conformance/REQUIREMENTS.md    the code, the tests and the number of vectors of each requirement
refcodec/data/trail.json       the code, the tests and vectors of each requirement, for `refcodec explain`
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator

import msgspec

from conformance.manifest import Manifest, Rejected, load
from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect.specification import clauses, own_requirements, requirements, text
from refcodec.inspect.trail import CodePlace, Trail, TrailRecord

from .made import ROOT, Made
from .trail import DECODERS, by_name, trails

FOLDER = ROOT / "conformance"
HEAD = f"""# Requirements

The table lists each requirement of [SPEC.md](../SPEC.md), the code for it in each decoder, its tests, and the number
of its [vectors](../vectors/README.md). `python -m spec` generates this page. `refcodec explain R6.10-2` prints the
same for one requirement, with lines, and `python -m spec --vectors` all vectors of each requirement, code, feature
and flag.

`test_fault[...]` tests generated files with that fault. The decoders must refuse them with its code and offset.

| requirement | what | {" | ".join(DECODERS)} | tests | vectors |
|{"---|" * (len(DECODERS) + 4)}
"""
# The number of vectors that trail.json lists for a requirement and for a clause, at most.
SHOWN = {"requirements": 12, "clauses": 30}
# Requirements that no single file and result can test, with the reason.
NO_VECTOR = {
    **dict.fromkeys(
        ("E12.1-1", "E12.1-2", "E12.1-3", "E15.2-1", "E15.2-2", "E15.3-1"),
        "none: runners do not test programs that write",
    ),
    "D10.2-2": "none: a mode of decoding that runners do not use",
    "G14.5-1": "none: runners do not compare images",
}


def _link(place: CodePlace) -> str:
    """Returns a link to a place that works on a code host."""
    file = place.path.rpartition("/")[2].removesuffix(".py")
    return f"[{file}.{place.name}](../{place.path})".replace("decoder.c.", "")


def holes(by_requirement: dict[str, Trail]) -> list[str]:
    """Returns messages on requirements without code in a decoder, a test, or a vector.

    A requirement of NO_VECTOR must have no vector.
    """
    missing = []
    for name, trail in by_requirement.items():
        missing += [f"{name} has no code in {decoder}" for decoder, places in trail.code.items() if not places]
        missing += [f"{name} has no test"] if not trail.tests else []
        if bool(trail.vectors) == (name in NO_VECTOR):
            missing.append(f"{name} has a vector" if trail.vectors else f"{name} has no vector")
    return missing


def document(spec: str, by_requirement: dict[str, Trail]) -> str:
    """Returns REQUIREMENTS.md. spec: SPEC.md. Raises SystemExit if there is a hole."""
    if missing := holes(by_requirement):
        raise SystemExit(f"holes in the matrix: {'; '.join(missing)}")
    known, rows = clauses(spec), []
    for name, r in requirements(spec).items():
        trail = by_requirement[name]
        cells = [f"[{name}](../SPEC.md#{known[r.clause].anchor})", r.text]
        cells += ["<br>".join(map(_link, trail.code[d])) if d in trail.code else "-" for d in DECODERS]
        cells.append("<br>".join(map(_link, trail.tests)))
        cells.append(NO_VECTOR.get(name, str(len(trail.vectors))))
        rows.append(f"| {' | '.join(cells)} |")
    share = f"{len(by_requirement) - len(NO_VECTOR)} of {len(by_requirement)} requirements have a vector."
    return HEAD + "\n".join(rows) + f"\n\n{share} No single file and result can test the other {len(NO_VECTOR)}.\n"


def vector_lists(suite: Manifest) -> Iterator[str]:
    """Yields a line for each term of `conformance run --select`: the term, a tab, and the ids of its vectors.

    Raises SystemExit for an error code, a feature or a flag without a vector.
    """
    refused = by_name(suite, lambda v: [v.expectation.name] if isinstance(v.expectation, Rejected) else [])
    terms: dict[str, tuple[Iterable[str], dict[str, list[str]]]] = {
        "requirement": (own_requirements(), by_name(suite, lambda v: v.requirements)),
        "code": ({str(k.code): k for k in REGISTRY.values()}, {str(REGISTRY[e].code): v for e, v in refused.items()}),
        "feature": (suite.features, by_name(suite, lambda v: v.features)),
        "flag": (suite.flags, by_name(suite, lambda v: v.flags)),
    }
    for term, (names, vectors) in terms.items():
        for name in names:
            if name not in vectors and name not in NO_VECTOR:
                raise SystemExit(f"without a vector: {name}")
            yield f"{term}:{name}\t{' '.join(vectors.get(name, []))}"


def record(kept: TrailRecord) -> str:
    """Returns trail.json, with the places, the number of vectors and the first vectors of each trail."""
    parts = []
    for part, trails_of in msgspec.structs.asdict(kept).items():
        cut = {
            name: msgspec.structs.replace(trail, vectors=trail.vectors[: SHOWN[part]])
            for name, trail in trails_of.items()
        }
        lines = [f"  {json.dumps(name)}: {msgspec.json.encode(trail).decode()}" for name, trail in cut.items()]
        parts.append(f' "{part}": {{\n' + ",\n".join(lines) + "\n }")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def made() -> Iterator[Made]:
    """Yields both files. Raises SystemExit for a hole."""
    spec, suite = text(), load()
    every = trails(requirements(spec), suite)
    list(vector_lists(suite))
    yield Made.text(FOLDER / "REQUIREMENTS.md", document(spec, every.requirements))
    yield Made.text(ROOT / "refcodec" / "data" / "trail.json", record(every))
