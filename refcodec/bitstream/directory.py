"""Clauses 5.6, 6.6 and 12.1: the directory."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from . import syntax
from .dimensions import Dimensions, weight_count
from .errors import BitstreamError
from .index import index_bytes
from .source import Piece, Source, pad4

# SPEC 6.6: the critical sections in file order, with their names in paths.
FRAME, WEIGHTS, PLANES_SECTION, INDEX, DATA = b"FRAM", b"WGTS", b"PLNS", b"INDX", b"DATA"
SECTIONS = {FRAME: "frame", WEIGHTS: "weights", PLANES_SECTION: "planes", INDEX: "index", DATA: "data"}
# SPEC 6.6: the highest mode of each section that has another mode than 0.
MODES = {WEIGHTS: 1, INDEX: 1}
SECTION_LENGTH_MAX = 1 << 48
# The block size, in bytes, in which sections are checked that are not kept.
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class Section:
    """SPEC 5.6: a section of a file.

    number: the number of its directory entry. start: the offset of its first byte. length: in bytes, without padding.
    """

    type: bytes
    mode: int
    number: int
    start: int
    length: int
    crc: int

    @property
    def end(self) -> int:
        """The offset after the padding, where the next section starts."""
        return self.start + pad4(self.length)

    @property
    def name(self) -> str:
        """The name of the section in paths."""
        return section_name(self.type, self.number)


def section_name(kind: bytes, number: int) -> str:
    """Returns the name of a section in paths. kind: its type. number: the number of its directory entry."""
    text = kind.decode("ascii") if kind.isalpha() else kind.hex()
    return SECTIONS.get(kind, f"{text}[{number}]")


def is_critical(kind: bytes) -> bool:
    """SPEC 12.1: returns whether a type is critical: its first letter is a capital."""
    return not kind[0] & 0x20


def critical_sections(d: Dimensions) -> list[bytes]:
    """SPEC [R6.6-3]: returns the critical sections that a file with these dimensions has, in file order."""
    absent = {FRAME: not d.has_frame, PLANES_SECTION: not d.plane_channels}
    return [kind for kind in SECTIONS if not absent.get(kind)]


def section_lengths(d: Dimensions, chunks: int, modes: Mapping[bytes, int]) -> dict[bytes, int]:
    """SPEC [R6.6-5]: returns the lengths in bytes that the header implies, by type.

    Sections of other lengths are omitted. chunks: C. modes: by type.
    """
    lengths = {FRAME: syntax.size_of("Frame"), INDEX: index_bytes(d.offset_count, modes[INDEX], chunks)}
    if not modes[WEIGHTS]:
        lengths[WEIGHTS] = pad4(2 + d.carm_inputs) + 4 * weight_count(d)
    return lengths


def parse_directory(header: syntax.Struct, d: Dimensions, start: int) -> tuple[Section, ...]:
    """SPEC 6.6: checks the directory and returns the sections in file order. Raises BitstreamError 301 to 305.

    Each requirement is checked over all entries before the next one (SPEC 10.1, DIRECTORY). Lengths are checked before
    data of that length is read (SPEC 13.1). header: the parsed header. start: the offset after the header.
    """
    entries = list(enumerate(header.fields.directory))
    # SPEC [R6.6-1]
    for i, e in entries:
        if not (e.type.isalpha() and e.type.isascii()):
            raise header.error("directory.type", f"directory[{i}].type", e.type.hex(" "), "four letters")
    # SPEC [R6.6-2], and for editors [E12.1-1]
    critical = [(i, e) for i, e in entries if is_critical(e.type)]
    for i, e in critical:
        if e.type not in SECTIONS:
            path, letters = f"directory[{i}].type", e.type.decode("ascii")
            raise header.error("directory.unknown_critical", path, letters, "a critical type of 6.6")
    # SPEC [R6.6-3]
    wanted = critical_sections(d)
    for place, (i, e) in enumerate(critical):
        if place >= len(wanted) or e.type != wanted[place]:
            allowed = wanted[place].decode() if place < len(wanted) else "no further critical section"
            raise header.error("directory.order", f"directory[{i}].type", e.type.decode("ascii"), allowed)
    if len(critical) < len(wanted):
        allowed = "the sections " + ", ".join(kind.decode() for kind in wanted)
        raise header.error("directory.order", "section_count", len(entries), allowed)
    # SPEC [R6.6-4]
    for i, e in critical:
        if e.mode > MODES.get(e.type, 0):
            allowed = f"of {e.type.decode()} {'0 or 1' if e.type in MODES else '0'}"
            raise header.error("directory.mode", f"directory[{i}].mode", e.mode, allowed)
    # SPEC [R6.6-5]
    modes = {e.type: e.mode for _, e in critical}
    lengths = section_lengths(d, header.fields.chunk_count, modes)
    sections, at = [], start
    for i, e in entries:
        implied = lengths.get(e.type, e.length)
        if e.length != implied or e.length > SECTION_LENGTH_MAX:
            allowed = implied if e.length != implied else f"at most {SECTION_LENGTH_MAX}"
            raise header.error("directory.length", f"directory[{i}].length", e.length, allowed)
        sections.append(Section(e.type, e.mode, i, at, e.length, e.crc))
        at = sections[-1].end
    return tuple(sections)


def truncated(source: Source, path: str, wanted: int) -> BitstreamError:
    """SPEC [R6.6-6]: returns the error of a truncated section. wanted: the offset at which it would end."""
    length = source.length()
    return BitstreamError("section.truncated", length, path, f"a file of {length} bytes", f"at least {wanted}")


def read_section(source: Source, section: Section) -> Piece:
    """SPEC [R6.6-6] to [R6.6-8]: reads a section other than DATA. Raises BitstreamError 311 to 313."""
    data = source.read(section.start, section.end - section.start)
    if len(data) < section.end - section.start:
        raise truncated(source, section.name, section.end)
    whole = Piece(data, section.start)
    piece = whole.cut(0, section.length)
    crc = zlib.crc32(piece.data)
    if crc != section.crc:
        raise piece.error("section.crc", 0, section.name, f"0x{section.crc:08x}", f"0x{crc:08x}")
    whole.require_zero("section.padding", section.length, len(data), section.name)
    return piece


def pass_section(source: Source, section: Section) -> None:
    """SPEC [R6.6-6] to [R6.6-8]: checks a section that is not kept, in bounded memory. Raises as read_section."""
    crc, at, end = 0, section.start, section.start + section.length
    while at < end:
        block = source.read(at, min(_BLOCK_BYTES, end - at))
        if not block:
            raise truncated(source, section.name, section.end)
        crc, at = zlib.crc32(block, crc), at + len(block)
    padding = Piece(source.read(end, section.end - end), end)
    if len(padding) < section.end - end:
        raise truncated(source, section.name, section.end)
    if crc != section.crc:
        stated = f"0x{section.crc:08x}"
        raise BitstreamError("section.crc", section.start, section.name, stated, f"0x{crc:08x}")
    padding.require_zero("section.padding", 0, len(padding), section.name)


def check_end(source: Source, sections: tuple[Section, ...]) -> None:
    """SPEC [R6.6-9]: checks that nothing follows the last section. Raises BitstreamError file.trailing."""
    end = sections[-1].end
    if source.read(end, 1):
        raise BitstreamError("file.trailing", end, "file", f"{source.length()} bytes", end)
