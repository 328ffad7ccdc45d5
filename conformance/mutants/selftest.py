"""The suite tested: do its vectors catch every planted bug, and does the grader catch every wrong decoder?"""

import json
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

from conformance.manifest import Accepted, Manifest, Rejected, load
from refcodec.files.stage import write_file
from refcodec.files.terminal import bar_options

from . import handwritten, misreadings, operators
from .exempt import GAPS, PROOFS
from .loading import unchanged
from .mutant import Mutant, around, definitions, planted, span
from .trial import Case, Grade, Outcome, grade, outcomes

T = TypeVar("T")
# Bug -> the vectors that catch it, each with what was wrong.
Catchers = Mapping[str, Sequence[tuple[str, str]]]


class SelfTestError(Exception):
    """The self-test has no result: there are no vectors, the unchanged decoder fails, or the grader is wrong."""


@cache
def mutants() -> tuple[Mutant, ...]:
    """Returns all mutants, each once: those by hand, the misreadings, and a sample of all small changes."""
    every = (*handwritten.bugs(), *misreadings.mutants(), *operators.sample())
    return tuple({mutant.tree: mutant for mutant in reversed(every)}.values())[::-1]


def cases(manifest: Manifest) -> list[Case]:
    """Returns the vectors that a decoder is judged by, without those of cameras. Raises SelfTestError if none is."""
    made = []
    for vector in manifest.vectors:
        if vector.operation == "decode":
            expected = vector.expectation
            digests, error = {}, None
            if isinstance(expected, Accepted):
                # The second decoder does not give that of the head.
                parts = {name: value for name, value in expected.parts.items() if name != "head"}
                digests = {"whole": expected.digest, **parts}
            elif isinstance(expected, Rejected):
                error = expected.code, expected.offset
            data, proves = manifest.path(vector).read_bytes(), frozenset(vector.requirements)
            made.append(Case(vector.id, data, digests, error, proves, vector.budget.seconds, vector.budget.bytes))
    if not made:
        raise SelfTestError("there is no vector to test with")
    return made


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
    at = span(definitions()["DECODE_FILE"])
    return [
        planted(name, "DECODE_FILE", at, f"def DECODE_FILE(data):\n    {body}", "no decoder")
        for name, body in bodies.items()
    ]


def demanded(case: Case) -> Outcome:
    """The outcome that a vector demands."""
    if case.error is None:
        return Outcome("accepted", digests=case.digests)
    return Outcome("rejected", code=case.error[0], offset=case.error[1])


def near_misses(case: Case) -> list[Outcome]:
    """Outcomes that are nearly what a vector demands, and wrong."""
    code, offset = case.error or (307, 0)
    wrong = [Outcome("accepted"), Outcome("accepted", digests={"whole": "0" * 64})]
    wrong += [Outcome("rejected", code=c, offset=at) for c, at in ((code + 1, offset), (code, offset + 1))]
    # A decoder that says the right thing and then crashes, or never ends, has not said it.
    return wrong + [replace(demanded(case), kind=kind) for kind in ("crash", "hang")]


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
# An exempt mutant is tried only on vectors of at most so many bytes: on all of them it would take minutes.
EXEMPT_BYTES = 1400
# Made by --hints: the vectors of bugs that pass at least so many others before. These make the self-test quick.
HINTS, LATE = Path(__file__).with_name("hints.json"), 40

_cases: dict[str, Case] = {}


def _start(all_cases: Sequence[Case]) -> None:
    # Ctrl-C is for the parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _cases.update((case.id, case) for case in all_cases)
    # What is loaded here is not loaded again in each child.
    unchanged()


def _try(task: tuple[Mutant | None, list[str]], stop: Grade | None, seconds: float) -> list[Outcome]:
    mutant, names = task
    own = [_cases[name] for name in names]
    return outcomes(mutant, [replace(case, seconds=min(case.seconds, seconds)) for case in own], stop)


def _progress(items: Iterable[T], total: int, what: str) -> Iterable[T]:
    bar: Iterable[T] = tqdm(items, total=total, desc=what, unit="", **bar_options())
    return bar


def read_hints() -> dict[str, str]:
    """Returns the vectors that catch bugs which the order by itself tries on many others first, by bug."""
    vectors = json.loads(HINTS.read_text(encoding="utf-8"))
    return {bug: vector for vector, bugs in vectors.items() for bug in bugs.split()}


def hints_text(made: Sequence[Mutant], all_cases: Sequence[Case], catchers: Catchers) -> str:
    """Returns the hints that follow from the vectors that catch some mutants, as JSON with a line for each vector."""
    late: dict[str, list[str]] = {}
    for m in made:
        for vector, _ in catchers[m.id]:
            if [c.id for c in order(m, all_cases)].index(vector) >= LATE:
                late.setdefault(vector, []).append(m.id)
    return "{\n" + ",\n".join(f'"{vector}": "{" ".join(bugs)}"' for vector, bugs in sorted(late.items())) + "\n}\n"


