"""Learn scenes and entropy models."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from ..statuses import INTERRUPTED, UsageError, refusing
from . import kinds
from .command import Report, command

if TYPE_CHECKING:
    from ..photographs.photographs import PhotographSet
    from ..train.settings import TrainSettings


class DataWords(TypedDict, total=False):
    """How photographs are read, and where a training begins.

    Args:
        static: learn a static scene: its Gaussians do not depend on the view, and its colours have spherical harmonics.
        background: colour behind the photographs: white, black or R,G,B (default: that of --from, or white if a pixel
            is transparent; else none, and no colour shines through the scene).
        holdout: hold out every N-th photograph, or none with 0, unless the data set has a split (default: 8).
        anchors: approximate number of initial anchors (default: the preset's).
        voxel: edge length of the voxels of the initial anchors, in world units.
        degree: degree of the harmonics of a static scene (default: chosen by rate and distortion).
        set: change one setting of train --print-settings; repeatable.
        up: up axis of the scene, such as --up=+z (default: derived from the cameras and the points).
    """

    static: bool
    background: kinds.Colour | None
    holdout: kinds.Count | None
    anchors: kinds.Positive | None
    voxel: kinds.Length | None
    degree: kinds.Degree | None
    set: Sequence[kinds.Change]
    up: kinds.Axis | None


class TrainingWords(DataWords, total=False):
    """The words of DataWords, and how long a training is.

    Args:
        preset: fast: 5,000 steps, photographs of 400 pixels, about 5,000 anchors at first, or more with random points;
            paper: 40,000 steps, 1,600 pixels, the median distance of neighbouring points as voxel size (default: fast).
        steps: training steps (default: the preset's).
        size: size to which photographs are averaged down, longest side, or full for unscaled (default: the preset's).
        seed: random seed (default: 0).
    """

    preset: kinds.Preset
    steps: kinds.Positive | None
    size: kinds.Size | None
    seed: kinds.Seed | None


@command("train", operands=("photographs",), writes=True)
def train(
    photographs: kinds.AnyPath | None = None,
    output: kinds.SceneFolder | None = None,
    *,
    settings: kinds.FilePath | None = None,
    print_settings: bool = False,
    from_scene: kinds.SceneFolder | None = None,
    lambda_r: kinds.Lambda | None = None,
    device: kinds.Device = "cpu",
    threads: kinds.Positive | None = None,
    meta: Sequence[kinds.Meta] | Mapping[str, str] = (),
    resume: bool = False,
    keep_state: bool = False,
    log: kinds.LogPath | None = None,
    progress: bool = False,
    stages: kinds.Stages = (),
    **words: Unpack[TrainingWords],
) -> Report:
    """Learn a scene from photographs, and write a scene folder.

    PHOTOGRAPHS is a COLMAP or NeRF folder; every eighth image is held out. refcodec encode and eval read
    SCENE_DIR. Its training.json has the settings and a report of the training.
    Masks exclude pixels that are black in masks/NAME.png (COLMAP) or in the mask_path of a frame (NeRF).
    Training starts with an anchor in each voxel that has points. --voxel or --anchors sets the voxel size.
    For a NeRF folder without points, points are drawn at random: in the visual hull of transparent photographs,
    or else in a cube. Anchors grow until 40 % of the steps, when the rate enters the loss. The setting
    growth.most is their maximum: 40,000 in the preset fast.
    Ctrl-C ends the training early, still writes the scene, and keeps SCENE_DIR.train-state for --resume.
    While such a state exists, a training without --resume does not start: use --resume, or remove the state.
    --resume --steps N with more steps than before extends a training. The rest of its schedule is stretched
    over the remaining steps: completed phases are not repeated, and learning rates continue from their values.
    A completed training continues in its last phase, if it was trained with --keep-state.
    Needs: pip install 'refcodec[train]'.

    Args:
        settings: settings that replace those of the preset, in the form of --print-settings.
        print_settings: print all settings with their meanings, and exit.
        from_scene: continue from a scene, such as one of convert, with its anchors, networks and features; none grow.
        lambda_r: lambda_r, the weight of the rate: usually 0.002 to 0.04, or 0 for an uncompressed Scaffold-GS
            (default: 0.004).
        device: device of the training; cuda needs pip install 'refcodec[cuda]'.
        threads: threads of the rasteriser (default: all); results do not depend on it.
        resume: continue a saved training of the same photographs and settings; --steps may be more than before.
        keep_state: keep SCENE_DIR.train-state after the end, so that --resume --steps N can extend the training.
        log: write a row for each evaluation on held-out photographs: step, seconds, PSNR, anchors, bytes by part,
            phase; a folder is for TensorBoard and needs pip install 'refcodec[tensorboard]'.
        stages: further stages of the training (docs/method.md), called after those of the method.

    Examples:
        train photographs -o scene
        train photographs -o scene --lambda 0.01 --steps 8000
        train photographs -o scene --resume
        train photographs -o better --from converted --lambda 0.002
        train photographs -o scene --anchors 20000 --background white --holdout 0
        train photographs -o scene --resume --steps 12000
        train photographs -o scene --log scene.csv
        train photographs -o scene --static
        train photographs -o scaffold --lambda 0
        train photographs -o scene --set masks.epsilon=0.0004 --set growth.most=60000
        train --preset paper --print-settings > settings.toml
        train photographs -o scene --settings settings.toml

    Returns:
        A report whose `values` are those of training.json.
    """
    from ..train.settings_file import chosen_settings, to_toml

    chosen = chosen_settings({**words, "lambda_r": lambda_r}, settings)
    if chosen.static and from_scene:
        raise UsageError("--from continues a view-dependent scene: omit --static")
    if print_settings:
        return Report(to_toml(chosen).splitlines())
    if photographs is None or output is None:
        raise UsageError("train needs PHOTOGRAPHS and -o SCENE_DIR")
    import numpy as np

    from ..bitstream.cameras import NamedCamera
    from ..bitstream.networks import BoundError
    from ..files.terminal import note
    from ..folder.georeference import georeference
    from ..folder.layout import REPORT_FILE
    from ..folder.metadata import stated_entries
    from ..folder.places import check_outputs
    from ..photographs.as_trained import scene_offset, stated_photographs
    from ..train.command import state_path
    from ..train.continued import BeginningError, read_beginning
    from ..train.log import check_log, open_log
    from ..train.place import REPORT, STATE, check_state, named
    from .shown import note_compiling

    entries = stated_entries(meta)
    if entries and not chosen.rate.lambda_r:
        raise UsageError("an uncompressed scene, as trained with --lambda 0, has no metadata: omit --meta")
    folder = named(output)
    state = state_path(folder)
    files = [(state, STATE), (folder / REPORT_FILE, REPORT), (None if log is None else check_log(Path(log)), None)]
    check_outputs([settings, from_scene], *files, scene=folder, uncompressed=True)
    check_state(folder, state, resume, "; a completed training keeps it only with --keep-state")
    given = None if from_scene is None else read_beginning(Path(from_scene))
    images = stated_photographs(photographs, chosen.size, chosen.background, chosen.holdout)
    if given is not None and chosen.background == "auto":
        images = images.over(given.render.background)
    reads = images.places()
    check_outputs(reads, *files, scene=folder, uncompressed=True)
    for text in images.notes:
        note(f"refcodec: {text}")
    offset = scene_offset(
        images, next(iter(given.cameras if given else ()), NamedCamera()), given.offset if given else np.zeros(3)
    )
    if offset.any():
        note(f"refcodec: far from the world's origin for its size: {offset.tolist()} is subtracted from all places")
        entries = {**georeference(offset), **entries} if chosen.rate.lambda_r else entries
    note_compiling()
    rows = None if log is None else open_log(Path(log))
    # The photographs are not at fault for networks that a file cannot hold.
    others = {
        BeginningError: f"{from_scene} cannot be continued",
        BoundError: f"{from_scene or folder} cannot be coded",
    }
    with refusing(f"{os.fspath(photographs)} cannot be trained", others):
        return run_training(
            images.moved(offset),
            chosen,
            folder,
            os.fspath(photographs),
            threads=threads or os.cpu_count() or 1,
            device=device,
            resume=resume,
            progress=progress,
            keep_state=keep_state,
            log=rows,
            metadata=entries,
            given=given,
            stages=stages,
            up_axis=kinds.axis_number(words.get("up")),
        )


def run_training(images: PhotographSet, settings: TrainSettings, output: Path, shown: str, **options: Any) -> Report:
    """Trains as train.command.train, and returns the report. shown: the photographs, for the advice."""
    from ..train.command import state_path, train
    from ..train.messages import closing
    from ..train.place import hold_state, stopped

    state = state_path(output)
    with hold_state(state):
        result = train(images, settings, output, **options)
    lines = [*closing(result.trainer, result.report, output, shown)]
    if result.whole:
        return Report(lines, result.report)
    note = stopped(result.trainer.clock.done, settings.steps, state)
    return Report(lines, result.report, [note], status=INTERRUPTED)


@command("fit", writes=True)
def fit(
    points: kinds.AnyPath,
    output: kinds.SceneFolder,
    *,
    steps: kinds.Positive = 4000,
    lambda_r: kinds.FitLambda = 0.004,
    voxel: kinds.Length | None = None,
    seed: kinds.Seed = 0,
    set: Sequence[kinds.Change] = (),
    meta: Sequence[kinds.Meta] | Mapping[str, str] = (),
    resume: bool = False,
    progress: bool = False,
) -> Report:
    """Fit an entropy model to points or to a scene, and write a scene folder.

    POINTS is a points3D.txt or points3D.bin of COLMAP, a .ply of points with uchar colours, an .npz with
    means3d and colors (integers from 0 to 255, or floats from 0 to 1), a scene folder of train, fit or decode,
    or the point_cloud.ply in one. A scene keeps its rendering networks, and points get simple ones.
    Ctrl-C ends the training early, still writes the scene, and keeps SCENE_DIR.fit-state for --resume.
    Needs: pip install 'refcodec[fit]'.

    Args:
        points: points, or a scene folder.
        steps: training steps.
        lambda_r: lambda_r: the quantisation steps grow with its square root.
        voxel: cell size of the anchor lattice, in world units (default: that of the scene, or the median distance of
            the points).
        seed: random seed.
        set: change one setting of refcodec.train.settings.FitSettings, such as entropy.channels=0 for no planes;
            repeatable.
        resume: continue an interrupted fit of the same points.

    Examples:
        fit points3D.txt -o scene
        fit trained -o scene --steps 6000
        fit points3D.txt -o scene --set entropy.channels=0 --set entropy.frequencies=0
        fit points3D.txt -o scene --resume
    """
    from zipfile import BadZipFile

    from ..files.terminal import note
    from ..folder.georeference import georeference
    from ..folder.layout import scene_files
    from ..folder.metadata import stated_entries, with_entries
    from ..folder.places import check_outputs, progress_bar
    from ..folder.write import write_folder
    from ..train.fit import fit as run
    from ..train.fit_input import read_given
    from ..train.place import STATE, check_state, hold_state, named, stopped
    from ..train.settings import FitSettings
    from ..train.settings_file import assigned, varied
    from ..train.state import write_somewhere

    folder, source = named(output), Path(points)
    # Beside the folder, not in it: a scene folder is complete or absent.
    state = folder.with_name(folder.name + ".fit-state")
    # The point cloud of a scene is read with the rest of the scene.
    inputs = [source, *(scene_files(source.parent) if source.suffix == ".ply" else [])]
    check_outputs(inputs, (state, STATE), scene=folder)
    check_state(folder, state, resume)
    plain = varied(FitSettings(), {"steps": steps, "seed": seed, "lambda_r": lambda_r})
    chosen = assigned(plain, set)
    entries = stated_entries(meta)
    # An unreadable npz file may be truncated, or not an archive.
    unreadable = dict.fromkeys((BadZipFile, EOFError), f"{source} cannot be fitted")
    with refusing(f"{source} cannot be fitted", unreadable), hold_state(state):
        given = read_given(source, voxel)
        for text in given.notes:
            note(f"refcodec: {source}: {text}")
        with progress_bar({"progress": progress}) as show:
            result = run(given, chosen, progress=show, state=state)
        scene = with_entries(result.scene, {**georeference(given.offset), **entries})
        write_somewhere(lambda place: write_folder(scene, place), folder, state)
        done, dropped = result.report["steps"], result.report["dropped"]
        # Ctrl-C ends the training, not the program.
        whole = done == chosen.steps or not scene.anchor_count
        if whole:
            with contextlib.suppress(OSError):
                state.unlink(missing_ok=True)
    line = f"{os.fspath(output)}: {scene.anchor_count} anchors, {dropped} without offsets dropped, {done} steps"
    if whole:
        return Report([line], result.report)
    return Report([line], result.report, [stopped(done, chosen.steps, state)], status=INTERRUPTED)
