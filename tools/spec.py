"""Writes the generated parts of SPEC.md: the error registry, the profiles and levels, and the worked example.

python tools/spec.py            rewrite them
python tools/spec.py --check    exit 1 if SPEC.md is not what the code says
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import walk

from refcodec.bitstream.codec import parse
from refcodec.bitstream.errors import REGISTRY
from refcodec.bitstream.limits import PROFILES, Profile
from refcodec.bitstream.reconstruction import digest

ROOT = Path(__file__).resolve().parent.parent
SPEC = ROOT / "SPEC.md"
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"


def errors() -> str:
    rows = ["| code | name | class | clause | meaning | offset |", "|---|---|---|---|---|---|"]
    rows += [f"| {k.code} | {k.name} | {k.klass} | {k.clause} | {k.text} | {k.where} |" for k in REGISTRY.values()]
    return "\n".join(rows)


def _bounds(profile: Profile, field: str) -> str:
    low, high = getattr(profile, field)
    return str(low) if low == high else f"{low} to {high}"


def profiles() -> str:
    numbers = list(PROFILES)
    fields = [f for f in Profile.__dataclass_fields__ if f not in ("name", "levels")]
    head = "| dimension | " + " | ".join(f"{PROFILES[n].name} ({n})" for n in numbers) + " |"
    rows = [head, "|---" * (len(numbers) + 1) + "|"]
    rows += [f"| {f} | " + " | ".join(_bounds(PROFILES[n], f) for n in numbers) + " |" for f in fields]
    return "\n".join(rows)


def levels() -> str:
    rows = ["| profile | level | largest anchor_count | largest plane_size |", "|---|---|---|---|"]
    for profile in PROFILES.values():
        rows += [
            f"| {profile.name} | {n} | {level.anchors} | {level.plane_size} |" for n, level in profile.levels.items()
        ]
    return "\n".join(rows)


def digests() -> str:
    whole, parts = digest(parse(EXAMPLE.read_bytes()).scene)
    rows = [
        "| part | SHA-256 |",
        "|---|---|",
        f"| whole | `{whole}` |",
        *(f"| {name} | `{value}` |" for name, value in parts.items()),
    ]
    return "\n".join(rows)


def _escape(made: str) -> str:
    return made.replace("\\", r"\\")


def rewritten(text: str) -> str:
    """SPEC.md with each generated part replaced."""
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


def main() -> int:
    before = SPEC.read_text(encoding="utf-8")
    after = rewritten(before)
    if "--check" in sys.argv[1:]:
        return 0 if before == after else 1
    SPEC.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
