"""The page as a whole: one HTML document that opens from a disk and makes no request."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...bitstream.cameras import CAMERAS, cameras
from ...bitstream.scene import Ancillary
from ...files.outputs import Kind
from ...pages.environment import render
from ..elements import Bytes, outline_of
from . import anchors, annotated, file_map, planes
from .lengths import LIMIT
from .measures import Measures
from .pictures import ramp

PAGE = Kind("a page that inspect wrote", re.compile(rb"<!(?i:doctype) html>\n<!-- refcodec inspect: a C3GS file -->"))


def page(data: Bytes, name: str, facts: Mapping[str, Any], measures: Measures) -> bytes:
    """Returns the page of an accepted file. The same arguments give the same bytes.

    Args:
        data: the file.
        name: the name of the file.
        facts: those of summary.document.
        measures: of the whole file, after `finish`.
    """
    outline = outline_of(data)
    seen = cameras(
        Ancillary(place.type, place.mode, data[place.start : place.end])
        for place in outline.sections
        if place.type == CAMERAS
    )
    return render(
        Path(__file__).with_name("page.html"),
        name=name,
        facts=facts,
        steps=[str(np.float32(float(step))) for step in facts["header"]["base_step"]],
        m=measures,
        limit=LIMIT,
        pieces=[piece for piece in file_map.pieces(data, outline) if piece.length],
        chunks_per_piece=file_map.chunks_per_piece(outline),
        bits=anchors.bits(measures, seen),
        masks=anchors.masks(measures, seen),
        planes=planes.planes(measures),
        elements=annotated.parts(data, outline),
        rows_max=annotated.ROWS_MAX,
        colours=ramp(),
        greys=ramp(grey=True),
    ).encode()
