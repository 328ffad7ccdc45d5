"""The meaning of each element of a file: its syntax table, the clauses that use it, and the requirements on it.

Elements are named by their paths, as `elements` gives them. A test compares the rules here with SPEC.md, and tries them
on every byte of the vectors.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from ..bitstream.ancillary import TYPES
from ..bitstream.syntax import SYNTAX

# The clause of each syntax table, in the order of SPEC.md.
TABLE_CLAUSES = {
    "Prologue": "5.1",
    "Header": "5.2",
    "Dimensions": "5.3",
    "PositionGrid": "5.4",
    "RenderInfo": "5.5",
    "DirectoryEntry": "5.6",
    "Frame": "5.7",
    "WeightScales": "5.8",
    "LayerModel": "5.9",
    "PlaneTable": "5.10",
    "MaskModel": "5.11",
    "PositionModel": "5.12",
    "ChunkEntry": "5.13",
    "Chunk": "5.14",
    "Substream": "5.15",
    **{table: clause for entry in TYPES.values() for table, clause in entry.tables.items()},
}

# The paths of the fields of each table. FIELD is the field name. The first matching pattern applies.
_STREAM = r"(?:weights|planes\.[\w.]+|(?:positions|masks|attributes)\[chunk \d+\])"
TABLES: list[tuple[str, str]] = [
    (r"prologue\.FIELD", "Prologue"),
    (r"header\.dimensions\.FIELD", "Dimensions"),
    (r"header\.position_grid\.FIELD", "PositionGrid"),
    (r"header\.render_info\.FIELD", "RenderInfo"),
    (r"header\.directory\[\d+\]\.FIELD", "DirectoryEntry"),
    (r"header\.FIELD", "Header"),
    (r"frame\.FIELD", "Frame"),
    (r"planes\.FIELD", "PlaneTable"),
    (r"index\.mask_model\.FIELD", "MaskModel"),
    (r"index\.position_model\.FIELD", "PositionModel"),
    (r"index\.entry\[\d+\]\.FIELD", "ChunkEntry"),
    (r"chunk\[\d+\]\.FIELD", "Chunk"),
    (rf"{_STREAM}\.FIELD", "Substream"),
    (r"weights\.(?:hyper|sarm|carm\.\d+|opacity|covariance|colour)\.\d+\.FIELD", "LayerModel"),
    (r"weights\.FIELD", "WeightScales"),
    *(
        (rf"{entry.type.decode()}\[\d+\]{at}\.FIELD", table)
        for entry in TYPES.values()
        for at, table in ((rf"\.{entry.item}\[\d+\]", entry.items), ("", entry.head))
    ),
]

# For each field the clauses that use it, without that of its table, and the requirements on it. The requirements that a
# wrong value breaks come first.
FIELDS: dict[str, str] = {
    "Prologue.signature": "6.1 R6.1-1 R6.1-2",
    "Prologue.major": "6.1 12.3 R6.1-4",
    "Prologue.minor": "6.1 12.3 R6.2-3",
    "Prologue.header_length": "6.1 R6.1-5 R6.2-1 R6.2-3",
    "Prologue.prologue_crc": "6.1 R6.1-3",
    "Header.profile": "11.1 R11.1-1",
    "Header.level": "11.2 R11.2-1 R11.2-4",
    "Header.section_count": "6.6 R6.6-3 R6.2-3",
    "Header.anchor_count": "6.10 11.2 R11.2-2 R11.2-3 R11.2-4",
    "Header.chunk_count": "6.10 R6.2-8",
    "Header.chunk_size": "6.10 11.1 R11.1-3",
    "Header.plane_lanes_log2": "6.2 8.3 R6.2-6",
    "Header.mask_lanes_log2": "6.2 8.3 R6.2-6",
    "Header.attribute_lanes_log2": "6.2 8.3 R6.2-6",
    "Header.reserved": "6.2 R6.2-5",
    "Header.base_step": "6.2 7.8 9.2 R6.2-7",
    "Header.header_crc": "6.2 R6.2-2",
    **dict.fromkeys(
        (f"Dimensions.{name}" for name in ("hyper_layers", "hyper_width", "sarm_layers", "sarm_width")),
        "6.3 5.8 R11.1-2",
    ),
    **dict.fromkeys(
        (f"Dimensions.{name}" for name in ("carm_layers", "carm_width", "render_width")), "6.3 5.8 R11.1-2"
    ),
    "Dimensions.offset_count": "6.3 7.6 R11.1-2",
    "Dimensions.plane_channels": "6.3 7.3 R11.1-2",
    "Dimensions.frequency_count": "6.3 7.5.5 R11.1-2",
    "Dimensions.plane_size": "6.3 7.3 11.2 R11.1-2 R11.2-4",
    "Dimensions.slice_count": "6.3 7.10 R11.1-2",
    "Dimensions.slice_width": "6.3 7.10 R11.1-2",
    "Dimensions.view_inputs": "6.5 5.8 14.3 R11.1-2",
    "Dimensions.colour_outputs": "6.5 5.8 14.3 R11.1-2",
    "Dimensions.reserved": "6.2 R6.2-5",
    "Dimensions.padding": "R6.2-4",
    "PositionGrid.origin": "6.4 9.1 R6.4-1 D9.1-1",
    "PositionGrid.scale_mantissa": "6.4 9.1 R6.4-1 D9.1-1",
    "PositionGrid.scale_exponent": "6.4 9.1 R6.4-1 D9.1-1",
    "PositionGrid.reserved": "6.2 R6.2-5",
    "RenderInfo.background": "14.5",
    "RenderInfo.up_axis": "6.5 R6.5-1",
    "RenderInfo.near_plane": "6.5 14.4 R6.5-1",
    "RenderInfo.distance_unit": "6.5 14.3 R6.5-1",
    "RenderInfo.alpha_max": "6.5 14.5 R6.5-1",
    "RenderInfo.low_pass": "6.5 14.4 R6.5-1",
    "RenderInfo.colour_primaries": "6.5 14.5",
    "RenderInfo.transfer_characteristics": "6.5 14.5",
    "RenderInfo.render_model": "6.5 R11.1-2 G6.5-1",
    "RenderInfo.reserved": "6.2 R6.2-5",
    "DirectoryEntry.type": "6.6 12.1 R6.6-1 R6.6-2 R6.6-3",
    "DirectoryEntry.mode": "6.6 R6.6-4",
    "DirectoryEntry.reserved": "6.2 R6.2-5",
    "DirectoryEntry.length": "6.6 R6.6-5 R6.6-6",
    "DirectoryEntry.crc": "6.6 R6.6-7",
    "Frame.matrix": "6.7 7.5.1 R6.7-2 D7.5.1-1",
    "Frame.translation": "6.7 7.5.1 R6.7-2 D7.5.1-1",
    "Frame.shift": "6.7 7.5.1 R6.7-2 D7.5.1-1",
    "Frame.reserved": "6.7 R6.7-1",
    "Frame.low": "6.7 7.5.3 R6.7-2 D7.5.3-1",
    "Frame.high": "6.7 7.5.3 R6.7-2 D7.5.3-1",
    "WeightScales.plane_shift": "6.8 7.5.4 R6.8-1 D7.5.4-1",
    "WeightScales.carm_input_count": "6.8 R6.8-1",
    "WeightScales.carm_shift": "6.8 7.9 R6.8-1 D7.9-1",
    "WeightScales.padding": "R6.8-2",
    "LayerModel.form": "6.8 7.13 R6.8-7 R6.8-5",
    "LayerModel.exponent_scale": "7.13 R6.8-7 D7.13-1",
    "LayerModel.exponent": "6.8 7.13 R6.8-7 R6.8-8 D7.13-1",
    "LayerModel.weight_scale": "7.13 R6.8-7 D7.13-1",
    "LayerModel.bias_scale": "7.13 R6.8-7 D7.13-1",
    "LayerModel.reserved": "R6.8-6",
    "PlaneTable.length": "6.9 R6.9-1",
    "MaskModel.frequency": "6.10 7.6 R6.10-1 D7.6-1",
    "MaskModel.padding": "R6.10-2",
    "PositionModel.cell_shift": "6.10 7.12 R6.10-4 D7.12-1",
    "PositionModel.reserved": "R6.10-3",
    "PositionModel.frequency": "6.10 7.12 R6.10-4 D7.12-1",
    "ChunkEntry.length": "6.10 R6.10-5 R6.10-6",
    "ChunkEntry.crc": "6.11 R6.11-1",
    "ChunkEntry.anchor_count": "6.10 R6.10-5 R6.10-6",
    "ChunkEntry.kept_count": "6.10 R6.10-5 R6.11-11",
    "ChunkEntry.low": "6.10 R6.10-5 R6.11-10",
    "ChunkEntry.high": "6.10 R6.10-5 R6.11-10",
    "Chunk.position_length": "6.11 R6.11-4",
    "Chunk.mask_length": "6.11 R6.11-4",
    "Chunk.attribute_length": "6.11 R6.11-4",
    "Chunk.position_form": "6.11 R6.11-3",
    "Chunk.reserved": "R6.11-2",
    "Substream.symbol_crc": "8.8 R8.8-5 R8.1-1 D8.8-1 D8.8-2",
    "Substream.word_count": "8.8 R8.1-1 R8.8-1",
    "Substream.state": "8.1 8.3 R8.1-1 R8.1-2 R8.8-2 D8.3-1",
    "Substream.word": "8.2 8.3 R8.8-1 R8.8-2 R8.8-5 D8.2-1",
    "Substream.raw": "8.5 8.6 8.7 R8.8-3 R8.8-4 R8.7-1 R8.5-1 R8.8-5 D8.5-1 D8.6-1 D8.7-1",
    **{
        f"{table}.{name}": " ".join((entry.clause, *entry.cited.get(name, "").split(), "R6.6-7"))
        for entry in TYPES.values()
        for table in entry.tables
        for name, _ in SYNTAX[table]
    },
}

# The elements outside tables: the pattern of their paths, their contents, clauses and requirements.
_CODING = r"weights\.(?:hyper|sarm|carm\.\d+)\.\d+"
_RENDERING = r"weights\.(?:opacity|covariance|colour)\.\d+"
_ANCILLARY = r"[a-z][A-Za-z]{3}\[\d+\]"
_SECTION = rf"(?:frame|weights|planes|index|data|{_ANCILLARY}|\w+\[\d+\])"
PAYLOADS: list[tuple[str, str, str]] = [
    (rf"{_CODING}\.weight", "weights of a layer, row by row", "5.8 6.8 7.2 R6.8-3 R6.8-4 D7.2-1"),
    (rf"{_CODING}\.bias", "its biases", "5.8 6.8 7.2 R6.8-3 R6.8-4 D7.2-1"),
    (rf"{_RENDERING}\.weight", "weights of a layer, row by row", "5.8 6.8 14.3 R6.8-3 G14.3-1"),
    (rf"{_RENDERING}\.bias", "its biases", "5.8 6.8 14.3 R6.8-3 G14.3-1"),
    (
        r"positions\[chunk \d+\]",
        "x, y, z of each anchor of the chunk",
        "5.14 6.11 7.4 R6.11-6 R6.11-7 R6.11-10 D7.4-1",
    ),
    (_STREAM, "a substream that is cut off", "5.15 8.1 R8.1-1"),
    (r"planes\.[\w.]+, padding", "zeros", "5.10 R6.9-2"),
    (r"(?:positions|masks|attributes)\[chunk \d+\], padding", "zeros", "5.14 R6.11-5"),
    (rf"{_SECTION}, padding", "zeros", "5.6 R6.6-8"),
    (r"chunk\[\d+\], bytes that no element uses", "bytes of a chunk that no element uses", "6.11 R6.11-4"),
    (r"header, bytes that no field uses", "bytes between the last field and the CRC-32", "6.2 12.3 R6.2-3"),
    (r"bytes that no element uses", "bytes that no element uses", "6.6 R6.6-9 R6.1-2 R6.2-1"),
    (
        rf"{_SECTION}, bytes that no element uses",
        "bytes of a section that no element uses",
        "6.6 R6.6-5 R6.9-1 R6.10-6",
    ),
    (_ANCILLARY, "an ancillary section, which a decoder may skip", "12.1 R6.6-7"),
    (_SECTION, "bytes of a section that no element uses", "6.6 R6.6-5 R6.6-7"),
]

# The clauses and requirements by which the substreams of a section are decoded.
DECODED = {
    "weights": "7.13 R6.8-8 D7.13-1",
    "planes": "7.3 D7.3-1 D7.3-2",
    "positions": "7.12 R6.11-8 R6.11-9 D7.12-1",
    "masks": "7.6 D7.6-1",
    "attributes": "7.5 7.7 7.8 7.9 7.10 D7.10-1",
}


@dataclass(frozen=True)
class Meaning:
    """The meaning of an element.

    table, field: those of chapter 5, or empty for a payload.
    words: the contents of a payload.
    clauses, requirements: in the order in which they are worth reading.
    """

    table: str
    field: str
    words: str
    clauses: tuple[str, ...]
    requirements: tuple[str, ...]


def _meaning(table: str, field: str, words: str, names: list[str]) -> Meaning:
    unique = list(dict.fromkeys(names))
    clauses = tuple(name for name in unique if name[0].isdigit())
    return Meaning(table, field, words, clauses, tuple(name for name in unique if not name[0].isdigit()))


def of_field(table: str, field: str) -> Meaning:
    """Returns the meaning of a field of a syntax table. Raises KeyError."""
    return _meaning(table, field, "", [TABLE_CLAUSES[table], *FIELDS[f"{table}.{field}"].split()])


def meaning(path: str) -> Meaning:
    """Returns the meaning of the element at a path. Raises KeyError for a path that no file has."""
    stream = re.fullmatch(rf"{_STREAM}\.(?:symbol_crc|word_count|state|word|raw)", path)
    decoded = DECODED[re.split(r"\W", path)[0]].split() if stream else []
    for pattern, table in TABLES:
        match = re.fullmatch(pattern.replace("FIELD", r"(\w+)") + r"(?:\[\d+\])?", path)
        if match and any(match[1] == field for field, _ in SYNTAX[table]):
            names = [TABLE_CLAUSES[table], *FIELDS[f"{table}.{match[1]}"].split(), *decoded]
            return _meaning(table, match[1], "", names)
    for pattern, words, names_of in PAYLOADS:
        if re.fullmatch(pattern, path):
            return _meaning("", "", words, [*names_of.split(), *decoded])
    raise KeyError(path)


def is_path(key: str) -> bool:
    """Whether a key is the path of an element."""
    try:
        meaning(key)
    except KeyError:
        return False
    return True
