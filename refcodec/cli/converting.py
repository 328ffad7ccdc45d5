"""The command that takes what other programs trained: convert."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import statuses
from ..files.terminal import note, say
from ..files.text import shell_word
from .shared import UsageError, add_command, check_scene_output, needs, progress_bar, whole

if TYPE_CHECKING:
    from ..bitstream.scene import Scene


def _convert(arguments: argparse.Namespace) -> int:
    return _model(arguments)


def _model(arguments: argparse.Namespace) -> int:
    """Converts a trained model of the family."""
    try:
        from ..convert.checkpoint import read_checkpoint
        from ..folder.uncompressed import write_uncompressed

        source, output = Path(arguments.source), Path(arguments.output)
        check_scene_output(output, [source], uncompressed=True)
        found = read_checkpoint(source, arguments.appearance)
    except ModuleNotFoundError as error:
        raise needs("convert", "fit", error, ("torch", "scipy")) from None
    scene = found.scene
    write_uncompressed(scene, output)
    if found.appearances and arguments.appearance is None:
        note(
            f"refcodec: the model has an appearance for each of {found.appearances} cameras; the scene has their mean, "
            "and --appearance N takes that of one camera"
        )
    count, offsets = scene.masks.shape
    say(f"{output}: {count} anchors, {scene.values.features.shape[1]} features, {offsets} offsets")
    name = output.name.rstrip("/") or "scene"
    say(f"next: refcodec encode {shell_word(str(output))} -o {shell_word(f'{name}.c3gs')} --rate 0.004")
    return 0


def fitted(arguments: argparse.Namespace) -> tuple[Scene, int]:
    """Returns the coded scene of an uncompressed one, for `encode`, and the exit status.

    Raises UsageError for a scene that cannot be fitted.
    """
    try:
        from ..train.fit import fit
        from ..train.fit_input import read_given
        from ..train.settings import FitSettings
    except ModuleNotFoundError as error:
        raise needs("encode of an uncompressed scene", "fit", error, ("torch", "scipy")) from None
    plain = FitSettings()
    settings = FitSettings(steps=arguments.steps or plain.steps, rate=arguments.rate or plain.rate)
    try:
        given = read_given(arguments.scene)
        with progress_bar(arguments.progress) as progress:
            result = fit(given, settings, progress=progress)
    except ValueError as error:
        raise UsageError(f"{arguments.scene} cannot be fitted: {error}") from None
    done = result.report["steps"]
    # Ctrl-C ends the training, not the program.
    if done < settings.steps and result.scene.anchor_count:
        note(f"refcodec: stopped at step {done} of {settings.steps}; the file is written, larger than it could be")
        return result.scene, statuses.INTERRUPTED
    return result.scene, statuses.DONE


def add(commands: Any) -> None:
    """Adds the command of this module."""
    convert = add_command(
        commands,
        "convert",
        _convert,
        "turn a trained model of another program into a scene folder",
        ["convert output/model -o scene", "convert output/model -o scene --appearance 0"],
        "MODEL is the folder of a model that Scaffold-GS, HAC, HAC++ or CAT-3DGS trained, or one of its folders\n"
        "iteration_N. The scene looks as the model does. It is not compressed yet: encode compresses it.\n"
        "No code of the model runs: pickles are looked at first, and TorchScript is read without running it.\n"
        "Needs: pip install 'refcodec[fit]'.",
        writes=True,
    )
    convert.add_argument("source", metavar="MODEL")
    convert.add_argument("-o", "--output", metavar="SCENE_DIR", required=True)
    convert.add_argument(
        "--appearance",
        type=whole,
        metavar="N",
        help="number of the training camera whose appearance the scene gets (default: the mean of all)",
    )
