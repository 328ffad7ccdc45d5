"""Commands that learn a scene or its entropy model: train, fit."""

# Modules that need NumPy are imported by the commands that use them, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import statuses
from ..files.lock import hold_file
from ..files.outputs import Kind, check_apart
from ..files.present import NotAFileError, is_there
from ..files.terminal import note, say
from . import train_options
from .meta import add_meta, metadata_of, with_entries
from .shared import (
    PHOTOGRAPHS,
    UsageError,
    add_command,
    check_scene_output,
    fit_rate,
    length,
    needs,
    note_compiling,
    positive,
    progress_bar,
    read_photographs_of,
    seed,
    weight,
)

if TYPE_CHECKING:
    from ..train.fit_input import Given
    from ..train.settings import FitSettings, TrainSettings


# A saved training is a safetensors file with notes.
STATE = Kind(
    "the saved state of a training",
    re.compile(rb'.{8}\{"__metadata__":\{"(format|of|sha256|values|version)":"', re.DOTALL),
)
REPORT = Kind("the report of a training", re.compile(rb'\{\n "settings": '))


def _folder(text: str) -> Path:
    """Returns the path of a folder with a name, beside which a state can be saved. Raises UsageError for the root."""
    path = Path(text)
    if path.name in ("", ".."):
        path = Path(os.path.abspath(path))
    if not path.name:
        raise UsageError(f"{path} is not a scene folder: choose another one")
    return path


def _lock(state: Path) -> Path:
    """Returns the lock file that a run holds while it trains, so that no other run trains into the same folder."""
    return state.with_name(state.name + ".lock")


def _settings(arguments: argparse.Namespace) -> TrainSettings:
    """Returns a preset, changed by a settings file, by --set, and by options for single settings."""
    from ..train.settings import PRESETS
    from ..train.settings_file import SettingsError, from_toml

    base = PRESETS[arguments.preset]
    try:
        if arguments.settings:
            base = from_toml(Path(arguments.settings), base)
    except SettingsError as error:
        raise UsageError(str(error)) from None
    own = {
        "rate.lambda_r": arguments.lambda_r,
        "steps": arguments.steps,
        "size": arguments.size,
        "seed": arguments.seed,
    }
    chosen = train_options.settings(arguments, base, own)
    if chosen.static and arguments.start:
        raise UsageError("--from continues a view-dependent scene: omit --static")
    return chosen


def _interrupted(done: int, steps: int, state: Path) -> int:
    kept = os.path.lexists(state)
    advice = "--resume continues from the saved state" if kept else "there is no saved state to continue from"
    note(f"refcodec: stopped at step {done} of {steps}; the scene is written, and {advice}")
    return statuses.INTERRUPTED


def _check_state(state: Path, resume: bool, advice: str = "") -> None:
    """Raises UsageError if a saved state to resume is missing, or if one would be lost.

    advice: added to the message on a missing state. Raises OSError if the state cannot be looked up.
    """
    try:
        if resume and not is_there(state):
            raise UsageError(f"there is nothing to resume: {state} does not exist{advice}")
    except NotAFileError as error:
        raise UsageError(f"there is nothing to resume: {state}: {error}") from None
    if not resume and os.path.lexists(state):
        raise UsageError(
            f"{state} is the saved state of a training into the same folder: continue it with --resume, or remove it"
        )


def _check_writable(output: Path) -> None:
    """Raises UsageError if a result cannot be written to a folder. Called before any work."""
    there = next(path for path in (output, *output.absolute().parents) if path.exists())
    if not os.access(there, os.W_OK | os.X_OK):
        raise UsageError(f"{output} cannot be written: {there} is read-only; choose another folder")


def _given(folder: str | None) -> Given | None:
    """Returns the scene to continue from, or None. Raises UsageError if it is not a scene folder."""
    from ..train.fit_input import read_given

    if folder is None:
        return None
    if not Path(folder).is_dir():
        raise UsageError(f"{folder} is not a scene folder: training can continue only from one")
    try:
        return read_given(folder)
    except ValueError as error:
        raise UsageError(f"cannot continue training from {folder}: {error}") from None


