"""Convert models and splats of other programs."""

from __future__ import annotations

import contextlib
import os
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Unpack

from ..files.lock import errors_of
from ..files.stage import folder_beside, write_file
from ..files.text import counted, shell_word
from ..statuses import DONE, INTERRUPTED, UsageError, refusing
from . import kinds
from .command import Report, apply_only, command
from .learning import TrainingWords, run_training

if TYPE_CHECKING:
    from ..rendering.camera import Camera

_VIEWS, _C3GS = 200, ".c3gs"
_GUESSED = "refcodec: no cameras are known, so views around and among the splats were guessed; --cameras states others"
# Words that apply to splat files only, and those of them that apply to a training only.
_OF_SPLATS = ("views", "cameras", "offset", "pictures", "steps", "lambda_r", "size", "psnr", "fast")
_OF_TRAINING = ("pictures", "lambda_r", "seed", "resume", "background", "holdout", "anchors", "voxel", "set")


class ConvertWords(TrainingWords, total=False):
    """How a model or a splat file is converted.

    Args:
        fast: splats: code the Gaussians, without a training of a scene.
        psnr: --fast: PSNR of pictures to those of the splats (default: 46).
        appearance: model: number of the training camera whose appearance the scene gets (default: the mean of all).
        views: splats: pictures to train from (default: 200; --fast: 32).
        cameras: splats: whose cameras draw them: a cameras.json as 3DGS writes it, a C3GS file, or a folder of a 3DGS
            model or of photographs.
        offset: splats: subtract X,Y,Z from all positions (default: for splats far from the world's origin, the middle).
        pictures: splats: keep the pictures, as photographs for eval.
        lambda_r: splats: lambda_r of the training (default: 0.004).
        preset: splats: training preset (default: fast).
        steps: splats: training steps (default: the preset's).
        size: splats: longest side of the pictures (default: the preset's).
        seed: splats: random seed (default: 0).
        resume: splats: continue an interrupted training.
    """

    fast: bool
    psnr: kinds.Decibels | None
    appearance: kinds.Count | None
    views: kinds.Positive | None
    cameras: kinds.SplatCameras | None
    offset: kinds.Offset | None
    pictures: kinds.Folder | None
    lambda_r: kinds.Lambda | None
    resume: bool
    progress: bool


@command("convert", writes=True)
def convert(source: kinds.AnyPath, output: kinds.SceneFolder, **words: Unpack[ConvertWords]) -> Report:
    """Convert a trained model or a splat file of another program to a scene folder.

    SOURCE is a model folder of Scaffold-GS, HAC, HAC++ or CAT-3DGS, or one of its folders iteration_N.
    The scene looks like the model. It is not compressed yet: encode compresses it.
    Or SOURCE is a splat file: .ply (of 3DGS, or compressed by PlayCanvas), .spz, .sog, .splat, .glb or .gltf, or a
    folder of a 3DGS model, or of SOG with meta.json. It is rendered from the cameras in its cameras.json, or else from
    cameras around and in it, whose up axis is that of --up, of a glTF file, or -y. A scene is trained from these
    pictures.
    Options that train also has work as there.
    With --fast, the Gaussians of a splat file themselves are coded, as a static scene, in about a minute; a
    million need 1.1 GB of memory and 60 processor seconds. The output is a C3GS file then. Pictures only
    measure which numbers matter.
    No code of a model runs: pickles are checked first, and TorchScript is read but not executed.
    Needs: pip install 'refcodec[convert]'.

    Args:
        source: a model folder, or a splat file.
        output: the scene folder to write; with --fast the C3GS file.

    Examples:
        convert output/model -o scene
        convert output/model -o scene --appearance 0
        convert scene.ply -o scene --views 200
        convert scene.ply -o scene.c3gs --fast
        convert scene.ply -o scene.c3gs --fast --psnr 40
        convert scene.spz -o scene --up=+y --size 800 --lambda 0.002 --steps 8000
    """
    from ..formats.others import described
    from ..formats.sog import META
    from ..formats.table import is_splat_file, model_splats, no_splat

    if Path(output).suffix.lower() == _C3GS and not words.get("fast"):
        raise UsageError(f"{output} is a folder of a scene here: add --fast to code the splat, or rename it")
    path = Path(source)
    splats = path / META if (path / META).is_file() else model_splats(path) or path
    if path.is_dir() and splats == path and not described(path):
        apply_only(words, _OF_SPLATS, f"splat files: omit it for {path}")
        return _convert_model(path, Path(output), words)
    if not is_splat_file(splats):
        raise no_splat(path) if os.path.lexists(path) else UsageError(f"{path} does not exist")
    apply_only(words, ("appearance",), f"model folders: omit it for {path}")
    if words.get("fast"):
        apply_only(words, _OF_TRAINING, "a training: omit it, or omit --fast")
        return _convert_fast(splats, Path(output), words)
    apply_only(words, ("psnr",), "--fast: add it, or choose the quality of a training with --lambda")
    return _train(splats, Path(output), words)