def order(mutant: Mutant, all_cases: Iterable[Case], hint: str | None = None) -> list[Case]:
    """Returns the vectors that a mutant is tried on. Their order decides nothing but the time.

    The hint comes first, then the vectors for what the mutant breaks, and of both kinds the smallest ones.
    """
    broken = set(mutant.requirements) or around(mutant.place)
    exempt = mutant.id in PROOFS or mutant.id in GAPS
    own = [c for c in all_cases if not exempt or len(c.data) <= EXEMPT_BYTES]
    return sorted(own, key=lambda c: (c.id != hint, not broken & c.requirements, len(c.data)))


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
        """Yields for each task, a decoder and vectors, the vectors that catch it, and what was wrong.

        first_only: only the first of them. seconds: bounds those of the vectors' budgets.
        """
        # The judge is always asked here too: one of a test's own may not be known to the processes.
        results = self._pool.imap(partial(_try, stop=grade if first_only else None, seconds=seconds), tasks)
        for (_, names), made in zip(tasks, _progress(results, len(tasks), what), strict=True):
            judged = [
                (name, self._judge(self._by_name[name], outcome)) for name, outcome in zip(names, made, strict=False)
            ]
            yield [(name, wrong) for name, wrong in judged if wrong]

    def check_decoder(self, names: list[str]) -> None:
        """Raises SelfTestError if the second decoder itself fails one of some vectors, which then catch nothing."""
        tasks = [(None, names[i : i + BATCH]) for i in range(0, len(names), BATCH)]
        for wrong in self.tries(tasks, "the unchanged decoder"):
            for name, text in wrong:
                raise SelfTestError(f"the second decoder, unchanged, fails {name}: {text}")

    def check_fakes(self) -> None:
        """Raises SelfTestError if a program that does not decode passes a vector of either kind."""
        first = [
            next((c.id for c in self._by_name.values() if (c.error is None) == accepts), None)
            for accepts in (True, False)
        ]
        names = [name for name in first if name]
        made = fakes()
        results = self.tries([(fake, names) for fake in made], "decoders that are none", seconds=FAKE_SECONDS)
        for fake, wrong in zip(made, results, strict=True):
            if len(wrong) != len(names):
                raise SelfTestError(f"a decoder that {fake.id} passes one of {names}")

    def catchers(self, made: Sequence[Mutant]) -> Catchers:
        """Returns for each mutant the first vector that catches it, if one does."""
        hints = read_hints()
        tasks = [(m, [c.id for c in order(m, self._by_name.values(), hints.get(m.id))]) for m in made]
        results = self.tries(tasks, "planted bugs", first_only=True)
        return {m.id: wrong for m, wrong in zip(made, results, strict=True)}


@contextmanager
def trials(all_cases: Sequence[Case], jobs: int, judge: Grade = grade) -> Iterator[Trials]:
    """Yields trials whose grader and treatment of crashes have been checked. Raises SelfTestError."""
    check_grader(all_cases, judge)
    with multiprocessing.get_context("spawn").Pool(jobs, _start, (all_cases,)) as pool:
        made = Trials(pool, all_cases, judge)
        made.check_fakes()
        yield made


# --- the score --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """What the vectors make of the mutants.

    bugs: those that the vectors must catch. survivors: bugs that none catches. refuted: exempt mutants that are caught.
    """

    bugs: list[Mutant]
    survivors: list[Mutant]
    refuted: list[Mutant]

    @property
    def right(self) -> bool:
        """Whether the suite catches all bugs, and no exemption is wrong."""
        return not self.survivors and not self.refuted


def score(made: Sequence[Mutant], catchers: Catchers) -> Score:
    """Returns the score of some mutants."""
    bugs = [m for m in made if m.id not in PROOFS and m.id not in GAPS]
    refuted = [m for m in made if m not in bugs and catchers[m.id]]
    return Score(bugs, [m for m in bugs if not catchers[m.id]], refuted)


def _cell(words: str) -> str:
    """Returns text for a cell of a table in Markdown."""
    line = " ".join(words.split())
    return (line if len(line) <= 100 else line[:97] + "...").replace("|", "\\|")


def table(made: Sequence[Mutant], catchers: Catchers) -> str:
    """Returns a table in Markdown of all mutants, with the change and the first vector that catches each."""
    lines = ["| bug | requirements | mistake | text | becomes | first vector | outcome |", "|" + "---|" * 7]
    for m in made:
        reason = PROOFS.get(m.id) or GAPS.get(m.id, "")
        vector, wrong = next(iter(catchers[m.id]), ("**none**", reason))
        change = (f"`{_cell(m.old)}`", f"`{_cell(m.new)}`")
        lines.append(f"| {' | '.join((m.id, ', '.join(m.requirements), m.what, *change, vector, _cell(wrong)))} |")
    return "\n".join(lines) + "\n"


def show(result: Score, catchers: Catchers) -> None:
    """Prints the score and what is wrong."""
    for m in result.survivors:
        print(f"survivor: {m.id}, SPEC.md line {m.line}: {m.what}\n  {m.old!r}\n  {m.new!r}")
    for m in result.refuted:
        vector, wrong = catchers[m.id][0]
        print(f"{m.id} is not exempt: {vector} catches it: {wrong}")
    hand = len({m.id for m in handwritten.bugs()} & {m.id for m in result.bugs})
    caught = len(result.bugs) - len(result.survivors)
    share = 100 * caught / len(result.bugs)
    by = f"{hand} by hand, {len(result.bugs) - hand} by operators"
    print(f"{len(result.bugs)} planted bugs, {by}: {caught} caught, {share:.1f} %")


def run(manifest: Path, jobs: int, *, with_table: bool = False, new_hints: bool = False) -> int:
    """Tries every planted bug on the vectors until one catches it, and prints the score.

    with_table: also prints a table of all mutants. new_hints: also writes the hints. Returns 0 if all bugs are caught,
    else 1. Raises ManifestError and OSError.
    """
    made, suite = mutants(), load(manifest)
    try:
        all_cases = cases(suite)
        with trials(all_cases, jobs) as test:
            catchers = test.catchers(made)
            test.check_decoder(sorted({vector for wrong in catchers.values() for vector, _ in wrong}))
    except SelfTestError as error:
        print(error, file=sys.stderr)
        return 1
    result = score(made, catchers)
    if new_hints:
        write_file(HINTS, hints_text(made, all_cases, catchers).encode())
    if with_table:
        print(table(made, catchers))
    show(result, catchers)
    return 0 if result.right else 1
