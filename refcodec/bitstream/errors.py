"""Clause 10.3: the registry of errors, and the exception that every refused file raises.

The registry is the only definition of the codes. `python -m spec` prints it in SPEC.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, cast

ErrorClass = Literal["malformed", "invalid", "unsupported"]


@dataclass(frozen=True)
class ErrorKind:
    """One row of SPEC.md 10.3.

    code: an integer that never changes.
    name: a dotted name that never changes.
    klass: the class of the refusal. A command exits with 1 for malformed and invalid, and with 2 for unsupported.
    requirement: the requirement that the file violates.
    text: the meaning.
    where: the byte at the offset of the error.
    """

    code: int
    name: str
    klass: ErrorClass
    requirement: str
    text: str
    where: str

    @property
    def clause(self) -> str:
        return self.requirement[1:].rpartition("-")[0]


# SPEC 10.3: code, name, class and requirement | meaning | offset.
_TABLE = """
101 prologue.truncated         malformed   R6.1-1  | the file is shorter than a prologue | the file's length
102 prologue.signature         malformed   R6.1-2  | the first eight bytes are not the signature | 0
103 prologue.crc               malformed   R6.1-3  | the prologue's CRC-32 does not match | 16
104 prologue.version           unsupported R6.1-4  | the major version is not MAJOR | 8
105 prologue.header_length     malformed   R6.1-5  | header_length is outside its limits or not a multiple of 4 | 12
201 header.truncated           malformed   R6.2-1  | the file ends inside the header | the file's length
202 header.crc                 malformed   R6.2-2  | the header's CRC-32 does not match | the field
203 header.syntax              malformed   R6.2-3  | the header's fields do not fill header_length exactly | the end of
    the header, after header_crc, if the fields are longer; the first byte between the last field and header_crc if they
    are shorter
204 header.reserved            unsupported R6.2-5  | a reserved field is not zero | the field
205 header.profile             unsupported R11.1-1 | the profile is not known | the field
206 header.level               unsupported R11.2-1 | the level is not known in this profile | the field
207 header.dimension           invalid     R11.1-2 | a dimension is outside the bounds of the profile | the field or
    item
208 header.anchor_count        invalid     R11.2-2 | anchor_count exceeds the level's limit | the field
209 header.level_not_minimal   invalid     R11.2-4 | a lower level would hold this scene | level
210 header.chunk_size          invalid     R11.1-3 | chunk_size is outside its limits | the field
211 header.lanes               invalid     R6.2-6  | a lane count is outside its limits | the field
212 header.base_step           invalid     R6.2-7  | a base step is outside its limits | the item
213 header.position_grid       invalid     R6.4-1  | a field of the position grid is outside its limits | the field or
    item
214 header.render_info         invalid     R6.5-1  | a field of the render information is outside its limits | the field
215 header.work                invalid     R11.2-3 | the work exceeds the level's limit | anchor_count
216 header.padding             malformed   R6.2-4  | the padding of the dimensions is not zero | the padding
217 header.chunk_count         invalid     R6.2-8  | chunk_count does not fit anchor_count and chunk_size | the field
301 directory.type             malformed   R6.6-1  | a section's type is not four letters | the entry's type
302 directory.unknown_critical unsupported R6.6-2  | a critical section has an unknown type | the entry's type
303 directory.order            malformed   R6.6-3  | a critical section is missing, repeated or out of order | the
    entry's type, or section_count
304 directory.mode             unsupported R6.6-4  | the coding mode of a section is not known | the entry's mode
305 directory.length           malformed   R6.6-5  | a section's length is too large or not the one that the header
    implies | the entry's length
311 section.truncated          malformed   R6.6-6  | the file ends inside a section | the file's length
312 section.crc                malformed   R6.6-7  | a section's CRC-32 does not match, or the crc of DATA is not 0 |
    the section
313 section.padding            malformed   R6.6-8  | the padding after a section is not zero | the padding
321 file.trailing              malformed   R6.6-9  | bytes follow the last section | the first of them
401 frame.range                invalid     R6.7-2  | a number of the PCA frame is outside its limits | the item
402 frame.reserved             unsupported R6.7-1  | a reserved field is not zero | the field
411 weights.scale              invalid     R6.8-1  | a field of WeightScales is outside its limits | the item
412 weights.not_finite         invalid     R6.8-3  | a weight or bias is NaN or infinite | the value
413 weights.bound              invalid     R6.8-4  | a row's integers could reach the accumulator bound | the row's
    first weight, or its bias if it has no weights; in mode 1 the LayerModel
414 weights.length             malformed   R6.8-5  | the LayerModels and raw values do not fit the section | the section
415 weights.layer              invalid     R6.8-7  | a field of a LayerModel is outside its limits | the field
416 weights.exponent           invalid     R6.8-8  | a row's grid exponent is not the one that its values imply | the
    LayerModel
