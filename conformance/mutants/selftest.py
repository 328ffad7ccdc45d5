"""The suite tested: do its vectors catch every planted bug, and does the grader catch every wrong decoder?"""

from __future__ import annotations

import ast
import multiprocessing
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from multiprocessing.pool import Pool
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

from conformance.manifest import Accepted, Manifest, ManifestError, Rejected, load

from . import handwritten, operators, record
from .equivalent import PROOFS
from .loading import changed
from .loading import load as load_decoder
from .mutant import Mutant
from .record import Caught
from .trial import Case, Grade, Outcome, grade, outcomes, visit

T = TypeVar("T")


class SelfTestError(Exception):
    """The self-test says nothing: there are no vectors, the unchanged decoder fails, or the grader is wrong."""


@cache
def decoder(mutant: Mutant) -> tuple[str, str]:
    """Returns the place of a mutant and its syntax tree there, as text. Mutants with the same ones are the same."""
    return mutant.place, ast.dump(ast.parse(mutant.statement))


@cache
def mutants() -> tuple[Mutant, ...]:
    """All planted bugs. Those by hand come first, and one of the operators that is one of these is left out."""
    hand = handwritten.bugs()
    known = {decoder(mutant) for mutant in hand}
    return *hand, *(mutant for mutant in operators.sample() if decoder(mutant) not in known)


def cases(manifest: Manifest) -> list[Case]:
    """The vectors that a decoder is judged by, without those of cameras."""
    found = []
    for vector in manifest.vectors:
        if vector.operation == "decode":
            expected = vector.expectation
            digests, error = {}, None
            if isinstance(expected, Accepted):
                # The second decoder does not tell the head's.
                digests = {
                    "whole": expected.digest,
                    **{name: value for name, value in expected.parts.items() if name != "head"},
                }
            elif isinstance(expected, Rejected):
                error = expected.code, expected.offset
            data, proves = manifest.path(vector).read_bytes(), frozenset(vector.requirements)
            found.append(Case(vector.id, data, digests, error, proves, vector.budget.seconds, vector.budget.bytes))
    if not found:
        raise SelfTestError("there is no vector to test with")
    return found


# --- the grader tested ------------------------------------------------------------------------------------------------


def fakes() -> list[Mutant]:
    """Returns programs that do not decode. Each vector must catch each of them."""
    bodies = {
        "raises": "raise ValueError",
        "exits": "raise SystemExit(1)",
        "ends": "import os; os._exit(1)",
        "kills-itself": "import os; os.kill(os.getpid(), 9)",
        "hangs": "while True: pass",
        "takes-all-memory": "return bytearray(1 << 40)",
        "accepts-everything": "return {'scene': b'', 'parts': [b''] * 7}",
        "refuses-everything": "raise Refused('section.crc', 1)",
        "refuses-without-code": "raise Refused('no.such', 0)",
        "does-not-load": "return (",
    }
    text = "ERRORS = {'section.crc': (312,)}\nclass Refused(Exception): pass\ndef DECODE_FILE(data):\n    {}\n"
    return [
        Mutant(name, "DECODE_FILE", 1, "", body, "no decoder", text.replace("{}", body))
        for name, body in bodies.items()
    ]


def demanded(case: Case) -> Outcome:
    """The outcome that a vector demands."""
    if case.error is None:
        return Outcome("accepted", digests=case.digests)
    return Outcome("rejected", code=case.error[0], offset=case.error[1])


def near_misses(case: Case) -> list[Outcome]:
    """Outcomes that are nearly what a vector demands, and wrong."""
    right = demanded(case)
    # A decoder that says the right thing and then crashes, or never ends, has not said it.
    wrong = [
        replace(right, kind="crash"),
        replace(right, kind="hang"),
        Outcome("accepted"),
        Outcome("accepted", digests={"whole": "0" * 64}),
    ]
    code, offset = case.error or (307, 0)
    return [
        *wrong,
        Outcome("rejected", code=code + 1, offset=offset),
        Outcome("rejected", code=code, offset=offset + 1),
    ]


