"""The commands that draw a file: gaussians, render, eval."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files.outputs import Kind, check_apart, check_file
from ..files.stage import write_file
from ..files.terminal import note, say
from ..files.text import printable
from .bounds import add_bounds, read_bounded
from .shared import (
    CODED_OR_PLAIN,
    FILE,
    PHOTOGRAPHS,
    RENDER_PACKAGES,
    UsageError,
    add_command,
    counted,
    encoded,
    needs,
    note_compiling,
    parse_file,
    positive,
    progress_bar,
    whole,
)
from .shown import camera_of, photographs_as_trained, read_shown, render_info

if TYPE_CHECKING:
    from ..rendering.camera import Camera


# Help for the commands that write images.
IMAGES = """\
An image has the name of its camera, including folders, with the suffix .png, which is appended to the camera's own
suffix if names would collide. Images are marked as written by refcodec, and only such images are replaced. They
appear in DIR when all are drawn.
"""


def _tell(lines: Iterable[str]) -> None:
    for line in lines:
        note(f"refcodec: {line}")


def _gaussians(arguments: argparse.Namespace) -> int:
    import json

    from ..rendering.camera import CAMERA_MAX, read_camera
    from ..rendering.gaussians import gaussians_document, gaussians_of

    output = Path(arguments.output)
    check_file(output, Kind.signed("a list of Gaussians", b'{"gaussians":'))
    check_apart([output], [arguments.file, arguments.camera])
    try:
        with open(arguments.camera, "rb") as file:
            camera = read_camera(file.read(CAMERA_MAX + 1))
    except ValueError as error:
        raise UsageError(f"{arguments.camera} is not a camera: {error}; vectors/README.md describes one") from None
    scene = parse_file(arguments, read_bounded(arguments)).scene
    visible = gaussians_of(scene, camera)
    write_file(output, json.dumps(gaussians_document(visible), separators=(",", ":")).encode())
    return 0


def _render(arguments: argparse.Namespace) -> int:
    try:
        from ..rendering.camera import OWN
        from ..rendering.images import ORBIT, ImageFolder
        from ..rendering.view import View, eight_bits, orbit_name, own_camera
    except ModuleNotFoundError as error:
        raise needs("render", "render", error, RENDER_PACKAGES) from None
    note_compiling()
    shown = read_shown(arguments)
    inputs: list[str | Path] = [arguments.file]
    notes: list[str] = []
    orbit = arguments.cameras == "orbit"
    cameras: list[Camera] = []
    if orbit:
        names = [orbit_name(number) for number in range(arguments.frames)]
    elif arguments.cameras == "default":
        names = [OWN]
    else:
        photographs, notes = photographs_as_trained(arguments, arguments.cameras, render_info(shown), camera_of(shown))
        cameras = [p.camera for p in (*photographs.test, *photographs.train)]
        names = [camera.name for camera in cameras]
        inputs += photographs.places()
    folder = Path(arguments.output)
    images = ImageFolder(folder, names, orbit, inputs)
    _tell(notes)
    view = View(parse_file(arguments, shown).scene if isinstance(shown, bytes) else shown)
    cameras = cameras or (view.orbit(arguments.frames) if orbit else [own_camera(view.camera)])
    frames = []
    with images, progress_bar(arguments.progress) as progress:
        for number, camera in enumerate(cameras):
            progress("images", number, len(cameras))
            try:
                image = view.draw(camera)
            except ValueError as error:
                raise UsageError(f"{arguments.file} cannot be drawn: {error}") from None
            images.add(image)
            if orbit:
                frames.append(eight_bits(image))
        if orbit:
            images.animate(frames)
        progress("images", len(cameras), len(cameras))
    say(f"{folder}: {counted(len(cameras), 'image')}" + (f", {ORBIT}" if orbit else ""))
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

    from ..bitstream.scene import Scene

    try:
        from ..evaluate.evaluation import compared_of, evaluate, table
        from ..photographs.cameras import PhotographError
        from ..rendering.images import ImageFolder
    except ModuleNotFoundError as error:
        raise needs("eval", "render", error, RENDER_PACKAGES) from None
    note_compiling()
    shown = read_shown(arguments)
    photographs, notes = photographs_as_trained(arguments, arguments.photographs, render_info(shown), camera_of(shown))
    images = None
    if arguments.images:
        inputs = [arguments.file, arguments.lpips, *photographs.places()]
        names = [p.camera.name for p in compared_of(photographs)]
        images = ImageFolder(Path(arguments.images), names, False, inputs)
    _tell(notes)
    lpips = _lpips(arguments.lpips) if arguments.lpips else None
    if isinstance(shown, Scene):
        shown = encoded(arguments, arguments.file, shown)
    try:
        with images or contextlib.nullcontext(), progress_bar(arguments.progress) as progress:
            result = evaluate(shown, photographs, images.add if images else None, progress, lpips)
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
        writes=True,
    )
    gaussians.add_argument("file", metavar="FILE", help=FILE)
    add_bounds(gaussians)
    gaussians.add_argument("camera", metavar="CAMERA", help="a JSON file with a camera")
    gaussians.add_argument("output", metavar="OUTPUT", help="the file to write")
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
        "FILE is a file or a scene folder. PHOTOGRAPHS is a COLMAP or NeRF folder, whose cameras are drawn at the\n"
        "training size. The images of an orbit are also written as an animation.\n"
        + IMAGES
        + "Needs: pip install 'refcodec[render]'.",
        writes=True,
    )
    render.add_argument("file", metavar="FILE", help=CODED_OR_PLAIN)
    add_bounds(render)
    render.add_argument("-o", "--output", metavar="DIR", required=True, help="folder of the images")
    render.add_argument(
        "--cameras",
        metavar="default|orbit|PHOTOGRAPHS",
        default="default",
        help="which cameras (default: that of the file)",
    )
    render.add_argument(
        "--size",
        metavar="WxH",
        help="with PHOTOGRAPHS: image size, longest side, or full for unscaled (default: the training size)",
    )
    render.add_argument(
        "--frames", type=positive, metavar="N", default=60, help="number of images of an orbit (default: %(default)s)"
    )
    evaluate = add_command(
        commands,
        "eval",
        _eval,
        "compare the images of a file with photographs",
        [
            "eval scene.c3gs photographs",
            "eval scene photographs",
            "eval scene.c3gs photographs --size 400x300 --json",
        ],
        "FILE is a file, a scene folder, which is encoded first, or the folder of an uncompressed scene.\n"
        "The photographs are those that training holds out: the test set of the data set, or every eighth one.\n"
        "Their size is the training size, from training.json in the scene folder or else from the scene's camera.\n"
        "training.json also states which photographs were held out. For a file, eval prints its own choice.\n"
        + IMAGES
        + "Needs: pip install 'refcodec[render]'.",
        writes=True,
    )
    evaluate.add_argument("file", metavar="FILE", help=CODED_OR_PLAIN)
    add_bounds(evaluate)
    evaluate.add_argument("photographs", metavar="PHOTOGRAPHS", help=PHOTOGRAPHS)
    evaluate.add_argument(
        "--size",
        metavar="WxH",
        help="size to which photographs are averaged down, longest side, or full for unscaled (default: the training "
        "size)",
    )
    evaluate.add_argument(
        "--background",
        metavar="C",
        help="colour behind transparent photographs: white, black or R,G,B (default: the scene's background)",
    )
    evaluate.add_argument(
        "--holdout",
        type=whole,
        metavar="N",
        help="compare every N-th photograph, or all with 0, unless the data set has a split (default: as in the "
        "training of a scene folder, else 8)",
    )
    evaluate.add_argument("--images", metavar="DIR", help="write the compared images to this folder, as PNG files")
    evaluate.add_argument(
        "--lpips",
        metavar="WEIGHTS",
        help="also compute LPIPS, with a weights file of python -m refcodec.evaluate.lpips_weights",
    )
    evaluate.add_argument("--json", action="store_true", help="print all figures as JSON, including each image")
