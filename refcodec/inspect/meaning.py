"""The meaning of each element of a file: its syntax table, the clauses that use it, and the requirements on it.

Elements are named by their paths, as `elements` gives them. `python -m spec --check` compares the rules here with
SPEC.md (spec/meanings.py), and a test tries them on every byte of the vectors.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from ..bitstream.ancillary import TYPES
from ..bitstream.dimensions import STATIC
from ..bitstream.planes import PLANE_NAMES
from ..bitstream.syntax import SYNTAX

# The parts of a file by their names in paths: the type of the section, and the clauses that are read first.
PARTS: dict[str, tuple[str, str]] = {
    "prologue": ("", "5.1 6.1"),
    "header": ("", "5.2 5.3 5.4 5.5 5.6 6.2 6.3 6.4 6.5 6.6 11.1 11.2"),
    "frame": ("FRAM", "5.7 6.7 7.5.1 7.5.3"),
    "weights": ("WGTS", "5.8 5.9 6.8 7.2 7.13 9.4 14.3"),
    "planes": ("PLNS", "5.10 6.9 7.3 7.5.4"),
    "index": ("INDX", "5.11 5.12 5.13 6.10 7.6 7.12"),
    "data": ("DATA", "5.14 6.11"),
    "positions": ("", "5.14 6.11 7.4 7.12 9.1"),
    "masks": ("", "5.14 6.12 7.6"),
    "attributes": ("", "5.14 6.13 7.7 7.8 7.9 7.10 9.2"),
    **{
        entry.name: (kind.decode(), " ".join((*entry.tables.values(), entry.clause, "12.1")))
        for kind, entry in TYPES.items()
    },
}

_PLANE = rf"planes\.(?:{'|'.join(map(re.escape, PLANE_NAMES))})"
_CHUNK_PART = r"(?:positions|masks|attributes)\[chunk \d+\]"
_STREAM = rf"(?:weights|{_PLANE}|{_CHUNK_PART})"
# SPEC 5.8: layers. A damaged header states any number of those of coding networks.
_CODING = r"weights\.(?:hyper|sarm|carm\.\d+)\.\d+"
_RENDERING = r"weights\.(?:opacity|covariance|colour)\.[01]"
# For each syntax table its clause, and the pattern of the path of the struct.
STRUCTS: dict[str, tuple[str, str]] = {
    "Prologue": ("5.1", "prologue"),
    "Header": ("5.2", "header"),
    "Dimensions": ("5.3", r"header\.dimensions"),
    "PositionGrid": ("5.4", r"header\.position_grid"),
    "RenderInfo": ("5.5", r"header\.render_info"),
    "DirectoryEntry": ("5.6", r"header\.directory\[\d+\]"),
    "Frame": ("5.7", "frame"),
    "WeightScales": ("5.8", "weights"),
    "LayerModel": ("5.9", f"(?:{_CODING}|{_RENDERING})"),
    "PlaneTable": ("5.10", "planes"),
    "MaskModel": ("5.11", r"index\.mask_model"),
    "PositionModel": ("5.12", r"index\.position_model"),
    "ChunkEntry": ("5.13", r"index\.entry\[\d+\]"),
    "Chunk": ("5.14", r"chunk\[\d+\]"),
    "Substream": ("5.15", _STREAM),
    **{
        table: (entry.tables[table], rf"{kind.decode()}\[\d+\]{at}")
        for kind, entry in TYPES.items()
        for table, at in ((entry.head, ""), (entry.items, rf"\.{entry.item}\[\d+\]"))
    },
}
TABLE_CLAUSES = {table: clause for table, (clause, _) in STRUCTS.items()}

# For each field the clauses that use it, without that of its table, and the requirements on it. The requirements that a
# wrong value breaks come first.
FIELDS: dict[str, str] = {
    "Prologue.signature": "6.1 R6.1-1 R6.1-2",
    "Prologue.major": "6.1 12.3 R6.1-4",
    "Prologue.minor": "6.1 12.3 R6.2-3",
    "Prologue.header_length": "6.1 R6.1-5 R6.2-1 R6.2-3",
    "Prologue.prologue_crc": "6.1 R6.1-3",
    "Header.profile": "11.1 R11.1-1 R11.1-2 R11.1-3",
    "Header.level": "11.2 R11.2-1 R11.2-4 R11.2-2 R11.2-3",
    "Header.section_count": "6.6 R6.6-3 R6.2-3",
    "Header.anchor_count": "6.10 11.2 R11.2-2 R11.2-3 R11.2-4 R6.10-6",
    "Header.chunk_count": "6.10 R6.2-8",
    "Header.chunk_size": "6.10 11.1 R11.1-3 R6.10-5",
    **dict.fromkeys((f"Header.{part}_lanes_log2" for part in ("plane", "mask", "attribute")), "6.2 8.3 R6.2-6 D8.3-1"),
    "Header.reserved": "6.2 R6.2-5",
    "Header.base_step": "6.2 7.8 9.2 R6.2-7 D7.8-1 D9.2-1",
    "Header.header_crc": "6.2 R6.2-2 R6.2-3",
    **dict.fromkeys(
        (f"Dimensions.{net}_{size}" for net in ("hyper", "sarm", "carm") for size in ("layers", "width")),
        "6.3 5.8 R11.1-2",
    ),
    "Dimensions.render_width": "6.3 5.8 R11.1-2",
    "Dimensions.offset_count": "6.3 7.6 R11.1-2 D7.6-1",
    "Dimensions.plane_channels": "6.3 7.3 R11.1-2 D7.3-1 D7.3-2",
    "Dimensions.frequency_count": "6.3 7.5.5 R11.1-2 D7.5.5-1",
    "Dimensions.plane_size": "6.3 7.3 11.2 R11.1-2 R11.2-4 D7.3-1 D7.3-2",
    "Dimensions.slice_count": "6.3 7.10 R11.1-2 D7.10-1",
    "Dimensions.slice_width": "6.3 7.10 R11.1-2 D7.10-1",
    "Dimensions.view_inputs": "6.5 5.8 11.2 14.3 R11.1-2 G14.3-1",
    "Dimensions.colour_outputs": "6.5 5.8 9.4 14.3 14.6 R11.1-2 D9.4-1 G14.3-1 G14.6-1",
    "Dimensions.reserved": "6.2 R6.2-5",
    "Dimensions.padding": "R6.2-4",
    "PositionGrid.origin": "6.4 9.1 R6.4-1 D9.1-1",
    "PositionGrid.scale_mantissa": "6.4 9.1 R6.4-1 D9.1-1",
    "PositionGrid.scale_exponent": "6.4 9.1 R6.4-1 D9.1-1",
    "PositionGrid.reserved": "6.2 R6.2-5",
    "RenderInfo.background": "14.5 G14.5-1",
    "RenderInfo.up_axis": "6.5 R6.5-1",
    "RenderInfo.near_plane": "6.5 14.4 R6.5-1",
    "RenderInfo.distance_unit": "6.5 14.3 R6.5-1 G14.3-1",
    "RenderInfo.alpha_max": "6.5 14.5 R6.5-1 G14.5-1",
    "RenderInfo.low_pass": "6.5 14.4 R6.5-1",
    "RenderInfo.colour_primaries": "6.5 14.5 G6.5-2 G14.5-1",
    "RenderInfo.transfer_characteristics": "6.5 14.5 G6.5-2 G14.5-1",
    "RenderInfo.render_model": "6.5 9.4 14.1 R11.1-2 G6.5-1 D9.4-1",
    "RenderInfo.reserved": "6.2 R6.2-5",
    "DirectoryEntry.type": "6.6 12.1 R6.6-1 R6.6-2 R6.6-3 D12.1-1",
    "DirectoryEntry.mode": "6.6 R6.6-4 R6.6-5",
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
    "LayerModel.form": "6.8 7.13 R6.8-7 R6.8-5 R6.8-4 D7.13-1",
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
    "Substream.word_count": "8.8 R8.1-1 R8.8-1 D8.8-1 D8.8-2",
    "Substream.state": "8.1 8.3 R8.1-1 R8.1-2 R8.8-2 D8.3-1",
    "Substream.word": "8.2 8.3 R8.8-1 R8.8-2 R8.8-5 D8.2-1 D8.3-1",
    "Substream.raw": "8.5 8.6 8.7 R8.8-3 R8.8-4 R8.7-1 R8.5-1 R8.8-5 D8.5-1 D8.6-1 D8.7-1",
    **{
        f"{table}.{name}": " ".join((entry.clause, *entry.cited.get(name, "").split(), "R6.6-7"))
        for entry in TYPES.values()
        for table in entry.tables
        for name, _ in SYNTAX[table]
    },
}

# The elements outside tables. The first matching pattern applies.
_VALUES = "5.8 6.8 R6.8-3 R6.8-5"
_INTEGERS = f"{_VALUES} R6.8-4 7.2 D7.2-1 D7.2-2"
_ANCILLARY = r"[a-z][A-Za-z]{3}\[\d+\]"
_SECTION = rf"(?:{'|'.join(name for name, (kind, _) in PARTS.items() if kind.isupper())}|[0-9A-Za-z]+\[\d+\])"
# SPEC 6.5: a render model that only later versions draw.
LATER = 2


@dataclass(frozen=True)
class Payload:
    """A rule for elements outside tables. pattern: of their paths. words: their contents. cited: as in FIELDS.

    models: the render models of the scenes that it is for, or empty for all. LATER stands for all others.
    """

    pattern: str
    words: str
    cited: str
    models: tuple[int, ...] = ()


PAYLOADS = [
    *(
        Payload(rf"{layer}\.{part}(?:\[\d+\])?", words, cited, models)
        for part, words in (("weight", "weights of a layer, row by row"), ("bias", "its biases"))
        for layer, cited, models in (
            (_CODING, _INTEGERS, ()),
            (_RENDERING, f"{_VALUES} 14.3 G14.3-1", (0,)),
            (_RENDERING, f"{_INTEGERS} 9.4 D9.4-1", (STATIC,)),
            (_RENDERING, f"{_VALUES} 6.5 G6.5-1", (LATER,)),
        )
    ),
    Payload(
        r"positions\[chunk \d+\]",
        "x, y, z of each anchor of the chunk",
        "5.14 6.11 7.4 R6.11-6 R6.11-7 R6.11-10 D7.4-1",
    ),
    Payload(rf"{_STREAM}, cut off", "a substream that is cut off", "5.15 8.1 R8.1-1"),
    Payload(rf"{_PLANE}, padding", "zeros", "5.10 R6.9-2"),
    Payload(rf"{_CHUNK_PART}, padding", "zeros", "5.14 R6.11-5"),
    Payload(rf"{_SECTION}, padding", "zeros", "5.6 R6.6-8"),
    Payload(r"chunk\[\d+\], unused", "bytes of a chunk that no element uses", "6.11 R6.11-4"),
    Payload(r"header, unused", "bytes between the last field and the CRC-32", "6.2 12.3 R6.2-3"),
    Payload(r"file, unused", "bytes that no element uses", "6.6 R6.6-9 R6.1-2 R6.2-1"),
    Payload(rf"{_SECTION}, unused", "bytes of a section that no element uses", "6.6 R6.6-5 R6.9-1 R6.10-6 R6.6-7"),
    Payload(_ANCILLARY, "an ancillary section, which a decoder may skip", "12.1 R6.6-7 D12.1-1"),
    Payload(r"[0-9A-Za-z]+\[\d+\]", "a section of an unknown type", "6.6 12.1 R6.6-1 R6.6-2 R6.6-7 D12.1-1"),
]

# The clauses and requirements by which the substreams of a section are decoded.
DECODED = {
    "weights": "7.13 R6.8-8 D7.13-1",
    "planes": "7.3 D7.3-1 D7.3-2",
    "positions": "7.12 6.11 R6.11-8 R6.11-9 R6.11-10 D7.12-1",
    "masks": "7.6 6.11 R6.11-11 D7.6-1",
    "attributes": "7.5 7.7 7.8 7.9 7.10 D7.10-1 D7.5-1 D7.7-1 D7.8-1 D7.9-1",
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

    def text(self, fields: Mapping[str, tuple[str, str]]) -> str:
        """Returns the meaning in a line. fields: of specification.fields."""
        return fields[f"{self.table}.{self.field}"][1] if self.table else self.words


def _meaning(table: str, field: str, words: str, names: list[str]) -> Meaning:
    unique = list(dict.fromkeys(names))
    clauses = tuple(name for name in unique if name[0].isdigit())
    return Meaning(table, field, words, clauses, tuple(name for name in unique if not name[0].isdigit()))


def of_field(table: str, field: str) -> Meaning:
    """Returns the meaning of a field of a syntax table. Raises KeyError."""
    return _meaning(table, field, "", [TABLE_CLAUSES[table], *FIELDS[f"{table}.{field}"].split()])


def meaning(path: str, model: int | None = None) -> Meaning:
    """Returns the meaning of the element at a path. Raises KeyError for a path that no file has.

    model: the render model of the file (SPEC 6.5). None: the meanings of all models together.
    """
    stream = re.fullmatch(rf"{_STREAM}\.(?:symbol_crc|word_count|state|word|raw)", path)
    decoded = DECODED[re.split(r"\W", path)[0]].split() if stream else []
    bare, _, number = path.removesuffix("]").rpartition("[") if re.search(r"\w\[\d+\]$", path) else (path, "", "")
    struct, _, field = bare.rpartition(".")
    for table, (clause, pattern) in STRUCTS.items():
        kind = dict(SYNTAX[table]).get(field)
        if kind and _has(kind, number) and re.fullmatch(pattern, struct):
            return _meaning(table, field, "", [clause, *FIELDS.get(f"{table}.{field}", "").split(), *decoded])
    wanted = None if model is None else min(model, LATER)
    rules = [rule for rule in PAYLOADS if wanted is None or not rule.models or wanted in rule.models]
    matching = [rule for rule in rules if re.fullmatch(rule.pattern, path)]
    if not matching:
        raise KeyError(path)
    # Only the rules of single models are together.
    together = [rule for rule in matching if rule.models] or matching[:1]
    return _meaning("", "", together[0].words, [name for rule in together for name in rule.cited.split()])


def _has(kind: str, number: str) -> bool:
    """Whether a field of a type can have an item of this number. number: digits, or empty for the field itself."""
    length = re.fullmatch(r"(?!bytes)\w+\[(.+)\]", kind)
    if not number or length is None:
        return not number
    return not length[1].isdigit() or int(number) < int(length[1])


def is_path(key: str) -> bool:
    """Whether a key is the path of an element."""
    try:
        meaning(key)
    except KeyError:
        return False
    return True
