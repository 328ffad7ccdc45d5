"""The part of export that puts a static scene into a GLB file as it is, and takes it out again."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from pathlib import Path

from ..files.outputs import Kind, check_apart, check_file
from ..files.stage import write_file
from ..files.terminal import say
from .shared import RENDER_PACKAGES, UsageError, needs, parse_file
from .shown import read_shown

GLB_SUFFIX, C3GS_SUFFIX = ".glb", ".c3gs"
PLAIN, C3GS, BOTH = "plain", "c3gs", "both"


def add_glb(export: argparse.ArgumentParser) -> None:
    """Adds the option that selects what a .glb contains."""
    export.add_argument(
        "--glb",
        choices=(PLAIN, C3GS, BOTH),
        default=PLAIN,
        help="what a .glb contains: plain Gaussians, or for a static scene FILE itself, or both (default: %(default)s)",
    )


def export_carried(arguments: argparse.Namespace) -> int:
    """Writes a GLB file that contains the command's file, or the C3GS file that the command's GLB file contains."""
    inside = Path(arguments.file).suffix.lower() == GLB_SUFFIX
    suffix = C3GS_SUFFIX if inside else GLB_SUFFIX
    outputs = [Path(name) for name in arguments.output]
    reason = f"{arguments.file} is a .glb" if inside else f"--glb {arguments.glb} is given"
    if len(outputs) != 1 or outputs[0].suffix.lower() != suffix or arguments.scaffold:
        raise UsageError(f"{reason}, so the output must be one {suffix} file")
    output = outputs[0]
    try:
        from ..export.glb import GLB
        from ..export.gltf_c3gs import c3gs_of_glb
    except ModuleNotFoundError as error:
        raise needs("export", "render", error, RENDER_PACKAGES) from None
    from ..bitstream.header import SIGNATURE

    check_file(output, Kind.signed("a C3GS file", SIGNATURE) if inside else GLB)
    check_apart([output], [arguments.file])
    if not inside:
        return _put(arguments, output)
    data = c3gs_of_glb(Path(arguments.file))
    if not data.startswith(SIGNATURE):
        raise UsageError(f"the scene in {arguments.file} is not a C3GS file")
    write_file(output, data)
    say(f"{output}: {len(data):,} bytes; `refcodec validate` checks them")
    return 0


def _put(arguments: argparse.Namespace, output: Path) -> int:
    """Writes a GLB file with the scene of the command's file."""
    from ..bitstream.codec import emit
    from ..bitstream.dimensions import STATIC
    from ..bitstream.reconstruction import gaussians
    from ..bitstream.scene import Scene
    from ..export.gltf_c3gs import glb_of_c3gs
    from ..render.view import scene_up, stated_cameras
    from .shown import render_info

    shown = read_shown(arguments)
    model = render_info(shown).render_model
    if model != STATIC:
        raise UsageError(
            f"{arguments.file} has render_model {model}, but --glb {arguments.glb} takes only static scenes, {STATIC}: "
            "use --glb plain"
        )
    scene = parse_file(arguments, shown).scene if isinstance(shown, bytes) else shown
    if not isinstance(scene, Scene):
        raise UsageError(f"{arguments.file} is the folder of an uncompressed scene: encode it first")
    data = shown if isinstance(shown, bytes) else emit(scene)
    up = scene_up(scene.render.up_axis, stated_cameras(scene))
    numbers = gaussians(scene)
    try:
        made = glb_of_c3gs(data, numbers, scene.render, up, arguments.glb == BOTH)
    except ValueError as error:
        raise UsageError(f"{arguments.file} cannot be exported: {error}") from None
    write_file(output, made)
    say(f"{output}: {len(numbers):,} Gaussians, {len(made):,} bytes, {len(data):,} of them the scene as C3GS")
    return 0
