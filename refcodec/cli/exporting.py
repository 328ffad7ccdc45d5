"""The command that writes a scene for other programs, export, and the splats of decode."""

# Modules that need NumPy are imported where they are used, so that help is instant.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..export import DEGREE, ITERATIONS
from ..files.outputs import check_apart, check_file
from ..files.stage import write_file
from ..files.terminal import note, say
from .bounds import add_bounds, check_bounds, read_bounded
from .carrying import GLB_SUFFIX, PLAIN, add_glb, export_carried
from .shared import (
    CODED_OR_PLAIN,
    RENDER_PACKAGES,
    UsageError,
    add_command,
    counted,
    needs,
    note_compiling,
    parse_file,
    progress_bar,
    whole,
)
from .shown import camera_of, photographs_as_trained, read_shown, render_info
from .viewing import PAGE_SUFFIX, add_photographs, export_page

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..bitstream.cameras import NamedCamera
    from ..bitstream.header import RenderInfo
    from ..bitstream.scene import Scene
    from ..export.views import Views
    from ..folder.uncompressed import Uncompressed
    from ..formats.splats import Splats
    from ..rendering.view import View

NOTES = """\
FILE is a file or a scene folder. The suffix of OUTPUT selects the format:

  .ply  Gaussians as the 3DGS code writes them. Every splat program reads them.
  .spz  Niantic's format: fixed point, compressed with gzip
  .sog  PlayCanvas's format: images in an archive
  .glb  glTF 2.0 with KHR_gaussian_splatting. The scene stands upright.
  .compressed.ply  PlayCanvas's format: numbers of 8 to 11 bits in the ranges of 256 Gaussians
  .html a page that draws FILE itself in any browser. It contains FILE and makes no requests.

--photographs adds photographs to a page for comparison. The rest of this text is about splats.

A static scene has ordinary Gaussians, which are written as they are: .ply and .glb lose nothing, .spz and .sog what the
format loses. The options of the fit do not apply.

The Gaussians of any other scene depend on the camera. An ordinary splat has one fixed set, with spherical harmonics for
the colours. It is fitted to the views of these cameras:

  - with --cameras PHOTOGRAPHS, a COLMAP or NeRF folder, the training cameras
  - else the cameras of FILE, if there are 8 or more; train keeps 16, spread as far as possible
  - else 64 cameras around the scene, where its networks were not trained

The command reports the PSNR of the splat in dB, measured on views that the fit did not use. With cameras of FILE, these
lie between each camera and its nearest.
Gaussians that contribute less than a tenth of a pixel to every view are dropped.
The fit and .sog need: pip install 'refcodec[render]'.

A static scene can be carried in a .glb as it is: --glb c3gs writes FILE itself by the extension
KHR_gaussian_splatting_compression_c3gs, and --glb both adds plain Gaussians for readers without this extension. If FILE
is such a .glb, an OUTPUT with the suffix .c3gs gets the scene that it contains.

With --scaffold, OUTPUT is a folder that the code of Scaffold-GS loads. It shows the same Gaussians as FILE.
Needs: pip install 'refcodec[fit]'."""


def _views(
    arguments: argparse.Namespace, shown: bytes | Scene | Uncompressed, view: View, stated: list[NamedCamera]
) -> tuple[Views, list[str | Path]]:
    """Returns the views of the fit, and the files read for them. Raises UsageError."""
    from ..export.views import Views, sized, views_of

    if arguments.cameras is None:
        views = views_of(view, stated)
        if len(views.fit) and "around" in views.source:
            note(
                f"refcodec: the views are {views.source}; --cameras PHOTOGRAPHS fits to cameras of photographs instead"
            )
        return views, []
    pictured, notes = photographs_as_trained(arguments, arguments.cameras, render_info(shown), camera_of(shown))
    for line in notes:
        note(f"refcodec: {line}")
    fit, test = ([sized(p.camera) for p in photographs] for photographs in (pictured.train, pictured.test))
    return Views(fit or test, test or fit, f"{len(fit)} cameras of photographs"), [*pictured.places()]


def _scaffold(arguments: argparse.Namespace, folder: Path) -> int:
    """Writes a Scaffold-GS folder."""
    # torch by itself may take more memory than the caller allows.
    check_bounds(arguments, arguments.file, 0, 0)
    try:
        # The networks are written with torch. If it is missing, this fails before the work.
        import torch  # noqa: F401

        from ..export.scaffold import FILES, check_folder, lattice_edge, scaffold_files, write_folder
    except ModuleNotFoundError as error:
        raise needs("export --scaffold", "fit", error, ("torch",)) from None
    from ..bitstream.reconstruction import reconstruct
    from ..bitstream.scene import Scene
    from ..rendering.view import stated_cameras

    check_folder(folder)
    check_apart([folder / file for file in FILES], [arguments.file])
    shown = read_shown(arguments)
    scene = parse_file(arguments, shown).scene if isinstance(shown, bytes) else shown
    values = reconstruct(scene) if isinstance(scene, Scene) else scene.values
    voxel = lattice_edge(scene) if isinstance(scene, Scene) else scene.voxel
    files = scaffold_files(values, scene.masks, scene.networks, scene.render, stated_cameras(scene), voxel)
    if scene.render.background not in ((0, 0, 0), (255, 255, 255)):
        note("refcodec: Scaffold-GS has only black and white backgrounds; the folder states black")
    write_folder(files, folder)
    say(f"{folder}: {scene.anchor_count:,} anchors, {sum(map(len, files.values())):,} bytes")
    return 0


