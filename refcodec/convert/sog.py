"""SOG files (PlayCanvas), version 2: 3D Gaussians as pixels of lossless WebP images.

The images and meta.json, which names them, are in a zip archive or in a folder.
"""

from __future__ import annotations

import io
import warnings
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from ..export.sog import META, PALETTE_MOST, ROW
from ..export.splats import with_largest
from ..files.documents import DocumentError, parse_json
from ..files.text import printable
from ..folder.layout import SceneFolderError, there
from ..rendering.harmonics import REST
from .archives import opened_zip
from .splat_arrays import ADVICE, Arrays, check_count, logits

VERSION = 2
# Maximum bytes of a compressed image, and of meta.json.
ENTRY_MAX, META_MAX = 1 << 28, 1 << 20
# Images have complete rows, so some pixels belong to no Gaussian.
SPARE = 1 << 20
BYTE = 256


Read = Callable[[str, int], bytes]


def _entry(file: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Returns an entry of an archive, of at most `most` bytes. Raises SceneFolderError."""
    try:
        # Other methods allocate a dictionary of a size that the entry states.
        if archive.getinfo(name).compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError("it is neither stored nor deflated")
        with archive.open(name) as entry:
            data = entry.read(most + 1)
    except KeyError:
        raise SceneFolderError(file, f"it has no entry {printable(name, 60)}", ADVICE) from None
    except MemoryError:
        raise
    # zipfile and zlib raise several types for bad bytes.
    except Exception as error:
        problem = f"its entry {printable(name, 60)} is damaged ({printable(str(error), 80)})"
        raise SceneFolderError(file, problem, ADVICE) from None
    if len(data) > most:
        raise SceneFolderError(file, f"its entry {printable(name, 60)} has more than {most} bytes", ADVICE)
    return data


def _beside(file: Path, name: str, most: int) -> bytes:
    """Returns a file beside another one, of at most `most` bytes. Raises SceneFolderError, and OSError."""
    # A plain name cannot lead to another folder.
    if not name or Path(name).name != name or not there(file.parent / name, ADVICE):
        raise SceneFolderError(file, f"there is no file {printable(name, 60)} beside it", ADVICE)
    with (file.parent / name).open("rb") as opened:
        data = opened.read(most + 1)
    if len(data) > most:
        raise SceneFolderError(file.parent / name, f"it has more than {most} bytes", ADVICE)
    return data


class _Scene:
    """The contents of meta.json, and its images. read: returns a file by name and maximum size in bytes."""

    def __init__(self, file: Path, read: Read) -> None:
        self.file, self._read = file, read
        try:
            self.root = parse_json(read(META, META_MAX), META_MAX)
        except DocumentError as error:
            raise SceneFolderError(file, f"its {META} is not JSON ({error})", ADVICE) from None

    def value(self, name: str) -> Any:
        """Returns a value of meta.json by its path, such as means.files; None if it is missing."""
        node = self.root
        for key in name.split("."):
            node = node.get(key) if isinstance(node, dict) else None
        return node

    def fault(self, name: str, wanted: str) -> SceneFolderError:
        return SceneFolderError(self.file, f"{name} in its {META} is not {wanted}", ADVICE)

    def integer(self, name: str, high: int) -> int:
        value = self.value(name)
        if type(value) is not int or not 0 <= value <= high:
            raise self.fault(name, f"an integer from 0 to {high}")
        return value

    def numbers(self, name: str, count: int) -> NDArray[np.float64]:
        value = self.value(name)
        right = isinstance(value, list) and len(value) == count
        if not right or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):
            raise self.fault(name, f"a list of {count} numbers")
        return np.array(value, np.float64)

    def pixels(self, name: str, number: int, least: int) -> NDArray[np.uint8]:
        """Returns an image as uint8 [height, width, 4]. name: of the list of files. least: minimum number of pixels."""
        files = self.value(name)
        if not isinstance(files, list) or number >= len(files) or not isinstance(files[number], str):
            raise self.fault(name, f"a list with {number + 1} names")
        shown = printable(files[number], 60)
        data = self._read(files[number], ENTRY_MAX)
        try:
            with warnings.catch_warnings():
                # Pillow only warns of many pixels. Here they are bounded.
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                image = Image.open(io.BytesIO(data), formats=["WEBP", "PNG"])
            with image:
                width, height = image.size
                if not least <= width * height <= 2 * least + SPARE:
                    problem = f"its image {shown} has {width} x {height} pixels for {least}"
                    raise SceneFolderError(self.file, problem, ADVICE)
                return np.asarray(image.convert("RGBA"))
        except (SceneFolderError, MemoryError):
            raise
        except UnidentifiedImageError:
            raise SceneFolderError(self.file, f"its image {shown} is neither WebP nor PNG", ADVICE) from None
        # Pillow raises many types for bad bytes.
        except Exception as error:
            problem = f"its image {shown} cannot be read ({printable(str(error), 80)})"
            raise SceneFolderError(self.file, problem, ADVICE) from None


def read_sog(file: Path) -> Arrays:
    """Returns the Gaussians of a file: an archive, or the meta.json of a folder, with the images beside it.

    Raises SceneFolderError, and OSError.
    """
    if file.name == META:
        size = sum(image.stat().st_size for image in file.parent.glob("*.webp"))
        return _gaussians(_Scene(file, partial(_beside, file)), size)
    with opened_zip(file, "zip archive", ADVICE) as archive:
        return _gaussians(_Scene(file, partial(_entry, file, archive)), file.stat().st_size)


def _gaussians(archive: _Scene, size: int) -> Arrays:
    """Returns the Gaussians of a scene. size: of its files, bytes. Raises SceneFolderError."""
    file = archive.file
    if archive.value("version") != VERSION:
        stated = printable(repr(archive.value("version")), 20)
        raise SceneFolderError(file, f"it is SOG version {stated}, but only version {VERSION} is supported", ADVICE)
    count = archive.integer("count", (1 << 32) - 1)
    check_count(file, count, size)

    def rows(name: str, number: int = 0) -> NDArray[np.uint8]:
        return archive.pixels(name, number, count).reshape(-1, 4)[:count]

    low, high = (rows("means.files", number)[:, :3].astype(np.int64) for number in (0, 1))
    least, most = (archive.numbers(f"means.{end}", 3) for end in ("mins", "maxs"))
    with np.errstate(over="ignore", invalid="ignore"):
        folded = least + (high << 8 | low) / 65535 * (most - least)
        # Positions are stored as the logarithm of 1 plus their magnitude.
        mean = np.sign(folded) * np.expm1(np.abs(folded))
    rotation, colour = rows("quats.files"), rows("sh0.files")
    largest = rotation[:, 3].astype(np.int64) - 252
    if largest.min(initial=0) < 0:
        raise SceneFolderError(file, "a rotation does not state its largest component", ADVICE)
    arrays = {
        "mean": mean,
        "base": archive.numbers("sh0.codebook", BYTE)[colour[:, :3]],
        "rest": _rest(archive, count),
        "scale": archive.numbers("scales.codebook", BYTE)[rows("scales.files")[:, :3]],
        "quaternion": with_largest(largest, (rotation[:, :3] / 255 - 0.5) * np.sqrt(2)),
    }
    with np.errstate(over="ignore"):
        return {name: v.astype(np.float32, copy=False) for name, v in arrays.items()} | {
            "opacity": logits(colour[:, 3] / 255)
        }


def _rest(archive: _Scene, count: int) -> NDArray[np.float32]:
    """Returns the harmonics besides the first, [N, K, 3]: each Gaussian has those of a palette entry."""
    if archive.value("shN") is None:
        return np.zeros((count, 0, 3), np.float32)
    rest, entries = REST[archive.integer("shN.bands", len(REST) - 1)], archive.integer("shN.count", PALETTE_MOST)
    book = archive.numbers("shN.codebook", BYTE)
    # A palette's rows have ROW entries of `rest` pixels each.
    palette = archive.pixels("shN.files", 0, max(entries * rest, 1))
    if palette.shape[1] != ROW * rest or palette.shape[0] * ROW < entries:
        raise archive.fault("shN", f"of a palette whose rows have {ROW} entries")
    labels = archive.pixels("shN.files", 1, count).reshape(-1, 4)[:count].astype(np.int64)
    chosen = labels[:, 0] | labels[:, 1] << 8
    if chosen.max(initial=0) >= max(entries, 1):
        raise SceneFolderError(archive.file, f"a Gaussian has harmonics beyond the {entries} of the palette", ADVICE)
    with np.errstate(over="ignore"):
        own = book.astype(np.float32)
    return own[palette.reshape(-1, rest, 4)[:, :, :3]][chosen]
