"""The form of a record.

Every member of an object is required, except those with a default, and no other is allowed.
"""

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from ..manifest import Count, Positive, Sha256, Strict, Text
from ..runner.run import Grade, Number, Result, Status

# The verdict that a vector counts for.
Group = Annotated[str, Meta(pattern="^(any|gaussians|rendering|(tiny|main) [0-9]+)$")]


class Description(Strict, frozen=True):
    """The description that a decoder gives of itself."""

    name: Text
    version: str
    language: str | UnsetType = UNSET
    author: str | UnsetType = UNSET
    url: str | UnsetType = UNSET
    notes: str | UnsetType = UNSET


class Suite(Strict, frozen=True):
    """vectors: the verdict that each vector counts for."""

    version: str
    format_version: int
    manifest_sha256: Sha256
    vectors: dict[str, Group]


class Runner(Strict, frozen=True):
    """The run. started: ISO 8601. seconds: wall time."""

    version: str
    python: str
    platform: str
    select: tuple[str, ...]
    started: str
    seconds: Number
    interrupted: bool
    jobs: Positive
    grade: Annotated[int, Meta(ge=1, le=3)]
    slow: Annotated[float, Meta(gt=0)]
    trace: bool
    serve: bool


class Decoder(Strict, frozen=True):
    """command, gaussians, render: templates. files: the SHA-256 of the program and of files that the command names."""

    description: Description
    command: tuple[str, ...]
    gaussians: tuple[str, ...] | None
    render: tuple[str, ...] | None
    files: dict[str, Sha256]


class Verdict(Strict, frozen=True):
    """grade: the lowest of the vectors."""

    conforms: bool
    grade: Grade | None
    counts: dict[Status, Count]
    not_run: Count


class Profile(Strict, frozen=True):
    """The verdict for a profile and level, lists of Gaussians, or rendering. needed, right: numbers of vectors."""

    profile: Literal["tiny", "main", "gaussians", "rendering"]
    level: Count | None
    verdict: Literal["conforms", "fails", "incomplete"]
    needed: Count
    right: Count


class Coverage(Strict, frozen=True):
    """The vectors of a requirement or a feature: in the suite, run, and right."""

    vectors: Count
    run: Count
    right: Count


class WrongNumber(Strict, frozen=True):
    """A clause whose numbers are wrong, with the number of such vectors, and the simplest of them."""

    clause: str
    title: str
    vectors: Count
    vector: str
    text: str


class Diagnosis(Strict, frozen=True):
    """failing, passing: numbers of vectors. text: lines for people."""

    failing: Count
    passing: Count
    text: tuple[str, ...]
    probes: tuple[WrongNumber, ...]


class Record(Strict, frozen=True, kw_only=True):
    """Report of a run of the C3GS conformance suite. conformance/README.md states the meaning of each member."""

    report: Literal["c3gs-conformance-report"] = "c3gs-conformance-report"
    report_version: Literal[5] = 5
    suite: Suite
    runner: Runner
    decoder: Decoder
    verdict: Verdict
    profiles: tuple[Profile, ...]
    requirements: dict[str, Coverage]
    features: dict[str, Coverage]
    diagnosis: Diagnosis | None
    sha256: Sha256
    vectors: tuple[Result, ...]
