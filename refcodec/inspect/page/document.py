"""The page as a whole: one document without a network, which opens from a disk."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...bitstream.cameras import CAMERAS, cameras
from ...bitstream.scene import Ancillary
from ...files.outputs import Kind
from ...resources import find
from ..elements import Bytes, outline_of
from . import anchors, annotated, file_map, masks, planes, sizes, symbols
from .markup import size, tag, text
from .measures import Measures

_MARK = "<!-- refcodec inspect: a C3GS file -->"
PAGE = Kind("a page that inspect wrote", re.compile(rb"<!DOCTYPE html>\n" + re.escape(_MARK.encode())))

# Metadata that is shown, and the most characters of a value.
_ENTRIES, _VALUE = 40, 300


def page(data: Bytes, name: str, facts: Mapping[str, Any], measures: Measures) -> bytes:
    """Returns the page of an accepted file. The same arguments give the same bytes.

    data: the file. name: that of the file. facts: those of summary.document. measures: `finish` was called.
    """
    outline = outline_of(data)
    seen = cameras(
        Ancillary(place.type, place.mode, data[place.start : place.end])
        for place in outline.sections
        if place.type == CAMERAS
    )
    style, script = (find(f"data/inspect.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    # No script but this one runs, whatever the file says, and nothing is fetched.
    known = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{known}'"
    body = "\n".join(
        (
            _head(facts, name),
            file_map.section(data, outline),
            sizes.section(facts),
            anchors.section(measures, facts, seen),
            symbols.section(measures),
            planes.section(measures),
            masks.section(measures, seen),
            annotated.section(data, outline),
        )
    )
    return (
        f"<!DOCTYPE html>\n{_MARK}\n"
        '<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{text(policy, None)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{text(name)}: what the file is made of</title>\n<style>\n{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n<script>{script}</script>\n</body>\n</html>\n"
    ).encode()


def _head(facts: Mapping[str, Any], name: str) -> str:
    """What the file is, in a few lines."""
    h, p = facts["header"], facts["prologue"]
    d = h["dimensions"]
    offsets = h["anchor_count"] * d["offset_count"]
    steps = (np.float32(float(step)) for step in h["base_step"])
    rows = {
        "file": f"{size(facts['bytes'])}, C3GS version {p['major']}.{p['minor']}, accepted",
        "profile": f"{facts['profile']}, level {h['level']}",
        "anchors": f"{h['anchor_count']:,}, in {h['chunk_count']:,} chunks of at most {h['chunk_size']:,}",
        "offsets": f"{facts.get('kept_offsets', 0):,} of {offsets:,} kept, each of which gives at most one Gaussian",
        "features": f"{sum(d['slice_width'])} channels in slices of {', '.join(map(str, d['slice_width']))}",
        "base steps": ", ".join(
            f"{kind} {step!s}{unit}"
            for kind, step, unit in zip(
                ("features", "scalings", "offsets"),
                steps,
                ("", " (of natural logarithms of world units)", " (in units of exp(scaling))"),
                strict=True,
            )
        ),
        "cameras": f"{len(facts['cameras']):,}",
        "digest": facts["digest"]["whole"],
    }
    listed = list(facts["metadata"].items())
    said = [*rows.items(), *listed[:_ENTRIES]]
    items = "".join(tag("dt", text(key, 60)) + tag("dd", text(value, _VALUE)) for key, value in said)
    left = len(listed) - _ENTRIES
    more = tag("p", f"{left:,} more entries of metadata are left out.", class_="soft") if left > 0 else ""
    links = (
        ("map", "to scale"),
        ("sizes", "sizes"),
        ("anchors", "bits per anchor"),
        ("symbols", "symbols"),
        ("planes", "planes"),
        ("masks", "masks"),
        ("bytes", "bytes"),
    )
    menu = tag("nav", *(f'<a href="#{place}">{words}</a>' for place, words in links))
    return tag("header", tag("h1", text(name, 120)), menu, tag("dl", items), more)
