"""Cases of clauses 5.6, 6.6 and 12.1: the directory, ancillary sections and the sections' checksums."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from refcodec.bitstream import directory
from refcodec.bitstream.directory import ATTRIBUTES, CHUNK_TABLE, FRAME, POSITIONS, SECTIONS, WEIGHTS
from refcodec.bitstream.scene import Scene

from .book import Book
from .checksums import Depth, resized
from .fault import Draw, Drawn, Edit, Refused, Whole, fault
from .samplers import drawn
from .scenes import SMALLEST
from .target import Target
from .targets import packed, plain

# --- faults -----------------------------------------------------------------------------------------------------------


@fault("directory.unknown_critical")
def unknown_section(t: Target, entry: int, kind: int) -> Edit:
    """An entry of a critical type that is not known."""
    path = f"directory[{entry}].type"
    return Edit(t.pack({path: kind}), t.at(path))


@unknown_section.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, t.fields.section_count - 1), draw.choice([0x80, 0x88, 0xFF])


@fault("directory.order")
def types(t: Target, kinds: dict[int, int], wrong: int) -> Edit:
    """Entries of other types, which are known. kinds: types by entry. wrong: the first entry that is out of order."""
    values = {f"directory[{entry}].type": kind for entry, kind in kinds.items()}
    return Edit(t.pack(values), t.at(f"directory[{wrong}].type"))


@types.drawn
def _(draw: Draw, t: Target) -> Drawn:
    old = [e.type for e in t.fields.directory]
    critical = draw.integer(0, 5)
    last = draw.integer(1, len(old) - 1)
    kinds, wrong = draw.choice(
        [
            ({critical: old[critical + 1], critical + 1: old[critical]}, critical),
            ({last: old[last - 1]}, last),
            ({critical: 5}, critical),
            ({last: 0}, last),
        ]
    )
    return t, kinds, wrong


@fault("directory.order")
def few_sections(t: Target, count: int) -> Whole:
    """Fewer sections than the critical ones."""

    def change(fields: Any) -> None:
        fields.section_count, fields.directory = count, fields.directory[:count]

    return Whole(t.with_header(change), t.at("section_count"))


@few_sections.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, 6)


@fault("directory.mode")
def mode(t: Target, entry: int, value: int) -> Edit:
    """A mode that the section does not have."""
    path = f"directory[{entry}].mode"
    return Edit(t.pack({path: value}), t.at(path))


@mode.drawn
def _(draw: Draw, t: Target) -> Drawn:
    entry, kind = draw.choice(list(enumerate(SECTIONS)))
    return t, entry, draw.integer(1 + directory.MODES.get(kind, 0), 255)


@fault("directory.offset")
def offset(t: Target, entry: int, value: int) -> Edit:
    """A section that does not begin where the one before it ends."""
    path = f"directory[{entry}].offset"
    return Edit(t.pack({path: value}), t.at(path))


@offset.drawn
def _(draw: Draw, t: Target) -> Drawn:
    entry = draw.integer(0, t.fields.section_count - 1)
    right = t.fields.directory[entry].offset
    wrong = [value for value in (right + 1, right - 1, 0, len(t.data), 0xFFFFFFFF) if value != right]
    return t, entry, draw.choice(wrong)


def _implied(t: Target) -> dict[int, int]:
    """By type the lengths that the header implies."""
    modes = {kind: section.mode for kind, section in t.sections.items()}
    return directory.section_lengths(t.header.dimensions, t.header.anchor_count, len(t.header.chunks), modes)


@fault("directory.length")
def section_length(t: Target, kind: int, change: int) -> Whole:
    """A section that is longer or shorter than the header implies.

    change: how many bytes of 0 are added, or cut off if it is negative.
    """
    content = t.content(kind)
    made = content + bytes(change) if change > 0 else content[:change]
    return Whole(resized(t.data, kind, made), t.at(f"directory[{list(SECTIONS).index(kind)}].length"))


@section_length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    kind = draw.choice([kind for kind in _implied(t) if t.content(kind)])
    return t, kind, draw.integer(1, 7) if draw.flag() else -draw.integer(1, 6)


@fault("directory.file_length")
def bytes_behind(t: Target, content: bytes) -> Whole:
    """Bytes behind the last section."""
    return Whole(t.data + content, len(t.data))


@bytes_behind.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.content(1, 9)


@fault("directory.file_length")
def cut(t: Target, length: int) -> Whole:
    """The file ends behind its header and before the end of its last section."""
    return Whole(t.data[:length], length)


@cut.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(t.header_end, len(t.data) - 1)


@fault("section.crc")
def section_byte(t: Target, kind: int, at: int, bits: int) -> Edit:
    """Bits of a byte of a section are turned, and its CRC-32 is the old one.

    at: the byte, from the section's start, or from its end if it is negative.
    """
    section = t.sections[kind]
    return Edit(t.flip(range(section.start, section.end)[at], bits), section.start, Depth.NOTHING)


@section_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    section = draw.choice([s for s in t.sections.values() if s.end > s.start])
    return t, section.type, draw.integer(0, section.end - section.start - 1), draw.integer(1, 255)


@fault("section.crc")
def section_crc(t: Target, entry: int, value: int) -> Edit:
    """Another CRC-32 in a section's entry."""
    return Edit(t.pack({f"directory[{entry}].crc": value}), t.fields.directory[entry].offset, Depth.HEADER)


