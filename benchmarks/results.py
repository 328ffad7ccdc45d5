"""The sections of RESULTS.md that benchmarks write, and their common parts."""

import math
import os
import platform
from collections.abc import Iterable, Sequence
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from typing import Any

from refcodec.statuses import DONE

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "RESULTS.md"
# The options of a benchmark: keyword arguments of add_argument, by name.
Arguments = dict[str, dict[str, Any]]
# Extensions of processors that affect speed, as Linux names them.
EXTENSIONS = "avx2 avx_vnni avx512f avx512_vnni asimd asimddp sve"


def write_section(name: str, title: str, lines: Iterable[str]) -> None:
    """Replaces the section between its markers, or appends it. Other text does not change."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    text = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else "# Measured results\n"
    section = "\n".join([begin, f"## {title}", "", *lines, end])
    if begin in text and end in text:
        before, rest = text.split(begin, 1)
        text = before + section + rest.split(end, 1)[1]
    else:
        text = text.rstrip("\n") + "\n\n" + section + "\n"
    RESULTS.write_text(text, encoding="utf-8")


def publish(name: str, title: str, lines: Sequence[str], write: bool) -> int:
    """Prints the lines of a section, and writes it if that is asked for. Returns the exit status."""
    print("\n".join(lines))
    if write:
        write_section(name, title, lines)
    return DONE


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Returns the lines of a Markdown table."""
    return ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]


def machine(*packages: str) -> str:
    """Returns a sentence: processor, cores, load of the last minute, versions of Python, NumPy and other packages."""
    try:
        lines = [line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines()]
    except OSError:
        lines = []
    stated = {name.strip(): value.strip() for name, _, value in lines}
    model = stated.get("model name", platform.processor() or platform.machine())
    there = (stated.get("flags") or stated.get("Features") or "").split()
    flags = " ".join(flag for flag in EXTENSIONS.split() if flag in there)
    versions = ", ".join([f"Python {platform.python_version()}", *map(_version, ("numpy", *packages))])
    system = f"{platform.system()} {platform.machine()}, {model}{f' ({flags})' if flags else ''}"
    return f"{system}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.2f}; {versions}."


def _version(package: str) -> str:
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return f"no {package}"


def kb(value: float) -> str:
    """Returns bytes as KB (10^3 bytes)."""
    return f"{value / 1000:.1f}"


def mib(value: float) -> str:
    """Returns bytes as MiB (2^20 bytes)."""
    return f"{value / (1 << 20):.1f}"


def bytes_at(points: Sequence[tuple[float, float]], psnr: float) -> float | None:
    """Returns the bytes of a method at a PSNR in dB, by linear interpolation of their logarithm.

    points: bytes and PSNR, by rising bytes. Returns None outside of them, and the smallest size if the curve meets the
    PSNR more than once.
    """
    for (size, low), (more, high) in pairwise(points):
        if min(low, high) <= psnr <= max(low, high):
            if low == high:
                return size
            share = (psnr - low) / (high - low)
            return math.exp((1 - share) * math.log(size) + share * math.log(more))
    return next((size for size, own in points if own == psnr), None)
