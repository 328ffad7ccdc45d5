"""Makes the table of sizes in README.md from the section of RESULTS.md that compares formats in one harness.

`python -m benchmarks.front` rewrites it. A test checks that it is current.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from .results import RESULTS, table

README = Path(__file__).resolve().parents[1] / "README.md"
_BEGIN, _END = "<!-- generated:sizes -->", "<!-- /generated -->"
# The names of the methods in the section. Sizes are those at the PSNR of SPZ.
BASELINE, OWN = "3DGS, SPZ", ("C3GS", "C3GS, static")
# The size of the photographs of README.md's table. At this size each method has several rates.
SIZE = 200
_HEAD = ("images, at equal PSNR", *OWN, "SPZ")


class FrontError(Exception):
    """RESULTS.md lacks something that the table shows."""


@dataclass(frozen=True)
class Row:
    """Sizes of a scene in KB at one PSNR, in dB. own: those of OWN, None for one that does not reach it."""

    scene: str
    psnr: float
    own: tuple[float | None, ...]
    baseline: float


def rows(results: str) -> list[Row]:
    """Returns a row for each scene with a common PSNR, at the highest one. Raises FrontError if there is none."""
    section = re.search(rf"<!-- peers-{SIZE}: begin -->(.*?)<!-- peers-{SIZE}: end -->", results, re.DOTALL)
    scenes = re.findall(r"^### (\w+), .*?\n(.*?)(?=^### |\Z)", section[1] if section else "", re.DOTALL | re.MULTILINE)
    found = [row for scene, text in scenes if (row := _row(scene, text))]
    if not found:
        raise FrontError("the section of peers has no scene for the table")
    return found


def _row(scene: str, text: str) -> Row | None:
    """Returns the row of a scene. Returns None if no method reaches a PSNR of the baseline."""
    found = []
    for head, cells in _tables(text):
        if head[0] != "PSNR, dB" or cells[0] == "BD-rate":
            continue
        named = {_method(name): _size(cell) for name, cell in zip(head, cells, strict=True)}
        own, baseline = tuple(named.get(name) for name in OWN), named[BASELINE]
        if baseline is not None and any(own):
            found.append(Row(scene, float(cells[0]), own, baseline))
    return max(found, key=lambda row: row.psnr, default=None)


def _size(cell: str) -> float | None:
    """Returns the KB of a cell such as `125.3, 4.75`, None for a text."""
    number = re.match(r"[\d.]+", cell)
    return float(number[0]) if number else None


def _tables(text: str) -> Iterator[tuple[list[str], list[str]]]:
    """Yields the cells of each row of all tables, with the head of its table."""
    head: list[str] = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split(" | ")] if line.startswith("|") else []
        if not cells or set(line) <= set("|- "):
            head = head if cells else []
        elif not head:
            head = cells
        else:
            yield head, cells


def _method(name: str) -> str:
    """Returns a method's name without its number of steps."""
    return re.sub(r", \d+ steps$", "", name)


def lines(found: list[Row]) -> list[str]:
    """Returns the lines of the table."""

    def words(row: Row) -> list[str]:
        sizes = [f"**{kb:,.0f} KB**, {row.baseline / kb:.1f} times smaller" if kb else "-" for kb in row.own]
        return [f"{row.scene}, {row.psnr:.1f} dB", *sizes, f"{row.baseline:,.0f} KB"]

    return table(_HEAD, map(words, found))


def current(readme: str, results: str) -> str:
    """Returns README.md with the current table."""
    before, _, rest = readme.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    made = "\n".join(lines(rows(results)))
    return f"{before}{_BEGIN}\n\n{made}\n\n{_END}{after}"


def main() -> None:
    """Runs the command line."""
    made = current(README.read_text(encoding="utf-8"), RESULTS.read_text(encoding="utf-8"))
    README.write_text(made, encoding="utf-8")


if __name__ == "__main__":
    main()
