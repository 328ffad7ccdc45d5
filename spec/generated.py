"""Makes the generated parts of SPEC.md.

These are the hashes of artefacts, the registry of errors, profiles and levels, the digests of the tables, and the
worked examples. vectors/tiny-example.md has parts, too.
"""

import hashlib
import re
from collections.abc import Callable, Iterator

import numpy as np

from conformance.manifest import MANIFEST, VECTORS
from refcodec.bitstream.codec import parse
from refcodec.bitstream.errors import REGISTRY
from refcodec.bitstream.limits import PROFILES, Profile
from refcodec.bitstream.reconstruction import chunk_digest, digest
from refcodec.bitstream.scene import take_anchors

from . import example, tables, walk
from .made import ROOT, Made

SPEC = ROOT / "SPEC.md"
GUIDE = example.EXAMPLE.with_suffix(".md")
# The dimensions that are 0 in a scene without planes.
OPTIONAL = ("plane_size", "sarm_layers")


def artefacts() -> str:
    """Returns the list of the files published with SPEC.md (front matter)."""
    files = (
        (tables.TARGET, "the tables of Annex A"),
        (VECTORS / MANIFEST, "the list of the conformance suite, with the hashes of its files"),
        (example.EXAMPLE, "the worked example of Annex D"),
    )
    return "\n".join(
        f"- `{path.name}`, {what}. Its SHA-256 is\n  `{hashlib.sha256(path.read_bytes()).hexdigest()}`."
        for path, what in files
    )


def errors() -> str:
    """Returns the table of errors (clause 10.3)."""
    rows = ["| code | name | class | requirement | meaning | offset |", "|---" * 6 + "|"]
    rows += [
        f"| {k.code} | {k.name} | {k.klass} | [{k.requirement}] | {k.text} | {k.where} |" for k in REGISTRY.values()
    ]
    return "\n".join(rows)


def _bounds(profile: Profile, field: str) -> str:
    low, high = getattr(profile, field)
    bounds = str(low) if low == high else f"{low} to {high}"
    return f"0, or {bounds}" if field in OPTIONAL else bounds


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
    rows = ["| profile | level | largest anchor_count | largest plane_size | largest work |", "|---|---|---|---|---|"]
    for profile in PROFILES.values():
        for number, level in profile.levels.items():
            power = level.work.bit_length() - 1
            assert level.work == 1 << power
            rows.append(f"| {profile.name} | {number} | {level.anchors} | {level.plane_size} | 2^{power} |")
    return "\n".join(rows)


def table_digests() -> str:
    """Returns the table of the tables (Annex A)."""
    rows = ["| table | bytes | SHA-256 |", "|---|---|---|"]
    rows += [f"| {name} | {len(b)} | `{hashlib.sha256(b).hexdigest()}` |" for name, b in tables.tables().items()]
    return "\n".join(rows)


def digests() -> str:
    """Returns the table of the worked examples' digests (D.2)."""
    scene = parse(example.EXAMPLE.read_bytes()).scene
    whole, parts = digest(scene)
    rows = [
        "| of | SHA-256 |",
        "|---|---|",
        f"| the scene | `{whole}` |",
        *(f"| {name} | `{value}` |" for name, value in parts.items()),
    ]
    for number, anchors in enumerate(scene.chunks):
        rows.append(f"| chunk {number} | `{chunk_digest(take_anchors(scene, np.array(anchors)))}` |")
    rows.append(f"| {example.PACKED.name} | `{digest(parse(example.PACKED.read_bytes()).scene)[0]}` |")
    return "\n".join(rows)


def _escape(made: str) -> str:
    """Returns text as a replacement of a regular expression."""
    return made.replace("\\", r"\\")


def _rewritten(text: str, name: str, parts: dict[str, Callable[[], str]]) -> str:
    """Returns a file with its generated parts replaced. Raises SystemExit for a missing or repeated part."""
    for part, make in parts.items():
        pattern = re.compile(rf"(<!-- generated:{part} -->\n).*?(<!-- /generated -->)", re.DOTALL)
        text, count = pattern.subn(rf"\g<1>\n{_escape(make())}\n\n\g<2>", text)
        if count != 1:
            raise SystemExit(f"{name} has {count} parts 'generated:{part}'")
    return text


def rewritten(text: str) -> str:
    """Returns SPEC.md with its generated parts replaced. Raises SystemExit for a missing or repeated part."""
    packed = example.PACKED.read_bytes()
    parts: dict[str, Callable[[], str]] = {
        "artefacts": artefacts,
        "errors": errors,
        "profiles": profiles,
        "levels": levels,
        "tables": table_digests,
        "dump": lambda: walk.struct_table(example.EXAMPLE.read_bytes()),
        "digests": digests,
        "cells": lambda: walk.cell_steps(packed),
        "layer": lambda: walk.layer_steps(packed),
    }
    return _rewritten(text, SPEC.name, parts)


def guide(text: str, spec: str) -> str:
    """Returns vectors/tiny-example.md with its generated parts replaced. spec: SPEC.md."""
    data = example.EXAMPLE.read_bytes()
    parts: dict[str, Callable[[], str]] = {
        "elements": lambda: walk.element_table(data, spec),
        "steps": lambda: walk.plane_steps(data, 16),
        "anchor": lambda: walk.first_anchor(data),
        "raw": lambda: walk.raw_fields(data),
    }
    return _rewritten(text, GUIDE.name, parts)


def made() -> Iterator[Made]:
    """Yields SPEC.md, and the page that explains the first worked example."""
    spec = rewritten(SPEC.read_text(encoding="utf-8"))
    yield Made.text(SPEC, spec)
    yield Made.text(GUIDE, guide(GUIDE.read_text(encoding="utf-8"), spec))
