"""Clause 10.3: the registry of errors, and the exception that every refused file raises."""

# SPEC 10.3: for each name its code, class, clause and meaning
REGISTRY: dict[str, tuple[int, str, str, str]] = {
    "prologue.truncated": (101, "malformed", "5.1", "the file is shorter than a prologue"),
    "prologue.signature": (102, "malformed", "6.1", "the first eight bytes are not the signature"),
    "prologue.crc": (103, "malformed", "6.1", "the prologue's CRC-32 does not match"),
    "prologue.version": (104, "unsupported", "6.1", "the major version is not 0"),
    "prologue.header_length": (105, "malformed", "6.1", "header_length is outside its limits, or no multiple of 4"),
    "header.truncated": (201, "malformed", "5.2", "the file ends inside the header"),
    "header.crc": (202, "malformed", "6.2", "the header's CRC-32 does not match"),
    "header.syntax": (203, "malformed", "5.2", "the header's fields do not fill header_length exactly"),
    "header.reserved": (204, "unsupported", "6.2", "a reserved field is not zero"),
    "header.profile": (205, "unsupported", "11.1", "the profile is not known"),
    "header.level": (206, "unsupported", "11.2", "the level is not known in this profile"),
    "header.dimension": (207, "invalid", "11.1", "a dimension is outside what the profile allows"),
    "header.anchor_count": (208, "invalid", "11.2", "anchor_count passes the level's limit"),
    "header.level_not_minimal": (209, "invalid", "11.2", "a lower level would hold this scene"),
    "header.chunk_size": (210, "invalid", "11.1", "chunk_size is outside its limits"),
    "header.lanes": (211, "invalid", "6.2", "a lane count is outside its limits"),
    "header.base_step": (212, "invalid", "6.2", "a base step is outside its limits"),
    "header.position_grid": (213, "invalid", "6.4", "a field of the position grid is outside its limits"),
    "header.render_info": (214, "invalid", "6.5", "a field of the render information is outside its limits"),
    "header.work": (215, "invalid", "11.2", "the work passes the level's limit"),
    "header.padding": (216, "malformed", "6.2", "the padding of the dimensions is not zero"),
    "header.chunk_count": (217, "invalid", "6.2", "chunk_count does not suit anchor_count and chunk_size"),
    "directory.type": (301, "malformed", "6.6", "a section's type is not four letters"),
    "directory.unknown_critical": (302, "unsupported", "12.1", "a critical section of unknown type"),
    "directory.order": (303, "malformed", "6.6", "a critical section is missing, repeated or out of order"),
    "directory.mode": (304, "unsupported", "6.6", "the coding mode of a section is not known"),
    "directory.length": (
        305,
        "malformed",
        "6.6",
        "a section's length is not the one that the header implies, or too large",
    ),
    "section.truncated": (311, "malformed", "6.6", "the file ends inside a section"),
    "section.crc": (312, "malformed", "6.6", "a section's CRC-32 does not match, or that of DATA is not 0"),
    "section.padding": (313, "malformed", "6.6", "the padding behind a section is not zero"),
    "file.trailing": (321, "malformed", "6.6", "bytes follow the last section"),
    "frame.range": (401, "invalid", "6.7", "a number of the PCA frame is outside its limits"),
    "frame.reserved": (402, "unsupported", "6.7", "a reserved field is not zero"),
    "weights.scale": (411, "invalid", "6.8", "a signalled scale is outside its limits"),
    "weights.not_finite": (412, "invalid", "6.8", "a weight or bias is NaN or infinite"),
    "weights.bound": (413, "invalid", "7.2", "a row's integers could pass the accumulator bound"),
    "weights.length": (414, "malformed", "6.8", "the layers' models and raw values do not fit the section"),
    "weights.layer": (415, "invalid", "6.8", "a field of a layer's model is outside its limits"),
    "weights.exponent": (416, "invalid", "6.8", "a row's exponent is not the one that its values have"),
    "weights.padding": (417, "malformed", "6.8", "the padding of the scales is not zero"),
    "weights.reserved": (418, "unsupported", "6.8", "a reserved field is not zero"),
    "planes.length": (421, "malformed", "6.9", "the substreams' lengths do not add up to the section"),
    "planes.padding": (422, "malformed", "6.9", "the padding behind a substream is not zero"),
    "index.mask_model": (431, "invalid", "6.10", "a frequency of the mask model is outside its limits"),
    "index.position_model": (432, "invalid", "6.10", "a number of the model of positions is outside its limits"),
    "index.chunk": (433, "invalid", "6.10", "a field of a chunk's entry is outside its limits"),
    "index.length": (434, "malformed", "6.10", "the chunks' anchors or bytes do not add up"),
    "index.padding": (435, "malformed", "6.10", "the padding of the mask model is not zero"),
    "index.reserved": (436, "unsupported", "6.10", "a reserved field is not zero"),
    "chunk.crc": (441, "malformed", "6.11", "a chunk's CRC-32 does not match"),
    "chunk.length": (442, "malformed", "6.11", "a chunk's parts do not fill it"),
    "chunk.form": (443, "malformed", "6.11", "the form of a chunk's positions is not known"),
    "chunk.padding": (444, "malformed", "6.11", "the padding behind a part of a chunk is not zero"),
    "chunk.reserved": (445, "unsupported", "6.11", "a reserved field is not zero"),
    "chunk.kept": (446, "invalid", "6.11", "a chunk does not keep as many offsets as its entry says"),
    "chunk.bounds": (447, "invalid", "6.11", "a chunk's positions do not have the bounds of its entry"),
    "positions.not_finite": (451, "invalid", "6.11", "a position is NaN or infinite"),
    "positions.negative_zero": (452, "invalid", "6.11", "a position is -0"),
    "positions.count": (453, "invalid", "6.11", "a tree has not as many cells as the chunk has anchors"),
    "positions.cell": (454, "invalid", "6.11", "a cell stands for no fp16"),
    "substream.length": (501, "malformed", "5.15", "the substream is shorter than its states and words"),
    "substream.state": (502, "invalid", "8.1", "an initial state is below 2^16"),
    "substream.words": (503, "invalid", "8.8", "the symbols do not consume exactly the words sent"),
    "substream.final_state": (504, "invalid", "8.8", "a final state is not 2^16"),
    "substream.escape": (505, "invalid", "8.7", "an escape's prefix is too long"),
    "substream.symbol_range": (506, "invalid", "8.5", "a symbol does not fit its type"),
    "substream.raw_length": (507, "invalid", "8.8", "the raw bits do not fill the substream's raw bytes exactly"),
    "substream.raw_padding": (508, "invalid", "8.8", "a padding bit of the raw bytes is not zero"),
    "substream.symbol_crc": (509, "invalid", "8.8", "the CRC-32 of the decoded symbols does not match"),
}


# SPEC 10.2, 10.3
class C3GSError(Exception):
    """A file that is refused.

    code, name, clause, meaning: of the registry. kind: the class of the error. offset: a byte of the file.
    """

    def __init__(self, name: str, offset: int) -> None:
        self.name = name
        self.offset = offset
        self.code, self.kind, self.clause, self.meaning = REGISTRY[name]
        super().__init__(f"{self.code} {name} ({self.kind}) at byte {offset}: {self.meaning} (clause {self.clause})")

    def as_dict(self) -> dict[str, int | str]:
        """Return the error as a JSON object: code, name, class, offset, clause."""
        return {"code": self.code, "name": self.name, "class": self.kind, "offset": self.offset, "clause": self.clause}


# SPEC 10.1
def require(condition: bool, name: str, offset: int) -> None:
    """Raise the named error unless the condition holds."""
    if not condition:
        raise C3GSError(name, offset)
