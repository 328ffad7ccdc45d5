"""Draw files, and compare them with photographs."""

from __future__ import annotations

import contextlib
import json as json_text
import os
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from ..files.outputs import Kind
from ..files.stage import write_file
from ..files.text import counted, printable
from ..statuses import UsageError, refusing
from . import kinds
from .command import ReadingWords, Report, apply_only, command

if TYPE_CHECKING:
    from ..rendering.camera import Camera
    from .scenes import Scene


@command(operands=("output",), writes=True)
def gaussians(file: kinds.Place, camera: kinds.AnyPath, output: kinds.AnyPath, **words: Unpack[ReadingWords]) -> None:
    """Write the Gaussians that a camera sees (SPEC.md 14.3) as JSON.

    CAMERA is a JSON object. vectors/README.md describes it.

    Args:
        camera: a JSON file with a camera.
        output: the file to write.

    Examples:
        gaussians scene.c3gs camera.json gaussians.json
    """
    from ..bitstream.codec import parse
    from ..folder.places import SPLAT_COPIES, check_outputs, progress_bar, read_whole
    from ..rendering.gaussians import gaussians_document, gaussians_of

    check_outputs([file, camera], (output, Kind.signed("a list of Gaussians", b'{"gaussians":')))
    seen_by = _camera(camera)
    data = read_whole(file, words, gaussians=SPLAT_COPIES)
    with progress_bar(words) as show:
        visible = gaussians_of(parse(data, progress=show).scene, seen_by)
    write_file(Path(output), json_text.dumps(gaussians_document(visible), separators=(",", ":")).encode())


def _camera(place: kinds.AnyPath) -> Camera:
    """Returns the camera of a JSON file. Raises UsageError and OSError."""
    from ..rendering.camera import CAMERA_MAX, read_camera

    try:
        with open(place, "rb") as stored:
            return read_camera(stored.read(CAMERA_MAX + 1))
    except ValueError as error:
        shown = f"{os.fspath(place)} is not a camera: {error}"
        raise UsageError(f"{shown}; vectors/README.md describes one") from None


@command("render", writes=True)
def render(
    file: kinds.Place | Scene,
    output: kinds.Folder,
    *,
    cameras: kinds.Cameras = "default",
    size: kinds.Size | None = None,
    frames: kinds.Frames = 60,
    **words: Unpack[ReadingWords],
) -> Report:
    """Draw a file.

    FILE is a file or a scene folder. PHOTOGRAPHS is a COLMAP or NeRF folder, whose cameras are drawn at the
    training size. The images of an orbit are also written as an animation. With CAMERA.json, which vectors/README.md
    describes, the output is one file: a PFM image of floats before any conversion (SPEC.md 14.5).
    An image has the name of its camera, including folders, with the suffix .png, which is appended to the camera's
    own suffix if names would collide. Images are marked as written by refcodec, and only such images are replaced.
    They appear in DIR when all are drawn.
    Needs: pip install 'refcodec[render]'.

    Args:
        file: a C3GS file, or the folder of an uncompressed scene.
        output: folder of the images, or the PFM file.
        cameras: which cameras (default: that of the file).
        frames: number of images of an orbit.

    Examples:
        render scene.c3gs -o images
        render scene.c3gs --cameras orbit -o images
        render scene.c3gs --cameras photographs -o images
        render scene.c3gs --cameras camera.json -o image.pfm
    """
    from ..bitstream.bounds import DRAWING
    from ..folder.places import check_outputs, progress_bar
    from ..rendering.camera import OWN
    from ..rendering.images import ORBIT, PFM, ImageFolder
    from ..rendering.view import View, eight_bits, foreign_colours, orbit_name, own_camera, pfm
    from .shown import Shown, note_compiling

    note_compiling()
    shown = Shown(file, words, program=DRAWING)
    inputs: list[str | Path | None] = [shown.folder or shown.name]
    notes: list[str] = []
    orbit, stated = cameras == "orbit", os.fspath(cameras).lower().endswith(".json")
    if cameras in ("default", "orbit") or stated:
        apply_only({"size": size}, ("size",), "photographs: omit it")
    chosen: list[Camera] = []
    if stated:
        check_outputs([*inputs, cameras], (output, PFM))
        camera = _camera(cameras)
        with refusing(f"{shown.name} cannot be drawn"):
            write_file(Path(output), pfm(View(shown.scene).blended(camera)))
        return Report([f"{os.fspath(output)}: an image of floats, before any conversion"])
    if orbit:
        names = [orbit_name(number) for number in range(frames)]
    elif cameras == "default":
        names = [OWN]
    else:
        photographs, notes = shown.photographs(cameras, {"size": size})
        chosen = [p.camera for p in (*photographs.test, *photographs.train)]
        names = [camera.name for camera in chosen]
        inputs += photographs.places()
    images = ImageFolder(Path(output), names, orbit, inputs)
    shown.remark(*notes)
    view = View(shown.scene)
    shown.remark(*foreign_colours(view.info))
    chosen = chosen or (view.orbit(frames) if orbit else [own_camera(view.camera)])
    drawn = []
    with images, progress_bar(words) as show, refusing(f"{shown.name} cannot be drawn"):
        for number, camera in enumerate(chosen):
            show("images", number, len(chosen))
            image = view.draw(camera)
            images.add(image)
            if orbit:
                drawn.append(eight_bits(image))
        if orbit:
            images.animate(drawn)
        show("images", len(chosen), len(chosen))
    return Report([f"{os.fspath(output)}: {counted(len(chosen), 'image')}" + (f", {ORBIT}" if orbit else "")])


