"""Processor time of the conformance suite with the project's three decoders, and of the self-test.

python -m benchmarks.suite        needs a C compiler, `cc`
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
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


def ran(*words: str) -> tuple[float, str]:
    """Runs a command of the suite. Returns the processor seconds of all its processes, and its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [PYTHON, "-m", "conformance", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def run(options: list[str], command: list[str], folder: Path) -> tuple[float, dict[str, int]]:
    """Returns processor seconds, and the number of vectors by status."""
    seconds, _ = ran("run", "--report", str(folder), *options, "--", *command)
    return seconds, json.loads((folder / "report.json").read_text())["verdict"]["counts"]


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
    least, _ = found[next(reversed(found))]
    rows = []
    for title, (seconds, counts) in found.items():
        vectors = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        rows.append([title, vectors, f"{seconds:.0f}", f"{seconds / least:.1f}"])
    seconds, output = ran("selftest", "--recorded")
    lines = [
        "`python -m benchmarks.suite`",
        "",
        machine(),
        "",
        *table(["decoder", "vectors", "processor seconds", "times of the decoder in C"], rows),
        "",
        f"`conformance selftest --recorded`: {output.strip().splitlines()[-1]}; {seconds:.0f} processor seconds.",
    ]
    write_section("suite", "The conformance suite", lines)


if __name__ == "__main__":
    main()
