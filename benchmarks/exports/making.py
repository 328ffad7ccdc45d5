"""A scene in all formats of `refcodec export`, for one degree of the harmonics: files and their quality.

.spz is also measured with the most bits of harmonics. Only the file of the default bits is kept.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from refcodec.bitstream.batches import no_progress
from refcodec.bitstream.codec import parse
from refcodec.bitstream.dimensions import STATIC
from refcodec.bitstream.scene import Scene
from refcodec.evaluate.quality import measures
from refcodec.export.fit import agreement, fit
from refcodec.export.views import sized
from refcodec.files.documents import read_json
from refcodec.formats.common import BITS, BITS_MOST, Options
from refcodec.formats.splats import Splats
from refcodec.formats.table import FORMATS, read_splats, write_splats
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.rendering.camera import Camera
from refcodec.rendering.gaussians import static_splats
from refcodec.rendering.rasterise import draw, settings_of
from refcodec.rendering.view import View

# As in refcodec export.
ITERATIONS = 10
# The measured formats, by suffix.
MEASURED = (".ply", ".spz", ".sog", ".glb")
Record = dict[str, Any]


@dataclass(frozen=True)
class Source:
    """A scene. name: for files and tables. file: a .c3gs file. photographs: their folder. size: longest side, pixels.

    The photographs are those of its training. Every eighth one, or the data set's own tests, are held out.
    """

    name: str
    file: Path
    photographs: Path
    size: int

    @property
    def stem(self) -> str:
        """The stem of its file names."""
        return f"{self.name}-{self.size}px"

    @cached_property
    def scene(self) -> Scene:
        """The decoded scene."""
        return parse(self.file.read_bytes()).scene

    @cached_property
    def view(self) -> View:
        """The decoded scene, for rendering."""
        return View(self.scene)

    @cached_property
    def own(self) -> Splats | None:
        """The Gaussians of a static scene, which need no fit; else None."""
        return static_splats(self.scene) if self.scene.render.render_model == STATIC else None

    @cached_property
    def set(self) -> PhotographSet:
        """The photographs."""
        return read_photographs(self.photographs, self.size, self.view.info.background)

    @property
    def fitted(self) -> list[Camera]:
        """The cameras for fitting splats."""
        return [sized(photograph.camera) for photograph in self.set.train]

    @property
    def tests(self) -> list[Camera]:
        """The test cameras."""
        return [sized(photograph.camera) for photograph in self.set.test]


def scene_record(source: Source, folder: Path) -> Record:
    """Returns anchors, kept offsets, bytes, and the quality of the file itself on held-out photographs."""

    def made() -> Record:
        shown = [measures(source.view.draw(p.camera), p.image) for p in source.set.test]
        view = source.view
        own = {"anchors": len(view.masks), "gaussians": int(view.masks.sum()), "bytes": source.file.stat().st_size}
        return {**own, **_means(shown), "cameras": len(source.fitted), "tests": len(shown)}

    return kept(folder / f"{source.stem}.json", made)


def splat_record(source: Source, degree: int, folder: Path) -> Record:
    """Returns the figures of the splats of a degree: bytes, and PSNR to the scene and photographs, by format.

    Their files are in the folder (file_of). degree: of a static scene, its own.
    """

    def made() -> Record:
        began = time.process_time()
        splats = source.own or fit(source.view, source.fitted, degree, ITERATIONS, no_progress).splats
        seconds = time.process_time() - began
        settings, files = settings_of(source.view.info), {}
        for suffix, bits in [(s, bits) for s in MEASURED for bits in ((BITS, BITS_MOST) if s == ".spz" else (BITS,))]:
            data = write_splats(splats, suffix, Options(source.view.up, spz_bits=bits))
            read = FORMATS[suffix].read(data)
            if bits == BITS:
                file_of(source, degree, suffix, folder).write_bytes(data)
            shown = [measures(draw(read, p.camera, settings).image, p.image) for p in source.set.test]
            near = agreement(source.view, read, source.tests, no_progress)
            name = f"{suffix}, {bits} bits" if suffix == ".spz" else suffix
            files[name] = {"bytes": len(data), "near": near, **_means(shown)}
        return {"gaussians": len(splats.mean), "seconds": seconds, "files": files}

    return kept(folder / f"{source.stem}-{degree}.json", made)


def file_of(source: Source, degree: int, suffix: str, folder: Path) -> Path:
    """Returns the path of the file of a format."""
    return folder / f"{source.stem}-{degree}{suffix}"


def held(source: Source, degree: int, suffix: str, folder: Path) -> Splats:
    """Returns the expected Gaussians of a file, from the PLY file, which has all bits.

    Raises ValueError if the file is another one.
    """
    splats = read_splats(file_of(source, degree, ".ply", folder))
    data = write_splats(splats, suffix, Options(source.view.up))
    file = file_of(source, degree, suffix, folder)
    if file.read_bytes() != data:
        raise ValueError(f"{file} is not of {source.stem}-{degree}.ply: remove the folder")
    return FORMATS[suffix].read(data)


def kept(file: Path, made: Any) -> Record:
    """Returns the content of a JSON file, which is first made if it is missing."""
    if file.exists():
        found: Record = read_json(file)
        return found
    record: Record = made()
    beside = file.with_suffix(".new")
    beside.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    beside.replace(file)
    print(f"{file.name}: {json.dumps(record)}", flush=True)
    return record


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([row[name] for row in rows])) for name in ("psnr", "ssim")}
