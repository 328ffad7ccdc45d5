"""Symbols moved one step towards their most likely value, where that saves the most bits: a file is written and drawn.

  python -m benchmarks.lengths.moves caliterra.c3gs PHOTOGRAPHS FOLDER

Networks and planes stay as they are. The first slices of features are contexts of the later ones, so that what a move
saves there is not all of what it changes: the file that is written tells.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.conventions import Int64
from refcodec.bitstream.entropy import SymbolName
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet
from refcodec.train.rate_model.units import MEAN_UNIT, SCALE_UNIT

from ..ideal import BitCounter, bin_bits
from ..results import table

# Least bits that a move of one symbol saves.
LEAST = (4.0, 3.0, 2.0, 1.5, 1.0)
MOVES_FILE = "moves.jsonl"


class _Recorder(BitCounter):
    """Keeps means, scales and symbols of each call."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[tuple[Int64, Int64, Int64]] = []

    def values(
        self,
        models: ModelSet,
        mean: Int64,
        scale: Int64,
        counts: list[int],
        limit: int,
        name: SymbolName,
        given: Int64 | None,
    ) -> Int64:
        """As Encoder.values."""
        assert given is not None
        self.calls.append((mean, scale, given))
        return super().values(models, mean, scale, counts, limit, name, given)


def moved(symbol: Int64, mean: Int64, scale: Int64, least: float) -> Int64:
    """Symbols one nearer to their mean, where that saves `least` bits or more. Arguments as in SPEC 7.7."""
    m, s = mean / MEAN_UNIT, scale / SCALE_UNIT
    nearer = symbol - np.sign(symbol - np.floor(m + 0.5)).astype(np.int64)
    saved = bin_bits("gauss", m, s, symbol.astype(np.float64)) - bin_bits("gauss", m, s, nearer.astype(np.float64))
    return np.where(saved >= least, nearer, symbol)


def with_moves(scene: Scene, kinds: str, least: float) -> tuple[Scene, int]:
    """The scene with moves of some kinds of symbols (f, s, o), and how many moved."""
    recorder = _Recorder()
    coding, n = codec.Coding(scene), scene.anchor_count
    code_attributes(recorder, coding.model, coding.contexts(), scene.masks, [range(n)], scene.attributes)
    found, a = [], scene.attributes
    for mean, scale, symbol in recorder.calls:
        found.append(moved(symbol, mean, np.maximum(scale, -40), least))
    slices = len(scene.dimensions.slices)
    features: NDArray[np.int32] = np.concatenate([f.reshape(n, -1) for f in found[:slices]], axis=1).astype(np.int32)
    offsets = a.offsets.copy().reshape(-1)
    offsets[np.repeat(scene.masks, 3, axis=1).reshape(-1)] = found[slices + 1]
    new = replace(
        a,
        features=features if "f" in kinds else a.features,
        scalings=found[slices].reshape(n, -1).astype(np.int32) if "s" in kinds else a.scalings,
        offsets=offsets.reshape(a.offsets.shape) if "o" in kinds else a.offsets,
    )
    count = sum(int((getattr(new, k) != getattr(a, k)).sum()) for k in ("features", "scalings", "offsets"))
    return replace(scene, attributes=new), count


def shown(path: Path, photographs: Path, size: str) -> float:
    """Held-out PSNR of a file."""
    command = [sys.executable, "-m", "refcodec", "eval", "--json", "--size", size, str(path), str(photographs)]
    return float(json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["mean"]["psnr"])


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("photographs", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--size", default="200")
    args = parser.parse_args()
    scene, whole = codec.parse(args.file.read_bytes()).scene, args.file.stat().st_size
    first = shown(args.file, args.photographs, args.size)
    rows = []
    for kinds in ("f", "s", "o"):
        for least in LEAST:
            new, count = with_moves(scene, kinds, least)
            path = args.work / "moved.c3gs"
            data = codec.emit(new)
            path.write_bytes(data)
            psnr = shown(path, args.photographs, args.size)
            entry = {"scene": args.file.stem, "file": whole, "kinds": kinds, "least": least, "moved": count}
            entry |= {"saved": whole - len(data), "lost": first - psnr, "psnr": first}
            with (args.work / MOVES_FILE).open("a") as stream:
                stream.write(json.dumps(entry) + "\n")
            rows.append([kinds, f"{least}", f"{count:,}", f"{whole - len(data):,}", f"{first - psnr:.3f}"])
            print(rows[-1], flush=True)
    print("\n".join(table(["kind", "least bits", "moved", "bytes saved", "dB lost"], rows)))


if __name__ == "__main__":
    main()
