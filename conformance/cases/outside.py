"""Files that the wrong decoders of an outside reader asked for, which all other vectors let pass."""

from __future__ import annotations

import copy
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from refcodec.bitstream import codec, directory, header, syntax
from refcodec.bitstream.entropy import Encoder
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import PACKED, chunk_codes, code_cells, encode_positions
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import tables

from .book import Book, Make, Refused
from .files import Target, grid_layers, position_parts, repair, resized, with_positions, with_stream
from .numbers import Int64, Numbers
from .orders import Changes, Fault, both
from .packing import MIDDLE, any_model, of_cells, placed, sharp_model
from .refused_header import main_file, packed, plain
from .refused_sections import FLOATS, grids, other_grids
from .refused_streams import ONE, far, stream_of
from .sampling import Sampler, sampled
from .scenes import SMALL, SMALLEST, constant, lattice, packed_weights, scales, scene, settled, with_symbols


def add(book: Book) -> None:
    """Adds the vectors."""
    _numbers(book)
    _lengths(book)
    _header(book)
    _layers(book)
    _chunks(book)


def _ordered(book: Book, klass: str, name: str, text: str, make: Make, requirements: str = "") -> None:
    """Adds a file with two faults."""
    needed = f"D10.1-1 {requirements}"
    book.add(f"{klass}-order-of-{name}", text, make, features="order", requirements=needed, flags="order-of-checks")


# --- numbers ----------------------------------------------------------------------------------------------------------


def _numbers(book: Book) -> None:
    def tiny() -> Scene:
        # The shift that makes them integers is wider than a register, or would be without the row's exponent.
        units = [-64, -70, -77, -84, -87, -90, -96, -100, -104, -107, -116, -126, -127, -138, -149]
        significands = [1, -3, (1 << 24) - 1, 1 - (1 << 24), (1 << 23) + 1, -(1 << 23) - 1]
        numbers = Numbers("outside-tiny")
        made = scene("outside-tiny", 4, SMALL)
        for name in ("hyper", "sarm", "carm.1"):
            for layer in made.networks[name]:
                for values in layer:
                    small = np.ldexp(
                        numbers.chosen(significands, *values.shape).astype(np.float32),
                        numbers.chosen(units, *values.shape),
                    )
                    values[:] = np.where(numbers.integers(0, 2, *values.shape) == 0, small.astype(np.float32), values)
        return sampled(made, Sampler(numbers))

    book.valid(
        "weights-tiny",
        "weights and biases of 2^-40 to 2^-149 among others, which round to 0",
        tiny,
        features="networks raw-weights",
        requirements="D7.2-1",
        flags="shift-too-far subnormals weight-rounding",
    )

    def rounded() -> Scene:
        # The product is next to a tie of binary32, on which binary64 rounds it.
        zero = np.zeros(ONE.attribute_width, np.int64)
        numbers = Numbers("outside-rounded")
        made = scene(
            "outside-rounded", 2, ONE, networks=constant(ONE, numbers, zero, zero + 160), masks=np.ones((2, 1), bool)
        )
        made.networks["hyper"][-1][1][-3:] = 63
        made = replace(made, base_step=(14832217 * 2.0**-24, 14832217 * 2.0**-30, 14832217 * 2.0**-20))
        y = 8388555 * np.array([[1], [-1]])
        return with_symbols(
            made,
            features=y,
            scalings=np.repeat(y, 6, axis=1),
            offsets=np.repeat(y, 3, axis=1)[:, None, :],
        )

    book.valid(
        "values-of-69-bits",
        "values just beside a tie, which binary64 takes for one",
        rounded,
        features="reconstruction",
        requirements="D9.2-1",
        flags="value-rounding",
    )
    for name, text, scale, value in (
        ("2-32-and-5", "2^32 and 5", 160, (1 << 32) + 5),
        ("minus-2-33-and-7", "-2^33 and 7", 160, 7 - (1 << 33)),
        ("2-32-less-9", "2^32 less 9", 80, (1 << 32) - 9),
    ):

        def wraps(scale: int = scale, value: int = value) -> Refused:
            t = far(0, scale)
            stream = stream_of(t, "attributes")
            encoder, gauss, none = Encoder(1, 1), tables().gauss, np.zeros(6, np.int64)

            def told(_: int, index: int) -> str:
                return str(index)

            # The encoder's CRC-32 is that of the value in 32 bits: who computes it so finds nothing wrong.
            encoder.values(gauss, none[:1], none[:1] + scale, [1], 1 << 40, told, np.array([value]))
            encoder.values(gauss, none, none - 40, [6], 1 << 40, told, none)
            return Refused(with_stream(t, stream, encoder.finish()[0]), "substream.symbol_range", stream[1])

        book.add(
            f"invalid-symbol-wraps-{name}",
            f"an escaped symbol of {text}, which is a small one in 32 bits",
            wraps,
            features="escapes raw-bits substream",
            requirements="D8.5-1 D8.8-2",
            flags="symbol-wraps symbol-limit",
        )

    def least() -> Scene:
        made = scene("outside-least", 2, SMALLEST, lanes=Lanes(0, 0, 1))
        for name, tiny in (("hyper", 2.0**-149), ("opacity", 2.0**-149), ("colour", (2.0**23 - 1) * 2.0**-149)):
            w, b = made.networks[name][0]
            w[:], b[:] = 1, 1
            w[0, 0] = tiny
        return packed_weights(settled(made))

    book.valid(
        "grids-raw-subnormal",
        "layers that are raw because of one subnormal number",
        least,
        features="packed-weights",
        requirements="D7.13-1 R6.8-7",
        flags="subnormals raw-layer grid-exponent",
    )


