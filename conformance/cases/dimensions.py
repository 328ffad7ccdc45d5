"""Cases of clauses 5.3 and 6.3: each dimension at its limits. Dimensions beyond a profile are in limits.py."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.limits import MAIN
from refcodec.bitstream.scene import Scene

from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import CONSTANT, LARGEST, PLANELESS, SMALLEST, TINY_DIMENSIONS, UNENCODED, scene
from .table import More, Recipe, label_of, valid
from .weights import QUIET_SARM, packed_weights, sparse, with_weights

SMALLEST_OF_MAIN = Dimensions(1, (1,), 0, 0, 0, (), (), (), 1)
LARGEST_OF_MAIN = Dimensions(16, (64, 64), 16, 16, 3, (128, 128), (32, 32), (128, 128), 128)
# Those of Scaffold-GS: 32 features in one slice, 10 offsets, layers of 32.
SCAFFOLD = Dimensions(10, (32,), 8, 10, 4, (32,), (16, 16), (), 32)


def _at(label: str, name: str, value: Any, **fields: Any) -> Scene:
    """Returns a scene of the usual dimensions but for one."""
    d = replace(TINY_DIMENSIONS, **{name: value})
    return drawn(label, 5, replace(d, carm_width=()) if len(d.slices) == 1 else d, **fields)


def _packed(name: str, d: Dimensions) -> Scene:
    return packed_weights(drawn(name, 4, d))


def _quiet(name: str, d: Dimensions, one_in: int = 16, **fields: Any) -> Scene:
    """Returns a scene of two anchors with large networks in few bytes, and zero planes. one_in: as of sparse."""
    made = with_weights(sparse(scene(name, 2, d, **fields), one_in), QUIET_SARM[0])
    flat = packed_weights(replace(made, planes=np.zeros_like(made.planes)))
    return sampled(flat, Sampler(Numbers(f"{name}/symbols")), planes=False)


def _largest_of_main() -> Scene:
    made = _quiet("main-largest", LARGEST_OF_MAIN, one_in=128, lanes=Lanes(2, 1, 6), profile=MAIN)
    assert made.weight_scales is not None
    # A weight of 0 takes almost no bits. The others are escaped.
    return replace(made, weight_scales=made.weight_scales * np.array([1, 0, 1], np.uint8))


def _each(
    bounds: list[tuple[str, list[Any], str, str]],
    features: str,
    more: str = "",
    before: str = "",
    behind: str = "",
    **fields: Any,
) -> list[Recipe]:
    """Returns a file for each value of each dimension.

    more: flags. before: of identifiers. behind: of titles. fields: as of scene.
    """
    made = []
    for name, values, requirements, flags in bounds:
        for value in values:
            text = "-".join(map(str, value)) or "none" if isinstance(value, tuple) else str(value)
            label = f"dimension-{before}{label_of(name)}-{text}"
            row = label, f"{name} {text}{behind}", partial(_at, label, name, value, **fields)
            made += valid(features, flags + more, f"R11.1-2 {requirements}", row)
    return made


# fmt: off
# Each dimension: values at its limits and between, the tested requirements, and the bugs that they reveal.
_OF_TINY: list[tuple[str, list[Any], str, str]] = [
    ("offset_count", [1, 10], "D7.6-1", "mask-context"),
    ("plane_channels", [1, 8], "D7.2-2", ""),
    ("frequency_count", [1, 10], "D7.5.5-1", ""),
    ("plane_size", [2, 3, 32], "D7.3-1 D7.3-2 D7.5.4-1", "wavefront-order"),
    ("render_width", [1, 64], "D7.2-2", ""),
    ("hyper_width", [(), (64,), (5, 64)], "D7.2-2", "hidden-layers"),
    ("sarm_width", [(1,), (16, 1)], "D7.2-2", ""),
    ("carm_width", [(), (1,), (4, 64)], "D7.9-1", "hidden-layers"),
    ("slices", [(16,), (1, 1), (1, 16), (2, 1, 3), (3, 1, 2, 1)], "D7.9-1 D7.10-1", "carm-slices"),
]
_OF_MAIN: list[tuple[str, list[Any], str, str]] = [
    ("offset_count", [1, 16], "D7.6-1", "mask-context"),
    ("plane_channels", [1, 16], "D7.2-2", ""),
    ("frequency_count", [1, 16], "D7.5.5-1", ""),
    ("plane_size", [2, 33], "D7.3-1 D7.3-2 D7.5.4-1", ""),
    ("render_width", [1, 128], "D7.2-2", ""),
    ("hyper_width", [(), (1,), (128,), (3, 128)], "D7.2-2", "hidden-layers"),
    ("sarm_width", [(1,), (32, 1), (3, 32)], "D7.2-2", ""),
    ("carm_width", [(), (1,), (128,), (2, 128)], "D7.9-1", "hidden-layers"),
    ("slices", [(1,), (64,), (64, 64), (1,) * 16, (1, 64, 63), (64, 63, 1), (8,) * 16], "D7.9-1 D7.10-1",
     "carm-slices"),
]

CASES = [
    *_each(_OF_TINY, "dimensions"),
    *_each(_OF_MAIN, "main dimensions", " main-bounds", "main-", " in Main", profile=MAIN),
    *valid("dimensions", "", "D7.10-1",
        ("smallest", "one anchor, and every dimension as small as it can be with planes", drawn, "smallest", 1,
         SMALLEST)),
    *valid("dimensions packed-weights", "buffer-too-small", "D7.2-2 D7.5-1",
        ("largest", "every dimension of Tiny as large as it can be",
         partial(_quiet, "largest", LARGEST, lanes=Lanes(3, 1, 6)))),
    *valid("dimensions", "optional-parts", "R6.6-3 R11.1-2 D7.7-1 D7.10-1", *(
        (name, title, drawn, name, 7, d) for name, title, d in (
            ("planeless", "no planes", PLANELESS),
            ("unencoded", "no positional encoding", UNENCODED),
            ("one-frequency", "no planes, and one frequency", replace(PLANELESS, frequency_count=1)),
            ("constant", "no hyperprior: neither planes nor an encoding, and F_h has its biases alone", CONSTANT)))),
    *valid("dimensions main", "optional-parts", "R6.6-3 R11.1-2 D7.7-1 D7.10-1", *(
        (name, title, partial(drawn, name, 7, d, profile=MAIN)) for name, title, d in (
            ("main-smallest", "every dimension of Main as small as it can be", SMALLEST_OF_MAIN),
            ("main-constant", "no hyperprior in Main",
             replace(CONSTANT, offset_count=10, slices=(32,), carm_width=(), render_width=32))))),
    *valid("dimensions packed-weights", "optional-parts", "R6.6-3 R11.1-2 D7.13-1",
        ("planeless-packed", "no planes, in mode 1", _packed, "planeless-packed", PLANELESS),
        ("constant-packed", "no hyperprior, in mode 1: a layer without inputs", _packed, "constant-packed", CONSTANT)),
    *valid("main dimensions packed-weights", "optional-parts", "R11.1-2 D7.7-1 D7.10-1",
        ("main-scaffold", "the default dimensions of Scaffold-GS: one slice, no CARM",
         lambda: sampled(sparse(scene("main-scaffold", 7, SCAFFOLD, profile=MAIN)),
                         Sampler(Numbers("main-scaffold"))))),
    *valid("main dimensions packed-weights", "buffer-too-small main-bounds", "R11.1-2 D7.2-2 D7.5-1",
        ("main-largest", "every dimension of Main but plane_size as large as it can be", _largest_of_main,
         More(seconds=60))),
]
