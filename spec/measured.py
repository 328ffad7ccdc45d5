"""Makes the tables of SPEC.md that repeat measured results: those of C.5 and E.6, from benchmarks/RESULTS.md."""

from __future__ import annotations

import re

from .made import ROOT

RESULTS = ROOT / "benchmarks" / "RESULTS.md"
# Contenders of the section "decode", as E.6 calls them.
DECODERS = {
    "refcodec, avx512vnni": "AVX-512 VNNI, one thread",
    "refcodec, avx512": "AVX-512, one thread",
    "refcodec, native, 2 threads": "AVX-512 VNNI, two threads",
    "refcodec, avx2": "AVX2, one thread",
    "JavaScript and WebAssembly": "WebAssembly with vectors of 128 bits",
    "refcodec, numpy": "NumPy",
    "C decoder, with the digest": "scalar code that follows the blocks, in C, with the digest",
}
# Parts that no decoder goes without, of the section "decode".
FLOORS = {"floor, native": "AVX-512 VNNI", "floor, AVX2": "AVX2"}
PARTS = {
    "products": "the bare products of the networks",
    "rANS": "a rANS pass over all symbols",
    "output": "a pass over the output",
}
LARGE = ("4,000,000", "streaming")


def _section(name: str) -> str:
    """Returns a section of RESULTS.md. Raises SystemExit if it is missing."""
    found = re.search(rf"<!-- {name}: begin -->\n(.*?)<!-- {name}: end -->", RESULTS.read_text(), re.DOTALL)
    if not found:
        raise SystemExit(f"RESULTS.md has no section '{name}'")
    return found[1]


def _rows(section: str) -> list[list[str]]:
    """Returns the cells of a section's only table, without its head."""
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def departures() -> str:
    """Returns the table of what undoing each departure changes (C.5)."""
    rows = ["| undone | PSNR, dB | bytes | PSNR at equal bytes, dB |", "|---|---|---|---|"]
    for name, _, psnr, size, equal, _ in _rows(_section("departures")):
        rows.append(f"| `{name}` | {psnr} | {size} | {equal} |")
    return "\n".join(rows)


def speed() -> str:
    """Returns the times of the reference decoder (E.6): of what and where, and a table with two significant digits."""
    section = _section("decode")
    of_what = re.search(r"^([\d,]+) anchors, ([\d,]+) bytes, with the symbols of", section, re.MULTILINE)
    where = re.search(r"^Linux \S+, (.*?) \(.*avx512_vnni", section, re.MULTILINE)
    if not of_what or not where:
        raise SystemExit("RESULTS.md, 'decode' does not say how many anchors and bytes there are, or on what processor")
    size = int(of_what[2].replace(",", "")) / 1e6
    said = f"The reference decoder, for {of_what[1]} anchors in {size:.1f} MB, on an {where[1]} with AVX-512 VNNI:"
    seconds = {cells[0]: cells[1] for cells in _rows(section)}
    if missing := (DECODERS.keys() | FLOORS.keys()) - seconds.keys():
        raise SystemExit(f"RESULTS.md, 'decode' lacks what E.6 tells: {', '.join(sorted(missing))}")
    rows = [said, "", "| what | seconds |", "|---|---|"]
    rows += [f"| {called} | {_two(seconds[name])} |" for name, called in DECODERS.items()]
    for name, called in FLOORS.items():
        (told,) = re.findall(rf"^- {re.escape(name)}: .*; (products .*) processor seconds\.$", section, re.MULTILINE)
        of = dict(part.split(" ") for part in told.split(", "))
        rows += [f"| of it with {called}: {what} | {_two(of[part])} |" for part, what in PARTS.items()]
    (large,) = (cells for cells in _rows(_section("scale")) if (cells[0], cells[2]) == LARGE)
    memory = f"in {float(large[6]):.0f} MiB"
    rows.append(f"| {large[0]} anchors, chunks used as they are made (E.2), {memory} | {_two(large[3])} |")
    return "\n".join(rows)


def _two(seconds: str) -> str:
    """Returns a time with two significant digits."""
    return f"{float(seconds):#.2g}"
