"""Positions and weights raw and packed: bytes, what rounding the weights costs, seconds, and where every byte of a file goes.

python benchmarks/packing.py scenes --work FOLDER                        trains both scenes; kept in FOLDER
python benchmarks/packing.py masks --work FOLDER                         of the files of scenes
python benchmarks/packing.py garden --points test_garden.npz             the paper's size: many anchors, networks of random numbers
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

# Before numba and torch are loaded: threads that wait do not spin.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import numba
import numpy as np
import torch

from benchmarks.ideal import BitCounter
from conformance.cases.target import Target
from refcodec.bitstream import codec
from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.conventions import Int64
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.entropy import SymbolName
from refcodec.bitstream.header import PROLOGUE_BYTES
from refcodec.bitstream.masks import code_masks, mask_models
from refcodec.bitstream.planes import code_planes
from refcodec.bitstream.positions import chunk_codes, code_cells
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet
from refcodec.bitstream.weights import code_grids, to_grid
from refcodec.encoder.quantise import packed
from refcodec.encoder.weights import quantise_rendering
from refcodec.evaluate.quality import measures
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.render.view import View
from refcodec.train.fit import fit
from refcodec.train.state import restore, save
from refcodec.train.trainer import WEIGHTS, Trainer, TrainSettings
from refcodec.train.voxelise import default_voxel, read_points, voxelise

from .results import write_section

EXAMPLES = Path(__file__).resolve().parent.parent / "examples" / "photographs"
SCENES, SIZE, STEPS, RATE = ("caliterra", "snowmiku"), (400, 300), 3000, 0.004
# Steps of the garden's fit: its attributes only have to be of about their size.
FIT_STEPS = 100
# Runs of each decoder, in turn.
REPEATS = 7
CODINGS = (("raw", "raw"), ("packed", "raw"), ("raw", "packed"), ("packed", "packed"))
MASKS_NOTE = (
    "None is taken: what the logits save, K more outputs of F_h cost for the most part (33 weights each, about 300 bytes in all), "
    "and the rest is 0.2 % of a file at most. Planes are about 1 % of these files: no model of theirs was tried."
)
COLUMNS = ("weights", "planes", "chunk_table", "positions", "masks", "attributes")


class _FloatTrainer(Trainer):
    """A training that leaves the weights as they are."""

    def _round_weights(self) -> None:
        pass


def train(name: str, work: Path) -> None:
    """Trains a scene twice, the same until the weights are rounded or not; writes raw files of both."""
    if (work / f"{name}-float.c3gs").exists():
        return
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    photographs = read_photographs(EXAMPLES / name, SIZE)
    settings, state = TrainSettings(rate=RATE, steps=STEPS), work / f"{name}.train-state"

    def watch(trainer: Trainer) -> None:
        if trainer.done % 250 == 0:
            print(f"{name}: step {trainer.done} of {STEPS}", flush=True)

    if not state.exists():
        trainer = Trainer(photographs, settings)
        while trainer.share < WEIGHTS:
            trainer.step()
            watch(trainer)
        save(trainer, state)
    for kind, maker in (("grid", Trainer), ("float", _FloatTrainer)):
        trainer = maker(photographs, settings)
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
    """Bytes of each section."""
    return {s.name: s.end - s.start for s in parse_container(data).sections.values()}


def seconds(files: list[bytes]) -> list[float]:
    """Of each file, of the fastest of some decodings that take turns; of the processor, which other work disturbs less."""
    best = [float("inf")] * len(files)
    for _ in range(REPEATS):
        for i, data in enumerate(files):
            start = time.process_time()
            codec.parse(data)
            best[i] = min(best[i], time.process_time() - start)
    return best


def coding_rows(scene: Scene, note: str) -> tuple[list[str], bytes]:
    """Rows of the table of codings, and the file with both packed."""
    files = [codec.emit(packed(scene, *coding)) for coding in CODINGS]
    parts, times = [lengths(data) for data in files], seconds(files)
    rows = []
    for (positions, weights), data, part, spent in zip(CODINGS, files, parts, times, strict=True):
        cells = " | ".join(f"{part[c]:,}" for c in COLUMNS)
        rows.append(f"| {note} | {positions} | {weights} | {cells} | {len(data):,} | {1000 * spent:.0f} |")
        note = ""
    saved = " | ".join(f"1/{parts[0][c] / parts[-1][c]:.1f}" if c in ("weights", "positions") else "" for c in COLUMNS)
    rows.append(f"| | | | {saved} | 1/{len(files[0]) / len(files[-1]):.2f} | {times[-1] / times[0] - 1:+.0%} |")
    return rows, files[-1]


CODING_HEAD = [
    "| scene | positions | weights | "
    + " | ".join(f"{c}, bytes" for c in COLUMNS)
    + " | file, bytes | decoding, ms of one core |",
    "|" + "---|" * (5 + len(COLUMNS)),
]


# --- the account ------------------------------------------------------------------------------------------------------


class Ledger(BitCounter):
    """A counter of code lengths by what the symbols are: bits, by the first part of their names."""

    def __init__(self) -> None:
        self.bits: dict[str, float] = defaultdict(float)

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
        before = self.table
        found = super().values(models, mean, scale, counts, limit, name, given)
        if len(found):
            self.bits[name(0, 0).partition("[")[0]] += self.table - before
        return found

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """As Encoder.plain."""
        before = self.table
        found = super().plain(models, index, counts, name, given)
        if len(found):
            self.bits[name(0, 0).partition("[")[0]] += self.table - before
        return found


def code_lengths(scene: Scene) -> dict[str, dict[str, float]]:
    """Of each section with substreams, bits of the symbols of each kind under the file's models."""
    d, every = scene.dimensions, [range(scene.anchor_count)]
    coding = codec.Coding(scene)
    found = {name: Ledger() for name in ("weights", "planes", "positions", "masks", "attributes")}
    code_planes(found["planes"], coding.sarm, d.plane_channels, d.plane_size, scene.planes)
    code_masks(found["masks"], mask_models(scene.mask_model), d.offset_count, every, scene.masks)
    code_attributes(found["attributes"], coding.model, coding.contexts(), scene.masks, every, scene.attributes)
    model = scene.position_model
    assert model is not None
    for start in range(0, scene.anchor_count, scene.chunk_size):
        codes = chunk_codes(scene.positions[start : start + scene.chunk_size], model.cell_shift)
        assert codes is not None
        code_cells(found["positions"], model.models(), [0], [len(codes)], codes)
    layers = layers_of(d)
    # A layer by itself: its symbols are named after it.
    assert scene.weight_scales is not None
    grids = [to_grid(layer) for network in scene.networks.values() for layer in network]
    for shape, grid, scales in zip(layers, grids, scene.weight_scales, strict=True):
        assert grid is not None
        code_grids(found["weights"], [shape], scales[None], [grid])
    return {name: ledger.bits for name, ledger in found.items()}


