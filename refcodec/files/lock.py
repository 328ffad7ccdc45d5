"""Locks between processes. The system gives a lock back when its holder ends, however it ends."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from ..statuses import UsageError
from .stage import make_folder, remove_folders
from .text import printable

try:
    import fcntl
except ImportError:  # pragma: no cover (systems without flock)
    fcntl = None  # type: ignore[assignment]

# What file systems without such locks answer. A run goes on without one there.
_NO_LOCKS = (errno.EBADF, errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS)


@contextlib.contextmanager
def hold_folder(folder: Path, wait: bool = False) -> Iterator[None]:
    """Holds the lock of a folder, which is made if it is not there, and removed if it was made and is empty at the end.

    Args:
        folder: the folder.
        wait: whether to wait for a run that holds it.

    Raises:
        UsageError: another run holds it, and is not waited for.
        OSError: the folder cannot be made.
    """
    made: list[Path] = []
    descriptor = None
    try:
        while descriptor is None:
            make_folder(folder, made)
            descriptor = _locked(folder, os.O_RDONLY, wait)
        yield
    finally:
        # Under the lock, so that no run finds the folder and then loses it.
        remove_folders(made)
        if descriptor is not None:
            os.close(descriptor)


@contextlib.contextmanager
def hold_file(path: Path) -> Iterator[None]:
    """Holds the lock of a file that is there only as long. Folders that it is in are made, and removed as hold_folder.

    Raises UsageError if another run holds it, and OSError if it cannot be made.
    """
    made: list[Path] = []
    descriptor = None
    try:
        make_folder(path.parent, made)
        while descriptor is None:
            descriptor = _locked(path, os.O_RDWR | os.O_CREAT, False)
        yield
    finally:
        if descriptor is not None:
            with contextlib.suppress(OSError):
                path.unlink()
            os.close(descriptor)
        remove_folders(made)


def _locked(path: Path, flags: int, wait: bool) -> int | None:
    """Returns a descriptor with the lock of a file or folder, or None if that is gone by now."""
    try:
        descriptor = os.open(path, flags, 0o666)
    except FileNotFoundError:
        return None
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        # Who held the lock before may have removed it meanwhile.
        if os.path.samestat(os.fstat(descriptor), os.stat(path)):
            return descriptor
    except BlockingIOError:
        os.close(descriptor)
        raise UsageError(
            f"another run writes to {printable(str(path))}: wait for it, or choose another place"
        ) from None
    except FileNotFoundError:
        pass
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return descriptor
        os.close(descriptor)
        raise
    except BaseException:
        os.close(descriptor)
        raise
    os.close(descriptor)
    return None
