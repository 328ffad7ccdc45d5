"""Runs a decoder on vectors: several processes at a time, each within the vector's budget."""

from __future__ import annotations

import hashlib
import json
import queue
import signal
import sys
import threading
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from tqdm import tqdm

from refcodec.files.text import printable

from ..manifest import Accepted, GaussiansOf, Manifest, ManifestError, Rejected, Vector
from . import process
from .folder import FileError, Folder, open_file
from .grading import GRADE_EXACT, Found, Judgement, judge, read
from .process import Ended, StoppedError, Watcher
from .traces import Probe, symbols_digest

# The longest error output of a process in a report, in characters.
STDERR_CHARACTERS = 4000
# The text of a result without a run.
SKIPPED = "no command for Gaussians was given (--gaussians)"


@dataclass(frozen=True)
class Options:
    """The options of a run.

    command: of the decoder, a template with {input} and {output}, and optionally {trace}. gaussians: a template with
    {camera} too, None without a renderer. jobs: number of processes. grade: the lowest grade that passes. slow: factor
    of the time budgets. trace: the trace is judged too. serve: the command serves (process.Watcher.ask).
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
    """The result of a vector.

    status: "passed", "failed", "crashed" or "skipped"; of a known failure "known", or "unexpected" if it passes.
    grade: 0 to 3. text: the fault, in words. found: the decoder's answer, None if it was not run. divergence: the
    first differences of output and trace. hex: the bytes of the file, annotated. probe: the first wrong number of a
    trace. stderr: its beginning and its end, printable. seconds, peak: of the process (Ended).
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
    probe: Probe | None = None

    @property
    def good(self) -> bool:
        """Whether a run with this result can succeed."""
        return self.status in ("passed", "known", "skipped")


@dataclass
class Run:
    """The outcome of a run.

    results: in the order of the vectors, without those that an interrupted run did not reach. left: folders that could
    not be removed.
    """

    results: list[Result] = field(default_factory=list)
    interrupted: bool = False
    left: list[str] = field(default_factory=list)


