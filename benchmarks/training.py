"""Training's figures: quality and size of real scenes, the paper's comparisons, and what exactness costs.

python benchmarks/training.py scenes       both sets of photographs at 400 x 300, uncompressed and at four rates
python benchmarks/training.py hyperpriors  the rows of the paper's table of hyperpriors, at 200 x 150
python benchmarks/training.py sampling     USRO against ViSRO at four rates, at 200 x 150
python benchmarks/training.py losses       what integer networks and fp16 positions cost, on the scenes' files
python benchmarks/training.py same         twice the same seed, one and two threads, another unit, at 200 x 150
python benchmarks/training.py speed        beside the prototype (--prototype FOLDER), and where the time goes

Each writes its section of RESULTS.md. Trainings run two at a time, one thread each, as commands of refcodec; what is finished is kept in
--work and not done again.
"""

from __future__ import annotations

import argparse
import cProfile
import hashlib
import json
import os
import platform
import pstats
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from refcodec.bitstream.codec import emit
from refcodec.bitstream.scene import Scene
from refcodec.evaluate.quality import measures
from refcodec.photographs.photographs import Photograph, PhotographSet, read_photographs
from refcodec.render.view import View
from refcodec.train.scaffold import lattice_positions
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer, TrainSettings

from .results import write_section

EXAMPLES = Path(__file__).resolve().parent.parent / "examples" / "photographs"
ENVIRONMENT = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE", "NUMBA_NUM_THREADS": "1"}
JOBS = 2
# Steps of each training at 400 x 300, at 200 x 150, of those that are repeated there, and beside the prototype.
STEPS, SMALL_STEPS, SAME_STEPS, BESIDE_STEPS = 3000, 2000, 600, 1000
HYPERPRIOR_NOTE = (
    "One run of each, and two runs of one setting differ by about 0.2 dB and 2 % of the bytes. As in the paper: VM needs no more bytes than the triplane and trains in less than half of its time; "
    "without gamma A grows (by 1.7 %; 6 % in the paper); A-RDO saves time and does not hurt PSNR. Not as in the paper: without A-RDO the planes are larger here, not smaller; the cause is not known. "
    "In a scene of this size nearly all planes become zeros: P is about 1.5 % of A in either."
)
SAMPLING_NOTE = (
    "As in the paper, at every rate: USRO has fewer bytes and a higher PSNR. One run of each on one scene: sizes differ by 2 to 5 %, in the same direction four times; "
    "the differences in PSNR, 0.1 to 0.6 dB, are partly those between any two runs, and a BD-rate makes much of them."
)


@dataclass(frozen=True)
class Run:
    """One training: photographs, longest side in pixels, lambda_r, steps, and the other options of `refcodec train`."""

    scene: str
    side: int
    rate: float
    steps: int
    options: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """A name for its files."""
        return "-".join(
            [self.scene, str(self.side), f"{self.rate:g}", str(self.steps), *(o.strip("-") for o in self.options)]
        )

    @property
    def command(self) -> str:
        """What to type."""
        words = [
            "refcodec train",
            f"examples/photographs/{self.scene}",
            "-o SCENE",
            f"--size {self.side}",
            f"--rate {self.rate:g}",
        ]
        return " ".join([*words, f"--steps {self.steps}", *self.options])


def perform(run: Run, work: Path) -> dict[str, Any]:
    """Trains, encodes and evaluates; what training.json and eval say, with `coded`: whether there is a file."""
    found = work / f"{run.name}.json"
    if found.exists():
        return dict(json.loads(found.read_text()))
    folder, file, photographs = work / run.name, work / f"{run.name}.c3gs", str(EXAMPLES / run.scene)
    state = folder.with_name(folder.name + ".train-state")

    def refcodec(*words: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "refcodec", *words], env=ENVIRONMENT, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(f"{run.name}: {done.stderr}")
        return done.stdout

    options = [
        "--size",
        str(run.side),
        "--rate",
        f"{run.rate:g}",
        "--steps",
        str(run.steps),
        "--threads",
        "1",
        *run.options,
    ]
    refcodec("train", photographs, "-o", str(folder), *options, *(["--resume"] if state.exists() else []))
    coded = (folder / "scene.json").exists()
    if coded:
        refcodec("encode", str(folder), "-o", str(file))
    shown = json.loads(refcodec("eval", str(file if coded else folder), photographs, "--size", str(run.side), "--json"))
    result = {"training": json.loads((folder / "training.json").read_text()), "eval": shown, "coded": coded}
    found.write_text(json.dumps(result))
    print(f"{run.name}: {shown['mean']['psnr']:.2f} dB, {shown['bytes']} bytes", flush=True)
    return result


