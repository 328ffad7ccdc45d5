"""Runs a decoder on vectors: several processes at a time, each bounded by the vector's budget."""

from __future__ import annotations

import hashlib
import json
import queue
import sys
import tempfile
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from tqdm import tqdm

from ..manifest import Accepted, GaussiansOf, Manifest, Rejected, Vector
from . import process
from .grading import GRADE_EXACT, Found, Judgement, judge, read
from .process import Ended, Server, StoppedError


@dataclass(frozen=True)
class Options:
    """What is run.

    command: the decoder's, a template with {input} and {output}, perhaps {trace}. gaussians: one with {camera} too,
    None without a renderer. grade: what a vector must reach. slow: factor of the time budgets. trace: a trace must be
    right too. serve: the command is no template, but serves (process.Server).
    """

    command: tuple[str, ...]
    gaussians: tuple[str, ...] | None = None
    jobs: int = 1
    grade: int = GRADE_EXACT
    slow: float = 1.0
    trace: bool = False
    serve: bool = False


@dataclass(frozen=True)
class Result:
    """A vector's outcome.

    status: "passed", "failed", "crashed" or "skipped"; of a known failure "known", or "unexpected" if it passes.
    grade: 0 to 3. text: what is wrong. found: what the decoder said, None if it was not run. lines: how an output or
    trace diverges, and the bytes of the file, annotated. stderr: its end. seconds, peak: of the process (Ended).
    """

    vector: Vector
    status: str
    grade: int = 0
    text: str = ""
    found: Found | None = None
    divergence: tuple[str, ...] = ()
    hex: tuple[str, ...] = ()
    stderr: str = ""
    seconds: float = 0.0
    peak: int | None = None

    @property
    def good(self) -> bool:
        """Whether the run may still succeed with it."""
        return self.status in ("passed", "known", "skipped")


@dataclass
class Run:
    """What came of a run; results in the order of the vectors, those that were reached before `interrupted`."""

    results: list[Result] = field(default_factory=list)
    interrupted: bool = False


def wrong_hashes(manifest: Manifest) -> list[str]:
    """The suite's files that are missing or not those of the manifest, in words."""
    wanted = {v.input.path: v.input.sha256 for v in manifest.vectors}
    wanted |= {
        v.expectation.path: v.expectation.sha256 for v in manifest.vectors if isinstance(v.expectation, GaussiansOf)
    }
    wrong = []
    for path, digest in wanted.items():
        try:
            found = hashlib.sha256((manifest.folder / path).read_bytes()).hexdigest()
        except OSError as error:
            wrong.append(f"{path}: {error.strerror}")
            continue
        if found != digest:
            wrong.append(f"{path}: its SHA-256 is {found}, {digest} expected")
    return wrong


