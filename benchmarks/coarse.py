"""Pictures of a part of a file, in its own order and coarse first.

python -m benchmarks coarse FILES ... [--write]

Each file is encoded again coarse first (SPEC.md B.1). The chunks that lie within a share of the bytes are drawn, and
compared with the whole scene, from the cameras of the file, or around and in a static scene.
"""

from argparse import Namespace
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
from refcodec.bitstream.reconstruction import reconstruct
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.bitstream.source import WholeFile
from refcodec.convert.pictures import chosen_cameras
from refcodec.convert.views import AXES
from refcodec.encoder.layers import coarse_layers
from refcodec.encoder.positions import pack_positions
from refcodec.rendering.camera import Camera
from refcodec.rendering.gaussians import Gaussians, gaussians_of, static_splats
from refcodec.rendering.rasterise import F32, image

from .results import Arguments, machine, table

OPTIONS: Arguments = {"files": {"type": Path, "nargs": "+"}}
SHARES = (0.1, 0.15, 0.25, 0.5)
# Cameras of a file, and the longest side of their pictures in pixels.
MOST, SIDE = 8, 400
# Bits of a second of the link.
LINK = 10e6


def looks(scene: Scene) -> list[Camera]:
    """Returns the cameras that compare pictures of a scene."""
    stated = named_cameras(cameras(scene.ancillary))[:MOST]
    if len(stated) < 2 and scene.render.render_model == STATIC:
        return chosen_cameras([], static_splats(scene), AXES["-y"], str(SIDE), 32)["test"][:MOST]
    shares = [min(1, SIDE / max(c.width, c.height)) for c in stated]
    return [c.resized(round(c.width * s), round(c.height * s)) for c, s in zip(stated, shares, strict=True)]


def enlarged(g: Gaussians, scene: Scene, there: int) -> Gaussians:
    """SPEC E.2: returns the Gaussians of the first chunks of a scene, longer where others are missing."""
    positions, found, mean = reconstruct(scene).positions, np.zeros((2, len(g.mean))), g.mean.astype(np.float64)
    for number, chunk in enumerate(scene.chunks):
        own = positions[chunk.start : chunk.stop].astype(np.float64)
        low, high = own.min(axis=0), own.max(axis=0)
        sides = np.maximum(high - low, (high - low).max() * 1e-3 or 1)
        within = ((mean >= low) & (mean <= high)).all(axis=1)
        found[:, within] += np.array([[number < there], [1]]) * (len(chunk) / sides.prod())
    share = np.divide(found[0], found[1], out=np.zeros(len(mean)), where=found[1] > 0)
    share = np.maximum(share, scene.chunks[there - 1].stop / scene.anchor_count)
    area = np.sort(g.lengths.astype(np.float64), axis=1)[:, 1:].prod(axis=1)
    middle = np.sort(area)[len(area) // 2]
    factor = np.sqrt(1 + (share**-0.5 - 1) * np.sqrt(np.divide(middle, area, out=np.zeros_like(area), where=area > 0)))
    return replace(g, lengths=g.lengths * factor.astype(np.float32)[:, None])


def pictures(scene: Scene, shown: Sequence[Camera], there: int | None = None, longer: bool = False) -> Iterator[F32]:
    """Yields pictures of a scene, or of its first chunks, whose Gaussians may be longer."""
    part = scene if there is None else take_anchors(scene, slice(0, scene.chunks[there - 1].stop))
    for camera in shown:
        g = gaussians_of(part, camera)
        yield image(enlarged(g, scene, there) if longer and there else g, camera, scene.render)


def row(data: bytes, shown: Sequence[Camera], truth: Sequence[F32], longer: bool) -> Iterator[str]:
    """Yields the bytes, the seconds of the link to the first chunk and to all, and the PSNR after each share, in dB."""
    reader = Reader(WholeFile(data))
    opened, scene = reader.open(), parse(data).scene
    lengths = [opened.index[number].length for number in range(len(opened.index))]
    ends = reader.header.section(DATA).start + np.cumsum(lengths)
    yield f"{len(data):,}"
    yield from (f"{8 * size / LINK:.2f}" for size in (ends[0], len(data)))
    for share in SHARES:
        there = int((ends <= share * len(data)).sum())
        made = zip(pictures(scene, shown, there, longer), truth, strict=True) if there else ()
        errors = [max(float(np.square(a - b).mean()), 1e-10) for a, b in made]
        yield f"{np.mean(-10 * np.log10(errors)):.1f}" if errors else "-"


def section(options: Namespace) -> list[str]:
    """Returns the lines of the section. Raises BitstreamError and OSError."""
    rows = list[list[str]]()
    for file in options.files:
        data = file.read_bytes()
        scene = parse(data).scene
        shown = looks(scene)
        truth, coarse = list(pictures(scene, shown)), emit(pack_positions(scene, coarse_layers(scene)))
        for title, own, longer in (("", data, False), ("coarse first", coarse, False), ("enlarged", coarse, True)):
            rows.append([title or file.stem, *row(own, shown, truth, longer)])
    return [
        f"`python -m benchmarks coarse {' '.join(file.name for file in options.files)}`",
        "",
        machine(),
        "PSNR in dB of the chunks that lie within a share of the bytes, relative to the whole scene. Seconds: of a",
        "link of 10 Mbit/s, computed from bytes. Enlarged: as SPEC.md E.2 advises. Cameras: those of the file if it",
        "has several, or else around and among its Gaussians. SPZ and SOG show nothing before their end.",
        "",
        *table(["file", "bytes", "first chunk, s", "whole, s", *(f"{share:.0%}" for share in SHARES)], rows),
    ]
