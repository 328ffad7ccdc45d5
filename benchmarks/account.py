"""Where every byte of a file goes: heads, states and tables, and the symbols by what they are."""

from __future__ import annotations

from collections import defaultdict

from conformance.cases.target import Target
from refcodec.bitstream import codec
from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.codec import parse_container
from refcodec.bitstream.conventions import Int64
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.entropy import SymbolName
from refcodec.bitstream.header import PROLOGUE_BYTES
from refcodec.bitstream.masks import code_masks, mask_models
from refcodec.bitstream.planes import code_planes
from refcodec.bitstream.positions import chunk_codes, code_cells
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet
from refcodec.bitstream.weights import code_grids, to_grid

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
    """Of each section with substreams, bits of the symbols of each kind under the file's models."""
    d, every = scene.dimensions, [range(scene.anchor_count)]
    coding = codec.Coding(scene)
    found = {name: Ledger() for name in ("weights", "planes", "positions", "masks", "attributes")}
    code_planes(found["planes"], coding.sarm, d.plane_channels, d.plane_size, scene.planes)
    code_masks(found["masks"], mask_models(scene.mask_model), d.offset_count, every, scene.masks)
    code_attributes(found["attributes"], coding.model, coding.contexts(), scene.masks, every, scene.attributes)
    model = scene.position_model
    assert model is not None
    for start in range(0, scene.anchor_count, scene.chunk_size):
        codes = chunk_codes(scene.positions[start : start + scene.chunk_size], model.cell_shift)
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


def account(data: bytes) -> list[str]:
    """A table of all bytes of a file with packed positions and weights, which adds up to its size."""
    scene, header = codec.parse(data).scene, parse_container(data)
    heads: dict[int, int] = defaultdict(int)
    states: dict[int, int] = defaultdict(int)
    streams: dict[int, int] = defaultdict(int)
    for s in Target(data).substreams.values():
        heads[s.section] += 8
        states[s.section] += 4 * s.lanes
        streams[s.section] += s.end - s.start
    symbols = code_lengths(scene)
    first = min(s.start for s in header.sections.values())
    rows: list[tuple[str, str, float]] = [
        ("prologue", "", PROLOGUE_BYTES),
        ("header", "fields and directory", first - PROLOGUE_BYTES),
    ]
    for kind, section in header.sections.items():
        name, size = section.name, section.end - section.start
        rows.append((name, "tables", size - streams[kind]))
        if not streams[kind]:
            continue
        rows.append((name, "heads of substreams", heads[kind]))
        rows.append((name, "states of lanes", states[kind]))
        spent = 0.0
        grouped: dict[str, float] = defaultdict(float)
        for path, bits in symbols[name].items():
            words = path.split(".")
            group = "symbols"
            if name == "weights":
                group = f"{words[1]}, {words[-1]}s"
            elif name == "attributes":
                group = words[1]
            grouped[group] += bits / 8
        for group, size_of in sorted(grouped.items(), key=lambda item: -item[1]):
            rows.append((name, group, size_of))
            spent += size_of
        # Lanes end in one state, so that the states sent are not lost whole.
        rows.append((name, "coder, less what the states hold", streams[kind] - heads[kind] - states[kind] - spent))
    total = sum(size for _, _, size in rows)
    assert round(total) == len(data), (total, len(data))
    cells, before = [], ""
    for name, what, share in rows:
        cells.append(["" if name == before else name, what, f"{share:,.1f}", f"{share / len(data):.2%}"])
        before = name
    return table(["section", "what", "bytes", "share"], [*cells, ["whole", "", f"{total:,.1f}", "100 %"]])