class _Desk:
    """Runs single vectors in a folder for their files."""

    def __init__(self, manifest: Manifest, options: Options, folder: Path) -> None:
        self.manifest, self.options, self.folder = manifest, options, folder
        self.stop = threading.Event()
        self.servers: queue.SimpleQueue[Server] = queue.SimpleQueue()
        for number in range(options.jobs if options.serve else 0):
            self.servers.put(Server(options.command, folder / f"server-{number}"))

    def file(self, vector: Vector, name: str) -> Path:
        return self.folder / f"{vector.id}.{name}"

    def run(self, vector: Vector) -> Result:
        """The outcome of a vector; raises StoppedError if the run was ended meanwhile."""
        o, output, trace = self.options, self.file(vector, "out"), self.file(vector, "trace")
        places = {"input": self.manifest.path(vector).resolve(), "output": output, "trace": trace}
        template = o.command
        if isinstance(vector.expectation, GaussiansOf):
            if o.gaussians is None:
                return Result(vector, "skipped", text="no command for Gaussians was given (--gaussians)")
            template = o.gaussians
            places["camera"] = self.file(vector, "camera")
            places["camera"].write_text(json.dumps(vector.expectation.camera), encoding="utf-8")
        if self.stop.is_set():
            raise StoppedError
        seconds = vector.budget.seconds * o.slow
        if o.serve and template is o.command:
            ended = self._ask(vector, places, seconds)
        else:
            errors = self.file(vector, "stderr")
            ended = process.run(process.fill(template, places), errors, seconds, vector.budget.bytes, self.stop, output)
            errors.unlink()
        found = read(ended, output)
        judgement = self._with_trace(vector, judge(self.manifest, vector, found, output), trace)
        status = "passed" if judgement.grade >= o.grade else "crashed" if found.result == "crashed" else "failed"
        if not judgement.text or found.result == "crashed":
            # The others are looked at again (explain).
            output.unlink(missing_ok=True)
        if not judgement.text:
            trace.unlink(missing_ok=True)
        return Result(
            vector,
            status,
            judgement.grade,
            judgement.text,
            found,
            stderr=ended.stderr.decode("utf-8", "replace"),
            seconds=ended.seconds,
            peak=ended.peak,
        )

    def _ask(self, vector: Vector, places: dict[str, Path], seconds: float) -> Ended:
        server = self.servers.get()
        try:
            wanted = {name: str(path) for name, path in places.items() if name != "trace" or self.options.trace}
            return server.ask(wanted, seconds, vector.budget.bytes, self.stop)
        finally:
            self.servers.put(server)

    def close(self) -> None:
        """Ends what serves; after the last vector."""
        while not self.servers.empty():
            self.servers.get().close()

    def _with_trace(self, vector: Vector, judgement: Judgement, trace: Path) -> Judgement:
        if not self.options.trace or judgement.text or not isinstance(vector.expectation, Accepted):
            return judgement
        if not trace.is_file():
            return Judgement(0, "the output is right; no trace was written")
        with trace.open("rb") as file:
            right = hashlib.file_digest(file, "sha256").hexdigest() == vector.expectation.trace
        return judgement if right else Judgement(0, "the output is right, the trace is not")

    def explain(self, result: Result) -> Result:
        """The result of a failure with what can be said of it."""
        vector, found = result.vector, result.found
        if not result.text or found is None or isinstance(vector.expectation, GaussiansOf):
            return result
        # numpy is slow to import, and is needed for failures alone.
        from . import divergence  # noqa: PLC0415

        data = self.manifest.path(vector).read_bytes()
        lines, spot = [], None
        output, trace = self.file(vector, "out"), self.file(vector, "trace")
        if isinstance(vector.expectation, Rejected):
            spot = vector.expectation.offset
        else:
            differs = divergence.of_output(data, output) if found.result == "accepted" else None
            if differs:
                lines.append(differs.text())
            symbol = divergence.of_trace(data, trace) if trace.is_file() else None
            if symbol:
                lines.append(symbol.text())
            spot = symbol.offset if symbol else found.offset
        near = [] if spot is None else divergence.annotated(data, spot)
        for path in (output, trace):
            path.unlink(missing_ok=True)
        return replace(result, divergence=tuple(lines), hex=tuple(near))


def run(
    manifest: Manifest, vectors: Sequence[Vector], options: Options, known: Iterable[str] = (), show: bool = True
) -> Run:
    """Runs a decoder on vectors. Ctrl-C ends it with what there is.

    known: ids that must fail. show: a bar of progress on stderr.
    """
    ended: dict[str, Result] = {}
    done = Run()
    bar = tqdm(total=len(vectors), unit="vector", file=sys.stderr, disable=not show)
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="c3gs-"))
        desk = stack.enter_context(closing(_Desk(manifest, options, Path(folder))))
        pool = stack.enter_context(ThreadPoolExecutor(options.jobs))
        stack.enter_context(bar)
        # The longest first, so that no single one is left at the end.
        queue = [pool.submit(desk.run, v) for v in sorted(vectors, key=lambda v: (-v.budget.seconds, -v.input.size))]
        try:
            for result in _as_they_end(queue):
                ended[result.vector.id] = desk.explain(result)
                bar.update()
                bad = sum(not r.good for r in ended.values())
                bar.set_postfix_str(f"{bad} failed" if bad else "", refresh=False)
        except KeyboardInterrupt:
            done.interrupted = True
        finally:
            desk.stop.set()
            for future in queue:
                future.cancel()
    done.results = [ended[v.id] for v in vectors if v.id in ended]
    names = set(known)
    done.results = [_as_known(r) if r.vector.id in names else r for r in done.results]
    return done


def _as_they_end(queue: Iterable[Future[Result]]) -> Iterable[Result]:
    waiting = set(queue)
    while waiting:
        # A wait without an end cannot be interrupted on every system.
        ready, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
        yield from (future.result() for future in ready)


def _as_known(result: Result) -> Result:
    if result.status == "passed":
        return replace(result, status="unexpected", text="a known failure passes: take it off the list")
    return replace(result, status="known") if result.status in ("failed", "crashed") else result
