"""Size against the ideal and speed, on anchors made from a point cloud.

python -m benchmarks.points --points examples/photographs/caliterra/sparse/0/points3D.txt --name caliterra
python -m benchmarks.points --points test_garden.npz --name garden --tile 421600

test_garden.npz is `assets/test_garden.npz` of github.com/nerfstudio-project/gsplat (Apache-2.0), 2 MB.

Fits networks to the cloud's anchors, codes the scene, and writes a section of RESULTS.md, one for each --name. With
--tile the fitted scene is also repeated up to that many anchors, to measure speed at another size.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.encoder.masks import mask_model
from refcodec.inspect.elements import outline_of
from refcodec.inspect.parts import part_bytes
from refcodec.train.fit import fit
from refcodec.train.fit_input import read_given
from refcodec.train.settings import FitSettings

from . import ideal
from .resident import ROOT
from .results import machine, table, write_section

# Times a parse in a process of its own, whose peak memory is the decoder's.
DECODE = """
import sys, time
from benchmarks.resident import resident
from refcodec.bitstream import codec
from refcodec.bitstream.tables import tables
stages = {}
def note(stage, done, total):
    now = time.perf_counter()
    if done == 0: stages[stage] = -now
    if done == total: stages[stage] += now
data = open(sys.argv[1], "rb").read()
tables()
start = time.perf_counter()
codec.parse(data, progress=note)
total = time.perf_counter() - start
print(total, stages["planes"], stages["chunks"], resident() / 2**20)
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


def decode_times(data: bytes, repeats: int) -> tuple[list[float], float]:
    """Seconds of the fastest of some parses (whole, planes, chunks), and the peak in MiB of its process."""
    runs = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.c3gs"
        path.write_bytes(data)
        for _ in range(repeats):
            command = [sys.executable, "-c", DECODE, str(path)]
            done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
            runs.append([float(x) for x in done.stdout.split()])
    best = min(runs)
    return best[:3], best[3]


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


def size_tables(scene: Scene, data: bytes) -> list[str]:
    """Coded bytes beside the ideal and beside the order-0 entropy, and the losses by cause."""
    sizes = part_bytes(data, outline_of(data))
    parts = [("attributes", ideal.attribute_code_length(scene)), ("planes", ideal.plane_code_length(scene))]
    zero = ideal.order_zero_bits(scene)
    rows, losses, total = [], [], np.zeros(4)
    for name, length in parts:
        coded = sizes[name]
        total += [length.symbols, coded, length.capped / 8, zero[name] / 8]
        shown = [f"{8 * coded / length.capped - 1:+.3%}", f"{length.ideal / 8:,.0f}", f"{zero[name] / 8:,.0f}"]
        each = f"{8 * coded / length.symbols:.3f}"
        rows.append([name, f"{length.symbols:,}", f"{coded:,}", f"{length.capped / 8:,.0f}", *shown, each])
        steps = [length.capped, length.grid, length.integer, length.table, 8 * coded]
        shares = [f"{(b - a) / length.capped:+.3%}" for a, b in pairwise(steps)]
        escapes = f"{length.escapes:,} symbols, {length.escape / 8:,.0f} bytes"
        losses.append([name, *shares, escapes, f"{length.raw / 8:,.0f} bytes"])
    symbols, every, capped, order = total.tolist()
    shares = [f"{symbols:,.0f}", f"{every:,.0f}", f"{capped:,.0f}", f"{every / capped - 1:+.3%}", "", f"{order:,.0f}"]
    rows.append(["both", *shares, f"{8 * every / symbols:.3f}"])
    head = ["part", "symbols", "bytes coded", "ideal, capped", "coded / ideal", "ideal, uncapped", "order-0 bytes"]
    causes = ["1/16 step, 1/8 octave", "integer networks", "frequency models", "lanes, heads", "escapes", "raw bits"]
    first, second = table([*head, "bits a symbol"], rows), table(["part", *causes], losses)
    return [*first, "", "Losses in % of the capped ideal:", "", *second]