def decode_splats(arguments: argparse.Namespace) -> int:
    """Writes the splat files of decode: the Gaussians of a static scene."""
    from ..bitstream.codec import parse_container
    from ..rendering.gaussians import check_static

    outputs = _splat_outputs(arguments.splat, arguments.file)
    data = read_bounded(arguments)
    check_static(parse_container(data).render)
    return _write_static(arguments, outputs, data, parse_file(arguments, data).scene)


def _splat_outputs(names: list[str], file: str, *others: str) -> list[Path]:
    """Returns the splat files to write. others: more suffixes that the command takes.

    Raises UsageError if a file has an unknown suffix, or is not free.
    """
    from ..formats.table import FORMATS, suffix_of

    outputs = [Path(name) for name in names]
    for output in outputs:
        suffix = suffix_of(output)
        if suffix is None:
            raise UsageError(f"{output} has an unknown suffix; allowed are {', '.join([*FORMATS, *others])}")
        check_file(output, FORMATS[suffix].kind)
    check_apart(outputs, [file])
    return outputs


def _write_static(
    arguments: argparse.Namespace, outputs: list[Path], shown: bytes | Scene | Uncompressed, scene: Scene | Uncompressed
) -> int:
    """Writes the Gaussians of a static scene. shown: as read_shown returns it."""
    from ..bitstream.cameras import cameras
    from ..bitstream.scene import Scene
    from ..rendering.camera import scene_up
    from ..rendering.gaussians import static_splats

    if not isinstance(scene, Scene):
        raise UsageError(f"{arguments.file} is the folder of an uncompressed static scene: encode it first")
    splats = static_splats(scene)
    up = scene_up(scene.render.up_axis, cameras(scene.ancillary))
    files = _files(arguments, outputs, splats, up, scene.render)
    for output, each in zip(outputs, files, strict=True):
        write_file(output, each)
        said = f"{output}: {counted(len(splats.mean), 'Gaussian')}, degree {splats.degree}, "
        say(said + _size(arguments, output, splats, each, shown), lines=True)
    return 0


def _files(
    arguments: argparse.Namespace, outputs: list[Path], splats: Splats, up: NDArray[np.float64], render: RenderInfo
) -> list[bytes]:
    """Returns the files of Gaussians. Raises UsageError if a format cannot hold them or needs a missing package."""
    from ..formats.common import Options
    from ..formats.table import FORMATS, suffix_of, write_splats

    options, suffix, files = Options(up, render, _spz_bits(arguments)), "", []
    try:
        for output in outputs:
            suffix = suffix_of(output) or ""
            files.append(write_splats(splats, suffix, options))
    except ModuleNotFoundError as error:
        raise needs(f"a {suffix} file", FORMATS[suffix].extra or "render", error, RENDER_PACKAGES) from None
    except ValueError as error:
        raise UsageError(f"{arguments.file} cannot be exported: {error}") from None
    return files


def _is_spz(output: Path) -> bool:
    return output.suffix.lower() == ".spz"


def _spz_bits(arguments: argparse.Namespace) -> int:
    """Returns the bits of harmonics in .spz. decode has no option for them."""
    from ..formats.common import BITS

    return getattr(arguments, "spz_bits", None) or BITS


def _size(
    arguments: argparse.Namespace, output: Path, splats: Splats, file: bytes, shown: bytes | Scene | Uncompressed
) -> str:
    """Returns the text about the size of a written file; for .spz also the size with other bits of harmonics."""
    from ..formats.common import BITS, BITS_MOST, Options
    from ..formats.table import write_splats

    size = f"{len(file):,} bytes"
    if isinstance(shown, bytes):
        size += f", {arguments.file} has {len(shown):,}"
    if not _is_spz(output) or not splats.degree:
        return size
    bits = _spz_bits(arguments)
    other = BITS if bits == BITS_MOST else BITS_MOST
    with_other = len(write_splats(splats, ".spz", Options(spz_bits=other)))
    return f"{size}\nits harmonics have {bits} bits; with {other} (export --spz-bits) it has {with_other:,} bytes"


