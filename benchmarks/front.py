"""Makes the table of sizes in README.md from the section of RESULTS.md that compares formats in one harness.

`python -m benchmarks.front` rewrites it. A test checks that it is current.
"""

import re

from .results import RESULTS, ROOT, table

README = ROOT / "README.md"
_BEGIN, _END = "<!-- generated:sizes -->", "<!-- /generated -->"
# The names of the methods in the section.
BASELINE, OWN = "3DGS, SPZ", ("C3GS", "C3GS, static")
# The size of the photographs of README.md's table. At this size each method has several points.
SIZE = 200


class FrontError(Exception):
    """RESULTS.md lacks something that the table shows."""


def rows(results: str) -> list[dict[str, str]]:
    """Returns the row of each scene with the highest PSNR that SPZ and a scene of C3GS reach, by column.

    They are those of the section's second table. Raises FrontError without any.
    """
    section = re.search(rf"<!-- peers-{SIZE}: begin -->(.*?)<!-- peers-{SIZE}: end -->", results, re.DOTALL)
    lines = [line.strip("| ").split(" | ") for line in (section[1] if section else "").splitlines() if line[:1] == "|"]
    heads = [number for number, line in enumerate(lines) if line[0] == "scene"]
    best: dict[str, dict[str, str]] = {}
    for line in lines[heads[-1] + 2 :] if heads else []:
        row = dict(zip(lines[heads[-1]], line, strict=True))
        if any(row.get(name, "-") != "-" for name in OWN):
            best[row["scene"]] = max(row, best.get(row["scene"], row), key=lambda one: float(one["PSNR, dB"]))
    if not best:
        raise FrontError("the section of peers has no scene for the table")
    return list(best.values())


def lines(scenes: list[dict[str, str]]) -> list[str]:
    body = []
    for row in scenes:
        baseline, own = float(row[BASELINE]), [row.get(name, "-") for name in OWN]
        sizes = [
            f"**{float(kb):.0f} KB**, {baseline / float(kb):.1f} times smaller" if kb != "-" else "-" for kb in own
        ]
        body.append([f"{row['scene']}, {float(row['PSNR, dB']):.1f} dB", *sizes, f"{baseline:,.0f} KB"])
    return table(("images, at equal PSNR", *OWN, "SPZ"), body)


def current(readme: str, results: str) -> str:
    """Returns README.md with the current table."""
    before, _, rest = readme.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    made = "\n".join(lines(rows(results)))
    return f"{before}{_BEGIN}\n\n{made}\n\n{_END}{after}"


if __name__ == "__main__":
    text = current(README.read_text(encoding="utf-8"), RESULTS.read_text(encoding="utf-8"))
    README.write_text(text, encoding="utf-8")
