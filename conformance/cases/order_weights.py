"""Cases of clause 10.1: two faults of the weights, the first of which must be reported.

Faults after the substream of mode 1 are reported by layer, and bounds last.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from refcodec.bitstream import codec
from refcodec.bitstream.header import Lanes

from . import entropy_substreams, networks, planes, weights_packed, weights_raw
from .book import Book
from .chain import Link, also, chain, other_symbols
from .fault import Refused, several
from .scenes import SMALLEST, packed_weights, scene, settled
from .target import Target
from .targets import five_cells, grids, plain
from .weights_raw import NOT_FINITE

NONE = NOT_FINITE["not-a-number"]


def add(book: Book) -> None:
    """Adds the vectors."""
    _raw_weights(book)
    _packed_weights(book)
    _layers(book)


def _raw_weights(book: Book) -> None:
    scale, finite = weights_raw.scale, weights_raw.not_finite
    chain(
        book,
        plain,
        "weights",
        [
            Link("plane-shift", "plane_shift", scale, "plane_shift", 11),
            Link("carm-input-count", "carm_input_count", scale, "carm_input_count", 0),
            Link("carm-shift", "a carm_shift", scale, "carm_shift[0]", 17),
            Link("later-carm-shift", "a later carm_shift", scale, "carm_shift[1]", 255),
            Link("not-finite", "a weight that is no number", finite, "hyper.0", 0, 0, NONE),
            Link("later-not-finite", "a later one that is no number", finite, "colour.1", 5, None, NONE),
            Link("bound", "a row of F_h at no exponent", networks.large_value, "hyper.0", 1, 0, 1e9),
            Link("later-bound", "a row of CARM at no exponent", networks.large_value, "carm.1.1", 0, 0, 1e9),
            Link("planes", "the lengths of the planes", planes.sub_plane_lengths, {0: 4}),
        ],
        "R6.8-1 R6.8-3 R6.8-4",
    )
    chain(
        book,
        five_cells,
        "weights-padding",
        [
            Link("plane-shift", "plane_shift", scale, "plane_shift", 11),
            Link("padding", "padding behind the table of scales", weights_raw.padding, 0, 1),
            Link("not-finite", "a weight that is no number", finite, "hyper.0", 0, 0, NONE),
        ],
        "R6.8-1 R6.8-2 R6.8-3",
    )


def _packed_weights(book: Book) -> None:
    field, reserved = weights_packed.model_field, weights_packed.reserved
    chain(
        book,
        grids,
        "packed-weights",
        [
            Link("scale", "plane_shift", weights_raw.scale, "plane_shift", 11),
            Link("padding", "padding behind the table of scales", weights_raw.padding, 1, 1),
            Link("reserved", "a reserved byte of the first layer", reserved, "hyper.0", 0, 1),
            Link("form", "the form of the first layer", field, "hyper.0", "form", 2),
            Link("reserved-1", "a reserved byte of the second layer", reserved, "hyper.1", 1, 1),
            Link("form-1", "the form of the second layer", field, "hyper.1", "form", 255),
            Link("exponent-1", "the exponent of the second layer", field, "hyper.1", "exponent", 150),
            Link("last-form", "the form of the last layer", field, "colour.1", "form", 3),
            Link("state", "a state of the weights", entropy_substreams.state, "weights", 0, 0),
            other_symbols("weights", "symbols", "symbol_crc of the weights"),
            Link("not-finite", "a raw number that is none", weights_raw.not_finite, "hyper.0", 0, 0, NONE),
            Link("planes", "the lengths of the planes", planes.sub_plane_lengths, {0: 4}),
        ],
        "R6.8-1 R6.8-2 R6.8-6 R6.8-7",
    )
    chain(
        book,
        grids,
        "raw-layer",
        [
            Link("exponent-outside", "an exponent of 150 in a raw layer", field, "hyper.0", "exponent", 150),
            Link("exponent-scale", "a scale of exponents", field, "hyper.0", "exponent_scale", 1),
            Link("exponent", "an exponent of 5", field, "hyper.0", "exponent", 5),
            Link("weight-scale", "a scale of weights", field, "hyper.0", "weight_scale", 1),
            Link("bias-scale", "a scale of biases", field, "hyper.0", "bias_scale", 1),
        ],
        "R6.8-7",
    )
    cut = weights_packed.cut
    rows: list[tuple[str, str, Callable[[], Refused], str | None, int]] = [
        ("invalid-scale-and-no-model", "plane_shift", weights_raw.scale.of(grids, "plane_shift", 11), "hyper.0", 0),
        (
            "invalid-carm-input-count-and-no-model",
            "carm_input_count 255, by which the table would be longer than the section",
            weights_raw.scale.of(grids, "carm_input_count", 255),
            None,
            4,
        ),
        ("malformed-padding-and-no-model", "padding of the table", weights_raw.padding.of(grids, 0, 1), "hyper.0", 0),
        ("unsupported-reserved-and-values", "a reserved byte", reserved.of(grids, "hyper.0", 0, 1), "hyper.0", 9),
        ("invalid-form-and-later-model", "a form", field.of(grids, "hyper.0", "form", 2), "sarm.1", 5),
        *(
            (
                f"invalid-raw-{name.replace('_', '-')}-and-values",
                f"{name} in a raw layer",
                field.of(grids, "hyper.0", name, value),
                "hyper.0",
                9,
            )
            for name, value in (("exponent", 5), ("weight_scale", 5))
        ),
    ]
    for identifier, text, make, layer, more in rows:
        book.ordered(identifier, f"{text}, and the section's end", also(make, cut, layer, more), "R6.8-5")


@cache
def _two_raw() -> Target:
    """Returns a file in mode 1 whose layers hyper.0 and opacity.0 are raw."""
    made = scene("outside-two-raw", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    for name in ("hyper", "opacity"):
        made.networks[name][0][1][0] = -0.0
    return Target(codec.emit(packed_weights(settled(made))))


def _layers(book: Book) -> None:
    """Adds faults after the substream: those of layers in order, then bounds."""
    finite, large, even = weights_raw.not_finite, networks.large_value, weights_packed.even_integers
    proved = "R6.8-3 R6.8-4 R6.8-8"
    first = finite.edit("hyper.0", 0, 0, NONE)
    title = "a raw layer with a number that is none, and an exponent of a later one"
    book.ordered(
        "invalid-layers-not-finite-and-exponent", title, several(even.target(_two_raw, "hyper.1"), first), proved
    )
    for name, title, make in (
        (
            "exponent-and-not-finite",
            "an exponent, and a later raw layer with a number that is none",
            also(even.of(_two_raw, "hyper.1"), finite, "opacity.0", 0, 0, NONE),
        ),
        (
            "exponent-and-bound",
            "an exponent, and an earlier raw layer that breaks the bound",
            also(even.of(_two_raw, "colour.0"), large, "hyper.0", 0, 0, 4096.0),
        ),
        (
            "not-finite-and-bound",
            "a raw layer with a number that is none, and an earlier one that breaks the bound",
            also(finite.of(_two_raw, "opacity.0", 0, 0, NONE), large, "hyper.0", 0, 0, 4096.0),
        ),
        (
            "bound-and-planes",
            "a raw layer that breaks the bound, and the lengths of the planes",
            also(large.of(_two_raw, "hyper.0", 0, 0, 4096.0), planes.sub_plane_lengths, {0: 4}),
        ),
    ):
        book.ordered(f"invalid-layers-{name}", title, make, proved)