def perform_all(runs: Sequence[Run], work: Path) -> list[dict[str, Any]]:
    """Results of runs, two at a time."""
    with ThreadPoolExecutor(JOBS) as pool:
        return list(pool.map(lambda run: perform(run, work), runs))


def machine() -> str:
    """The line that says what measured."""
    return (
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}, torch {torch.__version__}. "
        "Two trainings at a time, one thread each; every eighth image held out; PSNR and SSIM by scikit-image of eight-bit images."
    )


def kb(value: float) -> str:
    """Bytes as 10^3 bytes."""
    return f"{value / 1000:.1f}"


def scenes(work: Path) -> None:
    """Item 1: quality and size of both scenes."""
    rates = (0.0, 0.001, 0.004, 0.015)
    runs = [Run(scene, 400, rate, STEPS) for rate in rates for scene in ("caliterra", "snowmiku")]
    results = dict(zip(runs, perform_all(runs, work), strict=True))
    lines = [f"`python benchmarks/training.py scenes`; one training: `{runs[2].command}`", "", machine(), ""]
    for scene in ("caliterra", "snowmiku"):
        base = results[replace(runs[0], scene=scene)]
        plain = base["eval"]["parts"]
        lines += [f"### {scene}, 400 x 300", ""]
        lines += [
            "| lambda_r | PSNR | change | SSIM | 3DGS's PSNR / SSIM | KB | features / scalings / offsets | masks | planes | positions | weights | anchors | bits an anchor | attributes, masks, planes | file | training, s |"
        ]
        lines += ["|" + "---|" * 16]
        for rate in rates:
            result = results[Run(scene, 400, rate, STEPS)]
            shown, training = result["eval"], result["training"]
            mean, parts, kinds = shown["mean"], shown["parts"], training["bytes"]
            change = mean["psnr"] - base["eval"]["mean"]["psnr"]
            three = (
                " / ".join(kb(kinds[k]) for k in ("features", "scalings", "offsets"))
                if rate
                else kb(parts["attributes"])
            )
            body = parts["attributes"] + parts.get("masks", 0) + parts.get("planes", 0)
            lines.append(
                f"| {rate:g} | {mean['psnr']:.2f} | {change:+.2f} | {mean['ssim']:.4f} | {mean['psnr_3dgs']:.2f} / {mean['ssim_3dgs']:.4f} | {kb(shown['bytes'])} "
                f"| {three} | {kb(parts.get('masks', 0))} | {kb(parts.get('planes', 0))} | {kb(parts['positions'])} | {kb(parts['weights'])} | {shown['anchors']:,} "
                f"| {8 * body / shown['anchors']:.0f} | 1/{plain['attributes'] / body:.1f} | 1/{base['eval']['bytes'] / shown['bytes']:.1f} | {training['seconds']:.0f} |"
            )
        lines.append("")
    lines += [
        "lambda_r 0: Scaffold-GS of the same code and steps, uncompressed float32. KB are 10^3 bytes. The last columns but one compare with it: the attributes, masks and planes with its",
        "attributes, the file with all of it. Weights (fp32 networks) are the cost that does not depend on the scene's size. Features, scalings and offsets apart are code lengths, the other columns bytes of the file.",
    ]
    sizes, shown = agreement([result for run, result in results.items() if run.rate])
    lines += [
        "",
        f"Attributes and planes of these files are {100 * min(sizes):+.2f} to {100 * max(sizes):+.2f} % of what training had estimated at its end. PSNR of each held-out image, as the training draws its scene of integers",
        f"and as `eval` draws the decoded file in a process of its own, differs by {max(shown):.1g} dB at most.",
    ]
    write_section("training-scenes", "Photographs to files", lines)


