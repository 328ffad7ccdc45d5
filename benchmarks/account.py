"""Where every byte of a file goes: heads, states and tables, and the symbols by what they are."""

from __future__ import annotations

import re
from collections import defaultdict

from refcodec.bitstream import codec
from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.conventions import Int64
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.entropy import SymbolName
from refcodec.bitstream.masks import code_masks, mask_models
from refcodec.bitstream.planes import code_planes
from refcodec.bitstream.positions import chunk_codes, code_cells
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet
from refcodec.bitstream.weights import code_grids, to_grid
from refcodec.inspect.elements import rows

from .ideal import BitCounter
from .results import table


class Ledger(BitCounter):
    """A counter of code lengths by what the symbols are: bits, by the first part of their names."""

    def __init__(self) -> None:
        self.bits: dict[str, float] = defaultdict(float)

    def values(
        self,
        models: ModelSet,
        mean: Int64,
        scale: Int64,
        counts: list[int],
        limit: int,
        name: SymbolName,
        given: Int64 | None,
    ) -> Int64:
        """As Encoder.values."""
        before = self.table
        found = super().values(models, mean, scale, counts, limit, name, given)
        if len(found):
            self.bits[name(0, 0).partition("[")[0]] += self.table - before
        return found

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """As Encoder.plain."""
        before = self.table
        found = super().plain(models, index, counts, name, given)
        if len(found):
            self.bits[name(0, 0).partition("[")[0]] += self.table - before
        return found


def code_lengths(scene: Scene) -> dict[str, dict[str, float]]:
    """Of each part with substreams, bits of the symbols of each kind under the file's models."""
    d, every = scene.dimensions, [range(scene.anchor_count)]
    coding = codec.Coding(scene)
    found = {name: Ledger() for name in ("weights", "planes", "positions", "masks", "attributes")}
    if coding.sarm is not None:
        code_planes(found["planes"], coding.sarm, d.plane_channels, d.plane_size, scene.planes)
    code_masks(found["masks"], mask_models(scene.mask_model), d.offset_count, every, scene.masks)
    code_attributes(found["attributes"], coding.model, coding.contexts(), scene.masks, every, scene.attributes)
    model = scene.position_model
    assert model is not None
    for chunk in scene.chunks:
        codes = chunk_codes(scene.positions[chunk.start : chunk.stop], model.cell_shift)
        assert codes is not None
        code_cells(found["positions"], model.models(), [0], [len(codes)], codes)
    layers = layers_of(d)
    # A layer by itself: its symbols are named after it.
    assert scene.weight_scales is not None
    grids = [to_grid(layer) for network in scene.networks.values() for layer in network]
    for shape, grid, scales in zip(layers, grids, scene.weight_scales, strict=True):
        assert grid is not None
        code_grids(found["weights"], [shape], scales[None], [grid])
    return {name: ledger.bits for name, ledger in found.items()}


# What an element of a substream is, by the end of its path. The other elements of a part are its tables.
ELEMENTS = {
    "symbol_crc": "heads of substreams",
    "word_count": "heads of substreams",
    "state": "states of lanes",
    "word": "stream",
    "raw": "stream",
    ", padding": "padding",
    ".padding": "padding",
}


def elements(data: bytes) -> dict[str, dict[str, int]]:
    """Bytes of each part of a file, by what they are: tables, stream, or another value of ELEMENTS."""
    found: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for row in rows(data):
        what = next((what for end, what in ELEMENTS.items() if row.path.endswith(end)), "tables")
        found[re.split(r"[.\[,]", row.path)[0]][what] += row.end - row.start
    return found


def account(data: bytes) -> list[str]:
    """A table of all bytes of a file with packed positions and weights, which adds up to its size."""
    symbols = code_lengths(codec.parse(data).scene)
    cells: list[list[str]] = []
    total = 0.0
    for part, sizes in elements(data).items():
        shares: dict[str, float] = {what: size for what, size in sizes.items() if what != "stream"}
        grouped: dict[str, float] = defaultdict(float)
        for path, bits in symbols.get(part, {}).items():
            words = path.split(".")
            kind = {"weights": f"{words[1]}, {words[-1]}s", "attributes": words[1]} if len(words) > 1 else {}
            grouped[kind.get(part, "symbols")] += bits / 8
        shares |= dict(sorted(grouped.items(), key=lambda item: -item[1]))
        if "stream" in sizes:
            # Lanes end in one state, so that the states sent are not lost whole.
            shares["coder, less what the states hold"] = sizes["stream"] - sum(grouped.values())
        for i, (what, size) in enumerate(shares.items()):
            cells.append(["" if i else part, what, f"{size:,.1f}", f"{size / len(data):.2%}"])
        total += sum(shares.values())
    assert round(total) == len(data), (total, len(data))
    return table(["part", "what", "bytes", "share"], [*cells, ["whole", "", f"{total:,.1f}", "100 %"]])