def _train(arguments: argparse.Namespace) -> int:
    settings = _settings(arguments)
    if arguments.print_settings:
        from ..train.settings_file import to_toml

        print(to_toml(settings), end="")
        return 0
    if arguments.photographs is None or arguments.output is None:
        raise UsageError("train needs PHOTOGRAPHS and -o SCENE_DIR")
    from ..bitstream.networks import BoundError
    from ..folder.layout import scene_files

    try:
        from ..folder.layout import REPORT_FILE
        from ..train.command import state_path, train
        from ..train.continued import BeginningError
        from ..train.log import check_log, open_log
        from ..train.messages import closing
        from ..train.state import StateError
    except ModuleNotFoundError as error:
        raise needs("train", "train", error, ("torch", "numba", "scipy", "PIL", "skimage")) from None
    entries = metadata_of(arguments)
    if entries and not settings.rate.lambda_r:
        raise UsageError("an uncompressed scene, as trained with rate 0, has no metadata: omit --meta")
    output = _folder(arguments.output)
    state = state_path(output)
    others = [(state, STATE), (output / REPORT_FILE, REPORT)]
    log = Path(arguments.log) if arguments.log else None
    logged = [] if log is None else [check_log(log)]
    check_scene_output(output, [arguments.settings, arguments.start], uncompressed=True, others=others)
    _check_state(state, arguments.resume, "; a completed training keeps it only with --keep-state")
    _check_writable(output)
    photographs = read_photographs_of(arguments.photographs, settings.size, settings.background, settings.holdout)
    check_scene_output(output, photographs.places(), uncompressed=True)
    check_apart([*scene_files(output), state, output / REPORT_FILE, *logged], photographs.places())
    given = _given(arguments.start)
    note_compiling()
    try:
        rows = None if log is None else open_log(log)
    except ModuleNotFoundError as error:
        raise needs("train --log DIR", "tensorboard", error, ("tensorboard",)) from None
    try:
        with hold_file(_lock(state)):
            result = train(
                photographs,
                settings,
                output,
                threads=arguments.threads or os.cpu_count() or 1,
                device=arguments.device,
                resume=arguments.resume,
                progress=arguments.progress,
                keep_state=arguments.keep_state,
                log=rows,
                metadata=entries,
                given=given,
                up_axis=train_options.up_axis(arguments),
            )
    except StateError as error:
        raise UsageError(str(error)) from None
    except BeginningError as error:
        raise UsageError(f"{arguments.start} cannot be continued: {error}") from None
    except BoundError as error:
        # The photographs are not at fault for networks that a file cannot hold.
        raise UsageError(f"{arguments.start or output} cannot be coded: {error}") from None
    except ValueError as error:
        raise UsageError(f"{arguments.photographs} cannot be trained: {error}") from None
    for line in closing(result.trainer, result.report, output, arguments.photographs):
        say(line)
    return 0 if result.whole else _interrupted(result.trainer.clock.done, settings.steps, state)


def _fit_settings(arguments: argparse.Namespace) -> FitSettings:
    """Returns the settings of a fit. Raises UsageError."""
    from ..train.settings import FitSettings
    from ..train.settings_file import SettingsError, assigned

    try:
        return assigned(
            FitSettings(steps=arguments.steps, seed=arguments.seed, lambda_r=arguments.lambda_r), arguments.set
        )
    except SettingsError as error:
        raise UsageError(str(error)) from None


