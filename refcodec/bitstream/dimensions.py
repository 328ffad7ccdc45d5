"""Clauses 5.3, 5.8 and 6.3: the dimensions, and the networks that follow from them."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

# SPEC 3.2: the number of scalings of an anchor.
SCALINGS = 6
# SPEC 5.8: the rendering networks. No symbol depends on them.
RENDERING = ("opacity", "covariance", "colour")
# SPEC 6.5: the render model of static scenes, and view_inputs and colour_outputs of each render model.
STATIC = 1
RENDER_MODELS: dict[int, tuple[int, tuple[int, ...]]] = {0: (4, (3,)), STATIC: (0, (3, 12, 27, 48))}


@dataclass(frozen=True)
class Dimensions:
    """SPEC 5.3 and 6.3: the dimensions of a scene.

    offset_count: K.
    slices: the channels of each feature slice.
    plane_channels: ch, or 0 for a scene without planes.
    frequency_count: L, or 0 for a scene without a positional encoding.
    plane_size: B, or 0 without planes.
    hyper_width, sarm_width, carm_width: the widths of the hidden layers of F_h, of SARM and of each network of CARM.
    render_width: the width of the one hidden layer of each rendering network.
    view_inputs: the inputs of each rendering network in addition to the features.
    colour_outputs: the outputs of the colour network for each offset.
    """

    offset_count: int
    slices: tuple[int, ...]
    plane_channels: int
    frequency_count: int
    plane_size: int
    hyper_width: tuple[int, ...]
    sarm_width: tuple[int, ...]
    carm_width: tuple[int, ...]
    render_width: int
    view_inputs: int = 4
    colour_outputs: int = 3

    @property
    def features(self) -> int:
        """F, the number of feature channels of an anchor."""
        return sum(self.slices)

    @property
    def attribute_width(self) -> int:
        """D = F + 6 + 3 K, the number of attribute channels of an anchor."""
        return self.features + SCALINGS + 3 * self.offset_count

    @property
    def has_frame(self) -> bool:
        """SPEC 6.6: whether there is a frame. Only planes and the positional encoding need one."""
        return self.plane_channels + self.frequency_count > 0

    @property
    def carm_inputs(self) -> int:
        """The number of feature channels that CARM reads: those of all slices except the last."""
        return self.features - self.slices[-1]

    def network_shapes(self) -> dict[str, list[tuple[int, int]]]:
        """SPEC 5.8: returns the shapes (outputs, inputs) of the layers of each network, by name, in file order."""

        def mlp(widths: list[int]) -> list[tuple[int, int]]:
            return [(out, fan_in) for fan_in, out in pairwise(widths)]

        context = 2 * self.plane_channels + 2 * self.frequency_count
        shapes = {"hyper": mlp([context, *self.hyper_width, 2 * self.attribute_width + 3])}
        if self.plane_channels:
            shapes["sarm"] = mlp([4, *self.sarm_width, 2])
        for index in range(1, len(self.slices)):
            shapes[f"carm.{index}"] = mlp([sum(self.slices[:index]), *self.carm_width, 2 * self.slices[index]])
        for name, outputs in zip(RENDERING, (1, 7, self.colour_outputs), strict=True):
            shapes[name] = mlp([self.features + self.view_inputs, self.render_width, outputs * self.offset_count])
        return shapes


def dimensions_of(d: Any) -> Dimensions:
    """SPEC 5.3: returns the dimensions of a parsed struct, unchecked."""
    scalars = ("offset_count", "plane_channels", "frequency_count", "plane_size", "render_width", "view_inputs")
    widths: dict[str, Any] = {name: tuple(d[name]) for name in ("hyper_width", "sarm_width", "carm_width")}
    own = {name: d[name] for name in (*scalars, "colour_outputs")}
    return Dimensions(slices=tuple(d.slice_width), **widths, **own)


def dimension_fields(d: Dimensions) -> dict[str, Any]:
    """SPEC 5.3: returns the fields of the struct, by name."""
    fields = {"slice_width": d.slices, **{name: value for name, value in vars(d).items() if name != "slices"}}
    counts = {f"{name}_layers": len(fields[f"{name}_width"]) for name in ("hyper", "sarm", "carm")}
    return {**fields, **counts, "slice_count": len(d.slices), "reserved": 0}


def mask_contexts(offset_count: int) -> int:
    """SPEC 7.6: returns K (K + 1) / 2, the number of contexts of the mask model."""
    return offset_count * (offset_count + 1) // 2


def layers_of(d: Dimensions) -> list[tuple[str, int, int]]:
    """SPEC 5.8: returns (name, outputs, inputs) of every layer, in file order. A name is, for example, hyper.0."""
    shapes = d.network_shapes()
    return [(f"{name}.{i}", out, fan_in) for name in shapes for i, (out, fan_in) in enumerate(shapes[name])]


def weight_count(d: Dimensions) -> int:
    """SPEC 5.8: returns W, the number of weights and biases of all networks."""
    return sum(out * (fan_in + 1) for _, out, fan_in in layers_of(d))


def work(d: Dimensions, anchors: int) -> int:
    """SPEC 11.2: returns the work of a scene, N * (W_a + 16 D) + 5 ch B^2 (W_s + 16). anchors: N."""
    rendering = RENDERING if d.view_inputs == 0 else ()
    counts = {"hyper": 0, "sarm": 0, "carm": 0, **dict.fromkeys(RENDERING, 0)}
    for name, out, fan_in in layers_of(d):
        counts[name.split(".")[0]] += out * (fan_in + 1)
    points = 5 * d.plane_channels * d.plane_size**2
    each = sum(counts[name] for name in ("hyper", "carm", *rendering))
    return anchors * (each + 16 * d.attribute_width) + points * (counts["sarm"] + 16)
