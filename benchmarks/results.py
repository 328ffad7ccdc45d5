"""RESULTS.md, of which each benchmark writes a section, and what sections have in common."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).resolve().parent / "RESULTS.md"
# Fewer seeds are no result.
SEEDS = 3
HEADING = "# Measured results\n\nEach section holds the output of the command that it names; the command rewrites it.\n"
# Extensions of processors that decide which code is fast, as Linux names them.
EXTENSIONS = "avx2 fma bmi2 avx_vnni avx512f avx512bw avx512vbmi2 avx512_vnni vpclmulqdq sha_ni asimd asimddp sve sha2"


def write_section(name: str, title: str, lines: Iterable[str]) -> None:
    """Replaces the section between its markers, or appends it; all other text stays."""
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
    """The lines of a Markdown table."""
    return ["| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)]


def machine(*packages: str) -> str:
    """What measured: processor, cores, and the versions of Python, NumPy and other packages."""
    versions = [f"Python {platform.python_version()}", f"numpy {np.__version__}"]
    versions += [f"{name} {__import__(name).__version__}" for name in packages]
    return f"{platform.machine()}, {os.cpu_count()} cores, {', '.join(versions)}."


def processor() -> dict[str, Any]:
    """The model of the processor, and those of its extensions that decide which code is fast."""
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
    """What measured: processor, cores, load of the last minute, and versions. Packages that are not there are None."""
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
    """Facts as a sentence of a section."""
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items() if version)
    flags = f" ({' '.join(found['flags'])})" if found["flags"] else ""
    return f"{found['system']}, {found['model']}{flags}, {found['cores']} cores, load {found['load']}; {versions}."


def kb(value: float) -> str:
    """Bytes as 10^3 bytes."""
    return f"{value / 1000:.1f}"


def mib(value: float) -> str:
    """Bytes as 2^20 bytes."""
    return f"{value / (1 << 20):.1f}"
