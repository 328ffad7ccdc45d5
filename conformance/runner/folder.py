"""The folder of a vector: a copy of the file, a place for the outputs of a decoder, and one for temporary files.

`Folder.fault` reports misuse of the folder by the decoder.
"""

from __future__ import annotations

import os
import stat
import subprocess
import tempfile
from io import BufferedReader
from pathlib import Path

from refcodec.files.text import printable

# The parts of a folder, and their modes.
_PARTS = {"read": 0o555, "write": 0o700, "temporary": 0o700}
_INPUT, _CAMERA = "input.c3gs", "camera.json"
_OUTPUTS = {"output", "trace"}
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFLNK: "a link",
    stat.S_IFIFO: "a FIFO",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
# The longest list of file names in a message, in characters.
_NAMES = 100


class FileError(Exception):
    """A path is not a regular file, or the file cannot be read. The message continues a sentence about the file."""


def open_file(path: Path) -> BufferedReader:
    """Opens a file that a decoder wrote, without waiting and without following a link.

    Raises FileNotFoundError, and FileError for anything that is not a readable regular file.
    """
    try:
        mode = path.lstat().st_mode
        if not stat.S_ISREG(mode):
            raise FileError(f"is {_KINDS.get(stat.S_IFMT(mode), 'not a file')}")
        return open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb")
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileError(f"cannot be read ({error.strerror})") from None


class Folder:
    """A vector's folder with three parts.

    `input` and `camera` are in a read-only part, `output` and `trace` in a writable one; `temporary` is for temporary
    files. A folder without a fault is reused, because creating one takes longer than decoding a small file.
    """

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="c3gs-"))
        self._given: dict[str, bytes] = {}
        for name, mode in _PARTS.items():
            (self.path / name).mkdir()
            (self.path / name).chmod(mode)
        self.input, self.camera = self.path / "read" / _INPUT, self.path / "read" / _CAMERA
        self.output, self.trace = self.path / "write" / "output", self.path / "write" / "trace"
        self.temporary = self.path / "temporary"
        self._made = {path: path.lstat() for path in (self.path, *(self.path / name for name in _PARTS))}

    def put(self, data: bytes, camera: bytes | None = None) -> None:
        """Writes read-only copies of a vector's files."""
        self._given = {_INPUT: data} | ({} if camera is None else {_CAMERA: camera})
        part = self.path / "read"
        part.chmod(0o700)
        for name, content in self._given.items():
            (part / name).write_bytes(content)
            (part / name).chmod(0o444)
        part.chmod(_PARTS["read"])

    def clear(self) -> None:
        """Removes the vector's files from a folder without a fault. Raises OSError if others are left."""
        part = self.path / "read"
        part.chmod(0o700)
        for path in (*(part / name for name in self._given), self.output, self.trace):
            path.unlink(missing_ok=True)
        if any(self.temporary.iterdir()):
            raise FileExistsError("temporary files")

    def close(self) -> str | None:
        """Removes the folder with all its contents. Returns a message if it cannot be removed."""
        if self.path.is_symlink() or self.path.is_file():
            self.path.unlink()
        elif self.path.exists():
            # These commands handle any permissions, depth and length of paths.
            for command in (["chmod", "-R", "u+rwx"], ["rm", "-rf"]):
                subprocess.run([*command, str(self.path)], stderr=subprocess.DEVNULL, check=False)
        return f"{self.path}: cannot be removed" if self.path.exists() else None

    def fault(self) -> str | None:
        """Describes a change of the folder that a decoder must not make; None if there is none."""
        try:
            return self._fault()
        except FileNotFoundError:
            return "removed files that are not its own"
        except FileError as error:
            return f"left a file that {error}"
        except OSError as error:
            return f"left a folder that cannot be read ({error.strerror})"

    def _fault(self) -> str | None:
        for path, made in self._made.items():
            now = path.lstat()
            if not os.path.samestat(now, made):
                return "replaced its folder"
            if now.st_mode != made.st_mode:
                return "changed the permissions of its folder"
        allowed = {self.path: set(_PARTS), self.path / "read": set(self._given), self.path / "write": _OUTPUTS}
        beside = {name for path, names in allowed.items() for name in set(os.listdir(path)) - names}
        if beside:
            return f"left files beside its output: {printable(', '.join(sorted(beside)), _NAMES)}"
        for name, content in self._given.items():
            with open_file(self.path / "read" / name) as file:
                if file.read(len(content) + 1) != content:
                    return "changed its input"
        return None
