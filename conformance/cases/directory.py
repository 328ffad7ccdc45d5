"""Cases of clauses 5.6 and 6.6: the directory, and the sections' places, lengths, checksums and padding."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import partial
from typing import Any

from refcodec.bitstream import directory
from refcodec.bitstream.directory import DATA, FRAME, INDEX, PLANES_SECTION, SECTION_LENGTH_MAX, SECTIONS, WEIGHTS

from .book import Book
from .checksums import Depth, resized
from .fault import Draw, Drawn, Edit, Refused, Whole, fault, one_field
from .target import Target
from .targets import packed, plain, planeless, strewn, unencoded, unpredicted

# --- faults of the entries --------------------------------------------------------------------------------------------


@fault("directory.type")
def type_byte(t: Target, entry: int, place: int, value: int) -> Edit:
    """A byte of a type is not a letter."""
    at = t.at(f"directory[{entry}].type")
    return Edit({at + place: bytes([value])}, at)


@type_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    letters = (*range(0x41, 0x5B), *range(0x61, 0x7B))
    other = draw.choice([value for value in range(256) if value not in letters])
    return t, draw.integer(0, t.fields.section_count - 1), draw.integer(0, 3), other


@fault("directory.unknown_critical")
def unknown_section(t: Target, entry: int, kind: bytes) -> Edit:
    """An entry has an unknown critical type."""
    path = f"directory[{entry}].type"
    return Edit(t.pack({path: kind}), t.at(path))


@unknown_section.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, t.fields.section_count - 1), draw.choice([b"NOTE", b"Note", b"FRAm", b"ZZZZ", b"AAAA"])


@fault("directory.order")
def types(t: Target, kinds: dict[int, bytes], wrong: int) -> Edit:
    """Entries have other known types. kinds: types by entry. wrong: the first entry out of order."""
    values = {f"directory[{entry}].type": kind for entry, kind in kinds.items()}
    return Edit(t.pack(values), t.at(f"directory[{wrong}].type"))


@types.drawn
def _(draw: Draw, t: Target) -> Drawn:
    entries = [(entry, e.type) for entry, e in enumerate(t.fields.directory) if e.type in SECTIONS]
    first = draw.integer(0, len(entries) - 2)
    last = t.fields.section_count - 1
    (one, kind), (other, other_kind) = entries[first], entries[first + 1]
    kinds, wrong = draw.choice(
        [
            # Swapped, repeated, missing, and, if there is a place, an additional one after DATA.
            ({one: other_kind, other: kind}, one),
            ({other: kind}, other),
            ({one: b"noTE"}, other),
            *([({last: DATA}, last)] if last > t.sections[DATA].number else []),
        ]
    )
    return t, kinds, wrong


@fault("directory.order")
def few_sections(t: Target, count: int) -> Whole:
    """There are fewer sections than critical types."""

    def change(fields: Any) -> None:
        fields.section_count, fields.directory = count, fields.directory[:count]

    return Whole(t.with_header(change), t.at("section_count"))


@few_sections.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(0, t.sections[DATA].number)


@fault("directory.mode")
def mode(t: Target, entry: int, value: int) -> Edit:
    """The mode is unknown for the section."""
    return one_field(t, f"directory[{entry}].mode", value)


@mode.drawn
def _(draw: Draw, t: Target) -> Drawn:
    section = draw.choice(list(t.sections.values()))
    return t, section.number, draw.integer(1 + directory.MODES.get(section.type, 0), 255)


def _implied(t: Target) -> dict[bytes, int]:
    """Returns the lengths that the header implies, by type."""
    modes = {kind: section.mode for kind, section in t.sections.items()}
    implied = directory.section_lengths(t.header.dimensions, t.header.chunk_count, modes)
    return {kind: length for kind, length in implied.items() if kind in t.sections}


@fault("directory.length")
def section_length(t: Target, kind: bytes, change: int) -> Whole:
    """A section is longer or shorter than the header implies.

    change: zero bytes that are added, or bytes that are removed if it is negative.
    """
    content = t.content(kind)
    made = content + bytes(change) if change > 0 else content[:change]
    return Whole(resized(t.data, kind, made), t.at(f"directory[{t.sections[kind].number}].length"))


@section_length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    kind = draw.choice([kind for kind in _implied(t) if t.content(kind)])
    return t, kind, draw.integer(1, 7) if draw.flag() else -draw.integer(1, 6)


@fault("directory.length")
def stated_length(t: Target, entry: int, value: int) -> Edit:
    """The length is not the implied one, or is above the maximum of all sections."""
    return one_field(t, f"directory[{entry}].length", value)


@stated_length.drawn
def _(draw: Draw, t: Target) -> Drawn:
    kinds = _implied(t)
    section = draw.choice(t.header.sections)
    if section.type in kinds:
        # The lower 32 bits may be right.
        return t, section.number, kinds[section.type] + (draw.integer(1, 0xFFFF) << 32)
    return t, section.number, draw.integer(SECTION_LENGTH_MAX + 1, (1 << 64) - 1)


# --- faults of the sections -------------------------------------------------------------------------------------------


@fault("section.truncated")
def cut(t: Target, length: int) -> Whole:
    """The file ends between its header and the end of its last section with padding."""
    return Whole(t.data[:length], length)


@cut.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.integer(t.header_end, len(t.data) - 1)


@fault("section.truncated")
def long_section(t: Target, entry: int, length: int) -> Edit:
    """A section has an allowed length, but extends beyond the file."""
    return Edit(t.pack({f"directory[{entry}].length": length}), len(t.data))


@long_section.drawn
def _(draw: Draw, t: Target) -> Drawn:
    # SPEC [R6.10-6]: another length of DATA would contradict the index.
    free = [s for s in t.header.sections if s.type not in _implied(t) and s.type != DATA]
    section = draw.choice(free)
    return t, section.number, draw.integer(len(t.data) - section.start + 1, SECTION_LENGTH_MAX)


@fault("section.crc")
def section_byte(t: Target, kind: bytes, at: int, bits: int) -> Edit:
    """Bits of a byte of a section are flipped, without its CRC-32.

    kind: not DATA, whose chunks have CRC-32s. at: the byte, from the section's start, or from its end if negative.
    """
    section = t.section(kind)
    place = range(section.start, section.start + section.length)[at]
    return Edit(t.flip(place, bits), section.start, Depth.NOTHING)


@section_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    section = draw.choice([s for kind, s in t.sections.items() if kind != DATA])
    return t, section.type, draw.integer(0, section.length - 1), draw.integer(1, 255)


@fault("section.crc")
def section_crc(t: Target, entry: int, value: int) -> Edit:
    """A section's entry has a wrong CRC-32. That of DATA must be 0."""
    return Edit(t.pack({f"directory[{entry}].crc": value}), t.header.sections[entry].start, Depth.HEADER)