# --- lengths and counts -----------------------------------------------------------------------------------------------


@cache
def _empty() -> Target:
    """A file in mode 1 without anchors."""
    return Target(codec.emit(scene("outside-empty", 0, SMALLEST, position_model=sharp_model({}))))


def _joined(t: Target, content: dict[int, bytes], anchors: int) -> bytes:
    """The file with so many anchors, all in one chunk, and with other sections; content: by type, in their order."""
    fields = copy.deepcopy(t.fields)
    fields.anchor_count, fields.chunk_size = anchors, max(anchors, fields.chunk_size)
    at = t.header_end
    for entry in fields.directory:
        entry.offset, entry.length = at, len(content[entry.type])
        at += entry.length
    return repair(t.data[: header.PROLOGUE_BYTES] + syntax.build("Header", fields) + b"".join(content.values()))


def _crowd() -> Refused:
    """A file of Main whose only chunk has 65536 anchors; what follows the positions is missing."""
    t = main_file()
    lanes = 1 << codec.parse(t.data).scene.lanes.mask
    cells = (
        np.stack(np.meshgrid(np.arange(16), np.arange(64), np.arange(64), indexing="ij"), axis=-1).reshape(-1, 3)
        + MIDDLE
    )
    # Models that know no cuboid, for a byte stands for 16 anchors at most.
    model = replace(any_model(Numbers("outside-crowd")), cell_shift=22)
    part = encode_positions(model, of_cells(cells, 22), [range(len(cells))], lanes)[0]
    content = {kind: t.content(kind) for kind in directory.SECTIONS}
    numbers = struct.pack("<B288H", model.cell_shift, *model.frequency.reshape(-1).tolist())
    entry = struct.pack("<6I", len(part), 0, 1, 0, 0, 0)
    content[directory.CHUNK_TABLE] = content[directory.CHUNK_TABLE][: -len(numbers)] + numbers + entry
    content[directory.POSITIONS], content[directory.MASKS] = part, b"\0"
    data = bytearray(_joined(t, content, len(cells)))
    masks = len(data) - 1
    # The CRC-32 of the masks in the entry, which ends where the positions begin.
    data[masks - len(part) - 12] ^= 1
    return Refused(repair(bytes(data), chunks=False), "chunks.crc", masks)


