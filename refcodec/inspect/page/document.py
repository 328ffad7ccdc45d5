"""The page as a whole: one HTML document that opens from a disk and makes no request."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...files.outputs import Kind
from ...pages.environment import render
from ..elements import Bytes, outline_of
from . import anchors, file_map, pictures
from .measures import SceneMeasures

PAGE = Kind("a page that inspect wrote", re.compile(rb"<!(?i:doctype) html>\n<!-- refcodec inspect: a C3GS file -->"))


def page(
    data: Bytes, name: str, facts: Mapping[str, Any], measures: SceneMeasures, picture: bytes | None = None
) -> bytes:
    """Returns the page of an accepted file. The same arguments give the same bytes.

    Args:
        data: the file.
        name: the name of the file.
        facts: those of summary.document.
        measures: of the whole file, after `finish`.
        picture: of the scene, as PNG.
    """
    outline = outline_of(data)
    return render(
        Path(__file__).with_name("page.html"),
        name=name,
        facts=facts,
        steps=[str(np.float32(float(step))) for step in facts["header"]["base_step"]],
        m=measures,
        picture=picture,
        pieces=[piece for piece in file_map.pieces(data, outline) if piece.length],
        chunks_per_piece=file_map.chunks_per_piece(outline),
        bits=anchors.bits(measures),
        planes=pictures.planes(measures),
        elements=file_map.annotated(data, outline),
        rows_max=file_map.ROWS_MAX,
        colours=pictures.ramp(),
        greys=pictures.ramp(grey=True),
    ).encode()
