"""The results of a demo as one HTML page: page.html is the template, this module formats its numbers and images."""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..pages.environment import raw, render
from ..pages.plots import lines

U8 = NDArray[np.uint8]

# The factor by which differences are enlarged.
DIFFERENCE_SCALE = 4
JPEG_QUALITY = 92
# Between a number and its unit.
_JOINED = "\N{NO-BREAK SPACE}"


def readable(size: float) -> str:
    """Returns a number of bytes with three digits: 512 B, 51.2 kB, 5.12 MB. 1 MB is 10^6 bytes."""
    for unit, scale in (("MB", 1e6), ("kB", 1e3)):
        # From where rounding to three digits would reach the unit.
        if size >= 0.9995 * scale:
            value = size / scale
            return f"{value:.{max(0, 2 - max(0, math.floor(math.log10(value) + 2e-4)))}f}{_JOINED}{unit}"
    return f"{size:.0f}{_JOINED}B"


def times(ratio: float) -> str:
    """Returns a ratio with two digits or more."""
    return f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}"


def clock(seconds: float) -> str:
    """Returns a time: 1.3 s, or 1 min 40 s."""
    return f"{seconds:.1f} s" if seconds < 60 else f"{int(seconds + 0.5) // 60} min {int(seconds + 0.5) % 60:02d} s"


def jpeg(pixels: U8) -> bytes:
    """Returns an image as JPEG. pixels: uint8 [h, w, 3]."""
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return data.getvalue()


def difference(a: U8, b: U8) -> U8:
    """Returns the absolute difference of two images times DIFFERENCE_SCALE, uint8."""
    return np.clip(np.abs(a.astype(np.int64) - b) * DIFFERENCE_SCALE, 0, 255).astype(np.uint8)


def page(result: dict[str, Any]) -> str:
    """Returns the page: HTML that refers to nothing outside itself except files in its own folder.

    result: as from demo.collect.
    """
    before, after = (sum(part[side] for part in result["parts"]) for side in ("before", "after"))
    trained = zip(("uncompressed", "coded"), result["trained"], strict=True)
    return render(
        Path(__file__).with_name("page.html"),
        r=result,
        before=before,
        after=after,
        decoding=sum(seconds for name, _, seconds in result["steps"] if name.endswith("decode")),
        stopped=[(name, done) for name, done in trained if done < result["steps_wanted"]],
        chart=lines("PSNR over time", result["charts"], "seconds", "PSNR of a few photographs, dB"),
        curve=lines("Rates", {"coded": [(b / 1e3, m.psnr) for b, _, m in result["rates"]]}, "file, kB", "PSNR, dB"),
        # A no-break space is not printable, thus a template would escape it.
        readable=lambda size: raw(readable(size)),
        times=times,
        clock=clock,
        jpeg=jpeg,
        difference=difference,
        scale=DIFFERENCE_SCALE,
        quality=JPEG_QUALITY,
    )
