"""What exactness costs, and what it gives: integers, positions, fitted scenes, and the same training again.

python -m benchmarks.exactness losses   what integer networks and fp16 positions cost, at 200 x 150
python -m benchmarks.exactness fit      what a trained scene shows and takes after fit, by the step of its offsets
python -m benchmarks.exactness same     twice the same seed, one and two threads, another unit, at 200 x 150

Each writes its section of RESULTS.md. Trainings are kept in --work and go on there.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import torch

from refcodec.bitstream.codec import emit
from refcodec.bitstream.scene import Scene
from refcodec.encoder.quantise import packed
from refcodec.evaluate.quality import measures
from refcodec.folder.uncompressed import Uncompressed, read_uncompressed, write_uncompressed
from refcodec.photographs.photographs import Photograph, PhotographSet, read_photographs
from refcodec.render.view import View
from refcodec.train.fit import fit
from refcodec.train.fit_input import read_given
from refcodec.train.settings import FitSettings, QuantisationSettings, TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.start import lattice_positions
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer

from .results import kb, machine, table, write_section
from .runs import EXAMPLES

NAME, SIZE = "caliterra", (200, 150)
# Steps of a training, of one that is repeated, and of a fit.
STEPS, SAME_STEPS, FIT_STEPS = 2000, 600, 1000
HOW = "One training at a time, one thread; every eighth image held out; PSNR by scikit-image of eight-bit images."


def trained(photographs: PhotographSet, rate: float, state: Path) -> Trainer:
    """A training that came to its end, from its saved state if there is one."""
    trainer = Trainer(photographs, varied(TrainSettings(), {"rate.weight": rate, "steps": STEPS}))
    if state.exists():
        restore(trainer, state)
    trainer.run(lambda _: None, lambda: save(trainer, state))
    save(trainer, state)
    return trainer


def losses(work: Path) -> list[str]:
    """What integer networks and fp16 positions cost, each alone."""
    photographs = read_photographs(EXAMPLES / NAME, SIZE)
    trainer = trained(photographs, 0.004, work / "losses.train-state")
    assert trainer.rate is not None

    def quality() -> float:
        drawn = [measures(trainer.views.draw(p.camera).numpy(), p.image)["psnr"] for p in photographs.test]
        return float(np.mean(drawn))

    found = []
    for integers in (False, True):
        trainer.rate.started().set_integers(integers)
        size = trainer.estimate()
        found.append((size["attributes"], size["planes"], quality()))
    (plain, _, before), (whole, _, base) = found
    changes = ["", f"{100 * (whole / plain - 1):+.2f} % of the attributes, {base - before:+.4f} dB"]
    networks = [
        [words, kb(attributes), kb(planes), f"{value:.4f}", change]
        for words, (attributes, planes, value), change in zip(("float32", "integer"), found, changes, strict=True)
    ]
    scaffold = trainer.scaffold
    units, lattice = scaffold.units, scaffold.lattice
    cell = units.cell * units.length
    world = units.origin + lattice * cell
    choices = {
        "fp16 of lattice cells (the format)": lattice_positions(lattice).astype(np.float64),
        "fp16 of world coordinates (the ancestors)": (world.astype(np.float16) - units.origin) / cell,
    }
    places = [["float64", f"{base:.4f}", "", ""]]
    for words, cells in choices.items():
        scaffold.position = torch.from_numpy((cells * units.cell).astype(np.float32))
        value = quality()
        places.append([words, f"{value:.4f}", f"{value - base:+.4f}", f"{np.abs(cells - lattice).max():.3g}"])
    lines = ["`python -m benchmarks.exactness losses`", "", f"{NAME}, {machine('torch')} {HOW}", ""]
    lines += table(["networks", "attributes, KB", "planes, KB", "PSNR", "change"], networks)
    lines += ["", *table(["positions", "PSNR", "change", "largest move, in cells"], places), ""]
    return [
        *lines,
        "Networks: the same weights with hidden activations, contexts, means, scales and step indices in float32, and",
        "rounded as the decoder has them. Positions: a cell is half of an initial voxel.",
    ]


def fitted(work: Path) -> list[str]:
    """What a trained, uncompressed scene shows and takes after fit."""
    photographs, folder = read_photographs(EXAMPLES / NAME, SIZE), work / "fit-plain"
    if not folder.exists():
        result = trained(photographs, 0.0, work / "fit.train-state").result()
        assert isinstance(result, Uncompressed)
        write_uncompressed(result, folder)
    plain, given = View(read_uncompressed(folder)), read_given(folder)
    before = [plain.draw(p.camera).clip(0, 1) for p in photographs.test]
    quality = np.mean([measures(a, p.image)["psnr"] for a, p in zip(before, photographs.test, strict=True)])
    rows = [["none: the scene as it was", f"{quality:.2f}", "", kb(sum(read_uncompressed(folder).sizes().values()))]]
    for step in (0.2, 0.1, 0.05, 0.025, 0.0125):
        settings = FitSettings(steps=FIT_STEPS, scene=QuantisationSettings(offsets=step))
        scene = packed(fit(given, settings).scene, None, None)
        after = [View(scene).draw(p.camera).clip(0, 1) for p in photographs.test]
        quality = np.mean([measures(b, p.image)["psnr"] for b, p in zip(after, photographs.test, strict=True)])
        error = np.mean([(a - b) ** 2 for a, b in zip(before, after, strict=True)])
        rows.append([f"{step:g}", f"{quality:.2f}", f"{-10 * np.log10(error):.2f}", kb(len(emit(scene)))])
    lines = ["`python -m benchmarks.exactness fit`", "", f"{NAME}, {machine('torch')} {HOW}", ""]
    lines += table(["step of offsets", "PSNR", "PSNR between both scenes' drawings", "KB"], rows)
    steps = FitSettings().scene
    return [
        *lines,
        "",
        f"{FIT_STEPS:,} steps of `fit` on {given.cloud.masks.shape[0]:,} anchors. Features have steps of "
        f"{steps.features:.3g} spreads and",
        f"scalings of {steps.scalings:g}. `refcodec fit` takes {steps.offsets:g} for a trained scene, "
        f"and {FitSettings().quantisation.offsets:g} for points.",
    ]


def same(_: Path) -> list[str]:
    """Seeds, threads and units."""
    photographs = read_photographs(EXAMPLES / NAME, SIZE)

    def moved(group: Sequence[Photograph], factor: float) -> tuple[Photograph, ...]:
        return tuple(replace(p, camera=replace(p.camera, translation=p.camera.translation * factor)) for p in group)

    def another_unit(factor: float) -> PhotographSet:
        train, test = (moved(group, factor) for group in (photographs.train, photographs.test))
        return replace(photographs, train=train, test=test, points=photographs.points * factor)

    cases = [
        ("seed 0, one thread", photographs, 0, 1),
        ("again", photographs, 0, 1),
        ("seed 0, two threads", photographs, 0, 2),
        ("seed 1", photographs, 1, 1),
        ("units of a hundredth", another_unit(100.0), 0, 1),
        ("units of a hundred", another_unit(0.01), 0, 1),
    ]
    rows = []
    for words, found, seed, threads in cases:
        numba.set_num_threads(threads)
        trainer = Trainer(found, varied(TrainSettings(), {"steps": SAME_STEPS, "seed": seed}))
        trainer.run(lambda _: None)
        scene = trainer.result()
        assert isinstance(scene, Scene)
        data, view = emit(scene), View(scene)
        value = float(np.mean([measures(view.draw(p.camera), p.image)["psnr"] for p in found.test]))
        digest = hashlib.sha256(data).hexdigest()[:16]
        rows.append([words, f"{value:.3f}", kb(len(data)), f"{scene.anchor_count:,}", digest])
        print(rows[-1], flush=True)
    lines = ["`python -m benchmarks.exactness same`", "", f"{NAME}, {machine('torch')} {HOW}", ""]
    lines += table(["caliterra, 200 x 150", "PSNR", "file, KB", "anchors", "SHA-256 of the file"], rows)
    return [
        *lines,
        "",
        "All of torch runs in one thread, and the rasteriser's sums have one order: the number of threads changes no",
        "bit. Another unit rounds differently, and so takes another path.",
    ]


PARTS = {
    "losses": (losses, "training-losses", "What exactness costs"),
    "fit": (fitted, "training-fit", "Fitting a trained scene"),
    "same": (same, "training-same", "The same again"),
}


def main() -> None:
    """Runs one part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--work", type=Path, default=Path("benchmark-runs"))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    run, name, title = PARTS[arguments.part]
    write_section(name, title, run(arguments.work))


if __name__ == "__main__":
    main()
