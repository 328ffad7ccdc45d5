"""Size against the ideal and speed, on anchors made from a real point cloud.

python benchmarks/garden.py --points test_garden.npz --steps 4000
python benchmarks/garden.py --points points3D.txt --steps 4000 --voxel 0.02
python benchmarks/garden.py --points test_garden.npz --steps 4000 --tile 421600

Fits networks to the cloud's anchors, codes the scene, and writes a section of RESULTS.md (one for each --name). With --tile the
fitted scene is also repeated up to that many anchors, to measure speed at another size.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from benchmarks import ideal
from refcodec.bitstream import codec
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.directory import ATTRIBUTES, MASKS, PLANES_SECTION, POSITIONS, WEIGHTS
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.encoder.masks import mask_model
from refcodec.train.fit import FitResult, fit
from refcodec.train.voxelise import default_voxel, read_points, short_mantissa, voxelise

from .results import write_section

# Times a parse in a process of its own, whose peak memory is the decoder's.
DECODE = """
import sys, time
from refcodec import codec
from refcodec.tables import tables
stages = {}
def note(stage, done, total):
    now = time.perf_counter()
    if done == 0: stages[stage] = -now
    if done == total: stages[stage] += now
data = open(sys.argv[1], "rb").read()
tables()
start = time.perf_counter()
codec.parse(data, threads=int(sys.argv[2]), progress=note)
total = time.perf_counter() - start
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]
print(total, *(stages[s] for s in ("planes", "masks", "attributes")), peak)
"""


class StageTimer:
    """A codec.Progress that keeps the seconds of each stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.perf_counter()
        if done == 0:
            self.seconds[stage] = -now
        if done == total:
            self.seconds[stage] += now


def decode_times(data: bytes, threads: int, repeats: int) -> tuple[list[float], float]:
    """Seconds of the fastest of some parses (whole, planes, masks, attributes), and the peak in MiB of its process."""
    runs = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.c3gs"
        path.write_bytes(data)
        for _ in range(repeats):
            done = subprocess.run(
                [sys.executable, "-c", DECODE, str(path), str(threads)], check=True, capture_output=True, text=True
            )
            runs.append([float(x) for x in done.stdout.split()])
    best = min(runs)
    return best[:4], best[4] / 1024


def tiled(scene: Scene, count: int, seed: int) -> Scene:
    """The scene's anchors repeated, each copy moved a little, to `count` anchors in all."""
    index = np.sort(np.random.default_rng(seed).integers(0, scene.anchor_count, count))
    larger = take_anchors(scene, index)
    moved = larger.positions + np.random.default_rng(seed + 1).normal(0, 1, (count, 3)).astype(np.float16)
    moved[moved == 0] = 0
    larger = replace(
        larger, positions=np.clip(moved, -65000, 65000).astype(np.float16), mask_model=mask_model(larger.masks)
    )
    return replace(larger, attributes=replace(larger.attributes, steps=codec.derive_steps(larger)))


def size_table(scene: Scene, data: bytes) -> list[str]:
    """Coded bytes beside the ideal and beside the order-0 entropy, and the losses by cause."""
    sections = parse_container(data).sections
    parts = [
        ("attributes", ATTRIBUTES, ideal.attribute_code_length(scene)),
        ("planes", PLANES_SECTION, ideal.plane_code_length(scene)),
    ]
    zero = ideal.order_zero_bits(scene)
    head = [
        "part",
        "symbols",
        "bytes coded",
        "ideal, capped",
        "coded / ideal",
        "ideal, uncapped",
        "order-0 bytes",
        "bits a symbol",
    ]
    rows = [head, ["---"] * len(head)]
    losses = [
        ["part", "1/16 step, 1/8 octave", "integer networks", "frequency models", "lanes, heads", "escapes", "raw bits"]
    ]
    losses.append(["---"] * len(losses[0]))
    total = np.zeros(4)
    for name, kind, length in parts:
        coded = sections[kind].end - sections[kind].start
        total += [length.symbols, coded, length.capped / 8, zero[name] / 8]
        rows.append(
            [
                name,
                f"{length.symbols:,}",
                f"{coded:,}",
                f"{length.capped / 8:,.0f}",
                f"{8 * coded / length.capped - 1:+.3%}",
                f"{length.ideal / 8:,.0f}",
                f"{zero[name] / 8:,.0f}",
                f"{8 * coded / length.symbols:.3f}",
            ]
        )
        steps = [length.capped, length.grid, length.integer, length.table, 8 * coded]
        shares = [f"{(b - a) / length.capped:+.3%}" for a, b in pairwise(steps)]
        losses.append(
            [
                name,
                *shares,
                f"{length.escapes:,} symbols, {length.escape / 8:,.0f} bytes",
                f"{length.raw / 8:,.0f} bytes",
            ]
        )
    symbols, every, capped, order = total.tolist()
    shares = [f"{symbols:,.0f}", f"{every:,.0f}", f"{capped:,.0f}", f"{every / capped - 1:+.3%}", "", f"{order:,.0f}"]
    rows.append(["both", *shares, f"{8 * every / symbols:.3f}"])
    table = ["| " + " | ".join(row) + " |" for row in rows]
    return [*table, "", "Losses in % of the capped ideal:", "", *("| " + " | ".join(row) + " |" for row in losses)]


