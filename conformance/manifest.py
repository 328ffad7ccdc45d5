"""The manifest of the suite, vectors/manifest.json. vectors/manifest.schema.json states the same form for others."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType

from refcodec.files.documents import DocumentError, read_json
from refcodec.files.text import printable
from refcodec.resources import find

# The suite that came with this package, wherever it is installed.
VECTORS = find("vectors", Path(__file__).resolve().parent)
MANIFEST, SCHEMA, ARCHIVE = "manifest.json", "manifest.schema.json", "archive"
# The most characters of a fault in a message.
_WRONG = 300

Text = Annotated[str, Meta(min_length=1)]
Name = Annotated[str, Meta(pattern=r"^[a-z0-9]+(-[a-z0-9]+)*$")]
Requirement = Annotated[str, Meta(pattern=r"^[RDGE]([0-9]+(\.[0-9]+)*|[A-H](\.[0-9]+)*)-[0-9]+$")]
Sha256 = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$")]
Place = Annotated[str, Meta(pattern=r"^(valid|malformed|invalid|unsupported|resource)/[a-z0-9-]+\.(c3gs|json|pfm)$")]
Count = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(ge=1)]
# The parts of each scene, and that of a static one (SPEC 9.3).
_PARTS = {"head", "positions", "masks", "planes", "features", "scalings", "offsets", "weights"}
_MORE = {"splat"}
Class = Literal["valid", "malformed", "invalid", "unsupported", "resource"]
Operation = Literal["decode", "gaussians", "render"]


class ManifestError(Exception):
    """A manifest is not of its form, or contradicts itself."""


# The operation of each result that is not of a decoder.
OPERATIONS = {"gaussians": "gaussians", "image": "render", "undrawn": "render"}


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A JSON object without other members."""


class Input(Strict, frozen=True):
    """The file of a vector. path: from the manifest's folder. size: in bytes. sha256: in hexadecimal."""

    path: Place
    size: Count
    sha256: Sha256


class Accepted(Strict, frozen=True, tag="accepted", tag_field="result"):
    """The file is accepted.

    digest: of the canonical reconstruction (SPEC 9.3). parts: the digest of each part by name, the head too. trace: the
    SHA-256 of the symbol trace.
    """

    digest: Sha256
    parts: dict[str, Sha256]
    trace: Sha256


class Rejected(Strict, frozen=True, tag="rejected", tag_field="result"):
    """The file is refused with this error (SPEC 10.2)."""

    code: Annotated[int, Meta(ge=101, le=999)]
    name: Annotated[str, Meta(pattern=r"^[a-z]+\.[a-z_]+$")]
    offset: Count
    clause: Annotated[str, Meta(pattern=r"^[0-9]+(\.[0-9]+)*$")]


class GaussiansOf(Strict, frozen=True, tag="gaussians", tag_field="result"):
    """The Gaussians for a camera are within a tolerance of a list (SPEC 14.3).

    camera: a JSON object. path, sha256: those of the list. tolerance: relative to the length of the vector of each
    kind.
    """

    camera: dict[str, Any]
    path: Place
    sha256: Sha256
    tolerance: Annotated[float, Meta(gt=0)]


class ImageOf(Strict, frozen=True, tag="image", tag_field="result"):
    """The image of a camera is like a reference image (SPEC [G14.5-1]). path, sha256: of the latter, a PFM file."""

    camera: dict[str, Any]
    path: Place
    sha256: Sha256


class Undrawn(Strict, frozen=True, tag="undrawn", tag_field="result"):
    """A renderer draws nothing (SPEC [G6.5-1])."""

    camera: dict[str, Any]


Expectation = Accepted | Rejected | GaussiansOf | ImageOf | Undrawn


class Budget(Strict, frozen=True):
    """The most time, in seconds, and the most memory of a process, in bytes, that a decoder may take."""

    seconds: Positive
    bytes: Positive


class Generator(Strict, frozen=True):
    """The recipe that made the file."""

    name: Annotated[str, Meta(pattern="^[a-z0-9_]+$")]
    seed: Count


class Vector(Strict, frozen=True, rename={"klass": "class"}):
    """A vector: a file, and what a decoder makes of it.

    klass: its "class". profile, level: None if the header cannot be read. minor_at_most: the verdict holds for decoders
    of minor versions up to this one (SPEC 12.3), or of all if it is unset.
    """

    id: Name
    title: Text
    operation: Operation
    klass: Class
    profile: Literal["tiny", "main"] | None
    level: Annotated[int, Meta(ge=0, le=255)] | None
    features: Annotated[tuple[Name, ...], Meta(min_length=1)]
    requirements: Annotated[tuple[Requirement, ...], Meta(min_length=1)]
    flags: tuple[Name, ...]
    input: Input
    expectation: Expectation
    budget: Budget
    licence: Literal["CC0-1.0", "MIT"]
    generator: Generator
    minor_at_most: Annotated[int, Meta(ge=0, le=65535)] | UnsetType = UNSET


class _Document(Strict, frozen=True):
    suite: Literal["c3gs-conformance"]
    suite_version: Annotated[str, Meta(pattern=r"^[0-9]+\.[0-9]+\.[0-9]+$")]
    format_version: Literal[0]
    flags: dict[Name, Text]
    features: dict[Name, Text]
    vectors: Annotated[tuple[Vector, ...], Meta(min_length=1)]


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


def _faults(manifest: Manifest) -> Iterator[str]:
    """Yields the contradictions of a manifest."""
    vectors = manifest.vectors
    for what, values in (
        ("id", [v.id for v in vectors]),
        ("input", [v.input.path for v in vectors if v.operation == "decode"]),
    ):
        yield from (f"two vectors have the {what} {value}" for value, count in Counter(values).items() if count > 1)
    for kind in ("flags", "features"):
        used, known = {name for v in vectors for name in getattr(v, kind)}, set(getattr(manifest, kind))
        yield from (f"{name} is not defined in {kind}" for name in sorted(used - known))
        yield from (f"no vector has {name} of {kind}" for name in sorted(known - used))
    for v in vectors:
        rejected, operation = (
            isinstance(v.expectation, Rejected),
            OPERATIONS.get(str(v.expectation.__struct_config__.tag), "decode"),
        )
        right = {"valid": not rejected, "resource": True}.get(v.klass, rejected)
        if not right or operation != v.operation:
            yield f"{v.id}: class {v.klass} and operation {v.operation} with another result"
        if any(len(set(names)) < len(names) for names in (v.features, v.requirements, v.flags)):
            yield f"{v.id}: a name is repeated"
        if isinstance(v.expectation, Accepted) and v.expectation.parts.keys() - _MORE != _PARTS:
            yield f"{v.id}: its parts are {', '.join(v.expectation.parts)}"


def parse(document: Any, folder: Path) -> Manifest:
    """Returns the manifest of a JSON document. folder: of its files. Raises ManifestError."""
    try:
        stated = msgspec.convert(document, _Document)
    except msgspec.ValidationError as error:
        raise ManifestError(printable(str(error), _WRONG)) from None
    manifest = Manifest(
        stated.suite_version, stated.format_version, stated.flags, stated.features, stated.vectors, folder
    )
    for fault in _faults(manifest):
        raise ManifestError(printable(fault, _WRONG))
    return manifest


def load(path: Path = VECTORS / MANIFEST) -> Manifest:
    """Returns the manifest at a path. Raises ManifestError for a fault, and OSError if it cannot be read."""
    try:
        return parse(read_json(path), path.parent)
    except (DocumentError, ManifestError) as error:
        raise ManifestError(f"{path}: {error}") from None
