"""Cases of clauses 5.16, 5.17, 6.14, 6.15, 12.1 and 12.3: bytes that a decoder skips.

These are ancillary sections with any content, and the header fields of later minor versions. A fault of metadata or
cameras is not an error of the file.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import replace

from refcodec.bitstream import codec, metadata
from refcodec.bitstream.cameras import CAMERAS, NamedCamera, build_camera, emit_cameras, parse_cameras
from refcodec.bitstream.header import HEADER_LENGTH_MAX, PROLOGUE_BYTES
from refcodec.bitstream.metadata import METADATA, emit_metadata, parse_metadata
from refcodec.bitstream.scene import Ancillary, Scene

from . import directory, header, limits
from .samplers import drawn
from .scenes import SMALLEST
from .table import More, Row, refused, valid
from .target import Target
from .targets import BEHIND, later

# --- sections ---------------------------------------------------------------------------------------------------------


def _with_ancillary(*sections: Ancillary) -> Scene:
    return replace(drawn("ancillary", 2, SMALLEST), ancillary=sections)


def _vendor(name: bytes, content: bytes = b"") -> bytes:
    """SPEC 12.1: returns the content of a private section."""
    return bytes([len(name)]) + name + content


def _contents(kind: bytes, before: str, title: str, *rows: Row, broken: Callable[[bytes], object]) -> list[Row]:
    """Returns rows of scenes with sections of a type.

    A row: name, title, the contents. broken: tells whether there is a fault in a content; a name tells whether there
    should be.
    """
    made = []
    for name, text, *contents in rows:
        assert all(bool(broken(content)) == name.startswith("broken") for content in contents), name
        sections = [Ancillary(kind, 0, content, 0) for content in contents]
        made.append((f"{before}-{name}", f"{title}: {text}", _with_ancillary, *sections))
    return made


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


def _list(*items: bytes, count: int | None = None, reserved: int = 0) -> bytes:
    """Returns a section of entries or of cameras."""
    return struct.pack("<HH", len(items) if count is None else count, reserved) + b"".join(items)


_A, _B = _entry(b"author", b"someone"), _entry(b"title", b"something")
_LONGEST = _list(*(_entry(f"k{n}".encode(), b"a" * length) for n, length in enumerate((16378,) * 3 + (16374,))))
assert len(_LONGEST) == metadata.SECTION_BYTES_MAX

# --- cameras ----------------------------------------------------------------------------------------------------------

NAN, INFINITY = math.nan, math.inf
_TINY = 2.0**-149


def _camera(**changes: object) -> bytes:
    """Returns a camera with changed fields, possibly invalid ones."""
    fields = {**vars(NamedCamera("first")), **changes}
    name = fields["name"]
    text = name if isinstance(name, bytes) else str(name).encode()
    return build_camera({**fields, "name": text})


def _longer(camera: bytes, more: bytes) -> bytes:
    """Returns a camera with fields of a later minor version."""
    return struct.pack("<I", len(camera) - 4 + len(more)) + camera[4:] + more


_GOOD = [
    NamedCamera("first"),
    NamedCamera("", 1, 1, (_TINY, _TINY), (-0.5, 9.0), (0.0, 0.0, 0.0, -_TINY), (-1.0, 0.0, 2.0)),
    NamedCamera("Küche", (1 << 32) - 1, (1 << 32) - 1, (3.0e38, 3.0e38), (0.0, -0.0), (-0.0, 2.0, -3.0, 0.5)),
]
_TWO = _list(_camera(), _camera(name="second"))

# --- versions ---------------------------------------------------------------------------------------------------------


def _of_version(minor: int, content: bytes) -> Scene:
    return replace(drawn("later", 3, SMALLEST), minor=minor, later=content)


def _longest() -> Scene:
    """Returns the longest possible header."""
    taken = Target(codec.emit(_of_version(1, b""))).header_end - PROLOGUE_BYTES
    return _of_version(1, bytes(n % 251 for n in range(HEADER_LENGTH_MAX - taken)))


# fmt: off
_LETTERS = [bytes(kind) for kind in ((0x61, 0x41, 0x41, 0x41), (0x61, 0x5A, 0x7A, 0x61), (0x7A, 0x5A, 0x5A, 0x7A))]
_CRITICAL = (b"fRAM", b"wGTS", b"pLNS", b"iNDX", b"dATA")
CASES = [
    *valid("ancillary directory", "ancillary-refused", "D12.1-1",
        ("ancillary-everywhere",
         "ancillary sections of all lengths of padding, before, among and behind the critical ones", _with_ancillary,
         *(Ancillary(b"noTE", 0, bytes([place]) * place, place) for place in range(BEHIND + 1)),
         More("", "R6.6-6 R6.6-7 R6.6-8")),
        ("ancillary-repeated", "three sections of one type, two of them the same", _with_ancillary,
         *(Ancillary(b"noTE", 0, text, BEHIND) for text in (b"one", b"one", b"two")), More("", "R6.6-3")),
        ("ancillary-modes", "ancillary sections of modes that mean nothing", _with_ancillary,
         *(Ancillary(b"noTE", mode, b"?", 0) for mode in (1, 2, 255)), More("", "R6.6-4")),
        ("ancillary-letters", "types at the ends of the alphabet", _with_ancillary,
         *(Ancillary(kind, 0, b"", 2) for kind in _LETTERS), More("", "R6.6-1 R6.6-2")),
        ("ancillary-lookalikes", "types that are those of critical sections but for the case of their first letter",
         _with_ancillary, *(Ancillary(kind, 0, b"!", 3) for kind in _CRITICAL), More("", "R6.6-2 R6.6-3")),
        ("ancillary-private", "private sections of two vendors, with content and without", _with_ancillary,
         Ancillary(b"xyZZ", 0, _vendor(b"org.example.tools", b"\0\1\2"), 0),
         Ancillary(b"xyZZ", 7, _vendor(b"com.example"), BEHIND), More("", "R6.6-2")),
        ("ancillary-private-broken",
         "private sections whose vendor is longer than they are, is no ASCII, or is missing", _with_ancillary,
         *(Ancillary(b"xyZZ", 0, content, 1) for content in (b"\xffshort", _vendor(b"\x80\xff"), b"")),
         More("", "R6.6-2"))),
    *valid("ancillary directory", "ancillary-refused ancillary-contents", "D12.1-1",
        *_contents(METADATA, "ancillary-metadata", "metadata",
            ("standard", "all keys that have a meaning, and one of a vendor", emit_metadata(STANDARD)),
            ("empty", "no entries", emit_metadata({})),
            ("twice", "two sections with one key in both", emit_metadata({"title": "1"}),
             emit_metadata({"title": "2"})),
            ("longest", "as many bytes as a section may have", _LONGEST),
            ("broken-too-long", "four bytes more than a section may have", _LONGEST + bytes(4)),
            ("broken-nothing", "a section without bytes", b""),
            ("broken-cut", "a section that ends within an entry", _list(_A, _B)[:-7]),
            ("broken-count", "a count that no section could hold", _list(_A, _B, count=65535)),
            ("broken-behind", "bytes behind the last entry", _list(_A, _B) + b"more"),
            ("broken-reserved", "a reserved field that is not 0", _list(_A, _B, reserved=1)),
            ("broken-falling", "keys that fall", _list(_B, _A)),
            ("broken-same", "a key twice", _list(_A, _A)),
            ("broken-key", "a key of other characters", _list(_entry(b"The Author", b"someone"))),
            ("broken-no-key", "a key without characters", _list(_entry(b"", b"someone"))),
            ("broken-key-bytes", "a key that is no text", _list(_entry(b"\xff\xfe", b"someone"))),
            ("broken-value-bytes", "a value that is no text", _list(_entry(b"title", b"\xc3(\xed\xa0\x80"))),
            ("broken-padding", "padding that is not zero", _list(_entry(b"title", b"x", b"\1\1"))),
            ("broken-date", "a date that is none", _list(_entry(b"date", b"yesterday"))),
            ("broken-unit", "a unit that is no number", _list(_entry(b"unit", b"nan"))),
            ("broken-georeference", "a matrix of fifteen numbers", _list(_entry(b"georeference", b"1 " * 15))),
            broken=lambda content: parse_metadata(content)[1]),
        ("ancillary-metadata-broken-mode", "metadata: a mode that is not known", _with_ancillary,
         Ancillary(METADATA, 1, _list(_A, _B))),
        *_contents(CAMERAS, "ancillary-cameras", "named cameras",
            ("three", "three, of which one has no name and one is as large as can be", emit_cameras(_GOOD)),
            ("none", "none", emit_cameras([])),
            ("twice", "two sections", emit_cameras(_GOOD[:1]), emit_cameras(_GOOD[1:])),
            ("later", "fields of a later minor version",
             _list(_longer(_camera(), b"\xff" * 8), _camera(name="second"))),
            ("broken-nothing", "a section without bytes", b""),
            ("broken-cut", "a section that ends within a camera", _TWO[:-9]),
            ("broken-count", "a count that no section could hold", _list(_camera(), count=65535)),
            ("broken-name-length", "a name that is longer than the section",
             _TWO[:60] + b"\xff\xff\xff\x7f" + _TWO[64:]),
            ("broken-length-short", "a length that is shorter than the fields", _TWO[:4] + b"\x3c" + _TWO[5:]),
            ("broken-length-odd", "a length that is no multiple of 4", _list(_longer(_camera(), b"\0\0"))),
            ("broken-length-long", "a length that is longer than the section",
             _TWO[:4] + b"\xff\xff\xff\xff" + _TWO[8:]),
            ("broken-behind", "bytes behind the last camera", _TWO + bytes(4)),
            ("broken-reserved", "a reserved field that is not 0", _list(_camera(), reserved=1)),
            ("broken-width", "a width of 0", _list(_camera(width=0))),
            ("broken-focal", "a negative focal length", _list(_camera(focal=(-1.0, 1.0)))),
            ("broken-principal-point", "a principal point that is infinite",
             _list(_camera(principal_point=(INFINITY, 0.0)))),
            ("broken-rotation", "a quaternion of zeros", _list(_camera(rotation=(0.0, -0.0, 0.0, 0.0)))),
            ("broken-translation", "a translation that is no number", _list(_camera(translation=(0.0, NAN, 0.0)))),
            ("broken-name", "a name that is no text", _list(_camera(name=b"\xff"))),
            ("broken-same-name", "one name twice", _list(_camera(), _camera())),
            broken=lambda content: parse_cameras(content)[1]),
        ("ancillary-cameras-broken-mode", "named cameras: a mode that is not known", _with_ancillary,
         Ancillary(CAMERAS, 9, _TWO))),
    *valid("prologue header", "minor-version header-slack", "R6.1-4 R6.2-3 D12.1-1",
        ("minor-1-no-fields", "minor version 1, with no more header fields", _of_version, 1, b""),
        ("minor-1-four-bytes", "minor version 1, with four bytes of header fields more", _of_version, 1, b"\xff" * 4),
        ("minor-65535", "minor version 65535, with header fields of zeros", _of_version, 65535, bytes(64)),
        ("minor-longest-header", "minor version 1, with as many header fields as there can be", _longest)),
    *refused("prologue header", "minor-version",
        ("minor-crc", "a byte of the fields of a later minor version is changed", later, header.header_byte, -5, 1,
         More("checksum-unchecked")),
        ("minor-fields-cut", "minor version 1, and fewer fields than version 0 has", header.fields_cut_or_padded,
         lambda t: header.fields_length(t) - 4, False, 1, More("truncation")),
        ("minor-header-truncated", "the file ends within the fields of a later minor version", later,
         header.cut_in_header, lambda t: t.header_end - 6, More("truncation")),
        ("minor-critical", "a critical section that a later minor version may have", later, directory.unknown_section,
         0, b"NEWS", More("critical-skipped")),
        ("minor-mode", "a mode that a later minor version may have", later, directory.mode, 1, 2,
         More("mode-unchecked")),
        ("minor-profile", "a profile that a later minor version may have", later, limits.profile, 2,
         More("profile-unchecked")),
        ("minor-level", "a level that a later minor version may have", later, limits.level, 10, More("level-limits")),
        ("minor-reserved", "a reserved field to which a later minor version may give a meaning", later, header.reserved,
         "reserved", 1, More("reserved-unchecked"))),
]
