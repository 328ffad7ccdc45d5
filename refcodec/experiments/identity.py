"""The identity of the photographs in a folder: a digest of its files, which is cached until one of them changes."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ..files.documents import DocumentError, read_json
from ..files.stage import write_file
from ..photographs.colmap import IMAGE_SUFFIXES

# Images, models of COLMAP, transforms of NeRF, points.
SUFFIXES = (*IMAGE_SUFFIXES, ".bin", ".txt", ".json", ".ply")


class Identities:
    """Digests of folders. path: a JSON file that keeps those of their files, by size and time of the last change."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            found = read_json(path)
        except (OSError, DocumentError):
            found = None
        self._kept: dict[str, Any] = found if isinstance(found, dict) else {}

    def digest(self, folder: Path) -> str:
        """SHA-256 of the names, from the folder on, and contents of all files with SUFFIXES. Raises OSError."""
        names = sorted(
            path.relative_to(folder).as_posix()
            for path in folder.rglob("*")
            if path.suffix.lower() in SUFFIXES and path.is_file()
        )
        kept = self._kept.get(str(folder))
        before, now = kept if isinstance(kept, dict) else {}, {}
        for name in names:
            status = (folder / name).stat()
            entry = before.get(name)
            stamp = [status.st_size, status.st_mtime_ns]
            if not (isinstance(entry, list) and len(entry) == 3 and entry[:2] == stamp):
                with (folder / name).open("rb") as file:
                    entry = [*stamp, hashlib.file_digest(file, "sha256").hexdigest()]
            now[name] = entry
        if now != before:
            self._kept[str(folder)] = now
        return hashlib.sha256(json.dumps([[name, now[name][2]] for name in names]).encode()).hexdigest()

    def save(self) -> None:
        """Writes the file."""
        write_file(self.path, f"{json.dumps(self._kept)}\n".encode())
