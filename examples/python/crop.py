"""Keeps the anchors near the middle of a scene, and writes them as a new file.

python examples/python/crop.py scene.c3gs middle.c3gs 0.5

The number is the share of anchors to keep. They look as before, because networks and planes do not change.
"""

import sys

import numpy as np

import refcodec
from refcodec.bitstream.scene import take_anchors


def main() -> None:
    """Command line."""
    if len(sys.argv) != 4:
        raise SystemExit(__doc__)
    source, target, share = sys.argv[1], sys.argv[2], float(sys.argv[3])
    scene = refcodec.decode(source)
    away = np.linalg.norm(scene.positions - np.median(scene.positions, axis=0), axis=1)
    middle = refcodec.Scene(take_anchors(scene.coded, away <= np.quantile(away, share)))
    data = refcodec.encode(middle)
    # Mode x: no existing file is replaced, such as the scene itself.
    with open(target, "xb") as file:
        file.write(data)
    print(f"{scene.anchor_count} anchors, {sum(scene.sizes.values())} bytes")
    print(f"{middle.anchor_count} anchors, {len(data)} bytes")


if __name__ == "__main__":
    main()