def agreement(results: list[dict[str, Any]]) -> tuple[list[float], list[float]]:
    """Of coded scenes: bytes of attributes and planes over the estimate, less one; differences in PSNR between training and file."""
    sizes, shown = [], []
    for result in results:
        estimate, parts = result["training"]["bytes"], result["eval"]["parts"]
        sizes.append((parts["attributes"] + parts["planes"]) / (estimate["attributes"] + estimate["planes"]) - 1)
        quantised = result["training"]["quantised"]
        shown += [abs(quantised[row["image"]] - row["psnr_3dgs"]) for row in result["eval"]["images"]]
    return sizes, shown


def hyperpriors(work: Path) -> None:
    """Item 6: the rows of the paper's table."""
    rows = [
        ("triplane, 72 channels", "", ("--hyperprior", "triplane72", "--plane-period", "1")),
        ("triplane, 72 channels", "yes", ("--hyperprior", "triplane72")),
        ("triplane, 8 channels", "yes", ("--hyperprior", "triplane")),
        ("VM, 8 channels", "yes", ()),
        ("plane, 8 channels, no gamma", "yes", ("--hyperprior", "plane")),
    ]
    paper = [(27.3, 0.1, 19.2), (27.5, 0.8, 18.4), (27.6, 0.5, 18.8), (27.6, 0.3, 18.8), (27.4, 0.2, 20.0)]
    runs = [Run("caliterra", 200, 0.004, SMALL_STEPS, options) for _, _, options in rows]
    results = perform_all(runs, work)
    lines = ["`python benchmarks/training.py hyperpriors`", "", machine(), ""]
    lines += [
        "| hyperprior | A-RDO | PSNR | P, KB | A, KB | P + A, KB | training, s | the paper (Amsterdam): PSNR | P, MB | A, MB |",
        "|" + "---|" * 10,
    ]
    for (name, alternate, _), result, (psnr, planes, attributes) in zip(rows, results, paper, strict=True):
        size = result["training"]["bytes"]
        lines.append(
            f"| {name} | {alternate} | {result['eval']['mean']['psnr']:.2f} | {kb(size['planes'])} | {kb(size['attributes'])} "
            f"| {kb(size['planes'] + size['attributes'])} | {result['training']['seconds']:.0f} | {psnr} | {planes} | {attributes} |"
        )
    lines += [
        "",
        "P and A are code lengths with everything rounded; those hyperpriors but VM have no bitstream. PSNR is of rounded attributes.",
        "",
        HYPERPRIOR_NOTE,
        "",
    ]
    lines += (
        ["At full size:", "", "```sh"]
        + [replace(run, steps=40000).command.replace("--size 200", "--preset paper") for run in runs]
        + ["```"]
    )
    write_section("training-hyperpriors", "Hyperpriors and A-RDO", lines)