@command({"torch": "lpips", "": "render"}, writes=True)
def evaluate(
    file: kinds.Place | Scene,
    photographs: kinds.AnyPath,
    *,
    size: kinds.Size | None = None,
    background: kinds.Colour | None = None,
    holdout: kinds.Count | None = None,
    images: kinds.Folder | None = None,
    lpips: kinds.FilePath | None = None,
    json: bool = False,
    **words: Unpack[ReadingWords],
) -> Report:
    """Compare the images of a file with photographs.

    FILE is a file, a scene folder, which is encoded first, or the folder of an uncompressed scene.
    The photographs are those that training holds out: the test set of the data set, or every eighth one.
    Their size is the training size, from training.json in the scene folder or else from the scene's camera.
    training.json also states which photographs were held out. For a file, eval prints its own choice.
    psnr_cc is PSNR after the best gain and offset of each channel of each image. No figure counts masked pixels.
    An image has the name of its camera, including folders, with the suffix .png, which is appended to the camera's
    own suffix if names would collide. Images are marked as written by refcodec, and only such images are replaced.
    They appear in DIR when all are drawn.
    Needs: pip install 'refcodec[render]'.

    Args:
        file: a C3GS file, or the folder of an uncompressed scene.
        background: colour behind transparent photographs: white, black or R,G,B (default: the scene's background).
        holdout: compare every N-th photograph, or all with 0, unless the data set has a split (default: as in the
            training of a scene folder, else 8).
        images: write the compared images to this folder, as PNG files.
        lpips: also compute LPIPS, with a weights file of python -m refcodec.evaluate.lpips_weights.
        json: print all figures as JSON, including each image.

    Examples:
        eval scene.c3gs photographs
        eval scene photographs
        eval scene.c3gs photographs --size 400x300 --json

    Returns:
        A report whose `values` are the figures.
    """
    from ..bitstream.bounds import DRAWING
    from ..evaluate.evaluation import compared_of, evaluate, table
    from ..folder.places import progress_bar
    from ..rendering.images import ImageFolder
    from .shown import Shown, note_compiling

    note_compiling()
    shown = Shown(file, words, program=DRAWING)
    stated = {"size": size, "background": background, "holdout": holdout}
    compared, notes = shown.photographs(photographs, stated, compared=True)
    folder, weights = None, None if lpips is None else os.fspath(lpips)
    if images:
        names = [p.camera.name for p in compared_of(compared)]
        folder = ImageFolder(Path(images), names, False, [shown.folder or shown.name, weights, *compared.places()])
    shown.remark(*notes)
    measure = None
    if weights:
        from ..evaluate.lpips import Lpips

        with refusing():
            measure = Lpips(weights)
    data = shown.uncompressed or shown.file()
    drawn = refusing(f"{shown.name} cannot be drawn")
    with drawn, folder or contextlib.nullcontext(), progress_bar(words) as show:
        result = evaluate(data, compared, folder.add if folder else None, show, measure)
    result = {"file": shown.name, **result}
    lines = json_text.dumps(result, indent=1).splitlines() if json else [*map(printable, table(result))]
    return Report(lines, result)
