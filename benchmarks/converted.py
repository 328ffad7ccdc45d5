"""Splat files converted to C3GS, compared with SPZ and SOG of the same file.

python -m benchmarks.converted FOLDER SPLATS ... --up=-y [--steps 4000] [--rates 0.001 0.004 0.015] [--fast 35 40 46 52]
    [--write]

`refcodec convert` trains a scene from views of each file of SPLATS, and the scene is encoded. `refcodec convert --fast`
codes the Gaussians themselves. refcodec and splat-transform write SPZ and SOG. Test cameras compare renderings of all
files with those of SPLATS. FOLDER keeps files and figures: existing ones are reused, and an interrupted training is
resumed. --write writes a section of RESULTS.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch
from numpy.typing import NDArray

from refcodec.bitstream.codec import parse
from refcodec.convert.drawing import drawn, tensors
from refcodec.convert.views import AXES, NEAR, NEAR_MAX, TEST, TEST_EVERY, middle_and_radius, orbit
from refcodec.evaluate.quality import measures
from refcodec.files.outputs import check_apart
from refcodec.files.text import printable
from refcodec.formats.common import Options
from refcodec.formats.splats import Splats
from refcodec.formats.table import read_splats, write_splats
from refcodec.rendering.camera import Camera, axis_direction
from refcodec.rendering.rasterise import Settings
from refcodec.rendering.view import View, eight_bits
from refcodec.statuses import DONE, USAGE, UsageError

from .exports.making import Record, kept
from .peers.convert import INSTALL, VERSION, ToolError, convert, tool
from .results import machine, table, write_section

OWN, TOOL = "refcodec", f"splat-transform {VERSION}"
FORMATS = (".spz", ".sog")
# lambda_r of the training runs.
RATES = (0.001, 0.004, 0.015)
# The qualities of convert --fast, dB.
QUALITIES = (35.0, 40.0, 46.0, 52.0)
# Training runs at a time.
JOBS = 2


@dataclass(frozen=True)
class Source:
    """A splat file. up: its upward axis, of AXES. views: training pictures. size: their sides in pixels."""

    file: Path
    up: str
    views: int
    size: int

    @property
    def name(self) -> str:
        """The name in files and tables."""
        return self.file.name.removesuffix(self.file.suffix).removesuffix(".compressed")

    @cached_property
    def splats(self) -> Splats:
        """The Gaussians."""
        return read_splats(self.file)

    @cached_property
    def cameras(self) -> list[Camera]:
        """The test cameras of refcodec convert."""
        tests = max(self.views // TEST_EVERY, 1)
        return orbit(self.splats, AXES[self.up], self.size, self.views, tests)[TEST]

    @cached_property
    def settings(self) -> Settings:
        """The settings of the pictures."""
        _, radius = middle_and_radius(self.splats)
        return Settings(near_plane=min(NEAR * radius, NEAR_MAX))

    @cached_property
    def truth(self) -> list[NDArray[np.uint8]]:
        """The test pictures of the file itself."""
        return [eight_bits(self.image(self.splats, camera)) for camera in self.cameras]

    def image(self, splats: Splats, camera: Camera) -> NDArray[np.float32]:
        """Returns a picture of Gaussians by a camera."""
        found: NDArray[np.float32] = drawn(tensors(splats), camera, self.settings)[0].numpy()
        return found

    def compared(self, image: Callable[[Camera], NDArray[np.float32]]) -> dict[str, float]:
        """Returns the means of the measures over the test cameras."""
        rows = [measures(image(camera), right) for camera, right in zip(self.cameras, self.truth, strict=True)]
        return {name: float(np.mean([row[name] for row in rows])) for name in ("psnr", "ssim")}


def packed_record(source: Source, suffix: str, maker: str, folder: Path) -> Record:
    """Returns bytes and measures of SPZ or SOG, written and read by its maker. Raises ToolError."""

    by = maker.partition(" ")[0]
    file = folder / f"{source.name}-{by}{suffix}"

    def made() -> Record:
        if maker == OWN:
            data = write_splats(source.splats, suffix, Options(axis_direction(0)))
            file.write_bytes(data)
            splats = read_splats(file)
        else:
            again = file.with_name(f"{file.name}.ply")
            convert(source.file, file)
            convert(file, again)
            splats = read_splats(again)
            again.unlink()
        return {"bytes": file.stat().st_size, **source.compared(lambda camera: source.image(splats, camera))}

    return kept(folder / f"{source.name}-{by}{suffix}-{source.views}-{source.size}px.json", made)


def refcodec(*words: str) -> None:
    """Runs a command of refcodec with one thread. Raises SystemExit with its errors if it fails."""
    command = [sys.executable, "-m", "refcodec", *words]
    environment = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"refcodec {' '.join(words)}: {done.stderr}")


def coded_record(source: Source, rate: float, steps: int, folder: Path) -> Record:
    """Returns bytes and measures of the file that convert and encode make, and its training time.

    Raises SystemExit with the message of a failing command.
    """
    name = f"{source.name}-{source.views}-{source.size}px-{steps}-{rate:g}"

    def made() -> Record:
        scene, file = folder / name, folder / f"{name}.c3gs"
        resume = ["--resume"] if scene.with_name(f"{name}.train-state").exists() else []
        words = ["--views", str(source.views), f"--up={source.up}", "--size", str(source.size)]
        words += ["--steps", str(steps), "--lambda", f"{rate:g}"]
        if not scene.exists() or resume:
            refcodec("convert", str(source.file), "-o", str(scene), *words, *resume)
        refcodec("encode", str(scene), "-o", str(file))
        data = file.read_bytes()
        view = View(parse(data).scene)
        report = json.loads((scene / "training.json").read_text())
        own: dict[str, Any] = {"bytes": len(data), "anchors": len(view.masks), "seconds": report["seconds"]}
        return {**own, **source.compared(view.draw)}

    return kept(folder / f"{name}.json", made)


def fast_record(source: Source, psnr: float, folder: Path) -> Record:
    """Returns bytes and measures of the file that convert --fast makes, and the seconds of this command.

    Raises SystemExit with the message of a failing command.
    """
    name = f"{source.name}-fast-{psnr:g}"

    def made() -> Record:
        file, start = folder / f"{name}.c3gs", time.perf_counter()
        refcodec("convert", str(source.file), "-o", str(file), "--fast", "--psnr", f"{psnr:g}", f"--up={source.up}")
        seconds, data = time.perf_counter() - start, file.read_bytes()
        view = View(parse(data).scene)
        own: dict[str, Any] = {"bytes": len(data), "anchors": len(view.masks), "seconds": seconds}
        return {**own, **source.compared(view.draw)}

    return kept(folder / f"{name}-{source.views}-{source.size}px.json", made)


# --- the section ------------------------------------------------------------------------------------------------------

NOTE = (
    "Test cameras compare the eight-bit renderings of all files with those of the splat file, by scikit-image. SPZ and",
    "SOG are read by the program that wrote them, and rendered as plain 3DGS.",
    f"Two training runs in parallel, one thread each. {TOOL} is a third-party program. The seconds of --fast",
    "are those of the whole command with one thread.",
)


def _rows(source: Source, packed: dict[tuple[str, str], Record], coded: dict[str, Record]) -> list[list[str]]:
    own = source.file.stat().st_size
    rows = [[source.file.name, "", f"{own:,}", "1", "", "", f"{len(source.splats.mean):,} Gaussians", ""]]

    def row(label: str, by: str, found: Record, what: str = "", seconds: str = "") -> list[str]:
        share = f"{found['bytes'] / own:.3f}"
        return [label, by, f"{found['bytes']:,}", share, f"{found['psnr']:.2f}", f"{found['ssim']:.4f}", what, seconds]

    rows += [row(suffix, maker, found) for (suffix, maker), found in packed.items()]
    for by, found in coded.items():
        rows.append(row(".c3gs", by, found, f"{found['anchors']:,} anchors", f"{found['seconds']:.0f}"))
    return rows


def section(
    sources: Sequence[Source], rates: Sequence[float], qualities: Sequence[float], steps: int, folder: Path
) -> list[str]:
    """Returns the lines of the section. Raises ToolError, UsageError, ValueError, OSError and SystemExit."""
    torch.set_num_threads(1)
    numba.set_num_threads(1)
    if tool() is None:
        raise ToolError(f"splat-transform is missing: run `{INSTALL}` in the repository's folder")
    folder.mkdir(parents=True, exist_ok=True)
    lines = []
    head = ["file", "by", "bytes", "of the splat file", "PSNR, dB", "SSIM", "of", "seconds"]
    for source in sources:
        makers = [(suffix, maker) for suffix in FORMATS for maker in (OWN, TOOL)]
        places = [folder / f"{source.name}-{maker.partition(' ')[0]}{suffix}" for suffix, maker in makers]
        check_apart([*places, *(folder / f"{place.name}.ply" for place in places)], [s.file for s in sources])
        packed = {(suffix, maker): packed_record(source, suffix, maker, folder) for suffix, maker in makers}
        source.truth  # noqa: B018 (drawn once, before threads ask for it)
        fast = {f"--fast --psnr {psnr:g}": fast_record(source, psnr, folder) for psnr in qualities}
        with ThreadPoolExecutor(JOBS) as pool:
            found = pool.map(lambda rate, of=source: coded_record(of, rate, steps, folder), rates)
            coded = dict(zip([f"lambda_r {rate:g}" for rate in rates], found, strict=True))
        lines += [f"### {source.name}", "", *table(head, _rows(source, packed, fast | coded)), ""]
    return lines


def main(words: list[str] | None = None) -> int:
    """Runs the command line. Returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.converted", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("splats", type=Path, nargs="+")
    parser.add_argument("--up", choices=AXES, default="-y", help="axis that is up (-y); write --up=-y")
    parser.add_argument("--views", type=int, default=200, help="training pictures (200)")
    parser.add_argument("--size", type=int, default=400, help="their sides in pixels (400)")
    parser.add_argument("--steps", type=int, default=4000, help="of each training (4000)")
    parser.add_argument("--fast", type=float, nargs="*", default=list(QUALITIES), metavar="DB", help="qualities, dB")
    parser.add_argument("--rates", type=float, nargs="*", default=list(RATES), metavar="L", help="lambda_r")
    parser.add_argument("--write", action="store_true", help="write the section of benchmarks/RESULTS.md")
    options = parser.parse_args(words)
    sources = [Source(file, options.up, options.views, options.size) for file in options.splats]
    try:
        lines = section(sources, options.rates, options.fast, options.steps, options.folder)
    except (ToolError, UsageError, ValueError, OSError) as error:
        print(printable(str(error)), file=sys.stderr)
        return USAGE
    print("\n".join(lines))
    if options.write:
        shown = ["python -m benchmarks.converted FOLDER", *(s.file.name for s in sources), f"--up={options.up}"]
        shown += [f"--views {options.views} --size {options.size} --steps {options.steps}"]
        shown += ["--rates", *(f"{rate:g}" for rate in options.rates)]
        shown += ["--fast", *(f"{psnr:g}" for psnr in options.fast), "--write"]
        made = ["```", INSTALL, " ".join(shown), "```", "", machine("torch"), *NOTE, ""]
        write_section("converted", "Converted splat files", [*made, *lines])
    return DONE


if __name__ == "__main__":
    sys.exit(main())