def speed_rows(name: str, scene: Scene, repeats: int) -> tuple[list[list[str]], bytes]:
    """Rows of the table of seconds: encode, then decode."""
    timer = StageTimer()
    start = time.perf_counter()
    data = codec.emit(scene, progress=timer)
    whole, s = time.perf_counter() - start, timer.seconds
    encode = [f"{whole:.2f}", f"{s['planes']:.2f}", f"{s['chunks']:.2f}", ""]
    (whole, planes, chunks), peak = decode_times(data, repeats)
    decode = [f"{whole:.2f}", f"{planes:.2f}", f"{chunks:.2f}", f"{peak:.0f}"]
    return [[f"{name}, encode", *encode], [f"{name}, decode", *decode]], data


def section(arguments: argparse.Namespace) -> list[str]:
    """The section's text."""

    def note(stage: str, done: int, total: int) -> None:
        if done % 100 == 0:
            print(f"{stage} {done}/{total}", file=sys.stderr, flush=True)

    given, settings = read_given(arguments.points), FitSettings(steps=arguments.steps)
    result = fit(given, settings, progress=note, state=arguments.state)
    scene, done = result.scene, result.report
    rows, data = speed_rows(f"{scene.anchor_count:,} anchors", scene, arguments.repeats)
    if codec.emit(codec.parse(data).scene) != data:
        raise AssertionError("the file does not survive decoding")
    more = []
    if arguments.tile:
        larger = tiled(scene, arguments.tile, settings.seed)
        others, tile_data = speed_rows(f"{arguments.tile:,} anchors (repeated)", larger, arguments.repeats)
        rows += others
        symbols = 56 * larger.anchor_count + 3 * int(larger.masks.sum())
        more = [
            f"Repeated: {len(tile_data):,} bytes, {symbols:,} attribute symbols, anchors drawn from the fitted scene "
            "and moved."
        ]
    # Where a file lies outside the project is nobody's business.
    points = arguments.points.name if arguments.points.is_absolute() else arguments.points
    options = [f"--points {points}", f"--name {arguments.name}", f"--steps {settings.steps}"]
    options += [f"--tile {arguments.tile}"] if arguments.tile else []
    return [
        f"`python -m benchmarks.points {' '.join(options)}`",
        "",
        machine("torch"),
        *_facts(scene, data),
        f"{done['steps']:,} steps in {done['seconds']:.0f} s, seed {done['seed']}.",
        "",
        *size_tables(scene, data),
        "",
        "The ideal is the code length under the same weights in float64 with nothing rounded. Capped, no symbol counts",
        "more than the 14 bits of the least likely symbol of a model. Bytes coded are those of whole parts:",
        "heads, states, words and raw bits.",
        "",
        *table(["", "seconds", "planes", "chunks", "peak MiB"], rows),
        "",
        f"Decoding: fastest of {arguments.repeats}, each in a process of its own, whose peak is with Python and numpy.",
        f"Load average {os.getloadavg()[1]:.1f} in the last five minutes, this run included.",
        *more,
    ]


def _facts(scene: Scene, data: bytes) -> list[str]:
    """What was coded, and the sizes of the parts that the tables leave out."""
    sizes, lanes = part_bytes(data, outline_of(data)), scene.lanes
    features, scalings, offsets = scene.base_step
    return [
        f"{scene.anchor_count:,} anchors, {int(scene.masks.sum()):,} offsets kept, B = {scene.dimensions.plane_size}.",
        f"Steps are {features:.4g} (features), {scalings:.4g} (logarithms of scalings), {offsets:.4g} (offsets).",
        f"The file has {len(data):,} bytes, of which positions {sizes['positions']:,}, masks {sizes['masks']:,} and",
        f"weights {sizes['weights']:,}, in {len(scene.chunks)} chunks. Lanes are {1 << lanes.plane} (planes),",
        f"{1 << lanes.mask} (masks) and {1 << lanes.attribute} (attributes).",
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--points", type=Path, required=True, help="COLMAP points3D.txt, or npz with means3d and colors"
    )
    parser.add_argument("--name", required=True, help="section of RESULTS.md")
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--tile", type=int, help="anchors of a larger scene, for speed")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--state", help="file in which training saves itself and from which it goes on")
    arguments = parser.parse_args()
    write_section(arguments.name, f"Anchors of {arguments.name}", section(arguments))


if __name__ == "__main__":
    main()
