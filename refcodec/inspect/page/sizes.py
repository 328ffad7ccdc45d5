"""Sizes by part, beside the shares that the paper gives for a scene of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .markup import NUMBER, TEXT, count, share, table, tag, text

# "CAT-3DGS Pro: A New Benchmark for Efficient 3DGS Compression" (arXiv 2503.12862), the table "Analysis of A-RDO and
# the VM hyperprior on the Amsterdam scene", its row "Ours, VM (ch=8)". Sizes in MB, which are taken for 10^6 bytes.
_PAPER = {"planes": 0.3, "attributes": 18.8}
_PAPER_WHOLE = 23.5
# The same, the table "Comparison of decoding time and rendering throughput": anchors of that scene.
_PAPER_ANCHORS = 421_600
_PAPER_TITLE = (
    "CAT-3DGS Pro (arXiv 2503.12862), table &ldquo;Analysis of A-RDO and the VM hyperprior on the <i>Amsterdam</i> "
    "scene&rdquo;"
)

# What each part is, in words.
_WORDS = {
    "prologue": "signature, version, length of the header",
    "header": "dimensions, steps, position grid, directory",
    "frame": "the principal axes of the anchors",
    "weights": "networks of the entropy model and of the renderer",
    "planes": "the planes of the hyperprior",
    "index": "models of masks and positions, and where chunks are",
    "positions": "where anchors are",
    "masks": "which offsets are kept",
    "attributes": "features, scalings and offsets",
    "heads": "heads of chunks, and padding",
    "ancillary": "metadata, cameras and other sections",
    "rest": "bytes behind the last section",
}


def _bar(part: float, whole: float, kind: str = "") -> str:
    return f'<span class="share {kind}" style="width:{100 * part / whole if whole else 0:.3f}%"></span>'


def section(facts: Mapping[str, Any]) -> str:
    """Returns the section of the page. facts: those of summary.document."""
    whole, anchors, parts = facts["bytes"], facts["header"]["anchor_count"], facts["parts"]

    def bits(number: int) -> str:
        return count(8 * number / anchors, 2) if anchors else "-"

    rows = [
        (
            tag("b", text(name)),
            text(_WORDS[name]),
            f'<data value="{number}">{number:,}</data>',
            share(number, whole),
            bits(number),
            _bar(number, whole),
        )
        for name, number in parts.items()
        if number
    ]
    rows.append((tag("b", "the file"), "", f"{whole:,}", share(whole, whole), bits(whole), ""))
    own = table(
        [
            ("part", TEXT),
            ("what it holds", TEXT),
            ("bytes", NUMBER),
            ("share of the file", NUMBER),
            ("bits per anchor", NUMBER),
            ("", "bar"),
        ],
        rows,
        id="parts",
    )
    return tag("section", tag("h2", "Sizes by part"), own, _beside(parts, whole, anchors), id="sizes")


def _beside(parts: Mapping[str, int], whole: int, anchors: int) -> str:
    """The three parts that the paper tells apart, of this file and of the paper's scene."""
    mine = {name: float(parts.get(name, 0)) for name in _PAPER}
    mine["everything else"] = whole - sum(mine.values())
    paper = {**_PAPER, "everything else": _PAPER_WHOLE - sum(_PAPER.values())}
    rows = []
    for name, number in mine.items():
        theirs = paper[name]
        rows.append(
            (
                tag("b", name),
                share(number, whole),
                share(theirs, _PAPER_WHOLE),
                count(8 * number / anchors, 1) if anchors else "-",
                count(8e6 * theirs / _PAPER_ANCHORS, 1),
                f"{theirs:.1f} MB",
                _bar(number, whole) + "<br>" + _bar(theirs, _PAPER_WHOLE, "paper"),
            )
        )
    return (
        tag("h3", "Beside the paper")
        + tag(
            "p",
            f"{_PAPER_TITLE}, row &ldquo;Ours, VM (ch=8)&rdquo;: {_PAPER_WHOLE} MB in all. Everything else is what "
            "the table does not tell apart: positions, masks and networks. Bits per anchor of the paper are made here, "
            f"with {_PAPER_ANCHORS:,} anchors (its table of decoding times) and 1 MB = 10<sup>6</sup> bytes. Its "
            "scene is another one: shares can be compared, sizes cannot.",
        )
        + table(
            [
                ("part", TEXT),
                ("share, this file", NUMBER),
                ("share, the paper", NUMBER),
                ("bits per anchor, this file", NUMBER),
                ("bits per anchor, the paper", NUMBER),
                ("size, the paper", NUMBER),
                ("this file above, the paper below", "bar"),
            ],
            rows,
        )
    )
