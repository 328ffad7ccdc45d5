"""Clauses 5.16 and 6.14: the metadata, an ancillary section of keys and texts.

A violation in such a section is a warning and never refuses a file.
"""

import re
from collections.abc import Iterable, Mapping

import construct as cs

from . import syntax
from .scene import Ancillary

# SPEC 6.14
METADATA = b"mETa"
SECTION_BYTES_MAX = 1 << 16
KEY = re.compile(r"[a-z0-9._-]+")
# The syntax of some standard values. Numbers are decimal.
_NUMBER = r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"
_VALUES = {
    "date": re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII),
    "unit": re.compile(rf"(?!-)(?=[^eE]*[1-9]){_NUMBER}", re.ASCII),
    "georeference": re.compile(rf"\s*{_NUMBER}(\s+{_NUMBER}){{15}}\s*", re.ASCII),
}

_ALLOWED = {
    "date": "a date and time of RFC 3339",
    "unit": "a decimal number above 0",
    "georeference": "16 decimal numbers",
}


def parse_metadata(content: bytes) -> tuple[dict[str, str], list[str]]:
    """SPEC 5.16 and 6.14: returns the entries before the first syntax error, and the violations as text."""
    entries: dict[str, str] = {}
    if len(content) > SECTION_BYTES_MAX:
        return entries, [f"it has {len(content)} bytes, at most {SECTION_BYTES_MAX} are allowed"]
    problems = []
    try:
        head, at = syntax.parse("Metadata", content)
        if head.reserved:
            problems.append("its reserved field is not 0")
        last = b""
        for number in range(head.count):
            entry, size = syntax.parse("Entry", content, at)
            at += size
            if any(entry.padding):
                problems.append(f"the padding of entry {number} is not zero")
            key, value = entry.key.decode("ascii"), entry.value.decode()
            if not KEY.fullmatch(key):
                problems.append(f"the key of entry {number} has other characters than a-z, 0-9, '.', '_' and '-'")
            elif number and entry.key <= last:
                problems.append(f"the key {key} does not come after the one before it")
            else:
                entries[key] = value
                form = _VALUES.get(key)
                if form and not form.fullmatch(value):
                    problems.append(f"the value of {key} is {value!r:.60}, {_ALLOWED[key]} is required")
            last = entry.key
    except cs.ConstructError:
        problems.append("it ends within an entry")
    except UnicodeDecodeError:
        problems.append(f"entry {number} is not text")
    else:
        if at != len(content):
            problems.append(f"{len(content) - at} bytes follow the last entry")
    return entries, problems


def emit_metadata(entries: Mapping[str, str]) -> bytes:
    """SPEC 5.16: returns the bytes of a section. Raises ValueError for entries that violate SPEC 6.14."""
    parts = [syntax.build("Metadata", {"count": len(entries), "reserved": 0})]
    for key, value in sorted(entries.items()):
        texts = {"key": key.encode(), "value": value.encode()}
        if max(map(len, texts.values())) > 0xFFFF:
            raise ValueError(f"the key or value of {key[:60]} is too long: at most 65535 bytes each are allowed")
        parts.append(
            syntax.build("Entry", {"key_length": len(texts["key"]), "value_length": len(texts["value"]), **texts})
        )
    content = b"".join(parts)
    problems = parse_metadata(content)[1]
    if problems:
        raise ValueError(f"the metadata cannot be written: {problems[0]} (SPEC.md 6.14)")
    return content


def metadata(sections: Iterable[Ancillary]) -> dict[str, str]:
    """Returns the entries of all metadata sections. If several have the same key, the first one counts."""
    entries: dict[str, str] = {}
    for section in sections:
        if section.type == METADATA and not section.mode:
            entries = {**parse_metadata(section.content)[0], **entries}
    return entries


def with_metadata(sections: tuple[Ancillary, ...], changes: Mapping[str, str]) -> tuple[Ancillary, ...]:
    """Returns the ancillary sections with changed entries, in one metadata section.

    An empty value removes an entry. The section takes the place of the first one, or comes before all others. Raises
    ValueError as emit_metadata.
    """
    entries = {key: value for key, value in {**metadata(sections), **changes}.items() if value}
    mine = [section for section in sections if section.type == METADATA and not section.mode]
    made = Ancillary(METADATA, 0, emit_metadata(entries), mine[0].after if mine else 0)
    rest = [section for section in sections if section not in mine]
    first = sections.index(mine[0]) if mine else 0
    return (*rest[:first], made, *rest[first:]) if entries else tuple(rest)
