"""Runs a decoder on vectors: several processes at a time, each within the vector's budget."""

import hashlib
import json
import queue
import signal
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from msgspec import Meta
from msgspec.structs import replace
from tqdm import tqdm

from refcodec.files.terminal import bar_options
from refcodec.files.text import printable
from refcodec.inspect.specification import clause_of

from ..manifest import (
    Accepted,
    Class,
    Count,
    GaussiansOf,
    ImageOf,
    Manifest,
    ManifestError,
    Operation,
    Rejected,
    Sha256,
    Strict,
    Undrawn,
    Vector,
)
from . import process
from .folder import FileError, Folder, open_file
from .grading import GRADE_EXACT, Found, Judgement, judge, read
from .process import Bounds, Ended, StoppedError, Watcher
from .traces import Probe, symbols_digest

# The longest error output of a process in a report, in characters.
STDERR_CHARACTERS = 4000
# The text of a result without a run.
SKIPPED = {
    "gaussians": "no command for Gaussians was given (--gaussians)",
    "render": "no command for images was given (--render)",
}
Status = Literal["failed", "crashed", "unexpected", "known", "passed", "skipped"]
STATUSES: tuple[Status, ...] = get_args(Status)
Grade = Annotated[int, Meta(ge=0, le=GRADE_EXACT)]
Number = Annotated[float, Meta(ge=0)]


@dataclass(frozen=True)
class Options:
    """The options of a run.

    command: of the decoder, a template with {input} and {output}, and optionally {trace}. gaussians, render: templates
    with {camera} too, None without a renderer. jobs: number of processes. grade: the lowest that passes. slow: factor
    of the time budgets. trace: the trace is judged too. serve: the command serves (process.Watcher.ask).
    """

    command: tuple[str, ...]
    gaussians: tuple[str, ...] | None = None
    render: tuple[str, ...] | None = None
    jobs: int = 1
    grade: int = GRADE_EXACT
    slow: float = 1.0
    trace: bool = False
    serve: bool = False


class Digest(Strict, frozen=True, tag="accepted", tag_field="result"):
    """The file is accepted, and its scene has this digest."""

    digest: Sha256


class Tolerance(Strict, frozen=True, tag="gaussians", tag_field="result"):
    """The Gaussians are those of a list within a relative tolerance."""

    tolerance: Number


class Seen(Strict, frozen=True, tag="image", tag_field="result"):
    """The image is like a reference image, or nothing is drawn."""

    drawn: bool


class Result(Strict, frozen=True, rename={"klass": "class"}):
    """The result of a vector, and what the manifest says of it.

    clauses: to read, that of the expected error first. status: "passed", "failed", "crashed" or "skipped"; of a known
    failure "known", or "unexpected" if it passes. grade: 0 to 3. text: the fault, in words. found: the decoder's
    answer, None if it was not run. probe: the first wrong number of a trace. divergence: the first differences of
    output and trace. hex: the bytes of the file, annotated. stderr: its beginning and its end, printable. seconds,
    peak_bytes: of the process (Ended).
    """

    id: str
    title: str
    klass: Class
    operation: Operation
    profile: str | None
    level: Count | None
    requirements: tuple[str, ...]
    features: tuple[str, ...]
    flags: tuple[str, ...]
    clauses: tuple[str, ...]
    input: str
    expected: Digest | Rejected | Tolerance | Seen
    status: Status
    grade: Grade = 0
    text: str = ""
    found: Found | None = None
    probe: Probe | None = None
    divergence: tuple[str, ...] = ()
    hex: tuple[str, ...] = ()
    stderr: str = ""
    seconds: Number = 0.0
    peak_bytes: Count | None = None

    @property
    def is_good(self) -> bool:
        """Whether a run with this result can succeed."""
        return self.status in ("passed", "known", "skipped")


@dataclass
class Run:
    """The outcome of a run. results: in the order of the vectors, without those that were not reached."""

    results: list[Result] = field(default_factory=list)
    interrupted: bool = False