def _fit(arguments: argparse.Namespace) -> int:
    from zipfile import BadZipFile

    from ..folder.layout import scene_files
    from ..folder.write import write_folder

    try:
        from ..train.fit import fit
        from ..train.fit_input import read_given
        from ..train.state import StateError, write_somewhere
    except ModuleNotFoundError as error:
        raise needs("fit", "fit", error, ("torch", "numba", "scipy")) from None
    output, points = _folder(arguments.output), Path(arguments.points)
    _check_writable(output)
    # Beside the folder, not in it: a scene folder is complete or absent.
    state = output.with_name(output.name + ".fit-state")
    # The point cloud of a scene is read with the rest of the scene.
    inputs = [points, *(scene_files(points.parent) if points.suffix == ".ply" else [])]
    check_scene_output(output, inputs, others=[(state, STATE)])
    _check_state(state, arguments.resume)
    settings = _fit_settings(arguments)
    entries = metadata_of(arguments)
    try:
        given = read_given(arguments.points, arguments.voxel)
        with hold_file(_lock(state)):
            with progress_bar(arguments.progress) as progress:
                result = fit(given, settings, progress=progress, state=state)
            scene = with_entries(result.scene, entries)
            write_somewhere(lambda folder: write_folder(scene, folder), output, state)
            done, dropped = result.report["steps"], result.report["dropped"]
            # Ctrl-C ends the training, not the program.
            stopped = done < settings.steps and bool(result.scene.anchor_count)
            if not stopped:
                with contextlib.suppress(OSError):
                    state.unlink(missing_ok=True)
    except ModuleNotFoundError as error:
        raise needs("fit of points", "fit", error, ("PIL",)) from None
    except StateError as error:
        raise UsageError(str(error)) from None
    # An unreadable npz file may be truncated, or not an archive.
    except (ValueError, BadZipFile, EOFError) as error:
        raise UsageError(f"{arguments.points} cannot be fitted: {error}") from None
    say(f"{arguments.output}: {result.scene.anchor_count} anchors, {dropped} without offsets dropped, {done} steps")
    return _interrupted(done, settings.steps, state) if stopped else 0