@section_crc.drawn
def _(draw: Draw, t: Target) -> Drawn:
    entry = draw.integer(0, t.fields.section_count - 1)
    return t, entry, t.fields.directory[entry].crc ^ draw.integer(1, 0xFFFFFFFF)


# --- the suite's ------------------------------------------------------------------------------------------------------


def add(book: Book) -> None:
    """Adds the vectors."""
    add = partial(book.add, features="directory")
    _entries(add)
    _lengths(add)
    _checksums(add)
    _ancillary(book)


Add = Callable[..., None]


def _entries(add: Add) -> None:
    for entry, kind in ((0, 0x80), (3, 0x88), (8, 0xC5)):
        title, make = f"entry {entry} is a critical section {kind:02X}", unknown_section.of(plain, entry, kind)
        add(f"unsupported-section-{kind:02x}-as-entry-{entry}", title, make, flags="critical-skipped")
    orders: list[tuple[str, str, dict[int, int], int]] = [
        ("swapped", "the planes come before the weights", {1: 0x83, 2: 0x82}, 1),
        ("twice", "two sections of masks", {6: 0x86}, 6),
        ("ancillary-among", "an ancillary section among the critical ones", {2: 0x05}, 2),
        ("ancillary-first", "an ancillary section before the critical ones", {0: 0x01}, 0),
        ("ancillary-zero", "an ancillary section of type 00", {7: 0x00}, 7),
        ("ancillary-twice", "two ancillary sections of one type", {8: 0x05}, 8),
        ("ancillary-falls", "ancillary types that fall", {7: 0x0A}, 8),
        ("critical-behind", "a critical section behind the ancillary ones", {8: 0x87}, 8),
    ]
    for name, title, kinds, wrong in orders:
        add(f"malformed-order-{name}", title, types.of(plain, kinds, wrong), flags="section-order")
    for count in (0, 6):
        title, make = f"{count} sections", few_sections.of(plain, count)
        add(f"malformed-sections-{count}", title, make, flags="section-order truncation")
    for entry, (kind, section) in enumerate(SECTIONS.items()):
        value = 1 + directory.MODES.get(kind, 0)
        title, make = f"mode {value} of the {section.replace('_', ' ')}", mode.of(plain, entry, value)
        add(f"unsupported-mode-{section.replace('_', '-')}-{value}", title, make, flags="mode-unchecked")
    for entry, change, text in (
        (0, 1, "one late"),
        (3, 4, "a gap"),
        (5, -2, "an overlap"),
        (8, 1, "the last section, one late"),
    ):
        identifier = f"malformed-offset-{entry}-{text.replace(',', '').replace(' ', '-')}"
        add(identifier, f"entry {entry}: {text}", partial(_moved, entry, change), flags="offsets-trusted")
    title, make = "a section at the end of the address space", offset.of(plain, 2, 0xFFFFFFFF)
    add("malformed-offset-huge", title, make, flags="offsets-trusted buffer-too-small")


