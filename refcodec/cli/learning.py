"""Commands that learn a scene or its entropy model: train, fit."""

# Modules that need NumPy are imported by the commands that use them, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from . import statuses
from .shared import (
    UsageError,
    add_command,
    check_output_folder,
    length,
    needs,
    note,
    positive,
    progress_bar,
    read_photographs_of,
    seed,
    weight,
)


def _train(arguments: argparse.Namespace) -> int:
    try:
        from ..train.command import PRESETS, may_write, state_path, train
        from ..train.trainer import TrainSettings
    except ModuleNotFoundError as error:
        raise needs("train", "train", error, ("torch", "numba", "scipy", "PIL", "skimage")) from None
    output = Path(arguments.output.rstrip("/") or "/")
    if not may_write(output):
        raise UsageError(f"{output} exists and is not a scene folder: choose another one, or empty it")
    if arguments.resume and not state_path(output).exists():
        raise UsageError(f"there is nothing to resume: {state_path(output)} does not exist")
    preset = PRESETS[arguments.preset]
    photographs = read_photographs_of(arguments.photographs, arguments.size or str(preset["side"]))
    settings = TrainSettings(
        rate=arguments.rate,
        steps=arguments.steps or preset["steps"],
        seed=arguments.seed,
        hyperprior=arguments.hyperprior,
        uniform=arguments.sampling == "uniform",
        plane_period=arguments.plane_period,
        masks=not arguments.no_masks,
        epsilon=arguments.epsilon,
        anchors=preset["anchors"],
        most_anchors=preset["most_anchors"],
    )
    try:
        trainer, whole = train(
            photographs,
            settings,
            output,
            threads=arguments.threads or os.cpu_count() or 1,
            device=arguments.device,
            resume=arguments.resume,
            progress=arguments.progress,
        )
    except ValueError as error:
        raise UsageError(f"{arguments.photographs} cannot be trained: {error}") from None
    print(f"{output}: {trainer.scaffold.count} anchors, {trainer.done} steps, {trainer.seconds:.0f} s")
    if not whole:
        note(
            f"refcodec: stopped at step {trainer.done} of {settings.steps}; the scene is written, and --resume goes on from there"
        )
        return statuses.INTERRUPTED
    return 0


def _fit(arguments: argparse.Namespace) -> int:
    from zipfile import BadZipFile

    from ..folder.ply import read_cloud
    from ..folder.write import write_folder

    try:
        from ..train.fit import fit
        from ..train.voxelise import default_voxel, read_points, short_mantissa, voxelise
    except ModuleNotFoundError as error:
        raise needs("fit", "fit", error, ("torch", "scipy")) from None
    check_output_folder(arguments.output)
    # Beside the folder, not in it: a scene folder is whole or it is not there.
    state = Path(f"{arguments.output.rstrip('/')}.fit-state")
    if arguments.resume and not state.exists():
        raise UsageError(f"there is nothing to resume: {state} does not exist")
    voxel = arguments.voxel and short_mantissa(arguments.voxel)
    try:
        if arguments.points.endswith(".ply"):
            cloud = read_cloud(arguments.points)
        else:
            found = read_points(arguments.points)
            voxel = voxel or default_voxel(found.points)
            cloud = voxelise(found.points, found.colours, voxel)
        if not arguments.resume:
            state.unlink(missing_ok=True)
        with progress_bar(arguments.progress) as progress:
            result = fit(cloud, voxel=voxel, steps=arguments.steps, seed=arguments.seed, progress=progress, state=state)
    # Of the npz files that cannot be read some are no archives, and some are cut.
    except (ValueError, BadZipFile, EOFError) as error:
        raise UsageError(f"{arguments.points} cannot be fitted: {error}") from None
    write_folder(result.scene, arguments.output)
    done, dropped = result.report["steps"], result.report["dropped"]
    print(f"{arguments.output}: {result.scene.anchor_count} anchors, {dropped} without offsets left out, {done} steps")
    # Ctrl-C ends the training, not the program.
    if done < arguments.steps and state.exists():
        note(
            f"refcodec: stopped at step {done} of {arguments.steps}; the scene is written, and --resume goes on from there"
        )
        return statuses.INTERRUPTED
    state.unlink(missing_ok=True)
    return 0


