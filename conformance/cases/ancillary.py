"""Cases of clauses 5.16, 5.17, 6.14, 6.15, 12.1 and 12.3: bytes that a decoder skips.

These are ancillary sections with any content, and the header fields of later minor versions. A fault of metadata or
cameras is not an error of the file.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from refcodec.bitstream import codec, metadata
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, build_camera, emit_cameras, parse_cameras
from refcodec.bitstream.header import HEADER_LENGTH_MAX, PROLOGUE_BYTES
from refcodec.bitstream.metadata import METADATA, emit_metadata
from refcodec.bitstream.scene import Ancillary, Scene

from . import directory, header, limits
from .book import Book
from .fault import Refused
from .samplers import drawn
from .scenes import SMALLEST
from .target import Target
from .targets import BEHIND, later, plain

Sections = tuple[Ancillary, ...]


def add(book: Book) -> None:
    """Adds the vectors."""
    _sections(book)
    _metadata(book)
    _cameras(book)
    _versions(book)


def _with_ancillary(*sections: Ancillary) -> Scene:
    return replace(drawn("ancillary", 2, SMALLEST), ancillary=sections)


def _add(book: Book, name: str, title: str, sections: Sections, requirements: str, flags: str = "") -> None:
    book.valid(
        f"ancillary-{name}",
        title,
        partial(_with_ancillary, *sections),
        features="ancillary directory",
        requirements=f"D12.1-1 {requirements}",
        flags=f"ancillary-refused {flags}",
    )


# --- sections ---------------------------------------------------------------------------------------------------------


def _vendor(name: bytes, content: bytes = b"") -> bytes:
    """SPEC 12.1: returns the content of a private section."""
    return bytes([len(name)]) + name + content


def _sections(book: Book) -> None:
    letters = [bytes(kind) for kind in ((0x61, 0x41, 0x41, 0x41), (0x61, 0x5A, 0x7A, 0x61), (0x7A, 0x5A, 0x5A, 0x7A))]
    rows: list[tuple[str, str, Sections, str]] = [
        (
            "everywhere",
            "ancillary sections of all lengths of padding, before, among and behind the critical ones",
            tuple(Ancillary(b"noTE", 0, bytes([place]) * place, place) for place in range(BEHIND + 1)),
            "R6.6-6 R6.6-7 R6.6-8",
        ),
        (
            "repeated",
            "three sections of one type, two of them the same",
            tuple(Ancillary(b"noTE", 0, text, BEHIND) for text in (b"one", b"one", b"two")),
            "R6.6-3",
        ),
        (
            "modes",
            "ancillary sections of modes that mean nothing",
            tuple(Ancillary(b"noTE", mode, b"?", 0) for mode in (1, 2, 255)),
            "R6.6-4",
        ),
        (
            "letters",
            "types at the ends of the alphabet",
            tuple(Ancillary(kind, 0, b"", 2) for kind in letters),
            "R6.6-1 R6.6-2",
        ),
        (
            "lookalikes",
            "types that are those of critical sections but for the case of their first letter",
            tuple(Ancillary(kind, 0, b"!", 3) for kind in (b"fRAM", b"wGTS", b"pLNS", b"iNDX", b"dATA")),
            "R6.6-2 R6.6-3",
        ),
        (
            "private",
            "private sections of two vendors, with content and without",
            (
                Ancillary(b"xyZZ", 0, _vendor(b"org.example.tools", b"\0\1\2"), 0),
                Ancillary(b"xyZZ", 7, _vendor(b"com.example"), BEHIND),
            ),
            "R6.6-2",
        ),
        (
            "private-broken",
            "private sections whose vendor is longer than they are, is no ASCII, or is missing",
            tuple(Ancillary(b"xyZZ", 0, content, 1) for content in (b"\xffshort", _vendor(b"\x80\xff"), b"")),
            "R6.6-2",
        ),
    ]
    for name, title, sections, requirements in rows:
        _add(book, name, title, sections, requirements)


# --- metadata ---------------------------------------------------------------------------------------------------------

STANDARD = {
    "title": "Kürbis, ein Versuch",
    "author": "the suite",
    "licence": "CC0-1.0",
    "source": "numbers of SHAKE-256",
    "comment": "",
    "date": "2024-02-29T23:59:60.5+05:30",
    "encoder": "conformance 0",
    "settings": "none",
    "unit": "0.25",
    "crs": "EPSG:4978",
    "georeference": " ".join(map(str, (1, 0, 0, -2.5, 0, 1, 0, 1e3, 0, 0, 1, 0.125, 0, 0, 0, 1))),
    "org.example.note": "a key of a vendor",
}


def _entry(key: bytes, value: bytes, padding: bytes | None = None) -> bytes:
    made = struct.pack("<HH", len(key), len(value)) + key + value
    return made + (bytes(-len(made) % 4) if padding is None else padding)


def _entries(*entries: bytes, count: int | None = None, reserved: int = 0) -> bytes:
    return struct.pack("<HH", len(entries) if count is None else count, reserved) + b"".join(entries)


def _metadata(book: Book) -> None:
    def add(name: str, title: str, *contents: bytes, mode: int = 0) -> None:
        sections = tuple(Ancillary(METADATA, mode, content) for content in contents)
        _add(book, f"metadata-{name}", f"metadata: {title}", sections, "", "ancillary-contents")

    a, b = _entry(b"author", b"someone"), _entry(b"title", b"something")
    add("standard", "all keys that have a meaning, and one of a vendor", emit_metadata(STANDARD))
    add("empty", "no entries", emit_metadata({}))
    add("twice", "two sections with one key in both", emit_metadata({"title": "1"}), emit_metadata({"title": "2"}))
    longest = _entries(*(_entry(f"k{n}".encode(), b"a" * length) for n, length in enumerate((16378,) * 3 + (16374,))))
    assert len(longest) == metadata.SECTION_BYTES_MAX
    assert not metadata.parse_metadata(longest)[1]
    add("longest", "as many bytes as a section may have", longest)
    broken: list[tuple[str, str, bytes]] = [
        ("too-long", "four bytes more than a section may have", longest + bytes(4)),
        ("nothing", "a section without bytes", b""),
        ("cut", "a section that ends within an entry", _entries(a, b)[:-7]),
        ("count", "a count that no section could hold", _entries(a, b, count=65535)),
        ("behind", "bytes behind the last entry", _entries(a, b) + b"more"),
        ("reserved", "a reserved field that is not 0", _entries(a, b, reserved=1)),
        ("falling", "keys that fall", _entries(b, a)),
        ("same", "a key twice", _entries(a, a)),
        ("key", "a key of other characters", _entries(_entry(b"The Author", b"someone"))),
        ("no-key", "a key without characters", _entries(_entry(b"", b"someone"))),
        ("key-bytes", "a key that is no text", _entries(_entry(b"\xff\xfe", b"someone"))),
        ("value-bytes", "a value that is no text", _entries(_entry(b"title", b"\xc3(\xed\xa0\x80"))),
        ("padding", "padding that is not zero", _entries(_entry(b"title", b"x", b"\1\1"))),
        ("date", "a date that is none", _entries(_entry(b"date", b"yesterday"))),
        ("unit", "a unit that is no number", _entries(_entry(b"unit", b"nan"))),
        ("georeference", "a matrix of fifteen numbers", _entries(_entry(b"georeference", b"1 " * 15))),
    ]
    for name, title, content in broken:
        assert metadata.parse_metadata(content)[1], name
        add(f"broken-{name}", title, content)
    add("broken-mode", "a mode that is not known", _entries(a, b), mode=1)


# --- cameras ----------------------------------------------------------------------------------------------------------

NAN, INFINITY = math.nan, math.inf


def _camera(**changes: object) -> bytes:
    """Returns a camera with changed fields, possibly invalid ones."""
    fields = {**vars(NamedCamera("first")), **changes}
    name = fields["name"]
    text = name if isinstance(name, bytes) else str(name).encode()
    return build_camera({**fields, "name": text})


def _longer(camera: bytes, more: bytes) -> bytes:
    """Returns a camera with fields of a later minor version."""
    return struct.pack("<I", len(camera) - 4 + len(more)) + camera[4:] + more


def _list(*cameras: bytes, count: int | None = None, reserved: int = 0) -> bytes:
    return struct.pack("<HH", len(cameras) if count is None else count, reserved) + b"".join(cameras)


def _cameras(book: Book) -> None:
    def add(name: str, title: str, *contents: bytes, mode: int = 0) -> None:
        sections = tuple(Ancillary(CAMERAS, mode, content) for content in contents)
        _add(book, f"cameras-{name}", f"named cameras: {title}", sections, "", "ancillary-contents")

    tiny = 2.0**-149
    good = [
        NamedCamera("first"),
        NamedCamera("", 1, 1, (tiny, tiny), (-0.5, 9.0), (0.0, 0.0, 0.0, -tiny), (-1.0, 0.0, 2.0)),
        NamedCamera("Küche", (1 << 32) - 1, (1 << 32) - 1, (3.0e38, 3.0e38), (0.0, -0.0), (-0.0, 2.0, -3.0, 0.5)),
    ]
    add("three", "three, of which one has no name and one is as large as can be", emit_cameras(good))
    add("none", "none", emit_cameras([]))
    add("twice", "two sections", emit_cameras(good[:1]), emit_cameras(good[1:]))
    add("later", "fields of a later minor version", _list(_longer(_camera(), b"\xff" * 8), _camera(name="second")))
    whole = _list(_camera(), _camera(name="second"))
    broken: list[tuple[str, str, bytes]] = [
        ("nothing", "a section without bytes", b""),
        ("cut", "a section that ends within a camera", whole[:-9]),
        ("count", "a count that no section could hold", _list(_camera(), count=65535)),
        ("name-length", "a name that is longer than the section", whole[:60] + b"\xff\xff\xff\x7f" + whole[64:]),
        ("length-short", "a length that is shorter than the fields", whole[:4] + b"\x3c" + whole[5:]),
        ("length-odd", "a length that is no multiple of 4", _list(_longer(_camera(), b"\0\0"))),
        ("length-long", "a length that is longer than the section", whole[:4] + b"\xff\xff\xff\xff" + whole[8:]),
        ("behind", "bytes behind the last camera", whole + bytes(4)),
        ("reserved", "a reserved field that is not 0", _list(_camera(), reserved=1)),
        ("width", "a width of 0", _list(_camera(width=0))),
        ("focal", "a negative focal length", _list(_camera(focal=(-1.0, 1.0)))),
        ("principal-point", "a principal point that is infinite", _list(_camera(principal_point=(INFINITY, 0.0)))),
        ("rotation", "a quaternion of zeros", _list(_camera(rotation=(0.0, -0.0, 0.0, 0.0)))),
        ("translation", "a translation that is no number", _list(_camera(translation=(0.0, NAN, 0.0)))),
        ("name", "a name that is no text", _list(_camera(name=b"\xff"))),
        ("same-name", "one name twice", _list(_camera(), _camera())),
    ]
    for name, title, content in broken:
        assert parse_cameras(content)[1], name
        add(f"broken-{name}", title, content)
    add("broken-mode", "a mode that is not known", whole, mode=9)


# --- versions ---------------------------------------------------------------------------------------------------------


def _of_version(minor: int, content: bytes) -> Scene:
    return replace(drawn("later", 3, SMALLEST), minor=minor, later=content)


def _longest() -> Scene:
    """Returns the longest possible header."""
    taken = Target(codec.emit(_of_version(1, b""))).header_end - PROLOGUE_BYTES
    return _of_version(1, bytes(n % 251 for n in range(HEADER_LENGTH_MAX - taken)))


def _fields_cut() -> Refused:
    t = plain()
    return header.fields_cut_or_padded(t, header.fields_length(t) - 4, minor=1)


def _versions(book: Book) -> None:
    rows: list[tuple[str, str, Callable[[], Scene]]] = [
        ("1-no-fields", "minor version 1, with no more header fields", partial(_of_version, 1, b"")),
        (
            "1-four-bytes",
            "minor version 1, with four bytes of header fields more",
            partial(_of_version, 1, b"\xff" * 4),
        ),
        ("65535", "minor version 65535, with header fields of zeros", partial(_of_version, 65535, bytes(64))),
        ("longest-header", "minor version 1, with as many header fields as there can be", _longest),
    ]
    for name, title, make in rows:
        book.valid(
            f"minor-{name}",
            title,
            make,
            features="prologue header",
            requirements="R6.1-4 R6.2-3 D12.1-1",
            flags="minor-version header-slack",
        )
    faults: list[tuple[str, str, Callable[[], Refused], str]] = [
        (
            "malformed-minor-crc",
            "a byte of the fields of a later minor version is changed",
            header.header_byte.of(later, -5, 1),
            "checksum-unchecked",
        ),
        (
            "malformed-minor-fields-cut",
            "minor version 1, and fewer fields than version 0 has",
            _fields_cut,
            "truncation",
        ),
        (
            "malformed-minor-header-truncated",
            "the file ends within the fields of a later minor version",
            header.cut_in_header.of(later, -6),
            "truncation",
        ),
        (
            "unsupported-minor-critical",
            "a critical section that a later minor version may have",
            directory.unknown_section.of(later, 0, b"NEWS"),
            "critical-skipped",
        ),
        (
            "unsupported-minor-mode",
            "a mode that a later minor version may have",
            directory.mode.of(later, 1, 2),
            "mode-unchecked",
        ),
        (
            "unsupported-minor-profile",
            "a profile that a later minor version may have",
            limits.profile.of(later, "profile", 2),
            "profile-unchecked",
        ),
        (
            "unsupported-minor-level",
            "a level that a later minor version may have",
            limits.level.of(later, 1),
            "level-limits",
        ),
        (
            "unsupported-minor-reserved",
            "a reserved field to which a later minor version may give a meaning",
            header.reserved.of(later, "reserved", 1),
            "reserved-unchecked",
        ),
    ]
    for identifier, title, refused, flags in faults:
        book.add(identifier, title, refused, features="prologue header", flags=f"minor-version {flags}")