def sampling(work: Path) -> None:
    """Item 6: USRO against ViSRO."""
    import bjontegaard  # noqa: PLC0415 (only here)

    rates = (0.002, 0.004, 0.01, 0.03)
    both = {
        name: [Run(scene, 200, rate, SMALL_STEPS, options) for rate in rates for scene in ("caliterra",)]
        for name, options in (("USRO", ()), ("ViSRO", ("--sampling", "visible")))
    }
    results = dict(
        zip(both, np.array_split(np.array(perform_all([*both["USRO"], *both["ViSRO"]], work), object), 2), strict=True)
    )
    lines = [
        "`python benchmarks/training.py sampling`",
        "",
        machine(),
        "",
        "| lambda_r | sampling | PSNR | P, KB | A, KB | file, KB | anchors | training, s |",
        "|" + "---|" * 8,
    ]
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for i, rate in enumerate(rates):
        for name in both:
            result = results[name][i]
            size, shown = result["training"]["bytes"], result["eval"]
            body = sum(shown["parts"][part] for part in ("attributes", "masks", "planes"))
            curve = curves.setdefault(name, ([], []))
            curve[0].append(float(body))
            curve[1].append(float(shown["mean"]["psnr"]))
            lines.append(
                f"| {rate:g} | {name} | {shown['mean']['psnr']:.2f} | {kb(size['planes'])} | {kb(size['attributes'])} | {kb(shown['bytes'])} "
                f"| {shown['anchors']:,} | {result['training']['seconds']:.0f} |"
            )
    order = {name: np.argsort(curve[0]) for name, curve in curves.items()}
    sorted_curves = [[np.array(values)[order[name]] for values in curves[name]] for name in ("ViSRO", "USRO")]
    (r1, d1), (r2, d2) = sorted_curves
    saving = bjontegaard.bd_rate(r1, d1, r2, d2, method="akima", require_matching_points=False, min_overlap=0)
    lines += [
        "",
        f"BD-rate of USRO with ViSRO as anchor, by the bytes of attributes, masks and planes: {saving:+.1f} % (the paper: -2.5 to -45.6 % by the set of scenes).",
        "",
        SAMPLING_NOTE,
        "",
    ]
    full = [
        replace(run, steps=40000).command.replace("--size 200", "--preset paper")
        for runs in both.values()
        for run in runs[:1]
    ]
    lines += ["At full size, for each rate:", "", "```sh", *full, "```"]
    write_section("training-sampling", "USRO and ViSRO", lines)


def losses(work: Path) -> None:
    """Item 3: integer networks, and fp16 positions, each alone."""
    torch.set_num_threads(1)
    lines = ["`python benchmarks/training.py losses`", "", machine(), ""]
    lines += ["| scene | networks | attributes, KB | planes, KB | PSNR | change |", "|" + "---|" * 6]
    places = ["| scene | positions | PSNR | change | largest move, in cells |", "|" + "---|" * 5]
    for name in ("caliterra",):
        photographs = read_photographs(EXAMPLES / name, (200, 150))
        trainer = Trainer(photographs, TrainSettings(rate=0.004, steps=SMALL_STEPS))
        state = work / f"losses-{name}.train-state"
        if state.exists():
            restore(trainer, state)
        trainer.run(lambda _: None, state)
        save(trainer, state)
        assert trainer.rate is not None

        def quality(trainer: Trainer = trainer, photographs: PhotographSet = photographs) -> float:
            return float(np.mean([measures(trainer.draw(p.camera).numpy(), p.image)["psnr"] for p in photographs.test]))

        found = []
        for integers in (False, True):
            trainer.rate.rounding(integers)
            size = trainer.estimate()
            found.append((size["attributes"], size["planes"], quality()))
        for words, (attributes, planes, value) in zip(("float32", "integer"), found, strict=True):
            change = (
                f"{100 * (attributes / found[0][0] - 1):+.2f} % of the attributes, {value - found[0][2]:+.4f} dB"
                if words == "integer"
                else ""
            )
            lines.append(f"| {name} | {words} | {kb(attributes)} | {kb(planes)} | {value:.4f} | {change} |")
        scaffold, lattice, position = trainer.scaffold, trainer.scaffold.lattice, trainer.scaffold.position
        units = scaffold.units
        world = units.origin + lattice * (units.cell * units.length)
        base = found[1][2]
        choices = {
            "fp16 of lattice cells (the format)": lattice_positions(lattice).astype(np.float64),
            "fp16 of world coordinates (the ancestors)": (world.astype(np.float16).astype(np.float64) - units.origin)
            / (units.cell * units.length),
        }
        places.append(f"| {name} | float64 | {base:.4f} | | |")
        for words, cells in choices.items():
            scaffold.position = torch.from_numpy((cells * units.cell).astype(np.float32))
            value = quality()
            places.append(
                f"| {name} | {words} | {value:.4f} | {value - base:+.4f} | {np.abs(cells - lattice).max():.3g} |"
            )
        scaffold.position = position
    lines += ["", *places, ""]
    lines += [
        "Networks: the same weights with hidden activations, contexts, means, scales and step indices in float32, and rounded as the decoder has them. Positions: a cell is half of an initial voxel."
    ]
    write_section("training-losses", "What exactness costs", lines)


