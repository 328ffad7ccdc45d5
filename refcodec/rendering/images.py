"""Images of cameras as files of a folder: their names, which are apart, and the files, which are whole."""

import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from itertools import count
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ..files.outputs import Kind, check_apart, check_file
from ..files.stage import Stage
from .view import MARK, eight_bits, gif, png

# How the PNG files of `png` begin: with the header, and the text that names the program.
PNG = Kind(
    "a PNG file that refcodec wrote",
    re.compile(rb"\x89PNG\r\n\x1a\n.{25}.{4}tEXtSoftware\x00" + MARK.encode(), re.DOTALL),
)
# A GIF begins with its palette. The comment comes after it.
GIF = Kind("an animation that refcodec wrote", re.compile(rb"GIF8.{,1024}\x21\xfe." + MARK.encode(), re.DOTALL))
PFM = Kind.signed("a PFM image", b"PF\n")
ORBIT = "orbit.gif"


def image_names(cameras: Iterable[str]) -> list[str]:
    """Returns the names of the PNG files for images of cameras: no two are one file on any system.

    A camera's folders are kept, and the ending of its name becomes .png. If another camera has that name before it, the
    ending stays as well, and after that a number is added: 0.jpg, 0.tif and 0.jpg again give 0.png, 0.tif.png and
    0.jpg.png.
    """
    files: set[str] = set()
    folders: set[str] = set()
    names = []
    for camera in cameras:
        for form in _forms(camera):
            place = PurePosixPath(unicodedata.normalize("NFC", form).casefold())
            above = {str(folder) for folder in place.parents}
            if str(place) not in files | folders and not above & files:
                break
        files.add(str(place))
        folders |= above
        names.append(form)
    return names


def _forms(camera: str) -> Iterator[str]:
    """Yields names for the image of a camera, endlessly. The last ones are in no folder."""
    parts = [part for part in PurePosixPath(camera).parts if part not in ("/", "..")]
    path = PurePosixPath(*parts) if parts else PurePosixPath("image")
    yield str(path.with_suffix(".png"))
    yield f"{path}.png"
    for number in count(2):
        yield f"{'_'.join(path.parts)}-{number}.png"


class ImageFolder(Stage):
    """Images that get into a folder together at the end of a `with` block, or never if it fails.

    The folder is made if it is not there. Other files in it stay.
    """

    def __init__(
        self, folder: Path, cameras: Sequence[str], animated: bool, inputs: Iterable[str | Path | None]
    ) -> None:
        """Checks that the images may be written.

        Args:
            folder: of the images.
            cameras: their names, in the order of the images.
            animated: whether there is an animation of all of them, too.
            inputs: what the run reads.

        Raises:
            UsageError: an image is an input, or is in an input folder, or would replace a file that refcodec did not
                write.
        """
        # The images of two runs do not get mixed.
        super().__init__(turns=folder)
        paths = [folder / name for name in image_names(cameras)]
        self._next, self._animation = iter(paths), folder / ORBIT
        outputs = [(path, PNG) for path in paths] + ([(self._animation, GIF)] if animated else [])
        check_apart([path for path, _ in outputs], inputs)
        for path, kind in outputs:
            check_file(path, kind, made=True)

    def add(self, image: NDArray[np.float32]) -> None:
        """Writes the image of the next camera, float32 [height, width, 3]. Raises OSError."""
        self.write(next(self._next), png(eight_bits(image)))

    def animate(self, frames: Iterable[NDArray[np.uint8]]) -> None:
        """Writes the animation, of images uint8 [height, width, 3]. Raises OSError."""
        self.write(self._animation, gif(frames))
