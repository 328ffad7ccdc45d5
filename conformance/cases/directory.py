"""Cases of clauses 5.6 and 6.6: the directory, and the sections' places, lengths, checksums and padding."""

import zlib
from typing import Any

from refcodec.bitstream.directory import (
    DATA,
    FRAME,
    INDEX,
    MODES,
    PLANES_SECTION,
    SECTION_LENGTH_MAX,
    SECTIONS,
    WEIGHTS,
    section_lengths,
)

from .checksums import Depth, resized
from .fault import Draw, Drawn, Edit, Whole, element, ends, fault, padding
from .table import refused
from .target import Target
from .targets import packed, plain, planeless, strewn, unencoded, unpredicted

_OTHER_BYTES = [value for value in range(256) if value not in (*range(0x41, 0x5B), *range(0x61, 0x7B))]


def _entry(draw: Draw, t: Target) -> int:
    return draw.integer(0, t.fields.section_count - 1)


# --- faults of the entries --------------------------------------------------------------------------------------------


@fault("directory.type", _entry, (0, 3), _OTHER_BYTES)
def type_byte(t: Target, entry: int, place: int, value: int) -> Edit:
    """A byte of a type is not a letter."""
    at = t.at(f"directory[{entry}].type")
    return Edit({at + place: bytes([value])}, at)


unknown_section = element(
    "directory.unknown_critical", "directory[{}].type", _entry, [b"NOTE", b"Note", b"FRAm", b"ZZZZ", b"AAAA"]
)


def _types(draw: Draw, t: Target) -> Drawn:
    """Draws swapped, repeated or missing types, and, if there is a place, an additional one after DATA."""
    entries = [(entry, e.type) for entry, e in enumerate(t.fields.directory) if e.type in SECTIONS]
    first, last = draw.integer(0, len(entries) - 2), t.fields.section_count - 1
    (one, kind), (other, other_kind) = entries[first], entries[first + 1]
    behind = [({last: DATA}, last)] if last > t.sections[DATA].number else []
    return draw.choice(
        [({one: other_kind, other: kind}, one), ({other: kind}, other), ({one: b"noTE"}, other), *behind]
    )


@fault("directory.order", _types)
def types(t: Target, kinds: dict[int, bytes], wrong: int | None) -> Edit:
    """Entries have other known types. kinds: by entry. wrong: the first entry out of order; None if one is missing."""
    values = {f"directory[{entry}].type": kind for entry, kind in kinds.items()}
    return Edit(t.pack(values), t.at("section_count" if wrong is None else f"directory[{wrong}].type"))


@fault("directory.order", lambda d, t: d.integer(0, t.sections[DATA].number))
def few_sections(t: Target, count: int) -> Whole:
    """There are fewer sections than critical types."""

    def change(fields: Any) -> None:
        fields.section_count, fields.directory = count, fields.directory[:count]

    return Whole(t.with_header(change), t.at("section_count"))


mode = element(
    "directory.mode",
    "directory[{}].mode",
    lambda d, t: d.choice([section.number for section in t.sections.values()]),
    lambda d, t, entry: d.integer(1 + MODES.get(t.header.sections[entry].type, 0), 255),
)


def _implied(t: Target) -> dict[bytes, int]:
    """Returns the lengths that the header implies, by type."""
    modes = {kind: section.mode for kind, section in t.sections.items()}
    implied = section_lengths(t.header.dimensions, t.header.chunk_count, modes)
    return {kind: length for kind, length in implied.items() if kind in t.sections}


@fault(
    "directory.length",
    lambda d, t: d.choice([kind for kind in _implied(t) if t.content(kind)]),
    lambda d, t, kind: d.integer(1, 7) if d.flag() else -d.integer(1, 6),
)
def section_length(t: Target, kind: bytes, change: int) -> Whole:
    """A section is longer or shorter than the header implies.

    change: zero bytes that are added, or bytes that are removed if it is negative.
    """
    content = t.content(kind)
    made = content + bytes(change) if change > 0 else content[:change]
    return Whole(resized(t.data, kind, made), t.at(f"directory[{t.sections[kind].number}].length"))


