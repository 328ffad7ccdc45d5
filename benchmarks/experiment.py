"""The tables of an experiment as a section of RESULTS.md.

python -m benchmarks.experiment FOLDER

FOLDER is what `refcodec experiment FILE -o FOLDER` made. The section has the experiment's name.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from refcodec.experiments.tables import MARKDOWN
from refcodec.files.text import printable
from refcodec.statuses import DONE, USAGE

from .results import machine, write_section

NOTE = "One training at a time on each core, one thread each. PSNR and SSIM are by scikit-image, of eight-bit images."


def section(lines: list[str]) -> tuple[str, list[str]]:
    """The experiment's name, and the lines of its section: those of its tables, whose headings are one level lower."""
    (first, *rest) = lines
    return first.removeprefix("# "), [f"#{line}" if line.startswith("#") else line for line in rest]


def main(words: list[str] | None = None) -> int:
    """Writes the section. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.experiment", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(words).folder
    try:
        name, lines = section((folder / MARKDOWN).read_text(encoding="utf-8").splitlines())
    except (OSError, ValueError) as error:
        print(printable(str(error)), file=sys.stderr)
        return USAGE
    command = f"refcodec experiment benchmarks/experiments/{name}.toml -o FOLDER"
    own = ["```", command, "python -m benchmarks.experiment FOLDER", "```", "", machine("torch"), NOTE]
    write_section(f"experiment-{name}", f"Experiment: {name}", [*own, *lines])
    return DONE


if __name__ == "__main__":
    sys.exit(main())
