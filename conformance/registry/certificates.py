"""Certificates: what the report of a decoder and the matrix of an encoder state, in a few words."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from msgspec import to_builtins

from refcodec.files.documents import DocumentError

from ..manifest import Manifest
from ..report import record as records
from ..report.audit import audit
from ..report.schema import Record
from ..runner.grading import GRADE_EXACT
from .implementations import Implementation
from .matrix import Matrix


@dataclass(frozen=True)
class Certificate:
    """What is known of one side of an implementation.

    side: "decoder" or "encoder". text: for the badge. good: whether it conforms to anything, None if nothing current is
    known. record: the report of a decoder, if it is of this suite.
    """

    implementation: Implementation
    side: str
    text: str
    good: bool | None
    record: Record | None = None

    @property
    def badge(self) -> str:
        """The name of its badge's file."""
        return f"{self.implementation.key}{'.encoder' if self.side == 'encoder' else ''}.svg"


def words(record: Record) -> str:
    """Returns the profiles and levels that a record's decoder conforms to, such as `tiny 0, main 1-5, drawing`."""
    conforming: dict[str, list[int | None]] = {}
    for row in record.profiles:
        if row.verdict == "conforms":
            conforming.setdefault(row.profile, []).append(row.level)
    if conforming:
        return ", ".join(
            "drawing" if name == "rendering" else f"{name} {'-'.join(map(str, dict.fromkeys((own[0], own[-1]))))}"
            for name, own in conforming.items()
        )
    # A decoder may claim a lower grade (SPEC.md 15.4).
    wrong = sum(v.grade < GRADE_EXACT for v in record.vectors if v.found is not None)
    return f"grade {record.verdict.grade}" if record.verdict.grade else f"fails {wrong}"


def of_decoder(implementation: Implementation, folder: Path, manifest: Manifest) -> Certificate:
    """Returns the certificate of a decoder. A report of another suite is not judged.

    Raises RecordError for a report that was edited or is of another program, and OSError.
    """
    assert implementation.decoder is not None
    path = folder / implementation.decoder.report
    try:
        record = records.check(records.read(path))
        if record.suite.manifest_sha256 != records.manifest_digest(manifest):
            # Nothing is claimed of it.
            return Certificate(implementation, "decoder", f"only suite {record.suite.version}", None)
        audit(record, manifest)
        _check_whose(record, implementation)
    except FileNotFoundError:
        return Certificate(implementation, "decoder", "no report", None)
    except (DocumentError, records.RecordError) as error:
        raise records.RecordError(f"{path}: {error}") from None
    text = words(record)
    return Certificate(implementation, "decoder", text, not text.startswith("fails"), record)


def _check_whose(record: Record, implementation: Implementation) -> None:
    """Raises RecordError for a report of another program than that of the TOML file."""
    decoder = implementation.decoder
    assert decoder is not None
    gaussians = decoder.gaussians and tuple(shlex.split(decoder.gaussians))
    for name, stated, wanted in (
        ("description", to_builtins(record.decoder.description), implementation.description),
        ("command", record.decoder.command, tuple(decoder.words)),
        ("command for Gaussians", record.decoder.gaussians, gaussians),
    ):
        if stated != wanted:
            again = f"conformance registry --run {implementation.key}"
            raise records.RecordError(f"its {name} is not that of {implementation.key}.toml: {again} makes a report")


def of_encoder(implementation: Implementation, matrix: Matrix) -> Certificate:
    """Returns the certificate of an encoder: whether its files in the matrix are right."""
    rows = [row for row in matrix if row.encoder == implementation.key]
    wrong = sum(not row.right for row in rows)
    if not rows:
        return Certificate(implementation, "encoder", "not in the matrix", None)
    decoders = len({name for row in rows for name in row.digests})
    text = f"{wrong} of {len(rows)} files wrong" if wrong else f"{len(rows)} files, {decoders} decoders agree"
    return Certificate(implementation, "encoder", text, not wrong)
