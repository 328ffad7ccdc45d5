"""What a command may write to: one rule for every output of every command.

- An output is never a file that the same run reads, and never beside the files of a folder that it reads.
- It is never another output of the same run.
- An existing file is replaced only if it is empty, or of the kind that the command makes.

Files are compared as they are on the disk: links of both kinds, `./` and case do not hide that two names are one file.
Pipes and devices are written to as they are, because nothing in them is lost.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..statuses import UsageError
from .text import printable

# What the help of a command says of its outputs.
HELP = """\
outputs:
  All of them are written beside their places, and moved there when they are whole. A run that fails changes nothing.
  An output is never a file that is read, nor beside the files of a folder that is read, nor another output.
  An existing file is replaced only if it is empty, or of the kind that this command makes."""

# What is looked at of an existing file.
_HEAD_BYTES = 4096

# Device and inode: what a file is, whatever it is called.
_Identity = tuple[int, int]


@dataclass(frozen=True)
class Kind:
    """A kind of files that a command makes. name: with its article. begins: matches the first bytes of each of them."""

    name: str
    begins: re.Pattern[bytes]

    @classmethod
    def signed(cls, name: str, signature: bytes) -> Kind:
        """The kind of the files that begin with a signature."""
        return cls(name, re.compile(re.escape(signature)))


def check_file(path: Path, kind: Kind, made: bool = False) -> None:
    """Raises UsageError unless a file can be made at a path: nothing is there, or a file of the kind, or an empty one.

    made: whether the run makes the folder of the file, if it is not there.
    """
    status = _status(path)
    if status is None:
        folder = Path(os.path.realpath(path)).parent
        there = _status(folder)
        if there is None and not made:
            raise UsageError(f"there is no directory {_shown(folder)}")
        if there is not None and not stat.S_ISDIR(there.st_mode):
            raise UsageError(f"{_shown(folder)} is not a directory")
    elif stat.S_ISDIR(status.st_mode):
        raise UsageError(f"{_shown(path)} is a directory: give the name of a file")
    elif stat.S_ISREG(status.st_mode) and status.st_size:
        with path.open("rb") as file:
            if not kind.begins.match(file.read(_HEAD_BYTES)):
                raise UsageError(f"{_shown(path)} exists and is not {kind.name}: choose another name, or remove it")


def check_apart(outputs: Iterable[Path], inputs: Iterable[str | Path | None]) -> None:
    """Raises UsageError if an output is an input, or beside the files of a folder that is read, or another output.

    Args:
        outputs: files, which need not be there.
        inputs: files, and folders whose files are read. Folders in them count only if they are given, too. None stands
            for an input that is not given. What is not there is left to who reads it.
    """
    files, folders = _identities([Path(path) for path in inputs if path is not None])
    taken: dict[tuple[str, str] | _Identity, Path] = {}
    for path in outputs:
        status = _status(path)
        if status is not None and not stat.S_ISREG(status.st_mode):
            # Pipes and devices keep nothing that could be lost.
            continue
        real = Path(os.path.realpath(path))
        above = _status(real.parent)
        name = files.get(_identity(status)) if status is not None else None
        if name is not None:
            raise UsageError(f"{_shown(path)} is {_shown(name)}, which is read: choose another output")
        name = folders.get(_identity(above)) if above is not None else None
        if name is not None:
            raise UsageError(f"{_shown(path)} is in {_shown(name)}, whose files are read: choose another output")
        # Some systems take names that differ in case for one file.
        key = (str(real.parent), unicodedata.normalize("NFC", real.name).casefold())
        for mark in (key, *(() if status is None else (_identity(status),))):
            if taken.setdefault(mark, path) is not path:
                raise UsageError(f"{_shown(taken[mark])} and {_shown(path)} are one file: each output needs its own")


def _identities(paths: list[Path]) -> tuple[dict[_Identity, Path], dict[_Identity, Path]]:
    """Returns the files and the folders that are read, by identity, with the name of each."""
    files: dict[_Identity, Path] = {}
    folders: dict[_Identity, Path] = {}
    for path in paths:
        status = _status(path)
        if status is None:
            continue
        if not stat.S_ISDIR(status.st_mode):
            files.setdefault(_identity(status), path)
        elif folders.setdefault(_identity(status), path) is path:
            # Links of both kinds give its files other names elsewhere.
            for file in _listed(path):
                # A link in a circle is told by who reads it.
                with contextlib.suppress(OSError):
                    there = _status(file)
                    if there is not None and stat.S_ISREG(there.st_mode):
                        files.setdefault(_identity(there), file)
    return files, folders


def _listed(folder: Path) -> list[Path]:
    """Returns what is in a folder, or nothing if it may not be listed. Its files may be readable all the same."""
    try:
        return sorted(folder.iterdir())
    except PermissionError:
        return []


def _status(path: Path) -> os.stat_result | None:
    """Returns what is at a path, or None for nothing or a link that leads nowhere. Raises OSError, as for a circle."""
    try:
        return os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None


def _identity(status: os.stat_result) -> _Identity:
    return status.st_dev, status.st_ino


def _shown(path: Path) -> str:
    return printable(str(path))