def _export(arguments: argparse.Namespace) -> int:
    if arguments.glb != PLAIN or Path(arguments.file).suffix.lower() == GLB_SUFFIX:
        return export_carried(arguments)
    pages = [name for name in arguments.output if name.lower().endswith(PAGE_SUFFIX)]
    single = "a Scaffold-GS folder" if arguments.scaffold else "a page" if pages else None
    if single and len(arguments.output) > 1:
        raise UsageError(f"{single} needs its own command: only splats can be several outputs")
    if arguments.scaffold:
        return _scaffold(arguments, Path(arguments.output[0]))
    if pages:
        return export_page(arguments, Path(pages[0]))
    if arguments.photographs is not None:
        raise UsageError(f"--photographs applies only to {PAGE_SUFFIX} outputs: use --cameras for splats")
    from ..bitstream.dimensions import STATIC
    from ..rendering.gaussians import check_render_model

    outputs = _splat_outputs(arguments.output, arguments.file, PAGE_SUFFIX)
    if arguments.spz_bits is not None and not any(_is_spz(output) for output in outputs):
        raise UsageError("--spz-bits applies only to .spz outputs: omit it")
    shown = read_shown(arguments)
    info = render_info(shown)
    check_render_model(info)
    if info.render_model != STATIC:
        return _export_fitted(arguments, outputs, shown)
    given = [name for name in ("degree", "cameras", "iterations") if getattr(arguments, name) is not None]
    if given:
        raise UsageError(f"{arguments.file} is a static scene, which needs no fit: omit --{given[0]}")
    scene = parse_file(arguments, shown).scene if isinstance(shown, bytes) else shown
    return _write_static(arguments, outputs, shown, scene)


def _export_fitted(arguments: argparse.Namespace, outputs: list[Path], shown: bytes | Scene | Uncompressed) -> int:
    """Writes Gaussians that are fitted to the views of a scene. shown: as read_shown returns it."""
    try:
        from ..export.fit import agreement, fit
        from ..rendering.view import View, stated_cameras
    except ModuleNotFoundError as error:
        raise needs("export", "render", error, RENDER_PACKAGES) from None
    from ..formats.table import FORMATS, suffix_of

    degree = DEGREE if arguments.degree is None else arguments.degree
    iterations = ITERATIONS if arguments.iterations is None else arguments.iterations
    note_compiling()
    scene = parse_file(arguments, shown).scene if isinstance(shown, bytes) else shown
    view = View(scene)
    views, places = _views(arguments, shown, view, stated_cameras(scene))
    check_apart(outputs, places)
    try:
        with progress_bar(arguments.progress) as progress:
            fitted = fit(view, views.fit, degree, iterations, progress)
            files = _files(arguments, outputs, fitted.splats, view.up, scene.render)
            read = [FORMATS[suffix_of(output) or ""].read(file) for output, file in zip(outputs, files, strict=True)]
            near = [agreement(view, each, views.test, progress) for each in read]
    except ValueError as error:
        raise UsageError(f"{arguments.file} cannot be exported: {error}") from None
    for output, each, decibels in zip(outputs, files, near, strict=True):
        write_file(output, each)
        size = _size(arguments, output, fitted.splats, each, shown)
        say(
            f"{output}: {len(fitted.splats.mean):,} of {fitted.of:,} Gaussians, degree {degree}, {size}\n"
            f"PSNR to the scene: {decibels:.2f} dB over {len(views.test)} views, fitted to {views.source}",
            lines=True,
        )
    return 0


def add(commands: Any) -> None:
    """Adds the command of this module."""
    export = add_command(
        commands,
        "export",
        _export,
        "write a scene for other programs",
        [
            "export scene.c3gs -o scene.ply",
            "export scene.c3gs -o scene.spz --cameras photographs",
            "export scene.c3gs -o scene.sog -o scene.glb --degree 1",
            "export static.c3gs -o scene.glb --glb c3gs",
            "export scene.glb -o static.c3gs",
            "export scene.c3gs -o model --scaffold",
            "export scene.c3gs -o scene.html --photographs photographs",
        ],
        NOTES,
        writes=True,
    )
    export.add_argument("file", metavar="FILE", help=CODED_OR_PLAIN)
    add_bounds(export)
    export.add_argument(
        "-o",
        "--output",
        metavar="OUTPUT",
        action="append",
        required=True,
        help="the file to write; repeatable, and all splats of a command share one fit",
    )
    export.add_argument("--scaffold", action="store_true", help="write a Scaffold-GS folder")
    add_glb(export)
    export.add_argument(
        "--degree",
        type=int,
        choices=range(4),
        help=f"degree of the spherical harmonics, by which colours depend on the direction (default: {DEGREE})",
    )
    export.add_argument("--cameras", metavar="PHOTOGRAPHS", help="fit to the cameras of a folder of photographs")
    export.add_argument(
        "--size",
        metavar="WxH",
        help="with --cameras or --photographs: size of the photographs, longest side, or full for unscaled (default: "
        "the training size)",
    )
    add_photographs(export)
    export.add_argument(
        "--iterations",
        type=whole,
        metavar="N",
        help=f"least-squares steps on the images, after the fit of each Gaussian by itself (default: {ITERATIONS})",
    )
    export.add_argument(
        "--spz-bits",
        type=int,
        choices=range(4, 9),
        help="bits of the harmonics in .spz; fewer make a smaller, less accurate file (default: 7)",
    )
