"""A table of outcomes for the grader. Graders with planted faults fail on it."""

import hashlib
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from msgspec import structs

from conformance.manifest import Accepted, Budget, Generator, Input, Manifest, Rejected, Vector
from conformance.runner import grading
from conformance.runner.grading import Found, Judgement
from conformance.runner.process import Ended
from refcodec.bitstream import syntax
from refcodec.bitstream.dimensions import Dimensions, dimension_fields

# SPEC 9.3: of two anchors with K = 1, F = 3, ch = 1 and B = 2, and of one weight.
PARTS = [bytes([number]) * size for number, size in enumerate((24, 2, 40, 24, 48, 24, 4))]
_DIMENSIONS = dimension_fields(Dimensions(1, (1, 2), 1, 0, 2, (), (1,), (), 1))
HEAD = b"C3GSREC1" + struct.pack("<I", 2) + bytes(24) + syntax.build("Dimensions", _DIMENSIONS)
LISTED = HEAD + b"".join(hashlib.sha256(part).digest() for part in PARTS)
OUTPUT = LISTED + b"".join(PARTS)
DIGEST = hashlib.sha256(LISTED).hexdigest()
REFUSED = b'a line of talk\n{"code": 412, "name": "weights.not_finite", "offset": 300}\n'
NEW_VERSION = b'{"code": 104, "offset": 8}\n'
INVALID = Rejected(412, "weights.not_finite", 300, "6.8")
VERSION = Rejected(104, "prologue.version", 8, "6.1")
VALID = Accepted(DIGEST, {}, "")


MADE = Generator("test", 0)


def _vector(expectation: Accepted | Rejected) -> Vector:
    where = Input("valid/x.c3gs", 1, "0" * 64)
    return Vector("x", "x", "decode", "valid", "tiny", 0, (), (), (), where, expectation, Budget(1, 1), "CC0-1.0", MADE)


@dataclass(frozen=True)
class Case:
    """The end of a process and its output file, if any; whether this is a crash of a vector, and the grade."""

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
    Case("wrong first part", VALID, _ended(0), LISTED + b"!" * 24 + OUTPUT[len(LISTED) + 24 :], False, 0),
    Case("wrong digest of a part", VALID, _ended(0), LISTED[:-1] + b"!" + OUTPUT[len(LISTED) :], False, 0),
    Case("wrong head", VALID, _ended(0), OUTPUT[:8] + b"\3" + OUTPUT[9:], False, 0),
    Case("head and digests alone", VALID, _ended(0), LISTED, False, 0),
    Case("wrong dimensions", VALID, _ended(0), HEAD[:36] + b"\2" + OUTPUT[37:], False, 0),
    Case("an output that is cut in its head", VALID, _ended(0), HEAD[:-3], False, 0),
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
    Case("deep JSON, whole", INVALID, _ended(1, b'{"code": 412, "a": %b}' % (b"[" * 99 + b"]" * 99)), None, True, 0),
    Case("a long code", INVALID, _ended(1, b'{"code": ' + b"9" * 4000 + b"}"), None, True, 0),
    Case("a long offset", INVALID, _ended(1, REFUSED.replace(b"300", b"9" * 4000)), None, True, 0),
    Case("a large offset", INVALID, _ended(1, REFUSED.replace(b"300", b"9" * 40)), None, False, 2),
    Case("a code twice", INVALID, _ended(1, b'{"code": 413, "code": 412, "offset": 300}'), None, True, 0),
    Case("not UTF-8", INVALID, _ended(1, b'\xff\n{"code": 412, "offset": 300}'), None, False, 3),
]

Read = Callable[[Ended, Path], Found]
Judge = Callable[[Manifest, Vector, Found, Path], Judgement]


def faults(folder: Path, read: Read, judge: Judge) -> list[str]:
    """Returns the names of the cases that a grader judges wrongly."""
    manifest = Manifest("0.0.0", 0, {}, {}, (), folder)
    wrong = []
    for case in CASES:
        output = folder / "output"
        output.unlink(missing_ok=True)
        if case.output is not None:
            output.write_bytes(case.output)
        answer = read(case.ended, output)
        judgement = judge(manifest, _vector(case.expectation), answer, output)
        right = (answer.result == "crashed", judgement.grade) == (case.crashed, case.grade)
        # Every fault has a text.
        if not right or bool(judgement.text) != (case.grade < 3):
            wrong.append(case.name)
    return wrong


def test_the_grader(tmp_path: Path) -> None:
    assert faults(tmp_path, grading.read, grading.judge) == []


# --- wrong graders ----------------------------------------------------------------------------------------------------

REFUSAL = Found("rejected", 1, None, 412, 300)


def _any_line(ended: Ended, output: Path) -> Found:
    lines = [line for line in ended.stderr.splitlines() if line.startswith(b"{")]
    return grading.read(replace(ended, stderr=b"\n".join(lines) or ended.stderr), output)


def _signals_ignored(ended: Ended, output: Path) -> Found:
    status = (1 if ended.stderr else 0) if ended.status is None else ended.status
    return grading.read(replace(ended, signal=None, over=None, status=status), output)


READERS: dict[str, Read] = {
    "any crash is the expected refusal": lambda e, o: (
        REFUSAL if (found := grading.read(e, o)).result == "crashed" else found
    ),
    "signals are ignored": _signals_ignored,
    "bounds are ignored": lambda e, o: grading.read(replace(e, over=None), o),
    "any failure is a refusal": lambda e, o: grading.read(replace(e, status=e.status and min(e.status, 2)), o),
    "the exit status is ignored": lambda e, o: grading.read(replace(e, status=1) if b"{" in e.stderr else e, o),
    "any line of stderr counts": _any_line,
    "only the exit status counts": lambda e, o: REFUSAL if e.status == 1 else grading.read(e, o),
    "no output is needed": lambda e, o: (
        Found("accepted", 0, None, digest=DIGEST) if e.status == 0 else grading.read(e, o)
    ),
}


def _right_if(condition: Callable[[Vector, Found], bool]) -> Judge:
    """A judge that passes whatever meets a condition."""
    return lambda m, v, f, o: Judgement(3, "") if condition(v, f) else grading.judge(m, v, f, o)


def _offset_ignored(manifest: Manifest, vector: Vector, answer: Found, output: Path) -> Judgement:
    if isinstance(vector.expectation, Rejected) and answer.result == "rejected":
        answer = structs.replace(answer, offset=vector.expectation.offset)
    return grading.judge(manifest, vector, answer, output)


JUDGES: dict[str, Judge] = {
    "all is right": _right_if(lambda v, f: True),
    "all is wrong": lambda m, v, f, o: Judgement(0, "no"),
    "exit status 0 is right": _right_if(lambda v, f: f.status == 0),
    "any refusal is right": _right_if(lambda v, f: f.result == "rejected"),
    "refusals of valid files are right": _right_if(
        lambda v, f: f.result == "rejected" and isinstance(v.expectation, Accepted)
    ),
    "offsets are ignored": _offset_ignored,
    "the exit status is ignored": lambda m, v, f, o: grading.judge(
        m, v, structs.replace(f, status=2 if v.expectation == VERSION else 1), o
    ),
    "faults have no text": lambda m, v, f, o: replace(grading.judge(m, v, f, o), text=""),
}
GRADERS = {name: (read, grading.judge) for name, read in READERS.items()}
GRADERS |= {f"judge: {name}": (grading.read, judge) for name, judge in JUDGES.items()}


@pytest.mark.parametrize("name", GRADERS)
def test_a_wrong_grader_is_found(tmp_path: Path, name: str) -> None:
    assert faults(tmp_path, *GRADERS[name])
