"""Makes the generated parts of SPEC.md: the registry of errors, the profiles and levels, and the worked example."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from refcodec.bitstream.codec import parse
from refcodec.bitstream.errors import REGISTRY
from refcodec.bitstream.limits import PROFILES, Profile
from refcodec.bitstream.reconstruction import digest

from . import walk
from .made import ROOT, Made

SPEC = ROOT / "SPEC.md"
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"


def errors() -> str:
    """Returns the table of errors (clause 10.2)."""
    rows = ["| code | name | class | clause | meaning | offset |", "|---|---|---|---|---|---|"]
    rows += [f"| {k.code} | {k.name} | {k.klass} | {k.clause} | {k.text} | {k.where} |" for k in REGISTRY.values()]
    return "\n".join(rows)


def _bounds(profile: Profile, field: str) -> str:
    low, high = getattr(profile, field)
    return str(low) if low == high else f"{low} to {high}"


def profiles() -> str:
    """Returns the table of profiles (clause 11.1)."""
    numbers = list(PROFILES)
    fields = [f for f in Profile.__dataclass_fields__ if f not in ("name", "levels")]
    head = "| dimension | " + " | ".join(f"{PROFILES[n].name} ({n})" for n in numbers) + " |"
    rows = [head, "|---" * (len(numbers) + 1) + "|"]
    rows += [f"| {f} | " + " | ".join(_bounds(PROFILES[n], f) for n in numbers) + " |" for f in fields]
    return "\n".join(rows)


def levels() -> str:
    """Returns the table of levels (clause 11.2)."""
    rows = ["| profile | level | largest anchor_count | largest plane_size |", "|---|---|---|---|"]
    for profile in PROFILES.values():
        rows += [
            f"| {profile.name} | {n} | {level.anchors} | {level.plane_size} |" for n, level in profile.levels.items()
        ]
    return "\n".join(rows)


def digests() -> str:
    """Returns the table of the worked example's digests (D.6)."""
    whole, parts = digest(parse(EXAMPLE.read_bytes()).scene)
    rows = [
        "| part | SHA-256 |",
        "|---|---|",
        f"| whole | `{whole}` |",
        *(f"| {name} | `{value}` |" for name, value in parts.items()),
    ]
    return "\n".join(rows)


def _escape(made: str) -> str:
    """Returns text as a replacement of a regular expression."""
    return made.replace("\\", r"\\")


def rewritten(text: str) -> str:
    """Returns SPEC.md with each generated part made anew. Raises SystemExit if a part is missing, or there twice."""
    data = EXAMPLE.read_bytes()
    parts: dict[str, Callable[[], str]] = {
        "errors": errors,
        "profiles": profiles,
        "levels": levels,
        "dump": lambda: walk.hex_dump(data),
        "elements": lambda: walk.element_table(data, text),
        "steps": lambda: walk.plane_steps(data, text, 16),
        "anchor": lambda: walk.first_anchor(data, text),
        "raw": lambda: walk.raw_fields(data, text),
        "digests": digests,
    }
    for name, make in parts.items():
        pattern = re.compile(rf"(<!-- generated:{name} -->\n).*?(<!-- /generated -->)", re.DOTALL)
        text, count = pattern.subn(rf"\g<1>\n{_escape(make())}\n\n\g<2>", text)
        if count != 1:
            raise SystemExit(f"SPEC.md has {count} parts 'generated:{name}'")
    return text


def made() -> Iterator[Made]:
    """Yields SPEC.md."""
    yield Made.text(SPEC, rewritten(SPEC.read_text(encoding="utf-8")))
