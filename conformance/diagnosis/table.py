"""The table of fingerprints: what each planted bug does to each vector, and what code each vector runs.

The file is one stream of LZMA: a head in JSON, then arrays of little-endian integers, column by column, so that what is
alike lies together.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.files.documents import DocumentError, parse_json

from ..manifest import Vector
from .seen import RIGHT, Seen, Verdict

FILE = "fingerprints.xz"
MAGIC, VERSION = b"C3GSBUGS", 1
# The longest file and the most that may come of it, in bytes.
FILE_BYTES, TABLE_BYTES = 4 << 20, 256 << 20
# The bytes before the head.
_HEAD = 12


class TableError(Exception):
    """A file that is no table of fingerprints."""


@dataclass(frozen=True)
class Bug:
    """A planted bug.

    what: what the wrong decoder does. scope: the function of the second decoder that is changed. line: where. clauses:
    of SPEC.md, that which is broken first. requirements: those that are broken. stage: where in decoding, from 0. key:
    a hash of the wrong decoder.
    """

    id: str
    what: str
    scope: str
    line: int
    clauses: tuple[str, ...]
    requirements: tuple[str, ...]
    stage: int
    key: str

    @property
    def clause(self) -> str:
        """The clause to read."""
        return self.clauses[0]

    @property
    def place(self) -> tuple[str, int]:
        """Module and line: bugs of one place are siblings."""
        return self.scope.partition(".")[0], self.line


@dataclass(frozen=True)
class Place:
    """A statement of the second decoder. clauses, requirements: those that the comments above it cite."""

    module: str
    line: int
    clauses: tuple[str, ...]
    requirements: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """The table.

    vectors: (id, hash of file and expectation), in the order of the suite. outcomes: int64 [outcomes, 4] what bugs do
    to vectors, the number of the vector and the three of Seen, in the order of these numbers. cells: [vectors, bugs]
    the number of the outcome; right ones are -1. runs: [vectors, places] whether the unchanged decoder runs a place.
    lines: how many lines it runs for each vector. slow: hashes of the vectors that are not there, because it runs too
    many. decoder: a hash of it and of how many it may run.
    """

    bugs: tuple[Bug, ...]
    vectors: tuple[tuple[str, str], ...]
    places: tuple[Place, ...]
    outcomes: NDArray[np.int64]
    cells: NDArray[np.int32]
    runs: NDArray[np.bool_]
    lines: tuple[int, ...]
    slow: tuple[str, ...]
    decoder: str

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The vectors' identifiers."""
        return tuple(name for name, _ in self.vectors)

    def seen(self, vector: int, bug: int) -> Seen:
        """What a bug does to a vector."""
        cell = int(self.cells[vector, bug])
        return RIGHT if cell < 0 else Seen(*self.outcomes[cell, 1:].tolist())


def vector_key(vector: Vector) -> str:
    """A hash of a vector's file and of what is expected."""
    text = f"{vector.input.sha256}\0{json.dumps(asdict(vector.expectation), sort_keys=True)}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def build(
    bugs: Sequence[Bug],
    vectors: Sequence[tuple[str, str]],
    places: Sequence[Place],
    seen: Sequence[dict[str, Seen]],
    runs: NDArray[np.bool_],
    lines: Sequence[int],
    slow: Sequence[str],
    decoder: str,
) -> Table:
    """The table. seen: for each bug what it does to vectors; a vector that is not there is right."""
    numbers = {name: number for number, (name, _) in enumerate(vectors)}
    found = {(numbers[name], what) for row in seen for name, what in row.items() if what != RIGHT}
    ordered = sorted(found)
    outcomes = np.array([(vector, *what) for vector, what in ordered], np.int64).reshape(-1, 4)
    index = {outcome: number for number, outcome in enumerate(ordered)}
    cells = np.full((len(vectors), len(bugs)), -1, np.int32)
    for column, row in enumerate(seen):
        for name, what in row.items():
            if what != RIGHT:
                cells[numbers[name], column] = index[numbers[name], what]
    return Table(tuple(bugs), tuple(vectors), tuple(places), outcomes, cells, runs, tuple(lines), tuple(slow), decoder)