def _lengths(book: Book) -> None:
    def short() -> Scene:
        # The last chunk is one anchor, and has far fewer bytes than a sixteenth of the others' anchors.
        zero = np.zeros(SMALLEST.attribute_width, np.int64)
        found = constant(SMALLEST, Numbers("outside-short"), zero, zero - 40)
        where = lattice(Numbers("outside-short"), 601)
        made = placed(
            "outside-short", where, chunk_size=600, networks=found, masks=np.zeros((601, 1), bool), lanes=Lanes(0, 0, 0)
        )
        made = with_symbols(
            made, features=np.zeros((601, 1)), scalings=np.zeros((601, 6)), offsets=np.zeros((601, 1, 3))
        )
        _, length, anchors = position_parts(Target(codec.emit(made)))[-1]
        assert anchors == 1
        assert 16 * length < made.chunk_size
        return made

    book.valid(
        "cells-short-chunk",
        "a last chunk of one anchor, in fewer bytes than a sixteenth of chunk_size",
        short,
        features="packed-positions chunks",
        requirements="R6.10-2",
        flags="last-chunk",
    )
    book.add(
        "malformed-chunk-of-65536-anchors",
        "a packed chunk of as many anchors as there can be, and a wrong CRC-32 behind it",
        _crowd,
        features="packed-positions chunks main",
        requirements="D7.12-1",
        flags="count-in-16-bits",
    )
    for kind in directory.CHUNKED:

        def filled(kind: int = kind) -> Refused:
            t = _empty()
            content = {other: b"\0" if other == kind else t.content(other) for other in directory.SECTIONS}
            return Refused(_joined(t, content, 0), "chunks.length", t.start(kind))

        name = directory.SECTIONS[kind]
        book.add(
            f"malformed-empty-{name}-of-1-byte",
            f"no anchors, and a byte of {name}",
            filled,
            features="empty chunks",
            requirements="R11.2-2",
            flags="empty-sections",
        )

    def sixteenfold() -> Refused:
        t = packed()
        return Refused(
            repair(t.put(t.entries, struct.pack("<I", 1 << 28)), chunks=False),
            "chunks.length",
            t.start(directory.POSITIONS),
        )

    book.add(
        "malformed-chunks-position-wraps",
        "a position_length of which sixteen times is 2^32",
        sixteenfold,
        features="chunks packed-positions",
        flags="sum-wraps lengths-trusted",
    )
    for name, text, layer, length in (
        ("before-model", "before a layer's model", 3, 0),
        ("in-exponent", "within the exponent of a layer", 3, 2),
        ("in-last-model", "within the model of the last layer", -1, 3),
    ):

        def cut(layer: int = layer, length: int = length) -> Refused:
            t = grids()
            start = t.start(directory.WEIGHTS)
            end = list(grid_layers(t).values())[layer] - start + length
            return Refused(
                resized(t.data, directory.WEIGHTS, t.content(directory.WEIGHTS)[:end]), "weights.length", start
            )

        book.add(
            f"malformed-grids-cut-{name}",
            f"the weights end {text}, and the bytes of the planes make none",
            cut,
            features="packed-weights",
            flags="truncation lengths-trusted",
        )


# --- header and directory ---------------------------------------------------------------------------------------------


def _header(book: Book) -> None:
    def two(
        name: str, text: str, first: tuple[str, str, int], second: tuple[str, str, int], told: str | None = None
    ) -> None:
        def make() -> Refused:
            c = Changes(main_file())
            return both(c.t, c.field(*first, "header.dimension", told), c.field(*second, "header.dimension"))

        _ordered(book, "invalid", name, text, make, "R11.1-2")

    channels, width = ("dimensions.plane_channels", "B", 7), ("dimensions.render_width", "B", 49)
    slices, size = ("dimensions.slice_width[3]", "B", 19), ("dimensions.plane_size", "<H", 200)
    two("channels-and-slices", "plane_channels, and slices that are not those of Main", channels, slices)
    two("render-width-and-slices", "render_width, and slices that are not those of Main", width, slices)
    two("render-width-and-plane-size", "render_width, and a plane_size that the level does not allow", width, size)
    two(
        "slices-and-plane-size",
        "slices that are not those of Main, and a plane_size that the level does not allow",
        slices,
        size,
        "dimensions.slice_width[0]",
    )

    def offset_and_length() -> Refused:
        t = plain()
        data = bytearray(t.data)
        for entry in range(6):
            # Entries 1 to 5 follow the longer frame, entry 6 does not.
            at = t.at(f"directory[{entry}].{'offset' if entry else 'length'}")
            struct.pack_into("<I", data, at, struct.unpack_from("<I", data, at)[0] + 1)
        return Refused(repair(bytes(data), chunks=False), "directory.offset", t.at("directory[6].offset"))

    _ordered(
        book,
        "malformed",
        "late-offset-and-frame-length",
        "the offset of a late section, and the length of the frame",
        offset_and_length,
        "R6.6-4 R6.6-5",
    )


# --- weights ----------------------------------------------------------------------------------------------------------


