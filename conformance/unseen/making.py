"""A wrong decoder in a folder, which says of one file after the other what its process says."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from refcodec.bitstream import tables

from ..runner.process import CommandError, Ended
from .bugs import CONFORMANCE, SOURCES, Wrong

# A process that waits is ended after this many times its seconds.
_PATIENCE = 10
_IGNORED = shutil.ignore_patterns("__pycache__")


class Decoder(Protocol):
    """command: what a person would type, with {input} and {output}."""

    command: tuple[str, ...]

    def run(self, file: Path, output: Path, seconds: float, memory: int) -> Ended:
        """How a process ends that decodes a file. It may take so many seconds of processor time, and bytes."""
        ...


@contextlib.contextmanager
def made(wrong: Wrong, folder: Path) -> Iterator[Decoder]:
    """A wrong decoder in an empty folder.

    Raises BugError if its bugs cannot be planted, CommandError if there is no compiler or it refuses the text.
    """
    if wrong.decoder == "c":
        yield _Compiled(wrong.texts(), folder)
        return
    decoder = _Python(wrong.texts(), folder)
    try:
        yield decoder
    finally:
        decoder.close()


def _over(code: int) -> Ended:
    """The end of a process that a signal ended: its time was over, or it crashed."""
    return Ended(None, -code, "time" if -code == signal.SIGPROF else None, b"", 0.0, None)


class _Python:
    """The second decoder with other files. One process decodes all, and another one after a crash of it."""

    def __init__(self, texts: dict[str, str], folder: Path) -> None:
        # The packages are links to the right ones. Only the second decoder's is a copy.
        package = folder / CONFORMANCE.name
        package.mkdir()
        (folder / "refcodec").symlink_to(CONFORMANCE.parent / "refcodec")
        for entry in CONFORMANCE.iterdir():
            if entry != SOURCES["independent"] and entry.name != "__pycache__":
                (package / entry.name).symlink_to(entry)
        shutil.copytree(SOURCES["independent"], package / "independent", ignore=_IGNORED)
        for name, text in texts.items():
            (package / "independent" / name).write_text(text, encoding="utf-8")
        self.command: tuple[str, ...] = ("python", "-m", "conformance.independent", "decode", "{input}", "{output}")
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None

    def run(self, file: Path, output: Path, seconds: float, memory: int) -> Ended:
        began, process = time.monotonic(), self._started()
        assert process.stdin is not None
        assert process.stdout is not None
        request = {"input": str(file), "output": str(output), "seconds": seconds, "bytes": memory}
        process.stdin.write(json.dumps(request).encode() + b"\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line.endswith(b"\n"):
            ended = _over(process.wait())
            self.close()
            return ended
        said = json.loads(line)
        return Ended(said["status"], None, None, said["stderr"].encode(), time.monotonic() - began, None)

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            # -P: what is imported comes from this folder, not from the one that the process is started in.
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "conformance.unseen.child"],
                env={**os.environ, "PYTHONPATH": str(self._folder)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
        return self._process

    def close(self) -> None:
        """Ends its process, if there is one."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()


class _Compiled:
    """The decoder in C with another text, compiled. Each file has a process."""

    def __init__(self, texts: dict[str, str], folder: Path) -> None:
        compiler = os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)
        if compiler is None:
            raise CommandError("there is no C compiler (cc, gcc, clang, or one that CC names)")
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        self._program = folder / "decoder"
        # The decoder looks for the tables beside itself.
        (folder / "tables-0.bin").write_bytes(tables.tables_bytes())
        command = [compiler, "-std=c11", "-O2", *(str(folder / name) for name in texts), "-o", str(self._program)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise CommandError(f"the compiler refuses a wrong decoder: {ended.stderr.strip()}")
        self.command: tuple[str, ...] = ("decoder", "decode", "{input}", "{output}")

    def run(self, file: Path, output: Path, seconds: float, memory: int) -> Ended:
        # The decoder's memory is bounded by its own checks, which no bug of the list takes away.
        del memory
        began, command = time.monotonic(), [str(self._program), "decode", str(file), str(output)]
        try:
            ended = subprocess.run(command, capture_output=True, check=False, timeout=_PATIENCE * seconds)
        except subprocess.TimeoutExpired:
            return Ended(None, None, "time", b"", time.monotonic() - began, None)
        if ended.returncode < 0:
            return _over(ended.returncode)
        return Ended(ended.returncode, None, None, ended.stderr, time.monotonic() - began, None)
