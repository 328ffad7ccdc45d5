"""Draws a scene from cameras around it, and writes all views as one picture. Needs the extra `render`.

python examples/python/contact_sheet.py scene.c3gs sheet.png
"""

from __future__ import annotations

import sys

import numpy as np
from PIL import Image

import refcodec

COLUMNS, ROWS = 4, 2
WIDTH = 160


def main() -> None:
    """Command line."""
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    scene = refcodec.decode(sys.argv[1])
    cameras = scene.orbit(COLUMNS * ROWS)
    height = WIDTH * cameras[0].height // cameras[0].width
    views = [refcodec.render(scene, camera.resized(WIDTH, height)) for camera in cameras]
    rows = [np.hstack(views[first : first + COLUMNS]) for first in range(0, len(views), COLUMNS)]
    # Mode x: no existing file is replaced, such as the scene itself.
    with open(sys.argv[2], "xb") as file:
        Image.fromarray(np.vstack(rows)).save(file)
    print(f"{len(views)} views of {scene.anchor_count} anchors")


if __name__ == "__main__":
    main()