def account(data: bytes) -> list[str]:
    """A table of all bytes of a file with packed positions and weights, which adds up to its size."""
    scene, header = codec.parse(data).scene, parse_container(data)
    heads: dict[int, int] = defaultdict(int)
    states: dict[int, int] = defaultdict(int)
    streams: dict[int, int] = defaultdict(int)
    for s in Target(data).substreams.values():
        heads[s.section] += 8
        states[s.section] += 4 * s.lanes
        streams[s.section] += s.end - s.start
    symbols = code_lengths(scene)
    first = min(s.start for s in header.sections.values())
    rows: list[tuple[str, str, float]] = [
        ("prologue", "", PROLOGUE_BYTES),
        ("header", "fields and directory", first - PROLOGUE_BYTES),
    ]
    for kind, section in header.sections.items():
        name, size = section.name, section.end - section.start
        rows.append((name, "tables", size - streams[kind]))
        if not streams[kind]:
            continue
        rows.append((name, "heads of substreams", heads[kind]))
        rows.append((name, "states of lanes", states[kind]))
        spent = 0.0
        grouped: dict[str, float] = defaultdict(float)
        for path, bits in symbols[name].items():
            words = path.split(".")
            group = "symbols"
            if name == "weights":
                group = f"{words[1]}, {words[-1]}s"
            elif name == "attributes":
                group = words[1]
            grouped[group] += bits / 8
        for group, size_of in sorted(grouped.items(), key=lambda item: -item[1]):
            rows.append((name, group, size_of))
            spent += size_of
        # Lanes end in one state, so that the states sent are not lost whole.
        rows.append((name, "coder, less what the states hold", streams[kind] - heads[kind] - states[kind] - spent))
    total = sum(size for _, _, size in rows)
    assert round(total) == len(data), (total, len(data))
    lines = ["| section | what | bytes | share |", "|---|---|---|---|"]
    before = ""
    for name, what, share in rows:
        lines.append(f"| {name if name != before else ''} | {what} | {share:,.1f} | {share / len(data):.2%} |")
        before = name
    return [*lines, f"| whole | | {total:,.1f} | 100 % |"]