def speed_rows(name: str, scene: Scene, repeats: int) -> tuple[list[str], bytes]:
    """Rows of the table of seconds: encode, then decode with one and two threads."""
    timer = StageTimer()
    start = time.perf_counter()
    data = codec.emit(scene, progress=timer)
    whole = time.perf_counter() - start
    s = timer.seconds
    rows = [
        f"| {name}, encode, 1 thread | {whole:.2f} | {s['planes']:.2f} | masks and attributes {s['chunks']:.2f} | | |"
    ]
    for threads in (1, 2):
        (whole, planes, masks, attributes), peak = decode_times(data, threads, repeats)
        row = f"| {name}, decode, {threads} thread{'s'[: threads - 1]} | {whole:.2f} | {planes:.2f} | {attributes:.2f}"
        rows.append(f"{row} | {masks:.2f} | {peak:.0f} |")
    return rows, data


def report(arguments: argparse.Namespace, command: str) -> list[str]:
    """The section's text."""
    found = read_points(arguments.points)
    voxel = short_mantissa(arguments.voxel) if arguments.voxel else default_voxel(found.points)
    cloud = voxelise(found.points, found.colours, voxel)

    def note(stage: str, done: int, total: int) -> None:
        if done % 100 == 0:
            print(f"{stage} {done}/{total}", file=sys.stderr, flush=True)

    result: FitResult = fit(
        cloud, voxel=voxel, steps=arguments.steps, seed=arguments.seed, progress=note, state=arguments.state
    )
    scene, done = result.scene, result.report
    rows, data = speed_rows(f"{scene.anchor_count:,} anchors", scene, arguments.repeats)
    if codec.emit(codec.parse(data).scene) != data:
        raise AssertionError("the file does not survive decoding")
    sections = parse_container(data).sections
    others = {kind: sections[kind].end - sections[kind].start for kind in (POSITIONS, MASKS, WEIGHTS)}
    if arguments.tile:
        larger = tiled(scene, arguments.tile, arguments.seed)
        more, tile_data = speed_rows(f"{arguments.tile:,} anchors (repeated)", larger, arguments.repeats)
        rows += more
        kept = int(larger.masks.sum())
        symbols = 56 * larger.anchor_count + 3 * kept
        note_tile = [
            f"Repeated: {len(tile_data):,} bytes, {symbols:,} attribute symbols, anchors drawn from the fitted scene and moved."
        ]
    else:
        note_tile = []
    chunks = len(chunk_ranges(scene.anchor_count, scene.chunk_size))
    lanes = scene.lanes
    return [
        f"`{command}`",
        "",
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}, "
        f"torch {torch.__version__}. {len(found.points):,} points, voxel {voxel:g}: {scene.anchor_count:,} anchors, "
        f"{int(scene.masks.sum()):,} offsets kept, B = {scene.dimensions.plane_size}; steps {scene.base_step[0]:.4g} (features), "
        f"{scene.base_step[1]:.4g} (logarithms of scalings), {scene.base_step[2]:.4g} (offsets). "
        f"{done['steps']:,} steps in {done['seconds']:.0f} s, seed {done['seed']}. File {len(data):,} bytes, of which positions "
        f"{others[POSITIONS]:,}, masks {others[MASKS]:,}, weights {others[WEIGHTS]:,}. {chunks} chunks; lanes "
        f"{1 << lanes.plane} (planes), {1 << lanes.mask} (masks), {1 << lanes.attribute} (attributes).",
        "",
        *size_table(scene, data),
        "",
        "The ideal is the code length under the same weights in float64 with nothing rounded; capped, no symbol counts more than the",
        "14 bits of the least likely symbol of a model. Bytes coded are whole sections: tables, heads, states, words and raw bits.",
        "",
        "| | seconds | planes | attributes | masks | peak MiB |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        f"Decoding: fastest of {arguments.repeats}, each in a process of its own (peak with Python and numpy; all parts of the file).",
        *note_tile,
    ]


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(
        description="Size against the ideal and speed, on anchors made from a real point cloud."
    )
    parser.add_argument("--points", required=True, help="COLMAP points3D.txt, or npz with means3d and colors")
    parser.add_argument("--name", help="section of RESULTS.md (default: from the path)")
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--voxel", type=float, help="default: median distance to the nearest point")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tile", type=int, help="anchors of a larger scene, for speed")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--state", help="file in which training saves itself and from which it goes on")
    arguments = parser.parse_args()
    path = Path(arguments.points)
    name = arguments.name or (path.stem.removeprefix("test_") if path.suffix == ".npz" else path.stem)
    options = [f"--points {path.name}", f"--name {name}", f"--steps {arguments.steps}"]
    options += [f"--{o} {getattr(arguments, o)}" for o in ("voxel", "tile") if getattr(arguments, o)]
    lines = report(arguments, "python benchmarks/garden.py " + " ".join(options))
    print("\n".join(lines))
    write_section(name, f"Anchors of {name}", lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
