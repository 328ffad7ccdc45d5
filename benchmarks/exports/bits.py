"""SPZ files by the bits of their harmonics: bytes, and quality on held-out photographs. A section of RESULTS.md.

python -m benchmarks.exports.bits FOLDER --scene NAME FILE.c3gs PHOTOGRAPHS --scene ... [--write]

Harmonics have degree 3. FOLDER keeps files and figures for later runs, as in benchmarks.exports. --write writes the
section.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from refcodec.bitstream.batches import no_progress
from refcodec.convert.splat_files import read_splats
from refcodec.evaluate.quality import measures
from refcodec.export.fit import agreement, render_settings
from refcodec.export.splats import Packed, Splats, draw
from refcodec.export.spz import BITS_LEAST, BITS_MOST, spz_file
from refcodec.statuses import DONE

from ..results import machine, table, write_section
from .making import Record, Source, file_of, kept, means, splat_record

DEGREE = 3
# The bits of the harmonics of degree 1, and of the others, that Niantic's library keeps unless it is told others.
LIBRARY = 5, 4
HEAD = ["scene", "file", "bits", "bytes", "PSNR to the scene, dB", "PSNR, dB", "of .ply, dB", "SSIM"]
NOTE = (
    f"Splats are fitted as by `export --cameras PHOTOGRAPHS`, with harmonics of degree {DEGREE}. Quality is measured",
    "as in Exported scenes. `export --spz-bits` sets the bits of the harmonics.",
    f"{LIBRARY[0]} and {LIBRARY[1]}: the bits of degree 1 and of the others that Niantic's library keeps by default.",
    "Positions have 12 fraction bits in both scenes, by our rule and in the library.",
)


def library_file(splats: Splats) -> Packed:
    """Returns an SPZ file with the bits of LIBRARY."""
    first, others = (1 << (BITS_MOST - bits) for bits in LIBRARY)
    steps = np.where(np.arange(splats.rest.shape[1]) < 3, first, others)[:, None] / 128
    return spz_file(replace(splats, rest=(np.rint(splats.rest / steps) * steps).astype(np.float32)), BITS_MOST)


def bits_record(source: Source, folder: Path) -> Record:
    """Returns bytes and quality of the splat of a scene: as PLY, and as SPZ by the bits of its harmonics."""

    def made() -> Record:
        splat_record(source, DEGREE, folder)
        ply = file_of(source, DEGREE, ".ply", folder)
        splats = Splats(**read_splats(ply))
        files = {"": Packed(ply.read_bytes(), splats)}
        files |= {str(bits): spz_file(splats, bits) for bits in range(BITS_MOST, BITS_LEAST - 1, -1)}
        files[f"{LIBRARY[0]} and {LIBRARY[1]}"] = library_file(splats)
        settings, rows = render_settings(source.view), {}
        for name, packed in files.items():
            shown = [measures(draw(packed.splats, p.camera, settings).image, p.image) for p in source.set.test]
            near = agreement(source.view, packed.splats, source.tests, no_progress)
            rows[name] = {"bytes": len(packed.data), "near": near, **means(shown)}
        return rows

    return kept(folder / f"{source.stem}-{DEGREE}.bits.json", made)


def _rows(source: Source, record: Record) -> list[list[str]]:
    return [
        [
            source.name,
            ".spz" if bits else ".ply",
            bits,
            f"{row['bytes']:,}",
            f"{row['near']:.2f}",
            f"{row['psnr']:.3f}",
            f"{row['psnr'] - record['']['psnr']:+.3f}" if bits else "",
            f"{row['ssim']:.4f}",
        ]
        for bits, row in record.items()
    ]


def main(words: list[str] | None = None) -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.exports.bits",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scene", nargs=3, action="append", required=True, metavar=("NAME", "FILE", "PHOTOGRAPHS"))
    parser.add_argument("--size", type=int, default=200, help="longest side of the photographs in pixels (200)")
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    options.folder.mkdir(parents=True, exist_ok=True)
    sources = [Source(name, Path(file), Path(photographs), options.size) for name, file, photographs in options.scene]
    lines = table(HEAD, [row for source in sources for row in _rows(source, bits_record(source, options.folder))])
    print("\n".join(lines))
    if options.write:
        shown = [
            "python -m benchmarks.exports.bits FOLDER",
            *(f"--scene {name} {file} {photographs}" for name, file, photographs in options.scene),
            f"--size {options.size} --write",
        ]
        command = " \\\n  ".join(shown)
        write_section("bits", "SPZ files by their bits", ["```", command, "```", "", machine(), *NOTE, "", *lines])
    return DONE


if __name__ == "__main__":
    sys.exit(main())
