"""The folder that a decoder gets for a vector: a copy of the file, a place for what it writes, and one for the rest.

Whatever it does there is found afterwards (`Folder.fault`), and goes with the folder.
"""

from __future__ import annotations

import os
import stat
import tempfile
import uuid
from io import BufferedReader
from pathlib import Path

from refcodec.files.text import printable

_OPEN = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW
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
# So many characters of the names of files are told.
_NAMES = 100


class FileError(Exception):
    """A place for a file that holds something else, or a file that cannot be read. The text follows its name."""


def open_file(path: Path) -> BufferedReader:
    """Opens a file that a decoder wrote. Waits for nothing, and follows no link.

    Raises FileNotFoundError, and FileError for what is no file that can be read.
    """
    mode = _status(path).st_mode
    if not stat.S_ISREG(mode):
        raise FileError(f"is {_KINDS.get(stat.S_IFMT(mode), 'no file')}")
    try:
        return open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb")
    except OSError as error:
        raise FileError(f"cannot be read ({error.strerror})") from None


def _status(path: Path) -> os.stat_result:
    try:
        return path.lstat()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileError(f"cannot be read ({error.strerror})") from None


class Temporary:
    """A folder of our own, removed at the end, whatever has been made of it by then."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="c3gs-"))
        # It stays the same folder where another one gets its name.
        self._fd = os.open(self.path, _OPEN)

    def close(self) -> str | None:
        """Removes it. Returns what is left and why, or None."""
        try:
            _empty(self._fd)
            place = Path(f"/proc/self/fd/{self._fd}")
            # A folder that was moved is removed where it is, and what took its place too.
            for path in {self.path, place.readlink() if place.exists() else self.path}:
                self._remove(path)
        except OSError as error:
            return f"{self.path}: {error.strerror}"
        finally:
            os.close(self._fd)
        return None

    def _remove(self, path: Path) -> None:
        try:
            status = path.lstat()
        except FileNotFoundError:
            return
        if not stat.S_ISDIR(status.st_mode):
            path.unlink()
            return
        if not os.path.samestat(status, os.fstat(self._fd)):
            path.chmod(0o700)
            other = os.open(path, _OPEN)
            try:
                _empty(other)
            finally:
                os.close(other)
        path.rmdir()


def _empty(top: int) -> None:
    """Removes all that is in an open folder.

    Folders in folders are moved up before they are looked at: there is no depth, and no length of paths, that a
    decoder could reach and this could not.
    """
    os.fchmod(top, 0o700)
    while entries := list(os.scandir(top)):
        for entry in entries:
            if not entry.is_dir(follow_symlinks=False):
                os.unlink(entry.name, dir_fd=top)
                continue
            os.chmod(entry.name, 0o700, dir_fd=top)
            folder = os.open(entry.name, _OPEN, dir_fd=top)
            try:
                for inner in list(os.scandir(folder)):
                    if inner.is_dir(follow_symlinks=False):
                        # A folder that is moved gets another parent, and must be writable for that.
                        os.chmod(inner.name, 0o700, dir_fd=folder)
                        os.rename(inner.name, uuid.uuid4().hex, src_dir_fd=folder, dst_dir_fd=top)
                    else:
                        os.unlink(inner.name, dir_fd=folder)
            finally:
                os.close(folder)
            os.rmdir(entry.name, dir_fd=top)


class Folder(Temporary):
    """A vector's: `input` and `camera` in a part that is for reading, `output` and `trace` in one for writing.

    `temporary` is for temporary files. One in which nothing is wrong may serve the next vector too, because to remove
    a folder takes longer than a small file takes to decode.
    """

    def __init__(self) -> None:
        super().__init__()
        self._made: dict[str, os.stat_result] = {}
        self._given: dict[str, bytes] = {}
        for name in _PARTS:
            (self.path / name).mkdir(0o700)
        self.input, self.camera = self.path / "read" / _INPUT, self.path / "read" / _CAMERA
        self.output, self.trace = self.path / "write" / "output", self.path / "write" / "trace"
        self.temporary = self.path / "temporary"
        for name, mode in _PARTS.items():
            (self.path / name).chmod(mode)
            self._made[name] = (self.path / name).lstat()

    def put(self, data: bytes, camera: bytes | None = None) -> None:
        """Writes the copies of a vector's files, for reading alone."""
        self._given = {_INPUT: data} | ({} if camera is None else {_CAMERA: camera})
        part = self.path / "read"
        part.chmod(0o700)
        for name, content in self._given.items():
            (part / name).write_bytes(content)
            (part / name).chmod(0o444)
        part.chmod(_PARTS["read"])

    def clear(self) -> None:
        """Removes the vector's files, where `fault` finds nothing wrong. Raises OSError."""
        part = self.path / "read"
        part.chmod(0o700)
        for name in self._given:
            (part / name).unlink()
        self._given = {}
        for path in (self.output, self.trace):
            path.unlink(missing_ok=True)
        if any(self.temporary.iterdir()):
            temporary = os.open(self.temporary, _OPEN)
            try:
                _empty(temporary)
            finally:
                os.close(temporary)

    def fault(self) -> str | None:
        """What a decoder did here that it must not, in words; None if it is nothing."""
        try:
            return self._fault()
        except FileNotFoundError:
            return "removed files that are not its own"
        except FileError as error:
            return f"left a file that {error}"
        except OSError as error:
            return f"left a folder that cannot be read ({error.strerror})"

    def _fault(self) -> str | None:
        made = os.fstat(self._fd)
        if not os.path.samestat(self.path.lstat(), made):
            return "replaced its folder"
        if stat.S_IMODE(made.st_mode) != 0o700:
            return "changed the permissions of its folder"
        beside = set(os.listdir(self._fd)) - set(_PARTS)
        for name, status in self._made.items():
            now = (self.path / name).lstat()
            if not os.path.samestat(now, status):
                return "replaced its folder"
            if now.st_mode != status.st_mode:
                return "changed the permissions of its folder"
        beside |= set(os.listdir(self.path / "read")) - set(self._given)
        beside |= set(os.listdir(self.path / "write")) - _OUTPUTS
        if beside:
            return f"left files beside its output: {printable(', '.join(sorted(beside)), _NAMES)}"
        for name, content in self._given.items():
            with open_file(self.path / "read" / name) as file:
                if file.read(len(content) + 1) != content:
                    return "changed its input"
        return None
