"""Makes what SPEC.md and the repository hold of generated text, tables and pictures.

python -m spec            write what is not current
python -m spec --check    write nothing; exit 1 and say what is not current
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

from . import example, figures, generated, house, matrix, tables
from .made import Made

# In this order: the worked example is read by the parts of SPEC.md, and SPEC.md by the matrix.
MAKERS: tuple[Callable[[], Iterator[Made]], ...] = (
    tables.made, example.made, figures.made, generated.made, matrix.made, house.made,
)  # fmt: skip


def main(arguments: list[str]) -> int:
    """Runs the command; returns its exit status."""
    if arguments not in ([], ["--check"]):
        print(__doc__, file=sys.stderr)
        return 64
    stale = False
    for make in MAKERS:
        for file in make():
            if file.is_current():
                continue
            stale = True
            if arguments:
                print(f"{file.path.name} is not current: run python -m spec", file=sys.stderr)
            else:
                file.write()
                print(f"{file.path.name} is written")
    return 1 if stale and arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
