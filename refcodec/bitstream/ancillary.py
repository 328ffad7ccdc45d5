"""Clause 12.1: the registry of the ancillary section types that this package understands.

An entry holds everything specific to a type: `inspect`, `validate`, `open`, the page and the fuzzer iterate over
TYPES. CONTRIBUTING.md describes how to add one.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from . import cameras, metadata
from .scene import Ancillary

# Returns printable text, of at most so many characters.
Printable = Callable[[str, int], str]


@dataclass(frozen=True)
class AncillaryType:
    """A type of ancillary section in mode 0: a struct with a `count`, then as many items.

    type: its four letters.
    name: what its sections hold, as a key of `inspect --json` and in warnings.
    clause: of SPEC.md chapter 6, which gives the meaning.
    head, items: the tables of struct and items in `syntax`. item: the name of an item in paths.
    tables: the clauses of both tables in chapter 5.
    cited: clauses besides `clause` that use a field, by the field's name.
    problems: returns the violations in the content of a section, as text.
    facts: returns the combined content of all sections of the type, as a JSON value.
    lines: returns the facts as labels and texts, for a summary.
    """

    type: bytes
    name: str
    clause: str
    head: str
    items: str
    item: str
    tables: Mapping[str, str]
    problems: Callable[[bytes], list[str]]
    facts: Callable[[Iterable[Ancillary]], Any]
    lines: Callable[[Any, Printable], Iterable[tuple[str, str]]]
    cited: Mapping[str, str] = field(default_factory=dict)


def _camera_facts(sections: Iterable[Ancillary]) -> list[dict[str, Any]]:
    listed = (vars(camera).items() for camera in cameras.cameras(sections))
    return [{key: [*value] if isinstance(value, tuple) else value for key, value in camera} for camera in listed]


def _camera_lines(facts: list[dict[str, Any]], printable: Printable) -> Iterator[tuple[str, str]]:
    for first in facts[:1]:
        more = f", and {len(facts) - 1} more" if len(facts) > 1 else ""
        yield "default view", f"{printable(first['name'], 60)}, {first['width']} x {first['height']} pixels{more}"


TYPES: dict[bytes, AncillaryType] = {
    entry.type: entry
    for entry in (
        AncillaryType(
            type=metadata.METADATA,
            name="metadata",
            clause="6.14",
            head="Metadata",
            items="Entry",
            item="entry",
            tables={"Metadata": "5.16", "Entry": "5.16.1"},
            problems=lambda content: metadata.parse_metadata(content)[1],
            facts=metadata.metadata,
            lines=lambda facts, printable: ((printable(key, 12), printable(facts[key], 200)) for key in facts),
        ),
        AncillaryType(
            type=cameras.CAMERAS,
            name="cameras",
            clause="6.15",
            head="Cameras",
            items="Camera",
            item="camera",
            tables={"Cameras": "5.17", "Camera": "5.17.1"},
            problems=lambda content: cameras.parse_cameras(content)[1],
            facts=_camera_facts,
            lines=_camera_lines,
            cited=dict.fromkeys(("width", "height", "focal", "principal_point", "rotation", "translation"), "14.2"),
        ),
    )
}


# SPEC 12.1
def is_safe_to_copy(kind: bytes) -> bool:
    """Whether a section of a type remains true after any change of the critical sections."""
    return bool(kind[3] & 0x20)


def warnings(sections: Iterable[Ancillary]) -> list[str]:
    """SPEC 6.14 and 6.15: returns the violations in sections of known types, as text."""
    listed = list(sections)
    return [
        f"{entry.name}: {problem}"
        for entry in TYPES.values()
        for section in listed
        if section.type == entry.type
        for problem in (["its mode is not known"] if section.mode else entry.problems(section.content))
    ]
