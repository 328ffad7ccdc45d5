"""Photographs within the page: some of the held-out ones, with their cameras."""

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

from ..photographs.photographs import Photograph, PhotographSet

# Their maximum number, and their JPEG quality.
MOST = 8
_QUALITY = 88


def embedded(photographs: PhotographSet) -> list[dict[str, Any]]:
    """Returns photographs for `page.page`, those held out for tests if there are any. Raises PhotographError."""
    return [_document(photograph) for photograph in _spread(photographs.test or photographs.train)]


def _spread(photographs: Sequence[Photograph]) -> list[Photograph]:
    """Returns at most MOST photographs, evenly chosen."""
    chosen = np.linspace(0, len(photographs) - 1, min(len(photographs), MOST)).round().astype(int)
    return [photographs[number] for number in chosen]


def _document(photograph: Photograph) -> dict[str, Any]:
    camera = photograph.camera
    data = io.BytesIO()
    Image.fromarray(photograph.image).save(data, "JPEG", quality=_QUALITY)
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "focal": [camera.fx, camera.fy],
        "principal_point": [camera.cx, camera.cy],
        "rotation": camera.rotation.ravel().tolist(),
        "translation": camera.translation.tolist(),
        "image": f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}",
    }