def same(work: Path) -> None:
    """Item 5: seeds, threads and units."""
    torch.set_num_threads(1)
    photographs = read_photographs(EXAMPLES / "caliterra", (200, 150))

    def moved(group: Sequence[Photograph], factor: float) -> tuple[Photograph, ...]:
        return tuple(replace(p, camera=replace(p.camera, translation=p.camera.translation * factor)) for p in group)

    def another_unit(factor: float) -> PhotographSet:
        return replace(
            photographs,
            train=moved(photographs.train, factor),
            test=moved(photographs.test, factor),
            points=photographs.points * factor,
        )

    cases = [
        ("seed 0, one thread", photographs, 0, 1),
        ("again", photographs, 0, 1),
        ("seed 0, two threads", photographs, 0, 2),
    ]
    cases += [
        ("seed 1", photographs, 1, 1),
        ("units of a hundredth", another_unit(100.0), 0, 1),
        ("units of a hundred", another_unit(0.01), 0, 1),
    ]
    lines = [
        "`python benchmarks/training.py same`",
        "",
        machine().replace("Two trainings at a time, one thread each", "One training at a time"),
        "",
    ]
    lines += ["| caliterra, 200 x 150 | PSNR | file, KB | anchors | SHA-256 of the file |", "|" + "---|" * 5]
    for words, found, seed, threads in cases:
        numba.set_num_threads(threads)
        trainer = Trainer(found, TrainSettings(rate=0.004, steps=SAME_STEPS, seed=seed))
        trainer.run(lambda _: None)
        scene = trainer.result()
        assert isinstance(scene, Scene)
        data = emit(scene)
        view = View(scene)
        value = float(np.mean([measures(view.draw(p.camera), p.image)["psnr"] for p in found.test]))
        lines.append(
            f"| {words} | {value:.3f} | {kb(len(data))} | {scene.anchor_count:,} | {hashlib.sha256(data).hexdigest()[:16]} |"
        )
        print(lines[-1], flush=True)
    lines += [
        "",
        "All of torch runs in one thread, and the rasteriser's sums have one order: the number of threads changes no bit. Another unit rounds differently, and so takes another path.",
    ]
    write_section("training-same", "The same again", lines)


# Parts of a step, and what of the profile belongs to them.
PARTS = {
    "rasteriser, forward": ("_project", "_sort", "_list", "_blend"),
    "rasteriser, backward": ("_unblend", "_unproject"),
    "SSIM": ("ssim.py",),
    "anchors to Gaussians": ("spawn.py",),
    "Adam": ("adam.py", "/adam.py"),
    "torch, backward": ("run_backward",),
    "torch, products": ("linear",),
}


def speed(work: Path, prototype: Path | None) -> None:
    """Item 4: beside the prototype, and where the time goes."""
    lines = ["`python benchmarks/training.py speed --prototype FOLDER`", "", machine(), ""]
    if prototype:
        lines += [
            "One after the other, one thread each, uncompressed, the prototype with the minutes that this code took:",
            "",
            "| photographs | | minutes | steps | anchors | PSNR | memory, MiB |",
            "|" + "---|" * 7,
        ]
        for name, folder in (("snowmiku", "snowmiku_plush"), ("caliterra", "caliterra_aerial")):
            lines += beside(work, prototype, name, folder)
        lines.append("")
    lines += profile()
    write_section("training-speed", "Speed of training", lines)


