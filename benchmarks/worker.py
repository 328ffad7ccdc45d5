"""One contender in a separate process: python -m benchmarks.worker KIND FILE KEPT [OPTION]

It prepares itself, runs once without measurement, and prints a line of JSON:

- `missing`: the reason why it cannot take part; then it ends. Or
- `digest`: that of its result, or null for a contender that is not a decoder; `says`: the scope of the times.

Then it runs once for each line of its input, and prints `seconds`, `processor` (seconds of all its threads and
processes) and, if it has any, the processor seconds of its `parts`.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from refcodec.bitstream.codec import parse
from refcodec.bitstream.reconstruction import digest, reconstruct
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables_file

from . import floor
from .compiled import MissingError, compiled
from .large import ROOT

DECODER = ROOT / "conformance" / "c" / "decoder.c"

# The output of most contenders.
WHOLE_OUTPUT = "all symbols and float32 values"


@dataclass(frozen=True)
class Ready:
    """A prepared contender.

    run: the timed function, which returns a result. digest: of a result, or None. says: the scope of the times. parts:
    returns the processor seconds of the parts of a result.
    """

    run: Callable[[], Any]
    digest: Callable[[Any], str | None]
    says: str
    parts: Callable[[Any], dict[str, float]] | None = None


def _whole(scene: Scene) -> str:
    return digest(scene)[0]


def _decode(path: Path, kept: Path, option: str) -> Ready:
    data = path.read_bytes()

    def run() -> Scene:
        scene = parse(data).scene
        reconstruct(scene)
        return scene

    return Ready(run, _whole, WHOLE_OUTPUT)


def _digest(path: Path, kept: Path, option: str) -> Ready:
    data = path.read_bytes()
    return Ready(lambda: _whole(parse(data).scene), str, "all symbols and float32 values, and their SHA-256")


def _c(path: Path, kept: Path, option: str) -> Ready:
    program = compiled(DECODER, ["-std=c11", "-O3", "-march=native"], kept)
    os.environ["C3GS_TABLES"] = str(tables_file())

    def run() -> str:
        return subprocess.run([program, "digest", path], capture_output=True, text=True, check=True).stdout

    says = "all symbols and float32 values, and their SHA-256; including the start of a process and reading the file"
    return Ready(run, lambda printed: str(printed).split()[1], says)


def _family(path: Path, kept: Path, option: str) -> Ready:
    try:
        import torch  # noqa: PLC0415
    except ImportError as error:
        raise MissingError(f"torch: {error}") from None
    from .family import Family  # noqa: PLC0415

    torch.set_num_threads(1)
    scene = parse(path.read_bytes()).scene
    family = Family(scene)
    says = "the symbols of attributes alone; contexts, masks and positions are given"
    return Ready(family.decode, lambda found: _whole(replace(scene, attributes=found)), says)


def _floor(path: Path, kept: Path, option: str) -> Ready:
    least = floor.Floor(parse(path.read_bytes()).scene, floor.builds()[option], kept)

    def check(_: dict[str, float]) -> None:
        if (least.found != least.symbols).any():
            raise AssertionError("the rANS pass gave wrong symbols")

    products = "int16 pairs" if least.pairs else "float32"
    says = f"bare products ({products}), one bare rANS pass ({len(least.symbols):,} symbols), one pass over the output"
    return Ready(least.run, check, says, lambda spent: spent)


KINDS: dict[str, Callable[[Path, Path, str], Ready]] = {
    "decode": _decode,
    "digest": _digest,
    "c": _c,
    "family": _family,
    "floor": _floor,
}


def _processor() -> float:
    """Returns the processor seconds of this process, its threads, and its finished child processes."""
    waited = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + waited.ru_utime + waited.ru_stime


def main(kind: str, path: Path, kept: Path, option: str = "") -> None:
    """Answers until its input ends."""
    # Output of compilers and libraries goes to stderr, so that it does not mix with answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def answer(**found: Any) -> None:
        print(json.dumps(found), file=answers, flush=True)

    try:
        ready = KINDS[kind](path, kept, option)
    except MissingError as error:
        answer(missing=str(error))
        return
    answer(digest=ready.digest(ready.run()), says=ready.says)
    for _ in sys.stdin:
        seconds, processor = time.perf_counter(), _processor()
        result = ready.run()
        seconds, processor = time.perf_counter() - seconds, _processor() - processor
        parts = {"parts": ready.parts(result)} if ready.parts else {}
        del result
        answer(seconds=seconds, processor=processor, **parts)


if __name__ == "__main__":
    kind, file, kept, *option = sys.argv[1:]
    main(kind, Path(file), Path(kept), *option)
