"""The contenders of `decode`, and their processes.

Each contender is a separate process, which prepares itself and then waits (worker.py). Thus the environment can select
a path of refcodec for each, and none shares memory with another. Each contender runs once per round. A contender that
cannot take part is listed with the reason.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from tqdm import tqdm

from . import floor
from .large import KEPT, ROOT

# The kind of the contender that is not a Python process.
JAVASCRIPT = "javascript"
# The path that is always available, and the native paths. `native` is the one that refcodec chooses itself.
NUMPY, NATIVE = "numpy", "native"
NATIVE_PATHS = (NATIVE, "avx512vnni", "avx512", "avx2", "neon", "plain")
# Restricts all libraries to one thread.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "REFCODEC_THREADS"), "1")


@dataclass(frozen=True)
class Contender:
    """A contender. environment: additional variables of its process.

    kind: a key of worker.KINDS, or JAVASCRIPT. option: argument of the function for the kind.
    """

    name: str
    kind: str
    option: str = ""
    environment: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Missing:
    """A contender that does not take part, and the reason."""

    name: str
    why: str


class DisagreementError(Exception):
    """Contenders gave different results, or one failed. The message names them."""


def offered() -> tuple[list[str], list[Missing]]:
    """Returns the paths that refcodec offers on this machine, numpy first, and the missing ones.

    A path is offered if `refcodec --version`, with the path forced, names it.
    """
    found, missing = [NUMPY], []
    for path in NATIVE_PATHS:
        done = subprocess.run(
            [sys.executable, "-m", "refcodec", "--version"],
            env=os.environ | {"REFCODEC_PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode == 0 and path in done.stdout:
            found.append(path)
        else:
            said = next(reversed((done.stderr or done.stdout).splitlines()), "nothing")
            missing.append(Missing(f"refcodec, {path}", f"with this path, `refcodec --version` prints: {said}"))
    return found, missing


def contenders() -> tuple[list[Contender], list[Missing]]:
    """Returns the contenders, and the missing ones known before preparation."""
    paths, missing = offered()
    found: list[Contender] = []
    for path in paths:
        forced = {"REFCODEC_PATH": path}
        found.append(Contender(f"refcodec, {path}", "decode", environment=forced))
        if path in (NUMPY, NATIVE):
            # This is the work of `refcodec digest`, and always that of the C decoder.
            found.append(Contender(f"refcodec, {path}, with the digest", "digest", environment=forced))
        cores = os.cpu_count() or 1
        if path == NATIVE and cores > 1:
            threads = {**forced, "REFCODEC_THREADS": str(cores)}
            found.append(Contender(f"refcodec, {path}, {cores} threads", "decode", environment=threads))
    found.append(Contender("C decoder, with the digest", "c"))
    if shutil.which("node"):
        found.append(Contender("JavaScript and WebAssembly", JAVASCRIPT))
    else:
        missing.append(Missing("JavaScript and WebAssembly", "node is not installed"))
    found.append(Contender("float32 networks and constriction", "family"))
    found += [Contender(f"floor, {build}", "floor", build) for build in floor.builds()]
    return found, missing


class Worker:
    """The process of a contender. hello: its first answer, as worker.py prints it."""

    def __init__(self, contender: Contender, path: Path, kept: Path) -> None:
        """path: the scene's file. kept: the folder for compiled programs."""
        self.contender = contender
        if contender.kind == JAVASCRIPT:
            command = ["node", str(ROOT / "benchmarks" / "worker.mjs"), str(path)]
        else:
            own = [sys.executable, "-m", "benchmarks.worker"]
            command = [*own, contender.kind, str(path), str(kept), contender.option]
        search = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | ONE_THREAD | {"PYTHONPATH": search} | contender.environment,
        )
        self.hello = self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise DisagreementError(f"{self.contender.name} ended with status {self._process.wait()}")
        found: dict[str, Any] = json.loads(line)
        return found

    def run(self) -> dict[str, Any]:
        """Runs the contender once. Returns its seconds, its processor seconds, and those of its parts if any."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._answer()

    def stop(self) -> None:
        """Ends the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


@contextmanager
def workers(wanted: Sequence[Contender], path: Path, kept: Path) -> Iterator[tuple[list[Worker], list[Missing]]]:
    """Starts the processes in sequence, so that their preparations do not overlap. Stops them at the end."""
    ready, missing = [], []
    with ExitStack() as stack:
        for contender in tqdm(wanted, "preparing", leave=False):
            worker = Worker(contender, path, kept)
            stack.callback(worker.stop)
            if "missing" in worker.hello:
                missing.append(Missing(contender.name, worker.hello["missing"]))
            else:
                ready.append(worker)
        yield ready, missing


def compared(path: Path, rounds: int, kept: Path = KEPT) -> dict[str, Any]:
    """Returns the figures of a file: the contenders, the order of their runs, and all times.

    Raises DisagreementError if a result differs from that of the first contender, refcodec's numpy path.
    """
    wanted, missing = contenders()
    order: list[str] = []
    with workers(wanted, path, kept) as (ready, left_out):
        reference = ready[0].hello["digest"]
        for worker in ready:
            found = worker.hello["digest"]
            if found is not None and found != reference:
                raise DisagreementError(f"{worker.contender.name} gave {found}, {ready[0].contender.name} {reference}")
        times: dict[str, list[dict[str, Any]]] = {worker.contender.name: [] for worker in ready}
        for _ in tqdm(range(rounds), "rounds", leave=False):
            for worker in ready:
                order.append(worker.contender.name)
                times[worker.contender.name].append(worker.run())
        rows = [_row(worker, times[worker.contender.name]) for worker in ready]
    base = base_of(rows)
    for row in rows:
        for clock in ("seconds", "processor"):
            pairs = zip(row["runs"], base["runs"], strict=True)
            row["times"][clock] = median(own[clock] / other[clock] for own, other in pairs)
    return {
        "rounds": rounds,
        "order": order,
        "digest": reference,
        "base": base["name"],
        "contenders": rows,
        "missing": [vars(each) for each in (*missing, *left_out)],
    }


def _row(worker: Worker, runs: list[dict[str, Any]]) -> dict[str, Any]:
    medians = {clock: median(run[clock] for run in runs) for clock in ("seconds", "processor")}
    parts = {name: median(run["parts"][name] for run in runs) for name in runs[0].get("parts", {})}
    return {
        "name": worker.contender.name,
        "digest": worker.hello["digest"],
        "says": worker.hello["says"],
        **medians,
        **({"parts": parts} if parts else {}),
        "times": {},
        "runs": runs,
    }


def base_of(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Returns the row to compare with: refcodec's own choice of path with one thread, or its numpy path."""
    own = {row["name"]: row for row in rows}
    return own.get(f"refcodec, {NATIVE}") or own[f"refcodec, {NUMPY}"]