# --- the parts --------------------------------------------------------------------------------------------------------


def machine() -> str:
    """The line that says what measured."""
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, torch {torch.__version__}"
    return f"{platform.machine()}, {os.cpu_count()} cores, {versions}."


def bits_of(scene: Scene) -> str:
    """Bits of the largest weight of each layer on a grid."""
    found = []
    for layers in scene.networks.values():
        for layer in layers:
            grid = to_grid(layer)
            assert grid is not None
            found.append(str(int(np.abs(grid.weight).max()).bit_length() + 1))
    return " ".join(found)


def scenes(work: Path) -> None:
    """Both scenes from photographs."""
    work.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(len(SCENES), multiprocessing.get_context("spawn")) as pool:
        list(pool.map(train, SCENES, [work] * len(SCENES)))
    lines = [
        "`python benchmarks/packing.py scenes`",
        "",
        f"{machine()} {SIZE[0]} x {SIZE[1]}, {STEPS} steps, lambda_r {RATE:g}.",
        "",
    ]
    rounding = [
        "| scene | weights | PSNR | weights, bytes | attributes, bytes | file, bytes | bits of the largest weight in each layer |",
        "|" + "---|" * 7,
    ]
    lines += CODING_HEAD
    accounts: list[str] = []
    facts: dict[str, Any] = {}
    for name in SCENES:
        photographs = read_photographs(EXAMPLES / name, SIZE)
        found = {kind: codec.parse((work / f"{name}-{kind}.c3gs").read_bytes()).scene for kind in ("float", "grid")}
        rows, data = coding_rows(found["grid"], f"{name}, {found['grid'].anchor_count:,} anchors")
        lines += rows
        psnr = {kind: shown(scene, photographs) for kind, scene in found.items()}
        assert shown(codec.parse(data).scene, photographs) == psnr["grid"]
        for kind, words in (("float", "float32 to the end"), ("grid", f"rounded from {WEIGHTS:.0%} of the steps on")):
            coded = codec.emit(packed(found[kind], "packed", "packed"))
            part = lengths(coded)
            bits = bits_of(found[kind]) if kind == "grid" else ""
            note = f"{psnr[kind]:.3f}" + (f" ({psnr['grid'] - psnr['float']:+.3f})" if kind == "grid" else "")
            rounding.append(
                f"| {name} | {words} | {note} | {part['weights']:,} | {part['attributes']:,} | {len(coded):,} | {bits} |"
            )
        for few in (8, 7, 6):
            at_once = replace(found["float"], networks=quantise_rendering(found["float"].networks, few))
            coded = codec.emit(packed(at_once, "packed", "packed"))
            change = shown(at_once, photographs) - psnr["float"]
            rounding.append(
                f"| {name} | rounded at the end, rendering networks {few} bits | {psnr['float'] + change:.3f} ({change:+.3f}) "
                f"| {lengths(coded)['weights']:,} | {lengths(coded)['attributes']:,} | {len(coded):,} | |"
            )
        if not accounts:
            accounts = [f"### Every byte of {name}", "", *account(data)]
        facts[name] = {"psnr": psnr, "bytes": len(data)}
    print(json.dumps(facts))
    lines += [
        "",
        "PSNR is the same in all four: no symbol and no weight of the rendering networks differs.",
        "",
        "### Rounding the weights",
        "",
    ]
    write_section("packing-scenes", "Positions and weights, raw and packed", [*lines, *rounding, "", *accounts])