def check_grader(all_cases: Sequence[Case], judge: Grade) -> None:
    """SelfTestError if the grader lets a wrong outcome pass, or no right one."""
    for case in all_cases:
        if judge(case, demanded(case)):
            raise SelfTestError(f"the grader refuses what {case.id} demands")
        for outcome in near_misses(case):
            if not judge(case, outcome):
                raise SelfTestError(f"the grader takes {outcome} for what {case.id} demands")


# --- processes --------------------------------------------------------------------------------------------------------

# Vectors for which the unchanged decoder is loaded once.
BATCH = 8
# Seconds of processor time: more than any budget has, and what a decoder that is none is given.
SECONDS, FAKE_SECONDS = 3600.0, 0.2

_cases: dict[str, Case] = {}


def _start(all_cases: Sequence[Case]) -> None:
    # Ctrl-C is for the parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _cases.update((case.id, case) for case in all_cases)
    # What is compiled here is not compiled again in each child.
    load_decoder(None)


def _try(task: tuple[Mutant | None, list[str]], stop: Grade | None, seconds: float) -> list[Outcome]:
    mutant, names = task
    found = [_cases[name] for name in names]
    return outcomes(mutant, [replace(case, seconds=min(case.seconds, seconds)) for case in found], stop)


def _visit(name: str) -> tuple[int, frozenset[str] | None]:
    return visit(_cases[name].data)


def _progress(found: Iterable[T], total: int, what: str) -> Iterable[T]:
    bar: Iterable[T] = tqdm(found, total=total, desc=what, unit="", file=sys.stderr, leave=False)
    return bar


class Trials:
    """Decoders tried on vectors, by processes of one thread each, which may be forked."""

    def __init__(self, pool: Pool, all_cases: Sequence[Case], judge: Grade) -> None:
        self._pool = pool
        self._judge = judge
        self._by_name = {case.id: case for case in all_cases}

    def tries(
        self,
        tasks: Sequence[tuple[Mutant | None, list[str]]],
        what: str,
        *,
        first_only: bool = False,
        seconds: float = SECONDS,
    ) -> Iterator[list[tuple[str, str]]]:
        """For each task, a decoder and vectors: the vectors that catch it, and what was wrong.

        first_only: the first of them alone. seconds: bounds those of the vectors' budgets.
        """
        # The judge is always asked here too: one of a test's own may not be known to the processes.
        found = self._pool.imap(partial(_try, stop=grade if first_only else None, seconds=seconds), tasks)
        for (_, names), made in zip(tasks, _progress(found, len(tasks), what), strict=True):
            judged = [
                (name, self._judge(self._by_name[name], outcome)) for name, outcome in zip(names, made, strict=False)
            ]
            yield [(name, wrong) for name, wrong in judged if wrong]

    def check_decoder(self) -> None:
        """SelfTestError if the second decoder itself fails a vector."""
        names = list(self._by_name)
        tasks = [(None, names[i : i + BATCH]) for i in range(0, len(names), BATCH)]
        for wrong in self.tries(tasks, "the unchanged decoder"):
            for name, text in wrong:
                raise SelfTestError(f"the second decoder, unchanged, fails {name}: {text}")

    def check_fakes(self) -> None:
        """SelfTestError if a decoder that is none passes the first vector that accepts, or the first that refuses."""
        first = [
            next((c.id for c in self._by_name.values() if (c.error is None) == accepts), None)
            for accepts in (True, False)
        ]
        names = [name for name in first if name]
        made = fakes()
        found = self.tries([(fake, names) for fake in made], "decoders that are none", seconds=FAKE_SECONDS)
        for fake, wrong in zip(made, found, strict=True):
            if len(wrong) != len(names):
                raise SelfTestError(f"a decoder that {fake.id} passes one of {names}")

    def order(self, made: Sequence[Mutant]) -> dict[str, list[str]]:
        """For each mutant the vectors that can catch it.

        Those for a requirement that it breaks come before the others, and of both the cheapest first. The cost is
        counted in calls of the unchanged decoder, which are the same on every machine. A vector for which that does
        not call what the mutant changes is left out: the mutant passes it.
        """
        names = list(self._by_name)
        visits = list(_progress(self._pool.imap(_visit, names), len(names), "the vectors' costs"))
        return {
            m.id: likely(m, [(*seen, self._by_name[name]) for name, seen in zip(names, visits, strict=True)])
            for m in made
        }