def _lengths(draw: Draw, t: Target) -> Drawn:
    """Draws a length that is not the implied one, or is above the maximum of all sections."""
    kinds, section = _implied(t), draw.choice(t.header.sections)
    if section.type in kinds:
        # The lower 32 bits may be right.
        return section.number, kinds[section.type] + (draw.integer(1, 0xFFFF) << 32)
    return section.number, draw.integer(SECTION_LENGTH_MAX + 1, (1 << 64) - 1)


stated_length = element("directory.length", "directory[{}].length", _lengths)

# --- faults of the sections -------------------------------------------------------------------------------------------

# Between the header and the end of the last section with its padding.
cut = ends("section.truncated", "cut", lambda d, t: d.integer(t.header_end, len(t.data) - 1))


def _long(draw: Draw, t: Target) -> dict[int, int]:
    # SPEC [R6.10-6]: another length of DATA would contradict the index.
    section = draw.choice([s for s in t.header.sections if s.type not in _implied(t) and s.type != DATA])
    return {section.number: draw.integer(len(t.data) - section.start + 1, SECTION_LENGTH_MAX)}


@fault("section.truncated", _long)
def long_sections(t: Target, lengths: dict[int, int], right: Depth = Depth.CHUNKS) -> Edit:
    """Sections have allowed lengths, by entry, but extend beyond the file. right: as of Edit."""
    values = {f"directory[{entry}].length": length for entry, length in lengths.items()}
    return Edit(t.pack(values), len(t.data), right)


@fault(
    "section.crc",
    lambda d, t: d.choice([kind for kind in t.sections if kind != DATA]),
    lambda d, t, kind: d.integer(0, t.section(kind).length - 1),
    (1, 255),
)
def section_byte(t: Target, kind: bytes, at: int, bits: int) -> Edit:
    """Bits of a byte of a section are flipped, without its CRC-32.

    kind: not DATA, whose chunks have CRC-32s. at: the byte, from the section's start, or from its end if negative.
    """
    section = t.section(kind)
    place = range(section.start, section.start + section.length)[at]
    return Edit(t.flip(place, bits), section.start, Depth.NOTHING)


@fault("section.crc", _entry, lambda d, t, entry: t.fields.directory[entry].crc ^ d.integer(1, 0xFFFFFFFF))
def section_crc(t: Target, entry: int, value: int) -> Edit:
    """A section's entry has a wrong CRC-32. That of DATA must be 0."""
    return Edit(t.pack({f"directory[{entry}].crc": value}), t.header.sections[entry].start, Depth.HEADER)


padding_byte = padding("section.padding", r"\w+(\[\d+\])?, padding")


@fault("file.trailing", lambda d, t: d.content(1, 9))
def bytes_behind(t: Target, content: bytes) -> Whole:
    """There are bytes after the last section and its padding."""
    return Whole(t.data + content, len(t.data))


def _crc_of_padding(t: Target) -> int:
    """Returns the CRC-32 of an ancillary section with its padding."""
    section = t.section(b"noTE")
    return zlib.crc32(t.data[section.start : section.end])


