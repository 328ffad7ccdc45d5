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
BASELINE, OWN, OTHER, PLAIN = "3DGS, SPZ", "C3GS", "3DGS, SOG", "Scaffold-GS"
# The size of the photographs of README.md's table. At this size each method has several rates.
SIZE = 200
_HEAD = ("photographs, at equal PSNR", "C3GS", "SPZ", "SOG", "Scaffold-GS as trained")


class FrontError(Exception):
    """RESULTS.md lacks something that the table shows."""


@dataclass(frozen=True)
class Row:
    """Sizes of a scene in KB at one PSNR, in dB. plain: bytes and PSNR of the uncompressed scene."""

    scene: str
    psnr: float
    own: float
    baseline: float
    other: float
    plain: tuple[int, float]


def rows(results: str) -> list[Row]:
    """Returns a row for each scene of the section, at the highest PSNR that all methods reach. Raises FrontError."""
    section = re.search(rf"<!-- peers-{SIZE}: begin -->(.*?)<!-- peers-{SIZE}: end -->", results, re.DOTALL)
    scenes = re.findall(r"^### (\w+), .*?\n(.*?)(?=^### |\Z)", section[1] if section else "", re.DOTALL | re.MULTILINE)
    found = [row for scene, text in scenes if (row := _row(scene, text))]
    if not found:
        raise FrontError("the section of peers has no scene for the table")
    return found


def _row(scene: str, text: str) -> Row | None:
    """Returns the row of a scene. Returns None if the PSNR of the baseline does not grow with its bytes."""
    plain: tuple[int, float] | None = None
    points: list[tuple[float, float, float, float]] = []
    rising: list[float] = []
    for head, cells in _tables(text):
        named = {_method(name): cell for name, cell in zip(head, cells, strict=True)}
        if head[0] == "method" and "bytes" in head and _method(cells[0]) == PLAIN:
            plain = int(_first(named["bytes"]).replace(",", "")), float(_first(named["PSNR, dB"]))
        if head[0] == "method" and "bytes" in head and _method(cells[0]) == BASELINE:
            rising.append(float(_first(named["PSNR, dB"])))
        sizes = [named.get(name, "") for name in (OWN, BASELINE, OTHER)]
        if head[0] == "PSNR, dB" and all(re.match(r"[\d.]+", size) for size in sizes):
            psnr, own, baseline, other = (float(cell.partition(", ")[0]) for cell in (cells[0], *sizes))
            points.append((psnr, own, baseline, other))
    if rising != sorted(rising):
        return None
    if plain is None or not points:
        raise FrontError(f"{scene} lacks one of {OWN}, {BASELINE}, {OTHER} and {PLAIN}")
    psnr, own, baseline, other = max(points)
    return Row(scene, psnr, own, baseline, other, plain)


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


def _first(cell: str) -> str:
    """Returns a figure without its spread."""
    return cell.split(" ", maxsplit=1)[0]


def lines(found: list[Row]) -> list[str]:
    """Returns the lines of the table."""

    def words(row: Row) -> list[str]:
        size, psnr = row.plain
        times = [f"{kb:,.0f} KB, {kb / row.own:.1f} times" for kb in (row.baseline, row.other)]
        plain = f"{size / 1000:,.0f} KB at {psnr:.1f} dB"
        return [f"{row.scene}, {row.psnr:.1f} dB", f"**{row.own:,.0f} KB**", *times, plain]

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
