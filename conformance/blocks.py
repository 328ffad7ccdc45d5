"""Runs SPEC.md's python blocks, which are a decoder together."""

from __future__ import annotations

import re
import struct
from typing import Any

from refcodec.bitstream import directory, syntax, tables
from refcodec.bitstream.dimensions import layers_of
from refcodec.bitstream.header import PROLOGUE_BYTES, Header


def blocks(text: str) -> dict[str, Any]:
    """Returns the names that the python blocks of SPEC.md define, with the constants of 2.5 and the tables of Annex A.

    text: SPEC.md.
    """
    table = text.partition("### 2.5 ")[2].partition("\n## ")[0]
    space: dict[str, Any] = {
        name: eval(value.replace("^", "**"))
        for name, value in re.findall(r"^\| ([A-Z][A-Z0-9_]+) \| ([^|]+) \|", table, re.MULTILINE)
    }
    for block in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        exec(compile(block, "SPEC.md", "exec"), space)
    data = tables.tables_file().read_bytes()
    space["SINE"], space["STEP"], space["GAUSS"], space["LAPLACE"] = space["READ_TABLES"](data)
    return space


def decode(space: dict[str, Any], data: bytes, header: Header) -> tuple[bytes, list[str | None]]:
    """Decodes a file with SPEC.md's blocks. Returns the canonical reconstruction, and the verdict on each substream.

    space: what `blocks` returns. header: what parse_container returns. The schemas of refcodec read the container, and
    its checksums are not checked again. If the weights or a chunk's positions have an error, the reconstruction is
    empty.
    """
    h, _ = syntax.parse("Header", data, PROLOGUE_BYTES)
    start = {name: header.sections[kind].start for kind, name in directory.SECTIONS.items()}
    frame, _ = syntax.parse("Frame", data, start["frame"])
    scales, size = syntax.parse("WeightScales", data, start["weights"])
    section = header.sections[directory.WEIGHTS]
    at, models = section.start + size, []
    found: list[str | None] = []
    raw: list[Any] = []
    for _, out, fan_in in layers_of(header.dimensions):
        if section.mode:
            model, size = syntax.parse("LayerModel", data, at)
            models.append(model)
            at += size
        if section.mode and model.form:
            raw.append(None)
            continue
        values = struct.unpack_from(f"<{out * (fan_in + 1)}f", data, at)
        at += 4 * len(values)
        raw.append(([values[r * fan_in : (r + 1) * fan_in] for r in range(out)], values[out * fan_in :]))
    if section.mode:
        stream = space["OPEN"](data[at : section.end], 1 << h.attribute_lanes_log2)
        raw, verdict = space["DECODE_WEIGHTS"](
            stream, [shape[1:] for shape in layers_of(header.dimensions)], models, raw
        )
        found.append(verdict)
        if verdict:
            return b"", found
    weights = b"".join(struct.pack(f"<{len(part)}f", *part) for rows, biases in raw for part in (*rows, biases))
    rest = iter(raw)
    layers: dict[str, Any] = {
        name: [next(rest) for _ in shapes] for name, shapes in header.dimensions.network_shapes().items()
    }
    table, size = syntax.parse("PlaneTable", data, start["planes"])
    at, streams = start["planes"] + size, []
    for length in table.length:
        streams.append(data[at : at + length])
        at += length
    k = header.dimensions.offset_count
    contexts = k * (k + 1) // 2
    model = struct.unpack_from(f"<{contexts}H", data, start["chunk_table"])
    entries_at, position_model = start["chunk_table"] + 2 * contexts, None
    if header.sections[directory.POSITIONS].mode:
        position_model, size = syntax.parse("PositionModel", data, entries_at)
        cell_models = [list(position_model.frequency[i : i + 16]) for i in range(0, 288, 16)]
        entries_at += size
    chunks, next_at = [], {name: start[name] for name in ("positions", "masks", "attributes")}
    for number, anchors in enumerate(header.chunks):
        entry, _ = syntax.parse("ChunkEntry", data, entries_at + 24 * number)
        part = {}
        for name, field in (
            ("positions", "position_length"),
            ("masks", "mask_length"),
            ("attributes", "attribute_length"),
        ):
            part[name] = data[next_at[name] : next_at[name] + entry[field]]
            next_at[name] += entry[field]
        if position_model is None:
            positions = list(struct.iter_unpack("<3H", part["positions"]))
        else:
            lanes = 1 << h.mask_lanes_log2
            positions, verdict = space["DECODE_POSITIONS"](
                part["positions"], position_model.cell_shift, cell_models, len(anchors), lanes
            )
            found.append(verdict)
        chunks.append((positions, part["masks"], part["attributes"]))
    all_weights = {"plane_shift": scales.plane_shift, "carm_shift": scales.carm_shift, "networks": layers}
    if any(found):
        return b"", found
    out, verdicts = space["DECODE_SCENE"](h, frame, all_weights, streams, model, chunks)
    d = header.dimensions
    result = b"C3GSREC0" + struct.pack("<5I", header.anchor_count, k, d.features, d.plane_channels, d.plane_size)

    def flat(value: list) -> list:
        return [x for item in value for x in flat(item)] if value and isinstance(value[0], list) else value

    for name, code in (
        ("positions", "f"),
        ("masks", "B"),
        ("planes", "h"),
        ("features", "f"),
        ("scalings", "f"),
        ("offsets", "f"),
    ):
        numbers = flat(out[name])
        result += struct.pack(f"<{len(numbers)}{code}", *numbers)
    return result + weights, found + verdicts
