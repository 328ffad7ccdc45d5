"""Files that single planted bugs asked for (conformance/mutants): each tells one wrong decoder from a right one."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec, directory
from refcodec.bitstream.attributes import code_attributes
from refcodec.bitstream.chunks import chunk_ranges
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.entropy import Encoder, SymbolName, select
from refcodec.bitstream.header import Lanes, PositionGrid
from refcodec.bitstream.positions import cell_positions
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.tables import ModelSet

from .book import Book, Refused
from .decoding import ROWS, SEEN, f16, frame, shown
from .files import Target, grid_layers, lanes_of, position_parts, repair, resized, with_positions, with_stream
from .numbers import Int64, Numbers
from .packing import MIDDLE, any_model, placed
from .refused_header import main_file, packed, plain
from .refused_sections import grids, other_grids
from .refused_streams import far, stream_of, words_of
from .sampling import Sampler, sampled
from .scenes import SMALL, SMALLEST, dyadic, networks, packed_weights, scene


def add(book: Book) -> None:
    """Adds the vectors."""
    _header(book)
    _weights(book)
    _sections(book)
    _positions(book)
    _valid(book)
    _substreams(book)


def _header(book: Book) -> None:
    def two(
        name: str, text: str, error: str, first: tuple[str, str, float], second: tuple[str, str, float], klass: str
    ) -> None:
        def make() -> Refused:
            t = plain()
            data = bytearray(t.data)
            for path, form, value in (first, second):
                struct.pack_into(form, data, t.at(path), value)
            return Refused(repair(bytes(data)), error, t.at(first[0]))

        book.add(
            f"{klass}-order-of-{name}",
            text,
            make,
            features="order header",
            requirements="D10.1-1",
            flags="order-of-checks",
        )

    two(
        "reserved-and-grid",
        "reserved_0, and the grid's reserved",
        "header.reserved",
        ("reserved_0", "B", 1),
        ("position_grid.reserved", "B", 1),
        "malformed",
    )
    two(
        "width-and-height",
        "camera_width and camera_height are 0",
        "header.render_info",
        ("render_info.camera_width", "<H", 0),
        ("render_info.camera_height", "<H", 0),
        "invalid",
    )
    for name, text, value in (("lengths-infinite", "infinite", math.inf), ("lengths-zero", "0", 0.0)):
        two(
            name,
            f"near_plane and distance_unit are {text}",
            "header.render_info",
            ("render_info.near_plane", "<f", value),
            ("render_info.distance_unit", "<f", value),
            "invalid",
        )

    def largest() -> Refused:
        t = main_file()
        data = bytearray(t.data)
        for path, form, value in (
            ("level", "B", 2),
            ("dimensions.plane_size", "<H", 256),
            ("dimensions.hyper_width[0]", "B", 128),
            ("dimensions.carm_width[0]", "B", 128),
            ("chunk_size", "<I", 65536),
        ):
            struct.pack_into(form, data, t.at(path), value)
        return Refused(repair(bytes(data))[: t.header_end], "directory.file_length", t.header_end)

    book.add(
        "malformed-main-largest-cut",
        "a header of Main with the largest dimensions, of a level that its planes alone need, and nothing behind it",
        largest,
        features="header main dimensions",
        requirements="R11.1-2 R11.1-3 R11.2-2 R11.2-3",
        flags="level-limits level-not-minimal truncation",
    )


# --- weights in mode 1 ------------------------------------------------------------------------------------------------


def _with_raw_layer(name: str, layer: int = 0) -> tuple[Target, int]:
    """A file in mode 1 with one raw layer, of the colour network, and where its model is."""
    made = scene(f"planted-{name}", 2, SMALLEST, lanes=Lanes(0, 0, 1))
    made.networks["colour"][layer][1][0] = -0.0
    t = Target(codec.emit(packed_weights(made)))
    return t, grid_layers(t)[f"colour.{layer}"]


def _weights(book: Book) -> None:
    def cut() -> Refused:
        t, at = _with_raw_layer("cut", 1)
        start = t.start(directory.WEIGHTS)
        return Refused(
            resized(t.data, directory.WEIGHTS, t.content(directory.WEIGHTS)[: at + 15 - start]), "weights.length", start
        )

    book.add(
        "malformed-grids-cut-in-last-values",
        "the section ends within the values of its last layer, which is raw",
        cut,
        features="packed-weights",
        flags="truncation lengths-trusted",
    )

    def scaled() -> Refused:
        made = scene("planted-scaled", 2, replace(SMALLEST, render_width=2), lanes=Lanes(0, 0, 1))
        w, b = made.networks["opacity"][0]
        w[0], b[0], w[1], b[1] = 0, -0.0, 0, 0
        w[0, 0], w[1, 0] = (1 << 24) - 1, 2.0**-30
        t = Target(codec.emit(packed_weights(made)))
        at = grid_layers(t)["opacity.0"]
        # The raw layer without its -0: each row can be packed with an exponent of its own.
        return Refused(repair(t.put(at + 6 + 4 * w.size, bytes(4))), "weights.raw", at)

    book.add(
        "invalid-grids-raw-at-the-limit",
        "a raw layer with the largest integer in one row, and a far smaller number in another",
        scaled,
        features="packed-weights",
        requirements="D7.13-1",
        flags="canonical-form raw-layer limit-off-by-one",
    )

    def last_bias() -> Scene:
        made = scene("planted-last-bias", 2, replace(SMALLEST, render_width=3), lanes=Lanes(0, 0, 1))
        w, b = made.networks["opacity"][0]
        w[:], b[:] = 1, 1
        b[2] = 2.0**-24
        return packed_weights(made)

    book.valid(
        "grids-last-bias",
        "a layer that is raw because of its last bias alone",
        last_bias,
        features="packed-weights",
        requirements="R6.8-7 D7.13-1",
        flags="raw-layer grid-exponent",
    )

    def even() -> Refused:
        def change(layers: list[Any]) -> int:
            weight, bias = layers[1].weight.copy(), layers[1].bias.copy()
            weight[0], bias[0] = weight[0] * 2, bias[0] * 2
            weight[1, 0] |= 1
            layers[1] = replace(layers[1], weight=weight, bias=bias)
            return 1

        return other_grids(grids(), change)

    book.add(
        "invalid-exponent-even-first",
        "a first row whose integers are all even, odd ones behind it",
        even,
        features="packed-weights",
        requirements="D7.13-1",
        flags="grid-exponent",
    )


# --- planes, chunk table, positions -----------------------------------------------------------------------------------


def _sections(book: Book) -> None:
    def nearly_nothing() -> Refused:
        t = Target(codec.emit(scene("planted-empty", 0, SMALLEST)))
        kind = directory.PLANES_SECTION
        return Refused(resized(t.data, kind, t.content(kind)[:3]), "planes.length", t.start(kind))

    book.add(
        "malformed-planes-of-3-bytes",
        "three bytes of planes, and few bytes behind them",
        nearly_nothing,
        features="planes empty",
        flags="truncation",
    )

    def wraps() -> Refused:
        t = plain()
        data = bytearray(t.data)
        for entry in (0, 1):
            at = t.entries + 24 * entry + 8
            struct.pack_into("<I", data, at, struct.unpack_from("<I", data, at)[0] + (1 << 31))
        return Refused(repair(bytes(data), chunks=False), "chunks.length", t.start(directory.MASKS))

    book.add(
        "malformed-chunks-mask-wraps",
        "mask lengths that add up modulo 2^32",
        wraps,
        features="chunks",
        flags="lengths-trusted sum-wraps",
    )

    def crc_of_next() -> Refused:
        t = plain()
        stream = stream_of(t, "attributes")
        data = bytearray(repair(t.put(stream[1], bytes([t.data[stream[1]] ^ 1]))))
        data[t.entries + 24 + 20] ^= 1
        return Refused(repair(bytes(data), chunks=False), "substream.symbol_crc", stream[1])

    book.add(
        "invalid-order-of-attributes-and-chunk-crc",
        "the symbols of chunk 0, and the CRC-32 of chunk 1",
        crc_of_next,
        features="order",
        requirements="D10.1-1",
        flags="order-of-checks",
    )


def _raw_chunk(name: str, where: NDArray[np.float16], shift: int) -> Refused:
    """The positions of the only chunk, raw for nothing."""
    t = Target(codec.emit(placed(f"planted-{name}", where, any_model(Numbers(f"planted-{name}")), shift)))
    return Refused(
        with_positions(t, 0, b"\0" + where.astype("<f2").tobytes()), "positions.raw", t.start(directory.POSITIONS)
    )


def _positions(book: Book) -> None:
    def form() -> Refused:
        t = packed()
        raw = next(at for at, _, _ in position_parts(t) if t.data[at] == 0)
        return Refused(repair(t.put(raw, b"\2")), "positions.form", raw)

    book.add(
        "malformed-form-2-of-raw-length",
        "form 2, with as many bytes as a raw chunk has",
        form,
        features="packed-positions",
        flags="form-unchecked",
    )
    line = np.zeros((2, 3), np.float16)

    def along(axis: int, *values: float) -> NDArray[np.float16]:
        found = line.copy()
        found[:, axis] = values
        return found

    flat = cell_positions(MIDDLE + np.array([[1, 0, 0], [0, 1, 0]]), 22)[0]
    for name, text, where, shift in (
        ("negative", "cells of negative numbers, counted", along(0, -2, -1), 40),
        ("x-before-y", "a step along x before one along y", flat, 22),
        ("lowest", "the lowest cell of a lattice", along(0, -32, -31), 14),
    ):
        book.add(
            f"invalid-raw-{name}",
            f"a raw chunk that can be packed: {text}",
            lambda n=name, w=where, s=shift: _raw_chunk(n, w, s),  # type: ignore[misc]
            features="packed-positions",
            requirements="D7.12-1",
            flags="raw-chunk cell-ends cell-index axes-swapped",
        )
    # In order along y too, whatever a decoder makes of the coordinate x that has no cell.
    beyond = along(0, 0, 32)
    beyond[1, 1] = 2.0**-10
    book.valid(
        "cells-beyond",
        "a coordinate just above the highest cell of a lattice: the chunk is raw",
        lambda: placed("planted-beyond", beyond, any_model(Numbers("planted-beyond")), 14),
        features="packed-positions",
        requirements="D7.12-1 R6.11-4",
        flags="cell-ends raw-chunk",
    )


# --- the decoding process ---------------------------------------------------------------------------------------------


def _valid(book: Book) -> None:
    def exponent() -> Scene:
        numbers = Numbers("planted-exponent")
        found = networks(ROWS, numbers)
        w, b = found["hyper"][-1]
        total = ROWS.attribute_width
        # At the exponent 20 this bias is 2^19 - 1, which rounds to 0; at 19 it would be 2^18, which rounds to 1.
        w[:total], b[:total] = 0, 0.5 - 2.0**-20
        return sampled(scene("planted-exponent", 12, ROWS, networks=found), Sampler(numbers, 0))

    book.valid(
        "network-largest-exponent",
        "biases that only the largest exponent rounds down",
        exponent,
        features="networks",
        requirements="D7.2-1",
        flags="exponent-limit",
    )

    still = np.zeros((3, 3), np.int64)
    where = f16(np.zeros((4, 3), np.int64))
    # A length just below a whole number, where a square root in binary64 is that number.
    side = 44720
    # A sum just below a tie, which binary64 takes for one; and one below the clamp, where both limits of 31 bits differ.
    for name, text, translation, shift, low, high, requirement, flags in (
        (
            "root",
            "a length whose square is just below a square",
            (side * side // 2, side, 0),
            (0, 0, 0),
            (131060, -9, -9),
            (131076, 9, 9),
            "D7.5.2-1",
            "contraction-rounding",
        ),
        (
            "sum",
            "a frame sum that needs more than 53 bits",
            ((16384 << 45) + (1 << 44) - 1, 0, 0),
            (45, 0, 0),
            (16380, -9, -9),
            (16388, 9, 9),
            "D7.5.1-1",
            "sum-width frame-rounding",
        ),
        (
            "lowest",
            "a frame coordinate that is clamped from below, alone",
            (-(1 << 40), 0, 0),
            (0, 0, 0),
            (-131076, -9, -9),
            (-131060, 9, 9),
            "D7.5.1-1",
            "frame-clamp",
        ),
    ):

        def make(
            name: str = name, translation: Any = translation, shift: Any = shift, low: Any = low, high: Any = high
        ) -> Scene:
            return shown(f"planted-{name}", where, frame(still, translation, shift, low, high))

        book.valid(
            f"frame-exact-{name}",
            text,
            make,
            features="frame contraction",
            requirements=f"{requirement} D7.5-1",
            flags=flags,
        )

    def top() -> Scene:
        d = replace(SEEN, slices=(16, 4), frequency_count=10, hyper_width=(48,))
        change = frame(np.eye(3, dtype=np.int64), low=(-9, -9, -9), high=(9, 9, 9))
        return shown("planted-top", f16(np.array([[0, 0, 9], [0, 0, 40], [3, 1, 8], [0, 0, -9]])), change, d)

    book.valid(
        "encoding-top",
        "anchors at the upper end of the third component, and ten frequencies",
        top,
        features="encoding",
        requirements="D7.5.3-1 D7.5.5-1",
        flags="rescale-ends",
    )

    def world() -> Scene:
        tie = (1 << 61) + (1 << 37)
        return scene(
            "planted-world",
            2,
            SMALLEST,
            grid=PositionGrid((tie + 1, -tie - 1, tie - 1), 1, 0),
            positions=f16(np.array([[0, 0, 0], [1, -1, 2]])),
        )

    book.valid(
        "position-grid-long",
        "world positions that are ties but for their last bit",
        world,
        features="position-grid reconstruction",
        requirements="D9.1-1",
        flags="world-rounding",
    )


# --- substreams -------------------------------------------------------------------------------------------------------


@dataclass
class Liar:
    """A coder that draws symbols, and codes others in the place of the first ones: what a decoder must take for a certain value.

    beyond: the first symbol is coded far beyond every limit, and is 0 for all that follows. endless: the first symbol (or the second, if
    both) is coded as an escape whose prefix is too long, and is one past the radius for all that follows.
    """

    encoder: Encoder
    sampler: Sampler
    beyond: bool
    endless: bool
    first: bool = True

    def values(
        self,
        models: ModelSet,
        mean: Int64,
        scale: Int64,
        counts: list[int],
        limit: int,
        name: SymbolName,
        given: Int64 | None,
    ) -> Int64:
        """A group of values."""
        found = self.sampler.values(models, mean, scale, counts, limit, name, given)
        coded = found.copy()
        if self.first:
            model, centre, raw = select(mean, scale)
            assert not raw.any()
            if self.beyond:
                found[0], coded[0] = 0, 1 << 24
            if self.endless:
                at = int(self.beyond)
                found[at] = coded[at] = centre[at] + models.radius[model[at]] + 1
        self.encoder.values(models, mean, scale, counts, 1 << 40, name, coded)
        if self.first and self.endless:
            # The escape's fields: a sign, and zeros where the prefix was.
            self.encoder.raw[0][-1] = np.array([0, 0]), np.array([1, 26])
        self.first = False
        return found

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """No symbols of these kinds are coded."""
        raise NotImplementedError


@cache
def _lied(beyond: bool, endless: bool) -> Refused:
    """A file of one anchor whose second slice depends on each bit of the first one."""
    d = Dimensions(1, (2, 8), 1, 1, 2, (2,), (1,), (3,), 1)
    numbers = Numbers(f"planted-liar-{beyond:d}{endless:d}")
    found = networks(d, numbers)
    found["hyper"] = [(w * 0, b * 0) for w, b in found["hyper"]]
    first, last = found["carm.1"]
    # Units for either sign of both symbols' sum; each unit changes mean and scale.
    first[0][:], first[1][:] = np.array([[1, 1], [-1, -1], [0, 0]]), 0
    last[0][:], last[1][:] = dyadic(numbers.integers(-9, 9, *last[0].shape) * 2 + 1, 0), 0
    made = scene(
        "planted-liar",
        1,
        d,
        networks=found,
        carm_shift=np.zeros(2, np.uint8),
        lanes=Lanes(0, 0, 0),
        masks=np.ones((1, 1), bool),
    )
    t = Target(codec.emit(made))
    coding, encoder = codec.Coding(made), Encoder(1, 1)
    code_attributes(
        Liar(encoder, Sampler(numbers, 0), beyond, endless),
        coding.model,
        coding.contexts(),
        made.masks,
        chunk_ranges(1, made.chunk_size),
    )
    stream = stream_of(t, "attributes")
    name = "substream.escape" if endless else "substream.symbol_range"
    return Refused(with_stream(t, stream, encoder.finish()[0]), name, stream[1])


def _substreams(book: Book) -> None:
    for name, text, beyond, endless, flags in (
        (
            "range-then-more",
            "a symbol beyond the limit, and others whose models depend on its being 0",
            True,
            False,
            "symbol-limit",
        ),
        (
            "escape-then-more",
            "an escape whose prefix is too long, and others whose models depend on it",
            False,
            True,
            "escape-unbounded",
        ),
        (
            "order-of-escape-and-range",
            "a symbol beyond the limit, and an escape whose prefix is too long",
            True,
            True,
            "order-of-checks",
        ),
    ):
        book.add(
            f"invalid-{name}",
            text,
            lambda b=beyond, e=endless: _lied(b, e),  # type: ignore[misc]
            features="substream escapes carm",
            requirements="D8.8-1 D8.8-2 D10.1-1",
            flags=flags,
        )

    def at_the_end() -> Refused:
        t = far(1000)
        stream = stream_of(t, "attributes")
        return Refused(with_stream(t, stream, t.data[stream[1] : stream[1] + 5]), "substream.length", stream[1])

    book.add(
        "malformed-attributes-of-5-bytes",
        "the file ends within the head of its last substream",
        at_the_end,
        features="substream attributes",
        flags="truncation",
    )

    def wraps() -> Refused:
        t = plain()
        stream = stream_of(t, "attributes")
        count = words_of(t, stream)[0]
        return Refused(
            repair(t.put(stream[1] + 4, struct.pack("<I", count + (1 << 31)))), "substream.length", stream[1]
        )

    book.add(
        "malformed-words-wrap",
        "a word_count whose double is right modulo 2^32",
        wraps,
        features="substream",
        flags="sum-wraps lengths-trusted",
    )

    def words_and_state() -> Refused:
        made = scene("planted-idle", 3, SMALL, lanes=Lanes(0, 0, 8))
        t = Target(codec.emit(made))
        stream = stream_of(t, "attributes")
        count, _, raw_at = words_of(t, stream)
        idle = stream[1] + 8 + 4 * (lanes_of(t, stream[0]) - 1)
        part = bytearray(t.data[stream[1] : stream[1] + stream[2]])
        part[4:8] = struct.pack("<I", count + 1)
        part[idle - stream[1] : idle - stream[1] + 4] = struct.pack("<I", (1 << 16) + 1)
        part[raw_at - stream[1] : raw_at - stream[1]] = bytes(2)
        return Refused(with_stream(t, stream, bytes(part)), "substream.words", stream[1])

    book.add(
        "invalid-order-of-words-and-state",
        "a word that no lane takes, and a lane that does not end at 2^16",
        words_and_state,
        features="order substream",
        requirements="D8.8-2 D10.1-1",
        flags="order-of-checks",
    )
