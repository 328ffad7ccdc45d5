"""Write scenes for other programs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack

from ..export import DEGREE, ITERATIONS, VIEWERS
from ..files.outputs import check_apart, check_file
from ..files.stage import Stage, write_file
from ..files.text import counted
from ..statuses import UsageError, refusing
from . import kinds
from .command import ReadingWords, Report, apply_only, command

if TYPE_CHECKING:
    from ..bitstream.batches import Progress
    from ..formats.splats import Splats
    from ..rendering.camera import Camera
    from .scenes import Scene
    from .shown import Shown

_PAGE, _GLB, _C3GS = ".html", ".glb", ".c3gs"
# The copies of a scene that an export holds: the Gaussians of many views and their harmonics.
EXPORT_COPIES = 75


class ExportWords(ReadingWords, total=False):
    """How a scene is written.

    Args:
        glb: what a .glb contains: plain Gaussians, or for a static scene FILE itself, or both (default: plain).
        degree: degree of the spherical harmonics, by which colours depend on the direction (default: 3).
        cameras: fit to the cameras of a folder of photographs; in Python also a list of refcodec.Camera.
        size: with --cameras or --photographs: size of the photographs: WxH, longest side, or full for unscaled
            (default: the training size).
        photographs: add up to 8 held-out photographs to the page, to compare with the scene.
        iterations: least-squares steps on the images, after the fit of each Gaussian by itself (default: 10).
        spz_bits: bits of the harmonics in .spz; fewer make a smaller, less accurate file (default: 7).
    """

    glb: Literal["plain", "c3gs", "both"]
    degree: kinds.Degree | None
    cameras: kinds.FitCameras | Sequence[Camera] | None
    size: kinds.Size | None
    photographs: kinds.AnyPath | None
    iterations: kinds.Count | None
    spz_bits: kinds.SpzBits | None


@command("render", writes=True)
def export(
    file: kinds.Place | Scene, output: Sequence[kinds.AnyPath] | kinds.AnyPath, **words: Unpack[ExportWords]
) -> Report:
    """Write a scene for other programs.

    FILE is a file or a scene folder. The suffix of OUTPUT selects the format:

      .ply  Gaussians as the 3DGS code writes them. Every splat program reads them.
      .spz  Niantic's format: fixed point, compressed with gzip
      .sog  PlayCanvas's format: images in an archive
      .glb  glTF 2.0 with KHR_gaussian_splatting. The scene stands upright.
      .compressed.ply  PlayCanvas's format: numbers of 8 to 11 bits in the ranges of 256 Gaussians
      .html a page that draws FILE itself in any browser. It contains FILE, which can be saved from it, and makes no
            requests. Splats of the same command are in the page as well, to be saved, with their sizes.

    --photographs adds photographs to a page for comparison. The rest of this text is about splats.

    Other programs make each Gaussian larger by a filter of their own, in 3DGS of 0.3 square pixels. FILE may state less
    (low_pass): with 0.1, a picture by 3DGS loses 1.4 dB, and 4.8 at half the size (docs/programs.md). A .glb is sorted
    by the distance from the camera, and FILE by depth.

    A static scene has ordinary Gaussians, which are written as they are: .ply and .glb lose nothing, .spz and .sog what
    the format loses. The options of the fit do not apply.

    The Gaussians of any other scene depend on the camera. An ordinary splat has one fixed set, with spherical harmonics
    for the colours. It is fitted to the views of these cameras:

      - with --cameras PHOTOGRAPHS, a COLMAP or NeRF folder, the training cameras
      - else the cameras of FILE, if there are 8 or more; train keeps 16, spread as far as possible
      - else 64 cameras around the scene, where its networks were not trained

    3DGS, Spark and three.js add 0.3 square pixels to each Gaussian. The fit is made for them. The command reports the
    PSNR of the splat in dB as 3DGS draws it, on views that the fit did not use. With cameras of FILE, these lie between
    each camera and its nearest.
    Gaussians that contribute less than a tenth of a pixel to every view are dropped.
    Beside the splats stands a cameras.json as 3DGS writes it, from which `refcodec convert` measures: the cameras of
    --cameras, or those of FILE if there are 8 or more. No other file is replaced by it.
    The fit and .sog need: pip install 'refcodec[render]'.

    A static scene can be carried in a .glb as it is: --glb c3gs writes FILE itself by the extension
    KHR_gaussian_splatting_compression_c3gs, and --glb both adds plain Gaussians for readers without this extension. If
    FILE is such a .glb, an OUTPUT with the suffix .c3gs gets the scene that it contains.

    Args:
        file: a C3GS file, or the folder of an uncompressed scene.
        output: the file to write; repeatable, and all splats of a command share one fit.

    Examples:
        export scene.c3gs -o scene.ply
        export scene.c3gs -o scene.spz --cameras photographs
        export scene.c3gs -o scene.sog -o scene.glb --degree 1
        export static.c3gs -o scene.glb --glb c3gs
        export scene.glb -o static.c3gs
        export scene.c3gs -o scene.html --photographs photographs
        export scene.c3gs -o scene.html -o scene.spz -o scene.ply

    Returns:
        A report whose `values` have `splats`, the written Gaussians (refcodec.Splats), which is also made without an
        output.
    """
    from ..folder.places import check_outputs, shown_name
    from ..viewer.page import PAGE
    from .viewing import write_page

    paths, name = _paths(output), shown_name(file)
    if words.get("glb", "plain") != "plain" or name.lower().endswith(_GLB):
        return _carried(file, paths, words)
    pages = [path for path in paths if path.suffix.lower() == _PAGE]
    splats = [path for path in paths if path not in pages]
    if len(pages) > 1:
        raise UsageError("a command writes one page")
    if words.get("photographs") is None and words.get("cameras") is None:
        apply_only(words, ("size",), "photographs: omit it")
    if pages:
        check_outputs([file, words.get("photographs")], (pages[0], PAGE))
    else:
        apply_only(words, ("photographs",), f"{_PAGE} outputs: use --cameras for splats")
    if pages and not splats:
        apply_only(words, ("glb", "degree", "cameras", "iterations", "spz_bits"), "splats: omit it for a page")
        return write_page(_shown(file, words), pages[0], words)
    _check_splats(file, splats, _PAGE)
    if not any(path.suffix.lower() == ".spz" for path in splats):
        apply_only(words, ("spz_bits",), ".spz outputs: omit it")
    shown = _shown(file, words)
    report = _write_splats(shown, splats, words, beside=True)
    if not pages:
        return report
    beside = dict(zip(splats, report.values["psnr"] or [None] * len(splats), strict=True))
    return replace(report, lines=[*report.lines, *write_page(shown, pages[0], words, beside).lines])


def _shown(file: kinds.Place | Scene, words: ExportWords) -> Shown:
    """Returns the scene of an export."""
    from ..bitstream.bounds import DRAWING
    from .shown import Shown

    return Shown(file, words, EXPORT_COPIES, DRAWING)


def _paths(output: Sequence[kinds.StrPath] | kinds.StrPath) -> list[Path]:
    return [*map(Path, [output] if isinstance(output, str | os.PathLike) else output)]


def decode_splats(file: kinds.Place, output: Sequence[kinds.StrPath] | kinds.StrPath, words: ReadingWords) -> Report:
    """Writes the splat files of `decode`: the Gaussians of a static scene."""
    from ..rendering.gaussians import check_static
    from .shown import Shown

    paths = _paths(output)
    _check_splats(file, paths)
    shown = Shown(file, words)
    check_static(shown.render)
    return _write_splats(shown, paths, {**words})


def _check_splats(file: object, paths: list[Path], *others: str) -> None:
    """Raises UsageError if a file has an unknown suffix, or is not free. others: more suffixes that are allowed."""
    from ..folder.places import check_outputs
    from ..formats.table import FORMATS, suffix_of

    files = [(path, suffix_of(path)) for path in paths]
    for path, suffix in files:
        if suffix is None:
            raise UsageError(f"{path} has an unknown suffix; allowed are {', '.join([*FORMATS, *others])}")
    check_outputs([file], *((path, FORMATS[suffix].kind) for path, suffix in files if suffix))


def _write_splats(shown: Shown, paths: list[Path], words: ExportWords, beside: bool = False) -> Report:
    """Writes the Gaussians of a scene: those of a static scene as they are, or those of a fit.

    beside: whether cameras are written beside them.
    """
    from ..bitstream.dimensions import STATIC
    from ..folder.places import progress_bar
    from ..formats.common import BITS, Options
    from ..formats.table import FORMATS, suffix_of, write_splats
    from ..rendering.gaussians import check_render_model, static_splats
    from .scenes import read_only

    check_render_model(shown.render)
    if shown.render.render_model == STATIC:
        for word in ("degree", "cameras", "iterations"):
            if words.get(word) is not None:
                raise UsageError(f"{shown.name} is a static scene, which needs no fit: omit --{word}")
        splats, measure, views = static_splats(shown.coded()), None, ""
        cameras: Sequence[Camera] = _own_cameras(shown)
        if abs((own := shown.render.low_pass) - VIEWERS) > 1e-3:
            shown.remark(
                f"viewers of splats add {VIEWERS} square pixels to a Gaussian, this scene is made for {own:.3g}: they "
                "show it otherwise, most of all in small pictures (docs/programs.md)"
            )
        count = counted(len(splats.mean), "Gaussian")
    else:
        splats, kept, measure, views, cameras = _fit(shown, paths, words)
        count = f"{len(splats.mean):,} of {kept:,} Gaussians"
    bits, suffixes = words.get("spz_bits") or BITS, [suffix_of(path) or "" for path in paths]
    with refusing(f"{shown.name} cannot be exported"), progress_bar(words) as show:
        options = Options(shown.up, shown.render, bits)
        files = [write_splats(splats, suffix, options) for suffix in suffixes]
        # The written numbers are measured.
        near = [measure(FORMATS[s].read(file), show) for s, file in zip(suffixes, files, strict=True) if measure]
    lines = []
    for number, (path, file) in enumerate(zip(paths, files, strict=True)):
        size, *more = _sizes(path, splats, file, shown, bits)
        lines += [f"{path}: {count}, degree {splats.degree}, {size}", *more]
        lines += [f"PSNR to the scene, in viewers: {near[number]:.2f} dB over {views}"] if measure else []
    with Stage() as stage:
        for path, file in zip(paths, files, strict=True):
            stage.write(path, file)
        for place, data, line in _cameras_beside(paths, cameras) if beside else ():
            lines.append(line)
            if data:
                stage.write(place, data)
    return Report(lines, {"splats": read_only(splats), "psnr": near})


def _own_cameras(shown: Shown) -> list[Camera]:
    """Returns the cameras of a scene if they show from where it is viewed."""
    from ..export.views import FEW
    from ..rendering.camera import default_camera

    return [replace(default_camera(c), name=c.name) for c in shown.cameras] if len(shown.cameras) >= FEW else []


def _cameras_beside(paths: list[Path], cameras: Sequence[Camera]) -> Iterator[tuple[Path, bytes, str]]:
    """Yields the cameras.json of each folder of splats: its place, its content, empty if it must stay, and a line."""
    from ..convert.notes import CAMERAS_FILE, WRITTEN, cameras_json, read_cameras_of

    for folder in dict.fromkeys(path.parent for path in paths) if cameras else ():
        place, names = folder / CAMERAS_FILE, [path.name for path in paths if path.parent == folder]
        try:
            check_file(place, WRITTEN)
            others = read_cameras_of(place)[1] if place.is_file() and place.stat().st_size else []
            held = [name for name in others if name not in names and (folder / name).exists()]
            problem = f"it is of {', '.join(held)}" if held else ""
        except UsageError as error:
            problem = str(error)
        if problem:
            hint = "the cameras of the scene are for `refcodec convert --cameras FILE`"
            yield place, b"", f"{place} is not replaced ({problem}): {hint}"
        else:
            line = f"{place}: {counted(len(cameras), 'camera')}, from which `refcodec convert` measures"
            yield place, cameras_json(cameras, names), line


def _fit(
    shown: Shown, paths: list[Path], words: ExportWords
) -> tuple[Splats, int, Callable[[Splats, Progress], float], str, Sequence[Camera]]:
    """Returns Gaussians that are fitted to views, and the number that the scene keeps.

    Also returns a function that measures the PSNR of written Gaussians to the scene, in dB, its views in words, and the
    cameras from which people look.
    """
    from ..export.fit import agreement, fit
    from ..export.views import Views, sized, views_of
    from ..folder.places import progress_bar
    from ..rendering.camera import check_camera
    from ..rendering.view import View
    from .shown import note_compiling

    note_compiling()
    view, cameras = View(shown.scene), words.get("cameras")
    if cameras is None:
        stated: Sequence[Camera] = _own_cameras(shown)
        views = views_of(view, shown.cameras)
        if len(views.fit) and "around" in views.source:
            shown.remark(f"the views are {views.source}; --cameras PHOTOGRAPHS fits to cameras of photographs instead")
    elif isinstance(cameras, str | os.PathLike):
        pictured, notes = shown.photographs(cameras, {"size": words.get("size")})
        shown.remark(*notes)
        check_apart(paths, pictured.places())
        stated = [p.camera for p in (*pictured.train, *pictured.test)]
        train, test = ([sized(p.camera) for p in some] for some in (pictured.train, pictured.test))
        views = Views(train or test, test or train, f"{len(train)} cameras of photographs")
    else:
        for camera in cameras:
            check_camera(camera)
        if not cameras:
            raise UsageError("cameras is empty: give some, or None for those of the file")
        stated = cameras
        views = Views([*map(sized, cameras)], [*map(sized, cameras)], counted(len(cameras), "camera"))
    degree, iterations = words.get("degree"), words.get("iterations")
    with progress_bar(words) as show, refusing(f"{shown.name} cannot be exported"):
        steps = ITERATIONS if iterations is None else iterations
        fitted = fit(view, views.fit, DEGREE if degree is None else degree, steps, show)

    def measure(splats: Splats, show: Progress) -> float:
        return agreement(view, splats, views.test, show)

    return fitted.splats, fitted.of, measure, f"{len(views.test)} views, fitted to {views.source}", stated


def _sizes(path: Path, splats: Splats, file: bytes, shown: Shown, bits: int) -> list[str]:
    """Returns the lines about the size of a written file; for .spz also the size with other bits of harmonics."""
    from ..formats.common import BITS, BITS_MOST, Options
    from ..formats.table import write_splats

    size = f"{len(file):,} bytes"
    if shown.data is not None:
        size += f", {shown.name} has {len(shown.data):,}"
    if path.suffix.lower() != ".spz" or not splats.degree:
        return [size]
    other = BITS if bits == BITS_MOST else BITS_MOST
    with_other = len(write_splats(splats, ".spz", Options(spz_bits=other)))
    return [size, f"its harmonics have {bits} bits; with {other} (export --spz-bits) it has {with_other:,} bytes"]


def _carried(file: kinds.Place | Scene, paths: list[Path], words: ExportWords) -> Report:
    """Writes a GLB file that contains a static scene as C3GS, or the C3GS file that a GLB file contains."""
    from ..folder.places import C3GS, check_outputs, shown_name
    from ..formats.common import check_colours
    from ..formats.glb import glb_bytes
    from ..formats.table import FORMATS, carried_scene
    from ..rendering.gaussians import check_static, static_splats

    apply_only(words, ("degree", "cameras", "size", "photographs", "iterations", "spz_bits"), "made Gaussians: omit it")
    name = shown_name(file)
    inside, form = name.lower().endswith(_GLB), words.get("glb", "plain")
    suffix, reason = (_C3GS, f"{name} is a .glb") if inside else (_GLB, f"--glb {form} is given")
    if len(paths) != 1 or paths[0].suffix.lower() != suffix:
        raise UsageError(f"{reason}, so the output must be one {suffix} file")
    check_outputs([file], (paths[0], C3GS if inside else FORMATS[_GLB].kind))
    if inside:
        data = carried_scene(Path(name))
        if not C3GS.begins.match(data):
            raise UsageError(f"the scene in {name} is not a C3GS file")
        write_file(paths[0], data)
        return Report([f"{paths[0]}: {len(data):,} bytes; `refcodec validate` checks them"])
    shown = _shown(file, words)
    check_static(shown.render)
    scene, data = shown.coded(), shown.file()
    with refusing(f"{name} cannot be exported"):
        check_colours(scene.render)
        splats = static_splats(scene)
        if not len(splats.mean):
            raise ValueError("it has no Gaussians")
        made = glb_bytes(splats, shown.up, data, plain=form == "both")
    write_file(paths[0], made)
    share = f"{len(data):,} of them the scene as C3GS"
    return Report([f"{paths[0]}: {len(splats.mean):,} Gaussians, {len(made):,} bytes, {share}"])
