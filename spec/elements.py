"""Which extremes of the elements of chapter 5 the vectors reach: a part of `python -m spec --coverage`.

No table states the ranges here. The greatest value that a valid file has is the greatest allowed one if its type ends
there, or if a file with the next value is refused for it. The least value is alike. Thus the vectors themselves prove
each range, and what they do not prove is a hole, unless `ARGUED` gives a reason.
"""

import re
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from conformance.manifest import Accepted, Manifest, Rejected, Vector
from refcodec.bitstream.syntax import Element
from refcodec.inspect.elements import outline_of, rows
from refcodec.inspect.meaning import Meaning, meaning
from refcodec.inspect.specification import fields

_KIND = re.compile(r"([fiu])(8|16|32|64)(?:\[.+\])?")
# From these codes on (10.3), the fields of the header are accepted, and then its directory.
HEADER_PASSED, DIRECTORY_PASSED = 300, 311
# Fields that 11.1 and 11.2 bound by profile, besides those of Dimensions.
_BY_PROFILE = {"Header.level", "Header.anchor_count", "Header.chunk_size"}
_CHECKSUM = "a checksum, which has one right value in each file"
_STATED = "other elements determine it, and a comparison of a block checks it"
_IGNORED = "no value of an ancillary section makes a file invalid (6.14, 6.15)"
# Elements without vectors at all of their extremes, by their names or those of their tables.
ARGUED = {
    **dict.fromkeys(("Prologue.prologue_crc", "Header.header_crc", "DirectoryEntry.crc"), _CHECKSUM),
    **dict.fromkeys(("ChunkEntry.crc", "Substream.symbol_crc"), _CHECKSUM),
    **dict.fromkeys(("Prologue.header_length", "Header.section_count", "Header.chunk_count"), _STATED),
    **dict.fromkeys(("DirectoryEntry.length", "PlaneTable.length", "Substream.word_count"), _STATED),
    **dict.fromkeys(("ChunkEntry.length", "ChunkEntry.anchor_count", "ChunkEntry.kept_count"), _STATED),
    **dict.fromkeys(("Chunk.position_length", "Chunk.mask_length", "Chunk.attribute_length"), _STATED),
    **dict.fromkeys(("Metadata", "Entry", "Cameras", "Camera"), _IGNORED),
    "WeightScales.carm_input_count": _STATED,
    "PositionModel.frequency": "the 16 frequencies of a model add up to 2^PRECISION",
}


@dataclass
class Range:
    """The values of an element in the vectors, floats as integers in their order.

    kind: its type in chapter 5, without a length. least, greatest: of the valid files. refused: the vectors that are
    refused for a value, by the value.
    """

    kind: str
    least: int | None = None
    greatest: int = 0
    refused: dict[int, str] = field(default_factory=dict)

    def allow(self, least: int, greatest: int) -> None:
        """Extends the range of valid files."""
        self.greatest = greatest if self.least is None else max(self.greatest, greatest)
        self.least = least if self.least is None else min(self.least, least)

    def ends(self) -> tuple[str | None, str | None]:
        """Returns what proves that least and greatest are extremes: "type" or a vector. None: nothing does."""
        if self.least is None:
            return None, None
        bits = int(self.kind[1:])
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if self.kind[0] == "i" else (0, (1 << bits) - 1)
        below, above = self.refused.get(self.least - 1), self.refused.get(self.greatest + 1)
        whole = self.kind[0] != "f"
        return "type" if whole and self.least == low else below, "type" if whole and self.greatest == high else above


_meaning = cache(meaning)


def _name(element: Meaning, section: str, profile: str) -> str:
    """Returns the name of an element in the report. section: the type of the directory entry that it is in."""
    name = f"{element.table}.{element.field}" if element.table else element.words
    if name == "DirectoryEntry.mode":
        return f"{name} of {section}"
    if name in _BY_PROFILE or (element.table == "Dimensions" and element.field != "reserved"):
        return f"{name} of {profile}"
    if "R6.8-3" in element.requirements:
        kind = "weights" if name.startswith("weights") else "biases"
        return f"{kind} of integer networks" if "7.2" in element.clauses else "numbers of rendering networks"
    return name


