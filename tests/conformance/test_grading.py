"""The grader is tested by planting faults in it: each must show on a table of outcomes."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from conformance.manifest import Accepted, Budget, Input, Manifest, Rejected, Vector
from conformance.runner import grading
from conformance.runner.grading import Found, Judgement
from conformance.runner.process import Ended

# SPEC 9.3: of two anchors with K = 1, F = 3, ch = 1 and B = 2, and of one weight.
PARTS = [bytes([number]) * size for number, size in enumerate((24, 2, 40, 24, 48, 24, 4))]
HEAD = b"C3GSREC1" + struct.pack("<5I", 2, 1, 3, 1, 2)
LISTED = HEAD + b"".join(hashlib.sha256(part).digest() for part in PARTS)
OUTPUT = LISTED + b"".join(PARTS)
DIGEST = hashlib.sha256(LISTED).hexdigest()
REFUSED = b'a line of talk\n{"code": 412, "name": "weights.not_finite", "offset": 300}\n'
NEW_VERSION = b'{"code": 104, "offset": 8}\n'
INVALID = Rejected(412, "weights.not_finite", 300, "6.8")
VERSION = Rejected(104, "prologue.version", 8, "6.1")
VALID = Accepted(DIGEST, {}, "")


def _vector(expectation: Accepted | Rejected) -> Vector:
    where = Input("valid/x.c3gs", 1, "0" * 64)
    return Vector("x", "x", "decode", "valid", "tiny", 0, (), (), (), where, expectation, Budget(1, 1), "CC0-1.0", {})


@dataclass(frozen=True)
class Case:
    """A process's end and its output file, if any; what it must be to a vector: a crash or not, and the grade."""

    name: str
    expectation: Accepted | Rejected
    ended: Ended
    output: bytes | None
    crashed: bool
    grade: int


def _ended(status: int | None, stderr: bytes = b"", signal: int | None = None, over: str | None = None) -> Ended:
    return Ended(status, signal, over, stderr, 0.1, None)


CASES = [
    Case("right output", VALID, _ended(0), OUTPUT, False, 3),
    Case("wrong output", VALID, _ended(0), OUTPUT + b"!", False, 0),
    Case("wrong part", VALID, _ended(0), OUTPUT[:-1] + b"!", False, 0),
    Case("wrong first part", VALID, _ended(0), LISTED + b"!" * 24 + OUTPUT[276:], False, 0),
    Case("wrong digest of a part", VALID, _ended(0), OUTPUT[:40] + b"!" + OUTPUT[41:], False, 0),
    Case("wrong head", VALID, _ended(0), OUTPUT[:8] + b"\3" + OUTPUT[9:], False, 0),
    Case("head and digests alone", VALID, _ended(0), LISTED, False, 0),
    Case("an output that is cut in its digests", VALID, _ended(0), LISTED[:-1], False, 0),
    Case("empty output", VALID, _ended(0), b"", False, 0),
    Case("no output", VALID, _ended(0), None, True, 0),
    Case("a valid file refused", VALID, _ended(1, REFUSED), None, False, 0),
    Case("right output, exit 1", VALID, _ended(1), OUTPUT, True, 0),
    Case("right output, then a signal", VALID, _ended(None, signal=11), OUTPUT, True, 0),
    Case("right output, too late", VALID, _ended(None, signal=9, over="time"), OUTPUT, True, 0),
    Case("right output, with too much memory", VALID, _ended(0, over="memory"), OUTPUT, True, 0),
    Case("right output, of too many bytes", VALID, _ended(0, over="output"), OUTPUT, True, 0),
    Case("right code and offset", INVALID, _ended(1, REFUSED), None, False, 3),
    Case("and blank lines behind", INVALID, _ended(1, REFUSED + b"\n \n"), None, False, 3),
    Case("and an output file", INVALID, _ended(1, REFUSED), b"part", False, 3),
    Case("wrong offset", INVALID, _ended(1, REFUSED.replace(b"300", b"301")), None, False, 2),
    Case("offset as text", INVALID, _ended(1, REFUSED.replace(b"300", b'"300"')), None, False, 2),
    Case("offset as a fraction", INVALID, _ended(1, REFUSED.replace(b"300", b"300.0")), None, False, 2),
    Case("wrong code of the class", INVALID, _ended(1, REFUSED.replace(b"412", b"413")), None, False, 1),
    Case("code of another class", INVALID, _ended(1, REFUSED.replace(b"412", b"103")), None, False, 1),
    Case("exit 2 for what is invalid", INVALID, _ended(2, REFUSED), None, False, 1),
    Case("exit 1 for what is unsupported", VERSION, _ended(1, NEW_VERSION), None, False, 1),
    Case("unsupported", VERSION, _ended(2, NEW_VERSION), None, False, 3),
    Case("unsupported, with a code of another class", VERSION, _ended(2, REFUSED), None, False, 1),
    Case("accepts what is invalid", INVALID, _ended(0), OUTPUT, False, 0),
    Case("says it, but exit 0", INVALID, _ended(0, REFUSED), None, True, 0),
    Case("says it, but exit 3", INVALID, _ended(3, REFUSED), None, True, 0),
    Case("says it, but exit 139", INVALID, _ended(139, REFUSED), None, True, 0),
    Case("says it, then a signal", INVALID, _ended(None, REFUSED, signal=6), None, True, 0),
    Case("says it, then hangs", INVALID, _ended(None, REFUSED, signal=9, over="time"), None, True, 0),
    Case("an exception", INVALID, _ended(1, b"Traceback\nValueError: 412\n"), None, True, 0),
    Case("nothing said", INVALID, _ended(1), None, True, 0),
    Case("said before the last line", INVALID, _ended(1, REFUSED + b"done\n"), None, True, 0),
    Case("a code that is not registered", INVALID, _ended(1, REFUSED.replace(b"412", b"499")), None, True, 0),
    Case("code as text", INVALID, _ended(1, REFUSED.replace(b"412", b'"412"')), None, True, 0),
    Case("code as a fraction", INVALID, _ended(1, REFUSED.replace(b"412", b"412.0")), None, True, 0),
    Case("not an object", INVALID, _ended(1, b"412\n"), None, True, 0),
    Case("deep JSON", INVALID, _ended(1, b"[" * 5000), None, True, 0),
    Case("not UTF-8", INVALID, _ended(1, b'\xff\n{"code": 412, "offset": 300}'), None, False, 3),
]