def result_of(vector: Vector, status: Status, **more: Any) -> Result:
    """Returns the result of a vector. more: the members that the manifest does not have."""
    e, v = vector.expectation, vector
    clauses = [e.clause] if isinstance(e, Rejected) else []
    clauses = list(dict.fromkeys(clauses + [clause_of(name) for name in v.requirements]))
    expected: Any = e
    if isinstance(e, Accepted | GaussiansOf):
        expected = Digest(e.digest) if isinstance(e, Accepted) else Tolerance(e.tolerance)
    elif not isinstance(e, Rejected):
        expected = Seen(isinstance(e, ImageOf))
    stated = (v.id, v.title, v.klass, v.operation, v.profile, v.level, v.requirements, v.features, v.flags)
    return Result(*stated, tuple(clauses), v.input.path, expected, status, **more)


def status_of(answer: Found, judgement: Judgement, grade: int) -> Status:
    """Returns the status of a vector that was run and is not a known failure. grade: the lowest that passes."""
    if answer.result == "crashed":
        return "crashed"
    return "passed" if judgement.grade >= grade else "failed"


def shown(stderr: bytes) -> str:
    """Returns error output in a printable form of bounded length."""
    text = printable(stderr.decode("utf-8", "backslashreplace"), lines=True)
    left = len(text) - STDERR_CHARACTERS
    if left <= 0:
        return text
    first = STDERR_CHARACTERS // 4
    return f"{text[:first]}\n[{left} characters left out] {text[first + left :]}"


def wrong_hashes(manifest: Manifest) -> list[str]:
    """Returns a message for each file of the suite that is missing or differs from the manifest."""
    wanted = {v.input.path: v.input.sha256 for v in manifest.vectors}
    wanted |= {
        v.expectation.path: v.expectation.sha256
        for v in manifest.vectors
        if isinstance(v.expectation, GaussiansOf | ImageOf)
    }
    wrong = []
    for path, digest in wanted.items():
        try:
            actual = hashlib.sha256((manifest.folder / path).read_bytes()).hexdigest()
        except OSError as error:
            wrong.append(f"{path}: {error.strerror}")
            continue
        if actual != digest:
            wrong.append(f"{path}: its SHA-256 is {actual}, {digest} expected")
    return wrong


class _Desk:
    """Runs single vectors, each in its own folder."""

    def __init__(self, manifest: Manifest, options: Options) -> None:
        self.manifest, self.options = manifest, options
        self.stop = threading.Event()
        self._watchers: queue.SimpleQueue[Watcher] = queue.SimpleQueue()
        for _ in range(options.jobs):
            self._watchers.put(Watcher())

    def run(self, vector: Vector) -> Result:
        """Returns the result of a vector. Raises StoppedError if the run is stopped meanwhile."""
        o, e, camera, template = self.options, vector.expectation, None, self.options.command
        if isinstance(e, GaussiansOf | ImageOf | Undrawn):
            given = getattr(o, vector.operation)
            if given is None:
                return result_of(vector, "skipped", text=SKIPPED[vector.operation])
            template, camera = given, json.dumps(e.camera).encode()
        if self.stop.is_set():
            raise StoppedError
        with closing(Folder(self._data(vector), camera)) as folder:
            ended = self._end(vector, template, folder)
            answer = read(ended, folder.output, e)
            judgement = self._with_trace(vector, judge(self.manifest, vector, answer, folder.output), folder)
            result = result_of(
                vector,
                status_of(answer, judgement, o.grade),
                grade=judgement.grade,
                text=judgement.text,
                found=answer,
                stderr=shown(ended.stderr),
                seconds=round(ended.seconds, 3),
                peak_bytes=ended.peak,
            )
            if not judgement.text or result.status == "crashed" or vector.operation != "decode":
                return result
            return self._explained(result, vector, folder)

    def _data(self, vector: Vector) -> bytes:
        """Reads the file of a vector. Raises ManifestError if it changed since the run began."""
        try:
            data = self.manifest.path(vector).read_bytes()
        except OSError as error:
            raise ManifestError(f"{vector.input.path}: {error.strerror}") from None
        if hashlib.sha256(data).hexdigest() != vector.input.sha256:
            raise ManifestError(f"{vector.input.path}: it was changed while the decoder ran")
        return data

    def _end(self, vector: Vector, template: tuple[str, ...], folder: Folder) -> Ended:
        o = self.options
        bounds = Bounds(vector.budget.seconds * o.slow, vector.budget.bytes, folder, self.stop)
        places = {"input": folder.input, "output": folder.output, "trace": folder.trace, "camera": folder.camera}
        watcher = self._watchers.get()
        try:
            if o.serve and template is o.command:
                wanted = ("input", "output", "trace") if o.trace else ("input", "output")
                return watcher.ask(template, {name: str(places[name]) for name in wanted}, bounds)
            return watcher.run(process.fill(template, places), bounds)
        finally:
            self._watchers.put(watcher)

    def close(self) -> None:
        """Ends all decoders, after the last vector."""
        while not self._watchers.empty():
            self._watchers.get().close()

    def _with_trace(self, vector: Vector, judgement: Judgement, folder: Folder) -> Judgement:
        if not self.options.trace or judgement.text or not isinstance(vector.expectation, Accepted):
            return judgement
        try:
            with open_file(folder.trace) as file:
                right = symbols_digest(file.read()) == vector.expectation.trace
        except FileNotFoundError:
            return Judgement(0, "the output is right; no trace was written")
        except FileError as error:
            return Judgement(0, f"the output is right; the trace {error}")
        return judgement if right else Judgement(0, "the output is right, the trace is not")

    def _explained(self, result: Result, vector: Vector, folder: Folder) -> Result:
        """Adds divergence, annotated bytes and the first wrong probe to a failure."""
        # Only failures need numpy, which is slow to import.
        from . import divergence  # noqa: PLC0415

        assert result.found is not None
        data, lines, probe, spot = self._data(vector), list[str](), None, result.found.offset
        if isinstance(vector.expectation, Rejected):
            spot = vector.expectation.offset
        else:
            output = _content(folder.output) if result.found.result == "accepted" else None
            differs = None if output is None else divergence.of_output(data, output)
            lines += [differs.text()] if differs else []
            trace = _content(folder.trace)
            if trace is not None:
                symbol, compared = divergence.of_trace(data, trace)
                probe, of_probes = compared.first, list(compared.lines(symbol is not None))
                lines = [*of_probes, *lines] if probe else [*lines, *of_probes]
                if symbol:
                    lines.append(symbol.text())
                    spot = symbol.offset
        near = () if spot is None else tuple(divergence.annotated(data, spot))
        return replace(result, divergence=tuple(lines), hex=near, probe=probe)


