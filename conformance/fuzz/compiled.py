"""Coverage-guided fuzzing of the code in C: the decoder of conformance/c, and the native kernel beside it.

libFuzzer of clang runs conformance/c/fuzz.c with AddressSanitizer and UndefinedBehaviorSanitizer. A folder keeps the
program, the inputs that reach new code, and those that fail. A later run continues there.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from refcodec.bitstream import tables
from refcodec.files.lock import hold_file
from refcodec.files.stage import write_file

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "conformance" / "c" / "fuzz.c"
NATIVE = ROOT / "refcodec" / "native"
SOURCES = [TARGET, NATIVE / "kernel.c", NATIVE / "splat.c"]
# Those of setup.py that change results, without threads.
FLAGS = ["-std=gnu11", "-g", "-ffp-contract=off", "-fno-math-errno", "-DKERNEL_THREADS=0"]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
# Bytes of an input, seconds of one input, and MiB of memory. Larger files only take longer.
LIMITS = ["-max_len=65536", "-timeout=300", "-rss_limit_mb=2048"]
# Of libFuzzer after SIGINT.
_INTERRUPTED = 72
_FAILED = re.compile(r"(crash|leak|oom|timeout)-[0-9a-f]{40}")
_EXECUTED = re.compile(r"stat::number_of_executed_units: *(\d+)")
_COVERED = re.compile(r"cov: (\d+) ft: (\d+) corp: (\d+)")


class CompilerError(Exception):
    """There is no clang with libFuzzer, or it cannot compile the target."""


def command(compiler: str, to: Path, *, replay: bool) -> list[str | Path]:
    """Returns the command that compiles the target. replay: as a program that only runs given files."""
    kind = ["-O0", "-DREPLAY"] if replay else ["-O1", "-fsanitize=fuzzer"]
    return [compiler, *FLAGS, *SANITIZERS, *kind, *SOURCES, "-lm", "-o", to]


def environment() -> dict[str, str]:
    """Returns the environment of the target."""
    return {**os.environ, "C3GS_TABLES": str(tables.tables_file())}


def _program(state: Path) -> Path:
    """Returns the target, compiled if a source is newer. Raises CompilerError."""
    path = state / "fuzz"
    sources = [*TARGET.parent.glob("*.c"), *NATIVE.glob("*.[ch]")]
    if path.exists() and all(source.stat().st_mtime < path.stat().st_mtime for source in sources):
        return path
    compiler = shutil.which("clang")
    if compiler is None:
        raise CompilerError("clang is not here: install it with its sanitizers (in Debian clang and libclang-rt-dev)")
    print("compiling, which takes a minute", file=sys.stderr)
    found = subprocess.run(command(compiler, path, replay=False), capture_output=True, text=True, check=False)
    if found.returncode:
        raise CompilerError(f"clang cannot compile {TARGET}: {found.stderr.strip()[:2000]}")
    return path


def run(hours: float, state: Path, seeds: Path) -> int:
    """Fuzzes for some hours of wall time with one process. Returns 1 if an input failed, now or earlier, else 0.

    state: the folder. seeds: a folder with files to begin with, besides the inputs of earlier runs. Ctrl-C ends the
    run, and nothing is lost. Raises CompilerError.
    """
    corpus = state / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    with hold_file(state / "lock"):
        program, began = _program(state), time.time()
        arguments = [f"-max_total_time={round(hours * 3600)}", *LIMITS, "-print_final_stats=1"]
        arguments += [f"-artifact_prefix={state}/", "-close_fd_mask=1"]
        with (state / "log.txt").open("a") as log:
            child = subprocess.Popen(
                [program, *arguments, corpus, seeds], stderr=subprocess.PIPE, text=True, env=environment()
            )
            assert child.stderr is not None
            for line in child.stderr:
                log.write(line)
                if _COVERED.search(line) and not line.rstrip().endswith("-"):
                    print(line.rstrip()[:110], file=sys.stderr)
            status = child.wait()
        return _report(state, time.time() - began, status)


def minimise(state: Path) -> None:
    """Keeps only the inputs of the corpus that reach what others do not. Raises CompilerError."""
    with hold_file(state / "lock"):
        program, old, new = _program(state), state / "corpus", state / "corpus.new"
        new.mkdir()
        subprocess.run(
            [program, "-merge=1", *LIMITS, "-close_fd_mask=1", new, old],
            check=True,
            env=environment(),
            stderr=subprocess.DEVNULL,
        )
        shutil.rmtree(old)
        new.rename(old)


def _report(state: Path, seconds: float, status: int) -> int:
    """Prints what all runs of a folder found; returns 1 if an input failed, or the last run. status: of that run."""
    log = (state / "log.txt").read_text()
    spent_file = state / "seconds.txt"
    spent = seconds + (float(spent_file.read_text()) if spent_file.exists() else 0)
    write_file(spent_file, str(spent).encode())
    failed = sorted(path for path in state.iterdir() if _FAILED.fullmatch(path.name))
    covered = [*_COVERED.finditer(log)]
    inputs = sum(map(int, _EXECUTED.findall(log)))
    print(f"{inputs} inputs in {spent / 3600:.2f} hours of all runs, {len(failed)} failed")
    if covered:
        print(f"{covered[-1][1]} edges of the code reached, {covered[-1][3]} inputs kept in {state / 'corpus'}")
    for path in failed:
        print(f"{path}: see the end of {state / 'log.txt'}; to run it: {state / 'fuzz'} {path}")
    if status == _INTERRUPTED:
        status = 0
    if status:
        print(f"the program ended with status {status}: see the end of {state / 'log.txt'}")
    return 1 if failed or status else 0
