"""Untrusted zip archives, opened in bounded memory."""

from __future__ import annotations

import contextlib
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

from ..files.text import printable
from ..folder.layout import SceneFolderError

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
def opened_zip(file: Path, wanted: str, advice: str) -> Iterator[zipfile.ZipFile]:
    """Yields the archive of a file.

    wanted: the expected kind of file, for the message. advice: the remedy. Raises SceneFolderError, and OSError.
    """
    with _Opening(io.FileIO(file)) as opened:
        try:
            archive = zipfile.ZipFile(opened)
        # zipfile raises several types for bad bytes.
        except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            problem = f"it is not a {wanted} ({printable(str(error).partition(chr(10))[0], 120)})"
            raise SceneFolderError(file, problem, advice) from None
        opened.whole = True
        with archive:
            yield archive
