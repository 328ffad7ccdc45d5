"""Compares a file or an uncompressed scene with photographs: image quality, bytes of its parts, seconds."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.batches import Progress
from ..bitstream.codec import parse
from ..folder.uncompressed import Uncompressed
from ..inspect.elements import outline_of
from ..inspect.parts import part_bytes
from ..photographs.photographs import excluded
from ..rendering.view import View
from .quality import counted, measures

if TYPE_CHECKING:
    from ..photographs.photographs import Photograph, PhotographSet
    from .lpips import Lpips


def compared_of(photographs: PhotographSet) -> tuple[Photograph, ...]:
    """Returns the photographs that a scene is compared with: those held out, or all if none are."""
    return photographs.test or photographs.train


def evaluate(
    shown: bytes | Uncompressed,
    photographs: PhotographSet,
    images: Callable[[NDArray[np.float32]], None] | None,
    progress: Progress,
    lpips: Lpips | None = None,
) -> dict[str, Any]:
    """Compares a file or an uncompressed scene with the held-out photographs, or with all if none are held out.

    images: called with each compared image, float32 [height, width, 3], in the order of compared_of.

    Returns bytes, anchors, parts (bytes, as in inspect.parts), decode_seconds, frames_per_second, held_out, excluded.
    For each image and their mean, it has quality.measures, and lpips.measures if lpips is given. Raises
    BitstreamError for a file that is rejected, PhotographError for photographs that cannot be read or compared.
    """
    began: dict[str, float] = {}
    spent: dict[str, float] = {}

    def clock(stage: str, done: int, total: int) -> None:
        began.setdefault(stage, time.perf_counter())
        spent[stage] = time.perf_counter() - began[stage]

    start = time.perf_counter()
    if isinstance(shown, Uncompressed):
        view, parts = View(shown), shown.sizes()
        size, anchors = sum(parts.values()), shown.anchor_count
    else:
        parsed = parse(shown, progress=clock)
        view, size, anchors = View(parsed.scene), len(shown), parsed.scene.anchor_count
        parts = part_bytes(shown, outline_of(shown))
    spent["total"] = time.perf_counter() - start
    compared = compared_of(photographs)
    view.draw(compared[0].camera)  # The first call compiles.
    rows: list[dict[str, Any]] = []
    drawing = 0.0
    for number, photograph in enumerate(compared):
        progress("images", number, len(compared))
        at = time.perf_counter()
        made = view.draw(photograph.camera)
        drawing += time.perf_counter() - at
        more = lpips.measures(*counted(photograph.mask, made, photograph.image)) if lpips else {}
        rows.append({"image": photograph.camera.name, **measures(made, photograph.image, photograph.mask), **more})
        if images:
            images(made)
    progress("images", len(compared), len(compared))
    return {
        "bytes": size,
        "anchors": anchors,
        "parts": parts,
        "decode_seconds": spent,
        "frames_per_second": len(rows) / drawing,
        "held_out": bool(photographs.test),
        **excluded(compared),
        "mean": {name: sum(row[name] for row in rows) / len(rows) for name in rows[0] if name != "image"},
        "images": rows,
    }


def table(result: dict[str, Any]) -> Iterator[str]:
    """Returns the result as lines of text."""
    names = list(result["mean"])
    yield f"{'image':<28}" + "".join(f" {name:>10}" for name in names)
    for row in [*result["images"], {"image": "mean", **result["mean"]}]:
        yield f"{row['image']:<28}" + "".join(f" {row[name]:>10.4f}" for name in names)
    yield ""
    if result["masks"]:
        yield f"{result['masks']} from all figures: they are black in both images"
    yield f"PSNR with each photograph's best colours (psnr_cc): {result['mean']['psnr_cc']:.2f} dB"
    parts = ", ".join(f"{n} {b}" for n, b in result["parts"].items())
    yield f"{result['bytes']} bytes, {result['anchors']} anchors: {parts}"
    yield "decoding: " + ", ".join(f"{stage} {seconds:.2f} s" for stage, seconds in result["decode_seconds"].items())
    held = "" if result["held_out"] else "; no images were held out"
    yield f"drawing: {result['frames_per_second']:.1f} images a second{held}"
