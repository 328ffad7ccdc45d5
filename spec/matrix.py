"""Makes the matrix of requirements, refcodec/data/trail.json: the code, the tests and the vectors of each.

`refcodec explain` prints it. A requirement without code in a decoder, a test or a vector is an error.
"""

import json
from collections.abc import Iterable, Iterator

import msgspec

from conformance.manifest import Manifest, Rejected, load
from refcodec.bitstream.errors import REGISTRY
from refcodec.inspect.specification import own_requirements, requirements, text
from refcodec.inspect.trail import Trail, TrailRecord

from .made import ROOT, Made
from .trail import by_name, trails

# The number of vectors that trail.json lists for a requirement and for a clause, at most.
SHOWN = {"requirements": 12, "clauses": 30}
# Requirements that no single file and result can test, with the reason.
_OF_WRITERS = ("E12.1-1", "E12.1-2", "E12.1-3", "E15.2-1", "E15.2-2", "E15.3-1")
NO_VECTOR = {
    **dict.fromkeys(_OF_WRITERS, "none: runners do not test programs that write"),
    "D10.2-2": "none: a mode of decoding that runners do not use",
    "G6.5-2": "none: images are compared before any conversion",
}


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
    """Returns trail.json, with the places, the number of vectors and the first vectors of each trail.

    Raises SystemExit if there is a hole.
    """
    if missing := holes(kept.requirements):
        raise SystemExit(f"holes in the matrix: {'; '.join(missing)}")
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
    """Yields the file. Raises SystemExit for a hole."""
    suite = load()
    list(vector_lists(suite))
    yield Made.text(ROOT / "refcodec" / "data" / "trail.json", record(trails(requirements(text()), suite)))
