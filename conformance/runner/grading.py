"""Reads a decoder's answer to a vector, and judges it.

A decoder accepts with exit status 0 and an output file. It refuses with exit status 1 (malformed, invalid) or 2
(unsupported), and with a JSON object with a registered code as the last line of stderr. Anything else is a crash, and a
crash never passes.
"""

import hashlib
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import construct as cs

from refcodec import statuses
from refcodec.bitstream import syntax
from refcodec.bitstream.dimensions import dimensions_of, weight_count
from refcodec.bitstream.errors import REGISTRY
from refcodec.bitstream.reconstruction import DIGEST_MAGIC, LATER_MAGIC, part_names
from refcodec.files.documents import DocumentError, parse_json

from ..manifest import (
    Accepted,
    Expectation,
    GaussiansOf,
    ImageOf,
    Manifest,
    ManifestError,
    Rejected,
    Sha256,
    Strict,
    Undrawn,
    Vector,
)
from .folder import FileError, open_file
from .gaussians import difference
from .process import Ended

# The grades of a vector (SPEC 15.4). 1: the right verdict and output. 2: also the right code. 3: also the right offset.
GRADE_NONE, GRADE_VERDICT, GRADE_CODE, GRADE_EXACT = range(4)
GRADES = {
    GRADE_NONE: "a wrong verdict, a wrong output or a crash",
    GRADE_VERDICT: "right verdicts and outputs",
    GRADE_CODE: "right verdicts, outputs and codes",
    GRADE_EXACT: "right verdicts, outputs, codes and offsets",
}
# The reasons why a process crashed, by the names in process.Ended.over.
OVER = {
    "time": "took too long",
    "memory": "took too much memory",
    "output": "wrote too much",
    "start": "could not be started",
    "left": "left processes that could not be ended",
    "answer": "gave an answer that cannot be read",
}
# More bytes than the digest of any scene covers (SPEC 9.3).
_DIGESTED_MAX = 4096
# The bytes of one read of an output.
_BLOCK = 1 << 20
# The longest valid last line of stderr, in characters.
_LINE = 8 << 10
BY_CODE = {kind.code: kind for kind in REGISTRY.values()}


class Found(Strict, frozen=True):
    """The answer of a decoder.

    result: "accepted", "rejected" or "crashed". status, signal: of the process. code, offset: of a rejection; the
    offset is None if it is missing. digest: of an accepted output (read_output). text: the reason of a crash.
    differing: the wrong parts of an accepted output in their order; "digests" if only the list of digests is wrong.
    """

    result: Literal["accepted", "rejected", "crashed"]
    status: int | None
    signal: int | None
    code: int | None = None
    offset: int | None = None
    digest: Sha256 | None = None
    text: str = ""
    differing: tuple[str, ...] = ()


@dataclass(frozen=True)
class Judgement:
    """grade: 0 to 3. text: the fault, empty if there is none."""

    grade: int
    text: str


def exit_status(klass: str) -> int:
    """Returns the exit status of a refusal with an error of a class (SPEC 10.2)."""
    return statuses.UNSUPPORTED if klass == "unsupported" else statuses.REJECTED


