"""Curves of an experiment's results: bytes against PSNR, a line for each method, as PNG and SVG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from ..files.stage import write_file
from .tables import Row, grouped, spread


def write_curves(folder: Path, rows: Sequence[Row]) -> None:
    """Writes SCENE.png and SCENE.svg for each scene. Points are means over seeds, bars sample deviations."""
    # The same rows give the same SVG.
    with mpl.rc_context({"svg.hashsalt": "C3GS"}):
        for (scene,), of_scene in grouped(rows, "scene").items():
            figure = draw(scene, of_scene)
            for suffix, notes in (("png", {}), ("svg", {"Date": None})):
                data = io.BytesIO()
                figure.savefig(data, dpi=150, format=suffix, metadata=notes)
                write_file(folder / f"{scene}.{suffix}", data.getvalue())


def draw(scene: str, rows: Sequence[Row]) -> Figure:
    """The chart of one scene. An uncompressed method is a ring. A NaN deviation has no error bar."""
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    axes = figure.subplots()
    for (method,), of_method in grouped(rows, "method").items():
        points = sorted(
            (
                (spread([one["bytes"] for one in same]), spread([one["psnr"] for one in same]), rate)
                for (rate,), same in grouped(of_method, "rate").items()
            ),
            key=lambda point: point[0].mean,
        )
        sizes, psnrs = [point[0] for point in points], [point[1] for point in points]
        rated = any(rate for *_, rate in points)
        axes.errorbar(
            [size.mean for size in sizes],
            [psnr.mean for psnr in psnrs],
            xerr=[size.deviation for size in sizes],
            yerr=[psnr.deviation for psnr in psnrs],
            label=method,
            capsize=2,
            fmt="o-" if rated else "o",
            markerfacecolor=None if rated else "none",
        )
    axes.set(xscale="log", xlabel="bytes", ylabel="PSNR, dB", title=scene)
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    return figure
