"""What was seen of a decoder on a vector, in three numbers that can be compared with those of a planted bug."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import Any, NamedTuple

from refcodec.bitstream.reconstruction import PARTS

from ..runner.grading import GRADE_CODE, GRADE_VERDICT

# SPEC 9.3: what an output consists of, in its order; last the list of digests, which may be wrong by itself.
OUTPUT_PARTS = ("head", *PARTS, "digests")


class Verdict(IntEnum):
    """How an outcome is wrong."""

    RIGHT = 0
    REFUSED = 1
    ACCEPTED = 2
    OUTPUT = 3
    CODE = 4
    OFFSET = 5
    STATUS = 6
    CRASH = 7


WORDS = {
    Verdict.RIGHT: "right",
    Verdict.REFUSED: "a valid file is refused",
    Verdict.ACCEPTED: "a file is accepted that must be refused",
    Verdict.OUTPUT: "another output",
    Verdict.CODE: "another code",
    Verdict.OFFSET: "another offset",
    Verdict.STATUS: "another exit status",
    Verdict.CRASH: "a crash",
}


class Seen(NamedTuple):
    """What was seen on a vector.

    verdict: a Verdict. detail: of a refusal its code; of another output a bit for each of OUTPUT_PARTS that differs.
    exact: of a refusal its offset, or 2^32 - 1 if it has none; of another output the first 16 bits of its digest.
    """

    verdict: int
    detail: int = 0
    exact: int = 0


RIGHT = Seen(Verdict.RIGHT)
CRASH = Seen(Verdict.CRASH)
NO_OFFSET = (1 << 32) - 1


def refused(error: tuple[int, int] | None, code: int, offset: int | None) -> Seen:
    """A refusal. error: the code and the offset that are right, or None if the file is valid."""
    # A decoder may say any offset.
    place = offset if offset is not None and 0 <= offset < NO_OFFSET else NO_OFFSET
    if error is None:
        return Seen(Verdict.REFUSED, code, place)
    if code != error[0]:
        return Seen(Verdict.CODE, code, place)
    return RIGHT if offset == error[1] else Seen(Verdict.OFFSET, 0, place)


def accepted(error: tuple[int, int] | None, differing: Iterable[str], digest: str) -> Seen:
    """An output. error: as above. differing: the parts of OUTPUT_PARTS that are wrong. digest: hexadecimal."""
    if error is not None:
        return Seen(Verdict.ACCEPTED)
    mask = sum(1 << OUTPUT_PARTS.index(name) for name in set(differing))
    return Seen(Verdict.OUTPUT, mask, int(digest[:4], 16)) if mask else RIGHT


def at_grade(seen: Seen, grade: int) -> Seen:
    """What is seen where offsets (below grade 3) or codes (below grade 2) do not count."""
    lenient = {Verdict.OFFSET} if grade <= GRADE_CODE else set()
    if grade <= GRADE_VERDICT:
        lenient |= {Verdict.CODE, Verdict.STATUS}
    return RIGHT if seen.verdict in lenient else seen


def of_entry(entry: dict[str, Any], grade: int) -> Seen | None:
    """What a record says of a vector; None if it says nothing of decoding. grade: that the run demanded."""
    found, expected = entry["found"], entry["expected"]
    if found is None or expected["result"] == "gaussians":
        return None
    if found["result"] == "crashed":
        return CRASH
    error = (expected["code"], expected["offset"]) if expected["result"] == "rejected" else None
    if found["result"] == "accepted":
        return accepted(error, found["differing"], found["digest"])
    seen = refused(error, found["code"], found["offset"])
    if seen == RIGHT and entry["grade"] <= GRADE_VERDICT:
        # Code and offset are right, and the exit status is not.
        seen = Seen(Verdict.STATUS)
    return at_grade(seen, grade)