def add(commands: Any) -> None:
    """Adds the commands of this module."""
    train = add_command(
        commands,
        "train",
        _train,
        "learn a scene from photographs, and write a scene folder",
        [
            "train photographs -o scene",
            "train photographs -o scene --rate 0.01 --steps 8000",
            "train photographs -o scene --resume",
            "train photographs -o scaffold --rate 0",
        ],
        "PHOTOGRAPHS is a folder that COLMAP or a NeRF dataset made; every eighth image is held out. Then: refcodec encode SCENE_DIR.\n"
        "Ctrl-C ends the training early, writes the scene all the same, and keeps SCENE_DIR.train-state for --resume.\n"
        "Needs: pip install 'refcodec[train]'.",
    )
    train.add_argument("photographs", metavar="PHOTOGRAPHS")
    train.add_argument("-o", "--output", metavar="SCENE_DIR", required=True)
    train.add_argument(
        "--rate",
        type=weight,
        metavar="L",
        default=0.004,
        help="lambda_r, the weight of the rate: 0.002 to 0.04, or 0 for an uncompressed Scaffold-GS (default: %(default)s)",
    )
    train.add_argument("--steps", type=positive, metavar="N", help="training steps (default: the preset's)")
    train.add_argument(
        "--preset",
        choices=("fast", "paper"),
        default="fast",
        help="fast: 4,000 steps on photographs of 400 pixels; paper: 40,000 on 1,600 (default: %(default)s)",
    )
    train.add_argument(
        "--size", metavar="WxH", help="size that photographs are averaged down to, or their longest side"
    )
    train.add_argument("--seed", type=seed, metavar="S", default=0, help="of the random numbers (default: %(default)s)")
    train.add_argument(
        "--device",
        choices=("cpu", "cuda"),
        default="cpu",
        help="what rasterises; cuda needs pip install 'refcodec[cuda]'",
    )
    train.add_argument(
        "--threads", type=positive, metavar="N", help="of the rasteriser (default: all); no result depends on them"
    )
    train.add_argument(
        "--resume", action="store_true", help="go on with an interrupted training of the same photographs and settings"
    )
    paper = train.add_argument_group("what the paper compares")
    paper.add_argument(
        "--hyperprior",
        choices=("vm", "plane", "triplane", "triplane72"),
        default="vm",
        help="only vm can be written; the others are for estimates (default: %(default)s)",
    )
    paper.add_argument(
        "--sampling", choices=("uniform", "visible"), default="uniform", help="anchors whose rate counts: USRO or ViSRO"
    )
    paper.add_argument(
        "--plane-period", type=int, choices=(1, 4), default=4, help="steps between two with the planes' rate (A-RDO: 4)"
    )
    paper.add_argument("--no-masks", action="store_true", help="keep every offset")
    paper.add_argument(
        "--epsilon",
        type=length,
        metavar="E",
        default=0.01,
        help="share below which an offset is masked; 0.0004 where views are concentrated",
    )
    fit = add_command(
        commands,
        "fit",
        _fit,
        "fit an entropy model to points or to a trained scene, and write a scene folder",
        [
            "fit points3D.txt -o scene",
            "fit point_cloud.ply -o scene --steps 6000",
            "fit points3D.txt -o scene --resume",
        ],
        "POINTS is a COLMAP points3D.txt, an .npz with means3d and colors, or a Scaffold-GS, HAC or CAT-3DGS point_cloud.ply with\n"
        "10 offsets and 50 features. The rendering networks are simple ones that show coloured points. Ctrl-C ends the training\n"
        "early, writes the scene all the same, and keeps SCENE_DIR.fit-state for --resume. Needs: pip install 'refcodec[fit]'.",
    )
    fit.add_argument("points", metavar="POINTS")
    fit.add_argument("-o", "--output", metavar="SCENE_DIR", required=True)
    fit.add_argument("--steps", type=positive, metavar="N", default=4000, help="training steps (default: %(default)s)")
    fit.add_argument(
        "--voxel",
        type=length,
        metavar="V",
        help="edge of the anchors' lattice, in world units (default: median distance of the points; none for a .ply)",
    )
    fit.add_argument("--seed", type=seed, metavar="S", default=0, help="of the random numbers (default: %(default)s)")
    fit.add_argument("--resume", action="store_true", help="go on with an interrupted fit of the same points")
