"""Compiles the C sources of the benchmarks with the system's compiler, and keeps the results under out/."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from .large import KEPT
from .results import processor


class MissingError(Exception):
    """Something that a contender needs is missing. The message names it."""


def compiler() -> str:
    """Returns the command of the C compiler, which the environment variable CC may name. Raises MissingError."""
    name = os.environ.get("CC", "cc")
    if shutil.which(name) is None:
        raise MissingError(f"there is no C compiler {name}")
    return name


def compiler_version() -> str | None:
    """Returns the first line of the compiler's version, or None without a compiler."""
    try:
        done = subprocess.run([compiler(), "--version"], capture_output=True, text=True, check=True)
    except (MissingError, OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.splitlines()[0]


def compiled(source: Path, flags: Sequence[str], kept: Path = KEPT) -> Path:
    """Returns the program or library of a C source.

    It is compiled once for each source text, flags, compiler and processor. Raises MissingError.
    """
    command = [compiler(), *flags]
    made_of = [source.read_text(), *command, str(compiler_version()), *map(str, processor().values())]
    path = kept / f"{source.stem}-{hashlib.sha256(chr(0).join(made_of).encode()).hexdigest()[:16]}"
    if not path.exists():
        kept.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(f".{os.getpid()}")
        done = subprocess.run(
            [*command, str(source), "-o", str(temporary)], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise MissingError(f"{' '.join(command)} cannot compile {source.name}")
        temporary.replace(path)
    return path
