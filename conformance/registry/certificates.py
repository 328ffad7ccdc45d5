"""Certificates: what the report of a decoder and the matrix of an encoder say, in a few words, and their history."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msgspec import to_builtins

from refcodec.files.documents import DocumentError, read_json

from ..manifest import Manifest
from ..report import record as records
from ..report.audit import audit
from ..report.schema import Record
from ..runner.grading import GRADE_EXACT
from .implementations import Implementation
from .matrix import Matrix, is_right

HISTORY = "history.json"


@dataclass(frozen=True)
class Certificate:
    """What is known of one side of an implementation.

    side: "decoder" or "encoder". text: for the badge. good: whether it conforms to anything, None if nothing current is
    known. entry: of the history, for a decoder with a report. files: the hashes of the command's files in that report.
    """

    implementation: Implementation
    side: str
    text: str
    good: bool | None
    entry: dict[str, Any] | None = None
    files: dict[str, str] | None = None

    @property
    def badge(self) -> str:
        """The name of its badge's file."""
        return f"{self.implementation.key}{'.encoder' if self.side == 'encoder' else ''}.svg"


def words(record: Record) -> str:
    """Returns the profiles and levels that a record's decoder conforms to, such as `tiny 0, main 1-5, drawing`."""
    found = []
    for profile in dict.fromkeys(row.profile for row in record.profiles):
        rows = [row for row in record.profiles if row.profile == profile and row.verdict == "conforms"]
        levels = [row.level for row in rows]
        if profile == "rendering":
            found += ["drawing"] if rows else []
        elif levels:
            found.append(f"{profile} {levels[0]}" + (f"-{levels[-1]}" if len(levels) > 1 else ""))
    if found:
        return ", ".join(found)
    # A decoder may claim a lower grade (SPEC.md 15.4).
    wrong = sum(v.grade < GRADE_EXACT for v in record.vectors if v.found is not None)
    return f"grade {record.verdict.grade}" if record.verdict.grade else f"fails {wrong}"


def read_history(folder: Path) -> list[dict[str, Any]]:
    """Reads the history of a folder: an entry for each report that was ever in the registry, in order."""
    try:
        history: list[dict[str, Any]] = read_json(folder / HISTORY)
    except FileNotFoundError:
        return []
    except DocumentError as error:
        raise records.RecordError(f"{folder / HISTORY}: {error}") from None
    return history


def history_text(history: list[dict[str, Any]]) -> str:
    """Returns the history as JSON, with a line for each entry."""
    return "[\n" + ",\n".join(f" {json.dumps(entry)}" for entry in history) + "\n]\n"


def of_decoder(
    implementation: Implementation, folder: Path, manifest: Manifest, history: list[dict[str, Any]]
) -> Certificate:
    """Returns the certificate of a decoder, and adds a new report to the history.

    A report of an earlier suite can no longer be judged. It must be the last one of the implementation in the history.

    Raises:
        RecordError: the report was edited, or is of another program or suite.
        OSError: it cannot be read.
    """
    path = folder / implementation.decoder["report"]
    try:
        document = records.read(path)
    except FileNotFoundError:
        return Certificate(implementation, "decoder", "no report", None)
    except DocumentError as error:
        raise records.RecordError(f"{path}: {error}") from None
    mine = [entry for entry in history if entry["implementation"] == implementation.key]
    try:
        if mine and _is_earlier(document, mine[-1], manifest):
            return Certificate(implementation, "decoder", f"{mine[-1]['verdict']} (earlier)", None, mine[-1])
        record = records.check(document)
        audit(record, manifest)
        _check_whose(record, implementation)
    except records.RecordError as error:
        raise records.RecordError(f"{path}: {error}") from None
    entry = {
        "implementation": implementation.key,
        "version": implementation.version,
        "suite_version": manifest.suite_version,
        "manifest_sha256": record.suite.manifest_sha256,
        "report_sha256": record.sha256,
        "started": record.runner.started,
        "verdict": words(record),
    }
    if mine[-1:] != [entry]:
        history.append(entry)
    good = not entry["verdict"].startswith("fails")
    return Certificate(implementation, "decoder", entry["verdict"], good, entry, record.decoder.files)


def _is_earlier(record: Any, last: dict[str, Any], manifest: Manifest) -> bool:
    """Whether a report is the last one of its implementation in the history, and of an earlier suite."""
    return (
        isinstance(record, dict)
        and last["manifest_sha256"] != records.manifest_digest(manifest)
        and last["report_sha256"] == record.get("sha256") == records.seal(record)
    )


def _check_whose(record: Record, implementation: Implementation) -> None:
    """Raises RecordError for a report of another program than that of the TOML file."""
    gaussians = implementation.decoder.get("gaussians")
    for name, stated, wanted in (
        ("description", to_builtins(record.decoder.description), implementation.description),
        ("command", record.decoder.command, tuple(implementation.command)),
        ("command for Gaussians", record.decoder.gaussians, gaussians and tuple(shlex.split(gaussians))),
    ):
        if stated != wanted:
            raise records.RecordError(
                f"its {name} is not that of {implementation.key}.toml: "
                f"conformance registry --run {implementation.key} makes a report"
            )


def of_encoder(implementation: Implementation, matrix: Matrix) -> Certificate:
    """Returns the certificate of an encoder: whether its files in the matrix are right."""
    rows = [row for row in matrix["files"] if row["encoder"] == implementation.key]
    wrong = sum(not is_right(row) for row in rows)
    if not rows:
        return Certificate(implementation, "encoder", "not in the matrix", None)
    decoders = len({name for row in rows for name in row["found"]})
    text = f"{wrong} of {len(rows)} files wrong" if wrong else f"{len(rows)} files, {decoders} decoders agree"
    return Certificate(implementation, "encoder", text, not wrong)
