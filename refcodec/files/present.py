"""Whether a file is there: yes, no, or something else is in its place."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotAFileError(ValueError):
    """Something that is no file is in the place of one. The text says what, without the path."""


def is_there(path: Path, kind: int = stat.S_IFREG) -> bool:
    """Whether a file is at a path. False means that nothing is: no link that leads nowhere, no pipe, no folder.

    Args:
        path: of a file that need not be there, and whose absence means something.
        kind: stat.S_IFDIR for a folder in place of a file.

    Raises:
        NotAFileError: something else is there.
        OSError: it cannot be found out.
    """
    wanted = "file" if kind == stat.S_IFREG else "directory"
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        if path.is_symlink():
            raise NotAFileError(f"it is a link that leads nowhere, not a {wanted}") from None
        return False
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise NotAFileError(f"it is a link in a circle, not a {wanted}") from None
        raise
    found = stat.S_IFMT(mode)
    if found != kind:
        raise NotAFileError(f"it is {_KINDS.get(found, 'a file')}, not a {wanted}")
    return True
