"""A wrong decoder in a folder, as a command that the runner can run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from refcodec.bitstream import tables

from ..runner.process import CommandError
from .bugs import CONFORMANCE, SOURCES, Wrong

_IGNORED = shutil.ignore_patterns("__pycache__")


@dataclass(frozen=True)
class Made:
    """command: the decoder's. serve: whether it stays, and is asked (runner.process.Watcher.ask)."""

    command: tuple[str, ...]
    serve: bool


def make(wrong: Wrong, folder: Path) -> Made:
    """Makes a wrong decoder in an empty folder.

    Raises BugError if its bugs cannot be planted, CommandError if there is no compiler or it refuses the text.
    """
    return _python(wrong.texts(), folder) if wrong.decoder == "independent" else _compiled(wrong.texts(), folder)


def _python(texts: dict[str, str], folder: Path) -> Made:
    """The packages anew, by links to the right ones. Only the second decoder's is a copy, with the changed files."""
    package = folder / CONFORMANCE.name
    package.mkdir()
    (folder / "refcodec").symlink_to(CONFORMANCE.parent / "refcodec")
    for entry in CONFORMANCE.iterdir():
        if entry != SOURCES["independent"] and entry.name != "__pycache__":
            (package / entry.name).symlink_to(entry)
    shutil.copytree(SOURCES["independent"], package / "independent", ignore=_IGNORED)
    for name, text in texts.items():
        (package / "independent" / name).write_text(text, encoding="utf-8")
    # -P: what is imported comes from this folder, not from the one that the decoder is started in.
    serve = (sys.executable, "-P", "-m", "conformance.runner.serve", "independent")
    return Made(("env", f"PYTHONPATH={folder}", *serve), serve=True)


def _compiled(texts: dict[str, str], folder: Path) -> Made:
    compiler = os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is None:
        raise CommandError("there is no C compiler (cc, gcc, clang, or one that CC names)")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    program = folder / "decoder"
    # The decoder looks for the tables beside itself.
    (folder / "tables-0.bin").write_bytes(tables.tables_bytes())
    command = [compiler, "-std=c11", "-O2", *(str(folder / name) for name in texts), "-o", str(program)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise CommandError(f"the compiler refuses a wrong decoder: {ended.stderr.strip()}")
    return Made((str(program), "decode", "{input}", "{output}"), serve=False)
