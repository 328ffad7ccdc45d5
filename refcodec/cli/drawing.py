"""The commands that draw a file: gaussians, render, eval."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..files.terminal import say
from ..files.text import printable
from .bounds import add_bounds, check_folder, read_bounded
from .shared import (
    RENDER_PACKAGES,
    UsageError,
    add_command,
    check_output_file,
    needs,
    note_compiling,
    parse_file,
    positive,
    progress_bar,
    read_photographs_of,
    uncompressed_of,
    write_file,
)


def _gaussians(arguments: argparse.Namespace) -> int:
    import json

    from ..bitstream.reconstruction import reconstruct
    from ..render.camera import CAMERA_MAX, read_camera
    from ..render.gaussians import gaussians, gaussians_document

    output = Path(arguments.output)
    check_output_file(output, b'{"gaussians":', "a list of Gaussians")
    try:
        with open(arguments.camera, "rb") as file:
            camera = read_camera(file.read(CAMERA_MAX + 1))
    except ValueError as error:
        raise UsageError(f"{arguments.camera} is no camera: {error}") from None
    scene = parse_file(arguments, read_bounded(arguments)).scene
    found = gaussians(reconstruct(scene), scene.masks, scene.networks, camera, scene.render.distance_unit)
    write_file(output, json.dumps(gaussians_document(found), separators=(",", ":")).encode())
    return 0


def _render(arguments: argparse.Namespace) -> int:
    try:
        from ..render.view import View, eight_bits, own_camera, write_gif, write_png
    except ModuleNotFoundError as error:
        raise needs("render", "render", error, RENDER_PACKAGES) from None
    note_compiling()
    check_folder(arguments, Path(arguments.file))
    view = View(uncompressed_of(arguments.file) or parse_file(arguments, read_bounded(arguments)).scene)
    if arguments.cameras == "default":
        cameras = [own_camera(view.info)]
    elif arguments.cameras == "orbit":
        cameras = view.orbit(arguments.frames)
    else:
        found = read_photographs_of(arguments.cameras, arguments.size)
        cameras = [p.camera for p in (*found.test, *found.train)]
    folder = Path(arguments.output)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make {folder}: {error.strerror}") from None
    frames = []
    with progress_bar(arguments.progress) as progress:
        for number, camera in enumerate(cameras):
            progress("images", number, len(cameras))
            try:
                made = view.draw(camera)
            except ValueError as error:
                raise UsageError(f"{arguments.file} cannot be drawn: {error}") from None
            path = folder / f"{Path(camera.name).stem}.png"
            write_png(path, made)
            if arguments.cameras == "orbit":
                frames.append(eight_bits(made))
        progress("images", len(cameras), len(cameras))
    if frames:
        write_gif(folder / "orbit.gif", frames)
    say(f"{folder}: {len(cameras)} images" + (", orbit.gif" if frames else ""))
    return 0


def _lpips(path: str) -> Any:
    """Returns LPIPS with the weights of a file. Raises UsageError."""
    try:
        from ..evaluate.lpips import Lpips
    except ModuleNotFoundError as error:
        raise needs("eval --lpips", "lpips", error, ("torch",)) from None
    try:
        return Lpips(path)
    except ValueError as error:
        raise UsageError(str(error)) from None


def _eval(arguments: argparse.Namespace) -> int:
    import json

    try:
        from ..evaluate.evaluation import evaluate, table
        from ..photographs.cameras import PhotographError
    except ModuleNotFoundError as error:
        raise needs("eval", "render", error, RENDER_PACKAGES) from None
    note_compiling()
    lpips = _lpips(arguments.lpips) if arguments.lpips else None
    check_folder(arguments, Path(arguments.file))
    shown = uncompressed_of(arguments.file) or read_bounded(arguments)
    found = read_photographs_of(arguments.photographs, arguments.size)
    try:
        with progress_bar(arguments.progress) as progress:
            result = evaluate(shown, found, Path(arguments.images) if arguments.images else None, progress, lpips)
    except PhotographError as error:
        raise UsageError(str(error)) from None
    except ValueError as error:
        raise UsageError(f"{arguments.file} cannot be drawn: {error}") from None
    result = {"file": arguments.file, **result}
    say(json.dumps(result, indent=1) if arguments.json else "\n".join(map(printable, table(result))), lines=True)
    return 0


def add(commands: Any) -> None:
    """Adds the commands of this module."""
    gaussians = add_command(
        commands,
        "gaussians",
        _gaussians,
        "write the Gaussians that a camera sees (SPEC.md 14.3) as JSON",
        ["gaussians scene.c3gs camera.json gaussians.json"],
        "CAMERA is a JSON object. vectors/README.md describes it.",
    )
    gaussians.add_argument("file", metavar="FILE")
    add_bounds(gaussians)
    gaussians.add_argument("camera", metavar="CAMERA")
    gaussians.add_argument("output", metavar="OUTPUT")
    render = add_command(
        commands,
        "render",
        _render,
        "draw a file",
        [
            "render scene.c3gs -o images",
            "render scene.c3gs --cameras orbit -o images",
            "render scene.c3gs --cameras photographs -o images",
        ],
        "PHOTOGRAPHS is a folder that COLMAP or a NeRF dataset made. The images of an orbit are also written as an\n"
        "animation. Needs: pip install 'refcodec[render]'.",
    )
    render.add_argument("file", metavar="FILE")
    add_bounds(render)
    render.add_argument("-o", "--output", metavar="DIR", required=True)
    render.add_argument(
        "--cameras",
        metavar="default|orbit|PHOTOGRAPHS",
        default="default",
        help="which cameras (default: the file's own)",
    )
    render.add_argument("--size", metavar="WxH", help="with PHOTOGRAPHS, the size of the images or their longest side")
    render.add_argument(
        "--frames", type=positive, metavar="N", default=60, help="images of an orbit (default: %(default)s)"
    )
    evaluate = add_command(
        commands,
        "eval",
        _eval,
        "compare what a file shows with photographs",
        ["eval scene.c3gs photographs", "eval scene.c3gs photographs --size 400x300 --json"],
        "The photographs are those that training holds out: every eighth one, or the test set of the dataset.\n"
        "Needs: pip install 'refcodec[render]'.",
    )
    evaluate.add_argument("file", metavar="FILE")
    add_bounds(evaluate)
    evaluate.add_argument("photographs", metavar="PHOTOGRAPHS")
    evaluate.add_argument(
        "--size", metavar="WxH", help="the size to which photographs are averaged down, or its longest side"
    )
    evaluate.add_argument("--images", metavar="DIR", help="write the compared images to this folder, as PNG files")
    evaluate.add_argument(
        "--lpips",
        metavar="WEIGHTS",
        help="compute LPIPS too, with the weights of a file that python -m refcodec.evaluate.lpips_weights makes",
    )
    evaluate.add_argument("--json", action="store_true", help="print all figures as JSON, with those of each image")
