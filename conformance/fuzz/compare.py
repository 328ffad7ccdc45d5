"""Compares both decoders, and optionally another one, on many files.

The files are valid scenes of profile Tiny, and changed, truncated or faulty versions of them. The decoders must agree
on the digest, or on the error and its offset, and with the verdict if it is known. The encoder must write an accepted
file again for its scene (SPEC 4.3). refcodec decodes and encodes by each path of the machine: NumPy, and the variants
of the native kernel.
"""

import hashlib
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from unittest import mock

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from tqdm import tqdm

from refcodec.bitstream import codec, reconstruction
from refcodec.bitstream.errors import BitstreamError
from refcodec.bitstream.scene import Scene
from refcodec.files.stage import write_file
from refcodec.files.terminal import bar_options
from refcodec.native import library

from .. import spec_decoder
from ..cases.target import Target
from ..runner import grading, process
from ..runner.folder import Folder
from .strategies import draw_fault, draw_mutation, draw_splice, drawable, scenes

# Limits: seconds for one decoder and one file, which are those of a processor in this process; bytes of address space
# of a worker, most of which libraries use; and bytes of resident memory of another decoder's process.
FILE_SECONDS = 20
WORKER_BYTES = 3 << 30
PROCESS_BYTES = 256 << 20
# Files made from one scene, including its own; scenes in a batch.
FILES_OF_A_SCENE = 20
BATCH_SCENES = 25

Verdict = tuple[str, int]


def _decoded(data: bytes) -> tuple[Scene | None, Verdict]:
    """Returns refcodec's scene, None if it refuses the file, and its verdict."""
    try:
        scene = codec.parse(data).scene
        return scene, (reconstruction.digest(scene)[0], -1)
    except BitstreamError as error:
        return None, (error.kind.name, error.offset)


def first_verdict(data: bytes) -> Verdict:
    """Returns refcodec's verdict: name and offset of its error, or the digest and -1."""
    return _decoded(data)[1]


@contextmanager
def on_path(name: str) -> Iterator[None]:
    """Selects a path of refcodec in this process."""
    with mock.patch.dict(os.environ, {library.PATH_VARIABLE: name}):
        yield


def _paths() -> list[str]:
    """Returns refcodec's paths on this machine, NumPy first. `native` is one of the following variants."""
    return [name for name in library.paths() if name != library.NATIVE]


def _faulty_path(data: bytes, first: Verdict) -> str | None:
    """Returns the fault of a path of refcodec, or None. first: the verdict of NumPy."""
    for name in _paths():
        with on_path(name), _limited(FILE_SECONDS):
            scene, verdict = _decoded(data)
            if verdict != first:
                return f"refcodec says {first} by NumPy, and {verdict} by {name}"
            if scene is not None and codec.emit(scene) != data:
                return f"accepted, but not what the encoder writes for its scene by {name}"
    return None


def second_verdict(data: bytes) -> Verdict:
    """Returns the verdict of the second decoder, as first_verdict."""
    try:
        return spec_decoder.decode(data).digest, -1
    except spec_decoder.C3GSError as error:
        return error.name, error.offset


class BudgetError(Exception):
    """A decoder exceeded its time limit."""


class AnswerError(Exception):
    """The output of a process is neither an acceptance nor a refusal."""


