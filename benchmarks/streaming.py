"""Ways of reading a file: whole, as its bytes arrive, and one chunk by ranges. Memory, bytes and time of each.

python -m benchmarks.streaming [--anchors 100000]

It writes a section of RESULTS.md. The scene is random: its symbols cost more bytes than those of a trained scene, and
the memory of decoding depends on the number of anchors alone.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

from conformance.cases.scenes import MAIN_DIMENSIONS, random_scene
from refcodec.bitstream.codec import emit
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.reader import Reader
from refcodec.bitstream.source import WholeFile
from refcodec.encoder.quantise import packed
from refcodec.encoder.sizes import choose_lanes, choose_plane_size

from .reading import ARRIVING, BLOCK, WARM, WHOLE, reading
from .results import machine, mib, table, write_section


def section(anchors: int) -> list[str]:
    """The section's text."""
    d = replace(MAIN_DIMENSIONS, plane_size=choose_plane_size(anchors))
    lanes = choose_lanes(anchors, 2.0 * d.attribute_width)
    scene = packed(random_scene(17, anchors, d, lanes=lanes), None, None)
    data = emit(scene)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.c3gs"
        path.write_bytes(data)
        middle = str(len(scene.chunks) // 2)
        ways = {
            "whole file": WHOLE,
            f"blocks of {BLOCK} bytes": ARRIVING,
            f"chunk {middle} by ranges": middle,
            f"chunk {middle}, of an open file": WARM + middle,
        }
        traced = {name: reading(path, way, traced=True) for name, way in ways.items()}
        plain = {name: reading(path, way) for name, way in ways.items()}
    header = Reader(WholeFile(data)).header
    content = header.section(DATA)
    assert content is not None
    whole, arriving, alone, warm = traced.values()
    if whole.digest != arriving.digest or alone.digest != warm.digest:
        raise AssertionError("the readers do not agree")
    rows = []
    for name, found in traced.items():
        share = max(0.0, (found.first - content.start) / content.length)
        rows.append(
            [
                name,
                mib(found.peak),
                f"{found.peak / whole.peak:.3f}",
                mib(plain[name].peak),
                f"{plain[name].seconds:.3f}",
                f"{found.read:,}",
                f"{found.reads:,}",
                f"{share:.1%}" if name in list(traced)[:2] else "",
            ]
        )
    d = header.dimensions
    head = [
        "reading",
        "traced MiB",
        "share",
        "resident MiB",
        "seconds",
        "bytes",
        "reads",
        "first anchors",
    ]
    return [
        f"`python -m benchmarks.streaming --anchors {anchors}`",
        "",
        machine(),
        f"{anchors:,} random anchors in {len(scene.chunks)} chunks, {len(data):,} bytes.",
        f"{content.start:,} of them come before the chunks. Planes are 5 x {d.plane_channels} x {d.plane_size}^2.",
        "",
        *table(head, rows),
        "",
        "Traced: the largest sum of what Python and numpy allocated, without the program and its tables. Resident: of",
        "the process. Seconds: of decoding and of making float32 values. Share: of what the whole file takes. First",
        "anchors: the share of the chunks' bytes that had arrived when the first chunk was decoded. The digests of the",
        "whole file and of the arriving one are equal.",
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--anchors", type=int, default=100_000)
    write_section("streaming", "Ways of reading", section(parser.parse_args().anchors))


if __name__ == "__main__":
    main()
