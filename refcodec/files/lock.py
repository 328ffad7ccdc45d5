"""Locks between processes (filelock), and the folders that hold them."""

# filelock is imported where it is used, so that help is instant.
# ruff: noqa: PLC0415

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path

from ..statuses import UsageError
from .text import printable

# The prefix of the names of temporary files and folders.
BESIDE = ".refcodec-"


def is_empty(folder: Path) -> bool:
    """Whether a folder has no entries but temporary ones. Raises OSError."""
    return all(entry.name.startswith(BESIDE) for entry in folder.iterdir())


@contextlib.contextmanager
def errors_of(shown: Path) -> Iterator[None]:
    """Makes an OSError name an output if it names no file, or a temporary one. shown: the output."""
    try:
        yield
    except OSError as error:
        if error.filename is None or BESIDE in str(error.filename):
            error.filename = str(shown)
        raise


@contextlib.contextmanager
def made_folder(path: Path) -> Iterator[None]:
    """Makes a folder and its missing parents. At the end it removes those of them that are empty. Raises OSError."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for folder in missing:
            with contextlib.suppress(OSError):
                folder.rmdir()


@contextlib.contextmanager
def hold_file(path: Path, wait: bool = False, shown: Path | None = None) -> Iterator[None]:
    """Holds a lock file, which exists only meanwhile, in a folder of made_folder.

    The system releases the lock when the process ends. On file systems without locks, the lock holds nobody up.

    Args:
        path: the lock file.
        wait: whether to wait for another holder.
        shown: the name in messages; None stands for the path.

    Raises:
        UsageError: another process holds it, and `wait` is false.
        OSError: the file or its folder cannot be made.
    """
    from filelock import FileLock, Timeout

    while True:
        with made_folder(path.parent), contextlib.ExitStack() as held:
            try:
                with errors_of(shown or path):
                    held.enter_context(FileLock(path).acquire(timeout=-1 if wait else 0))
            except Timeout:
                name = printable(str(shown or path))
                raise UsageError(f"another run writes to {name}: wait for it, or choose another place") from None
            except FileNotFoundError:
                # The holder before has removed the folder.
                continue
            except OSError as error:
                if error.errno not in (errno.ENOLCK, errno.ENOTSUP):
                    raise
            held.callback(_remove, path)
            yield
            return


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def hold_folder(folder: Path, wait: bool = False) -> contextlib.AbstractContextManager[None]:
    """Holds the lock of a folder, which is made if it is missing, and removed at the end if it was made and is empty.

    wait, errors: as in hold_file.
    """
    return hold_file(folder / f"{BESIDE}lock", wait, folder)
