"""The trail of SPEC.md: the code, the tests and the vectors of its requirements and clauses.

`python -m spec` records it (spec/trail.py).
"""

from functools import cache

import msgspec

from ..resources import find


class CodePlace(msgspec.Struct, frozen=True, order=True, array_like=True):
    """A function, a class or a test. path: of its file in the repository."""

    path: str
    name: str


class Trail(msgspec.Struct):
    """A trail. code: by decoder. count: the number of vectors. vectors: the ids of some of them."""

    code: dict[str, list[CodePlace]]
    tests: list[CodePlace]
    count: int
    vectors: list[str]


class TrailRecord(msgspec.Struct):
    """The trails of the requirements by identifier, and of the clauses without requirements by number."""

    requirements: dict[str, Trail]
    clauses: dict[str, Trail]


@cache
def record() -> TrailRecord:
    """Returns the record that came with the program."""
    return msgspec.json.decode(find("data/trail.json").read_bytes(), type=TrailRecord)
