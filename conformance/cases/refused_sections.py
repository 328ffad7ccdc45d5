"""Files with one fault in the frame, the weights, the planes, the chunk table or the positions."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from refcodec.bitstream import codec, dimensions, directory, weights
from refcodec.bitstream.entropy import Encoder
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.networks import Layer
from refcodec.bitstream.positions import PACKED, chunk_codes, code_cells
from refcodec.bitstream.scene import Scene

from .book import Book, Make, Refused
from .files import Target, grid_layers, position_parts, repair, resized, with_positions
from .numbers import Int64, Numbers
from .packing import MIDDLE, of_cells, placed
from .refused_header import INFINITY, NAN, packed, patched, plain
from .scenes import SMALLEST, lattice, scales, scene, settled

FLOATS = {
    "not-a-number": struct.pack("<f", NAN),
    "infinite": struct.pack("<f", INFINITY),
    "signalling": b"\1\0\x80\xff",
}


def add(book: Book) -> None:
    """Adds the vectors."""
    _frame(book)
    _raw_weights(book)
    _packed_weights(book)
    _tables(book)
    _raw_positions(book)
    _packed_positions(book)


def _frame(book: Book) -> None:
    rows: list[tuple[str, str, int, str]] = [
        ("matrix[0]", "<i", 1 << 20, "too-large"),
        ("matrix[8]", "<i", -(1 << 20), "too-small"),
        ("matrix[4]", "<i", -(1 << 31), "least"),
        ("translation[0]", "<q", 1 << 61, "too-large"),
        ("translation[2]", "<q", -(1 << 61), "too-small"),
        ("translation[1]", "<q", -(1 << 63), "least"),
        ("shift[2]", "B", 61, "too-large"),
        ("reserved", "B", 1, "set"),
        ("low[0]", "<i", 1 << 18, "too-large"),
        ("low[2]", "<i", -(1 << 18) - 1, "too-small"),
        ("high[0]", "<i", (1 << 18) + 1, "too-large"),
        ("high[2]", "<i", -(1 << 31), "below-low"),
    ]
    for field, form, value, text in rows:
        label = field.replace("[", "-").replace("]", "")
        book.add(
            f"invalid-frame-{label}-{text}",
            f"{field} of the frame is {value}",
            patched(plain, f"frame.{field}", form, value, "frame.range"),
            features="frame",
            flags="limit-off-by-one signed-limits",
        )

    def equal() -> Refused:
        t = plain()
        low = t.data[t.at("frame.low[1]") :][:4]
        return Refused(repair(t.put(t.at("frame.high[1]"), low)), "frame.range", t.at("frame.high[1]"))

    book.add(
        "invalid-frame-empty-range", "high is low", equal, features="frame", flags="limit-off-by-one division-by-zero"
    )


# --- weights ----------------------------------------------------------------------------------------------------------


def value_at(t: Target, name: str, number: int, row: int, column: int | None) -> int:
    """Where a weight of a layer in mode 0 is, or its bias."""
    at = t.start(directory.WEIGHTS) + 2 + t.header.dimensions.carm_inputs
    for layer, out, fan_in in dimensions.layers_of(t.header.dimensions):
        if layer == f"{name}.{number}":
            return at + 4 * (out * fan_in + row if column is None else row * fan_in + column)
        at += 4 * out * (fan_in + 1)
    raise AssertionError(name)


def _raw_weights(book: Book) -> None:
    def add(name: str, text: str, make: Make, flags: str) -> None:
        book.add(f"invalid-weights-{name}", text, make, features="raw-weights", flags=flags)

    for base, label in ((plain, ""), (packed, "packed-")):
        for item, value, text in (
            (0, 11, "plane_shift 11"),
            (1, 0, "carm_input_count 0"),
            (2, 17, "carm_shift 17"),
        ):
            if label and item != 1:
                continue

            def scale(base: Callable[[], Target] = base, item: int = item, value: int = value) -> Refused:
                t = base()
                at = t.start(directory.WEIGHTS) + item
                return Refused(repair(t.put(at, bytes([value]))), "weights.scale", at)

            name = text.replace(" ", "-").replace("_", "-")
            book.add(
                f"invalid-{label}{name}", text, scale, features=f"{label or 'raw-'}weights", flags="limit-off-by-one"
            )
    places: list[tuple[str, str, tuple[str, int, int, int | None]]] = [
        ("first", "not-a-number", ("hyper", 0, 0, 0)),
        ("bias", "infinite", ("sarm", 0, 1, None)),
        ("carm", "signalling", ("carm.1", 0, 0, 0)),
        ("last", "not-a-number", ("colour", 1, 5, None)),
    ]
    for name, text, place in places:

        def float_(text: str = text, place: tuple[str, int, int, int | None] = place) -> Refused:
            t = plain()
            at = value_at(t, *place)
            return Refused(repair(t.put(at, FLOATS[text])), "weights.not_finite", at)

        add(f"{text}-{name}", f"a weight or bias is {text.replace('-', ' ')}: {name}", float_, "float-limits")

    def bound(name: str, number: int, row: int, column: int | None, value: float) -> Make:
        def make() -> Refused:
            t = plain()
            data = repair(t.put(value_at(t, name, number, row, column), struct.pack("<f", value)))
            return Refused(data, "weights.bound", value_at(t, name, number, row, 0))

        return make

    for name, text, make in (
        ("weight-1023-5", "a weight that rounds to 1024 at each exponent", bound("hyper", 1, 3, 1, 1023.5)),
        ("weight-minus-1024", "a weight of -1024", bound("carm.1", 0, 1, 0, -1024.0)),
        ("weight-largest", "the largest f32 as a weight", bound("sarm", 2, 1, 3, -3.4028234663852886e38)),
        ("bias-2-24", "a bias of 2^24", bound("hyper", 0, 2, None, 2.0**24)),
        ("bias-minus-2-24", "a bias of -2^24", bound("sarm", 1, 0, None, -(2.0**24))),
        ("bias-largest", "the largest f32 as a bias", bound("carm.1", 1, 5, None, 3.4028234663852886e38)),
    ):
        add(f"bound-{name}", text, make, "accumulator-bound weight-limit")

    def exactly(change: Callable[[list[Layer]], None], row: int) -> Make:
        def make() -> Refused:
            t = _rows()
            made = codec.parse(t.data).scene
            layers = made.networks["hyper"]
            content = bytearray(t.content(directory.WEIGHTS))
            copied = [(w.copy(), b.copy()) for w, b in layers]
            change(copied)
            at = value_at(t, "hyper", 1, 0, 0)
            values = b"".join(part.astype("<f4").tobytes() for part in copied[1])
            first = at - t.start(directory.WEIGHTS)
            content[first : first + len(values)] = values
            return Refused(
                resized(t.data, directory.WEIGHTS, bytes(content)), "weights.bound", value_at(t, "hyper", 1, row, 0)
            )

        return make

    spare = (1 << 24) - 1 - 16 * 1023 * 1023

    def full(layers: list[Layer]) -> None:
        layers[1][0][4], layers[1][1][4] = -1023, spare + 1

    def seventeen(layers: list[Layer]) -> None:
        layers[1][0][2], layers[1][1][2] = 1023, 0
        layers[1][0][2, 0] = 1022.5
        layers[1][1][2] = spare + 0.5

    add(
        "bound-by-one",
        "a row that is at the accumulator bound, and not below it",
        exactly(full, 4),
        "accumulator-bound",
    )
    add(
        "bound-rounded",
        "a row that is at the bound once its bias is rounded",
        exactly(seventeen, 2),
        "accumulator-bound weight-rounding",
    )

    def two() -> Refused:
        t = plain()
        first, second = value_at(t, "sarm", 0, 1, 0), value_at(t, "sarm", 0, 0, None)
        data = bytearray(t.put(second, struct.pack("<f", 1e30)))
        data[first : first + 4] = struct.pack("<f", 5000.0)
        return Refused(repair(bytes(data)), "weights.bound", value_at(t, "sarm", 0, 0, 0))

    add("bound-bias-of-first-row", "two rows that break the bound, the first by its bias", two, "row-order")


@cache
def _rows() -> Target:
    from .decoding import ROWS  # noqa: PLC0415

    return Target(codec.emit(scene("refused-rows", 1, ROWS)))


@cache
def grids() -> Target:
    """A small file whose first layer is raw in mode 1, all others packed."""
    made = scene("refused-grids", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    made.networks["hyper"][0][1][0] = -0.0
    found = settled(made)
    return Target(codec.emit(replace(found, weight_scales=scales(found.networks))))


def other_grids(t: Target, change: Callable[[list[Any]], int]) -> Refused:
    """The file with other integers in its packed layers, coded rightly; change gives the number of the layer that is wrong."""
    made = codec.parse(t.data).scene
    assert made.weight_scales is not None
    layers: list[Any] = [weights.to_grid(layer) for network in made.networks.values() for layer in network]
    wrong = change(layers)
    coded = [i for i, grid in enumerate(layers) if grid is not None]
    encoder, shapes = Encoder(1, 1 << made.lanes.attribute), dimensions.layers_of(made.dimensions)
    weights.code_grids(encoder, [shapes[i] for i in coded], made.weight_scales[coded], [layers[i] for i in coded])
    starts = list(grid_layers(t).values())
    start, at = t.start(directory.WEIGHTS), starts[wrong] - t.start(directory.WEIGHTS)
    models = bytearray(t.data[start : starts[-1] + 6])
    models[at + 1 : at + 3] = struct.pack("<h", layers[wrong].exponent)
    return Refused(
        resized(t.data, directory.WEIGHTS, bytes(models) + encoder.finish()[0]), "weights.exponent", starts[wrong]
    )


def _packed_weights(book: Book) -> None:
    def add(klass: str, name: str, text: str, make: Make, flags: str) -> None:
        book.add(f"{klass}-grids-{name}", text, make, features="packed-weights", flags=flags)

    def cut(length: Callable[[Target], int]) -> Make:
        def make() -> Refused:
            t = grids()
            return Refused(
                resized(t.data, directory.WEIGHTS, t.content(directory.WEIGHTS)[: length(t)]),
                "weights.length",
                t.start(directory.WEIGHTS),
            )

        return make

    start = directory.WEIGHTS
    for name, text, length in (
        ("nothing", "a section of weights without a byte", lambda t: 0),
        ("cut-in-table", "the section ends within its table", lambda t: 1),
        (
            "cut-in-model",
            "the section ends within a layer's model",
            lambda t: list(grid_layers(t).values())[3] - t.start(start) + 5,
        ),
        (
            "cut-in-values",
            "the section ends within the values of a raw layer",
            lambda t: next(iter(grid_layers(t).values())) - t.start(start) + 9,
        ),
    ):
        add("malformed", name, text, cut(length), "truncation lengths-trusted")

    def field(number: int, offset: int, value: bytes) -> Make:
        def make() -> Refused:
            t = grids()
            at = list(grid_layers(t).values())[number] + offset
            return Refused(repair(t.put(at, value)), "weights.layer", at)

        return make

    for name, text, number, offset, value in (
        ("form-2", "form 2", 1, 0, b"\2"),
        ("exponent-150", "exponent 150", 2, 1, struct.pack("<h", 150)),
        ("exponent-minus-105", "exponent -105", 2, 1, struct.pack("<h", -105)),
        ("raw-exponent", "a raw layer with an exponent", 0, 1, struct.pack("<h", 1)),
        ("raw-exponent-scale", "a raw layer with a scale of exponents", 0, 3, b"\1"),
        ("raw-weight-scale", "a raw layer with a scale of weights", 0, 4, b"\1"),
        ("raw-bias-scale", "a raw layer with a scale of biases", 0, 5, b"\xff"),
    ):
        add("invalid", name, text, field(number, offset, value), "limit-off-by-one reserved-unchecked")

    def grid(number: int, **parts: Callable[[Any], Any]) -> Make:
        def change(layers: list[Any]) -> int:
            g = layers[number]
            values = {
                "exponent": g.exponent,
                "difference": g.difference.copy(),
                "weight": g.weight.copy(),
                "bias": g.bias.copy(),
            }
            for part, new in parts.items():
                values[part] = new(values[part])
            layers[number] = weights.GridLayer(**values)
            return number

        return lambda: other_grids(grids(), change)

    def all_even(x: Int64) -> Int64:
        return np.asarray(x * 2)

    def first_is(value: int) -> Callable[[Int64], Int64]:
        return lambda x: np.concatenate([[value], x.reshape(-1)[1:]]).reshape(x.shape)

    def last_is(value: int) -> Callable[[Int64], Int64]:
        return lambda x: np.concatenate([x[:-1], [value]])

    def zero(x: Int64) -> Int64:
        return np.zeros_like(x)

    for name, text, make in (
        ("even", "a row whose integers are all even", grid(1, weight=all_even, bias=all_even)),
        ("first-difference", "a first row whose exponent is not the model's", grid(3, difference=first_is(1))),
        ("outside-above", "an exponent above the largest", grid(5, difference=last_is(1000))),
        ("outside-below", "an exponent below the least", grid(4, difference=last_is(-1000))),
        ("far-outside", "exponents of eight digits", grid(1, difference=last_is((1 << 24) - 1))),
        (
            "zero-row-differs",
            "a row of zeros with an exponent of its own",
            grid(1, difference=last_is(3), bias=last_is(0), weight=lambda x: np.concatenate([x[:-1], zero(x[-1:])])),
        ),
        (
            "zero-layer-exponent",
            "a layer of zeros with an exponent",
            grid(3, difference=zero, weight=zero, bias=zero, exponent=lambda e: 7),
        ),
        (
            "zero-row-first",
            "a difference in the first row, which is all zero",
            grid(
                1,
                difference=lambda x: np.concatenate([[2, -2], zero(x[2:])]),
                weight=lambda x: np.concatenate([zero(x[:1]), x[1:]]),
                bias=first_is(0),
            ),
        ),
    ):
        add("invalid", f"exponent-{name}", text, make, "grid-exponent zero-rows")

    def raw_for_nothing() -> Refused:
        t = grids()
        at = next(iter(grid_layers(t).values()))
        out, fan_in = t.header.dimensions.network_shapes()["hyper"][0]
        return Refused(repair(t.put(at + 6 + 4 * out * fan_in, bytes(4))), "weights.raw", at)

    add("invalid", "raw-for-nothing", "a raw layer that can be packed", raw_for_nothing, "canonical-form raw-layer")

    def raw_float() -> Refused:
        t = grids()
        at = next(iter(grid_layers(t).values())) + 6
        return Refused(repair(t.put(at, FLOATS["not-a-number"])), "weights.not_finite", at)

    add("invalid", "raw-not-a-number", "a raw layer with a number that is none", raw_float, "float-limits")

    def raw_bound() -> Refused:
        t = grids()
        at = next(iter(grid_layers(t).values()))
        return Refused(repair(t.put(at + 6, struct.pack("<f", 4096.0))), "weights.bound", at)

    add("invalid", "raw-bound", "a row of a raw layer in mode 1 that breaks the bound", raw_bound, "accumulator-bound")

    def packed_bound() -> Refused:
        made = scene("refused-grids-bound", 1, SMALLEST)
        t = Target(codec.emit(replace(made, weight_scales=scales(made.networks))))

        def change(layers: list[Any]) -> int:
            w = layers[1].weight.copy()
            w[-1, 0] = (1 << 23) + 1
            layers[1] = replace(layers[1], weight=w)
            return 1

        refused = other_grids(t, change)
        return Refused(refused.data, "weights.bound", refused.offset)

    add("invalid", "packed-bound", "a row of a packed layer that breaks the bound", packed_bound, "accumulator-bound")


# --- planes and chunk table -------------------------------------------------------------------------------------------


def _tables(book: Book) -> None:
    def planes_cut() -> Refused:
        t = plain()
        return Refused(
            resized(t.data, directory.PLANES_SECTION, t.content(directory.PLANES_SECTION)[:19]),
            "planes.length",
            t.start(directory.PLANES_SECTION),
        )

    book.add(
        "malformed-planes-cut",
        "a section of planes that ends within its table",
        planes_cut,
        features="planes",
        flags="truncation",
    )
    for number, change in ((0, 1), (4, -1), (2, 1 << 31)):

        def plane_length(number: int = number, change: int = change) -> Refused:
            t = plain()
            at = t.start(directory.PLANES_SECTION) + 4 * number
            old = int.from_bytes(t.data[at : at + 4], "little")
            return Refused(
                repair(t.put(at, ((old + change) % (1 << 32)).to_bytes(4, "little"))),
                "planes.length",
                t.start(directory.PLANES_SECTION),
            )

        text = "huge" if change > 1 else "one more" if change > 0 else "one less"
        book.add(
            f"malformed-planes-length-{number}-{text.replace(' ', '-')}",
            f"the length of sub-plane {number} is {text}",
            plane_length,
            features="planes",
            flags="lengths-trusted",
        )

    def wrapped() -> Refused:
        t = plain()
        start = t.start(directory.PLANES_SECTION)
        lengths = list(struct.unpack_from("<5I", t.data, start))
        # The sum is right modulo 2^32.
        lengths[0], lengths[1] = lengths[0] + (1 << 31), lengths[1] + (1 << 31)
        return Refused(repair(t.put(start, struct.pack("<5I", *lengths))), "planes.length", start)

    book.add(
        "malformed-planes-length-wraps",
        "lengths that add up modulo 2^32",
        wrapped,
        features="planes",
        flags="lengths-trusted sum-wraps",
    )
    for number, value in ((0, 0), (2, 1 << 14), (1, 65535)):

        def model(number: int = number, value: int = value) -> Refused:
            t = plain()
            at = t.table + 2 * number
            return Refused(repair(t.put(at, value.to_bytes(2, "little"))), "chunks.mask_model", at)

        book.add(
            f"invalid-mask-model-{value}",
            f"a frequency of {value} in the mask model",
            model,
            features="masks",
            flags="limit-off-by-one",
        )

    def lengths(base: Callable[[], Target], entry: int, column: int, change: int, told: str) -> Make:
        def make() -> Refused:
            t = base()
            at = t.entries + 24 * entry + 8 * column
            old = int.from_bytes(t.data[at : at + 4], "little")
            data = repair(t.put(at, ((old + change) % (1 << 32)).to_bytes(4, "little")), chunks=False)
            return Refused(
                data, "chunks.length", t.entries + 24 * entry if told == "entry" else t.start(directory.CHUNKED[column])
            )

        return make

    for name, text, make in (
        ("position-more", "a position_length that is not six times the anchors", lengths(plain, 1, 0, 6, "entry")),
        ("position-last", "the last chunk has as many positions as the others", lengths(plain, 2, 0, 6, "entry")),
        ("mask-more", "mask lengths that add up to one more", lengths(plain, 0, 1, 1, "section")),
        ("mask-less", "mask lengths that add up to one less", lengths(plain, 2, 1, -1, "section")),
        ("attribute-more", "attribute lengths that add up to one more", lengths(plain, 2, 2, 1, "section")),
        ("attribute-huge", "an attribute_length of 2^31 more", lengths(plain, 1, 2, 1 << 31, "section")),
        (
            "packed-position-more",
            "packed position lengths that add up to one more",
            lengths(packed, 0, 0, 1, "section"),
        ),
        (
            "packed-position-less",
            "packed position lengths that add up to one less",
            lengths(packed, 2, 0, -1, "section"),
        ),
    ):
        book.add(f"malformed-chunks-{name}", text, make, features="chunks", flags="lengths-trusted last-chunk")

    def none() -> Refused:
        t = packed()
        return Refused(repair(t.put(t.entries + 24, bytes(4)), chunks=False), "chunks.length", t.entries + 24)

    book.add(
        "malformed-chunks-packed-position-none",
        "a packed chunk of no bytes",
        none,
        features="chunks packed-positions",
        flags="lengths-trusted",
    )

    def sixteenth() -> Refused:
        # 33 anchors in two bytes, the substream's head cut off: more than sixteen anchors for each byte.
        where = lattice(Numbers("refused-crowd"), 33)
        t = Target(codec.emit(placed("refused-crowd", where)))
        return Refused(with_positions(t, 0, b"\1\0"), "chunks.length", t.entries)

    book.add(
        "malformed-chunks-packed-position-crowded",
        "33 anchors in two bytes",
        sixteenth,
        features="chunks packed-positions",
        flags="lengths-trusted limit-off-by-one",
    )
    for base, label in ((plain, ""), (packed, "packed-")):
        for column, kind in enumerate(directory.CHUNKED):
            if label and column:
                continue

            def crc(base: Callable[[], Target] = base, column: int = column, kind: int = kind) -> Refused:
                t = base()
                at = t.start(kind)
                for chunk in range(1):
                    at += int.from_bytes(t.data[t.entries + 24 * chunk + 8 * column :][:4], "little")
                place = t.entries + 24 + 8 * column + 4
                return Refused(repair(t.put(place, bytes([t.data[place] ^ 1])), chunks=False), "chunks.crc", at)

            book.add(
                f"malformed-chunk-crc-{label}{directory.SECTIONS[kind]}",
                f"the CRC-32 of chunk 1 of the {directory.SECTIONS[kind]} does not match",
                crc,
                features="chunks",
                flags="checksum-unchecked",
            )

    def last_crc() -> Refused:
        t = plain()
        at = t.start(directory.ATTRIBUTES)
        for chunk in range(2):
            at += int.from_bytes(t.data[t.entries + 24 * chunk + 16 :][:4], "little")
        place = t.entries + 48 + 20
        return Refused(repair(t.put(place, bytes([t.data[place] ^ 0x80])), chunks=False), "chunks.crc", at)

    book.add(
        "malformed-chunk-crc-last",
        "the CRC-32 of the last chunk's attributes does not match",
        last_crc,
        features="chunks",
        flags="checksum-unchecked",
    )
    _position_model(book)


def _position_model(book: Book) -> None:
    def changed(model: int, change: Callable[[list[int]], None]) -> Make:
        def make() -> Refused:
            t = packed()
            at = t.position_model + 1 + 32 * model
            values = list(struct.unpack_from("<16H", t.data, at))
            change(values)
            return Refused(repair(t.put(at, struct.pack("<16H", *values))), "chunks.position_model", at)

        return make

    def more(values: list[int]) -> None:
        values[int(np.argmax(values))] += 1

    def less(values: list[int]) -> None:
        values[int(np.argmax(values))] -= 1

    def none(values: list[int]) -> None:
        values[int(np.argmax(values))] += values[9]
        values[9] = 0

    def empty_first(values: list[int]) -> None:
        values[int(np.argmax(values))] -= 1
        values[0] = 1

    def no_first(values: list[int]) -> None:
        values[int(np.argmax(values[1:])) + 1] += values[0]
        values[0] = 0

    def wraps(values: list[int]) -> None:
        # The sum is right modulo 2^16.
        values[3], values[4] = values[3] + 32768, values[4] + 32768

    for name, text, make in (
        ("sum-more", "frequencies that add up to one more", changed(0, more)),
        ("sum-less", "frequencies that add up to one less", changed(17, less)),
        ("zero", "a frequency of 0", changed(6, none)),
        ("zero-after-none", "a frequency of 0 after no children, not of symbol 0", changed(7, none)),
        ("empty-node", "a frequency above 0 for a node without children", changed(13, empty_first)),
        ("no-first-half", "a frequency of 0 for no children in the first half", changed(12, no_first)),
        ("sum-wraps", "frequencies that add up modulo 2^16", changed(2, wraps)),
    ):
        book.add(
            f"invalid-position-model-{name}",
            text,
            make,
            features="packed-positions",
            flags="position-model limit-off-by-one",
        )
    for value in (41,):

        def shift(value: int = value) -> Refused:
            t = packed()
            return Refused(repair(t.put(t.position_model, bytes([value]))), "chunks.position_model", t.position_model)

        book.add(
            f"invalid-cell-shift-{value}",
            f"cell_shift {value}",
            shift,
            features="packed-positions",
            flags="limit-off-by-one shift-overflow",
        )


# --- positions --------------------------------------------------------------------------------------------------------


def _raw_positions(book: Book) -> None:
    for base, label in ((plain, ""), (packed, "packed-")):
        for name, value, error in (
            ("infinite", 0x7C00, "not_finite"),
            ("minus-infinite", 0xFC00, "not_finite"),
            ("not-a-number", 0x7E01, "not_finite"),
            ("last-not-a-number", 0xFFFF, "not_finite"),
            ("negative-zero", 0x8000, "negative_zero"),
        ):
            if label and name not in ("infinite", "negative-zero"):
                continue

            def position(
                base: Callable[[], Target] = base, value: int = value, error: str = error, last: bool = "last" in name
            ) -> Refused:
                t = base()
                if base is packed:
                    start = next(start + 1 for start, _, _ in position_parts(t) if t.data[start] == 0)
                    at = start + 4
                else:
                    at = t.sections[directory.POSITIONS].end - 2 if last else t.start(directory.POSITIONS) + 26
                return Refused(repair(t.put(at, value.to_bytes(2, "little"))), f"positions.{error}", at)

            book.add(
                f"invalid-{label}position-{name}",
                f"a position is {name.replace('-', ' ')}",
                position,
                features=f"{label or 'raw-'}positions",
                flags="half-limits",
            )


def _other_cells(t: Target, code: Int64, name: str) -> Refused:
    """The file with other cells in its first chunk, coded rightly."""
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    encoder = Encoder(1, 1 << made.lanes.mask)
    code_cells(encoder, made.position_model.models(), [0], [len(code)], code)
    return Refused(with_positions(t, 0, bytes([PACKED]) + encoder.finish()[0]), name, t.start(directory.POSITIONS))


def overgrown(t: Target, levels: int) -> Refused:
    """The file with another tree in its first chunk: all children of each node on so many levels, then the first one alone. Of the nodes
    past the chunk's anchors nothing is sent."""
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    anchors = position_parts(t)[0][2]
    encoder, nodes, models = Encoder(1, 1 << made.lanes.mask), 1, made.position_model.models()

    def name(stream: int, index: int) -> str:
        return ""

    for level in range(15, -1, -1):
        every = level > 15 - levels
        low = np.full(nodes, 15 if every else 1)
        first = 6 * min(level, 2)
        encoder.plain(models, np.full(nodes, first), [nodes], name, low)
        encoder.plain(models, np.full(nodes, first + (5 if every else 2)), [nodes], name, low if every else low - 1)
        nodes = min(8 * nodes, anchors) if every else nodes
    return Refused(
        with_positions(t, 0, bytes([PACKED]) + encoder.finish()[0]), "positions.count", t.start(directory.POSITIONS)
    )