def values(row: Element, data: bytes) -> np.ndarray | None:
    """Returns the numbers of an element as int64 or uint64, floats as integers in their order. None: it has no number.

    The order is that of the finite numbers: those of -1, -0, 0 and 1 increase, and -0 and 0 are the same.
    """
    form = _KIND.fullmatch(row.kind)
    if form is None:
        return None
    size = int(form[2]) // 8
    raw = data[row.start : row.end]
    kind = "u" if form[1] == "f" else form[1]
    numbers = np.frombuffer(raw[: len(raw) // size * size], f"<{kind}{size}")
    if form[1] == "f":
        top = 1 << 8 * size - 1
        numbers = numbers.astype(np.int64)
        numbers = np.where(numbers & top, -(numbers & (top - 1)), numbers)
    return numbers


def _of_vector(vector: Vector, data: bytes, ranges: dict[str, Range]) -> None:
    """Adds the elements of a vector."""
    expected, section, profile, model = vector.expectation, "", "", outline_of(data).render_model
    starts: dict[str, int] = {}
    code, offset = (expected.code, expected.offset) if isinstance(expected, Rejected) else (0, -1)
    for row in rows(data):
        if row.kind == "bytes[4]":
            section = row.value.decode("latin-1")
            section = section if section in ("FRAM", "WGTS", "PLNS", "INDX", "DATA") else "others"
        if row.path == "header.profile":
            profile = {0: "Tiny", 1: "Main"}.get(row.value, "others")
        structure = row.path.rpartition(".")[0]
        starts.setdefault(structure, row.start)
        numbers = values(row, data)
        if numbers is None or not len(numbers):
            continue
        name = _name(_meaning(row.path, model), section, profile)
        own = ranges.setdefault(name, Range(row.kind.partition("[")[0]))
        # An error of a state has the offset of its substream, and that of a weight the offset of its row (10.3).
        nearby = name == "Substream.state" or name.endswith("integer networks")
        start = starts[structure] if nearby else row.start
        passed = DIRECTORY_PASSED if name.startswith("DirectoryEntry") else HEADER_PASSED
        if isinstance(expected, Accepted) or (row.path.startswith("header.") and code >= passed):
            own.allow(int(numbers.min()), int(numbers.max()))
        elif start <= offset < row.end:
            size = (row.end - row.start) // len(numbers)
            wrong = numbers if nearby else numbers[[(offset - row.start) // size]]
            for value in wrong.tolist():
                own.refused.setdefault(value, vector.id)


def of_vectors(manifest: Manifest) -> dict[str, Range]:
    """Returns the ranges of the elements by name. A header is valid if no error of it or of its directory is found."""
    ranges: dict[str, Range] = {}
    for vector in manifest.vectors:
        if vector.operation == "decode":
            _of_vector(vector, manifest.path(vector).read_bytes(), ranges)
    return ranges


def argued(name: str) -> str | None:
    """Returns why an element needs no vectors at its extremes, or None."""
    return ARGUED.get(name) or ARGUED.get(name.partition(".")[0])


def _shown(kind: str, value: int) -> str:
    if kind[0] != "f":
        return str(value)
    size = int(kind[1:])
    bits = value if value >= 0 else -value | 1 << size - 1
    return str(float(np.array(bits, f"u{size // 8}").view(f"f{size // 8}")))


def report(spec: str, manifest: Manifest) -> tuple[list[str], int]:
    """Returns lines on the extremes, and how many of them no vector reaches without a reason. spec: SPEC.md."""
    ranges = of_vectors(manifest)
    lines: list[str] = []
    proved = reasoned = holes = 0
    known = {name.partition(" of ")[0] for name in ranges}
    for name, (kind, _) in fields(spec).items():
        if _KIND.fullmatch(kind.partition("[")[0]) and name not in known:
            lines.append(f"  {name}: no vector has it")
            holes += 2
    for name, own in ranges.items():
        if name.endswith(" of others") and own.least is None:
            # An unknown profile.
            continue
        reason, ends = argued(name), own.ends()
        words = []
        for what, end in zip(("below", "above"), ends, strict=True):
            words.append(f"{what}: {reason or 'open'}" if end is None else "" if end == "type" else f"{what}: {end}")
        proved += sum(end is not None for end in ends)
        reasoned += sum(end is None for end in ends) if reason else 0
        holes += 0 if reason else sum(end is None for end in ends)
        span = "none" if own.least is None else " to ".join(_shown(own.kind, x) for x in (own.least, own.greatest))
        lines.append(f"  {name}: {span}{''.join(f'; {text}' for text in words if text)}")
    head = f"extremes of elements: {proved + reasoned + holes}, of which the vectors show {proved}"
    return [f"{head}; {reasoned} argued, {holes} open", *lines], holes
