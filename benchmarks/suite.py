"""Wall and processor time of the conformance suite with the project's three decoders, and of the self-test.

python -m benchmarks.suite        needs a C compiler, `cc`
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tqdm import tqdm

from .results import machine, table, write_section

ROOT = Path(__file__).resolve().parent.parent
PYTHON = sys.executable
GAUSSIANS = ["--gaussians", f"{PYTHON} -m refcodec gaussians {{input}} {{camera}} {{output}}"]
SERVE = [PYTHON, "-m", "conformance.runner.serve"]
RUNS = {
    "refcodec, with --serve, and its Gaussians": (["--serve", *GAUSSIANS], [*SERVE, "refcodec"]),
    "refcodec, with --serve and --trace": (["--serve", "--trace"], [*SERVE, "refcodec"]),
    "the second decoder, with --serve": (["--serve"], [*SERVE, "spec_decoder"]),
    "the decoder in C, a process for each vector": ([], ["{c}", "decode", "{input}", "{output}"]),
}


def run(options: list[str], command: list[str], folder: Path) -> tuple[float, float, dict[str, int]]:
    """Returns wall seconds, processor seconds, and the number of vectors by status."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    words = [PYTHON, "-m", "conformance", "run", "--report", str(folder), *options, "--", *command]
    subprocess.run(words, cwd=ROOT, capture_output=True, check=False)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    counts = json.loads((folder / "report.json").read_text())["verdict"]["counts"]
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, counts


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run(
            ["cc", "-std=c11", "-O2", str(ROOT / "conformance" / "c" / "decoder.c"), "-o", str(folder / "decoder")],
            check=True,
        )
        os.environ["C3GS_TABLES"] = str(ROOT / "refcodec" / "data" / "tables-0.bin")
        found = {}
        for title, (options, command) in tqdm(RUNS.items(), leave=False):
            found[title] = run(options, [word.replace("{c}", str(folder / "decoder")) for word in command], folder)
    _, least, _ = found[next(reversed(found))]
    rows = []
    for title, (wall, processor, counts) in found.items():
        vectors = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        rows.append([title, vectors, f"{wall:.1f}", f"{processor:.0f}", f"{processor / least:.1f}"])
    start = time.perf_counter()
    command = [PYTHON, "-m", "conformance", "selftest", "--recorded"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    bugs, seconds = done.stdout.strip().splitlines()[-1], time.perf_counter() - start
    lines = [
        "`python -m benchmarks.suite`",
        "",
        f"{machine()} One process per core.",
        "",
        *table(["decoder", "vectors", "seconds", "processor seconds", "times of the decoder in C"], rows),
        "",
        f"`conformance selftest --recorded`: {bugs}; {seconds:.0f} s.",
    ]
    write_section("suite", "The conformance suite", lines)


if __name__ == "__main__":
    main()
