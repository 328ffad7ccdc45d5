"""Archives whose bytes depend on the names and contents of their files only: sorted, of one owner, mode and time."""

import gzip
import io
import tarfile
import time
import zipfile
from collections.abc import Mapping
from pathlib import Path

# zlib's best, stated because the default of Python changed once.
_LEVEL = 9
_PLAIN, _PROGRAM = 0o644, 0o755
# zip cannot state an earlier time.
_ZIP_FIRST = 315532800


def tar_gz(files: Mapping[str, bytes], epoch: int, programs: frozenset[str] = frozenset()) -> bytes:
    """Returns a .tar.gz. files: contents by path. epoch: the time of each. programs: paths that may be executed."""
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for name in sorted(files):
            member = tarfile.TarInfo(name)
            member.size, member.mtime = len(files[name]), epoch
            member.mode = _PROGRAM if name in programs else _PLAIN
            archive.addfile(member, io.BytesIO(files[name]))
    return gzip.compress(raw.getvalue(), _LEVEL, mtime=epoch)


def same_tar_gz(data: bytes, epoch: int) -> bytes:
    """Returns a .tar.gz with the files of another, in the form of tar_gz. A program remains one."""
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        members = [member for member in archive.getmembers() if member.isfile()]
        files = {m.name: taken.read() for m in members if (taken := archive.extractfile(m))}
        return tar_gz(files, epoch, frozenset(m.name for m in members if m.mode & 0o100))


def zipped(files: Mapping[str, bytes], epoch: int) -> bytes:
    """Returns a .zip in the order of files. files: contents by path. epoch: the time of each."""
    raw = io.BytesIO()
    with zipfile.ZipFile(raw, "w") as archive:
        for name, content in files.items():
            member = zipfile.ZipInfo(name, time.gmtime(max(epoch, _ZIP_FIRST))[:6])
            # As on Unix, whatever system builds it: 3 in the format of zip.
            member.create_system, member.external_attr = 3, (0o100000 | _PLAIN) << 16
            archive.writestr(member, content, zipfile.ZIP_DEFLATED, _LEVEL)
    return raw.getvalue()


def members(archive: bytes) -> dict[str, bytes]:
    """Returns the files of a .zip by path."""
    with zipfile.ZipFile(io.BytesIO(archive)) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def tree(folder: Path, prefix: str = "") -> dict[str, bytes]:
    """Returns the files of a folder by path, with a prefix."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {prefix + path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