Read = Callable[[Ended, Path], Found]
Judge = Callable[[Manifest, Vector, Found, Path], Judgement]


def faults(folder: Path, read: Read, judge: Judge) -> list[str]:
    """The cases that a grader gets wrong."""
    manifest = Manifest("0.0.0", 0, {}, {}, (), folder)
    wrong = []
    for case in CASES:
        output = folder / "output"
        output.unlink(missing_ok=True)
        if case.output is not None:
            output.write_bytes(case.output)
        found = read(case.ended, output)
        judgement = judge(manifest, _vector(case.expectation), found, output)
        right = (found.result == "crashed", judgement.grade) == (case.crashed, case.grade)
        # What is wrong is said.
        if not right or bool(judgement.text) != (case.grade < 3):
            wrong.append(case.name)
    return wrong


def test_the_grader(tmp_path: Path) -> None:
    assert faults(tmp_path, grading.read, grading.judge) == []


# --- wrong graders ----------------------------------------------------------------------------------------------------


def _crash_is_refusal(ended: Ended, output: Path) -> Found:
    """Takes any crash for a refusal with the code that it finds."""
    found = grading.read(ended, output)
    return Found("rejected", 1, None, 412, 300) if found.result == "crashed" else found


def _signals_ignored(ended: Ended, output: Path) -> Found:
    status = (1 if ended.stderr else 0) if ended.status is None else ended.status
    return grading.read(replace(ended, signal=None, over=None, status=status), output)


def _bounds_ignored(ended: Ended, output: Path) -> Found:
    return grading.read(replace(ended, over=None), output)


def _any_failure_is_refusal(ended: Ended, output: Path) -> Found:
    return grading.read(replace(ended, status=ended.status and min(ended.status, 2)), output)


def _stderr_alone(ended: Ended, output: Path) -> Found:
    """Believes what stderr says, whatever the exit status."""
    return grading.read(replace(ended, status=1), output) if b"{" in ended.stderr else grading.read(ended, output)


def _any_line(ended: Ended, output: Path) -> Found:
    lines = [line for line in ended.stderr.splitlines() if line.startswith(b"{")]
    return grading.read(replace(ended, stderr=b"\n".join(lines) or ended.stderr), output)


def _status_alone(ended: Ended, output: Path) -> Found:
    """Takes exit status 1 for the refusal that is expected."""
    return Found("rejected", 1, None, 412, 300) if ended.status == 1 else grading.read(ended, output)


def _no_output_needed(ended: Ended, output: Path) -> Found:
    return Found("accepted", 0, None, digest=DIGEST) if ended.status == 0 else grading.read(ended, output)


def _accepts_all(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    return Judgement(3, "")


def _refuses_all(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    return Judgement(0, "no")


def _success_is_enough(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    """What many runners do: an exit status of 0 is right."""
    return Judgement(3, "") if found.status == 0 else grading.judge(manifest, vector, found, output)


def _any_refusal_is_right(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    return Judgement(3, "") if found.result == "rejected" else grading.judge(manifest, vector, found, output)


def _refusals_of_valid_files(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    refused = found.result == "rejected" and isinstance(vector.expectation, Accepted)
    return Judgement(3, "") if refused else grading.judge(manifest, vector, found, output)


def _offset_ignored(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    if isinstance(vector.expectation, Rejected) and found.result == "rejected":
        found = replace(found, offset=vector.expectation.offset)
    return grading.judge(manifest, vector, found, output)


def _status_ignored(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    status = 2 if vector.expectation == VERSION else 1
    return grading.judge(manifest, vector, replace(found, status=status), output)


def _silent(manifest: Manifest, vector: Vector, found: Found, output: Path) -> Judgement:
    return replace(grading.judge(manifest, vector, found, output), text="")


@pytest.mark.parametrize(
    ("read", "judge"),
    [
        *(
            (read, grading.judge)
            for read in (_crash_is_refusal, _signals_ignored, _bounds_ignored, _any_failure_is_refusal)
        ),
        *((read, grading.judge) for read in (_stderr_alone, _any_line, _status_alone, _no_output_needed)),
        *((grading.read, judge) for judge in (_accepts_all, _refuses_all, _success_is_enough, _any_refusal_is_right)),
        *((grading.read, judge) for judge in (_refusals_of_valid_files, _offset_ignored, _status_ignored, _silent)),
    ],
)
def test_a_wrong_grader_is_found(tmp_path: Path, read: Read, judge: Judge) -> None:
    assert faults(tmp_path, read, judge)