def to_bytes(table: Table) -> bytes:
    """The file of a table."""
    head = json.dumps(
        {
            "version": VERSION,
            "decoder": table.decoder,
            "bugs": [asdict(bug) for bug in table.bugs],
            "vectors": table.vectors,
            "places": [asdict(place) for place in table.places],
            "outcomes": len(table.outcomes),
            "lines": table.lines,
            "slow": table.slow,
        },
        separators=(",", ":"),
    ).encode()
    # Within a vector the outcomes count from 1, so that numbers are small and alike from vector to vector.
    owner, verdict, detail, exact = table.outcomes.T
    first = np.searchsorted(owner, np.arange(len(table.vectors)))
    local = np.where(table.cells < 0, 0, table.cells - first[:, None] + 1)
    arrays = [
        owner.astype("<u2"),
        verdict.astype("u1"),
        detail.astype("<u2"),
        exact.astype("<u4"),
        local.T.astype("<u2"),
        np.packbits(table.runs, axis=0).T,
    ]
    content = struct.pack("<8sI", MAGIC, len(head)) + head + b"".join(array.tobytes() for array in arrays)
    return lzma.compress(content, preset=9 | lzma.PRESET_EXTREME)


def _unpacked(data: bytes) -> bytes:
    if len(data) > FILE_BYTES:
        raise TableError(f"more than {FILE_BYTES} bytes")
    unpack = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=TABLE_BYTES)
    try:
        content = unpack.decompress(data, TABLE_BYTES)
    except lzma.LZMAError as error:
        raise TableError(str(error)) from None
    if not unpack.eof:
        raise TableError("not whole")
    return content


def from_bytes(data: bytes) -> Table:
    """The table of a file. Raises TableError."""
    content = _unpacked(data)
    try:
        return _read(content)
    except (DocumentError, AttributeError, IndexError, KeyError, TypeError, ValueError, struct.error) as error:
        raise TableError(f"damaged ({type(error).__name__})") from None


def _read(content: bytes) -> Table:
    magic, length = struct.unpack_from("<8sI", content)
    if magic != MAGIC:
        raise TableError("another kind of file")
    head: dict[str, Any] = parse_json(content[_HEAD : _HEAD + length], TABLE_BYTES)
    if head["version"] != VERSION:
        raise TableError(f"version {head['version']}")
    bugs = tuple(Bug(**_tuples(bug)) for bug in head["bugs"])
    spots = tuple(Place(**_tuples(place)) for place in head["places"])
    vectors = tuple((str(name), str(key)) for name, key in head["vectors"])
    row, outcomes, at = -(-len(vectors) // 8), head["outcomes"], _HEAD + length
    arrays = []
    for kind, count in (
        ("<u2", outcomes),
        ("u1", outcomes),
        ("<u2", outcomes),
        ("<u4", outcomes),
        ("<u2", len(vectors) * len(bugs)),
        ("u1", len(spots) * row),
    ):
        if count < 0:
            raise ValueError(count)
        arrays.append(np.frombuffer(content, kind, count, at))
        at += arrays[-1].nbytes
    owner, verdict, detail, exact, local, packed = arrays
    first = np.searchsorted(owner, np.arange(len(vectors)))
    cells = local.reshape(len(bugs), len(vectors)).T.astype(np.int32)
    cells = np.where(cells == 0, -1, cells - 1 + first[:, None]).astype(np.int32)
    if cells.max(initial=-1) >= outcomes or owner.max(initial=0) >= max(1, len(vectors)):
        raise ValueError(outcomes)
    told = np.stack([owner, verdict, detail, exact], axis=1).astype(np.int64)
    if verdict.max(initial=0) > max(Verdict) or (np.lexsort(told.T[::-1]) != np.arange(outcomes)).any():
        raise ValueError(outcomes)
    runs = np.unpackbits(packed.reshape(len(spots), row).T, axis=0, count=len(vectors)).astype(bool)
    return Table(
        bugs, vectors, spots, told, cells, runs, tuple(head["lines"]), tuple(head["slow"]), str(head["decoder"])
    )


def _tuples(fields: dict[str, Any]) -> dict[str, Any]:
    """JSON's lists as tuples."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}


def path() -> Path:
    """The table that came with the suite."""
    return Path(__file__).with_name(FILE)


def read(place: Path | None = None) -> Table:
    """The table of a file, or the one that came with the suite. Raises TableError, OSError."""
    return from_bytes((place or path()).read_bytes())