def _moved(entry: int, change: int) -> Refused:
    t = plain()
    return offset(t, entry, t.fields.directory[entry].offset + change)


def _lengths(add: Add) -> None:
    for base, before, text, kind, change in (
        (plain, "", "", FRAME, 1),
        (plain, "", "", FRAME, -1),
        (plain, "", "", WEIGHTS, 4),
        (plain, "", "", WEIGHTS, -4),
        (plain, "", "", CHUNK_TABLE, 24),
        (plain, "", "", CHUNK_TABLE, -1),
        (plain, "", "", POSITIONS, 6),
        (plain, "", "", POSITIONS, -6),
        (packed, "packed-", " in mode 1", CHUNK_TABLE, 24),
        (packed, "packed-", " in mode 1", CHUNK_TABLE, -1),
    ):
        section = SECTIONS[kind]
        sign = "plus" if change > 0 else "minus"
        add(
            f"malformed-length-{before}{section.replace('_', '-')}-{sign}-{abs(change)}",
            f"{section.replace('_', ' ')}{text}: {change:+} bytes against what the header implies",
            section_length.of(base, kind, change),
            flags="lengths-trusted",
        )
    title, make = "a byte behind the last section", bytes_behind.of(plain, b"\0")
    add("malformed-behind-the-end", title, make, flags="trailing-bytes")
    places: list[tuple[str, Callable[[Target], int]]] = [
        ("by-one", lambda t: len(t.data) - 1),
        ("within-attributes", lambda t: t.start(ATTRIBUTES) + 5),
        ("behind-header", lambda t: t.header_end),
    ]
    for name, place in places:
        title = f"the file is cut, {name.replace('-', ' ')}"
        add(f"malformed-file-cut-{name}", title, partial(_cut_at, place), flags="truncation")


def _cut_at(place: Callable[[Target], int]) -> Refused:
    return cut(plain(), place(plain()))


def _checksums(add: Add) -> None:
    for kind, section in ((FRAME, "frame"), (WEIGHTS, "weights"), (ATTRIBUTES, "attributes"), (5, "ancillary section")):
        title, make = f"the CRC-32 of the {section} does not match", section_byte.of(plain, kind, -1, 0x80)
        add(f"malformed-crc-{section.replace(' ', '-')}", title, make, flags="checksum-unchecked")
    title, make = "the CRC-32 of an empty ancillary section is not 0", section_crc.of(plain, 8, 1)
    add("malformed-crc-of-nothing", title, make, flags="checksum-unchecked")


def _ancillary(book: Book) -> None:
    text = "the least and the largest ancillary types, empty and not, with modes that mean nothing"
    ends = ((1, 255, b""), (0x3F, 1, b"?"), (0x40, 2, b""), (0x7F, 254, b"last"))
    every = tuple((kind, kind, bytes([kind])) for kind in range(1, 128))
    for name, title, sections in (("ends", text, ends), ("all", "all 127 ancillary types", every)):
        book.valid(
            f"ancillary-{name}",
            title,
            partial(_with_ancillary, sections),
            features="ancillary directory",
            requirements="D12.1-1 R6.6-2 R6.6-6",
            flags="ancillary-refused",
        )


def _with_ancillary(sections: tuple[tuple[int, int, bytes], ...]) -> Scene:
    return replace(drawn("ancillary", 2, SMALLEST), extensions=sections)
