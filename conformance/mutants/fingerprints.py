"""Makes the table of fingerprints: each planted bug on each quick vector, and the code that each vector runs.

Only what has changed is made anew: a row's key is a hash of the wrong decoder, a column's one of the vector. A run that
is interrupted goes on from its journal.
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import multiprocessing
import random
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

from refcodec.files.documents import DocumentError, parse_json
from refcodec.files.stage import write_file

from ..diagnosis import table as tables
from ..diagnosis.seen import CRASH, RIGHT, Seen, accepted, refused
from ..diagnosis.table import Bug, Place, Table, TableError, vector_key
from ..manifest import Accepted, Manifest, Rejected, Vector
from ..runner.grading import BY_CODE, Found, differing, read_output
from . import handwritten, operators, places
from .equivalent import PROOFS
from .loading import load as load_decoder
from .mutant import MODULES, Mutant, text_of
from .replay import OUTSIDE, Kept, Replay, SameError
from .selftest import cases, decoder
from .trial import Case, Outcome, outcomes

T = TypeVar("T")

# A vector is quick if the unchanged decoder runs at most so many lines for it; the shortest for a requirement, an error
# or a flag may run more. They are the same on every machine.
QUICK_LINES, TELLING_LINES = 40_000, 60_000
# Processor time of a wrong decoder on a quick vector, in seconds: the right one takes a hundredth of it.
SECONDS = 2.0
# A change of fewer characters says nothing without its line.
_LITTLE = 16
# The interpreter with numpy, in bytes of address space beside a vector's budget.
_ROOM = 1 << 30


# --- what a decoder does with a vector --------------------------------------------------------------------------------


def written(package: ModuleType, data: bytes) -> Outcome:
    """What a loaded decoder would write, as the runner reads it."""
    try:
        scene = package.decode(data)
        parts = package.reconstruction.canonical_parts(scene)
        output = package.reconstruction.digested(scene, parts) + b"".join(parts.values())
    except package.C3GSError as error:
        return Outcome("rejected", code=int(error.code), offset=int(error.offset))
    found = read_output(io.BytesIO(output))
    return Outcome("accepted", digests={"whole": found.digest, **found.parts})


def seen(vector: Vector, outcome: Outcome) -> Seen:
    """What an outcome is, for a vector."""
    expected = vector.expectation
    error = (expected.code, expected.offset) if isinstance(expected, Rejected) else None
    if outcome.kind == "same":
        return RIGHT
    if outcome.kind == "rejected":
        return refused(error, outcome.code, outcome.offset) if outcome.code in BY_CODE else CRASH
    if outcome.kind != "accepted":
        return CRASH
    digest = outcome.digests["whole"]
    parts = {name: value for name, value in outcome.digests.items() if name != "whole"}
    found = Found("accepted", 0, None, digest=digest, parts=parts)
    wrong = differing(expected, found) if isinstance(expected, Accepted) else []
    return accepted(error, wrong, digest)


_replay: Replay
_kept: dict[str, Kept] = {}
SAME = Outcome("same")


def replayed(mutant: Mutant | None) -> Callable[[Case], Outcome]:
    """The wrong decoder in place of the right one; as a package of its own where that cannot be."""
    changed = _replay.plant(mutant) if mutant and not mutant.also else None
    if changed is None:
        package = load_decoder(mutant)
        return lambda case: written(package, case.data)

    def look(case: Case) -> Outcome:
        _replay.again(_kept[case.id], changed)
        try:
            return written(_replay.package, case.data)
        except SameError:
            return SAME

    return look


def alone(mutant: Mutant | None) -> Callable[[Case], Outcome]:
    """The wrong decoder as a package of its own, which runs all."""
    package = load_decoder(mutant)
    return lambda case: written(package, case.data)


# --- keys -------------------------------------------------------------------------------------------------------------


def _hash(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


def _code(text: str) -> str:
    """A module without blank lines and lines of comment, which change nothing."""
    return "\n".join(line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))


def decoder_key(mutant: Mutant | None) -> str:
    """A hash of a decoder's code."""
    wrong = {m.module: m.source for m in (mutant, *mutant.also)} if mutant else {}
    return _hash(*(_code(wrong.get(name, text_of(name))) for name in MODULES))


def right_key() -> str:
    """A hash of the right decoder, and of how many lines it may run: by these the vectors of a table are chosen."""
    return _hash(decoder_key(None), str((QUICK_LINES, TELLING_LINES)))


# --- the work ---------------------------------------------------------------------------------------------------------

_cases: dict[str, Case] = {}


