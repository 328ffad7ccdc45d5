"""Compares training on a GPU with training on the CPU.

python -m benchmarks.gpu              compares the two on this machine, in at most 20 minutes, and prints a table
python -m benchmarks.gpu --results    writes it into benchmarks/RESULTS.md, too

It needs an NVIDIA GPU, nvcc, torch for CUDA and gsplat, but no network: the photographs are in examples/.
The exit status is 0 if the two agree, 1 if they do not, 69 without a GPU or the software for it, and 70 if the time
limit is exceeded.
"""

from __future__ import annotations

import argparse
import importlib
import shutil
import sys
import tempfile
import time
from pathlib import Path

import torch

from refcodec.statuses import DONE, FAULT, REJECTED

from ..results import machine, table, write_section
from .compare import LateError, Size, holds, networks_agree, steps_agree, trained, trainings_agree

# A service that is not available (EX_UNAVAILABLE of sysexits.h).
UNAVAILABLE = 69
SECONDS = 20 * 60.0
HEAD = ["", "CPU", "CUDA", "difference", "at most", "agrees"]
INSTALL = """\
Without a network, wheels come from a machine that has one, with the same Python and system:
  pip download -d wheels 'setuptools>=77' wheel ninja packaging
  pip download -d wheels torch --index-url https://download.pytorch.org/whl/cu130
  pip download -d wheels --no-build-isolation '.[train,cuda]'
and then on this machine:
  pip install --no-index --find-links wheels setuptools wheel ninja packaging torch
  pip install --no-index --find-links wheels --no-build-isolation '.[train,cuda]'
gsplat is compiled with nvcc when it is first imported, which takes minutes."""


def missing() -> str | None:
    """The missing parts of this machine in one line, or None."""
    if not torch.cuda.is_available():
        return f"there is no GPU that torch {torch.__version__} can use"
    if shutil.which("nvcc") is None:
        return "nvcc is not there, with which gsplat is compiled"
    try:
        importlib.import_module("gsplat")
    except ImportError as error:
        return f"gsplat cannot be imported ({error})"
    return None


def section(size: Size, deadline: float) -> tuple[list[str], bool]:
    """The lines of the report, and whether CPU and GPU agree. Raises LateError."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        rows = [networks_agree("cuda"), *steps_agree("cuda", work, size)]
        rows += trainings_agree(*(trained(device, work, size, deadline) for device in ("cpu", "cuda")))
    lines = [
        "`python -m benchmarks.gpu --results`",
        "",
        machine("torch", "gsplat"),
        f"GPU: {torch.cuda.get_device_name()}, CUDA {torch.version.cuda}.",
        f"caliterra; single steps of {size.sides[0]} pixels, training runs of {size.sides[1]} pixels and",
        f"{size.steps[1]} steps, {size.anchors:,} anchors at first. Differences of gradients and bytes are relative.",
        "",
        *table(HEAD, [row.cells for row in rows]),
    ]
    return lines, holds(rows)


def main(words: list[str] | None = None) -> int:
    """Runs the command. Returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", action="store_true", help="writes the table into benchmarks/RESULTS.md, too")
    arguments = parser.parse_args(words)
    deadline = time.monotonic() + SECONDS
    lacks = missing()
    if lacks is not None:
        print(f"{lacks}; nothing was compared\n{INSTALL}", file=sys.stderr)
        return UNAVAILABLE
    try:
        lines, agrees = section(Size(), deadline)
    except LateError as error:
        print(error, file=sys.stderr)
        return FAULT
    if arguments.results:
        write_section("gpu", "A GPU against the CPU", lines)
    print("\n".join(lines))
    return DONE if agrees else REJECTED


if __name__ == "__main__":
    sys.exit(main())
