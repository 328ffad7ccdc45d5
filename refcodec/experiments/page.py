"""What a demo has found, as one HTML page that needs nothing else: images, charts and its script are in it.

page.html is the template. Here are the words for its numbers, and its images.
"""

from __future__ import annotations

import base64
import io
import math
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup
from PIL import Image

from ..files.text import printable
from . import chart
from .result import U8, Result

# Differences are shown this many times larger.
DIFFERENCE_SCALE = 4
JPEG_QUALITY = 92
# Between a number and its unit.
_JOINED = "\N{NO-BREAK SPACE}"
_TEMPLATE = Path(__file__).with_name("page.html")


def readable(size: float) -> str:
    """A number of bytes with three digits: 512 B, 51.2 kB, 5.12 MB, 1 MB being 10^6 bytes."""
    for unit, scale in (("MB", 1e6), ("kB", 1e3)):
        # From where rounding to three digits would reach the unit.
        if size >= 0.9995 * scale:
            value = size / scale
            return f"{value:.{max(0, 2 - max(0, math.floor(math.log10(value) + 2e-4)))}f}{_JOINED}{unit}"
    return f"{size:.0f}{_JOINED}B"


def times(ratio: float) -> str:
    """A ratio with two digits or more."""
    return f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}"


def clock(seconds: float) -> str:
    """A time: 1.3 s, or 1 min 40 s."""
    return f"{seconds:.1f} s" if seconds < 60 else f"{int(seconds + 0.5) // 60} min {int(seconds + 0.5) % 60:02d} s"


def _shown(value: object) -> object:
    """What a page shows of a value: texts of names and documents as they may be shown."""
    return printable(value, lines=True) if type(value) is str else value


def jpeg(pixels: U8) -> str:
    """An image [h, w, 3] as the address of its own data."""
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"


def difference(a: U8, b: U8) -> U8:
    """How far two images are apart, DIFFERENCE_SCALE times: uint8, 0 where they are the same."""
    return np.clip(np.abs(a.astype(np.int64) - b) * DIFFERENCE_SCALE, 0, 255).astype(np.uint8)


def page(result: Result) -> str:
    """The page: HTML that refers to nothing outside itself but the files in its own folder."""
    environment = jinja2.Environment(
        autoescape=True,
        finalize=_shown,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    # A space that does not break is not printable, and these are no texts of others.
    environment.filters |= {"readable": lambda size: Markup(readable(size))}
    environment.filters |= {"times": times, "clock": clock, "jpeg": jpeg}
    before, after = (sum(getattr(part, side) for part in result.parts) for side in ("before", "after"))
    trained = zip(("uncompressed", "coded"), result.trained, strict=True)
    return environment.from_string(_TEMPLATE.read_text(encoding="utf-8")).render(
        r=result,
        before=before,
        after=after,
        decoding=sum(step.seconds for step in result.steps if step.name.endswith("decode")),
        stopped=[(name, done) for name, done in trained if done < result.steps_wanted],
        chart=chart.layout(result.charts),
        size=chart,
        difference=difference,
        scale=DIFFERENCE_SCALE,
        quality=JPEG_QUALITY,
    )
