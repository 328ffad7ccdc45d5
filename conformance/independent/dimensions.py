"""Clauses 5.3, 5.8 and 6.3: the dimensions, and the networks and the work that follow from them."""

from itertools import pairwise
from typing import NamedTuple

from .syntax import Fields


class Dimensions(Fields):
    """The fields of a header, and what follows from its dimensions."""

    # SPEC 6.3
    @property
    def features(self) -> int:
        """F, the number of feature channels of an anchor."""
        return sum(self["slice_width"])

    # SPEC 6.3
    @property
    def channels(self) -> int:
        """D, the number of attribute channels of an anchor."""
        return self.features + 6 + 3 * self["offset_count"]

    # SPEC 5.8
    @property
    def carm_inputs(self) -> int:
        """The number of inputs of CARM: F less the width of the last slice."""
        return self.features - self["slice_width"][-1]

    # SPEC 5.7, [R6.6-3]
    @property
    def framed(self) -> bool:
        """Whether F_h has inputs. A file has a frame then."""
        return self["plane_channels"] + self["frequency_count"] > 0


class Shape(NamedTuple):
    """The shape of a network.

    widths: from the inputs to the outputs. integer: whether it acts on integers, as all but the rendering networks do.
    """

    name: str
    widths: list[int]
    integer: bool

    # SPEC 5.8
    @property
    def weight_count(self) -> int:
        """The number of its weights and biases."""
        return sum((inputs + 1) * outputs for inputs, outputs in pairwise(self.widths))


# SPEC 5.8
def shapes(header: Dimensions) -> list[Shape]:
    """Return the shapes of the networks, in file order."""
    k, f, d = header["offset_count"], header.features, header.channels
    slices = header["slice_width"]
    context = 2 * header["plane_channels"] + 2 * header["frequency_count"]
    out = [Shape("hyper", [context, *header["hyper_width"], 2 * d + 3], True)]
    if header["plane_channels"]:
        out.append(Shape("sarm", [4, *header["sarm_width"], 2], True))
    out += [
        Shape(f"carm.{i}", [sum(slices[:i]), *header["carm_width"], 2 * slices[i]], True) for i in range(1, len(slices))
    ]
    rendering = (("opacity", k), ("covariance", 7 * k), ("colour", 3 * k))
    return out + [Shape(name, [f + 4, header["render_width"], outputs], False) for name, outputs in rendering]


# SPEC 5.8, [R6.6-5]
def weight_count(header: Dimensions) -> int:
    """Return W, the number of weights and biases."""
    return sum(shape.weight_count for shape in shapes(header))


# SPEC 11.2
def work(header: Dimensions) -> int:
    """Return the work of a file."""
    anchor, symbol = 16 * header.channels, 16
    for shape in shapes(header):
        if shape.name == "sarm":
            symbol += shape.weight_count
        elif shape.integer:
            anchor += shape.weight_count
    symbols = 5 * header["plane_channels"] * header["plane_size"] ** 2
    anchors: int = header["anchor_count"]
    return anchors * anchor + symbols * symbol