417 weights.padding            malformed   R6.8-2  | the padding of WeightScales is not zero | the padding
418 weights.reserved           unsupported R6.8-6  | a reserved field is not zero | the field
421 planes.length              malformed   R6.9-1  | the substreams' lengths do not add up to the section | the section
422 planes.padding             malformed   R6.9-2  | the padding after a substream is not zero | the padding
431 index.mask_model           invalid     R6.10-1 | a frequency of the mask model is outside its limits | the frequency
432 index.position_model       invalid     R6.10-4 | a number of the PositionModel is outside its limits | cell_shift,
    or the model's first frequency
433 index.chunk                invalid     R6.10-5 | a field of a ChunkEntry is outside its limits | the field or item
434 index.length               malformed   R6.10-6 | the anchors or bytes of the chunks do not add up | the section
435 index.padding              malformed   R6.10-2 | the padding of the mask model is not zero | the padding
436 index.reserved             unsupported R6.10-3 | a reserved field is not zero | the field
441 chunk.crc                  malformed   R6.11-1 | a chunk's CRC-32 does not match | the chunk
442 chunk.length               malformed   R6.11-4 | the parts of a chunk do not fill it exactly | the chunk
443 chunk.form                 malformed   R6.11-3 | the form of a chunk's positions is not known | the field
444 chunk.padding              malformed   R6.11-5 | the padding after a part of a chunk is not zero | the padding
445 chunk.reserved             unsupported R6.11-2 | a reserved field is not zero | the field
446 chunk.kept                 invalid     R6.11-11 | kept_count is not the number of kept offsets | the chunk
447 chunk.bounds               invalid     R6.11-10 | low and high are not the bounds of the chunk's positions |
    the chunk
451 positions.not_finite       invalid     R6.11-6 | a position is NaN or infinite | the value
452 positions.negative_zero    invalid     R6.11-7 | a position is -0 | the value
453 positions.count            invalid     R6.11-8 | the tree does not have as many cells as the chunk has anchors | the
    substream
454 positions.cell             invalid     R6.11-9 | a cell represents no finite f16 | the substream
501 substream.length           malformed   R8.1-1  | the substream is shorter than its states and words | the substream
502 substream.state            invalid     R8.1-2  | an initial state is below STATE_MIN | the substream
503 substream.words            invalid     R8.8-1  | the symbols do not consume exactly word_count words | the substream
504 substream.final_state      invalid     R8.8-2  | a final state is not STATE_MIN | the substream
505 substream.escape           invalid     R8.7-1  | an escape's prefix is too long | the substream
506 substream.symbol_range     invalid     R8.5-1  | a symbol exceeds the limit of its kind | the substream
507 substream.raw_length       invalid     R8.8-3  | the raw bits do not fill the substream's raw bytes exactly | the
    substream
508 substream.raw_padding      invalid     R8.8-4  | an unused bit of the last raw byte is not zero | the substream
509 substream.symbol_crc       invalid     R8.8-5  | the CRC-32 of the decoded symbols does not match | the substream
"""


def _registry() -> Iterator[ErrorKind]:
    # An indented line continues the line before it.
    for line in _TABLE.replace("\n    ", " ").strip().splitlines():
        head, text, where = line.split(" | ")
        code, name, klass, requirement = head.split()
        yield ErrorKind(int(code), name, cast(ErrorClass, klass), requirement, text, where)


# The rows by name, in the order of the codes.
REGISTRY: dict[str, ErrorKind] = {kind.name: kind for kind in _registry()}


class BitstreamError(Exception):
    """A refused file. Decoding raises no other error.

    kind: the row of the registry.
    offset: a byte of the file, as SPEC 10.3 defines it.
    path: the syntax element.
    found, allowed: the content of the file there, and the allowed content, as text.
    """

    kind: ErrorKind
    offset: int
    path: str
    found: str
    allowed: str

    def __init__(self, name: str, offset: int, path: str, found: object, allowed: object) -> None:
        self.kind = REGISTRY[name]
        self.offset = int(offset)
        self.path = path
        self.found, self.allowed = str(found), str(allowed)
        place = f"at byte {self.offset}, {path}; SPEC.md {self.kind.clause} [{self.kind.requirement}]"
        super().__init__(f"{self.kind.text}: found {self.found}, allowed {self.allowed} ({place})")

    @property
    def exit_status(self) -> int:
        """The exit status of a command: 1 for a malformed or invalid file, 2 for an unsupported one."""
        return 2 if self.kind.klass == "unsupported" else 1

    def to_json(self) -> str:
        """Returns one line of JSON: code, name, offset, path, clause, requirement, found, allowed."""
        return json.dumps(
            {
                "code": self.kind.code,
                "name": self.kind.name,
                "offset": self.offset,
                "path": self.path,
                "clause": self.kind.clause,
                "requirement": self.kind.requirement,
                "found": self.found,
                "allowed": self.allowed,
            }
        )
