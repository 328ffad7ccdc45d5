"""Renders photographs of a splat in NeRF's format, without points.

python -m benchmarks.peers.scene SPLAT.ply -o FOLDER

The cameras are those of refcodec convert (refcodec.convert.views). The images have the splat's licence.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from refcodec.convert.views import AXES, orbit, write_photographs
from refcodec.files.text import printable
from refcodec.formats.table import read_splats
from refcodec.statuses import DONE, USAGE


def main(words: list[str] | None = None) -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers.scene",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("splat", type=Path, help="a PLY file of 3DGS")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--views", type=int, default=100, help="training images (100)")
    parser.add_argument("--tests", type=int, default=25, help="test images (25)")
    parser.add_argument("--size", type=int, default=400, help="sides in pixels (400)")
    parser.add_argument("--up", choices=AXES, default="+z", help="axis that is up (+z); write --up=-y")
    arguments = parser.parse_args(words)
    try:
        if min(arguments.views, arguments.tests, arguments.size) < 1:
            raise ValueError("views, tests and size must be at least 1")
        splats = read_splats(arguments.splat)
        views = orbit(splats, AXES[arguments.up], arguments.size, arguments.views, arguments.tests)
        write_photographs(splats, views, arguments.output, lambda stage, done, total: None, points=False)
    except (ValueError, OSError) as error:
        print(printable(str(error)), file=sys.stderr)
        return USAGE
    print(f"{arguments.output}: {arguments.views} training images, {arguments.tests} test images, no points")
    return DONE


if __name__ == "__main__":
    sys.exit(main())
