"""Positions and weights raw and packed: bytes, seconds, what rounding the weights costs, and where every byte goes.

python -m benchmarks.packing scenes                             trains both scenes, which are kept in --work
python -m benchmarks.packing garden --points test_garden.npz    many anchors, networks of random numbers

benchmarks/points.py says where test_garden.npz is from. Each part writes its section of RESULTS.md.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

# Before numba and torch are loaded: threads that wait do not spin.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba
import numpy as np
import torch

from refcodec.bitstream import codec
from refcodec.bitstream.dimensions import RENDERING
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import to_grid
from refcodec.encoder.quantise import packed
from refcodec.encoder.weights import quantise_rendering
from refcodec.evaluate.quality import measures
from refcodec.inspect.elements import outline_of
from refcodec.inspect.parts import part_bytes
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.render.view import View
from refcodec.train.fit import fit
from refcodec.train.fit_input import read_given
from refcodec.train.settings import FitSettings, TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer

from .account import account
from .results import machine, table, write_section
from .runs import EXAMPLES

SCENES, SIZE = ("caliterra", "snowmiku"), (400, 300)
SETTINGS = varied(TrainSettings(), {"rate.weight": 0.004, "steps": 3000})
# Steps of the garden's fit: its attributes only have to be of about their size.
FIT_STEPS = 100
# Runs of each decoder, in turn.
REPEATS = 7
CODINGS = (("raw", "raw"), ("packed", "raw"), ("raw", "packed"), ("packed", "packed"))
COLUMNS = ("weights", "planes", "index", "positions", "masks", "attributes")
HEAD = ["scene", "positions", "weights", *(f"{c}, bytes" for c in COLUMNS), "file, bytes", "decoding, ms of one core"]


def train(name: str, work: Path) -> None:
    """Trains a scene twice, the same until the weights are rounded or not; writes raw files of both."""
    if (work / f"{name}-float.c3gs").exists():
        return
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    photographs, state = read_photographs(EXAMPLES / name, SIZE), work / f"{name}.train-state"

    def watch(trainer: Trainer) -> None:
        if trainer.clock.done % 250 == 0:
            print(f"{name}: step {trainer.clock.done} of {trainer.clock.steps}", flush=True)

    if not state.exists():
        trainer = Trainer(photographs, SETTINGS)
        while trainer.clock.share < trainer.clock.begin("weights"):
            trainer.step()
            watch(trainer)
        save(trainer, state)
    for kind in ("grid", "float"):
        trainer = Trainer(photographs, SETTINGS)
        if kind == "float":
            trainer.parts[:] = [part for part in trainer.parts if part.name != "weights"]
        restore(trainer, state)
        trainer.run(watch)
        scene = trainer.result()
        assert isinstance(scene, Scene)
        (work / f"{name}-{kind}.c3gs").write_bytes(codec.emit(scene))


def shown(scene: Scene, photographs: PhotographSet) -> float:
    """Mean PSNR of the held-out photographs, dB."""
    view = View(scene)
    return float(np.mean([measures(view.draw(p.camera), p.image)["psnr"] for p in photographs.test]))


def lengths(data: bytes) -> dict[str, int]:
    """Bytes of each part."""
    return part_bytes(data, outline_of(data))


def seconds(files: list[bytes]) -> list[float]:
    """Of each file, of the fastest of some decodings that take turns.

    They are seconds of the processor, which other work disturbs less.
    """
    best = [float("inf")] * len(files)
    for _ in range(REPEATS):
        for i, data in enumerate(files):
            start = time.process_time()
            codec.parse(data)
            best[i] = min(best[i], time.process_time() - start)
    return best


def coding_rows(scene: Scene, note: str) -> tuple[list[list[str]], bytes]:
    """Rows of the table of codings, and the file with both packed."""
    files = [codec.emit(packed(scene, *coding)) for coding in CODINGS]
    parts, times = [lengths(data) for data in files], seconds(files)
    rows = []
    for coding, data, part, spent in zip(CODINGS, files, parts, times, strict=True):
        sizes = [f"{part[c]:,}" for c in COLUMNS]
        rows.append([note, *coding, *sizes, f"{len(data):,}", f"{1000 * spent:.0f}"])
        note = ""
    saved = [f"1/{parts[0][c] / parts[-1][c]:.1f}" if c in ("weights", "positions") else "" for c in COLUMNS]
    whole = f"1/{len(files[0]) / len(files[-1]):.2f}"
    return [*rows, ["", "", "", *saved, whole, f"{times[-1] / times[0] - 1:+.0%}"]], files[-1]


def bits_of(scene: Scene) -> str:
    """Bits of the largest weight of each layer on a grid."""
    found = []
    for layers in scene.networks.values():
        for layer in layers:
            grid = to_grid(layer)
            assert grid is not None
            found.append(str(int(np.abs(grid.weight).max()).bit_length() + 1))
    return " ".join(found)


def rounding_rows(name: str, found: dict[str, Scene], photographs: PhotographSet) -> list[list[str]]:
    """Rows of what rounding the weights costs. found: the scene with weights on grids, `grid`, and without, `float`."""
    psnr = {kind: shown(scene, photographs) for kind, scene in found.items()}
    plain = found["float"]
    begin = next(phase.begin for phase in SETTINGS.phases if phase.name == "weights")
    cases = [("float32 to the end", plain, ""), (f"rounded from {begin:.0%} of the steps on", found["grid"], "grid")]
    for few in (8, 7, 6):
        at_once = replace(plain, networks=quantise_rendering(plain.networks, few))
        cases.append((f"rounded at the end, rendering networks {few} bits", at_once, ""))
    rows = []
    for words, scene, kind in cases:
        coded = codec.emit(packed(scene, "packed", "packed"))
        part, value = lengths(coded), shown(scene, photographs)
        note = f"{value:.3f}" + ("" if scene is plain else f" ({value - psnr['float']:+.3f})")
        sizes = [f"{part['weights']:,}", f"{part['attributes']:,}", f"{len(coded):,}"]
        rows.append([name, words, note, *sizes, bits_of(scene) if kind else ""])
    return rows


def scenes(work: Path) -> list[str]:
    """Both scenes from photographs."""
    with ProcessPoolExecutor(len(SCENES), multiprocessing.get_context("spawn")) as pool:
        list(pool.map(train, SCENES, [work] * len(SCENES)))
    codings, rounding = [], []
    accounts: list[str] = []
    for name in SCENES:
        photographs = read_photographs(EXAMPLES / name, SIZE)
        found = {kind: codec.parse((work / f"{name}-{kind}.c3gs").read_bytes()).scene for kind in ("float", "grid")}
        rows, data = coding_rows(found["grid"], f"{name}, {found['grid'].anchor_count:,} anchors")
        codings += rows
        assert shown(codec.parse(data).scene, photographs) == shown(found["grid"], photographs)
        rounding += rounding_rows(name, found, photographs)
        accounts += [] if accounts else [f"### Every byte of {name}", "", *account(data)]
    what = f"{SIZE[0]} x {SIZE[1]}, {SETTINGS.steps} steps, lambda_r {SETTINGS.rate.weight:g}."
    head = ["scene", "weights", "PSNR", "weights, bytes", "attributes, bytes", "file, bytes"]
    return [
        "`python -m benchmarks.packing scenes`",
        "",
        f"{machine('torch')} {what}",
        "",
        *table(HEAD, codings),
        "",
        "PSNR is the same in all four: no symbol and no weight of the rendering networks differs.",
        "",
        "### Rounding the weights",
        "",
        *table([*head, "bits of the largest weight in each layer"], rounding),
        "",
        *accounts,
    ]


def garden(points: Path) -> list[str]:
    """The paper's size: anchors of a large scene, and rendering networks of random numbers on a grid of eight bits."""
    scene = fit(read_given(points), FitSettings(steps=FIT_STEPS)).scene
    rng, networks = np.random.default_rng(0), dict(scene.networks)
    for name in RENDERING:
        networks[name] = [
            (rng.normal(0, 0.2, w.shape).astype(np.float32), rng.normal(0, 0.2, b.shape).astype(np.float32))
            for w, b in networks[name]
        ]
    scene = replace(scene, networks=quantise_rendering(networks, 8))
    rows, _ = coding_rows(scene, f"garden's points, {scene.anchor_count:,} anchors")
    what = (
        f"Coding networks and attributes of {FIT_STEPS} steps of `fit`; rendering networks of random numbers, 8 bits."
    )
    command = f"`python -m benchmarks.packing garden --points {points.name}`"
    return [command, "", machine("torch"), what, "", *table(HEAD, rows)]


def main() -> None:
    """Runs one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("scenes", "garden"))
    parser.add_argument("--work", type=Path, default=Path("benchmark-runs"))
    parser.add_argument("--points", type=Path)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    if arguments.part == "scenes":
        write_section("packing-scenes", "Positions and weights, raw and packed", scenes(arguments.work))
    elif arguments.points:
        write_section("packing-garden", "Positions and weights of a large scene", garden(arguments.points))
    else:
        parser.error("garden needs --points")


if __name__ == "__main__":
    main()
