"""The formats of splat files. A new format is a module and a row of FORMATS."""

import contextlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..files.outputs import Kind
from ..files.ply import PlyError, property_names
from ..files.present import NotAFileError, is_there, mapped
from ..files.text import counted
from ..folder.georeference import far_offset
from ..folder.layout import SceneFolderError, there
from . import compressed_ply, glb, ply, sog, splat, spz
from .common import ADVICE, ContentError, Data, Options, check_colours, errors_in, remark, remarks
from .others import described
from .splats import Splats, rows_of

F64 = NDArray[np.float64]

# Logits and logarithms beyond these have no effect in float32.
LOGIT_MAX, LOGARITHM_MAX = 20.0, 40.0
# The largest coordinate, length and coefficient. Squares of larger ones overflow float32, or nearly so.
LARGEST = 1e9
_WRONG = f"a number that is NaN, infinite or beyond {LARGEST:g}"


@dataclass(frozen=True)
class Format:
    """A format of splat files.

    read: returns the Gaussians of a file, whose counts and lengths it checks. Raises ContentError and PlyError.
    write: returns a file of Gaussians, of which there is at least one. Raises ValueError if it cannot hold them.
    kind: of the written files, for output checks.
    extra: that has the packages of the writer, None for no extra.
    """

    read: Callable[[Data], Splats]
    write: Callable[[Splats, Options], bytes]
    kind: Kind
    extra: str | None = None


def _read_ply(data: Data) -> Splats:
    """Returns the Gaussians of a PLY file: both kinds often have the suffix .ply."""
    tables = ply.tables_of(data)
    return (compressed_ply if compressed_ply.is_compressed(tables) else ply).read(tables)


FORMATS = {
    ".ply": Format(_read_ply, ply.write, ply.KIND),
    ".spz": Format(spz.read, spz.write, spz.KIND),
    ".sog": Format(sog.read, sog.write, sog.KIND, extra="render"),
    ".glb": Format(glb.read, glb.write, glb.KIND),
    ".compressed.ply": Format(_read_ply, compressed_ply.write, compressed_ply.KIND),
}


# The suffixes of files that are read. Some are not written.
READ = (*FORMATS, ".splat", ".gltf")


def suffix_of(file: str | Path, suffixes: Iterable[str] = FORMATS) -> str | None:
    """Returns the suffix that a file name has, the longest one if it has several; None if it has none."""
    name = Path(file).name.lower()
    return max((suffix for suffix in suffixes if name.endswith(suffix)), key=len, default=None)


def is_splat_file(file: Path) -> bool:
    """Whether the name of a file is that of a splat file: with a suffix of READ, or meta.json of a SOG folder."""
    return file.name == sog.META or suffix_of(file, READ) is not None


def no_splat(file: Path) -> SceneFolderError:
    """Returns the error for something whose name is not that of a splat file."""
    known = described(file)
    problem, advice = known or ("it is neither a model folder nor a splat file", f"give one of {', '.join(READ)}")
    return SceneFolderError(file, problem if os.path.lexists(file) else "the file does not exist", advice)


def _read(file: Path) -> Splats:
    """Returns the Gaussians of a file as it has them. Raises ContentError, PlyError, and OSError."""
    if file.name == sog.META:
        return sog.read_folder(file)
    suffix = suffix_of(file, READ) or ""
    try:
        data = _data(file)
        return (FORMATS[suffix].read if suffix in FORMATS else {".splat": splat.read, ".gltf": glb.read}[suffix])(data)
    except (ContentError, PlyError):
        # What has the name of a splat may be something else.
        if known := described(file, suffix):
            raise ContentError(*known) from None
        raise


def _data(file: Path) -> Data:
    """Returns the bytes of a file, those of a GLB file for a .gltf file. Raises ContentError, and OSError."""
    return glb.packed(file) if suffix_of(file, READ) == ".gltf" else mapped(file)