@cache
def _two_raw() -> Target:
    """A file in mode 1 whose layers hyper.0 and opacity.0 are raw."""
    made = scene("outside-two-raw", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    for name in ("hyper", "opacity"):
        made.networks[name][0][1][0] = -0.0
    found = settled(made)
    return Target(codec.emit(replace(found, weight_scales=scales(found.networks))))


def _layers(book: Book) -> None:
    for first, second in ((0, 2), (1, 2)):

        def shifts(first: int = first, second: int = second) -> Refused:
            c = Changes(plain())
            at = c.t.start(directory.WEIGHTS)
            fields = {0: b"\x0b", 1: b"\0", 2: b"\x11"}
            return both(
                c.t,
                c.put(at + first, fields[first], "weights.scale"),
                c.put(at + second, fields[second], "weights.scale"),
            )

        name = "plane-shift" if first == 0 else "carm-input-count"
        text = name.replace("-", "_")
        _ordered(book, "invalid", f"{name}-and-carm-shift", f"{text} and carm_shift", shifts, "R6.8-1")
    for name, text, offset, value in (
        ("exponent", "an exponent of 5", 1, struct.pack("<h", 5)),
        ("large-exponent", "an exponent of 999", 1, struct.pack("<h", 999)),
        ("weight-scale", "a scale of weights", 4, b"\5"),
    ):

        def field(offset: int = offset, value: bytes = value) -> Refused:
            t = grids()
            at = next(iter(grid_layers(t).values()))
            data = t.put(at + offset, value)[t.start(directory.WEIGHTS) : at + 9]
            return Refused(resized(t.data, directory.WEIGHTS, data), "weights.layer", at + offset)

        _ordered(
            book,
            "invalid",
            f"raw-{name}-and-values",
            f"{text} in a raw layer, and the end within its values",
            field,
            "R6.8-4 R6.8-5",
        )

    def fault(kind: str, network: str) -> Fault:
        """A fault of the first layer of a network, which is raw."""
        t = _two_raw()
        at = grid_layers(t)[f"{network}.0"]
        out, fan_in = t.header.dimensions.network_shapes()[network][0]
        if kind == "not-finite":
            return Fault(at + 6, FLOATS["not-a-number"], "weights.not_finite", at + 6)
        if kind == "bound":
            return Fault(at + 6, struct.pack("<f", 4096.0), "weights.bound", at)
        # Without its -0 the layer can be packed.
        return Fault(at + 6 + 4 * out * fan_in, bytes(4), "weights.raw", at)

    def with_exponent(layer: str, other: Fault, first: bool) -> Refused:
        """The file with a packed layer whose integers are all even, and a fault of a raw one, which is told if it is first."""

        def change(found: list[Any]) -> int:
            number = list(grid_layers(_two_raw())).index(layer)
            g = found[number]
            found[number] = replace(g, weight=g.weight * 2, bias=g.bias * 2)
            return number

        refused = other_grids(_two_raw(), change)
        data = refused.data[: other.at] + other.value + refused.data[other.at + len(other.value) :]
        return Refused(repair(data), *((other.name, other.offset) if first else (refused.name, refused.offset)))

    rows: list[tuple[str, str, Callable[[], Refused]]] = [
        (
            "raw-and-not-finite",
            "a raw layer that can be packed, and a later one with a number that is none",
            lambda: both(_two_raw(), fault("raw", "hyper"), fault("not-finite", "opacity")),
        ),
        (
            "not-finite-and-raw",
            "a raw layer with a number that is none, and a later one that can be packed",
            lambda: both(_two_raw(), fault("not-finite", "hyper"), fault("raw", "opacity")),
        ),
        (
            "exponent-and-not-finite",
            "an exponent, and a later raw layer with a number that is none",
            lambda: with_exponent("hyper.1", fault("not-finite", "opacity"), False),
        ),
        (
            "not-finite-and-exponent",
            "a raw layer with a number that is none, and an exponent of a later one",
            lambda: with_exponent("hyper.1", fault("not-finite", "hyper"), True),
        ),
        (
            "raw-and-bound",
            "a raw layer that can be packed, and an earlier one that breaks the bound",
            lambda: both(_two_raw(), fault("raw", "opacity"), fault("bound", "hyper")),
        ),
        (
            "exponent-and-bound",
            "an exponent, and an earlier raw layer that breaks the bound",
            lambda: with_exponent("colour.0", fault("bound", "hyper"), False),
        ),
    ]
    for name, text, make in rows:
        _ordered(book, "invalid", f"layers-{name}", text, make, "R6.8-2 R6.8-3 R6.8-6 R6.8-7")


# --- chunks -----------------------------------------------------------------------------------------------------------


@cache
def _idle_cells() -> tuple[Target, Int64]:
    """A file of five anchors in one packed chunk of 16 lanes, and the codes of their cells."""
    made = placed("outside-cells", lattice(Numbers("outside-cells"), 5), chunk_size=5, lanes=Lanes(0, 4, 0))
    code = chunk_codes(made.positions, made.position_model.cell_shift if made.position_model else 0)
    assert code is not None
    return Target(codec.emit(made)), code


def _fewer(change: Callable[[bytearray], None], name: str) -> Refused:
    """The file with a tree of four cells, whose substream is changed."""
    t, code = _idle_cells()
    made = codec.parse(t.data).scene
    assert made.position_model is not None
    encoder = Encoder(1, 1 << made.lanes.mask)
    code_cells(encoder, made.position_model.models(), [0], [4], code[:4])
    content = bytearray(encoder.finish()[0])
    change(content)
    return Refused(
        with_positions(t, 0, bytes([PACKED]) + bytes(content)), f"substream.{name}", t.start(directory.POSITIONS) + 1
    )


def _chunks(book: Book) -> None:
    def models() -> Refused:
        t = packed()
        data, first = bytearray(t.data), t.position_model + 1
        values = list(struct.unpack_from("<16H", data, first))
        values[int(np.argmax(values))] += values[9]
        values[9] = 0
        struct.pack_into("<16H", data, first, *values)
        other = first + 32
        values = list(struct.unpack_from("<16H", data, other))
        values[int(np.argmax(values))] += 1
        struct.pack_into("<16H", data, other, *values)
        return Refused(repair(bytes(data)), "chunks.position_model", first)

    text = "a frequency of 0 in the first model, and a wrong sum of the second"
    _ordered(book, "invalid", "frequency-and-later-sum", text, models, "R6.10-4")
    for column, base in ((0, packed), (1, plain)):

        def sums(column: int = column, base: Callable[[], Target] = base) -> Refused:
            t = base()
            data = bytearray(t.data)
            for at in (t.entries + 8 * column, t.entries + 8 * column + 8):
                struct.pack_into("<I", data, at, struct.unpack_from("<I", data, at)[0] + 1)
            return Refused(repair(bytes(data), chunks=False), "chunks.length", t.start(directory.CHUNKED[column]))

        here, next_one = (directory.SECTIONS[kind] for kind in directory.CHUNKED[column : column + 2])
        text = f"the lengths of the {here}, and those of the {next_one}"
        _ordered(book, "malformed", f"sum-of-{here}-and-{next_one}", text, sums, "R6.10-2")

    def crc_and_form() -> Refused:
        t = packed()
        raw = next(at for at, _, _ in position_parts(t) if t.data[at] == 0)
        return Refused(repair(t.put(raw, b"\2"), chunks=False), "chunks.crc", raw)

    text = "the CRC-32 of a chunk of positions, and its form"
    _ordered(book, "malformed", "chunk-crc-and-form", text, crc_and_form, "R6.10-3 R6.11-3")

    def mask_crc_behind() -> Refused:
        t = plain()
        stream = stream_of(t, "masks")
        data = bytearray(repair(t.put(stream[1], bytes([t.data[stream[1]] ^ 1]))))
        data[t.entries + 24 + 12] ^= 1
        return Refused(repair(bytes(data), chunks=False), "substream.symbol_crc", stream[1])

    text = "the symbols of chunk 0 of the masks, and the CRC-32 of chunk 1"
    _ordered(book, "invalid", "masks-and-chunk-crc", text, mask_crc_behind)

    def crc(content: bytearray) -> None:
        content[0] ^= 1

    def word(content: bytearray) -> None:
        content[4:8] = struct.pack("<I", struct.unpack_from("<I", content, 4)[0] + 1)
        content += bytes(2)

    def state(content: bytearray) -> None:
        # The last lane has no symbol.
        content[8 + 4 * 15 : 8 + 4 * 16] = struct.pack("<I", (1 << 16) + 1)

    def raw(content: bytearray) -> None:
        content += bytes(1)

    for name, what, change in (
        ("words", "a word that no lane takes", word),
        ("final_state", "a lane that does not end at 2^16", state),
        ("raw_length", "a raw byte that nothing reads", raw),
        ("symbol_crc", "a CRC-32 of other symbols", crc),
    ):
        _ordered(
            book,
            "invalid",
            f"{name.replace('_', '-')}-and-cells",
            f"{what}, and a cell less than there are anchors",
            lambda change=change, name=name: _fewer(change, name),  # type: ignore[misc]
            "R6.11-5 D8.8-2",
        )
