"""The folder of a vector: a copy of the file, a place for the outputs of a decoder, and one for temporary files."""

import contextlib
import os
import shutil
import stat
import subprocess
import tempfile
from io import BufferedReader
from pathlib import Path


class FileError(Exception):
    """A path is not a regular file, or the file cannot be read. The message continues a sentence about the file."""


def open_file(path: Path) -> BufferedReader:
    """Opens a file that a decoder wrote, without waiting and without following a link.

    Raises FileNotFoundError, and FileError for anything that is not a readable regular file.
    """
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            raise FileError("is not a regular file")
        return open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb")
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileError(f"cannot be read ({error.strerror})") from None


class Folder:
    """A vector's folder. input, camera: its files. output, trace: of a decoder. temporary: an empty folder."""

    def __init__(self, data: bytes = b"", camera: bytes | None = None) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="c3gs-"))
        self.input, self.camera = self.path / "input.c3gs", self.path / "camera.json"
        self.output, self.trace, self.temporary = (self.path / name for name in ("output", "trace", "temporary"))
        self.temporary.mkdir()
        self.input.write_bytes(data)
        if camera is not None:
            self.camera.write_bytes(camera)

    def close(self) -> None:
        """Removes the folder with its contents."""
        # rmtree calls itself for each level of a folder that a decoder may have made.
        with contextlib.suppress(RecursionError):
            shutil.rmtree(self.path, ignore_errors=True)
        if self.path.exists():
            # Folders may be closed, too. Files keep their modes, because they may be others' by a link.
            opened = ["-type", "d", "!", "-perm", "-700", "-execdir", "chmod", "u+rwx", "{}", ";"]
            for command in (["find", str(self.path), *opened], ["rm", "-rf", "--", str(self.path)]):
                subprocess.run(command, stderr=subprocess.DEVNULL, check=False)
