"""One wrong decoder on vectors, in a process of bounded time and memory: whatever it does has an outcome."""

from __future__ import annotations

import gc
import json
import os
import resource
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import CodeType, FrameType

from ..spec_decoder import PARTS, Names, verdict
from . import loading
from .mutant import PATH, Mutant

# What the interpreter has taken before a file is looked at, in bytes of address space.
INTERPRETER_BYTES = 128 << 20
# More than this a vector's cost is not told apart.
MOST_CALLS = 1 << 18


@dataclass(frozen=True)
class Case:
    """A vector as a trial needs it.

    digests: hexadecimal, those of the parts by name (SPEC 9.3), and of all as "whole"; empty if the file is to be
    refused. error: the code and the offset of that refusal, else None. requirements: what the vector is for. seconds:
    of processor time.
    """

    id: str
    data: bytes
    digests: dict[str, str]
    error: tuple[int, int] | None
    requirements: frozenset[str]
    seconds: float
    bytes: int


@dataclass(frozen=True)
class Outcome:
    """What a decoder did with a file. kind: accepted (digests), rejected (code, offset), crash (text) or hang."""

    kind: str
    digests: dict[str, str] = field(default_factory=dict)
    code: int = 0
    offset: int = 0
    text: str = ""


HANG = Outcome("hang")
Grade = Callable[[Case, Outcome], str | None]


def grade(case: Case, outcome: Outcome) -> str | None:
    """What is wrong with an outcome, or None if it is what the vector demands. A crash is never a refusal."""
    if outcome.kind in ("crash", "hang"):
        return f"{outcome.kind} {outcome.text}".strip()
    if case.error is None:
        if outcome.kind == "rejected":
            return f"refused with {outcome.code} at {outcome.offset}"
        return None if outcome.digests == case.digests else "another digest"
    if outcome.kind == "accepted":
        return f"accepted, not {case.error[0]}"
    if outcome.code != case.error[0]:
        return f"{outcome.code}, not {case.error[0]}"
    return None if outcome.offset == case.error[1] else f"{outcome.code} at {outcome.offset}, not {case.error[1]}"


def decode(names: Names, data: bytes) -> Outcome:
    """Returns what a loaded decoder does with a file. Raises what the decoder raises besides its own refusal."""
    result, error = verdict(names, data)
    if error:
        return Outcome("rejected", code=int(names["ERRORS"][error[0]][0]), offset=int(error[1]))
    assert result is not None
    digests = dict(zip(("whole", *PARTS), (result["scene"], *result["parts"]), strict=False))
    return Outcome("accepted", digests={name: bytes(digest).hex() for name, digest in digests.items()})


def _child(write: int, mutant: Mutant | None, cases: Sequence[Case], stop: Grade | None) -> None:
    """Writes a line of JSON for each case. The timer counts processor time, and ends a call of C too."""
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    with os.fdopen(write, "w", encoding="utf-8") as out:
        decoder, broken = None, Outcome("crash")
        signal.setitimer(signal.ITIMER_PROF, cases[0].seconds)
        try:
            decoder = loading.load(mutant)
        except (Exception, SystemExit) as error:
            broken = Outcome("crash", text=type(error).__name__)
        for case in cases:
            outcome = broken
            signal.setitimer(signal.ITIMER_PROF, case.seconds)
            resource.setrlimit(resource.RLIMIT_AS, (case.bytes + INTERPRETER_BYTES, resource.RLIM_INFINITY))
            if decoder is not None:
                try:
                    outcome = decode(decoder, case.data)
                except (Exception, SystemExit) as error:  # whatever it is, it is the decoder's fault
                    outcome = Outcome("crash", text=type(error).__name__)
            print(json.dumps(vars(outcome)), file=out, flush=True)
            if stop and stop(case, outcome):
                return


def _fork(mutant: Mutant | None, cases: Sequence[Case], stop: Grade | None) -> list[Outcome]:
    """The outcomes up to the case that ends the child, if one does."""
    read, write = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            os.close(read)
            _child(write, mutant, cases, stop)
        finally:
            # Nothing of the parent is run, whatever has been raised.
            os._exit(0)
    os.close(write)
    with os.fdopen(read, encoding="utf-8") as lines:
        found = [Outcome(**json.loads(line)) for line in lines if line.endswith("\n")]
    _, status = os.waitpid(pid, 0)
    if len(found) == len(cases) or (found and stop and stop(cases[len(found) - 1], found[-1])):
        return found
    hang = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF
    return [*found, HANG if hang else Outcome("crash", text=f"status {status}")]


def outcomes(mutant: Mutant | None, cases: Sequence[Case], stop: Grade | None = None) -> list[Outcome]:
    """The outcome of each case, in order; with `stop` only up to the first that it finds wrong.

    To be called in a process of one thread, which is forked.
    """
    found: list[Outcome] = []
    while len(found) < len(cases) and not (found and stop and stop(cases[len(found) - 1], found[-1])):
        found += _fork(mutant, cases[len(found) :], stop)
    return found


class _EnoughError(Exception):
    """MOST_CALLS have been counted."""


def visit(data: bytes) -> tuple[int, frozenset[str] | None]:
    """How many calls the unchanged decoder makes for a file, and of what functions: a vector's cost on any machine.

    Beyond MOST_CALLS it is not counted further; None stands for all functions then.
    """
    decoder, calls = loading.load(None), 0
    codes: set[CodeType] = set()

    def count(frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")
        codes.add(frame.f_code)
        if calls == MOST_CALLS:
            raise _EnoughError

    # The collector comes when it likes, and may call what others have hung on it.
    gc.disable()
    sys.setprofile(count)
    try:
        decode(decoder, data)
    except _EnoughError:
        return calls, None
    finally:
        sys.setprofile(None)
        gc.enable()
    return calls, frozenset(code.co_qualname for code in codes if code.co_filename == PATH)
