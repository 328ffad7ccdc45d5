"""Cases of clauses 5.3 and 6.3: each dimension at its limits. Dimensions beyond a profile are in limits.py."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Scene

from .book import Book
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import (
    CONSTANT,
    LARGEST,
    PLANELESS,
    SMALLEST,
    TINY_DIMENSIONS,
    UNENCODED,
    packed_weights,
    scene,
    silent,
    sparse,
)

# By dimension: values at its limits and between, the tested requirements, and the bugs that they reveal.
Bounds = dict[str, tuple[list[Any], str, str]]
OF_TINY: Bounds = {
    "offset_count": ([1, 10], "D7.6-1", "mask-context"),
    "plane_channels": ([1, 8], "D7.2-2", ""),
    "frequency_count": ([1, 10], "D7.5.5-1", ""),
    "plane_size": ([2, 3, 32], "D7.3-1 D7.3-2 D7.5.4-1", "wavefront-order"),
    "render_width": ([1, 64], "D7.2-2", ""),
    "hyper_width": ([(), (64,), (5, 64)], "D7.2-2", "hidden-layers"),
    "sarm_width": ([(1,), (16, 1)], "D7.2-2", ""),
    "carm_width": ([(), (1,), (4, 64)], "D7.9-1", "hidden-layers"),
    "slices": ([(16,), (1, 1), (1, 16), (2, 1, 3), (3, 1, 2, 1)], "D7.9-1 D7.10-1", "carm-slices"),
}
OF_MAIN: Bounds = {
    "offset_count": ([1, 16], "D7.6-1", "mask-context main-bounds"),
    "plane_channels": ([1, 16], "D7.2-2", "main-bounds"),
    "frequency_count": ([1, 16], "D7.5.5-1", "main-bounds"),
    "plane_size": ([2, 33], "D7.3-1 D7.3-2 D7.5.4-1", "main-bounds"),
    "render_width": ([1, 128], "D7.2-2", "main-bounds"),
    "hyper_width": ([(), (1,), (128,), (3, 128)], "D7.2-2", "hidden-layers main-bounds"),
    "sarm_width": ([(1,), (32, 1), (3, 32)], "D7.2-2", "main-bounds"),
    "carm_width": ([(), (1,), (128,), (2, 128)], "D7.9-1", "hidden-layers main-bounds"),
    "slices": (
        [(1,), (64,), (64, 64), (1,) * 16, (1, 64, 63), (64, 63, 1), (8,) * 16],
        "D7.9-1 D7.10-1",
        "carm-slices main-bounds",
    ),
}
SMALLEST_OF_MAIN = Dimensions(1, (1,), 0, 0, 0, (), (), (), 1)
LARGEST_OF_MAIN = Dimensions(16, (64, 64), 16, 16, 3, (128, 128), (32, 32), (128, 128), 128)
# Those of Scaffold-GS: 32 features in one slice, 10 offsets, layers of 32.
SCAFFOLD = Dimensions(10, (32,), 8, 10, 4, (32,), (16, 16), (), 32)


def add(book: Book) -> None:
    """Adds the vectors."""
    _whole(book)
    for bounds, before, features, fields in (
        (OF_TINY, "", "dimensions", {}),
        (OF_MAIN, "main-", "main dimensions", {"profile": MAIN}),
    ):
        for name, (values, requirements, flags) in bounds.items():
            for value in values:
                d = replace(TINY_DIMENSIONS, **{name: value})
                if len(d.slices) == 1:
                    d = replace(d, carm_width=())
                text = "-".join(map(str, value)) or "none" if isinstance(value, tuple) else str(value)
                label = f"dimension-{before}{name.replace('_', '-')}-{text}"
                book.valid(
                    label,
                    f"{name} {text}{' in Main' if fields else ''}",
                    partial(drawn, label, 5, d, **fields),
                    features=features,
                    requirements=f"R11.1-2 {requirements}",
                    flags=flags,
                )


def _whole(book: Book) -> None:
    """Adds scenes with unusual values of all dimensions, and scenes without parts."""
    book.valid(
        "smallest",
        "one anchor, and every dimension as small as it can be with planes",
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
    parts: list[tuple[str, str, Dimensions, dict[str, Any]]] = [
        ("planeless", "no planes", PLANELESS, {}),
        ("unencoded", "no positional encoding", UNENCODED, {}),
        ("one-frequency", "no planes, and one frequency", replace(PLANELESS, frequency_count=1), {}),
        ("constant", "no hyperprior: neither planes nor an encoding, and F_h has its biases alone", CONSTANT, {}),
        ("main-smallest", "every dimension of Main as small as it can be", SMALLEST_OF_MAIN, {"profile": MAIN}),
        (
            "main-constant",
            "no hyperprior in Main",
            replace(CONSTANT, offset_count=10, slices=(32,), carm_width=(), render_width=32),
            {"profile": MAIN},
        ),
    ]
    for name, title, d, fields in parts:
        book.valid(
            name,
            title,
            partial(drawn, name, 7, d, **fields),
            features="dimensions main" if fields else "dimensions",
            requirements="R6.6-3 R11.1-2 D7.7-1 D7.10-1",
            flags="optional-parts",
        )
    for name, title, d in (
        ("planeless-packed", "no planes, in mode 1", PLANELESS),
        ("constant-packed", "no hyperprior, in mode 1: a layer without inputs", CONSTANT),
    ):
        book.valid(
            name,
            title,
            partial(_packed, name, d),
            features="dimensions packed-weights",
            requirements="R6.6-3 R11.1-2 D7.13-1",
            flags="optional-parts",
        )
    book.valid(
        "main-scaffold",
        "the default dimensions of Scaffold-GS: one slice, no CARM",
        lambda: sampled(sparse(scene("main-scaffold", 7, SCAFFOLD, profile=MAIN)), Sampler(Numbers("main-scaffold"))),
        features="main dimensions packed-weights",
        requirements="R11.1-2 D7.7-1 D7.10-1",
        flags="optional-parts",
    )
    book.valid(
        "main-largest",
        "every dimension of Main but plane_size as large as it can be",
        _largest_of_main,
        features="main dimensions packed-weights",
        requirements="R11.1-2 D7.2-2 D7.5-1",
        flags="buffer-too-small main-bounds",
        seconds=60,
    )


def _packed(name: str, d: Dimensions) -> Scene:
    return packed_weights(drawn(name, 4, d))


def _largest() -> Scene:
    return _quiet("largest", LARGEST, lanes=Lanes(3, 1, 6))


def _largest_of_main() -> Scene:
    made = _quiet("main-largest", LARGEST_OF_MAIN, one_in=128, lanes=Lanes(2, 1, 6), profile=MAIN)
    assert made.weight_scales is not None
    # A weight of 0 takes almost no bits. The others are escaped.
    return replace(made, weight_scales=made.weight_scales * np.array([1, 0, 1], np.uint8))


def _quiet(name: str, d: Dimensions, one_in: int = 16, **fields: Any) -> Scene:
    """Returns a scene of two anchors with large networks in few bytes, and zero planes. one_in: as of sparse."""
    made = sparse(scene(name, 2, d, **fields), one_in)
    networks = {**made.networks, "sarm": silent(made.networks["sarm"])}
    flat = replace(made, networks=networks, planes=np.zeros_like(made.planes))
    return sampled(packed_weights(flat), Sampler(Numbers(f"{name}/symbols")), planes=False)
