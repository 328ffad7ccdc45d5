"""The part of export that puts a static scene into a GLB file as it is, and takes it out again."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from pathlib import Path

from ..files.outputs import Kind, check_apart, check_file
from ..files.stage import write_file
from ..files.terminal import say
from .bounds import read_bounded
from .shared import UsageError, parse_file

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
    from ..bitstream.header import SIGNATURE
    from ..formats.table import FORMATS, carried_scene

    check_file(output, Kind.signed("a C3GS file", SIGNATURE) if inside else FORMATS[GLB_SUFFIX].kind)
    check_apart([output], [arguments.file])
    if not inside:
        return _put(arguments, output)
    data = carried_scene(Path(arguments.file))
    if not data.startswith(SIGNATURE):
        raise UsageError(f"the scene in {arguments.file} is not a C3GS file")
    write_file(output, data)
    say(f"{output}: {len(data):,} bytes; `refcodec validate` checks them")
    return 0


def _put(arguments: argparse.Namespace, output: Path) -> int:
    """Writes a GLB file with the scene of the command's file."""
    from ..bitstream.cameras import cameras
    from ..bitstream.codec import parse_container
    from ..formats.glb import check_colours, glb_bytes
    from ..rendering.camera import scene_up
    from ..rendering.gaussians import check_static, static_splats

    data = read_bounded(arguments)
    check_static(parse_container(data).render)
    scene = parse_file(arguments, data).scene
    try:
        check_colours(scene.render)
        splats = static_splats(scene)
        if not len(splats.mean):
            raise ValueError("it has no Gaussians")
        up = scene_up(scene.render.up_axis, cameras(scene.ancillary))
        made = glb_bytes(splats, up, data, plain=arguments.glb == BOTH)
    except ValueError as error:
        raise UsageError(f"{arguments.file} cannot be exported: {error}") from None
    write_file(output, made)
    say(f"{output}: {len(splats.mean):,} Gaussians, {len(made):,} bytes, {len(data):,} of them the scene as C3GS")
    return 0
