"""Training's figures: quality and size of real scenes, and the paper's comparisons.

python -m benchmarks.training scenes       both sets of photographs at 400 x 300, uncompressed and at four rates
python -m benchmarks.training hyperpriors  the rows of the paper's table of hyperpriors, at 200 x 150
python -m benchmarks.training sampling     USRO against ViSRO at four rates, at 200 x 150

Each writes its section of RESULTS.md. What is finished is kept in --work and not done again. --paper takes the paper's
steps and photographs of 1,600 pixels for the last two, and prints the section only.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import bjontegaard
import numpy as np

from refcodec.bitstream.batches import no_progress
from refcodec.evaluate.evaluation import evaluate
from refcodec.photographs.photographs import read_photographs
from refcodec.train.command import report
from refcodec.train.settings import PRESETS
from refcodec.train.settings_file import assigned, varied
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer

from .hyperpriors import HYPERPRIORS, rounded_scene
from .results import kb, machine, table, write_section
from .runs import EXAMPLES, HOW, JOBS, Run, keep, perform_all

# Steps of each training at 400 x 300, and at 200 x 150.
STEPS, SMALL_STEPS = 3000, 2000
SCENES_NOTE = """
lambda_r 0: Scaffold-GS of the same code and steps, uncompressed float32. KB are 10^3 bytes. The last columns but one
compare with it: the attributes, masks and planes with its attributes, the file with all of it. Weights are the cost
that does not depend on the scene's size. Features, scalings and offsets apart are code lengths, the other columns bytes
of the file."""
HYPERPRIOR_NOTE = """
P and A are code lengths with everything rounded; those hyperpriors but VM have no bitstream. PSNR is of rounded
attributes. There is one run of each: two runs of one setting differ by about 0.2 dB and 2 % of the bytes."""
SAMPLING_NOTE = """
There is one run of each on one scene. The differences in PSNR are partly those between any two runs, and a BD-rate
makes much of them."""


def scenes(work: Path) -> list[str]:
    """Quality and size of both scenes."""
    names, rates = ("caliterra", "snowmiku"), (0.0, 0.001, 0.004, 0.015)
    runs = [Run(scene, 400, rate, STEPS) for rate in rates for scene in names]
    results = dict(zip(runs, perform_all(runs, work), strict=True))
    one = next(run for run in runs if run.rate)
    lines = [
        f"`python -m benchmarks.training scenes`; one training: `{one.command}`",
        "",
        f"{machine('torch')} {HOW}",
        "",
    ]
    head = ["lambda_r", "PSNR", "change", "SSIM", "3DGS's PSNR / SSIM", "KB", "features / scalings / offsets", "masks"]
    head += ["planes", "positions", "weights", "anchors", "bits an anchor", "attributes, masks, planes", "file"]
    for scene in names:
        base = results[Run(scene, 400, 0.0, STEPS)]
        rows = [_scene_row(results[Run(scene, 400, rate, STEPS)], rate, base) for rate in rates]
        lines += [f"### {scene}, 400 x 300", "", *table([*head, "training, s"], rows), ""]
    sizes, shown = agreement([result for run, result in results.items() if run.rate])
    least, most = 100 * min(sizes), 100 * max(sizes)
    lines += [*SCENES_NOTE.splitlines()[1:], ""]
    lines += [
        f"Attributes and planes of these files are {least:+.2f} to {most:+.2f} % of what training had estimated at its",
        "end. PSNR of each held-out image, as the training draws its scene of integers and as `eval` draws the decoded",
        f"file in a process of its own, differs by {max(shown):.1g} dB at most.",
    ]
    return lines


def _scene_row(result: dict[str, Any], rate: float, base: dict[str, Any]) -> list[str]:
    shown, training, plain = result["eval"], result["training"], base["eval"]
    mean, parts, kinds = shown["mean"], shown["parts"], training["bytes"]
    apart = [kb(kinds[kind]) for kind in ("features", "scalings", "offsets")] if rate else [kb(parts["attributes"])]
    body = parts["attributes"] + parts.get("masks", 0) + parts.get("planes", 0)
    return [
        f"{rate:g}",
        f"{mean['psnr']:.2f}",
        f"{mean['psnr'] - plain['mean']['psnr']:+.2f}",
        f"{mean['ssim']:.4f}",
        f"{mean['psnr_3dgs']:.2f} / {mean['ssim_3dgs']:.4f}",
        kb(shown["bytes"]),
        " / ".join(apart),
        *(kb(parts.get(part, 0)) for part in ("masks", "planes", "positions", "weights")),
        f"{shown['anchors']:,}",
        f"{8 * body / shown['anchors']:.0f}",
        f"1/{plain['parts']['attributes'] / body:.1f}",
        f"1/{plain['bytes'] / shown['bytes']:.1f}",
        f"{training['seconds']:.0f}",
    ]


def agreement(results: list[dict[str, Any]]) -> tuple[list[float], list[float]]:
    """Of coded scenes: bytes of attributes and planes over the estimate, less one, and differences in PSNR.

    The differences are those between what the training drew of its scene of integers and what eval drew of the file.
    """
    sizes, shown = [], []
    for result in results:
        estimate, parts = result["training"]["bytes"], result["eval"]["parts"]
        sizes.append((parts["attributes"] + parts["planes"]) / (estimate["attributes"] + estimate["planes"]) - 1)
        quantised = result["training"]["quantised"]
        shown += [abs(quantised[row["image"]] - row["psnr_3dgs"]) for row in result["eval"]["images"]]
    return sizes, shown


# --- the paper's comparisons ------------------------------------------------------------------------------------------


def train_hyperprior(name: str, run: Run, paper: bool, work: Path) -> dict[str, Any]:
    """As runs.perform, with a hyperprior that no file can hold."""
    key = f"{name}-{run.name}"
    if (work / f"{key}.json").exists():
        return dict(json.loads((work / f"{key}.json").read_text()))
    photographs = read_photographs(EXAMPLES / run.scene, run.side)
    changes = {"rate.weight": run.rate, "steps": run.steps, "size": str(run.side)}
    settings = assigned(varied(_preset(paper), changes), run.changes)
    trainer, state = Trainer(photographs, settings, hyperprior=HYPERPRIORS[name]), work / f"{key}.train-state"
    if state.exists():
        restore(trainer, state)
    trainer.run(lambda _: None, lambda: save(trainer, state))
    scene = rounded_scene(trainer)
    shown = evaluate(scene, photographs, None, no_progress)
    return keep(key, work, {"training": report(trainer, scene), "eval": shown})


def _preset(paper: bool) -> Any:
    return PRESETS["paper" if paper else "fast"]


def _small(paper: bool, rate: float, changes: tuple[str, ...] = ()) -> Run:
    """A training of a comparison: of caliterra at 200 x 150, or at the paper's size."""
    if not paper:
        return Run("caliterra", 200, rate, SMALL_STEPS, changes)
    preset = _preset(paper)
    more = (f"start.least={preset.start.least}", f"growth.most={preset.growth.most}")
    return Run("caliterra", int(preset.size), rate, preset.steps, (*more, *changes))


