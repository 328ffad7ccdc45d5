"""Untrusted zip archives, opened in bounded memory."""

import contextlib
import io
import zipfile
from collections.abc import Iterator

from ..files.text import printable
from .common import ContentError

# Maximum size of the directory of an archive, which zipfile reads at once, into ten times the memory. A checkpoint or a
# SOG file has some dozen entries of a hundred bytes.
DIRECTORY_MAX = 1 << 18


class _Opening(io.BufferedReader):
    """A file that reads at most DIRECTORY_MAX bytes at once until `whole` is set."""

    whole = False

    def read(self, size: int | None = -1, /) -> bytes:
        """As for any file. Raises ValueError for more bytes than may be read at once."""
        if self.whole:
            return super().read(size)
        most = DIRECTORY_MAX + 1
        data = super().read(most if size is None or size < 0 else min(size, most))
        if len(data) > DIRECTORY_MAX:
            raise ValueError(f"its directory has more than {DIRECTORY_MAX} bytes")
        return data


@contextlib.contextmanager
def opened_zip(file: io.RawIOBase, wanted: str) -> Iterator[zipfile.ZipFile]:
    """Yields the archive of an open file, and closes it.

    wanted: the expected kind of file, for the message. Raises ContentError, and OSError.
    """
    with _Opening(file) as opened:
        try:
            archive = zipfile.ZipFile(opened)
        # zipfile raises several types for bad bytes.
        except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            raise ContentError(f"it is not a {wanted} ({printable(str(error).partition(chr(10))[0], 120)})") from None
        opened.whole = True
        with archive:
            yield archive


def read_entry(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Returns an entry of an archive, of at most `most` bytes. Raises ContentError."""
    shown = printable(name, 60)
    try:
        info = archive.getinfo(name)
        # Other methods allocate a dictionary of a size that the entry states.
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ContentError(f"its entry {shown} is neither stored nor deflated")
        # As many bytes are allocated before they are read.
        if info.compress_size > archive.start_dir:
            raise ContentError(f"its entry {shown} is longer than the archive")
        with archive.open(name) as entry:
            data = entry.read(most + 1)
    except KeyError:
        raise ContentError(f"it has no entry {shown}") from None
    except (ContentError, MemoryError):
        raise
    # zipfile and zlib raise several types for bad bytes.
    except Exception as error:
        raise ContentError(f"its entry {shown} is damaged ({printable(str(error), 80)})") from None
    if len(data) > most:
        raise ContentError(f"its entry {shown} has more than {most} bytes")
    return data