def _prepare(manifest: Manifest) -> None:
    """What the processes have of their parent, of which they are forks."""
    _cases.clear()
    for case in cases(manifest):
        _cases[case.id] = replace(case, seconds=SECONDS, bytes=case.bytes + _ROOM)


def _hold_on() -> None:
    # Ctrl-C is for the parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _lines(name: str) -> int | None:
    kept = _replay.record(written, _cases[name].data, TELLING_LINES)
    return kept.lines if kept else None


def _row(task: tuple[Mutant, list[str]]) -> list[Outcome]:
    mutant, names = task
    return outcomes(mutant, [_cases[name] for name in names], make=replayed)


def _row_alone(task: tuple[Mutant, list[str]]) -> list[Outcome]:
    mutant, names = task
    return outcomes(mutant, [_cases[name] for name in names], make=alone)


def _progress(found: Iterable[T], total: int, what: str) -> Iterable[T]:
    bar: Iterable[T] = tqdm(found, total=total, desc=what, unit="", file=sys.stderr, leave=False)
    return bar


class Journal:
    """What is done, a line of JSON for each vector and each bug. A line that is cut is left out.

    lines: by hash of a vector how many lines it runs, None if it is not quick. rows: by hash of a bug what it does to
    vectors, each with its hash.
    """

    def __init__(self, path: Path) -> None:
        self.lines: dict[str, int | None] = {}
        self.rows: dict[str, dict[str, tuple[str, Seen]]] = {}
        if path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    said = parse_json(line)
                    if "lines" in said:
                        self.lines[str(said["vector"])] = said["lines"]
                    else:
                        row = {name: (key, Seen(*what)) for name, (key, *what) in said["seen"].items()}
                        self.rows.setdefault(str(said["bug"]), {}).update(row)
                except (DocumentError, AttributeError, KeyError, TypeError, ValueError):
                    continue
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a", encoding="utf-8")

    def add(self, **said: Any) -> None:
        """Notes a line."""
        self._file.write(json.dumps(said, separators=(",", ":")) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Closes the file."""
        self._file.close()


def _pooled(work: Callable[[Any], T], tasks: Sequence[Any], jobs: int, what: str) -> Iterator[T]:
    """The results of tasks, in their order. The processes are forks, and have what is here now."""
    with multiprocessing.get_context("fork").Pool(jobs, _hold_on) as pool:
        yield from _progress(pool.imap(work, tasks), len(tasks), what)


def _rows(
    manifest: Manifest, tasks: Sequence[tuple[Mutant, list[str]]], jobs: int, work: Callable[[Any], list[Outcome]]
) -> Iterator[tuple[Mutant, dict[str, Seen]]]:
    """For each task, a bug and vectors: what it does to these."""
    vectors = {v.id: v for v in manifest.vectors}
    for (mutant, names), made in zip(tasks, _pooled(work, tasks, jobs, "planted bugs"), strict=True):
        yield mutant, {name: seen(vectors[name], what) for name, what in zip(names, made, strict=True)}


def quick(vectors: Sequence[Vector], lines: Mapping[str, int | None]) -> list[str]:
    """The quick vectors: those of few lines, and the shortest for each requirement, error and flag.

    lines: for each vector how many it runs, None if too many.
    """
    best: dict[object, tuple[int, str]] = {}
    for v in vectors:
        count = lines.get(v.id)
        if count is not None:
            e = v.expectation
            for tag in (*v.requirements, *v.flags, *v.features, e.code if isinstance(e, Rejected) else None):
                best[tag] = min(best.get(tag, (count, v.id)), (count, v.id))
    telling = {name for _, name in best.values()}
    found = []
    for v in vectors:
        count = lines.get(v.id)
        if count is not None and (count <= QUICK_LINES or v.id in telling):
            found.append(v.id)
    return found


def planted() -> list[Mutant]:
    """The bugs of the table: those by hand and all changes of the operators, but not those that are proved to be none.

    The self-test has a tenth of the changes, which is enough to judge vectors by. A diagnosis is the better, the nearer
    its bugs are to any other: with each doubling of their number four more in a hundred get the right clause.
    """
    hand = handwritten.bugs()
    known = {decoder(m) for m in hand}
    found = [*hand, *(m for m in operators.changes() if decoder(m) not in known)]
    return [m for m in found if m.id not in PROOFS]


def described(mutant: Mutant) -> Bug:
    """What the table says of a bug."""
    clauses, requirements = places.rules(mutant)
    touched = places.touched(mutant)
    inner = touched[-1].function if touched else ""
    scope = f"{mutant.module}.{inner}".rstrip(".")
    what = mutant.what if mutant.requirements else _changed(mutant)
    return Bug(
        mutant.id,
        what,
        scope,
        mutant.line,
        clauses,
        requirements,
        places.stage(mutant.module),
        decoder_key(mutant),
    )


def _changed(mutant: Mutant) -> str:
    """What an operator has changed, in the same style before and after. Of little the whole line is told."""
    try:
        old, new = ast.unparse(ast.parse(f"({mutant.old})", mode="eval")), mutant.new
    except SyntaxError:
        old, new = mutant.old, mutant.new
    if len(old) < _LITTLE:
        old, new = (text.splitlines()[mutant.line - 1] for text in (text_of(mutant.module), mutant.source))
    old, new = (" ".join(text.split()) for text in (old, new))
    return f"`{_cut(old)}` is left out" if new == "pass" else f"`{_cut(new)}` in place of `{_cut(old)}`"


def _cut(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "..."


def _known(place: Path) -> Table | None:
    """The table of an earlier run, if there is one that can be read."""
    try:
        return tables.read(place)
    except (OSError, TableError):
        return None


def make(manifest: Manifest, jobs: int, journal: Path, place: Path) -> Table:
    """Makes the table anew where vectors or bugs have changed, and writes it. Raises OSError."""
    global _replay  # noqa: PLW0603 (what forks have of their parent)
    old, bugs, right = _known(place), planted(), right_key()
    vectors = [v for v in manifest.vectors if v.operation == "decode"]
    keys = {v.id: vector_key(v) for v in vectors}
    known = _cells(old)
    _prepare(manifest)
    _replay = Replay()
    with closing(Journal(journal)) as notes:
        lines = dict(notes.lines)
        if old and old.decoder == right:
            lines |= {key: count for (_, key), count in zip(old.vectors, old.lines, strict=True)}
            lines |= dict.fromkeys(old.slow)
        todo = [v.id for v in vectors if keys[v.id] not in lines]
        for name, count in zip(todo, _pooled(_lines, todo, jobs, "lines of vectors"), strict=True):
            lines[keys[name]] = count
            notes.add(vector=keys[name], lines=count)
        names = quick(vectors, {v.id: lines[keys[v.id]] for v in vectors})
        for name in _progress(names, len(names), "the right decoder"):
            kept = _replay.record(written, _cases[name].data, TELLING_LINES)
            assert kept is not None, name
            _kept[name] = kept
        tasks, rows = [], {}
        for mutant in bugs:
            key = decoder_key(mutant)
            rows[mutant.id] = dict.fromkeys(names, RIGHT)
            done: set[str] = set()
            for found in (known.get(key, {}), notes.rows.get(key, {})):
                same = {n: what for n, (k, what) in found.items() if keys.get(n) == k and n in rows[mutant.id]}
                rows[mutant.id] |= same
                done |= set(same)
            left = [name for name in names if name not in done]
            if left:
                tasks.append((mutant, left))
        # In no order, so that what is done at any time is a sample.
        random.Random(0).shuffle(tasks)
        trials = sum(len(left) for _, left in tasks)
        print(f"{len(bugs)} bugs, {len(names)} quick vectors of {len(keys)}; {trials} trials to make", flush=True)
        for mutant, made in _rows(manifest, tasks, jobs, _row):
            rows[mutant.id] |= made
            notes.add(bug=decoder_key(mutant), seen={name: [keys[name], *map(int, w)] for name, w in made.items()})
    spots = [Place(s.module, s.lines.start, *places.cited(s)) for s in places.places()]
    bits = np.array([[_kept[name].ran[OUTSIDE] >> n & 1 for n in range(len(spots))] for name in names], bool)
    made_table = tables.build(
        bugs=[described(m) for m in bugs],
        vectors=[(name, keys[name]) for name in names],
        places=spots,
        seen=[rows[m.id] for m in bugs],
        runs=bits.reshape(len(names), len(spots)),
        lines=[_kept[name].lines for name in names],
        slow=[key for name, key in keys.items() if name not in set(names)],
        decoder=right,
    )
    write_file(place, tables.to_bytes(made_table))
    return made_table


def _cells(old: Table | None) -> dict[str, dict[str, tuple[str, Seen]]]:
    """What a table knows: for each bug's key, and each vector, the vector's key and what was seen."""
    if old is None:
        return {}
    return {
        bug.key: {name: (key, old.seen(v, b)) for v, (name, key) in enumerate(old.vectors)}
        for b, bug in enumerate(old.bugs)
    }


# --- checks -----------------------------------------------------------------------------------------------------------


def stale(manifest: Manifest, table: Table) -> list[str]:
    """What a table says otherwise than the bugs and the vectors of today, in words."""
    wrong = []
    now = {m.id: described(m) for m in planted()}
    then = {bug.id: bug for bug in table.bugs}
    wrong += [f"the bug {name} is not in the table" for name in now if name not in then]
    wrong += [f"the bug {name} of the table is gone" for name in then if name not in now]
    wrong += [f"the bug {name} has changed" for name in now if name in then and now[name] != then[name]]
    keys = {v.id: vector_key(v) for v in manifest.vectors if v.operation == "decode"}
    wrong += [f"the vector {name} has changed or is gone" for name, key in table.vectors if keys.get(name) != key]
    if table.decoder != right_key():
        wrong.append("the second decoder or the choice of vectors has changed")
    return wrong


def check(manifest: Manifest, table: Table, jobs: int, count: int, seed: int) -> list[str]:
    """Makes a sample of the cells anew, and compares. Half of them are failures, half are any. Returns what differs.

    Each wrong decoder runs as a package of its own, from the first byte on.
    """
    chosen = random.Random(seed)
    failing = list(zip(*np.nonzero(table.cells >= 0), strict=True))
    cells = chosen.sample(failing, min(count // 2, len(failing)))
    whole = [(v, b) for v in range(len(table.vectors)) for b in range(len(table.bugs))]
    cells += chosen.sample(whole, min(count - len(cells), len(whole)))
    by_id = {m.id: m for m in planted()}
    wanted: dict[int, list[int]] = {}
    for v, b in sorted({(int(v), int(b)) for v, b in cells}):
        wanted.setdefault(b, []).append(v)
    wrong = []
    tasks = [(by_id[table.bugs[b].id], [table.names[v] for v in vectors]) for b, vectors in wanted.items()]
    _prepare(manifest)
    for (mutant, made), (b, vectors) in zip(_rows(manifest, tasks, jobs, _row_alone), wanted.items(), strict=True):
        for v in vectors:
            now, then = made[table.names[v]], table.seen(v, b)
            if now != then:
                wrong.append(f"{mutant.id} on {table.names[v]}: {tuple(now)} now, {tuple(then)} in the table")
    return wrong


def _merged(a: Mutant, b: Mutant) -> Mutant | None:
    """A decoder with both bugs, or None if they change the same text."""
    name = f"{a.id}+{b.id}"
    if a.module != b.module:
        return replace(a, id=name, also=(b,))
    spans = []
    right = text_of(a.module)
    for wrong in (a.source, b.source):
        start = next(i for i, (x, y) in enumerate(zip(right + "\0", wrong + "\1", strict=False)) if x != y)
        most = min(len(right), len(wrong)) - start
        tail = next((i for i in range(most) if right[-1 - i] != wrong[-1 - i]), most)
        spans.append((start, len(right) - tail, wrong[start : len(wrong) - tail]))
    (first, end, one), (second, last, other) = sorted(spans)
    if end > second:
        return None
    return replace(a, id=name, source=right[:first] + one + right[end:second] + other + right[last:])


def pairs(manifest: Manifest, table: Table, jobs: int, count: int, seed: int) -> list[tuple[int, int, dict[str, Seen]]]:
    """Decoders with two planted bugs of different clauses, and what they do to the vectors of a table.

    Returns for each the numbers of the two bugs in the table, and what was seen where it is not right.
    """
    chosen = random.Random(seed)
    by_id = {m.id: m for m in planted()}
    some = [b for b in range(len(table.bugs)) if (table.cells[:, b] >= 0).any()]
    tasks: list[tuple[Mutant, list[str]]] = []
    found: list[tuple[int, int]] = []
    while len(tasks) < count:
        a, b = chosen.sample(some, 2)
        one, other = table.bugs[a], table.bugs[b]
        if set(one.clauses) & set(other.clauses) or one.place == other.place:
            continue
        merged = _merged(by_id[one.id], by_id[other.id])
        if merged is not None:
            tasks.append((merged, list(table.names)))
            found.append((a, b))
    _prepare(manifest)
    made = _rows(manifest, tasks, jobs, _row_alone)
    rows = [{name: what for name, what in row.items() if what != RIGHT} for _, row in made]
    return [(a, b, row) for (a, b), row in zip(found, rows, strict=True)]


def took(began: float) -> str:
    """Time since a beginning, on the clock and of processors, ours and of processes that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = time.process_time() + children.ru_utime + children.ru_stime
    return f"{time.monotonic() - began:.0f} s, {used:.0f} s of processors"