def hyperpriors(work: Path, paper: bool) -> list[str]:
    """The rows of the paper's table."""
    every = ("rate.plane_period=1",)
    rows = [
        ("triplane, 72 channels", "", "triplane72", every, (27.3, 0.1, 19.2)),
        ("triplane, 72 channels", "yes", "triplane72", (), (27.5, 0.8, 18.4)),
        ("triplane, 8 channels", "yes", "triplane", (), (27.6, 0.5, 18.8)),
        ("VM, 8 channels", "yes", "", (), (27.6, 0.3, 18.8)),
        ("plane, 8 channels, no gamma", "yes", "plane", (), (27.4, 0.2, 20.0)),
    ]
    runs = [(name, _small(paper, 0.004, changes)) for _, _, name, changes, _ in rows]
    with ProcessPoolExecutor(JOBS, multiprocessing.get_context("spawn"), initializer=_one_thread) as pool:
        others = {pair: pool.submit(train_hyperprior, *pair, paper, work) for pair in runs if pair[0]}
        done = {pair: future.result() for pair, future in others.items()}
    done |= dict(zip([p for p in runs if not p[0]], perform_all([r for n, r in runs if not n], work), strict=True))
    head = ["hyperprior", "A-RDO", "PSNR", "P, KB", "A, KB", "P + A, KB", "training, s"]
    cells = []
    for (words, alternate, _, _, theirs), pair in zip(rows, runs, strict=True):
        size, result = done[pair]["training"]["bytes"], done[pair]
        both = size["planes"] + size["attributes"]
        figures = [f"{result['eval']['mean']['psnr']:.2f}", kb(size["planes"]), kb(size["attributes"]), kb(both)]
        cells.append([words, alternate, *figures, f"{result['training']['seconds']:.0f}", *map(str, theirs)])
    lines = ["`python -m benchmarks.training hyperpriors`", "", f"{machine('torch')} {HOW}", ""]
    lines += table([*head, "the paper (Amsterdam): PSNR", "P, MB", "A, MB"], cells)
    return [*lines, *HYPERPRIOR_NOTE.splitlines()]