@contextmanager
def _unlimited() -> Iterator[None]:
    """Removes the address space limit of a child process: interpreters and sanitizers reserve much."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def command_verdict(command: Sequence[str], data: bytes) -> Verdict:
    """Returns the verdict of a decoder in a separate process, with the interface of `conformance run`.

    Raises AnswerError.
    """
    with closing(Folder(data)) as folder, _unlimited():
        words = process.fill(command, {"input": folder.input, "output": folder.output})
        bounds = process.Bounds(FILE_SECONDS, PROCESS_BYTES, folder, threading.Event())
        answer = grading.read(process.Watcher().run(words, bounds), folder.output)
    if answer.result == "accepted":
        return str(answer.digest), -1
    if answer.result == "crashed":
        raise AnswerError(f"a crash: {answer.text}")
    assert answer.code is not None
    kind = grading.BY_CODE[answer.code]
    if answer.status != grading.exit_status(kind.klass):
        raise AnswerError(f"exit status {answer.status} with {kind.name}, which is {kind.klass}")
    if answer.offset is None:
        raise AnswerError(f"{kind.name} without an offset")
    return kind.name, answer.offset


@contextmanager
def _limited(seconds: int) -> Iterator[None]:
    """Limits the processor time of a block, so that a loaded machine changes no result."""

    def stop(*_: object) -> None:
        raise BudgetError(f"more than {seconds} s of a processor")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def compare(data: bytes, expected: Verdict | None = None, command: Sequence[str] = ()) -> tuple[Verdict, str | None]:
    """Returns refcodec's verdict, and a fault or None.

    A fault is a difference between decoders, another failure of one, or an unexpected verdict. command: of another
    decoder, with {input} and {output}.
    """
    verdicts = []
    for decoder in (first_verdict, second_verdict):
        try:
            with on_path(library.NUMPY), _limited(FILE_SECONDS):
                verdicts.append(decoder(data))
        except Exception as error:  # any failure is a finding
            return ("crash", 0), f"{decoder.__name__}: {type(error).__name__}: {error}"
    first, second = verdicts
    if first != second:
        return first, f"refcodec says {first}, the second decoder {second}"
    if expected is not None and first != expected:
        return first, f"both say {first}, expected was {expected}"
    try:
        wrong = _faulty_path(data, first)
    except Exception as error:  # as above
        wrong = f"a path of refcodec: {type(error).__name__}: {error}"
    if wrong:
        return first, wrong
    if command:
        try:
            third = command_verdict(command, data)
        except AnswerError as error:
            return first, f"refcodec says {first}, the decoder {error}"
        if third != first:
            return first, f"refcodec says {first}, the decoder {third}"
    return first, None


KINDS = ["fault", "fault", "fault", "mutation", "mutation", "splice", "splice", "cut", "flip"]


@st.composite
def families(draw: st.DrawFn) -> list[tuple[bytes, Verdict | None]]:
    """Draws a valid file and files made from it, each with its verdict if that is known."""
    scene = draw(scenes(max_anchors=6))
    target = Target(codec.emit(scene))
    data = target.data
    made: list[tuple[bytes, Verdict | None]] = [(data, (reconstruction.digest(scene)[0], -1))]
    for _ in range(FILES_OF_A_SCENE - 1):
        kind = draw(st.sampled_from(KINDS))
        if kind == "fault":
            fault = draw_fault(draw, target, draw(st.sampled_from(sorted(drawable()))))
            if fault is not None:
                made.append((fault.data, (fault.name, fault.offset)))
        elif kind in ("cut", "flip"):
            at = draw(st.integers(0, len(data) - 1))
            made.append(
                (data[:at] if kind == "cut" else target.put(at, bytes([data[at] ^ 1 << draw(st.integers(0, 7))])), None)
            )
        else:
            made.append((draw_mutation(draw, data) if kind == "mutation" else draw_splice(draw, data), None))
    return made


@dataclass
class Findings:
    """Results of batches: number of files by verdict, and the text and smallest file of each disagreement."""

    seen: Counter[str] = field(default_factory=Counter)
    wrong: list[tuple[str, bytes]] = field(default_factory=list)


def batch(number: int) -> list[tuple[bytes, Verdict | None]]:
    """Returns the files of a batch, each with its verdict if that is known.

    The same number gives the same files.
    """
    files: list[tuple[bytes, Verdict | None]] = []

    @seed(number)
    @settings(
        max_examples=BATCH_SCENES,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
    )
    @given(families())
    def collect(made: list[tuple[bytes, Verdict | None]]) -> None:
        files.extend(made)

    collect()
    return files


def run_batch(number: int, command: Sequence[str] = ()) -> Findings:
    """Compares the decoders on the files of a batch. command: of another decoder."""
    findings = Findings()
    for data, expected in batch(number):
        verdict, wrong = compare(data, expected, command)
        findings.seen[verdict[0] if verdict[1] >= 0 else "accepted"] += 1
        if wrong:
            findings.wrong.append((wrong, data))
    return findings


def _start_worker() -> None:
    # Only the parent handles Ctrl-C. The memory of the worker is limited.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_AS, (WORKER_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]))


def run(count: int, first: int, jobs: int, keep: Path, command: Sequence[str]) -> int:
    """Compares the decoders on at least `count` files, in `jobs` processes. Returns 1 if they disagree on any, else 0.

    Args:
        count: number of files.
        first: number of the first batch. A run that was interrupted prints the number from which another continues.
        jobs: number of processes.
        keep: folder for files on which the decoders disagree.
        command: of another decoder, with {input} and {output}, or empty.
    """
    seen, wrong, began = Counter[str](), 0, time.monotonic()
    # Scenes without a place for a drawn fault give fewer files.
    least = BATCH_SCENES * FILES_OF_A_SCENE * 3 // 4
    batches = range(first, first + -(-count // least))
    bar = tqdm(total=count, unit="files", **bar_options())
    with multiprocessing.get_context("spawn").Pool(jobs, _start_worker) as pool, bar:
        try:
            for number, findings in zip(batches, pool.imap(partial(run_batch, command=command), batches), strict=True):
                first = number + 1
                seen += findings.seen
                bar.update(min(sum(findings.seen.values()), bar.total - bar.n))
                for text, data in findings.wrong:
                    wrong += 1
                    # The name depends on the content, so that files of other runs are not replaced.
                    path = keep / f"{number}-{hashlib.sha256(data).hexdigest()[:12]}.c3gs"
                    write_file(path, data)
                    see = f"refcodec inspect {path} --hex; python -m conformance.spec_decoder validate {path}"
                    print(f"{path}: {text}\n  to see it: {see}")
                if sum(seen.values()) >= count:
                    break
        except KeyboardInterrupt:
            print(f"interrupted: --seed {first} continues", file=sys.stderr)
            raise
    took = f"{time.monotonic() - began:.0f} s with {jobs} processes"
    print(f"{sum(seen.values())} files, {wrong} disagreements, {took}; the next seed is {first}; verdicts:")
    for name, number in seen.most_common():
        print(f"  {name:<26} {number:>7}")
    return 1 if wrong else 0
