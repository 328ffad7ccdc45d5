"""What a demo has made, as one HTML page that needs nothing else: images and charts are in it, and its few lines of script."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import NDArray
from PIL import Image

U8 = NDArray[np.uint8]

# Differences are shown this many times larger.
DIFFERENCE_SCALE = 4
JPEG_QUALITY = 92
# Between a number and its unit.
_JOINED = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True, eq=False)
class View:
    """A photograph and its two images, uint8 [h, w, 3] each; before, after: figures of the images (quality.measures)."""

    name: str
    photograph: U8
    uncompressed: U8
    decoded: U8
    before: dict[str, float]
    after: dict[str, float]


@dataclass(frozen=True)
class Part:
    """A part of a scene. name: its class of colour; text: what it is; before, after: bytes uncompressed and in the file."""

    name: str
    text: str
    before: int
    after: int


@dataclass(frozen=True)
class Step:
    """A command, as it is typed, and the seconds that it took."""

    name: str
    command: str
    seconds: float


@dataclass(frozen=True)
class Chart:
    """A training. points: its seconds and PSNR in dB."""

    name: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class File:
    """A file or folder. path: from the page's folder."""

    path: str
    text: str
    size: int


@dataclass(frozen=True, eq=False)
class Result:
    """What the page shows. photographs: how many there are; held_out: whether the views' were kept from the training; anchors, trained:
    anchors and steps of both trainings, the uncompressed one first, of steps_wanted; digest: SHA-256 of both sides' scene."""

    title: str
    photographs: int
    held_out: bool
    views: tuple[View, ...]
    mean_before: dict[str, float]
    mean_after: dict[str, float]
    parts: tuple[Part, ...]
    anchors: tuple[int, int]
    trained: tuple[int, int]
    steps_wanted: int
    rate: float
    digest: str
    steps: tuple[Step, ...]
    charts: tuple[Chart, ...]
    files: tuple[File, ...]
    credits: str


def readable(size: float) -> str:
    """A number of bytes with three digits: 512 B, 51.2 kB, 5.12 MB, 1 MB being 10^6 bytes."""
    for unit, scale in (("MB", 1e6), ("kB", 1e3)):
        # From where rounding to three digits would reach the unit.
        if size >= 0.9995 * scale:
            value = size / scale
            return f"{value:.{max(0, 2 - max(0, math.floor(math.log10(value) + 2e-4)))}f}{_JOINED}{unit}"
    return f"{size:.0f}{_JOINED}B"


def _times(ratio: float) -> str:
    return f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}"


