"""Measures the branch coverage that the vectors alone have of the second decoder. It has to be above 98 %.

python -m spec.coverage

Vectors with a budget of more than ten seconds are left out. They take long, and reach nothing that the others do not.
"""

from __future__ import annotations

import contextlib
import io
import sys

import coverage

# The least coverage in per cent, and the largest budget of a vector in seconds.
LEAST = 98.0
LARGEST_SECONDS = 10
# No file decides what the command line does.
OMIT = ["*/independent/__main__.py"]


def main() -> int:
    """Decodes the vectors, prints the coverage, and returns the exit status."""
    measured = coverage.Coverage(branch=True, source=["conformance.independent"], omit=OMIT, data_file=None)
    measured.start()
    # These are imported late, so that what runs at import counts.
    from conformance import independent  # noqa: PLC0415
    from conformance.independent.trace import Trace  # noqa: PLC0415
    from conformance.manifest import load  # noqa: PLC0415

    suite = load()
    for vector in suite.vectors:
        if vector.operation == "decode" and vector.budget.seconds <= LARGEST_SECONDS:
            with contextlib.suppress(independent.C3GSError):
                scene = independent.decode(suite.path(vector).read_bytes(), Trace(io.StringIO()))
                independent.digest(scene)
    measured.stop()
    share = measured.report(show_missing=True, skip_covered=True)
    return 0 if share > LEAST else 1


if __name__ == "__main__":
    sys.exit(main())
