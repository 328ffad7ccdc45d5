"""The command convert, which imports models and splats, and the fit of uncompressed scenes for encode."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import statuses
from ..files.lock import errors_of, hold_file
from ..files.stage import folder_beside
from ..files.terminal import note, say
from ..files.text import shell_word
from . import train_options
from .shared import (
    UsageError,
    add_command,
    check_scene_output,
    needs,
    note_compiling,
    positive,
    progress_bar,
    quality,
    read_photographs_of,
    seed,
    weight,
    whole,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..bitstream.scene import Scene
    from ..formats.splats import Splats
    from ..rendering.camera import Camera
    from ..train.settings import TrainSettings

# The packages of convert beyond those of the decoder.
_PACKAGES = ("torch", "numba", "scipy", "PIL", "skimage")
_VIEWS = 200
# Options of a training that --fast does not have.
_TRAINED = ("pictures", "lambda_r", "seed", "resume", "background", "holdout", "anchors", "voxel", "set")


def _convert(arguments: argparse.Namespace) -> int:
    source = Path(arguments.source)
    splats = _splats_of(source)
    if not splats and not source.is_dir():
        if not os.path.lexists(source):
            raise UsageError(f"{source} does not exist")
        from ..formats.table import FORMATS

        raise UsageError(f"{source} is neither a model folder nor a splat file ({', '.join(FORMATS)})")
    if splats and arguments.appearance is not None:
        raise UsageError(f"--appearance applies only to model folders: omit it for {source}")
    drawn = {
        name: getattr(arguments, name) for name in ("views", "cameras", "pictures", "steps", "lambda_r", "size", "psnr")
    }
    drawn["fast"] = arguments.fast or None
    given = next((name for name, value in drawn.items() if value is not None), None)
    if not splats and given:
        raise UsageError(f"--{given.removesuffix('_r')} applies only to splat files: omit it for {source}")
    if arguments.psnr is not None and not arguments.fast:
        raise UsageError("--psnr applies only to --fast: add it, or choose the quality of a training with --lambda")
    try:
        if splats:
            return _convert_fast(arguments, splats) if arguments.fast else _train_from_splats(arguments, splats)
        return _convert_model(arguments)
    except ModuleNotFoundError as error:
        raise needs("convert", "convert", error, _PACKAGES) from None


def _splats_of(source: Path) -> Path | None:
    """Returns the splat file of a source, or None for a model folder."""
    from ..formats.sog import META
    from ..formats.table import is_splat_file

    if source.is_dir():
        return source / META if (source / META).is_file() else None
    return source if is_splat_file(source) else None


# --- a model of the family --------------------------------------------------------------------------------------------


def _convert_model(arguments: argparse.Namespace) -> int:
    """Converts a model folder to an uncompressed scene."""
    from ..convert.checkpoint import read_checkpoint
    from ..folder.uncompressed import write_uncompressed

    source, output = Path(arguments.source), Path(arguments.output)
    check_scene_output(output, [source], uncompressed=True)
    model = read_checkpoint(source, arguments.appearance)
    scene, up = model.scene, train_options.up_axis(arguments)
    if up is not None:
        scene = replace(scene, render=replace(scene.render, up_axis=up))
    write_uncompressed(scene, output)
    if model.appearances and arguments.appearance is None:
        note(
            f"refcodec: the model has an appearance for each of {model.appearances} cameras; the scene gets their mean "
            "(--appearance N selects that of one camera)"
        )
    count, offsets = scene.masks.shape
    say(f"{output}: {count} anchors, {scene.values.features.shape[1]} features, {offsets} offsets")
    say(f"next: refcodec encode {shell_word(str(output))} -o {shell_word(f'{output}.c3gs')} --lambda 0.004")
    return statuses.DONE


def fitted(arguments: argparse.Namespace) -> tuple[Scene, int]:
    """Fits an uncompressed scene for `encode`. Returns the coded scene and the exit status. Raises UsageError."""
    try:
        from ..convert.networks import on_grids
        from ..train.fit import fit
        from ..train.fit_input import read_given
        from ..train.settings import FitSettings
    except ModuleNotFoundError as error:
        raise needs("encode of an uncompressed scene", "fit", error, ("torch", "numba", "scipy")) from None
    plain = FitSettings()
    settings = FitSettings(steps=arguments.steps or plain.steps, lambda_r=arguments.lambda_r or plain.lambda_r)
    try:
        given = read_given(arguments.scene)
        with progress_bar(arguments.progress) as progress:
            result = fit(given, settings, progress=progress)
        scene = on_grids(result.scene, given.cloud)
    except ValueError as error:
        raise UsageError(f"{arguments.scene} cannot be fitted: {error}") from None
    done = result.report["steps"]
    # Ctrl-C ends the training, not the program.
    if done < settings.steps and scene.anchor_count:
        note(f"refcodec: stopped at step {done} of {settings.steps}; the file is written, but larger than necessary")
        return scene, statuses.INTERRUPTED
    return scene, statuses.DONE


# --- a file of splats -------------------------------------------------------------------------------------------------


def _convert_fast(arguments: argparse.Namespace, source: Path) -> int:
    """Converts a splat file to a file of a static scene, without a training of the scene."""
    from ..bitstream.codec import emit
    from ..bitstream.header import SIGNATURE, RenderInfo
    from ..convert import fast, views
    from ..files.outputs import Kind, check_apart, check_file
    from ..files.stage import write_file
    from ..formats.table import read_splats, splats_up
    from ..rendering.camera import STATED, nearest_axis

    for name in _TRAINED:
        if getattr(arguments, name):
            raise UsageError(f"--{name.removesuffix('_r')} applies only to a training: omit it, or omit --fast")
    output = Path(arguments.output)
    check_file(output, Kind.signed("a C3GS file", SIGNATURE))
    check_apart([output], [source])
    cameras = _cameras_of(source, arguments.cameras)
    splats = read_splats(source)
    note_compiling()
    up = views.AXES[arguments.up] if arguments.up else splats_up(source)
    chosen = _chosen(arguments, cameras, splats, up, arguments.size or str(fast.SIDE), fast.VIEWS)
    render = RenderInfo(up_axis=nearest_axis(up), near_plane=views.near_plane(splats))
    psnr = fast.PSNR if arguments.psnr is None else arguments.psnr
    with progress_bar(arguments.progress) as progress:
        try:
            found = fast.converted(
                splats, chosen, render, STATED if cameras else 1, psnr, arguments.steps or fast.STEPS, progress
            )
            data = emit(found.scene, progress=progress)
        except ValueError as error:
            raise UsageError(f"{source} cannot be converted: {error}") from None
    write_file(output, data)
    count = f"{found.scene.anchor_count:,} of {len(splats.mean):,} Gaussians"
    say(f"{output}: {len(data):,} bytes, {count}, {found.psnr:.1f} dB to {source}")
    if abs(found.psnr - psnr) > 1:
        note(f"refcodec: {psnr:g} dB were not reached: the file has the nearest quality that was found")
    if not found.whole:
        note("refcodec: stopped early; the file is written, but larger than necessary")
        return statuses.INTERRUPTED
    return statuses.DONE


def _train_from_splats(arguments: argparse.Namespace, source: Path) -> int:
    """Draws a splat file from cameras, and trains a scene from these pictures."""
    from ..folder.layout import SceneFolderError
    from ..train.command import state_path, train
    from ..train.messages import closing
    from ..train.state import StateError

    output = Path(arguments.output)
    pictures = Path(arguments.pictures) if arguments.pictures else None
    settings, state = _train_settings(arguments), state_path(output)
    check_scene_output(output, [source], uncompressed=True)
    if arguments.resume != os.path.lexists(state):
        if arguments.resume:
            raise UsageError(f"there is nothing to resume: {state} does not exist")
        raise UsageError(f"{state} is a saved training: continue it with --resume, or remove it")
    # A resumed training uses the pictures that the interrupted one left.
    kept = pictures if arguments.resume and pictures and pictures.is_dir() else None
    if pictures is not None and kept is None:
        _check_pictures(pictures, output)
    cameras = _cameras_of(source, arguments.cameras)
    note_compiling()
    drawn = None
    beside = contextlib.ExitStack()
    try:
        if kept is None:
            drawn = beside.enter_context(folder_beside((pictures or output).absolute().parent)) / "pictures"
            with errors_of(pictures or output):
                drawn.mkdir()
                _draw(arguments, source, cameras, drawn, settings)
        # The pictures have their own split.
        photographs = read_photographs_of(str(kept or drawn), settings.size, settings.background, settings.holdout)
        with hold_file(state.with_name(state.name + ".lock")):
            result = train(
                photographs,
                settings,
                output,
                threads=os.cpu_count() or 1,
                device="cpu",
                resume=arguments.resume,
                progress=arguments.progress,
                up_axis=train_options.up_axis(arguments),
            )
        if drawn and pictures:
            with errors_of(pictures):
                drawn.replace(pictures)
    except SceneFolderError:
        raise
    except StateError as error:
        raise UsageError(str(error)) from None
    except ValueError as error:
        raise UsageError(f"{source} cannot be used for training: {error}") from None
    finally:
        beside.close()
    for line in closing(result.trainer, result.report, output, str(pictures or "PHOTOGRAPHS")):
        say(line)
    if not result.whole:
        note(f"refcodec: stopped at step {result.trainer.clock.done}; the scene is written, and --resume continues")
        return statuses.INTERRUPTED
    return statuses.DONE


def _check_pictures(pictures: Path, output: Path) -> None:
    """Raises UsageError unless pictures can be kept in a new folder outside the scene."""
    if os.path.lexists(pictures):
        raise UsageError(f"{pictures} exists: choose another folder for the pictures")
    place, scene = Path(os.path.realpath(pictures)), Path(os.path.realpath(output))
    if place.is_relative_to(scene) or scene.is_relative_to(place):
        raise UsageError(
            f"{pictures} and {output} are the same folder or nested: choose another folder for the pictures"
        )


def _train_settings(arguments: argparse.Namespace) -> TrainSettings:
    """Returns the settings of the training. The default background is black, as in 3DGS."""
    from ..train.settings import PRESETS

    if arguments.background is None:
        arguments.background = "black"
    own = {
        "rate.lambda_r": arguments.lambda_r,
        "steps": arguments.steps,
        "size": arguments.size,
        "seed": arguments.seed,
    }
    return train_options.settings(arguments, PRESETS[arguments.preset], own)


def _cameras_of(source: Path, stated: str | None) -> list[Camera]:
    """Returns the cameras of a cameras.json: the stated file, or that of the splat's model; else none.

    3DGS writes it beside its folder point_cloud. Raises UsageError and SceneFolderError.
    """
    from ..convert.notes import CAMERAS_FILE, read_cameras

    if stated:
        found = read_cameras(Path(stated))
        if not found:
            raise UsageError(f"{stated} has no cameras: give a cameras.json of 3DGS, or omit --cameras")
        return found
    beside = [source.parent / CAMERAS_FILE]
    if source.parent.parent.name == "point_cloud":
        beside.append(source.parent.parent.parent / CAMERAS_FILE)
    return next((cameras for cameras in map(read_cameras, beside) if cameras), [])


def _draw(
    arguments: argparse.Namespace, source: Path, cameras: list[Camera], folder: Path, settings: TrainSettings
) -> None:
    """Writes the pictures of a splat file to a folder. Raises UsageError and SceneFolderError."""
    from ..convert import views
    from ..formats.table import read_splats, splats_up
    from ..photographs.images import parse_background

    try:
        background = parse_background(settings.background)
    except ValueError as error:
        raise UsageError(str(error)) from None
    splats = read_splats(source)
    up = views.AXES[arguments.up] if arguments.up else splats_up(source)
    chosen = _chosen(arguments, cameras, splats, up, settings.size, _VIEWS)
    with progress_bar(arguments.progress) as progress:
        views.write_photographs(splats, chosen, folder, progress, background)


def _chosen(
    arguments: argparse.Namespace, cameras: list[Camera], splats: Splats, up: NDArray[Any], size: str, count: int
) -> dict[str, list[Camera]]:
    """Returns cameras by purpose: a selection of the given ones, or else cameras around the splats.

    size, count: the default of --views, and the sides of pictures. Raises UsageError.
    """
    from ..convert import views
    from ..photographs.images import parse_size

    try:
        sides = parse_size(size)
    except ValueError as error:
        raise UsageError(str(error)) from None
    side = max(sides) if isinstance(sides, tuple) else sides
    count = arguments.views or count
    if cameras:
        return views.given(cameras, count, side)
    return views.orbit(splats, up, side or views.SIDE, count, max(count // views.TEST_EVERY, 1))


def add(commands: Any) -> None:
    """Adds the command of this module."""
    convert = add_command(
        commands,
        "convert",
        _convert,
        "convert a trained model or a splat file of another program to a scene folder",
        [
            "convert output/model -o scene",
            "convert output/model -o scene --appearance 0",
            "convert scene.ply -o scene --views 200",
            "convert scene.ply -o scene.c3gs --fast",
            "convert scene.ply -o scene.c3gs --fast --psnr 40",
            "convert scene.spz -o scene --up=+y --size 800 --lambda 0.002 --steps 8000",
        ],
        "SOURCE is a model folder of Scaffold-GS, HAC, HAC++ or CAT-3DGS, or one of its folders iteration_N.\n"
        "The scene looks like the model. It is not compressed yet: encode compresses it.\n"
        "Or SOURCE is a splat file: .ply (of 3DGS, or compressed by PlayCanvas), .spz, .sog or .glb, or a SOG folder\n"
        "with meta.json. It is rendered from the cameras in its cameras.json, or else from cameras around it, whose\n"
        "up axis is that of --up, of a .glb file, or -y. A scene is trained from these pictures.\n"
        "Options that train also has work as there.\n"
        "With --fast, the Gaussians of a splat file themselves are coded, as a static scene, in about a minute. The\n"
        "output is a C3GS file then. Pictures only measure which numbers matter.\n"
        "No code of a model runs: pickles are checked first, and TorchScript is read but not executed.\n"
        "Needs: pip install 'refcodec[convert]'.",
        writes=True,
        parents=[train_options.parser()],
    )
    convert.add_argument("source", metavar="SOURCE", help="a model folder, or a splat file")
    convert.add_argument(
        "-o",
        "--output",
        metavar="SCENE_DIR",
        required=True,
        help="the scene folder to write; with --fast the C3GS file",
    )
    convert.add_argument(
        "--fast", action="store_true", help="splats: code the Gaussians, without a training of a scene"
    )
    convert.add_argument(
        "--psnr", type=quality, metavar="DB", help="--fast: PSNR of pictures to those of the splats (default: 46)"
    )
    convert.add_argument(
        "--appearance",
        type=whole,
        metavar="N",
        help="model: number of the training camera whose appearance the scene gets (default: the mean of all)",
    )
    convert.add_argument(
        "--views", type=positive, metavar="N", help=f"splats: pictures to train from (default: {_VIEWS}; --fast: 32)"
    )
    convert.add_argument("--cameras", metavar="FILE", help="splats: a cameras.json as 3DGS writes it")
    convert.add_argument("--pictures", metavar="DIR", help="splats: keep the pictures, as photographs for eval")
    convert.add_argument(
        "--preset", choices=("fast", "paper"), default="fast", help="splats: training preset (default: %(default)s)"
    )
    convert.add_argument(
        "--lambda", dest="lambda_r", type=weight, metavar="L", help="splats: lambda_r of the training (default: 0.004)"
    )
    convert.add_argument("--steps", type=positive, metavar="N", help="splats: training steps (default: the preset's)")
    convert.add_argument("--size", metavar="WxH", help="splats: longest side of the pictures (default: the preset's)")
    convert.add_argument("--seed", type=seed, metavar="S", help="splats: random seed (default: 0)")
    convert.add_argument("--resume", action="store_true", help="splats: continue an interrupted training")
