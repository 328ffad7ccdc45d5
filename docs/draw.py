"""Draws the picture of README.md: a photograph, the scene as it was trained, and the decoded file, with their bytes.

python -m docs.draw FILE UNCOMPRESSED PHOTOGRAPHS IMAGE -o docs/pictures/front.jpg

FILE is a C3GS file, UNCOMPRESSED the scene folder of `refcodec train --rate 0`, and IMAGE the name of a photograph that
both trainings held out. The bars below the images have one scale. It needs the extra `render`.
"""

from __future__ import annotations

import argparse
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import refcodec
from refcodec.files.outputs import check_apart
from refcodec.files.stage import write_file
from refcodec.folder.uncompressed import read_uncompressed
from refcodec.photographs.photographs import read_photographs
from refcodec.render.view import View, eight_bits

U8 = NDArray[np.uint8]

# Pixels: between panels and around them, a bar, a line of text.
GAP, BAR, LINE = 12, 16, 24
# Of the page, of text, and of the bytes: readable on white and on black pages.
PAGE, TEXT = (255, 255, 255), (40, 40, 40)
COLOURS = {
    "attributes": (213, 94, 0),
    "weights": (0, 114, 178),
    "positions": (0, 158, 115),
    "masks": (204, 121, 167),
    "planes": (230, 159, 0),
    "the rest": (120, 120, 120),
}
QUALITY = 88


@dataclass(frozen=True)
class Panel:
    """An image with a line of text, and the bytes of its parts."""

    image: U8
    text: str
    sizes: dict[str, int]


def grouped(sizes: dict[str, int]) -> dict[str, int]:
    """Returns the bytes of a file by the names of COLOURS."""
    found = {name: sizes.get(name, 0) for name in COLOURS}
    found["the rest"] = sum(sizes.values()) - sum(found.values())
    return found


def picture(panels: list[Panel]) -> Image.Image:
    """Returns the panels side by side, with bars of bytes below them. A whole panel's width is the largest of all."""
    height, width, _ = panels[0].image.shape
    most = max(sum(panel.sizes.values()) for panel in panels)
    size = len(panels) * (width + GAP) + GAP, height + 2 * LINE + BAR + 3 * GAP
    made = Image.new("RGB", size, PAGE)
    draw, font = ImageDraw.Draw(made), ImageFont.load_default(15)
    for number, panel in enumerate(panels):
        left, top = GAP + number * (width + GAP), GAP
        made.paste(Image.fromarray(panel.image), (left, top))
        top += height + GAP // 2
        draw.text((left, top), panel.text, TEXT, font)
        x, top = float(left), top + LINE
        for name, count in panel.sizes.items():
            end = x + count / most * (width - 1)
            if count:
                draw.rectangle((x, top, end, top + BAR), COLOURS[name])
            x = end
    _legend(draw, font, made.height - LINE, panels)
    return made


def _legend(
    draw: ImageDraw.ImageDraw, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, top: int, panels: list[Panel]
) -> None:
    x = float(GAP)
    for name, colour in COLOURS.items():
        if any(panel.sizes.get(name) for panel in panels):
            draw.rectangle((x, top + 4, x + 12, top + 16), colour)
            draw.text((x + 18, top), name, TEXT, font)
            x += 18 + draw.textlength(name, font) + 2 * GAP


def panels(file: Path, uncompressed: Path, photographs: Path, image: str) -> list[Panel]:
    """Returns the panels of the picture. Raises StopIteration if no photograph that is held out has the name."""
    found = read_photographs(photographs)
    photograph = next(p for p in found.test if p.camera.name == image)
    plain, scene = read_uncompressed(uncompressed), refcodec.decode(file)
    plain_bytes, coded_bytes = sum(plain.sizes().values()), sum(scene.sizes.values())
    return [
        Panel(photograph.image, "photograph, not used in training", {}),
        Panel(
            eight_bits(View(plain).draw(photograph.camera)),
            f"Scaffold-GS, {plain_bytes / 1000:,.0f} KB",
            grouped(plain.sizes()),
        ),
        Panel(
            refcodec.render(scene, photograph.camera), f"C3GS file, {coded_bytes / 1000:,.0f} KB", grouped(scene.sizes)
        ),
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m docs.draw", description=__doc__.partition("\n")[0] if __doc__ else ""
    )
    for name in ("file", "uncompressed", "photographs"):
        parser.add_argument(name, metavar=name.upper(), type=Path)
    parser.add_argument("image", metavar="IMAGE")
    parser.add_argument("-o", "--output", metavar="JPEG", type=Path, required=True)
    arguments = parser.parse_args()
    folders = [path for path in arguments.photographs.rglob("*") if path.is_dir()]
    read = [arguments.file, arguments.uncompressed, arguments.photographs, *folders]
    check_apart([arguments.output], read)
    made = picture(panels(arguments.file, arguments.uncompressed, arguments.photographs, arguments.image))
    data = io.BytesIO()
    made.save(data, "JPEG", quality=QUALITY, optimize=True)
    write_file(arguments.output, data.getvalue())


if __name__ == "__main__":
    main()
