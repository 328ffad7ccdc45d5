"""A file that is made, and not written by hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Made:
    """Where a file is, and what it has to be."""

    path: Path
    content: bytes

    @classmethod
    def text(cls, path: Path, content: str) -> Made:
        """One of UTF-8."""
        return cls(path, content.encode("utf-8"))

    def is_current(self) -> bool:
        """Whether the file is there and right."""
        return self.path.is_file() and self.path.read_bytes() == self.content

    def write(self) -> None:
        """Makes it so."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_bytes(self.content)