@cache
def five_cells() -> tuple[Target, Int64]:
    """A file of five anchors in one packed chunk, and the codes of their cells."""
    made: Scene = placed("refused-cells", lattice(Numbers("refused-cells"), 5), chunk_size=5)
    code = chunk_codes(made.positions, made.position_model.cell_shift if made.position_model else 0)
    assert code is not None
    return Target(codec.emit(made)), code


def _packed_positions(book: Book) -> None:
    def add(klass: str, name: str, text: str, make: Make, flags: str) -> None:
        book.add(f"{klass}-cells-{name}", text, make, features="packed-positions", flags=flags)

    for name, form in (("form-2", 2),):

        def other(form: int = form) -> Refused:
            t, _ = five_cells()
            at = t.start(directory.POSITIONS)
            return Refused(repair(t.put(at, bytes([form]))), "positions.form", at)

        add("malformed", name, f"a chunk of form {form}", other, "form-unchecked")
    for name, change in (("raw-shorter", -1), ("raw-longer", 1)):

        def sized(change: int = change) -> Refused:
            t, _ = five_cells()
            return Refused(with_positions(t, 0, bytes(1 + 30 + change)), "positions.form", t.start(directory.POSITIONS))

        add(
            "malformed",
            name,
            f"a raw chunk of {30 + change} bytes for five anchors",
            sized,
            "lengths-trusted form-unchecked",
        )

    def raw() -> Refused:
        t, _ = five_cells()
        where = codec.parse(t.data).scene.positions
        return Refused(
            with_positions(t, 0, b"\0" + where.astype("<f2").tobytes()), "positions.raw", t.start(directory.POSITIONS)
        )

    add("invalid", "raw-for-nothing", "a raw chunk that can be packed", raw, "canonical-form raw-chunk")

    def raw_single() -> Refused:
        where = of_cells(MIDDLE + np.array([[5, -3, 2]]), 22)
        t = Target(codec.emit(placed("refused-single", where)))
        return Refused(
            with_positions(t, 0, b"\0" + where.astype("<f2").tobytes()), "positions.raw", t.start(directory.POSITIONS)
        )

    add("invalid", "raw-single", "a raw chunk of one anchor, which is in order", raw_single, "canonical-form raw-chunk")
    add(
        "invalid",
        "count-one-less",
        "a tree with a cell less than there are anchors",
        lambda: _other_cells(five_cells()[0], five_cells()[1][:4], "positions.count"),
        "tree-count",
    )

    def sibling() -> Refused:
        t, code = five_cells()
        more = next(c for c in (int(code[4]) ^ np.arange(1, 8)).tolist() if c not in code)
        return _other_cells(t, np.unique(np.append(code, more)), "positions.count")

    add("invalid", "count-one-more", "a tree with a cell more, at its last level", sibling, "tree-count")

    add(
        "invalid",
        "count-many-more",
        "a tree with more nodes than anchors from its first levels on, which are dropped",
        lambda: overgrown(five_cells()[0], 3),
        "tree-count tree-dropped",
    )
    add(
        "invalid",
        "cell-of-no-f16",
        "a cell whose integer has more bits than an f16",
        lambda: _other_cells(five_cells()[0], np.append(five_cells()[1][:4], (1 << 48) - 1), "positions.cell"),
        "cell-ends",
    )

    def index() -> Refused:
        where = of_cells(MIDDLE + np.array([[0, 0, 0], [1, 2, 3], [0x7BFF, 0x7BFF, 0x7BFF]]), 40)
        t = Target(codec.emit(placed("refused-index", where, shift=40)))
        code = chunk_codes(where, 40)
        assert code is not None
        return _other_cells(t, np.append(code[:2], (1 << 48) - 1), "positions.cell")

    add("invalid", "cell-infinite", "a cell that counts to where infinity would be", index, "cell-index half-limits")

    def overflow() -> Refused:
        where = of_cells(MIDDLE + np.array([[0, 0, 0], [1, 0, 0]]), 39)
        t = Target(codec.emit(placed("refused-overflow", where, shift=39)))
        codes = chunk_codes(where, 39)
        assert codes is not None
        # 2 * 2^39 is one more than the largest f16.
        two = np.array([int(codes[0]), int(codes[0]) | 1 << 3])
        return _other_cells(t, two, "positions.cell")

    add("invalid", "cell-overflow", "a cell beyond the largest f16", overflow, "cell-ends half-limits")