@section_crc.drawn
def _(draw: Draw, t: Target) -> Drawn:
    entry = draw.integer(0, t.fields.section_count - 1)
    return t, entry, t.fields.directory[entry].crc ^ draw.integer(1, 0xFFFFFFFF)


@fault("section.padding")
def padding_byte(t: Target, entry: int, place: int, value: int) -> Edit:
    """A byte of the padding after a section is not zero."""
    section = t.header.sections[entry]
    first = section.start + section.length
    return Edit({first + place: bytes([value])}, first)


@padding_byte.drawn
def _(draw: Draw, t: Target) -> Drawn:
    padded = [s for s in t.header.sections if s.length % 4]
    section = draw.choice(padded)
    return t, section.number, draw.integer(0, -section.length % 4 - 1), draw.integer(1, 255)


@fault("file.trailing")
def bytes_behind(t: Target, content: bytes) -> Whole:
    """There are bytes after the last section and its padding."""
    return Whole(t.data + content, len(t.data))


@bytes_behind.drawn
def _(draw: Draw, t: Target) -> Drawn:
    return t, draw.content(1, 9)


# --- the suite's ------------------------------------------------------------------------------------------------------

Add = Callable[..., None]


def add(book: Book) -> None:
    """Adds the vectors."""
    add = partial(book.add, features="directory")
    _types(add)
    _orders(add)
    _lengths(add)
    _truncated(add)
    _checksums(add)


def _types(add: Add) -> None:
    for entry, place, value, text in (
        (0, 0, 0x40, "the byte before A"),
        (1, 1, 0x5B, "the byte behind Z"),
        (5, 0, 0x60, "the byte before a"),
        (6, 3, 0x7B, "the byte behind z"),
        (2, 2, 0x31, "a digit"),
        (5, 1, 0xCF, "a letter with its high bit set"),
        (4, 0, 0x00, "zero"),
    ):
        title = f"byte {place} of the type of entry {entry} is {text}"
        make = type_byte.of(plain, entry, place, value)
        add(f"malformed-type-{value:02x}-in-entry-{entry}", title, make, flags="type-letters")
    for entry, kind, text in (
        (0, b"NOTE", "before all others"),
        (3, b"FRAm", "of letters that are those of a known one but for their case"),
        (6, b"ZZZZ", "behind all others"),
        (5, b"Priv", "that is private"),
    ):
        title, make = f"a critical section {kind.decode()} {text}", unknown_section.of(plain, entry, kind)
        add(f"unsupported-section-{kind.decode().lower()}-as-entry-{entry}", title, make, flags="critical-skipped")
    for entry, section in enumerate(SECTIONS.values()):
        kind = list(SECTIONS)[entry]
        value = 1 + directory.MODES.get(kind, 0)
        title, make = f"mode {value} of the {section}", mode.of(plain, entry, value)
        add(f"unsupported-mode-{section}-{value}", title, make, flags="mode-unchecked")
    add("unsupported-mode-data-255", "mode 255 of the data", mode.of(plain, 4, 255), flags="mode-unchecked")


