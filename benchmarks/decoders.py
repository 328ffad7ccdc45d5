"""Decoding time of a large scene by each decoder.

python -m benchmarks decode [--anchors 421600] [--rounds 7] [--write]

Each run is a process of its own, and the decoders take turns, so that the load of the machine affects all alike.
"""

import json
import os
import shutil
import subprocess
import sys
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from typing import Any

from tqdm import tqdm

from refcodec.bitstream.tables import tables_file
from refcodec.files.terminal import bar_options
from refcodec.statuses import DONE

from .large import KEPT, PAPER_ANCHORS, TRAINED, large
from .resident import Usage, usage
from .results import ROOT, Arguments, machine, table

OPTIONS: Arguments = {
    "--anchors": {"type": int, "default": PAPER_ANCHORS},
    "--rounds": {"type": int, "default": 7},
    "--kept": {"type": Path, "default": KEPT, "help": "folder of large scenes"},
}
# The paths of refcodec. `native` is the one that it chooses itself.
PATHS = ("numpy", "native", "avx512vnni", "avx512", "avx2", "neon", "plain")
# Restricts all libraries to one thread.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "REFCODEC_THREADS"), "1")
# The decoding time of the paper, on a GPU, for a scene of PAPER_ANCHORS anchors.
PAPER_SECONDS = 13.1

# A command that decodes a file, and variables of its environment.
Decoder = tuple[list[str], Mapping[str, str]]


def decoding(way: str, path: Path, native: str = "native", threads: int = 1) -> Decoder:
    """Returns a way of decoding.py on a path of refcodec."""
    variables = {**ONE_THREAD, "REFCODEC_PATH": native, "REFCODEC_THREADS": str(threads)}
    return [sys.executable, "-m", "benchmarks.decoding", way, str(path)], variables


def c_decoder(kept: Path = KEPT) -> Path:
    """Compiles the decoder in C, and returns its program. Raises OSError without a C compiler."""
    kept.mkdir(parents=True, exist_ok=True)
    source, program = ROOT / "conformance" / "c" / "decoder.c", kept / "decoder"
    subprocess.run(["cc", "-std=c11", "-O3", "-march=native", source, "-o", program], check=True)
    return program


def decoders(path: Path, kept: Path) -> dict[str, Decoder]:
    """Returns the decoders of a file that this machine may have."""
    made = {f"refcodec, {name}": decoding("whole", path, name) for name in PATHS}
    made |= {f"refcodec, {name}, with the digest": decoding("digest", path, name) for name in ("numpy", "native")}
    if (cores := os.cpu_count() or 1) > 1:
        made[f"refcodec, native, {cores} threads"] = decoding("whole", path, "native", cores)
    if shutil.which("cc"):
        made["C decoder, with the digest"] = (
            [str(c_decoder(kept)), "digest", str(path)],
            {"C3GS_TABLES": str(tables_file())},
        )
    if shutil.which("node"):
        made["JavaScript and WebAssembly"] = ["node", str(ROOT / "benchmarks" / "decoding.mjs"), str(path)], {}
    return made


def in_turn(wanted: Mapping[str, Decoder], rounds: int) -> dict[str, list[tuple[Usage, dict[str, Any]]]]:
    """Runs each decoder once in each round. Returns what the processes took and printed.

    Decoders that this machine does not have are left out. Those that print no JSON, as the decoder in C, have their
    digest after the first word, and the times of the process.
    """
    runs: dict[str, list[tuple[Usage, dict[str, Any]]]] = {name: [] for name in wanted}
    for number in tqdm(range(rounds * len(wanted)), unit="runs", **bar_options()):
        name = [*wanted][number % len(wanted)]
        spent = usage(*wanted[name])
        if spent.status == DONE:
            process: dict[str, Any] = {"seconds": spent.seconds, "processor": spent.processor}
            if spent.printed.startswith("{"):
                process = json.loads(spent.printed)
            elif spent.printed:
                process |= {"digest": spent.printed.split()[1]}
            runs[name].append((spent, process))
    return {name: own for name, own in runs.items() if own}


def decode(options: Namespace) -> list[str]:
    """Returns the lines of the section about a large scene. Raises ValueError if digests differ."""
    anchors, rounds, kept = options.anchors, options.rounds, options.kept
    path, facts = large(anchors, kept), machine("torch")
    runs = {name: [result for _, result in own] for name, own in in_turn(decoders(path, kept), rounds).items()}
    digests = {result["digest"] for own in runs.values() for result in own if "digest" in result}
    if len(digests) != 1:
        raise ValueError(f"the decoders disagree: {', '.join(sorted(digests))}")
    base, rows = runs["refcodec, native"], []
    for name, own in runs.items():
        row = [f"{median(result[clock] for result in own):.3f}" for clock in ("seconds", "processor")]
        ratio = median(one["processor"] / other["processor"] for one, other in zip(own, base, strict=True))
        rows.append([name, *row, f"{ratio:.2f}"])
    return [
        f"`python -m benchmarks decode --anchors {anchors} --rounds {rounds}`",
        "",
        facts,
        f"{anchors:,} anchors, {path.stat().st_size:,} bytes, with the symbols of `{TRAINED.name}`: its anchors are",
        "repeated, and each copy has its own chunks. Medians of the times of all symbols and float32 values; ratios of",
        f"the same round. One thread each unless stated. That of C includes the start of the process. {rounds} rounds.",
        "",
        *table(["decoder", "seconds", "processor seconds", "times of `refcodec, native`"], rows),
        "",
        f"The digest of all results is {digests.pop()[:16]}.",
        *(
            [f"The paper's own decoder takes {PAPER_SECONDS} s for a scene of this size, on a GPU."]
            * (anchors == PAPER_ANCHORS)
        ),
    ]
