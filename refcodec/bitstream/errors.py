"""Errors (SPEC.md chapter 10): one registry, one exception type for everything a bitstream can do wrong.

The registry is the only place where codes are defined; SPEC.md 10.2 is compared with it by a test.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Literal

ErrorClass = Literal["malformed", "invalid", "unsupported"]


@dataclass(frozen=True)
class ErrorKind:
    """One row of SPEC.md 10.2.

    code: stable integer; name: stable dotted name; klass: what a validator's exit status is made from
    (malformed and invalid exit 1, unsupported exits 2); clause: the clause of SPEC.md that is broken; text: its meaning;
    where: the byte that the offset of the error points at.
    """

    code: int
    name: str
    klass: ErrorClass
    clause: str
    text: str
    where: str


def _row(code: int, name: str, klass: ErrorClass, clause: str, text: str, where: str) -> tuple[str, ErrorKind]:
    return name, ErrorKind(code, name, klass, clause, text, where)


# SPEC 10.2: the error registry.
REGISTRY: dict[str, ErrorKind] = dict(
    [
        _row(101, "prologue.truncated", "malformed", "5.1", "the file is shorter than a prologue", "the file's length"),
        _row(102, "prologue.signature", "malformed", "6.1", "the first eight bytes are not the signature", "0"),
        _row(103, "prologue.crc", "malformed", "6.1", "the prologue's CRC-32 does not match", "16"),
        _row(104, "prologue.version", "unsupported", "6.1", "the format version is not 0", "8"),
        _row(105, "prologue.header_length", "malformed", "6.1", "header_length is outside its limits", "12"),
        _row(201, "header.truncated", "malformed", "5.2", "the file ends inside the header", "the file's length"),
        _row(202, "header.crc", "malformed", "6.2", "the header's CRC-32 does not match", "the field"),
        _row(
            203,
            "header.syntax",
            "malformed",
            "5.2",
            "the header's fields do not fill header_length exactly",
            "the header's end, CRC-32 included, if the fields are longer; the first byte between the last field and the CRC-32 if they "
            "are shorter",
        ),
        _row(204, "header.reserved", "malformed", "6.2", "a reserved field is not zero", "the field"),
        _row(205, "header.profile", "unsupported", "11.1", "the profile is not known", "the field"),
        _row(206, "header.level", "unsupported", "11.2", "the level is not known in this profile", "the field"),
        _row(
            207,
            "header.dimension",
            "invalid",
            "11.1",
            "a dimension is outside what the profile allows",
            "the field or item",
        ),
        _row(208, "header.anchor_count", "invalid", "11.2", "anchor_count passes the level's limit", "the field"),
        _row(209, "header.level_not_minimal", "invalid", "11.2", "a lower level would hold this scene", "level"),
        _row(210, "header.chunk_size", "invalid", "11.1", "chunk_size is outside its limits", "the field"),
        _row(211, "header.lanes", "invalid", "6.2", "a lane count is outside its limits", "the field"),
        _row(212, "header.base_step", "invalid", "6.2", "a base step is outside its limits", "the item"),
        _row(
            213,
            "header.position_grid",
            "invalid",
            "6.4",
            "a field of the position grid is outside its limits",
            "the field or item",
        ),
        _row(
            214,
            "header.render_info",
            "invalid",
            "6.5",
            "a field of the render information is outside its limits",
            "the field",
        ),
        _row(
            301,
            "directory.unknown_critical",
            "unsupported",
            "12.1",
            "a critical section of unknown type",
            "the entry's type",
        ),
        _row(
            302,
            "directory.order",
            "malformed",
            "6.6",
            "a section is missing, repeated or out of order",
            "the entry's type, or section_count",
        ),
        _row(
            303, "directory.mode", "unsupported", "6.6", "the coding mode of a section is not known", "the entry's mode"
        ),
        _row(
            304,
            "directory.offset",
            "malformed",
            "6.6",
            "a section does not start where the one before it ends",
            "the entry's offset",
        ),
        _row(
            305,
            "directory.length",
            "malformed",
            "6.6",
            "a section's length is not the one that the header implies",
            "the entry's length",
        ),
        _row(
            306,
            "directory.file_length",
            "malformed",
            "6.6",
            "the last section does not end where the file ends",
            "the smaller of the file's length and the last section's end",
        ),
        _row(307, "section.crc", "malformed", "6.6", "a section's CRC-32 does not match", "the section"),
        _row(401, "frame.range", "invalid", "6.7", "a number of the PCA frame is outside its limits", "the item"),
        _row(411, "weights.scale", "invalid", "6.8", "a signalled scale is outside its limits", "the item"),
        _row(412, "weights.not_finite", "invalid", "6.8", "a weight or bias is NaN or infinite", "the value"),
        _row(
            413,
            "weights.bound",
            "invalid",
            "7.2",
            "a row's integers could pass the accumulator bound",
            "the row's first weight, or in mode 1 the layer's model",
        ),
        _row(
            414,
            "weights.length",
            "malformed",
            "6.8",
            "the layers' models and raw values do not fit the section",
            "the section",
        ),
        _row(415, "weights.layer", "invalid", "6.8", "a field of a layer's model is outside its limits", "the field"),
        _row(
            416,
            "weights.exponent",
            "invalid",
            "6.8",
            "a row's exponent is not the one that its values have",
            "the layer's model",
        ),
        _row(417, "weights.raw", "invalid", "6.8", "a layer that can be packed is raw", "the layer's model"),
        _row(
            421,
            "planes.length",
            "malformed",
            "6.9",
            "the substreams' lengths do not add up to the section",
            "the section",
        ),
        _row(
            431,
            "chunks.mask_model",
            "invalid",
            "6.10",
            "a frequency of the mask model is outside its limits",
            "the frequency",
        ),
        _row(
            432,
            "chunks.length",
            "malformed",
            "6.10",
            "the chunks' lengths do not add up to their section",
            "the chunk's entry, or the section",
        ),
        _row(433, "chunks.crc", "malformed", "6.10", "the CRC-32 of a chunk's part does not match", "the chunk's part"),
        _row(
            434,
            "chunks.position_model",
            "invalid",
            "6.10",
            "a number of the model of positions is outside its limits",
            "cell_shift, or the model's first frequency",
        ),
        _row(441, "positions.not_finite", "invalid", "6.11", "a position is NaN or infinite", "the value"),
        _row(442, "positions.negative_zero", "invalid", "6.11", "a position is -0", "the value"),
        _row(
            443,
            "positions.form",
            "malformed",
            "6.11",
            "a chunk's form is not known or does not have its length",
            "the chunk's part",
        ),
        _row(444, "positions.raw", "invalid", "6.11", "a chunk that can be packed is raw", "the chunk's part"),
        _row(
            445,
            "positions.count",
            "invalid",
            "6.11",
            "a tree has not as many cells as the chunk has anchors",
            "the chunk's part",
        ),
        _row(446, "positions.cell", "invalid", "6.11", "a cell stands for no fp16", "the chunk's part"),
        _row(
            501,
            "substream.length",
            "malformed",
            "5.14",
            "the substream is shorter than its states and words",
            "the substream",
        ),
        _row(502, "substream.state", "invalid", "8.1", "an initial state is below 2^16", "the substream"),
        _row(
            503,
            "substream.words",
            "invalid",
            "8.8",
            "the symbols do not consume exactly the words sent",
            "the substream",
        ),
        _row(504, "substream.final_state", "invalid", "8.8", "a final state is not 2^16", "the substream"),
        _row(505, "substream.escape", "invalid", "8.7", "an escape's prefix is too long", "the substream"),
        _row(506, "substream.symbol_range", "invalid", "8.5", "a symbol does not fit its type", "the substream"),
        _row(
            507,
            "substream.raw_length",
            "invalid",
            "8.8",
            "the raw bits do not fill the substream's raw bytes exactly",
            "the substream",
        ),
        _row(
            508,
            "substream.raw_padding",
            "invalid",
            "8.8",
            "a padding bit of the raw bytes is not zero",
            "the substream",
        ),
        _row(
            509,
            "substream.symbol_crc",
            "invalid",
            "8.8",
            "the CRC-32 of the decoded symbols does not match",
            "the substream",
        ),
    ]
)


class BitstreamError(Exception):
    """A file that is not an acceptable bitstream: the one error type of the decoder.

    kind: row of the registry; offset: byte offset in the file (SPEC 10.2 says which); path: the syntax element;
    found, allowed: what stands there, and what may, as text.
    """

    def __init__(self, name: str, offset: int, path: str, found: object, allowed: object) -> None:
        self.kind = REGISTRY[name]
        self.offset = int(offset)
        self.path = path
        self.found, self.allowed = str(found), str(allowed)
        place = f"at byte {self.offset}, {path}; SPEC.md {self.kind.clause}"
        super().__init__(f"{self.kind.text}: found {self.found}, allowed {self.allowed} ({place})")

    @property
    def exit_status(self) -> int:
        """1 for a rejected file, 2 for one that needs a newer decoder (SPEC 10.1)."""
        return 2 if self.kind.klass == "unsupported" else 1

    def to_json(self) -> str:
        """The verdict as one line of JSON: code, name, offset, path, clause, found, allowed."""
        return json.dumps(
            {
                "code": self.kind.code,
                "name": self.kind.name,
                "offset": self.offset,
                "path": self.path,
                "clause": self.kind.clause,
                "found": self.found,
                "allowed": self.allowed,
            }
        )