def beside(work: Path, prototype: Path, name: str, folder: str) -> list[str]:
    """Rows of this code, and of the prototype with the minutes that this code took."""
    output, photographs, size = work / f"beside-{name}", str(EXAMPLES / name), ("--size", "400")
    steps = ("--steps", str(BESIDE_STEPS), "--rate", "0", "--threads", "1")
    ours = subprocess.Popen(
        [sys.executable, "-m", "refcodec", "train", photographs, "-o", str(output), *size, *steps], env=ENVIRONMENT
    )
    peak = os.wait4(ours.pid, 0)[2].ru_maxrss / 1024
    facts = json.loads((output / "training.json").read_text())
    words = ["--data", str(prototype.parent / "data" / folder), "--threads", "1", "--grow", "100", "--down", "1"]
    words += ["--minutes", f"{facts['seconds'] / 60:.3f}", "--evalat", "1"]
    theirs = subprocess.run(
        [sys.executable, "train.py", *words], cwd=prototype, env=ENVIRONMENT, capture_output=True, text=True, check=True
    )
    shown = subprocess.run(
        [sys.executable, "-m", "refcodec", "eval", str(output), photographs, *size, "--json"],
        env=ENVIRONMENT,
        capture_output=True,
        check=True,
    )
    value = json.loads(shown.stdout)["mean"]["psnr_3dgs"]
    rows = [
        f"| {name}, 400 x 300 | this code | {facts['seconds'] / 60:.2f} | {facts['steps']} "
        f"| {facts['anchors']:,} | {value:.2f} | {peak:.0f} |"
    ]
    for line in theirs.stdout.splitlines():
        if line.startswith("END"):
            found = line.split()
            at = {word: found[i + 1] for i, word in enumerate(found[:-1])}
            memory = float(at["rss"]) * 1e9 / 2**20
            rows.append(
                f"| | prototype | {at['t']} | {at['step']} | {int(at['anchors']):,} | {float(at['PSNR']):.2f} | {memory:.0f} |"
            )
    print("\n".join(rows), flush=True)
    return rows


def profile() -> list[str]:
    """Where the time of a step goes, with and without a rate."""
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    lines = [
        "Milliseconds of a step, caliterra, one thread, mean of 100 steps:",
        "",
        "| size | phase | step | " + " | ".join(PARTS) + " | the rest |",
        "|" + "---|" * (len(PARTS) + 4),
    ]
    for side in (200, 400):
        photographs = read_photographs(EXAMPLES / "caliterra", (side, side * 3 // 4))
        for words, rate, begin in (("anchors alone", 0.0, 0), ("with the rate", 0.004, 0.5)):
            trainer = Trainer(photographs, TrainSettings(rate=rate, steps=1000))
            for _ in range(60):
                trainer.step()
            trainer.done += int(begin * 1000)
            for _ in range(20):
                trainer.step()
            profiler = cProfile.Profile()
            profiler.enable()
            for _ in range(100):
                trainer.step()
            profiler.disable()
            spent = dict.fromkeys(PARTS, 0.0)
            total = 0.0
            for (file, _, function), (_, _, own, _, _) in getattr(pstats.Stats(profiler), "stats").items():
                total += own
                for name, marks in PARTS.items():
                    if any(
                        mark == function
                        or file.endswith(mark)
                        or (mark in function and mark in ("run_backward", "linear"))
                        for mark in marks
                    ):
                        spent[name] += own
                        break
            cells = " | ".join(f"{10 * value:.1f}" for value in spent.values())
            lines.append(
                f"| {side} x {side * 3 // 4} | {words} | {10 * total:.1f} | {cells} | {10 * (total - sum(spent.values())):.1f} |"
            )
    return lines


def main() -> None:
    """Runs one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("scenes", "hyperpriors", "sampling", "losses", "same", "speed"))
    parser.add_argument("--work", type=Path, default=Path("benchmark-runs"))
    parser.add_argument("--prototype", type=Path)
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    if arguments.part == "speed":
        speed(arguments.work, arguments.prototype)
    else:
        {"scenes": scenes, "hyperpriors": hyperpriors, "sampling": sampling, "losses": losses, "same": same}[
            arguments.part
        ](arguments.work)


if __name__ == "__main__":
    main()