def _orders(add: Add) -> None:
    orders: list[tuple[str, str, dict[int, bytes], int]] = [
        ("swapped", "the planes come before the weights", {1: PLANES_SECTION, 2: WEIGHTS}, 1),
        ("twice", "two sections of data", {6: DATA}, 6),
        ("early", "two sections of weights", {2: WEIGHTS}, 2),
        ("missing", "the frame is an ancillary section", {0: b"fRAM"}, 1),
        ("missing-planes", "no planes, though there are plane channels", {2: b"plNS"}, 3),
        ("behind", "a critical section behind the ancillary ones", {6: FRAME}, 6),
        ("data-before-index", "the data come before the index", {3: DATA, 4: INDEX}, 3),
    ]
    for name, title, kinds, wrong in orders:
        add(f"malformed-order-{name}", title, types.of(plain, kinds, wrong), flags="section-order")
    without: list[tuple[str, str, Callable[[], Target], dict[int, bytes], int]] = [
        ("planes-of-none", "planes, though there are no plane channels", planeless, {2: PLANES_SECTION}, 2),
        ("frame-of-none", "a frame, though there are neither planes nor frequencies", unpredicted, {0: FRAME}, 0),
    ]
    for name, title, base, kinds, wrong in without:
        add(f"malformed-order-{name}", title, types.of(base, kinds, wrong), flags="section-order")
    title, make = "no frame, though there are frequencies", types.of(planeless, {0: b"frAM"}, 1)
    add("malformed-order-no-frame", title, make, flags="section-order")
    title, make = "no frame, though there are planes", types.of(unencoded, {0: b"frAM"}, 1)
    add("malformed-order-no-frame-of-planes", title, make, flags="section-order")
    title, make = "two sections of the last type", types.of(strewn, {10: DATA}, 10)
    add("malformed-order-data-behind", title, make, flags="section-order")
    for count in (0, 4):
        title, make = f"{count} sections", few_sections.of(plain, count)
        add(f"malformed-sections-{count}", title, make, flags="section-order truncation")
    title = "the data are an ancillary section"
    add("malformed-order-no-data", title, _without_data, flags="section-order")


def _without_data() -> Refused:
    """The last critical section is missing: the error names section_count."""
    t = plain()
    return Refused(t.with_values({"directory[4].type": b"dATA"}), "directory.order", t.at("section_count"))


def _lengths(add: Add) -> None:
    for base, before, text, kind, change in (
        (plain, "", "", FRAME, 1),
        (plain, "", "", FRAME, -1),
        (plain, "", "", WEIGHTS, 4),
        (plain, "", "", WEIGHTS, -4),
        (plain, "", "", INDEX, 28),
        (plain, "", "", INDEX, -1),
        (packed, "packed-", " in mode 1", INDEX, 28),
        (packed, "packed-", " in mode 1", INDEX, -28),
    ):
        section = SECTIONS[kind]
        sign = "plus" if change > 0 else "minus"
        add(
            f"malformed-length-{before}{section}-{sign}-{abs(change)}",
            f"{section}{text}: {change:+} bytes against what the header implies",
            section_length.of(base, kind, change),
            flags="lengths-trusted",
        )
    for entry, value, name, text in (
        (5, SECTION_LENGTH_MAX + 1, "ancillary-over", "an ancillary section of 2^48 + 1 bytes"),
        (5, (1 << 64) - 1, "ancillary-huge", "an ancillary section of 2^64 - 1 bytes"),
        (5, 1 << 63, "ancillary-signed", "an ancillary section of 2^63 bytes"),
        (2, (1 << 64) - 4, "planes-huge", "planes of 2^64 - 4 bytes, with which the sum of lengths wraps"),
        (4, (1 << 64) - 8, "data-huge", "data of 2^64 - 8 bytes, with which the sum of lengths wraps"),
        (0, (1 << 32) + 88, "frame-high", "a frame of 2^32 + 88 bytes"),
    ):
        make = stated_length.of(plain, entry, value)
        add(f"malformed-length-{name}", text, make, flags="length-in-32-bits sum-wraps lengths-trusted")
    add(
        "malformed-length-index-high",
        "an index of 2^40 bytes and those that the header implies",
        lambda: stated_length(plain(), 3, (1 << 40) + plain().sections[INDEX].length),
        flags="length-in-32-bits lengths-trusted",
    )