def _convert_model(source: Path, output: Path, words: ConvertWords) -> Report:
    """Converts a model folder to an uncompressed scene."""
    from ..convert.checkpoint import read_checkpoint
    from ..folder.places import check_outputs
    from ..folder.uncompressed import write_uncompressed

    check_outputs([source], scene=output, uncompressed=True)
    appearance = words.get("appearance")
    model = read_checkpoint(source, appearance)
    scene = model.scene
    if (up := kinds.axis_number(words.get("up"))) is not None:
        scene = replace(scene, render=replace(scene.render, up_axis=up))
    write_uncompressed(scene, output)
    notes = []
    if model.appearances and appearance is None:
        notes = [
            f"refcodec: the model has an appearance for each of {model.appearances} cameras; the scene gets their mean "
            "(--appearance N selects that of one camera)"
        ]
    count, offsets = scene.masks.shape
    line = f"{output}: {count} anchors, {scene.values.features.shape[1]} features, {offsets} offsets"
    hint = f"next: refcodec encode {shell_word(str(output))} -o {shell_word(f'{output}.c3gs')} --lambda 0.004"
    return Report([line, hint], {"anchors": count}, notes)


def _cameras(source: Path, file: kinds.StrPath | None, size: str, notes: list[str]) -> list[Camera]:
    """Returns the cameras of a file or folder, or those beside a splat file; none if there are none.

    size: of photographs. notes: receives what is not used.
    """
    from ..convert.notes import CAMERAS_FILE
    from ..convert.pictures import stated_cameras
    from ..photographs.as_trained import stated_photographs
    from .opening import open

    if file is None or not (Path(file).is_dir() or Path(file).suffix.lower() == _C3GS):
        return stated_cameras(source, file, notes.append)
    place = Path(file)
    if (place / CAMERAS_FILE).is_file():
        return stated_cameras(source, place / CAMERAS_FILE)
    if place.is_dir():
        photographs = stated_photographs(place, size)
        notes += [f"refcodec: {text}" for text in photographs.notes]
        return [p.camera for p in (*photographs.train, *photographs.test)]
    with open(place) as opened:
        cameras = opened.cameras
    if not cameras:
        raise UsageError(f"{place} has no cameras: give another file, or omit --cameras")
    return cameras