def model_splats(folder: Path) -> Path | None:
    """Returns the splat file of the last iteration in the folder of a model of 3DGS; None for other folders."""
    files = folder.glob("point_cloud/iteration_*/point_cloud.ply")
    # iteration_30000 is behind iteration_7000.
    file = max(files, key=lambda path: (len(path.parent.name), path), default=None)
    with contextlib.suppress(PlyError, NotAFileError, OSError):
        names = property_names(file) if file and is_there(file) else []
        return file if "f_dc_0" in names and "f_offset_0" not in names else None
    return None


def read_splats(file: Path) -> Splats:
    """Returns the Gaussians of a splat file, at least one, all with finite numbers.

    Raises SceneFolderError, and OSError.
    """
    return read_located(file, np.zeros(3))[0]


def read_located(file: Path, offset: F64 | None, note: Callable[[str], None] = lambda text: None) -> tuple[Splats, F64]:
    """Returns the Gaussians of a splat file as read_splats, and what was subtracted from their means, float64 [3].

    offset: to subtract, before anything is rounded to float32. None: whole numbers near the middle if the Gaussians are
    so far from the world's origin that float32 would blur them, as in coordinates of a map, and else zeros. note:
    receives what was changed, ignored or left out. Raises SceneFolderError, and OSError.
    """
    if not is_splat_file(file) or not there(file, ADVICE):
        raise no_splat(file)
    with errors_in(file), remarks() as texts:
        splats = checked(_read(file))
        if offset is None:
            offset = far_offset(splats.mean.astype(np.float64), np.exp(splats.scale.max(axis=1)))
            if offset.any():
                remark(f"far from the world's origin for its size: {offset.tolist()} is subtracted from positions")
    for text in texts:
        note(f"refcodec: {file}: {text}")
    moved = splats.mean.astype(np.float64) - offset if offset.any() else splats.mean
    return replace(splats, mean=moved.astype(np.float32, copy=False)), offset


def checked(splats: Splats) -> Splats:
    """Returns Gaussians with bounded logits and logarithms, without those that have no place or no shape.

    Raises ContentError if none is left.
    """
    finite = np.ones(len(splats.mean), bool)
    for name, values in vars(splats).items():
        # Logits and logarithms of infinity have a meaning.
        right = ~np.isnan(values) if name in ("opacity", "scale") else np.isfinite(values)
        if name in ("mean", "base", "rest"):
            right &= np.abs(values) <= LARGEST
        finite &= right.reshape(len(values), -1).all(axis=1)
    turned = (splats.quaternion != 0).any(axis=1)
    if not (finite & turned).any():
        raise ContentError(f"each of its Gaussians has {_WRONG}, or a quaternion of 0")
    for rows, what in ((finite, _WRONG), (turned | ~finite, "a quaternion of 0")):
        if not rows.all():
            remark(f"{counted(int((~rows).sum()), 'Gaussian')} with {what}: left out")
    if not (finite & turned).all():
        splats = rows_of(splats, finite & turned)
    arrays = vars(splats) | {
        "opacity": splats.opacity.clip(-LOGIT_MAX, LOGIT_MAX),
        "scale": splats.scale.clip(-LOGARITHM_MAX, np.float32(np.log(LARGEST))),
    }
    return Splats(**arrays)


def splats_up(file: Path, unstated: F64 | None = None) -> F64:
    """Returns the up axis of a splat file, a unit vector, float64 [3].

    unstated: that of a file of a format without one, None for -y as in 3DGS. Raises SceneFolderError, and OSError.
    """
    with errors_in(file):
        if suffix_of(file, (".glb", ".gltf")):
            return glb.read_up(_data(file))
        return Options().up if unstated is None else unstated


def write_splats(splats: Splats, suffix: str, options: Options | None = None) -> bytes:
    """Returns a file of Gaussians.

    suffix: of FORMATS. options: None for the defaults. Raises ValueError if the format cannot hold them, if there are
    none, and as check_colours for a scene's, and ModuleNotFoundError without a package of the extra.
    """
    if options and options.render:
        check_colours(options.render)
    if not len(splats.mean):
        raise ValueError("it has no Gaussians")
    return FORMATS[suffix].write(splats, options or Options())


def carried_scene(file: Path) -> bytes:
    """Returns the C3GS file in a GLB file. It is not decoded. Raises SceneFolderError, and OSError."""
    with errors_in(file):
        return glb.read_carried(mapped(file))
