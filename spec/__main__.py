"""Makes the generated texts and tables of SPEC.md and of the repository.

python -m spec            writes the files that are not current
python -m spec --check    names stale files and wrong citations of SPEC.md, and exits with 1 if there are any
python -m spec --vectors  prints the vectors of each requirement, error code, feature and flag
python -m spec --coverage prints which lines, conditions and extremes no vector reaches, in a minute
python -m spec --proofs   proves the bounds of 7.11 and the entropy coder for all inputs with z3, in a minute
"""

import sys
from collections.abc import Callable, Iterator

from conformance.manifest import load

from . import citations, coverage, example, generated, house, matrix, meanings, proofs, public, tables, version
from .made import Made

# The order matters. The worked example needs the tables, SPEC.md contains the example, and the matrix reads SPEC.md.
MAKERS: tuple[Callable[[], Iterator[Made]], ...] = (
    version.made, tables.made, example.made, generated.made, matrix.made, house.made, public.made,
)  # fmt: skip


def main(arguments: list[str]) -> int:
    """Runs the command and returns its exit status. arguments: those after `python -m spec`."""
    if arguments not in ([], ["--check"], ["--vectors"], ["--coverage"], ["--proofs"]):
        print(__doc__, file=sys.stderr)
        return 64
    if arguments == ["--vectors"]:
        print("\n".join(matrix.vector_lists(load())))
        return 0
    if arguments == ["--coverage"]:
        return coverage.main()
    if arguments == ["--proofs"]:
        return proofs.main()
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
                print(f"{file.path.name} was written")
    for fault in (*citations.check(), *meanings.check()) if arguments else ():
        stale = True
        print(fault, file=sys.stderr)
    return 1 if stale and arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