def _convert_fast(source: Path, output: Path, words: ConvertWords) -> Report:
    """Converts a splat file to a file of a static scene, without a training of the scene."""
    from ..bitstream.codec import emit
    from ..bitstream.header import RenderInfo
    from ..convert import fast
    from ..convert.pictures import chosen_cameras, up_of
    from ..convert.views import near_plane
    from ..folder.georeference import georeference
    from ..folder.metadata import with_entries
    from ..folder.places import C3GS, check_outputs, progress_bar
    from ..formats.table import read_located
    from ..rendering.camera import STATED, moved, nearest_axis
    from .shown import note_compiling

    check_outputs([source, words.get("cameras")], (output, C3GS))
    if output.suffix.lower() != _C3GS:
        raise UsageError(f"{output} must end in {_C3GS}: --fast writes a file, not a scene folder")
    notes: list[str] = []
    size = words.get("size") or str(fast.SIDE)
    cameras = _cameras(source, words.get("cameras"), size, notes)
    up = up_of(source, words.get("up"), cameras)
    splats, offset = read_located(source, kinds.place(words.get("offset")), notes.append)
    cameras = moved(cameras, offset)
    note_compiling()
    chosen = chosen_cameras(cameras, splats, up, size, words.get("views") or fast.VIEWS)
    render = RenderInfo(up_axis=nearest_axis(up), near_plane=near_plane(splats))
    psnr, steps = words.get("psnr") or fast.PSNR, words.get("steps") or fast.STEPS
    held, given_count = [splats], len(splats.mean)
    del splats
    with progress_bar(words) as show, refusing(f"{source} cannot be converted"):
        made = fast.converted(held, chosen, render, STATED if cameras else 1, psnr, steps, show)
        data = emit(with_entries(made.scene, georeference(offset)), progress=show)
    write_file(output, data)
    count, reached = f"{made.scene.anchor_count:,} of {given_count:,} Gaussians", fmean(made.psnr)
    places = "cameras of the splats" if cameras else "cameras around and among the splats"
    lines = [
        f"{output}: {len(data):,} bytes, {count}",
        f"PSNR to {source}: {reached:.1f} dB in {counted(len(made.psnr), 'picture')} of {size} pixels by {places}, "
        f"{min(made.psnr):.1f} in the worst",
    ]
    if made.faint or made.dropped:
        lines.append(f"left out: {made.faint:,} Gaussians too faint for any picture, {made.dropped:,} of little effect")
    if not cameras:
        notes.append(_GUESSED)
    if reached < psnr - 1:
        notes.append(f"refcodec: {psnr:g} dB were not reached: this is the best quality that was found")
    if reached > psnr + 1:
        notes.append(f"refcodec: {psnr:g} dB were passed: no smaller file was found")
    if not made.whole:
        notes.append("refcodec: stopped early; the file is written, but larger than necessary")
    values = {"bytes": len(data), "anchors": made.scene.anchor_count, "psnr": reached, "worst": min(made.psnr)}
    return Report(lines, values, notes, status=DONE if made.whole else INTERRUPTED)


def _train(source: Path, output: Path, words: ConvertWords) -> Report:
    """Draws a splat file from cameras, and trains a scene from these pictures."""
    from ..convert.pictures import check_pictures, draw_pictures, up_of
    from ..folder.georeference import georeference
    from ..folder.places import check_outputs, progress_bar
    from ..formats.table import read_located
    from ..photographs.as_trained import stated_photographs
    from ..rendering.camera import moved
    from ..train.command import state_path
    from ..train.place import STATE, check_state
    from ..train.settings_file import chosen_settings
    from .shown import note_compiling

    # The default background is black, as in 3DGS.
    words["background"] = words.get("background") or "black"
    settings, up = chosen_settings(words), words.get("up")
    resume, stated = words.get("resume", False), words.get("pictures")
    state, kept = state_path(output), None if stated is None else Path(stated)
    check_outputs([source, words.get("cameras")], (state, STATE), scene=output, uncompressed=True)
    check_state(output, state, resume)
    # A resumed training uses the pictures that the interrupted one left.
    drawn = not (resume and kept and kept.is_dir())
    if kept and drawn:
        check_pictures(kept, output)
    views, notes = words.get("views") or _VIEWS, list[str]()
    cameras = _cameras(source, words.get("cameras"), settings.size, notes)
    splats, offset = read_located(source, kinds.place(words.get("offset")), notes.append)
    cameras = moved(cameras, offset)
    note_compiling()
    with contextlib.ExitStack() as beside, refusing(f"{source} cannot be used for training"):
        folder = kept or Path()
        if drawn:
            notes += [] if cameras else [_GUESSED]
            folder = beside.enter_context(folder_beside((kept or output).absolute().parent)) / "pictures"
            with errors_of(kept or output), progress_bar(words) as show:
                folder.mkdir()
                above = up_of(source, up, cameras)
                draw_pictures(splats, cameras, folder, above, settings.size, views, settings.background, show)
        # The pictures have their own split.
        photographs = stated_photographs(folder, settings.size, settings.background, settings.holdout)
        report = run_training(
            photographs,
            settings,
            output,
            str(kept or "PHOTOGRAPHS"),
            threads=os.cpu_count() or 1,
            device="cpu",
            resume=resume,
            progress=words.get("progress", False),
            up_axis=kinds.axis_number(up),
            metadata=georeference(offset) if settings.rate.lambda_r else {},
        )
        if drawn and kept:
            with errors_of(kept):
                folder.replace(kept)
    return replace(report, notes=[*notes, *report.notes])
