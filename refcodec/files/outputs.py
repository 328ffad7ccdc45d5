"""Rules for the outputs of every command.

- An output is never a file that the same run reads, and never in a folder whose files it reads.
- It is never another output of the same run.
- An existing file is replaced only if it is empty, or of the kind that the command makes.

Files are compared by identity on the disk: two names of one file, by links of both kinds, `./` or case, count as one.
Pipes and devices are exempt, because they hold nothing that could be lost.
"""

from __future__ import annotations

import os
import re
import stat
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..statuses import UsageError
from .text import printable

# The paragraph about outputs in the help of a command.
HELP = """\
outputs:
  All of them are written beside their places, and moved there when they are whole. A run that fails changes nothing.
  An output is never a file that is read, nor in a folder whose files are read, nor another output.
  An existing file is replaced only if it is empty, or of the kind that this command makes."""

# The bytes of an existing file that are compared with a kind.
_HEAD_BYTES = 4096


@dataclass(frozen=True)
class Kind:
    """A kind of files that a command makes. name: with its article. begins: matches the first bytes of each of them."""

    name: str
    begins: re.Pattern[bytes]

    @classmethod
    def signed(cls, name: str, *signatures: bytes) -> Kind:
        """Returns the kind of the files that begin with one of some signatures."""
        return cls(name, re.compile(b"|".join(map(re.escape, signatures))))


def check_file(path: Path, kind: Kind, made: bool = False) -> None:
    """Raises UsageError unless a path is free for a file: nothing, a file of the kind, an empty file, or a pipe.

    made: whether the run makes a missing folder of the file. Raises OSError.
    """
    mode, shown = _mode(path), _shown(path)
    folder = Path(os.path.realpath(path)).parent
    if mode == 0 and not folder.is_dir():
        if folder.exists():
            raise UsageError(f"{_shown(folder)} is not a directory")
        if not made:
            raise UsageError(f"there is no directory {_shown(folder)}")
    # Said before the work, which would be lost. A missing folder is made later.
    if (stat.S_ISREG(mode) or not mode) and folder.is_dir() and not os.access(folder, os.W_OK | os.X_OK):
        raise UsageError(f"{shown} cannot be written: {_shown(folder)} is read-only; choose another folder")
    if stat.S_ISDIR(mode):
        raise UsageError(f"{shown} is a directory: give the name of a file")
    if stat.S_ISREG(mode):
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        if head and not kind.begins.match(head):
            raise UsageError(f"{shown} exists and is not {kind.name}: choose another name, or remove it")


def check_apart(outputs: Iterable[Path], inputs: Iterable[str | Path | None]) -> None:
    """Raises UsageError if an output is an input, or in an input folder, or another output. Raises OSError.

    Args:
        outputs: files, which may be missing.
        inputs: files, and folders whose files are read. Their subfolders count only if they are listed, too. None
            stands for an input that is not given. A missing input is ignored: its reader reports it.
    """
    read: dict[tuple[int, int] | None, Path] = {}
    for path in (Path(path) for path in inputs if path is not None):
        # The files of a folder may have other names elsewhere, by links of both kinds.
        for file in (path, *_files_in(path)):
            read.setdefault(_identity(file), file)
    read.pop(None, None)
    taken: dict[object, Path] = {}
    for path in outputs:
        if (mode := _mode(path)) and not stat.S_ISREG(mode):
            continue
        real, own = Path(os.path.realpath(path)), _identity(path)
        if name := read.get(own):
            raise UsageError(f"{_shown(path)} is {_shown(name)}, which is read: choose another output")
        if name := read.get(_identity(real.parent)):
            raise UsageError(f"{_shown(path)} is in {_shown(name)}, whose files are read: choose another output")
        # Some systems take names that differ in case, or in the form of an accent, for one file.
        key = (str(real.parent), unicodedata.normalize("NFC", real.name).casefold())
        for mark in (key, own or key):
            if (other := taken.setdefault(mark, path)) is not path:
                raise UsageError(f"{_shown(other)} and {_shown(path)} are one file: each output needs its own")


def _files_in(folder: Path) -> list[Path]:
    """Returns the files in a folder; none if it is not a folder, or cannot be listed."""
    try:
        return sorted(path for path in folder.iterdir() if path.is_file())
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return []


def _status(path: Path) -> os.stat_result | None:
    """Returns the status of a path, or None if it is missing or a link to nothing. Raises OSError, as for a circle."""
    try:
        return os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None


def _mode(path: Path) -> int:
    return 0 if (status := _status(path)) is None else status.st_mode


def _identity(path: Path) -> tuple[int, int] | None:
    return None if (status := _status(path)) is None else (status.st_dev, status.st_ino)


def _shown(path: Path) -> str:
    return printable(str(path))