def add(commands: Any) -> None:
    """Adds the commands of this module."""
    train = add_command(
        commands,
        "train",
        _train,
        "learn a scene from photographs, and write a scene folder",
        [
            "train photographs -o scene",
            "train photographs -o scene --lambda 0.01 --steps 8000",
            "train photographs -o scene --resume",
            "train photographs -o better --from converted --lambda 0.002",
            "train photographs -o scene --anchors 20000 --background white --holdout 0",
            "train photographs -o scene --resume --steps 12000",
            "train photographs -o scene --log scene.csv",
            "train photographs -o scene --static",
            "train photographs -o scaffold --lambda 0",
            "train photographs -o scene --set masks.epsilon=0.0004 --set growth.most=60000",
            "train --preset paper --print-settings > settings.toml",
            "train photographs -o scene --settings settings.toml",
        ],
        "PHOTOGRAPHS is a COLMAP or NeRF folder; every eighth image is held out. refcodec encode and eval read\n"
        "SCENE_DIR. Its training.json has the settings and a report of the training.\n"
        "Training starts with an anchor in each voxel that has points. --voxel or --anchors sets the voxel size.\n"
        "For a NeRF folder without points, points are drawn at random: in the visual hull of transparent photographs,\n"
        "or else in a cube. Anchors grow until 40 % of the steps, when the rate enters the loss. The setting\n"
        "growth.most is their maximum: 40,000 in the preset fast.\n"
        "Ctrl-C ends the training early, still writes the scene, and keeps SCENE_DIR.train-state for --resume.\n"
        "While such a state exists, a training without --resume does not start: use --resume, or remove the state.\n"
        "--resume --steps N with more steps than before extends a training. The rest of its schedule is stretched\n"
        "over the remaining steps: completed phases are not repeated, and learning rates continue from their values.\n"
        "A completed training continues in its last phase, if it was trained with --keep-state.\n"
        "Needs: pip install 'refcodec[train]'.",
        writes=True,
        parents=[train_options.parser()],
    )
    train.add_argument("photographs", metavar="PHOTOGRAPHS", nargs="?", help=PHOTOGRAPHS)
    train.add_argument("-o", "--output", metavar="SCENE_DIR", help="the scene folder to write")
    train.add_argument(
        "--preset",
        choices=("fast", "paper"),
        default="fast",
        help="fast: 4,000 steps, photographs of 400 pixels, about 5,000 anchors at first, or more with random points; "
        "paper: 40,000 steps, 1,600 pixels, the median distance of neighbouring points as voxel size (default: "
        "%(default)s)",
    )
    train.add_argument(
        "--settings", metavar="FILE", help="settings that replace those of the preset, in the form of --print-settings"
    )
    train.add_argument("--print-settings", action="store_true", help="print all settings with their meanings, and exit")
    train.add_argument(
        "--from",
        dest="start",
        metavar="SCENE_DIR",
        help="continue from a scene, such as one of convert, with its anchors, networks and features; none grow",
    )
    train.add_argument(
        "--lambda",
        dest="lambda_r",
        type=weight,
        metavar="L",
        help="lambda_r, the weight of the rate: usually 0.002 to 0.04, or 0 for an uncompressed Scaffold-GS (default: "
        "0.004)",
    )
    train.add_argument("--steps", type=positive, metavar="N", help="training steps (default: the preset's)")
    train.add_argument(
        "--size", metavar="WxH", help="size to which photographs are averaged down, longest side, or full for unscaled"
    )
    train.add_argument("--seed", type=seed, metavar="S", help="random seed (default: 0)")
    train.add_argument(
        "--device",
        choices=("cpu", "cuda"),
        default="cpu",
        help="device of the training (default: cpu); cuda needs pip install 'refcodec[cuda]'",
    )
    train.add_argument(
        "--threads",
        type=positive,
        metavar="N",
        help="threads of the rasteriser (default: all); results do not depend on it",
    )
    add_meta(train)
    train.add_argument(
        "--resume",
        action="store_true",
        help="continue a saved training of the same photographs and settings; --steps may be more than before",
    )
    train.add_argument(
        "--keep-state",
        action="store_true",
        help="keep SCENE_DIR.train-state after the end, so that --resume --steps N can extend the training",
    )
    train.add_argument(
        "--log",
        metavar="FILE.csv|DIR",
        help="write a row for each evaluation on held-out photographs: step, seconds, PSNR, anchors, bytes by part, "
        "phase; a folder is for TensorBoard and needs pip install 'refcodec[tensorboard]'",
    )
    fit = add_command(
        commands,
        "fit",
        _fit,
        "fit an entropy model to points or to a scene, and write a scene folder",
        [
            "fit points3D.txt -o scene",
            "fit trained -o scene --steps 6000",
            "fit points3D.txt -o scene --set entropy.channels=0 --set entropy.frequencies=0",
            "fit points3D.txt -o scene --resume",
        ],
        "POINTS is a points3D.txt or points3D.bin of COLMAP, a .ply of points with uchar colours, an .npz with\n"
        "means3d and colors (integers from 0 to 255, or floats from 0 to 1), a scene folder of train, fit or decode,\n"
        "or the point_cloud.ply in one. A scene keeps its rendering networks, and points get simple ones.\n"
        "Ctrl-C ends the training early, still writes the scene, and keeps SCENE_DIR.fit-state for --resume.\n"
        "Needs: pip install 'refcodec[fit]'.",
        writes=True,
    )
    fit.add_argument("points", metavar="POINTS", help="points, or a scene folder")
    fit.add_argument("-o", "--output", metavar="SCENE_DIR", required=True, help="the scene folder to write")
    fit.add_argument("--steps", type=positive, metavar="N", default=4000, help="training steps (default: %(default)s)")
    fit.add_argument(
        "--lambda",
        dest="lambda_r",
        type=fit_rate,
        metavar="L",
        default=0.004,
        help="lambda_r: the quantisation steps grow with its square root (default: %(default)s)",
    )
    fit.add_argument(
        "--voxel",
        type=length,
        metavar="V",
        help="cell size of the anchor lattice, in world units (default: that of the scene, or the median distance of "
        "the points)",
    )
    fit.add_argument("--seed", type=seed, metavar="S", default=0, help="random seed (default: %(default)s)")
    fit.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="change one setting of refcodec.train.settings.FitSettings, such as entropy.channels=0 for no planes; "
        "repeatable",
    )
    add_meta(fit)
    fit.add_argument("--resume", action="store_true", help="continue an interrupted fit of the same points")