def _clock(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60 else f"{int(seconds + 0.5) // 60} min {int(seconds + 0.5) % 60:02d} s"


def _image(pixels: U8, text: str) -> str:
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    height, width = pixels.shape[:2]
    source = base64.b64encode(data.getvalue()).decode()
    return f'<img alt="{escape(text)}" width="{width}" height="{height}" src="data:image/jpeg;base64,{source}">'


def difference(a: U8, b: U8) -> U8:
    """How far two images are apart, DIFFERENCE_SCALE times: uint8, 0 where they are the same."""
    return np.clip(np.abs(a.astype(np.int64) - b) * DIFFERENCE_SCALE, 0, 255).astype(np.uint8)


def _figures(figures: dict[str, float]) -> str:
    return f"{figures['psnr']:.2f} dB, SSIM {figures['ssim']:.3f}"


def _view(view: View) -> str:
    shown = [
        (view.photograph, "Photograph", escape(view.name)),
        (view.uncompressed, "Uncompressed", _figures(view.before)),
        (view.decoded, "Decoded from the file", _figures(view.after)),
        (
            difference(view.decoded, view.photograph),
            f"Difference, {DIFFERENCE_SCALE} times",
            "decoded against photograph",
        ),
    ]
    figures = (
        f"<figure>{_image(pixels, f'{name}: {view.name}')}<figcaption><b>{name}</b><br>{text}</figcaption></figure>"
        for pixels, name, text in shown
    )
    return f'<div class="view">{"".join(figures)}</div>'


def _slider(view: View) -> str:
    return (
        f'<div class="slider" style="--cut:50%">{_image(view.decoded, "Decoded from the file")}'
        f'<div class="before">{_image(view.uncompressed, "Uncompressed")}</div>'
        '<span class="tag left">uncompressed</span><span class="tag right">decoded</span><i></i>'
        '<input type="range" min="0" max="100" value="50" step="0.1" aria-label="Where the uncompressed image ends"></div>'
    )


def _bar(parts: Sequence[tuple[str, int]], total: float, label: str) -> str:
    """Sizes side by side, on a scale that ends at `total`."""
    rects, at = [], 0.0
    for name, size in parts:
        width = 100 * size / total
        if size:
            rects.append(
                f'<rect class="{name}" x="{at:.4f}" y="0" width="{width:.4f}" height="10"><title>{name}: {readable(size)}</title></rect>'
            )
        at += width
    return (
        f'<p class="bar">{escape(label)}</p><svg class="bar" viewBox="0 0 100 10" preserveAspectRatio="none" role="img" '
        f'aria-label="{escape(label)}">{"".join(rects)}</svg>'
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: int = 0) -> str:
    """Cells are HTML. numbers: how many of the last columns hold numbers."""
    first = len(head) - numbers

    def row(cells: Sequence[str], tag: str) -> str:
        return (
            "<tr>"
            + "".join(f"<{tag}{' class=n' if i >= first else ''}>{c}</{tag}>" for i, c in enumerate(cells))
            + "</tr>"
        )

    body = "".join(row(cells, "td") for cells in rows)
    return f'<div class="wide"><table><thead>{row(head, "th")}</thead><tbody>{body}</tbody></table></div>'


def _sizes(result: Result) -> str:
    before, after = (sum(getattr(part, side) for part in result.parts) for side in ("before", "after"))
    sides = [[(part.name, getattr(part, side)) for part in result.parts] for side in ("before", "after")]
    rows = [
        (
            f'<i class="swatch {part.name}"></i>{part.name}<span class="soft told">{part.text}</span>',
            readable(part.before) if part.before else "&ndash;",
            readable(part.after),
            f"{100 * part.after / after:.1f} %",
            _times(part.before / part.after) if part.before and part.after else "&ndash;",
        )
        for part in result.parts
    ]
    rows.append(
        (
            "<b>all</b>",
            f"<b>{readable(before)}</b>",
            f"<b>{readable(after)}</b>",
            "100 %",
            f"<b>{_times(before / after)}</b>",
        )
    )
    return (
        _bar(sides[0], before, f"uncompressed, {readable(before)}")
        + _bar(sides[1], before, f"the file on the same scale, {readable(after)}")
        + _bar(sides[1], after, f"the file, enlarged {_times(before / after)} times")
        + _table(("part", "uncompressed", "file", "of the file", "times smaller"), rows, 4)
        + f"<p>Uncompressed is every value of {result.anchors[0]:,} anchors as float32. The file is of another training, which pays for "
        f"bits and ended with {result.anchors[1]:,} anchors; its weights include those of the networks that "
        "predict the symbols. 1 MB is 10<sup>6</sup> bytes.</p>"
    )


def _ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers from low to high, about `count` of them."""
    rough = max(high - low, 1e-9) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    return [i * step for i in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]


def _chart(charts: Sequence[Chart]) -> str:
    """PSNR over seconds, a line for each training, whose name is at its end."""
    points = [point for chart in charts for point in chart.points if all(map(math.isfinite, point))]
    if not points:
        return "<p>There was no time to note anything.</p>"
    left, right, top, bottom, width, height = 52, 128, 12, 28, 600, 300
    end = max(seconds for seconds, _ in points) or 1.0
    low, high = min(psnr for _, psnr in points), max(psnr for _, psnr in points)
    high = max(high, low + 1)

    def x(seconds: float) -> float:
        return left + (width - left - right) * seconds / end

    def y(psnr: float) -> float:
        return top + (height - top - bottom) * (high - psnr) / (high - low)

    lines = []
    for tick in _ticks(low, high, 8):
        at = f'y1="{y(tick):.1f}" y2="{y(tick):.1f}"'
        lines.append(f'<line class="grid" x1="{left}" x2="{width - right}" {at}/>')
        lines.append(f'<text x="{left - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>')
    lines += [
        f'<text x="{x(tick):.1f}" y="{height - bottom + 20}" text-anchor="middle">{tick:g}</text>'
        for tick in _ticks(0, end, 6)
    ]
    ends = []
    for chart in charts:
        kept = [(x(seconds), y(psnr)) for seconds, psnr in chart.points if math.isfinite(psnr)]
        if kept:
            path = " ".join(f"{a:.1f},{b:.1f}" for a, b in kept)
            lines.append(f'<polyline class="{escape(chart.name)}" points="{path}"/>')
            ends.append((kept[-1][1], kept[-1][0], chart.name))
    # Names keep a line's height between them.
    below = -math.inf
    for place, across, name in sorted(ends):
        below = max(place, below + 18)
        lines.append(f'<text class="{escape(name)}" x="{across + 6:.1f}" y="{below + 4:.1f}">{escape(name)}</text>')
    return f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="PSNR over time">{"".join(lines)}</svg>'


_STYLE = """
:root{color-scheme:light dark;--page:#fbfbf9;--ink:#1c1c1a;--soft:#5d5d57;--line:#dcdcd5;--card:#fff;--uncompressed:#5a6b7b;--coded:#0b6fb8;
--positions:#8c6bb1;--attributes:#0b6fb8;--masks:#d9822b;--planes:#2a9d6f;--weights:#c2426b;--headers:#8a8a82}
@media(prefers-color-scheme:dark){:root{--page:#161615;--ink:#ececE6;--soft:#a3a39a;--line:#34342f;--card:#1f1f1d;--uncompressed:#9fb0bf;
--coded:#5fb2f0;--positions:#b59ad8;--attributes:#5fb2f0;--masks:#f0a95b;--planes:#5cc79c;--weights:#ea7a9e;--headers:#8f8f87}}
*{box-sizing:border-box}
body{margin:0 auto;padding:2rem clamp(1rem,4vw,3rem) 4rem;max-width:90rem;background:var(--page);color:var(--ink);
font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
h1{font-size:clamp(1.6rem,4vw,2.4rem);line-height:1.15;margin:0 0 .6rem;text-wrap:balance}
h2{font-size:1.2rem;margin:2.8rem 0 .8rem}
p{max-width:46rem;margin:.6rem 0}
.lead{font-size:1.1rem}
.note{border-left:4px solid var(--masks);padding-left:.8rem}
.hero{display:grid;grid-template-columns:minmax(0,3fr) minmax(0,2fr);gap:1.4rem;margin:1.6rem 0;align-items:start}
.facts{display:grid;grid-template-columns:1fr 1fr;gap:.8rem}
.facts div{background:var(--card);border:1px solid var(--line);border-radius:.5rem;padding:.7rem .9rem;color:var(--soft);font-size:.85rem}
.facts div:last-child{grid-column:1/-1}
.facts b{display:block;font-size:clamp(1.4rem,2.2vw,2rem);line-height:1.25;color:var(--ink);font-variant-numeric:tabular-nums}
img{display:block;width:100%;height:auto;border-radius:.25rem}
.view{display:grid;grid-template-columns:repeat(4,1fr);gap:.8rem;margin-bottom:1.4rem}
figure{margin:0}
figcaption{font-size:.85rem;line-height:1.4;color:var(--soft);margin-top:.35rem;font-variant-numeric:tabular-nums}
figcaption b{color:var(--ink)}
.slider{position:relative;touch-action:pan-y}
.slider .before{position:absolute;inset:0;clip-path:inset(0 calc(100% - var(--cut)) 0 0)}
.slider i{position:absolute;top:0;bottom:0;left:var(--cut);width:2px;margin-left:-1px;background:#fff;box-shadow:0 0 4px #000}
.slider i::after{content:"";position:absolute;top:50%;left:50%;width:2rem;height:2rem;margin:-1rem;border:2px solid #fff;border-radius:50%;
background:#0006}
.slider input{position:absolute;inset:0;width:100%;height:100%;margin:0;opacity:0;cursor:ew-resize;touch-action:pan-y}
.slider:focus-within{outline:2px solid var(--coded);outline-offset:3px}
.tag{position:absolute;top:.6rem;padding:.1rem .6rem;border-radius:1rem;background:#000a;color:#fff;font-size:.85rem}
.left{left:.6rem}.right{right:.6rem}
p.bar{margin:.9rem 0 .2rem}p.bar,.soft{font-size:.9rem;color:var(--soft)}
svg.bar{display:block;width:100%;max-width:62rem;height:1.8rem;background:var(--line);border-radius:.25rem}
svg.bar rect{stroke:var(--page);stroke-width:2;vector-effect:non-scaling-stroke}
.wide{overflow-x:auto;max-width:62rem;margin:1rem 0}
table{border-collapse:collapse;width:100%;font-size:.92rem}
th,td{text-align:left;padding:.4rem .9rem .4rem 0;border-bottom:1px solid var(--line);vertical-align:top}
th{font-weight:600;color:var(--soft)}
.n{text-align:right;font-variant-numeric:tabular-nums}td.n{white-space:nowrap}
code{font:.85em/1.5 ui-monospace,SFMono-Regular,Consolas,monospace;overflow-wrap:anywhere}
.told{margin-left:1rem}
.swatch{display:inline-block;width:.8em;height:.8em;border-radius:.2em;margin-right:.5em}
.chart{display:block;width:100%;max-width:50rem;font:13px system-ui,sans-serif}
.chart text{fill:var(--soft)}.grid{stroke:var(--line)}
polyline{fill:none;stroke-width:2;stroke-linejoin:round}
pre{white-space:pre-wrap;font:inherit;font-size:.9rem;color:var(--soft);max-width:62rem}
@media(max-width:48rem){.hero{grid-template-columns:minmax(0,1fr)}
.view{grid-template-columns:1fr 1fr}.chart{font-size:16px}table{font-size:.8rem}.told{display:none}th,td{padding-right:.5rem}}
"""
_COLOURS = "".join(
    f"rect.{name}{{fill:var(--{name})}}.swatch.{name}{{background:var(--{name})}}"
    for name in ("positions", "attributes", "masks", "planes", "weights", "headers")
) + "".join(
    f"polyline.{name}{{stroke:var(--{name})}}.chart text.{name}{{fill:var(--{name})}}"
    for name in ("uncompressed", "coded")
)
_SCRIPT = """
for (const s of document.querySelectorAll(".slider"))
  s.lastElementChild.addEventListener("input", e => s.style.setProperty("--cut", e.target.value + "%"));
"""


def page(result: Result) -> str:
    """The page: HTML that refers to nothing outside itself but the files in its own folder."""
    before, after = (sum(getattr(part, side) for part in result.parts) for side in ("before", "after"))
    how = "that were kept from the training" if result.held_out else "that the training saw, as none were held out"
    lead = (
        f"{result.photographs} photographs were learned as 3D Gaussians, once uncompressed ({readable(before)}) and once with the codec of "
        f"CAT-3DGS Pro, as a C3GS file of {readable(after)}. Another process decoded the file and drew it from the cameras of "
        f"{len(result.views)} photographs {how}."
    )
    facts = [
        (_times(before / after), f"times smaller: {readable(before)} to {readable(after)}"),
        (
            _clock(sum(s.seconds for s in result.steps if s.name.endswith("decode"))),
            "to decode the file, from the start of the program",
        ),
        *(
            (f"{mean[name]:{digits}}{unit}", f"mean {name.upper()}, {side}")
            for name, digits, unit in (("psnr", ".2f", " dB"), ("ssim", ".3f", ""))
            for mean, side in ((result.mean_before, "uncompressed"), (result.mean_after, "decoded from the file"))
        ),
    ]
    stopped = [
        f"{name} at step {done:,}"
        for name, done in zip(("uncompressed", "coded"), result.trained, strict=True)
        if done < result.steps_wanted
    ]
    note = f"The training was stopped early: {' and '.join(stopped)} of {result.steps_wanted:,}. The same command goes on from there."
    body = [
        f"<h1>{escape(result.title)}: {readable(before)} of Gaussians in a file of {readable(after)}</h1>",
        f'<p class="lead">{lead}</p>',
        f'<p class="note">{note}</p>' if stopped else "",
        f'<div class="hero"><div>{_slider(result.views[0])}<p class="soft">{escape(result.views[0].name)}: drag to compare.</p></div>',
        '<div class="facts">' + "".join(f"<div><b>{value}</b>{text}</div>" for value, text in facts),
        "<div><b>the same SHA-256</b>of the scene before encoding and of the one that another process decoded</div></div></div>",
        f"<h2>Where the bytes are</h2>{_sizes(result)}",
        "<h2>Held-out views</h2>" if result.held_out else "<h2>Views</h2>",
        *map(_view, result.views),
        f"<p>Images are JPEG of quality {JPEG_QUALITY} here; the figures are of the exact ones, which are in the folders below.</p>",
        f"<h2>PSNR over time</h2><p>Both trained at the same time, with one thread each, the coded scene with λ<sub>r</sub>&nbsp;=&nbsp;"
        f"{result.rate:g}. Upwards: PSNR in dB of a few photographs; to the right: seconds of training, and at first of compiling.</p>"
        + _chart(result.charts),
        "<h2>What was run</h2>"
        + _table(
            ("step", "command", "time"),
            (
                (escape(step.name), f"<code>{escape(step.command)}</code>", _clock(step.seconds))
                for step in result.steps
            ),
            1,
        ),
        "<h2>Exactness</h2><p>The scene before encoding and the one that another process decoded have the same SHA-256:<br>"
        f"<code>{escape(result.digest)}</code></p>",
        "<h2>Files</h2>"
        + _table(
            ("file", "what it is", "size"),
            (
                (f'<a href="{escape(f.path)}"><code>{escape(f.path)}</code></a>', escape(f.text), readable(f.size))
                for f in result.files
            ),
            1,
        ),
        f"<h2>Photographs</h2><pre>{escape(result.credits)}</pre>",
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>C3GS: {escape(result.title)}</title><style>{_STYLE}{_COLOURS}</style></head>\n<body>\n"
        + "\n".join(part for part in body if part)
        + f"\n<script>{_SCRIPT}</script></body></html>\n"
    )