def likely(mutant: Mutant, visits: Sequence[tuple[int, frozenset[str] | None, Case]]) -> list[str]:
    """The order of Trials.order, for one mutant; visits: calls, functions called (None: any), case."""
    places, broken = changed(mutant), set(mutant.requirements)

    def reached(called: frozenset[str] | None) -> bool:
        return places is None or called is None or bool(places & called)

    found = [(not broken & case.requirements, calls, case.id) for calls, called, case in visits if reached(called)]
    return [name for *_, name in sorted(found)]


@contextmanager
def trials(all_cases: Sequence[Case], jobs: int, judge: Grade = grade) -> Iterator[Trials]:
    """Trials whose grader, decoder and treatment of crashes have been checked; SelfTestError if one is wrong."""
    check_grader(all_cases, judge)
    with multiprocessing.get_context("spawn").Pool(jobs, _start, (all_cases,)) as pool:
        made = Trials(pool, all_cases, judge)
        made.check_fakes()
        made.check_decoder()
        yield made


# --- the score --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """What the vectors make of the bugs.

    caught: bug -> (first vector, what was wrong). survivors: bugs that no vector catches. refuted: proved to be none,
    and caught.
    """

    caught: Caught
    survivors: list[Mutant]
    refuted: list[str]

    @property
    def right(self) -> bool:
        """Whether the suite catches all, and no proof is wrong."""
        return not self.survivors and not self.refuted


def score(made: Sequence[Mutant], catchers: Mapping[str, Sequence[tuple[str, str]]]) -> Score:
    """The score; catchers: for each bug the vectors that catch it, in order."""
    caught = {m.id: catchers[m.id][0] for m in made if catchers[m.id]}
    survivors = [m for m in made if m.id not in caught and m.id not in PROOFS]
    return Score(caught, survivors, [m.id for m in made if m.id in caught and m.id in PROOFS])


def show(result: Score, made: Sequence[Mutant]) -> None:
    """Prints the score and what is wrong."""
    bugs = [m for m in made if m.id not in PROOFS]
    for m in result.survivors:
        print(f"survivor: {m.id}, {m.place}, line {m.line}: {m.what}\n  {m.old!r}\n  {m.new!r}")
    for name in result.refuted:
        print(f"no equivalent: {name} is caught by {result.caught[name][0]}: {result.caught[name][1]}")
    hand, caught = sum(bool(m.requirements) for m in bugs), len(bugs) - len(result.survivors)
    share = 100 * caught / len(bugs)
    print(f"{len(bugs)} planted bugs, {hand} by hand, {len(bugs) - hand} by operators: {caught} caught, {share:.1f} %")


def run(manifest: Path, jobs: int, recorded: bool, write: bool) -> int:
    """Tries every planted bug on the vectors until one catches it, and prints the score.

    recorded: tries each bug only on the vector that is recorded as the first to catch it. write: renews the record.
    Returns 0 if all are caught, else 1. Raises ManifestError and OSError for the manifest.
    """
    suite = load(manifest)
    bugs: Sequence[Mutant] = mutants()
    known = record.read() if recorded else {}
    try:
        wanted = {vector for vector, _ in known.values()}
        all_cases = [c for c in cases(suite) if not recorded or c.id in wanted]
        missing = wanted - {c.id for c in all_cases}
        if missing:
            raise ManifestError(f"{manifest}: vectors of the record are missing: {', '.join(sorted(missing)[:3])}")
        with trials(all_cases, jobs) as test:
            if recorded:
                bugs = [m for m in bugs if m.id in known]
                order = {m.id: [known[m.id][0]] for m in bugs}
            else:
                order = test.order(bugs)
            tries = test.tries([(m, order[m.id]) for m in bugs], "planted bugs", first_only=True)
            catchers = {m.id: wrong for m, wrong in zip(bugs, tries, strict=True)}
    except SelfTestError as error:
        print(error, file=sys.stderr)
        return 1
    result = score(bugs, catchers)
    if write:
        record.write(bugs, result.caught)
    show(result, bugs)
    return 0 if result.right else 1
