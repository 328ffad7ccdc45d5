"""Locks of files and folders, which the system gives back when their holder ends, however it ends."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from ..statuses import UsageError
from .text import printable

try:
    import fcntl
except ImportError:  # pragma: no cover (systems without flock)
    fcntl = None  # type: ignore[assignment]

# What file systems without such locks answer. A run goes on without one there.
_NO_LOCKS = (errno.EBADF, errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS)


def locked(path: Path, flags: int, wait: bool) -> int | None:
    """Returns a descriptor with the lock of a file or folder, or None if that is gone by now.

    wait: whether to wait for a run that holds it. Raises UsageError if one holds it and is not waited for, and OSError.
    """
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


def taken(folder: str) -> int | None:
    """Returns a descriptor with the lock of a folder, or None if another run holds it, or if nobody can know."""
    if fcntl is None:
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # Who held the lock before may have removed it, and another run may have made it again.
        if os.path.samestat(os.fstat(descriptor), os.stat(folder)):
            return descriptor
    except OSError:
        pass
    os.close(descriptor)
    return None
