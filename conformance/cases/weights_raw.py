"""Cases of clauses 5.8 and 6.8: the table of scales, and weights as f32, in mode 0 and in raw layers of mode 1."""

from __future__ import annotations

import struct
from functools import partial

import numpy as np

from refcodec.bitstream.dimensions import RENDERING, layers_of
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import CARM_SHIFT_MAX, PLANE_SHIFT_MAX

from .book import Book
from .fault import Draw, Drawn, Edit, fault, one_field
from .header import INFINITY, LARGEST_F32, NAN, SMALLEST_F32, label_of
from .numbers import Numbers
from .samplers import Sampler, drawn, sampled
from .scenes import CONSTANT, PLANELESS, UNENCODED
from .target import Target
from .targets import five_cells, grids, packed, plain, planeless

NOT_FINITE = {
    "not-a-number": struct.pack("<f", NAN),
    "infinite": struct.pack("<f", INFINITY),
    "signalling": b"\1\0\x80\xff",
}

MINUS = struct.pack("<f", -INFINITY)


@fault("weights.scale")
def scale(t: Target, field: str, value: int) -> Edit:
    """A field of the table at the start of the section is outside its limits."""
    return one_field(t, f"weights.{field}", value)


@scale.drawn
def _(draw: Draw, t: Target) -> Drawn:
    d = t.header.dimensions
    inputs = d.carm_inputs
    limits = {"plane_shift": PLANE_SHIFT_MAX if d.plane_channels else 0, "carm_input_count": inputs}
    limits |= {f"carm_shift[{i}]": CARM_SHIFT_MAX for i in range(inputs)}
    field = draw.choice(list(limits))
    return t, field, draw.choice([limits[field] + 1, 255])


@fault("weights.padding")
def padding(t: Target, at: int, value: int) -> Edit:
    """A byte of the padding after carm_shift is not zero."""
    start = t.at("weights.padding")
    return Edit({start + at: bytes([value])}, start)


@padding.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if "weights.padding" not in t.elements:
        return None
    row = t.element("weights.padding")
    return t, draw.integer(0, row.end - row.start - 1), draw.integer(1, 255)


@fault("weights.not_finite")
def not_finite(t: Target, layer: str, row: int, column: int | None, value: bytes) -> Edit:
    """A weight of a raw layer, or a bias if column is None, is not finite."""
    at = t.weight_at(layer, row, column)
    return Edit({at: value}, at)


@not_finite.drawn
def _(draw: Draw, t: Target) -> Drawn:
    raw = [shape for shape in layers_of(t.header.dimensions) if f"weights.{shape[0]}.weight" in t.elements]
    layer, out, fan_in = draw.choice(raw)
    column = draw.integer(0, fan_in)
    value = draw.choice([*NOT_FINITE.values(), b"\1\0\x80\x7f"])
    return t, layer, draw.integer(0, out - 1), None if column == fan_in else column, value


def add(book: Book) -> None:
    """Adds the vectors."""
    for base, before, features, field, value in (
        (plain, "", "raw-weights", "plane_shift", 11),
        (plain, "", "raw-weights", "carm_input_count", 0),
        (plain, "", "raw-weights", "carm_input_count", 3),
        (plain, "", "raw-weights", "carm_shift[0]", 17),
        (plain, "last-", "raw-weights", "carm_shift[1]", 17),
        (packed, "packed-", "packed-weights", "carm_input_count", 0),
    ):
        title = f"{field.partition('[')[0]} {value}"
        identifier = f"invalid-{before}{label_of(title).replace(' ', '-')}"
        book.add(identifier, title, scale.of(base, field, value), features=features, flags="limit-off-by-one")
    title = "plane_shift 1, and no planes"
    make = scale.of(planeless, "plane_shift", 1)
    book.add("invalid-planeless-plane-shift-1", title, make, features="raw-weights", flags="limit-off-by-one")
    for name, base, at, features in (
        ("raw", five_cells, 1, "raw-weights"),
        ("packed", grids, 0, "packed-weights"),
        ("packed-last-byte", grids, 1, "packed-weights"),
    ):
        title = f"padding of the table of scales that is not zero: {name.replace('-', ', ')}"
        make = padding.of(base, at, 0x80)
        book.add(f"malformed-weights-padding-{name}", title, make, features=features, flags="padding-unchecked")
    places: list[tuple[str, str, tuple[str, int, int | None]]] = [
        ("first", "not-a-number", ("hyper.0", 0, 0)),
        ("bias", "infinite", ("sarm.0", 1, None)),
        ("carm", "signalling", ("carm.1.0", 0, 0)),
        ("last", "not-a-number", ("colour.1", 5, None)),
    ]
    for name, value_name, place in places:
        book.add(
            f"invalid-weights-{value_name}-{name}",
            f"a weight or bias is {value_name.replace('-', ' ')}: {name}",
            not_finite.of(plain, *place, NOT_FINITE[value_name]),
            features="raw-weights",
            flags="float-limits",
        )
    title, make = "the last bias of a section of weights is infinite", not_finite.of(plain, "colour.1", 5, None, MINUS)
    book.add("invalid-weights-infinite-end", title, make, features="raw-weights", flags="float-limits")
    title = "the first weight of a rendering network is infinite"
    make = not_finite.of(plain, "opacity.0", 0, 0, NOT_FINITE["infinite"])
    book.add("invalid-weights-infinite-rendering", title, make, features="raw-weights", flags="float-limits")
    title = "a raw layer with a number that is none"
    make = not_finite.of(grids, "hyper.0", 0, 0, NOT_FINITE["not-a-number"])
    book.add("invalid-grids-raw-not-a-number", title, make, features="packed-weights", flags="float-limits")
    book.valid(
        "weights-any",
        "rendering networks with any finite f32, which decide no symbol",
        _any_finite,
        features="raw-weights",
        requirements="R6.8-3 D9.3-1",
        flags="weight-bits",
    )
    book.valid(
        "weights-negative-zero",
        "weights and biases of -0, which stay as they are",
        _negative_zeros,
        features="raw-weights networks",
        requirements="D7.2-1 D9.3-1",
        flags="weight-bits",
    )
    for name, text, d in (
        ("planeless", "no planes: there is no SARM, and plane_shift is 0", PLANELESS),
        ("unencoded", "no positional encoding: F_h has four inputs", UNENCODED),
        ("constant", "neither planes nor encoding: F_h is its biases", CONSTANT),
    ):
        book.valid(
            f"weights-{name}",
            f"weights of a scene with {text}",
            partial(drawn, f"weights-{name}", 7, d, chunk_size=4),
            features="raw-weights dimensions",
            requirements="R6.8-1 D7.2-1 D7.2-2",
            flags="empty-refused",
        )


def _any_finite() -> Scene:
    made = drawn("weights-any", 2)
    values = np.array([LARGEST_F32, -LARGEST_F32, -0.0, SMALLEST_F32, -(2.0**-126), 1 / 3], np.float32)
    for name in RENDERING:
        for w, b in made.networks[name]:
            flat = w.reshape(-1)
            flat[:6] = values[: flat.size]
            b[0] = -0.0
    return made


def _negative_zeros() -> Scene:
    made = drawn("weights-negative-zero", 3)
    for layers in made.networks.values():
        layers[0][0][0, 0] = -0.0
        layers[-1][1][0] = -0.0
    return sampled(made, Sampler(Numbers("weights-negative-zero/again")))
