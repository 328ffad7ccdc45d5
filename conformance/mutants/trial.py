"""One wrong decoder on vectors, in a process of bounded time and memory: whatever it does has an outcome."""

import json
import os
import resource
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ..spec_decoder import PARTS, Names, verdict
from . import loading
from .mutant import Mutant

# What the interpreter has taken before a file is looked at, in bytes of address space.
INTERPRETER_BYTES = 128 << 20


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
    # For a mistake that is made in some files only.
    names["FILE"] = data
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
        outcomes = [Outcome(**json.loads(line)) for line in lines if line.endswith("\n")]
    _, status = os.waitpid(pid, 0)
    if len(outcomes) == len(cases) or _stops(stop, cases, outcomes):
        return outcomes
    hang = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF
    return [*outcomes, HANG if hang else Outcome("crash", text=f"status {status}")]


def _stops(stop: Grade | None, cases: Sequence[Case], outcomes: Sequence[Outcome]) -> bool:
    return bool(stop and outcomes and stop(cases[len(outcomes) - 1], outcomes[-1]))


def outcomes(mutant: Mutant | None, cases: Sequence[Case], stop: Grade | None = None) -> list[Outcome]:
    """Returns the outcome of each case, in order; with `stop` only up to the first that this judges to be wrong.

    To be called in a process of one thread, which is forked.
    """
    every: list[Outcome] = []
    while len(every) < len(cases) and not _stops(stop, cases, every):
        every += _fork(mutant, cases[len(every) :], stop)
    return every