def signal_name(number: int) -> str:
    """Returns the name of a signal, such as SIGSEGV."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _refusal(line: str) -> tuple[int, int | None] | str:
    """Returns code and offset of the last line of stderr, or its fault in words."""
    try:
        error: Any = parse_json(line, _LINE)
    except DocumentError:
        return "whose last line of stderr is not JSON"
    if not isinstance(error, dict) or type(error.get("code")) is not int:
        return "whose last line of stderr is not an object with a code"
    if error["code"] not in BY_CODE:
        return f"with a code, {error['code']}, that is not registered"
    offset = error.get("offset")
    return error["code"], offset if type(offset) is int else None


@dataclass(frozen=True)
class Output:
    """The digests of an output. digest: of the scene. parts: of the parts and the head, by name."""

    digest: str
    parts: dict[str, str]


def read_output(file: BinaryIO) -> Output:
    """Returns the digests of the scene in an output and of its parts (SPEC 9.3).

    An output begins with a list of the digests of the parts, which the digest of the scene covers; the parts follow. If
    the list and the parts disagree, the digest is the SHA-256 of a zero and the output, which no scene has.
    """
    start = file.read(_DIGESTED_MAX)
    at, names = len(DIGEST_MAGIC) + 4, part_names(0)
    try:
        render, size = syntax.parse("RenderInfo", start, at)
        at, names = at + size, part_names(render.render_model)
        d, size = syntax.parse("Dimensions", start, at)
        size += 32 if start.startswith(LATER_MAGIC) else 0
    except cs.ConstructError:
        size = len(start)
    head, listed = start[: at + size], start[: at + size + 32 * len(names)]
    whole = hashlib.sha256(b"\0" + listed)
    parts = {"head": hashlib.sha256(head).hexdigest()}
    if len(listed) < at + size + 32 * len(names):
        return Output(whole.hexdigest(), parts)
    file.seek(len(listed))
    n = int.from_bytes(start[len(DIGEST_MAGIC) :][:4], "little")
    k, f, ch, b = d.offset_count, sum(d.slice_width), d.plane_channels, d.plane_size
    sizes = [12 * n, n * k, 2 * 5 * ch * b * b, 4 * n * f, 24 * n, 12 * n * k, 4 * weight_count(dimensions_of(d))]
    content = head
    for number, name in enumerate(names):
        # The last part has no stated size.
        left = sizes[number] if number < len(names) - 1 else None
        digest = hashlib.sha256()
        while block := file.read(_BLOCK if left is None else min(_BLOCK, left)):
            digest.update(block)
            whole.update(block)
            left = None if left is None else left - len(block)
        content += digest.digest()
        parts[name] = digest.hexdigest()
    return Output(hashlib.sha256(listed).hexdigest() if content == listed else whole.hexdigest(), parts)


def read(ended: Ended, output: Path, expected: Expectation | None = None) -> Found:
    """Returns the answer of a process from its end and its output file. expected: of the vector.

    A renderer that does not draw ends with any exit status but 0.
    """

    def crash(text: str) -> Found:
        return Found("crashed", ended.status, ended.signal, text=text)

    if ended.over:
        return crash(OVER[ended.over])
    if ended.signal is not None:
        return crash(f"ended by {signal_name(ended.signal)}")
    if isinstance(expected, GaussiansOf | ImageOf | Undrawn) and ended.status != statuses.DONE:
        return Found("rejected", ended.status, None)
    if ended.status == statuses.DONE:
        try:
            with open_file(output) as file:
                content = read_output(file)
        except FileNotFoundError:
            return crash("exit status 0 without an output file")
        except FileError as error:
            return crash(f"its output {error}")
        wrong: tuple[str, ...] = ()
        if isinstance(expected, Accepted) and content.digest != expected.digest:
            wrong = tuple(n for n, digest in expected.parts.items() if content.parts.get(n) != digest) or ("digests",)
        return Found("accepted", ended.status, None, digest=content.digest, differing=wrong)
    if ended.status not in (statuses.REJECTED, statuses.UNSUPPORTED):
        return crash(f"exit status {ended.status}")
    last = ended.stderr.strip().splitlines()[-1:]
    refusal = _refusal(b"".join(last).decode("utf-8", "replace"))
    if isinstance(refusal, str):
        return crash(f"exit status {ended.status}, {refusal}")
    return Found("rejected", ended.status, None, *refusal)


def _describe(code: int) -> str:
    kind = BY_CODE[code]
    return f"{code} {kind.name}, {kind.klass}"


def _judge_refusal(expected: Rejected, answer: Found) -> Judgement:
    if answer.result != "rejected" or answer.code is None:
        return Judgement(GRADE_NONE, f"accepted; {_describe(expected.code)}, at byte {expected.offset} expected")
    wanted = exit_status(BY_CODE[expected.code].klass)
    where = "no offset" if answer.offset is None else f"byte {answer.offset}"
    text = f"{_describe(answer.code)}, {where}; {_describe(expected.code)}, byte {expected.offset} expected"
    if answer.status != wanted:
        return Judgement(GRADE_VERDICT, f"exit status {answer.status}, {wanted} expected; {text}")
    if answer.code != expected.code:
        return Judgement(GRADE_VERDICT, text)
    if answer.offset != expected.offset:
        return Judgement(GRADE_CODE, text)
    return Judgement(GRADE_EXACT, "")


def judge(manifest: Manifest, vector: Vector, answer: Found, output: Path) -> Judgement:
    """Compares a decoder's answer and its output file with the expectation of a vector."""
    if answer.result == "crashed":
        return Judgement(GRADE_NONE, f"crash: {answer.text}")
    if isinstance(vector.expectation, Undrawn):
        drawn = answer.result == "accepted"
        return Judgement(GRADE_NONE, "drawn, although no renderer may") if drawn else Judgement(GRADE_EXACT, "")
    if isinstance(vector.expectation, Rejected):
        return _judge_refusal(vector.expectation, answer)
    if answer.result == "rejected" and answer.code is None:
        return Judgement(GRADE_NONE, f"not drawn: exit status {answer.status}")
    if answer.result == "rejected":
        assert answer.code is not None
        return Judgement(GRADE_NONE, f"refused with {_describe(answer.code)}; the file is valid")
    if isinstance(vector.expectation, Accepted):
        if answer.digest != vector.expectation.digest:
            return Judgement(GRADE_NONE, "the output is not the canonical reconstruction")
        return Judgement(GRADE_EXACT, "")
    return _judge_seen(manifest, vector.expectation, output, "G14.6-1" in vector.requirements)


def _judge_seen(manifest: Manifest, expected: GaussiansOf | ImageOf, output: Path, static: bool) -> Judgement:
    """Compares a list of Gaussians or an image. static: whether the list is of a static scene."""
    try:
        wanted = (manifest.folder / expected.path).read_bytes()
    except OSError as error:
        raise ManifestError(f"{expected.path}: {error.strerror}") from None
    try:
        with open_file(output) as file:
            if isinstance(expected, ImageOf):
                # Only images need numpy, which is slow to import.
                from .images import image_difference  # noqa: PLC0415

                wrong = image_difference(wanted, file.read(len(wanted) + 1))
            else:
                wrong = difference(wanted, file.read(), expected.tolerance, static)
    except (ValueError, OverflowError) as error:
        wrong = f"the output is no list of Gaussians ({type(error).__name__})"
    return Judgement(GRADE_NONE, wrong) if wrong else Judgement(GRADE_EXACT, "")