def status_of(found: Found, judgement: Judgement, grade: int) -> str:
    """Returns the status of a vector that was run and is not a known failure. grade: the lowest that passes."""
    if found.result == "crashed":
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
    """Runs single vectors, each in its own folder."""

    def __init__(self, manifest: Manifest, options: Options) -> None:
        self.manifest, self.options = manifest, options
        self.stop = threading.Event()
        self.left: list[str] = []
        self._watchers: queue.SimpleQueue[Watcher] = queue.SimpleQueue()
        for _ in range(options.jobs):
            self._watchers.put(Watcher())
        # The folders of vectors by identifier, and the free folders.
        self._folders: dict[str, Folder] = {}
        self._free: queue.SimpleQueue[Folder] = queue.SimpleQueue()

    def run(self, vector: Vector) -> Result:
        """Returns the result of a vector. Raises StoppedError if the run is stopped meanwhile.

        The folder of a failure is kept for `explain`.
        """
        camera, template = None, self.options.command
        if isinstance(vector.expectation, GaussiansOf):
            if self.options.gaussians is None:
                return Result(vector, "skipped", text=SKIPPED)
            template = self.options.gaussians
            camera = json.dumps(vector.expectation.camera).encode()
        if self.stop.is_set():
            raise StoppedError
        folder = self._folders[vector.id] = self._folder()
        folder.put(self._data(vector), camera)
        ended = self._end(vector, template, folder)
        found, damage = read(ended, folder.output), folder.fault()
        if damage and not ended.over:
            found = Found("crashed", ended.status, ended.signal, text=damage)
        judgement = self._with_trace(vector, judge(self.manifest, vector, found, folder.output), folder)
        if found.result == "crashed":
            self._remove(self._folders.pop(vector.id))
        elif not judgement.text:
            self._release(vector)
        return Result(
            vector,
            status_of(found, judgement, self.options.grade),
            judgement.grade,
            judgement.text,
            found,
            stderr=shown(ended.stderr),
            seconds=ended.seconds,
            peak=ended.peak,
        )

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
        o, seconds, memory = self.options, vector.budget.seconds * self.options.slow, vector.budget.bytes
        places = {"input": folder.input, "output": folder.output, "trace": folder.trace, "camera": folder.camera}
        watcher = self._watchers.get()
        try:
            if o.serve and template is o.command:
                wanted = ("input", "output", "trace") if o.trace else ("input", "output")
                request = {name: str(places[name]) for name in wanted}
                return watcher.ask(template, request, seconds, memory, self.stop, folder)
            return watcher.run(process.fill(template, places), seconds, memory, self.stop, folder)
        finally:
            self._watchers.put(watcher)

    def _folder(self) -> Folder:
        with suppress(queue.Empty):
            return self._free.get_nowait()
        return Folder()

    def _release(self, vector: Vector) -> None:
        """Clears a folder without a fault for the next vector."""
        folder = self._folders.pop(vector.id)
        try:
            folder.clear()
        except OSError:
            self._remove(folder)
        else:
            self._free.put(folder)

    def _remove(self, folder: Folder) -> None:
        left = folder.close()
        if left:
            self.left.append(left)

    def close(self) -> None:
        """Ends all decoders and removes all folders, after the last vector."""
        while not self._watchers.empty():
            self._watchers.get().close()
        while not self._free.empty():
            self._remove(self._free.get())
        for folder in self._folders.values():
            self._remove(folder)

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

    def explain(self, result: Result) -> Result:
        """Adds divergence, annotated bytes and the first wrong probe to a failure, and frees its folder."""
        folder = self._folders.get(result.vector.id)
        if folder is None:
            return result
        try:
            return self._explained(result, folder)
        finally:
            self._release(result.vector)

    def _explained(self, result: Result, folder: Folder) -> Result:
        vector, found = result.vector, result.found
        if found is None or isinstance(vector.expectation, GaussiansOf):
            return result
        # Only failures need numpy, which is slow to import.
        from . import divergence  # noqa: PLC0415

        data = self._data(vector)
        lines, spot, probe = list[str](), None, None
        if isinstance(vector.expectation, Rejected):
            spot = vector.expectation.offset
        else:
            output = _content(folder.output) if found.result == "accepted" else None
            differs = None if output is None else divergence.of_output(data, output)
            if differs:
                lines.append(differs.text())
            trace = _content(folder.trace)
            symbol = None
            if trace is not None:
                symbol, compared = divergence.of_trace(data, trace)
                probe = compared.first
                told = list(compared.lines(symbol is not None))
                lines = [*told, *lines] if probe else [*lines, *told]
            if symbol:
                lines.append(symbol.text())
            spot = symbol.offset if symbol else found.offset
        near = [] if spot is None else divergence.annotated(data, spot)
        return replace(result, divergence=tuple(lines), hex=tuple(near), probe=probe)


def _content(path: Path) -> bytes | None:
    """Reads a decoder's output; None if it is not a regular file."""
    with suppress(FileNotFoundError, FileError), open_file(path) as file:
        return file.read()
    return None


def run(
    manifest: Manifest, vectors: Sequence[Vector], options: Options, known: Iterable[str] = (), show: bool = True
) -> Run:
    """Runs a decoder on vectors. An interrupt (SIGINT, SIGTERM or SIGHUP) ends the run with the results so far.

    known: identifiers of vectors that must fail. show: show a progress bar on stderr.
    """
    ended: dict[str, Result] = {}
    done = Run()
    bar = tqdm(total=len(vectors), unit="vector", file=sys.stderr, disable=not show)
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
    done.left = [printable(text) for text in desk.left]
    names = set(known)
    done.results = [as_known(r) if r.vector.id in names else r for r in done.results]
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
