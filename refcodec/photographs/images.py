"""Image files: their sizes, their pixels, and smaller versions of them."""

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import sparse

from ..files.present import mapped
from ..rendering.camera import PIXELS_MAX
from .cameras import SIDE_MAX, U8, PhotographError

# The supported formats. Some of Pillow's other readers start programs (EPS).
FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "BMP")
# Pillow reads a PNG file whose last bytes are missing, which have the checksums.
_PNG_END = b"IEND\xaeB`\x82"
# 16-bit and float images have no common range.
EIGHT_BITS = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "CMYK", "YCbCr")

# (width, height) or the longest side, in pixels; None for the sizes of the images.
Size = tuple[int, int] | int | None


def parse_size(text: str) -> Size:
    """Returns the size of an option: "400x300", "400" for the longest side, or "full" for the sizes of the photographs.

    Raises PhotographError.
    """
    if text.strip() == "full":
        return None
    match = re.fullmatch(r"([1-9][0-9]{0,5})(?:x([1-9][0-9]{0,5}))?", text.strip())
    numbers = [int(n) for n in match.groups() if n] if match else []
    if not numbers or max(numbers) > SIDE_MAX:
        raise PhotographError(
            f"size {text!r}",
            f"it is neither WIDTHxHEIGHT nor a longest side of 1 to {SIDE_MAX} pixels",
            "use for example 400x300, 400, or full for the photographs' own",
        )
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def parse_background(text: str) -> tuple[int, int, int] | None:
    """Returns the colour of an option: "white", "black", or "R,G,B" from 0 to 255; None for "auto".

    Raises PhotographError.
    """
    text = {"white": "255,255,255", "black": "0,0,0"}.get(text.strip(), text.strip())
    if text == "auto":
        return None
    match = re.fullmatch(r"([0-9]{1,3}),([0-9]{1,3}),([0-9]{1,3})", text, re.ASCII)
    if not match or max(map(int, match.groups())) > 255:
        problem = "it is not white, black or R,G,B from 0 to 255"
        raise PhotographError(f"background {text!r}", problem, "use for example white, or 255,128,0")
    red, green, blue = map(int, match.groups())
    return red, green, blue


def same_aspect(width: int, height: int, other_width: int, other_height: int) -> bool:
    """Whether one size, scaled to the other, differs by at most a pixel of the smaller one."""
    return abs(width * other_height - height * other_width) <= max(width, height, other_width, other_height)


def wanted_size(where: Path | str, width: int, height: int, size: Size) -> tuple[int, int]:
    """Returns the width and height to which an image of width x height is reduced. Images are never enlarged.

    Raises PhotographError if the size would stretch the image by more than a pixel, or is larger than the image.
    """
    if size is None:
        return width, height
    if isinstance(size, int):
        longer = max(width, height)
        size = min(size, longer)
        return max(1, round(width * size / longer)), max(1, round(height * size / longer))
    if size[0] > width or size[1] > height:
        raise PhotographError(
            where,
            f"the image has {width} x {height} pixels and {size[0]} x {size[1]} are requested: images are not enlarged",
            f"use {width}x{height} or less",
        )
    if not same_aspect(width, height, *size):
        raise PhotographError(
            where,
            f"{size[0]} x {size[1]} would stretch an image of {width} x {height} by more than a pixel",
            f"use {size[0]}x{max(1, round(height * size[0] / width))}, or give only the longest side",
        )
    return size


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    if not path.is_file():
        raise PhotographError(path, "the image is missing", "restore it, or remove what names it in the dataset")
    try:
        with warnings.catch_warnings():
            # Pillow only warns of large images. Here the bound is an error.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            opened = Image.open(path, formats=FORMATS)
        with opened as image:
            width, height = image.size
            if width * height > PIXELS_MAX:
                problem = f"the image has {width} x {height} pixels, but at most {PIXELS_MAX} are allowed"
                raise PhotographError(path, problem, "export it again with fewer pixels")
            yield image
    except (PhotographError, MemoryError):
        raise
    # Pillow's readers raise many types for bad bytes.
    except Exception as error:
        problem = f"it is not a readable image ({error}); the supported formats are {', '.join(FORMATS)}"
        raise PhotographError(path, problem, "export or copy the image again") from None


def image_size(path: Path) -> tuple[int, int]:
    """Returns width and height of an image file. Only the header is read. Raises PhotographError.

    As in COLMAP, pixels are used as stored. An EXIF orientation is not applied, because poses ignore it.
    """
    with _opened(path) as image:
        return image.size


def is_transparent(path: Path) -> bool:
    """Whether a pixel of an image file is not opaque. Pixels are read only if there is alpha. As image_size."""
    with _opened(path) as image:
        return image.has_transparency_data and bool((np.asarray(image.convert("RGBA"))[..., 3] < 255).any())


def read_image(path: Path, background: tuple[int, int, int]) -> U8:
    """Returns the pixels of an image file, uint8 [H, W, 3], RGB. Raises PhotographError.

    An image with an alpha channel is blended over the background, 0 to 255 each.
    """
    with _opened(path) as image:
        if image.mode not in EIGHT_BITS:
            problem = f"its pixel format is {image.mode}, but must have 8 bits per channel"
            raise PhotographError(path, problem, "convert it to 8 bits")
        image.load()
        if image.format == "PNG" and mapped(path).rfind(_PNG_END) < 0:
            raise PhotographError(path, "its end is missing, as if it were cut", "export or copy the image again")
        if image.has_transparency_data:
            pixels = np.asarray(image.convert("RGBA"), np.float32)
            alpha = pixels[..., 3:] / 255
            return np.rint(pixels[..., :3] * alpha + np.array(background, np.float32) * (1 - alpha)).astype(np.uint8)
        return np.asarray(image.convert("RGB"), np.uint8)


def shrink(image: U8, width: int, height: int) -> U8:
    """Returns an image [H, W, 3] reduced by averaging over the area of each target pixel, uint8 [height, width, 3].

    A source pixel that overlaps two target pixels counts in each by its share. Pillow's BOX filter assigns it to one,
    which shifts the image by up to a quarter of a pixel unless the sides divide. Stored values are averaged, without
    gamma correction.
    """
    h, w = image.shape[:2]
    if (w, h) == (width, height):
        return image
    rows = _area_weights(h, height) @ image.reshape(h, w * 3).astype(np.float32)
    columns = rows.reshape(height, w, 3).transpose(1, 0, 2).reshape(w, height * 3)
    out = (_area_weights(w, width) @ columns).reshape(width, height, 3).transpose(1, 0, 2)
    return np.ascontiguousarray(np.rint(out).astype(np.uint8))


def _area_weights(n: int, m: int) -> sparse.csr_array:
    """Returns [m, n]: the share of each of n pixels in each of m larger ones, in exact integers up to the division."""
    start = np.arange(m) * n
    # In units of 1/m source pixel, row i covers [i n, (i + 1) n) and source pixel j covers [j m, (j + 1) m).
    column = start[:, None] // m + np.arange(n // m + 2)
    overlap = np.minimum(start[:, None] + n, (column + 1) * m) - np.maximum(start[:, None], column * m)
    row = np.broadcast_to(np.arange(m)[:, None], column.shape)
    kept = (overlap > 0) & (column < n)
    return sparse.csr_array(((overlap[kept] / n).astype(np.float32), (row[kept], column[kept])), shape=(m, n))
