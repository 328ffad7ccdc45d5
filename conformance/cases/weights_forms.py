"""Cases of clauses 5.9 and 6.8: valid files in mode 1 of the weights, with layers of either form.

Some layers are raw because no grid contains their values, others by the encoder's choice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream.dimensions import Dimensions, layers_of
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import packable

from .book import Book
from .samplers import drawn
from .scenes import CONSTANT, SMALLEST, TINY_DIMENSIONS, Networks, packed_weights, scene, settled, silent
from .weights_packed import regular


def add(book: Book) -> None:
    """Adds the vectors."""
    valid = partial(book.valid, features="packed-weights")
    valid(
        "grids-raw-layers",
        "layers that are raw: -0, integers and exponents beyond the limits",
        partial(regular, "grids-raw-layers", _beyond),
        requirements="D7.13-1 R6.8-7 R6.8-3",
        flags="raw-layer",
    )
    valid(
        "grids-raw-all",
        "every layer raw, and a substream of no symbols",
        partial(regular, "grids-raw-all", _all_raw),
        requirements="D7.13-1 R6.8-7 R6.8-3",
        flags="raw-layer empty-substream",
    )
    valid(
        "grids-last-bias",
        "a layer that is raw because of its last bias alone",
        _last_bias,
        requirements="R6.8-7 R6.8-3 D7.13-1",
        flags="raw-layer grid-exponent",
    )
    valid(
        "grids-raw-subnormal",
        "layers that are raw because of one subnormal number",
        _subnormal,
        requirements="D7.13-1 R6.8-7",
        flags="subnormals raw-layer grid-exponent",
    )
    valid(
        "grids-raw-by-choice",
        "every second layer raw, all of which could be packed",
        partial(_chosen, "grids-raw-by-choice", lambda n: np.arange(n) % 2),
        requirements="D7.13-1 R6.8-7 R6.8-5",
        flags="raw-layer canonical-form",
    )
    valid(
        "grids-raw-all-by-choice",
        "every layer raw, none of which has to be: as in mode 0, but for the models and the substream",
        partial(_chosen, "grids-raw-all-by-choice", np.zeros),
        requirements="D7.13-1 R6.8-7 R6.8-5",
        flags="raw-layer empty-substream canonical-form",
    )
    valid(
        "grids-packed-one",
        "the last layer packed, all others raw",
        partial(_chosen, "grids-packed-one", lambda n: np.arange(n) == n - 1),
        requirements="D7.13-1 R6.8-7 R6.8-5",
        flags="raw-layer",
    )
    valid(
        "grids-raw-of-zeros",
        "raw layers of zeros, and packed ones",
        _zeros_of_both_forms,
        requirements="D7.13-1 R6.8-7",
        flags="raw-layer zero-rows",
    )
    valid(
        "grids-raw-at-the-limit",
        "the largest integer in one row and a far smaller number in another, in a raw and in a packed layer",
        _at_the_limit,
        requirements="D7.13-1 R6.8-7",
        flags="raw-layer limit-off-by-one",
    )
    for name, forms in (("packed", np.ones), ("raw", np.zeros)):
        valid(
            f"grids-no-inputs-{name}",
            f"a layer of F_h that has no inputs, {name}",
            partial(_chosen, f"grids-no-inputs-{name}", forms, CONSTANT),
            requirements="D7.13-1 R6.8-8" if name == "packed" else "D7.13-1 R6.8-7",
            flags="raw-layer grid-exponent empty-refused",
        )


def _chosen(name: str, forms: Callable[[int], NDArray[Any]], d: Dimensions = TINY_DIMENSIONS) -> Scene:
    """Returns a scene in mode 1 in which all layers can be packed. forms: of the first layers."""
    made = packed_weights(drawn(name, 3, d))
    found = forms(len(layers_of(d))).astype(np.uint8)
    assert packable(made.networks).all()
    assert made.weight_scales is not None
    # The model of a raw layer has no scales.
    return replace(made, weight_scales=made.weight_scales * found[:, None], weight_forms=found)


def _zeros_of_both_forms() -> Scene:
    made = scene("grids-raw-of-zeros", 2, SMALLEST)
    for name in ("opacity", "colour"):
        made.networks[name] = silent(made.networks[name])
    return _some_raw(settled(packed_weights(made)), "opacity.0", "colour.1")


def _at_the_limit() -> Scene:
    made = scene("planted-scaled", 2, replace(SMALLEST, render_width=2), lanes=Lanes(0, 0, 1))
    for name in ("opacity", "covariance"):
        w, b = made.networks[name][0]
        w[:], b[:] = 0, 0
        w[0, 0], w[1, 0] = (1 << 24) - 1, 2.0**-30
    return _some_raw(packed_weights(made), "opacity.0")


def _some_raw(made: Scene, *names: str) -> Scene:
    """Returns the scene with some layers raw, and the others packed."""
    raw = np.array([name in names for name, _, _ in layers_of(made.dimensions)])
    assert made.weight_scales is not None
    scale = np.where(raw[:, None], 0, made.weight_scales).astype(np.uint8)
    return replace(made, weight_scales=scale, weight_forms=(~raw).astype(np.uint8))


def _beyond(n: Networks) -> None:
    n["hyper"][0][0][0, 0] = -0.0
    n["covariance"][1][1][3] = -0.0
    # An odd integer beyond the limit, and exponents beyond their limits.
    n["opacity"][0][0][0, :2] = 2.0**24, 1
    n["opacity"][1][0][0, 0] = 2.0**105
    n["opacity"][1][0][0, 1:] = 0
    n["opacity"][1][1][0] = 0
    n["colour"][0][0][1, :2] = 3.0e38, 2.0**-149
    # A row of zeros in a raw layer.
    n["colour"][0][0][0], n["colour"][0][1][0] = 0, 0


def _all_raw(n: Networks) -> None:
    for layers in n.values():
        for _, b in layers:
            b[0] = -0.0


def _last_bias() -> Scene:
    made = scene("planted-last-bias", 2, replace(SMALLEST, render_width=3), lanes=Lanes(0, 0, 1))
    w, b = made.networks["opacity"][0]
    w[:], b[:] = 1, 1
    b[2] = 2.0**-24
    return packed_weights(made)


def _subnormal() -> Scene:
    made = scene("outside-least", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    for name, tiny in (("hyper", 2.0**-149), ("opacity", 2.0**-149), ("colour", (2.0**23 - 1) * 2.0**-149)):
        w, b = made.networks[name][0]
        w[:], b[:] = 1, 1
        w[0, 0] = tiny
    return packed_weights(settled(made))
