"""Writes the sections of RESULTS.md, one for each benchmark, and their common parts."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "RESULTS.md"
# The least number of seeds of a result.
SEEDS = 3
HEADING = "# Measured results\n\nEach section holds the output of the command that it names; the command rewrites it.\n"
# Extensions of processors that affect speed, as Linux names them.
EXTENSIONS = "avx2 fma bmi2 avx_vnni avx512f avx512bw avx512vbmi2 avx512_vnni vpclmulqdq sha_ni asimd asimddp sve sha2"


def write_section(name: str, title: str, lines: Iterable[str]) -> None:
    """Replaces the section between its markers, or appends it. Other text does not change."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    text = RESULTS.read_text() if RESULTS.exists() else HEADING
    section = "\n".join([begin, f"## {title}", "", *lines, end])
    if begin in text and end in text:
        before, rest = text.split(begin, 1)
        text = before + section + rest.split(end, 1)[1]
    else:
        text = text.rstrip("\n") + "\n\n" + section + "\n"
    RESULTS.write_text(text)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Returns the lines of a Markdown table."""
    return ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]


def machine(*packages: str) -> str:
    """Returns the machine as text: processor, cores, and the versions of Python, NumPy and other packages."""
    versions = [f"Python {platform.python_version()}", f"numpy {np.__version__}"]
    versions += [f"{name} {__import__(name).__version__}" for name in packages]
    return f"{platform.machine()}, {os.cpu_count()} cores, {', '.join(versions)}."


def processor() -> dict[str, Any]:
    """Returns the model of the processor, and its extensions that affect speed."""
    model, flags = platform.processor() or platform.machine(), set[str]()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() in ("model name", "Model"):
            model = value.strip()
        elif name.strip() in ("flags", "Features"):
            flags |= set(value.split())
    return {"model": model, "flags": [flag for flag in EXTENSIONS.split() if flag in flags]}


def facts(*packages: str) -> dict[str, Any]:
    """Returns processor, cores, load of the last minute, and versions, which are None for missing packages."""
    versions: dict[str, str | None] = {"python": platform.python_version(), "numpy": np.__version__}
    for name in packages:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "system": f"{platform.system()} {platform.machine()}",
        **processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
        "versions": versions,
    }


def facts_line(found: dict[str, Any]) -> str:
    """Returns facts as a sentence of a section."""
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items() if version)
    flags = f" ({' '.join(found['flags'])})" if found["flags"] else ""
    return f"{found['system']}, {found['model']}{flags}, {found['cores']} cores, load {found['load']}; {versions}."


def kb(value: float) -> str:
    """Returns bytes as KB (10^3 bytes)."""
    return f"{value / 1000:.1f}"


def mib(value: float) -> str:
    """Returns bytes as MiB (2^20 bytes)."""
    return f"{value / (1 << 20):.1f}"
