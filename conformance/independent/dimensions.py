"""Clauses 5.3, 5.8 and 6.3: the dimensions, and the networks that follow from them."""

from typing import NamedTuple

from .syntax import Fields


class Dimensions(Fields):
    """A header's fields, with what follows from its dimensions."""

    # SPEC 6.3
    @property
    def features(self) -> int:
        """F of 6.3."""
        return sum(self["slice_width"])

    # SPEC 6.3
    @property
    def channels(self) -> int:
        """D of 6.3."""
        return self.features + 6 + 3 * self["offset_count"]

    # SPEC 5.8
    @property
    def carm_inputs(self) -> int:
        """F less the width of the last slice (5.8)."""
        return self.features - self["slice_width"][-1]


class Shape(NamedTuple):
    """A network as 5.8 lists it: its widths from inputs to outputs."""

    name: str
    widths: list[int]
    integer: bool


# SPEC 5.8
def shapes(header: Dimensions) -> list[Shape]:
    """The networks in file order."""
    k, f, d = header["offset_count"], header.features, header.channels
    slices = header["slice_width"]
    context = 2 * header["plane_channels"] + 2 * header["frequency_count"]
    out = [
        Shape("hyper", [context, *header["hyper_width"], 2 * d + 3], True),
        Shape("sarm", [4, *header["sarm_width"], 2], True),
    ]
    out += [
        Shape(f"carm.{i}", [sum(slices[:i]), *header["carm_width"], 2 * slices[i]], True) for i in range(1, len(slices))
    ]
    rendering = (("opacity", k), ("covariance", 7 * k), ("colour", 3 * k))
    return out + [Shape(name, [f + 4, header["render_width"], outputs], False) for name, outputs in rendering]


# SPEC 5.8, [R6.6-5]
def weight_count(header: Dimensions) -> int:
    """W, the number of values."""
    return sum((a + 1) * b for shape in shapes(header) for a, b in zip(shape.widths, shape.widths[1:]))