def _truncated(add: Add) -> None:
    places: list[tuple[str, Callable[[], Target], Callable[[Target], int]]] = [
        ("by-one", strewn, lambda t: len(t.data) - 1),
        ("before-its-last-padding", strewn, lambda t: len(t.data) - 3),
        ("within-the-last-chunk", plain, lambda t: t.chunk_at(2) + 21),
        ("behind-the-first-chunk", plain, lambda t: t.chunk_at(1)),
        ("behind-header", plain, lambda t: t.header_end),
        ("before-the-index", plain, lambda t: t.start(INDEX)),
        ("within-an-ancillary-section", strewn, lambda t: t.header.sections[6].start + 2),
    ]
    for name, base, place in places:
        title = f"the file is cut, {name.replace('-', ' ')}"
        add(f"malformed-file-cut-{name}", title, partial(_cut_at, base, place), flags="truncation")
    for entry, length, name, text in (
        (5, SECTION_LENGTH_MAX, "ancillary-2-48", "an ancillary section of 2^48 bytes"),
        (5, (1 << 32) + 5, "ancillary-high", "an ancillary section of 2^32 bytes and those that are there"),
        (6, 1, "ancillary-last", "the last ancillary section has a byte that is not there"),
        (2, SECTION_LENGTH_MAX, "planes-2-48", "planes of 2^48 bytes"),
        (2, 1 << 32, "planes-2-32", "planes of 2^32 bytes"),
    ):
        make = long_section.of(plain, entry, length)
        add(f"malformed-beyond-{name}", text, make, flags="truncation length-in-32-bits lengths-trusted")
    title = "sections of 2^48 bytes each, before the frame and among the critical ones"
    add("malformed-beyond-all", title, _all_beyond, flags="truncation sum-wraps lengths-trusted")
    for name, content in (("one", b"\0"), ("four", bytes(4)), ("section", b"noTE")):
        title = f"{len(content)} byte{'s' * (len(content) > 1)} behind the last section"
        add(f"malformed-behind-the-end-{name}", title, bytes_behind.of(plain, content), flags="trailing-bytes")
    title = "bytes behind the padding of the last section"
    add("malformed-behind-the-padding", title, bytes_behind.of(strewn, b"\1"), flags="trailing-bytes")


def _cut_at(base: Callable[[], Target], place: Callable[[Target], int]) -> Refused:
    return cut(base(), place(base()))


def _all_beyond() -> Refused:
    t = strewn()
    free = [s.number for s in t.header.sections if s.type not in SECTIONS]
    values = {f"directory[{number}].length": SECTION_LENGTH_MAX for number in free}
    return Refused(t.with_values(values, Depth.HEADER), "section.truncated", len(t.data))


def _checksums(add: Add) -> None:
    for kind, section in ((FRAME, "frame"), (WEIGHTS, "weights"), (INDEX, "index"), (b"noTE", "ancillary section")):
        title, make = f"the CRC-32 of the {section} does not match", section_byte.of(plain, kind, -1, 0x80)
        add(f"malformed-crc-{section.replace(' ', '-')}", title, make, flags="checksum-unchecked")
    title, make = "the CRC-32 of the planes does not match", section_byte.of(plain, PLANES_SECTION, 0, 1)
    add("malformed-crc-planes", title, make, flags="checksum-unchecked")
    title, make = "the CRC-32 of an empty ancillary section is not 0", section_crc.of(plain, 6, 1)
    add("malformed-crc-of-nothing", title, make, flags="checksum-unchecked")
    title, make = "the directory's CRC-32 of the data is not 0", section_crc.of(plain, 4, 1 << 31)
    add("malformed-crc-of-data", title, make, flags="data-crc")
    add("malformed-crc-of-data-right", "the directory has the CRC-32 of the data", _data_crc, flags="data-crc")
    title = "the CRC-32 of an ancillary section covers its padding too"
    add("malformed-crc-of-padding", title, _padding_crc, flags="checksum-unchecked")
    add = partial(add, flags="padding-unchecked")
    for entry, place, value in ((0, 0, 1), (2, 2, 0x80), (10, 0, 255)):
        title = f"byte {place} of the padding behind section {entry} is {value}"
        add(f"malformed-section-padding-{entry}-{place}", title, padding_byte.of(strewn, entry, place, value))


def _data_crc() -> Refused:
    t = plain()
    return section_crc(t, t.sections[DATA].number, zlib.crc32(t.content(DATA)))


def _padding_crc() -> Refused:
    t = plain()
    section = t.section(b"noTE")
    return section_crc(t, section.number, zlib.crc32(t.data[section.start : section.end]))
