"""The manifest of the suite, vectors/manifest.json, which is checked against vectors/manifest.schema.json."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema

from refcodec.files.documents import DocumentError, read_json
from refcodec.files.text import printable
from refcodec.resources import find

# The suite that came with this package, wherever it is installed.
VECTORS = find("vectors", Path(__file__).resolve().parent)
MANIFEST, SCHEMA = "manifest.json", "manifest.schema.json"


# So many characters are told of what is wrong.
_WRONG = 300


class ManifestError(Exception):
    """A manifest breaks its schema, or contradicts itself."""


@dataclass(frozen=True)
class Input:
    """The file of a vector. path: from the manifest's folder. size: in bytes. sha256: in hexadecimal."""

    path: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Accepted:
    """The file is accepted.

    digest: of the canonical reconstruction (SPEC 9.3). parts: the digest of each part by name, the head too. trace: the
    SHA-256 of the symbol trace.
    """

    digest: str
    parts: dict[str, str]
    trace: str


@dataclass(frozen=True)
class Rejected:
    """The file is refused with this error (SPEC 10.2)."""

    code: int
    name: str
    offset: int
    clause: str


@dataclass(frozen=True)
class GaussiansOf:
    """The Gaussians for a camera are within a tolerance of a list (SPEC 14.3).

    camera: a JSON object. path, sha256: those of the list. tolerance: relative to the length of the vector of each
    kind.
    """

    camera: dict[str, Any]
    path: str
    sha256: str
    tolerance: float


@dataclass(frozen=True)
class Budget:
    """The most time, in seconds, and the most memory of a process, in bytes, that a decoder may take."""

    seconds: int
    bytes: int


@dataclass(frozen=True)
class Vector:
    """A vector: a file, and what a decoder makes of it.

    operation: "decode" or "gaussians". klass: its "class". profile, level: None if the header cannot be read.
    minor_at_most: the verdict holds for decoders of minor versions up to this one (SPEC 12.3), or of all if it is None.
    generator: how the file was made.
    """

    id: str
    title: str
    operation: str
    klass: str
    profile: str | None
    level: int | None
    features: tuple[str, ...]
    requirements: tuple[str, ...]
    flags: tuple[str, ...]
    input: Input
    expectation: Accepted | Rejected | GaussiansOf
    budget: Budget
    licence: str
    generator: dict[str, Any]
    minor_at_most: int | None = None


@dataclass(frozen=True)
class Manifest:
    """The suite. flags, features: the meaning of each, by name. folder: that of the manifest. Paths start there."""

    suite_version: str
    format_version: int
    flags: dict[str, str]
    features: dict[str, str]
    vectors: tuple[Vector, ...]
    folder: Path

    def path(self, vector: Vector) -> Path:
        """Returns the path of a vector's file."""
        return self.folder / vector.input.path


_RESULTS: dict[str, type[Accepted | Rejected | GaussiansOf]] = {
    "accepted": Accepted,
    "rejected": Rejected,
    "gaussians": GaussiansOf,
}


def _vector(fields: dict[str, Any]) -> Vector:
    values = {"klass" if name == "class" else name: value for name, value in fields.items()}
    for name in ("features", "requirements", "flags"):
        values[name] = tuple(values[name])
    expectation = dict(values["expectation"])
    values["expectation"] = _RESULTS[expectation.pop("result")](**expectation)
    return Vector(**{**values, "input": Input(**values["input"]), "budget": Budget(**values["budget"])})


def faults(document: dict[str, Any]) -> Iterator[str]:
    """Yields the faults of a manifest that its schema cannot find."""
    vectors = document["vectors"]
    for what, values in (
        ("id", [v["id"] for v in vectors]),
        ("input", [v["input"]["path"] for v in vectors if v["operation"] == "decode"]),
    ):
        yield from (f"two vectors have the {what} {value}" for value, count in Counter(values).items() if count > 1)
    for kind in ("flags", "features"):
        used = {name for v in vectors for name in v[kind]}
        yield from (f"{name} is not defined in {kind}" for name in sorted(used - set(document[kind])))
        yield from (f"no vector has {name} of {kind}" for name in sorted(set(document[kind]) - used))
    for v in vectors:
        result, klass = v["expectation"]["result"], v["class"]
        right = {"valid": result != "rejected", "resource": True}.get(klass, result == "rejected")
        if not right or (result == "gaussians") != (v["operation"] == "gaussians"):
            yield f"{v['id']}: class {klass} and operation {v['operation']} with the result {result}"


def load(path: Path = VECTORS / MANIFEST) -> Manifest:
    """Returns the manifest at a path. Its schema is the one that came with this package, of whatever suite it is.

    Raises ManifestError for a fault of the manifest, and OSError if it cannot be read.
    """
    try:
        document = read_json(path)
        jsonschema.validate(document, read_json(VECTORS / SCHEMA))
    except DocumentError as error:
        raise ManifestError(f"{path}: {error}") from None
    except jsonschema.ValidationError as error:
        text = f"{printable(error.json_path, _WRONG)}: {printable(error.message, _WRONG)}"
        raise ManifestError(f"{path}: {text}") from None
    for fault in faults(document):
        raise ManifestError(f"{path}: {printable(fault, _WRONG)}")
    return Manifest(
        document["suite_version"],
        document["format_version"],
        document["flags"],
        document["features"],
        tuple(_vector(fields) for fields in document["vectors"]),
        path.parent,
    )
