"""Compares lists of Gaussians (vectors/README.md) within the tolerance of SPEC 14.3."""

import math
import struct
from typing import Any

from refcodec.files.documents import parse_json
from refcodec.files.text import printable

# Below this opacity a Gaussian may be missing or added (SPEC [G14.3-1]).
FAINT = 1e-4
# SPEC [G14.3-1]: of means, relative to their lengths, beside the tolerance for their distance from the anchor.
ROUNDING = 2.0**-22
# SPEC [G14.3-1]: of colours, which may be 0 by cancelling, and of lengths below the normal numbers of binary32.
LEAST = {"colour": 2.0**-20, "lengths": 2.0**-126}
KINDS = {"mean": 3, "lengths": 3, "quaternion": 4, "opacity": 1, "colour": 3}


def _same(one: float, other: float) -> bool:
    """Whether two numbers are the same as binary32."""
    return struct.pack("<f", one) == struct.pack("<f", other)


def _by_place(text: bytes | str) -> dict[tuple[int, int], dict[str, list[float]]]:
    """Returns the Gaussians of a list by anchor and offset. Raises ValueError for another document."""
    try:
        places = {}
        for g in parse_json(text)["gaussians"]:
            # The distance of a mean from its anchor, which expected lists have.
            reach = float(g.get("reach", 0))
            values = {kind: [float(x) for x in (g[kind] if size > 1 else [g[kind]])] for kind, size in KINDS.items()}
            if any(len(values[kind]) != size for kind, size in KINDS.items()):
                raise ValueError("a vector of another length")
            place = (int(g["anchor"]), int(g["offset"]))
            if place in places:
                raise ValueError(f"anchor {place[0]}, offset {place[1]} twice")
            places[place] = {**values, "reach": [reach]}
    except (KeyError, TypeError) as error:
        raise ValueError(f"no list of Gaussians: {type(error).__name__} {printable(str(error), 80)}") from None
    return places


def difference(expected: bytes | str, output: bytes | str, tolerance: float, static: bool = False) -> str | None:
    """Returns the first difference in words, or None.

    expected, output: JSON. tolerance: relative to the length of the expected vector, or for a mean to its distance from
    the anchor; LEAST and ROUNDING are added. static: the means are of a static scene, and exact as binary32.
    """
    wanted = _by_place(expected)
    try:
        made: dict[tuple[int, int], dict[str, Any]] = _by_place(output)
    except ValueError as error:
        return str(error)
    for place in sorted(wanted.keys() | made.keys()):
        where = f"anchor {place[0]}, offset {place[1]}"
        if place not in wanted or place not in made:
            if (wanted.get(place) or made[place])["opacity"][0] >= FAINT:
                return f"{where}: " + ("missing" if place in wanted else "there is none")
            continue
        for kind in KINDS:
            right, value = wanted[place][kind], made[place][kind]
            allowed = tolerance * math.hypot(*right) + LEAST.get(kind, 0)
            if kind == "mean":
                allowed = tolerance * wanted[place]["reach"][0] + ROUNDING * math.hypot(*right)
                if static and not all(map(_same, right, value)):
                    return f"{where}: {kind} is {value}, {right} expected, the same numbers as binary32"
            # A quaternion and its negative are one rotation.
            signs = (1, -1) if kind == "quaternion" else (1,)
            # NaN is within no tolerance.
            if not any(all(abs(a - s * b) <= allowed for a, b in zip(right, value, strict=True)) for s in signs):
                return f"{where}: {kind} is {value}, {right} expected"
    return None
