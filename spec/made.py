"""Generated files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Made:
    """A generated file and its expected content."""

    path: Path
    content: bytes

    @classmethod
    def text(cls, path: Path, content: str) -> Made:
        """Returns a file of text in UTF-8."""
        return cls(path, content.encode("utf-8"))

    def is_current(self) -> bool:
        """Whether the file exists and has this content."""
        return self.path.is_file() and self.path.read_bytes() == self.content

    def write(self) -> None:
        """Writes the file, and makes missing folders."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_bytes(self.content)
