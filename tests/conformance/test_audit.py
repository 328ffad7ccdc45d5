"""The audit of reports: whatever follows from the answers of a decoder cannot be edited."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_suite import Suite

from conformance.manifest import MANIFEST, load
from conformance.report import record as records
from conformance.report.audit import audit

Record = dict[str, Any]


def _vector(record: Record, name: str) -> Record:
    return next(v for v in record["vectors"] if v["id"] == name)


def _pass(record: Record) -> None:
    """Edits the failure, and all conclusions from it."""
    failed, other = _vector(record, "valid-extended"), _vector(record, "valid-plain")
    failed.update({name: other[name] for name in ("status", "grade", "text", "divergence", "hex", "stderr")})
    record["verdict"].update(conforms=True, grade=3, counts={**record["verdict"]["counts"], "failed": 0, "passed": 6})
    record["profiles"][0].update(verdict="conforms", right=6)
    for name in ("requirements", "features"):
        for row in record[name].values():
            row["right"] = 6
    record["diagnosis"] = None


EDITS: dict[str, Callable[[Record], object]] = {
    "a verdict": lambda r: r["profiles"][0].update(verdict="conforms"),
    "a status": lambda r: _vector(r, "valid-extended").update(status="passed", grade=3, text=""),
    "all verdicts": _pass,
    "a count": lambda r: r["verdict"]["counts"].update(failed=0, passed=6),
    "the suite's version": lambda r: r["suite"].update(version="0.0.2"),
    "the manifest": lambda r: r["suite"].update(manifest_sha256="0" * 64),
    "a digest": lambda r: _vector(r, "valid-plain")["found"].update(digest="0" * 64),
    "an expectation": lambda r: _vector(r, "valid-plain")["expected"].update(digest="0" * 64),
    "a code": lambda r: _vector(r, "malformed-crc")["found"].update(code=101),
    "an unknown code": lambda r: _vector(r, "malformed-crc")["found"].update(code=999),
    "no answer": lambda r: _vector(r, "valid-extended").update(found=None, status="skipped"),
    "a removed vector": lambda r: r["vectors"].remove(_vector(r, "valid-extended")),
    "a vector twice": lambda r: r["vectors"].append(r["vectors"][0]),
    "a known failure": lambda r: _vector(r, "valid-extended").update(status="known"),
    "a requirement": lambda r: r["requirements"]["R6.2-1"].update(right=6),
    "a selection": lambda r: r["runner"].update(select=["class:valid"]),
    "the grade": lambda r: r["runner"].update(grade=1),
    "no command": lambda r: r["decoder"].update(command=[]),
    "a field": lambda r: r.update(more=1),
}


@pytest.fixture(scope="module")
def report(suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a decoder that fails one vector, valid-extended."""
    folder = tmp_path_factory.mktemp("report")
    suite.report("no-ancillary", folder)
    return folder / "report.json"


def judged(record: Record, suite: Suite) -> None:
    audit(records.check(record), load(suite.folder / MANIFEST))


def test_a_report_as_it_was_made(report: Path, suite: Suite) -> None:
    record = records.read(report)
    judged(record, suite)
    # Time has no second source. Only the record's own SHA-256 covers it.
    record["vectors"][0]["seconds"] = 0.0
    with pytest.raises(records.RecordError, match="its SHA-256"):
        judged(record, suite)
    record["sha256"] = records.seal(record)
    judged(record, suite)


@pytest.mark.parametrize("what", EDITS)
def test_an_edited_report_is_refused(report: Path, what: str, suite: Suite) -> None:
    """With the record's own SHA-256 made again, the rest of the content must contradict the edit."""
    record = records.read(report)
    EDITS[what](record)
    for sealed in (False, True):
        if sealed and what == "the grade":
            # No vector has grade 1 or 2, thus the same verdicts follow.
            continue
        with pytest.raises(records.RecordError):
            judged(record | ({"sha256": records.seal(record)} if sealed else {}), suite)