def _content(path: Path) -> bytes | None:
    """Reads a decoder's output; None if it is not a regular file."""
    with suppress(FileNotFoundError, FileError), open_file(path) as file:
        return file.read()
    return None


def run(manifest: Manifest, vectors: Sequence[Vector], options: Options, known: Iterable[str] = ()) -> Run:
    """Runs a decoder on vectors. An interrupt (SIGINT, SIGTERM or SIGHUP) ends the run with the results so far.

    known: identifiers of vectors that must fail.
    """
    ended: dict[str, Result] = {}
    done, names = Run(), set(known)
    bar = tqdm(total=len(vectors), unit="vectors", **bar_options())
    with ExitStack() as stack:
        # The default action of these signals would leave decoders behind.
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) == signal.SIG_DFL:
                stack.callback(signal.signal, number, signal.signal(number, signal.default_int_handler))
        desk = stack.enter_context(closing(_Desk(manifest, options)))
        pool = stack.enter_context(ThreadPoolExecutor(options.jobs))
        stack.enter_context(bar)
        # Long vectors first, so that none of them runs alone at the end.
        queue = [pool.submit(desk.run, v) for v in sorted(vectors, key=lambda v: (-v.budget.seconds, -v.input.size))]
        try:
            for result in _as_they_end(queue):
                ended[result.id] = as_known(result) if result.id in names else result
                bar.update()
                bad = sum(not r.is_good for r in ended.values())
                bar.set_postfix_str(f"{bad} failed" if bad else "", refresh=False)
        except KeyboardInterrupt:
            done.interrupted = True
        finally:
            desk.stop.set()
            for future in queue:
                future.cancel()
    done.results = [ended[v.id] for v in vectors if v.id in ended]
    return done


def _as_they_end(queue: Iterable[Future[Result]]) -> Iterable[Result]:
    waiting = set(queue)
    while waiting:
        # On some systems a wait without a timeout cannot be interrupted.
        ready, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
        yield from (future.result() for future in ready)


def as_known(result: Result) -> Result:
    """Returns the result of a known failure."""
    if result.status == "passed":
        return replace(result, status="unexpected", text="a known failure passes: take it off the list")
    return replace(result, status="known") if result.status in ("failed", "crashed") else result
