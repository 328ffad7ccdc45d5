"""The Gaussians of a camera, of the package for browsers in Node and of refcodec.render: processor time of each.

python -m benchmarks.web_gaussians [--anchors 10000 100000] [--rounds 9] [--write]

--write also writes a section of RESULTS.md. The scene is a trained one, whose anchors are drawn until there are enough.
Both compute in float32. The two take turns, from places on a circle around the scene.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from refcodec.bitstream.codec import parse
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.render.camera import Camera
from refcodec.render.gaussians import gaussians

from .commands import large
from .results import machine, table, write_section

SERVER = Path(__file__).with_name("web_gaussians.mjs")


def places(positions: Any, count: int) -> list[list[float]]:
    """Places on a circle around a scene, at two standard deviations from its middle."""
    turns = np.arange(count) * 2 * np.pi / count
    around = np.stack([np.cos(turns), np.zeros(count), np.sin(turns)], axis=1)
    return (positions.mean(axis=0) + 2 * np.linalg.norm(positions.std(axis=0)) * around).tolist()


def row(anchors: int, rounds: int) -> list[str]:
    """A row of the table."""
    node = shutil.which("node")
    if node is None:
        raise SystemExit("node is not installed")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.c3gs"
        large(path, anchors)
        scene = parse(path.read_bytes()).scene
        values = reconstruct(scene)
        theirs, ours = [], []
        command, pipe = [node, str(SERVER), str(path)], subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            added = json.loads(process.stdout.readline())
            # The first place warms both up.
            for place in places(values.positions.astype(np.float64), rounds + 1):
                print(json.dumps(place), file=process.stdin, flush=True)
                said = json.loads(process.stdout.readline())
                camera = Camera("", 1, 1, 1.0, 1.0, 0.0, 0.0, np.eye(3), -np.array(place))
                before = time.process_time()
                found = gaussians(values, scene.masks, scene.networks, camera, scene.render.distance_unit)
                theirs.append(time.process_time() - before)
                ours.append(said["seconds"])
                if abs(said["count"] - len(found.mean)) > 1e-4 * len(found.mean):
                    raise AssertionError(f"{said['count']} Gaussians instead of {len(found.mean)}")
            process.stdin.close()
    ratio = median(theirs[1:]) / median(ours[1:])
    numbers = [median(ours[1:]), median(theirs[1:]), added["seconds"]]
    return [f"{anchors:,}", f"{said['count']:,}", *(f"{1000 * x:.1f}" for x in numbers), f"{ratio:.1f}"]


def section(sizes: list[int], rounds: int) -> list[str]:
    """The section's text."""
    head = ["anchors", "Gaussians", "package ms", "refcodec.render ms", "adding the anchors once, ms", "ratio"]
    return [
        f"`python -m benchmarks.web_gaussians --anchors {' '.join(map(str, sizes))} --rounds {rounds}`",
        "",
        machine(),
        f"Processor time of one camera, medians of {rounds}. The package runs in one thread of Node.",
        "",
        *table(head, [row(anchors, rounds) for anchors in sizes]),
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--anchors", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    lines = section(options.anchors, options.rounds)
    print("\n".join(lines))
    if options.write:
        write_section("web-gaussians", "Gaussians of a camera in the browser", lines)


if __name__ == "__main__":
    main()