# fmt: off
CASES = [
    # Types and modes.
    *refused("directory", "type-letters", *(
        (f"type-{value:02x}-in-entry-{entry}", f"byte {place} of the type of entry {entry} is {text}", type_byte, entry,
         place, value)
        for entry, place, value, text in (
            (0, 0, 0x40, "the byte before A"), (1, 1, 0x5B, "the byte behind Z"), (5, 0, 0x60, "the byte before a"),
            (6, 3, 0x7B, "the byte behind z"), (2, 2, 0x31, "a digit"), (5, 1, 0xCF, "a letter with its high bit set"),
            (4, 0, 0x00, "zero")))),
    *refused("directory", "critical-skipped", *(
        (f"section-{kind.lower()}-as-entry-{entry}", f"a critical section {kind} {text}", unknown_section, entry,
         kind.encode())
        for entry, kind, text in (
            (0, "NOTE", "before all others"), (6, "ZZZZ", "behind all others"), (5, "Priv", "that is private"),
            (3, "FRAm", "of letters that are those of a known one but for their case")))),
    *refused("directory", "mode-unchecked", *(
        (f"mode-{section}-{value}", f"mode {value} of the {section}", mode, entry, value)
        for entry, section, value in (
            (0, "frame", 1), (1, "weights", 2), (2, "planes", 1), (3, "index", 2), (4, "data", 1), (4, "data", 255)))),

    # The order of sections.
    *refused("directory", "section-order",
        ("order-swapped", "the planes come before the weights", types, {1: PLANES_SECTION, 2: WEIGHTS}, 1),
        ("order-twice", "two sections of data", types, {6: DATA}, 6),
        ("order-early", "two sections of weights", types, {2: WEIGHTS}, 2),
        ("order-missing", "the frame is an ancillary section", types, {0: b"fRAM"}, 1),
        ("order-missing-planes", "no planes, though there are plane channels", types, {2: b"plNS"}, 3),
        ("order-behind", "a critical section behind the ancillary ones", types, {6: FRAME}, 6),
        ("order-data-before-index", "the data come before the index", types, {3: DATA, 4: INDEX}, 3),
        ("order-no-data", "the data are an ancillary section", types, {4: b"dATA"}, None),
        ("order-planes-of-none", "planes, though there are no plane channels", planeless, types, {2: PLANES_SECTION},
         2),
        ("order-frame-of-none", "a frame, though there are neither planes nor frequencies", unpredicted, types,
         {0: FRAME}, 0),
        ("order-no-frame", "no frame, though there are frequencies", planeless, types, {0: b"frAM"}, 1),
        ("order-no-frame-of-planes", "no frame, though there are planes", unencoded, types, {0: b"frAM"}, 1),
        ("order-data-behind", "two sections of the last type", strewn, types, {10: DATA}, 10)),
    *refused("directory", "section-order truncation", *(
        (f"sections-{count}", f"{count} sections", few_sections, count) for count in (0, 4))),

    # Lengths.
    *refused("directory", "lengths-trusted", *(
        (f"length-{before}{SECTIONS[kind]}-{'plus' if change > 0 else 'minus'}-{abs(change)}",
         f"{SECTIONS[kind]}{text}: {change:+} bytes against what the header implies", base, section_length, kind,
         change)
        for base, before, text, kind, change in (
            (plain, "", "", FRAME, 1), (plain, "", "", FRAME, -1), (plain, "", "", WEIGHTS, 4),
            (plain, "", "", WEIGHTS, -4), (plain, "", "", INDEX, 28), (plain, "", "", INDEX, -1),
            (packed, "packed-", " in mode 1", INDEX, 28), (packed, "packed-", " in mode 1", INDEX, -28)))),
    *refused("directory", "length-in-32-bits sum-wraps lengths-trusted", (stated_length,),
        ("length-ancillary-over", "an ancillary section of 2^48 + 1 bytes", 5, SECTION_LENGTH_MAX + 1),
        ("length-ancillary-huge", "an ancillary section of 2^64 - 1 bytes", 5, (1 << 64) - 1),
        ("length-ancillary-signed", "an ancillary section of 2^63 bytes", 5, 1 << 63),
        ("length-planes-huge", "planes of 2^64 - 4 bytes, with which the sum of lengths wraps", 2, (1 << 64) - 4),
        ("length-data-huge", "data of 2^64 - 8 bytes, with which the sum of lengths wraps", 4, (1 << 64) - 8),
        ("length-frame-high", "a frame of 2^32 + 88 bytes", 0, (1 << 32) + 88)),
    *refused("directory", "length-in-32-bits lengths-trusted",
        ("length-index-high", "an index of 2^40 bytes and those that the header implies", stated_length, 3,
         lambda t: (1 << 40) + t.sections[INDEX].length)),

    # The end of the file.
    *refused("directory", "truncation", *(
        (f"file-cut-{name}", f"the file is cut, {name.replace('-', ' ')}", base, cut, place)
        for name, base, place in (
            ("by-one", strewn, lambda t: len(t.data) - 1),
            ("before-its-last-padding", strewn, lambda t: len(t.data) - 3),
            ("within-the-last-chunk", plain, lambda t: t.chunk_at(2) + 21),
            ("behind-the-first-chunk", plain, lambda t: t.chunk_at(1)),
            ("behind-header", plain, lambda t: t.header_end),
            ("before-the-index", plain, lambda t: t.start(INDEX)),
            ("within-an-ancillary-section", strewn, lambda t: t.header.sections[6].start + 2)))),
    *refused("directory", "truncation length-in-32-bits lengths-trusted", *(
        (f"beyond-{name}", text, plain, long_sections, {entry: length})
        for name, text, entry, length in (
            ("ancillary-2-48", "an ancillary section of 2^48 bytes", 5, SECTION_LENGTH_MAX),
            ("ancillary-high", "an ancillary section of 2^32 bytes and those that are there", 5, (1 << 32) + 5),
            ("ancillary-last", "the last ancillary section has a byte that is not there", 6, 1),
            ("planes-2-48", "planes of 2^48 bytes", 2, SECTION_LENGTH_MAX),
            ("planes-2-32", "planes of 2^32 bytes", 2, 1 << 32)))),
    *refused("directory", "truncation sum-wraps lengths-trusted",
        ("beyond-all", "sections of 2^48 bytes each, before the frame and among the critical ones", strewn,
         long_sections, lambda t: {s.number: SECTION_LENGTH_MAX for s in t.header.sections if s.type not in SECTIONS},
         Depth.HEADER)),
    *refused("directory", "trailing-bytes",
        ("behind-the-end-one", "1 byte behind the last section", bytes_behind, b"\0"),
        ("behind-the-end-four", "4 bytes behind the last section", bytes_behind, bytes(4)),
        ("behind-the-end-section", "4 bytes behind the last section", bytes_behind, b"noTE"),
        ("behind-the-padding", "bytes behind the padding of the last section", strewn, bytes_behind, b"\1")),

    # Checksums and padding.
    *refused("directory", "checksum-unchecked", (section_byte,),
        *((f"crc-{section.replace(' ', '-')}", f"the CRC-32 of the {section} does not match", kind, -1, 0x80)
          for kind, section in (
              (FRAME, "frame"), (WEIGHTS, "weights"), (INDEX, "index"), (b"noTE", "ancillary section"))),
        ("crc-planes", "the CRC-32 of the planes does not match", PLANES_SECTION, 0, 1),
        (section_crc,),
        ("crc-of-nothing", "the CRC-32 of an empty ancillary section is not 0", 6, 1),
        ("crc-of-padding", "the CRC-32 of an ancillary section covers its padding too", 5, _crc_of_padding)),
    *refused("directory", "data-crc", (section_crc,),
        ("crc-of-data", "the directory's CRC-32 of the data is not 0", 4, 1 << 31),
        ("crc-of-data-right", "the directory has the CRC-32 of the data", 4, lambda t: zlib.crc32(t.content(DATA)))),
    *refused("directory", "padding-unchecked", *(
        (f"section-padding-{entry}-{place}", f"byte {place} of the padding behind section {entry} is {value}", strewn,
         padding_byte, path, place, value)
        for entry, path, place, value in (
            (0, "moRE[0], padding", 0, 1), (2, "noTE[2], padding", 2, 0x80), (10, "noTE[10], padding", 0, 255)))),
]