def _one_thread() -> None:
    import numba  # noqa: PLC0415 (in the process that trains)
    import torch  # noqa: PLC0415

    torch.set_num_threads(1)
    numba.set_num_threads(1)


def sampling(work: Path, paper: bool) -> list[str]:
    """USRO against ViSRO."""
    rates = (0.002, 0.004, 0.01, 0.03)
    both = {
        name: [_small(paper, rate, changes) for rate in rates]
        for name, changes in (("USRO", ()), ("ViSRO", ("sampling.among=visible",)))
    }
    runs = [run for pair in zip(*both.values(), strict=True) for run in pair]
    results = dict(zip(runs, perform_all(runs, work), strict=True))
    rows = []
    curves: dict[str, list[tuple[float, float]]] = {name: [] for name in both}
    for run, result in results.items():
        name = "ViSRO" if run in both["ViSRO"] else "USRO"
        size, shown = result["training"]["bytes"], result["eval"]
        body = sum(shown["parts"][part] for part in ("attributes", "masks", "planes"))
        curves[name].append((float(body), float(shown["mean"]["psnr"])))
        figures = [f"{shown['mean']['psnr']:.2f}", kb(size["planes"]), kb(size["attributes"]), kb(shown["bytes"])]
        rows.append([f"{run.rate:g}", name, *figures, f"{shown['anchors']:,}", f"{result['training']['seconds']:.0f}"])
    columns = [np.array(sorted(curves[name])).T for name in ("ViSRO", "USRO")]
    points = [column for curve in columns for column in curve]
    saving = bjontegaard.bd_rate(*points, method="akima", require_matching_points=False, min_overlap=0)
    head = ["lambda_r", "sampling", "PSNR", "P, KB", "A, KB", "file, KB", "anchors", "training, s"]
    lines = ["`python -m benchmarks.training sampling`", "", f"{machine('torch')} {HOW}", "", *table(head, rows), ""]
    lines += [
        "BD-rate of USRO with ViSRO as anchor, by the bytes of attributes, masks and planes: "
        f"{saving:+.1f} % (the paper: -2.5 to -45.6 % by the set of scenes).",
    ]
    return [*lines, *SAMPLING_NOTE.splitlines()]


def main() -> None:
    """Runs one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("scenes", "hyperpriors", "sampling"))
    parser.add_argument("--work", type=Path, default=Path("benchmark-runs"))
    parser.add_argument("--paper", action="store_true")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    if arguments.part == "scenes":
        write_section("training-scenes", "Photographs to files", scenes(arguments.work))
        return
    title = {"hyperpriors": "Hyperpriors and A-RDO", "sampling": "USRO and ViSRO"}[arguments.part]
    lines = {"hyperpriors": hyperpriors, "sampling": sampling}[arguments.part](arguments.work, arguments.paper)
    if arguments.paper:
        print("\n".join(lines))
    else:
        write_section(f"training-{arguments.part}", title, lines)


if __name__ == "__main__":
    main()
