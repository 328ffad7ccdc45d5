"""Cases of clauses 5.3 and 6.3: each dimension at its limits. What a profile does not allow is in limits.py."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Scene

from .book import Book
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import LARGEST, SMALLEST, TINY_DIMENSIONS, packed_weights, scene, silent, sparse

# By dimension: values at its limits and between, the requirements that they test, and the bugs that they tell.
BOUNDS: dict[str, tuple[list[Any], str, str]] = {
    "offset_count": ([1, 10], "D7.6-1", "mask-context"),
    "plane_channels": ([1, 8], "D7.2-2", ""),
    "plane_size": ([2, 3, 32], "D7.3-1 D7.3-2 D7.5.4-1", "wavefront-order"),
    "render_width": ([1, 64], "D7.2-2", ""),
    "hyper_width": ([(64,), (5, 64)], "D7.2-2", ""),
    "sarm_width": ([(1,), (16, 1)], "D7.2-2", ""),
    "carm_width": ([(1,), (4, 64)], "D7.9-1", ""),
    "slices": ([(16,), (1, 1), (1, 16), (2, 1, 3), (3, 1, 2, 1)], "D7.9-1 D7.10-1", "carm-slices"),
}


def add(book: Book) -> None:
    """Adds the vectors."""
    book.valid(
        "smallest",
        "one anchor, and every dimension as small as it can be",
        partial(drawn, "smallest", 1, SMALLEST),
        features="dimensions",
        requirements="D7.10-1",
    )
    book.valid(
        "largest",
        "every dimension of Tiny as large as it can be",
        _largest,
        features="dimensions packed-weights",
        requirements="D7.2-2 D7.5-1",
        flags="buffer-too-small",
    )
    for name, (values, requirements, flags) in BOUNDS.items():
        for value in values:
            d = replace(TINY_DIMENSIONS, **{name: value})
            if len(d.slices) == 1:
                d = replace(d, carm_width=())
            text = "-".join(map(str, value)) if isinstance(value, tuple) else str(value)
            label = f"dimension-{name.replace('_', '-')}-{text}"
            book.valid(
                label,
                f"{name} {text}",
                partial(drawn, label, 5, d),
                features="dimensions",
                requirements=requirements,
                flags=flags,
            )


def _largest() -> Scene:
    made = sparse(scene("largest", 2, LARGEST, lanes=Lanes(3, 1, 6)))
    networks = {**made.networks, "sarm": silent(made.networks["sarm"])}
    flat = replace(made, networks=networks, planes=np.zeros_like(made.planes))
    return sampled(packed_weights(flat), Sampler(Numbers("largest/symbols")), planes=False)
