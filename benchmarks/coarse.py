"""Pictures of a part of a file, in its own order and coarse first: a section of RESULTS.md.

python -m benchmarks.coarse FILES ... [--write]

Each file is encoded again coarse first (SPEC.md B.1). The chunks that lie within a share of the bytes are drawn, and
compared with the whole scene, from the cameras of the file, or around and in a static scene.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from refcodec.api.scenes import named_cameras
from refcodec.bitstream.cameras import cameras
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.dimensions import STATIC
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.bitstream.source import WholeFile
from refcodec.convert.pictures import chosen_cameras
from refcodec.convert.views import AXES
from refcodec.encoder.layers import coarse_layers
from refcodec.encoder.positions import pack_positions
from refcodec.rendering.camera import Camera
from refcodec.rendering.gaussians import gaussians_of, static_splats
from refcodec.rendering.rasterise import F32, image

from .results import machine, publish, table

SHARES = (0.1, 0.15, 0.25, 0.5)
# Cameras of a file, and the longest side of their pictures in pixels.
MOST, SIDE = 8, 400
# Bits of a second of the link.
LINK = 10e6
# SPEC E.2: lengths of the Gaussians of a share s of the anchors are times s to this power.
ENLARGED = -1 / 8


def looks(scene: Scene) -> list[Camera]:
    """Returns the cameras that compare pictures of a scene."""
    if scene.render.render_model == STATIC:
        return chosen_cameras([], static_splats(scene), AXES["-y"], str(SIDE), 32)["test"][:MOST]
    stated = named_cameras(cameras(scene.ancillary))[:MOST]
    shares = [min(1, SIDE / max(c.width, c.height)) for c in stated]
    return [c.resized(round(c.width * s), round(c.height * s)) for c, s in zip(stated, shares, strict=True)]


def pictures(scene: Scene, shown: Sequence[Camera], longer: float = 1) -> list[F32]:
    """Returns pictures of a scene. longer: the factor of its Gaussians' lengths."""
    drawn = ((gaussians_of(scene, camera), camera) for camera in shown)
    return [image(replace(g, lengths=g.lengths * np.float32(longer)), camera, scene.render) for g, camera in drawn]


def row(data: bytes, shown: Sequence[Camera], truth: Sequence[F32], power: float) -> Iterator[str]:
    """Yields the bytes, the seconds of the link to the first chunk and to all, and the PSNR after each share, in dB."""
    reader = Reader(WholeFile(data))
    opened, scene = reader.open(), parse(data).scene
    index = [opened.index[number] for number in range(len(opened.index))]
    ends = reader.header.section(DATA).start + np.cumsum([entry.length for entry in index])
    yield f"{len(data):,}"
    yield from (f"{8 * size / LINK:.2f}" for size in (ends[0], len(data)))
    for share in SHARES:
        there = int((ends <= share * len(data)).sum())
        if there == 0:
            yield "-"
            continue
        part = take_anchors(scene, slice(0, index[there - 1].anchors.stop))
        made = pictures(part, shown, (part.anchor_count / scene.anchor_count) ** power)
        errors = [max(float(np.square(a - b).mean()), 1e-10) for a, b in zip(made, truth, strict=True)]
        yield f"{np.mean(-10 * np.log10(errors)):.1f}"


def main(words: list[str] | None = None) -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.coarse", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options, rows = parser.parse_args(words), list[list[str]]()
    for file in options.files:
        data = file.read_bytes()
        scene = parse(data).scene
        shown = looks(scene)
        truth, coarse = pictures(scene, shown), emit(pack_positions(scene, coarse_layers(scene)))
        for title, own, power in (("", data, 0), ("coarse first", coarse, 0), ("enlarged", coarse, ENLARGED)):
            rows.append([title or file.stem, *row(own, shown, truth, power)])
    lines = [
        f"`python -m benchmarks.coarse {' '.join(file.name for file in options.files)}`",
        "",
        machine(),
        "PSNR in dB of the chunks that lie within a share of the bytes, relative to the whole scene. Seconds: of a",
        "link of 10 Mbit/s, computed from bytes. Enlarged: lengths times s^(-1/8) for a share s of the anchors.",
        "",
        *table(["file", "bytes", "first chunk, s", "whole, s", *(f"{share:.0%}" for share in SHARES)], rows),
    ]
    return publish("coarse", "Parts of a file", lines, options.write)


if __name__ == "__main__":
    sys.exit(main())
