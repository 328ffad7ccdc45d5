"""The pictures of the manual are small, and each has the command that made it."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"


def test_every_picture_has_its_command() -> None:
    page = (PICTURES / "README.md").read_text(encoding="utf-8")
    pictures = [path for path in sorted(PICTURES.iterdir()) if path.suffix != ".md"]
    assert pictures
    for path in pictures:
        (row,) = [line for line in page.splitlines() if line.startswith(f"| [{path.name}]({path.name}) | `")]
        assert path.stat().st_size < 200_000, row