def masks(work: Path) -> None:
    """Other models of the masks, ideal code lengths: static frequencies by other contexts, and logits of a network."""
    torch.set_num_threads(1)
    lines = ["`python benchmarks/packing.py masks`, after `scenes`", "", machine(), ""]
    head = (
        "scene",
        "now",
        "model, bytes",
        "by all kept bits before",
        "model, bytes",
        "by the anchor before as well",
        "logits from F_h's contexts",
    )
    lines.append("| " + " | ".join(head) + " |")
    lines.append("|" + "---|" * 7)
    for name in SCENES:
        scene = packed(codec.parse((work / f"{name}-grid.c3gs").read_bytes()).scene, "packed", "packed")
        kept, k = scene.masks.astype(np.int64), scene.dimensions.offset_count
        column, before = np.arange(k)[None], np.cumsum(kept, axis=1) - kept
        history = (kept << column).cumsum(axis=1) - (kept << column)
        previous = np.vstack([np.zeros((1, k), np.int64), kept[:-1]])

        def length(context: Int64, kept: Int64 = kept) -> float:
            _, index = np.unique(context, return_inverse=True)
            share = np.bincount(index.reshape(-1), weights=kept.reshape(-1)) / np.bincount(index.reshape(-1))
            each = share[index.reshape(kept.shape)]
            return float(-np.log2(np.where(kept == 1, each, 1 - each)).sum()) / 8

        now, seen = column * k + before, column << k | history
        cells = [
            length(now),
            2 * len(scene.mask_model),
            length(seen),
            2 * len(np.unique(seen)),
            length(now * 2 + previous),
        ]
        cells.append(logit_bytes(codec.Coding(scene).contexts(), kept, before))
        lines.append(f"| {name} | " + " | ".join(f"{c:,.0f}" for c in cells) + " |")
    lines += ["", MASKS_NOTE]
    write_section("packing-masks", "Models of the masks that were tried", lines)


def logit_bytes(contexts: np.ndarray, kept: Int64, before: Int64) -> float:
    """Code length of masks whose logits a network of 32 hidden units, fitted to them, makes of the contexts [n, .], with a table by
    offset and count, bytes without the network."""
    torch.manual_seed(0)
    inputs, bits = torch.from_numpy(contexts.astype(np.float32) / 256), torch.from_numpy(kept.astype(np.float32))
    network = torch.nn.Sequential(
        torch.nn.Linear(inputs.shape[1], 32), torch.nn.ReLU(), torch.nn.Linear(32, kept.shape[1])
    )
    table = torch.nn.Parameter(torch.zeros(kept.shape[1], kept.shape[1]))
    columns, counts = torch.arange(kept.shape[1]), torch.from_numpy(before)
    optimiser = torch.optim.Adam([*network.parameters(), table], lr=0.01)
    nats = torch.zeros(())
    for _ in range(600):
        optimiser.zero_grad()
        nats = torch.nn.functional.binary_cross_entropy_with_logits(
            network(inputs) + table[columns, counts], bits, reduction="sum"
        )
        nats.backward()
        optimiser.step()
    return float(nats.detach()) / np.log(2) / 8


def garden(points: str) -> None:
    """The paper's size: anchors of a large scene, and rendering networks of random numbers on a grid of eight bits."""
    found = read_points(points)
    voxel = default_voxel(found.points)
    scene = fit(voxelise(found.points, found.colours, voxel), voxel=voxel, steps=FIT_STEPS).scene
    rng = np.random.default_rng(0)
    networks = {
        name: [
            (rng.normal(0, 0.2, w.shape).astype(np.float32), rng.normal(0, 0.2, b.shape).astype(np.float32))
            for w, b in layers
        ]
        if name in ("opacity", "covariance", "colour")
        else layers
        for name, layers in scene.networks.items()
    }
    scene = replace(scene, networks=quantise_rendering(networks, 8))
    rows, _ = coding_rows(scene, f"garden's points, {scene.anchor_count:,} anchors")
    lines = [
        f"`python benchmarks/packing.py garden --points {Path(points).name}`",
        "",
        f"{machine()} Coding networks and attributes after",
    ]
    lines[-1] += f" {FIT_STEPS} steps of `fit`; rendering networks of random numbers, 8 bits."
    write_section("packing-garden", "Positions and weights of a large scene", [*lines, "", *CODING_HEAD, *rows])


def main() -> None:
    """Runs one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("scenes", "masks", "garden"))
    parser.add_argument("--work", type=Path, default=Path("benchmark-runs"))
    parser.add_argument("--points")
    arguments = parser.parse_args()
    if arguments.part == "scenes":
        scenes(arguments.work)
    elif arguments.part == "masks":
        masks(arguments.work)
    elif arguments.points:
        garden(arguments.points)
    else:
        parser.error("garden needs --points")


if __name__ == "__main__":
    main()
