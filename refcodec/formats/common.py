"""What all formats share: the error of their readers, the bounds of a file, and the choices of their writers."""

import contextlib
import mmap
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.header import RenderInfo
from ..files.documents import DocumentError, FieldError, checked, parse_json
from ..files.ply import MeshError, PlyError
from ..files.present import NotAFileError, is_there, mapped
from ..files.text import printable
from ..folder.layout import SceneFolderError
from .harmonics import DEGREE_MAX

# The bytes of a file.
Data = mmap.mmap | bytes

# Stands for no value.
_REQUIRED = object()
ADVICE = "export the splats again"
TRANSFORM = "`splat-transform {file} scene.ply` (npm i -g @playcanvas/splat-transform) makes a PLY file of it"
_OF_MESHES = "a mesh is no splat, but `refcodec fit` takes its vertices, without the faces"
# Of splats that are meant for such a filter.
COMPENSATED = (
    "trained for antialiasing that compensates opacities, as Mip-Splatting does; here it is drawn without: thin parts "
    "look thicker and more opaque, mostly from afar"
)
# Maximum per file. A 3DGS scene has a few million.
GAUSSIANS_MAX = 1 << 24
# A file of more Gaussians must have at least a byte for each. For trained scenes, all formats have ten and more. An
# image in one colour takes a few bytes, whatever its size.
DENSE_MAX = 1 << 20
# The bits of each coefficient of degree 1 and more in SPZ files. On photographs, files of 7 bits lose 0.01 dB, of 6 up
# to 0.06, and with the 5 bits of degree 1 and the 4 of the others of Niantic's library up to 0.9
# (benchmarks/RESULTS.md, closed studies).
BITS_LEAST, BITS, BITS_MOST = 4, 7, 8


# SPEC 6.5, code points of ITU-T H.273: BT.709 primaries and the sRGB curve. 2 is unspecified, and means the same here.
_PRIMARIES, _TRANSFER = (1, 2), (13, 2)
# The transfer characteristics of linear light.
LINEAR = 8


def is_shown(render: RenderInfo, *others: int) -> bool:
    """Whether a scene has colours of sRGB. others: further transfer characteristics that are shown rightly."""
    return render.colour_primaries in _PRIMARIES and render.transfer_characteristics in (*_TRANSFER, *others)


def check_colours(render: RenderInfo, *others: int) -> None:
    """Raises ValueError for a scene whose colours other programs would take for sRGB, though they are not.

    Blending comes before any conversion, so that Gaussians cannot be converted. others: as of is_shown.
    """
    if not is_shown(render, *others):
        allowed = " or ".join(map(str, (_TRANSFER[0], *others)))
        raise ValueError(
            f"its colours have primaries {render.colour_primaries} and transfer characteristics "
            f"{render.transfer_characteristics} of ITU-T H.273, but must have 1 and {allowed}: other programs would "
            "show other colours"
        )


@dataclass(frozen=True)
class Options:
    """What a file may state or choose besides the Gaussians.

    up: the up axis of their world, a unit vector, float64 [3]; that of 3DGS files by default. render: the render
    information of their scene, None if there is none. spz_bits: of each coefficient of degree 1 and more in SPZ files,
    BITS_LEAST to BITS_MOST.
    """

    up: NDArray[np.float64] = field(default_factory=lambda: np.array([0.0, -1.0, 0.0]))
    render: RenderInfo | None = None
    spz_bits: int = BITS


class ContentError(ValueError):
    """Bytes that cannot be used. The text states the problem, without the file's name. advice: a remedy of its own."""

    def __init__(self, problem: str, advice: str | None = None) -> None:
        super().__init__(problem)
        self.advice = advice


_remarks: ContextVar[list[str] | None] = ContextVar("remarks", default=None)


def remark(text: str) -> None:
    """Reports what a reader changed or ignored, to the innermost `remarks`."""
    if (texts := _remarks.get()) is not None:
        texts.append(text)


@contextlib.contextmanager
def remarks() -> Iterator[list[str]]:
    """Yields the list that gets the texts of `remark` in the block."""
    texts: list[str] = []
    token = _remarks.set(texts)
    try:
        yield texts
    finally:
        _remarks.reset(token)


@contextlib.contextmanager
def errors_in(file: Path, advice: str = ADVICE) -> Iterator[None]:
    """Raises SceneFolderError about a file instead of ContentError and PlyError. advice: the usual remedy."""
    try:
        yield
    except PlyError as error:
        advice = _OF_MESHES if isinstance(error, MeshError) else advice
        raise SceneFolderError(file, f"it is not a readable PLY file ({printable(str(error), 120)})", advice) from None
    except ContentError as error:
        raise SceneFolderError(file, str(error), error.advice or advice) from None


def cut_degree(stated: int) -> int:
    """Returns the degree of harmonics that is kept of a stated one, and reports a cut."""
    if stated > DEGREE_MAX:
        remark(f"its harmonics of degree {stated} are cut to degree {DEGREE_MAX}")
    return min(stated, DEGREE_MAX)


def beside(file: Path, name: str, most: int) -> bytes:
    """Returns a file beside another one, of at most `most` bytes. Raises ContentError, and OSError."""
    shown = printable(name, 60)
    try:
        # A plain name cannot lead to another folder.
        if not name or Path(name).name != name or not is_there(file.parent / name):
            raise ContentError(f"there is no file {shown} beside it")
    except NotAFileError as error:
        raise ContentError(f"{shown} beside it is not a file: {error}") from None
    data = mapped(file.parent / name)
    if len(data) > most:
        raise ContentError(f"{shown} beside it has more than {most} bytes")
    return data[:]


def check_count(count: int, size: int) -> None:
    """Raises ContentError for no Gaussians, and for more than a file of `size` bytes may have."""
    if not count:
        raise ContentError("it has no Gaussians")
    if count > GAUSSIANS_MAX:
        raise ContentError(f"it has {count} Gaussians, but at most {GAUSSIANS_MAX} are allowed")
    if count > max(size, DENSE_MAX):
        raise ContentError(f"it states {count} Gaussians, but has only {size} bytes")


class Document:
    """A JSON text, whose values are checked when they are used. name: of the text in errors."""

    def __init__(self, name: str, data: bytes, most: int) -> None:
        """Parses a text of at most `most` bytes. Raises ContentError."""
        self._name = name
        try:
            self._root = parse_json(data, most)
        except DocumentError as error:
            raise ContentError(f"its {name} is not JSON ({error})") from None

    def get(self, path: str, form: Any, default: Any = _REQUIRED) -> Any:
        """Returns a value as a type of msgspec.

        path: the keys and the numbers in lists that lead to it, such as means/files/0; empty for all values. default:
        for a missing value.
        Raises ContentError for a value of another type, and for a missing one without a default.
        """
        value = self._root
        for step in filter(None, path.split("/")):
            if isinstance(value, list):
                value = value[int(step)] if step.isdecimal() and int(step) < len(value) else _REQUIRED
            else:
                value = value.get(step, _REQUIRED) if isinstance(value, dict) else _REQUIRED
        if value is _REQUIRED:
            if default is _REQUIRED:
                raise ContentError(f"its {self._name} has no {path}")
            return default
        try:
            return checked(value, form)
        except FieldError as error:
            # Below a dictionary, the name has no keys.
            inner = error.name.partition("[...]")[0].replace(".", "/")
            where = "/".join(filter(None, (path, inner))) or "the value"
            raise ContentError(f"{where} in its {self._name} {error.problem}") from None
