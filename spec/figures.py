"""Draws the pictures of SPEC.md, with values computed by the blocks of SPEC.md."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any

from conformance import spec_decoder
from refcodec.bitstream.syntax import SYNTAX, parse_elements, size_of

from .made import ROOT, Made

PICTURES = ROOT / "spec" / "pictures"
INK, FAINT, FILL, LIGHT, STRONG, PAPER = "#1f2933", "#9aa5b1", "#dce6f2", "#f3f6fa", "#c2410c", "#ffffff"


class Drawing:
    """An SVG picture. Coordinates are pixels from the upper left corner."""

    def __init__(self, width: int, height: int, title: str) -> None:
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
            f'viewBox="0 0 {width} {height}" role="img">',
            f"<title>{title}</title>",
            '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
            'orient="auto">'
            f'<path d="M0 0 L8 4 L0 8 z" fill="{INK}"/></marker></defs>',
            f'<rect width="{width}" height="{height}" fill="{PAPER}"/>',
        ]

    def box(self, x: float, y: float, w: float, h: float, fill: str = FILL, line: str = INK) -> None:
        """Draws a rectangle."""
        self.parts.append(f'<rect x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" fill="{fill}" stroke="{line}"/>')

    def words(self, x: float, y: float, value: str, size: int = 13, anchor: str = "middle", bold: bool = False) -> None:
        """Writes a line of text at the baseline y. anchor: text-anchor of SVG."""
        weight = ' font-weight="bold"' if bold else ""
        safe = value.replace("&", "&amp;").replace("<", "&lt;")
        self.parts.append(
            f'<text x="{x:g}" y="{y:g}" font-family="sans-serif" font-size="{size}" '
            f'text-anchor="{anchor}"{weight}>{safe}</text>'
        )

    def line(
        self,
        points: list[tuple[float, float]],
        arrow: bool = False,
        stroke: str = INK,
        width: float = 1.2,
        dash: str = "",
    ) -> None:
        """Draws lines from point to point. dash: as in SVG."""
        path = " ".join(f"{x:g},{y:g}" for x, y in points)
        end = ' marker-end="url(#head)"' if arrow else ""
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(
            f'<polyline points="{path}" fill="none" stroke="{stroke}" stroke-width="{width:g}"{end}{dashes}/>'
        )

    def labelled(self, x: float, y: float, w: float, h: float, lines: list[str], fill: str = FILL) -> None:
        """Draws a box with centred lines of text. The first one is bold."""
        self.box(x, y, w, h, fill)
        top = y + h / 2 - 8 * (len(lines) - 1) + 4
        for i, value in enumerate(lines):
            self.words(x + w / 2, top + 16 * i, value, 13 if i == 0 else 11, bold=i == 0)

    def strip(self, x: float, y: float, parts: list[tuple[str, list[str], float]]) -> None:
        """Draws adjacent boxes. parts: the offset above a left edge, the lines (none: padding), the width."""
        for offset, lines, width in parts:
            self.labelled(x, y, width, 46, lines, LIGHT if lines else FAINT)
            if offset:
                self.words(x + 1, y - 5, offset, 11, "start")
            x += width

    def zoom(self, x: float, w: float, y: float, to_x: float, to_w: float, to_y: float) -> None:
        """Joins the lower edge of a box, from (x, y), to the upper edge of its enlargement, from (to_x, to_y)."""
        points = f"{x:g},{y:g} {x + w:g},{y:g} {to_x + to_w:g},{to_y:g} {to_x:g},{to_y:g}"
        self.parts.append(f'<polygon points="{points}" fill="{FILL}"/>')

    def svg(self) -> str:
        """Returns the file."""
        return "\n".join([*self.parts, "</svg>"]) + "\n"


def first_bytes(name: str, at: int = 0) -> dict[str, int]:
    """Returns the offset of each field of a struct that starts at byte `at`, with each length that it states 0."""
    starts: dict[str, int] = {}
    for element in parse_elements(name, bytes(1000), at):
        starts.setdefault(re.split(r"[.[]", element.path)[0], element.start)
    return starts


def scalar_size(kind: str) -> int:
    """Returns the bytes of a scalar such as u16, or of one item of an array of them."""
    return int(kind.partition("[")[0][1:]) // 8


def layout(space: dict[str, Any]) -> str:
    """Returns the picture of the bytes of a file, of its header, of a chunk and of a substream."""
    del space
    d = Drawing(1000, 472, "The bytes of a file, of its header, of a chunk and of a substream")
    rows = (50, 152, 254, 356)
    d.zoom(110, 150, rows[0] + 46, 20, 678, rows[1])
    d.zoom(760, 220, rows[0] + 46, 724, 256, rows[1])
    d.zoom(792, 68, rows[1] + 46, 20, 960, rows[2])
    d.zoom(808, 160, rows[2] + 46, 180, 800, rows[3])

    d.words(20, rows[0] - 24, "file: offsets from its start", 12, "start", bold=True)
    header = size_of("Prologue")
    d.strip(20, rows[0], [
        ("0", ["prologue", f"{header} bytes"], 90),
        (str(header), ["header", "header_length bytes"], 150),
        (f"{header} + header_length: the first section", ["FRAM", "frame"], 130),
        ("", ["WGTS", "weights"], 140),
        ("", ["PLNS", "planes"], 130),
        ("", ["INDX", "chunk index"], 100),
        ("", ["DATA", "chunks"], 220),
    ])  # fmt: skip

    d.words(20, rows[1] - 24, "header: offsets from the start of the file", 12, "start", bold=True)
    at = first_bytes("Header", header)
    grid, render, dimensions = at["position_grid"], at["render_info"], at["dimensions"]
    arrays = [kind for _, kind in SYNTAX["Dimensions"] if "[" in kind]
    fixed = sum(scalar_size(kind) for _, kind in SYNTAX["Dimensions"] if kind != "padding" and kind not in arrays)
    crc = scalar_size(dict(SYNTAX["Header"])["header_crc"])
    d.strip(20, rows[1], [
        (str(header), ["profile to base_step", f"{grid - header} bytes"], 162),
        (str(grid), ["PositionGrid", f"{render - grid} bytes"], 104),
        (str(render), ["RenderInfo", f"{dimensions - render} bytes"], 98),
        (str(dimensions), ["Dimensions", f"{fixed} bytes, widths"], 98),
        ("d", ["directory", f"{size_of('DirectoryEntry')} * section_count"], 116),
        (f"{header - crc} + header_length", ["header_crc", f"{crc} bytes"], 100),
    ])  # fmt: skip
    chunks = [("chunk 0", 68), ("chunk 1", 68), ("...", 24), ("chunk C - 1", 96)]
    d.strip(724, rows[1], [("", [name], width) for name, width in chunks])

    d.words(20, rows[2] - 24, "chunk: offsets from its start", 12, "start", bold=True)
    at = first_bytes("Chunk")
    heads = zip(SYNTAX["Chunk"], (122, 104, 130, 112, 78), strict=True)
    padding: tuple[str, list[str], float] = ("", [], 12)
    d.strip(20, rows[2], [
        *((str(at[field]), [field, kind], width) for (field, kind), width in heads),
        (str(size_of("Chunk")), ["positions", "f16[3] or Substream"], 134), padding,
        ("", ["masks", "Substream"], 84), padding,
        ("", ["attributes", "Substream"], 160), padding,
    ])  # fmt: skip

    d.words(180, rows[3] - 24, "substream: offsets from its start", 12, "start", bold=True)
    at, kinds = first_bytes("Substream"), dict(SYNTAX["Substream"])
    state = str(size_of("Substream"))
    word = f"{state} + {scalar_size(kinds['state'])} * lanes"
    raw = f"{word} + {scalar_size(kinds['word'])} * word_count"
    places = [str(at["symbol_crc"]), str(at["word_count"]), state, word, raw]
    parts = zip(places, kinds.items(), (120, 120, 160, 190, 210), strict=True)
    d.strip(180, rows[3], [(place, list(part), width) for place, part, width in parts])

    terms = [f"{scalar_size(kind)} * {kind.partition('[')[2][:-1]}".removeprefix("1 * ") for kind in arrays]
    d.words(20, 430, f"d = {dimensions} + {fixed} + {' + '.join(terms)}, rounded up to a multiple of 4", 11, "start")
    d.box(20, 446, 12, 12, FAINT)
    d.words(38, 456, "padding, 0 to 3 bytes; each section is followed by such padding, too", 11, "start")
    return d.svg()


def planes(space: dict[str, Any]) -> str:
    """Returns the picture of the sub-planes, their wavefronts, and the context of a symbol.

    space: the names of SPEC.md's blocks.
    """
    d = Drawing(760, 315, "Sub-planes, wavefronts and the context of a symbol")
    d.words(85, 24, "r = 1", bold=True)
    d.box(35, 50, 100, 100)
    d.words(85, 105, "0", 20)
    d.words(85, 42, "B", 11)
    d.words(255, 24, "r = 2", bold=True)
    marked = [[["1"]], [["2"]], [["3"]], [["4"]]]
    joined = space["JOIN_QUADRANTS"](marked)[0]
    for i in range(2):
        for j in range(2):
            d.box(175 + 80 * j, 50 + 80 * i, 80, 80)
            d.words(215 + 80 * j, 97 + 80 * i, joined[i][j], 20)
    d.words(255, 42, "2 B", 11)
    d.line([(175, 232), (335, 232)], arrow=True)
    d.words(255, 250, "column j: first principal component", 11)
    d.line([(352, 50), (352, 210)], arrow=True)
    d.words(356, 42, "row i: second", 11)
    size, cell, left, top = 6, 38, 420, 50
    d.words(left + size * cell / 2, 24, f"wavefronts t = j + 2 i, for B = {size}", bold=True)
    chosen = (2, 3)
    for t, group in enumerate(space["PLANE_GROUPS"](1, size)):
        for _, i, j in group:
            near = (i - chosen[0], j - chosen[1]) in {(-1, -1), (-1, 0), (-1, 1), (0, -1)}
            fill = "#fed7aa" if near else "#fb923c" if (i, j) == chosen else FILL if t % 2 else LIGHT
            d.box(left + cell * j, top + cell * i, cell, cell, fill, FAINT)
            d.words(left + cell * (j + 0.5), top + cell * (i + 0.5) + 5, str(t))
    for x, fill, value in (
        (420, "#fb923c", "a symbol"),
        (490, "#fed7aa", "its context, all of it of earlier wavefronts"),
    ):
        d.box(x, 289, 12, 12, fill, FAINT)
        d.words(x + 18, 300, value, 11, "start")
    d.words(35, 285, "Each sub-plane is coded alone, in one substream;", 11, "start")
    d.words(35, 300, "the number in a cell is its wavefront.", 11, "start")
    return d.svg()


def stages(space: dict[str, Any]) -> str:
    """Returns the picture of the inputs from which the symbols of an anchor are decoded."""
    del space
    d = Drawing(760, 330, "From position to symbols")
    d.labelled(20, 30, 110, 50, ["position", "7.4"], LIGHT)
    d.labelled(170, 30, 130, 50, ["frame, contraction,", "rescaling: 7.5.1 to 7.5.3"])
    d.labelled(340, 10, 130, 40, ["planes", "query: 7.5.4"])
    d.labelled(340, 66, 130, 40, ["gamma", "7.5.5"])
    d.labelled(520, 30, 80, 50, ["F_h", "7.7"])
    d.line([(130, 55), (170, 55)], arrow=True)
    d.line([(300, 48), (340, 30)], arrow=True)
    d.words(322, 28, "x', y'", 11)
    d.line([(300, 62), (340, 86)], arrow=True)
    d.words(316, 92, "z'", 11)
    d.line([(470, 30), (520, 46)], arrow=True)
    d.line([(470, 86), (520, 64)], arrow=True)
    d.line([(600, 55), (640, 55)], arrow=True)
    d.words(645, 46, "means, scale", 11, "start")
    d.words(645, 60, "indices, step", 11, "start")
    d.words(645, 74, "indices (7.8)", 11, "start")
    names = ["scalings", "offsets", "slice 0", "slice 1", "slice 2", "slice 3"]
    for n, name in enumerate(names):
        x = 20 + 122 * n
        d.labelled(x, 230, 105, 50, [name, f"group {n}"], LIGHT)
        d.line([(560, 80), (560, 132), (x + 52, 132), (x + 52, 230 if n <= 2 else 165)], arrow=True, stroke=FAINT)
        if n > 2:
            earlier = "of slice 0" if n == 3 else f"of slices 0 to {n - 3}"
            d.labelled(x + 2, 165, 101, 40, [f"+ carm.{n - 2}", earlier])
            d.line([(x + 52, 205), (x + 52, 230)], arrow=True)
            d.line([(x - 17, 242), (x - 8, 242), (x - 8, 185), (x + 2, 185)], arrow=True)
    d.words(
        20,
        310,
        "Groups of one substream, in coding order (7.10), with four slices; masked offsets have no symbols.",
        11,
        "start",
    )
    return d.svg()


def substream(space: dict[str, Any]) -> str:
    """Returns the picture of the bytes of a substream, and of the lanes of the symbols of a group."""
    streams = {"state": [0, 0, 0, 0]}
    lanes_of: list[int] = []
    original = space["DECODE_SYMBOL"]

    def noted(stream: dict, lane: int, model: None) -> int:
        lanes_of.append(lane)
        return 0

    space["DECODE_SYMBOL"] = noted
    groups = [6, 3]
    for count in groups:
        space["DECODE_GROUP"](streams, [None] * count)
    space["DECODE_SYMBOL"] = original
    d = Drawing(760, 250, "A substream and its lanes")
    parts = [
        ("symbol_crc", "u32", 90),
        ("word_count", "u32", 90),
        ("states", "u32[lanes]", 150),
        ("words", "u16[word_count]", 200),
        ("raw bytes", "to the end", 170),
    ]
    x = 20.0
    for name, kind, width in parts:
        d.labelled(x, 20, width, 46, [name, kind], LIGHT)
        x += width
    d.words(20, 100, "Lanes of the symbols of two groups, with four lanes: each group starts at lane 0.", 12, "start")
    colours = ["#dbeafe", "#dcfce7", "#fef3c7", "#fce7f3"]
    x, number = 20.0, 0
    for index, count in enumerate(groups):
        d.words(x, 128, f"group {index}", 12, "start", bold=True)
        for i in range(count):
            lane = lanes_of[number]
            d.labelled(x + 66 * i, 138, 60, 44, [f"lane {lane}", f"symbol {i}"], colours[lane])
            number += 1
        x += 66 * count + 24
    d.line([(20, 206), (x - 30, 206)], arrow=True)
    d.words(
        20,
        228,
        "Time. A lane below 2^16 takes the next word before the next symbol is decoded; raw bits are read after",
        11,
        "start",
    )
    d.words(20, 242, "the model indices of a group: first those of all symbols, then the escapes.", 11, "start")
    return d.svg()


def contraction(space: dict[str, Any]) -> str:
    """Returns the graph of the length after the contraction against the length before it, in units of U."""
    d = Drawing(560, 300, "Contraction")
    left, bottom, unit = 70, 250, 90

    def place(x: float, y: float) -> tuple[float, float]:
        return left + unit * x, bottom - unit * y

    for y in (0, 1, 2):
        d.line([place(0, y), place(5, y)], stroke=FAINT, dash="" if y == 0 else "3 3")
        d.words(left - 10, place(0, y)[1] + 4, f"{y} U" if y else "0", 12, "end")
    for x in range(6):
        d.line([place(x, 0), place(x, -0.05)])
        d.words(place(x, 0)[0], bottom + 22, f"{x} U" if x else "0", 12)
    points = [x / 50 for x in range(251)]
    d.line([place(x, space["CONTRACT"]([round(x * 65536), 0, 0])[0] / 65536) for x in points], stroke=STRONG, width=2)
    d.words(left + unit * 2.5, 290, "length before", 12)
    d.words(left + 20, 40, "length after: itself in the unit ball, then 2 - 1 / length, never 2", 12, "start")
    return d.svg()


MAKE: dict[str, Callable[[dict[str, Any]], str]] = {
    "layout": layout, "planes": planes, "stages": stages, "substream": substream, "contraction": contraction,
}  # fmt: skip


def made() -> Iterator[Made]:
    """Yields the pictures."""
    space = spec_decoder.names()
    for name, make in MAKE.items():
        yield Made.text(PICTURES / f"{name}.svg", make(space))
