"""Files with two faults: the first one in the order of checks (SPEC 10.1) counts, wherever in the file it is."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

from refcodec.bitstream import directory

from .book import Book, Refused
from .files import Target, grid_layers, position_parts, repair
from .refused_header import main_file, packed, plain
from .refused_sections import FLOATS, grids, value_at
from .refused_streams import escape_of, far, raw_of, stream_of, with_raw, words_of


@dataclass(frozen=True)
class Fault:
    """A fault as bytes at a place: changed before the checksums are repaired, or after that; name and offset of its error."""

    at: int
    value: bytes
    name: str
    offset: int
    after: bool = False


@dataclass
class Changes:
    """Faults of a file."""

    t: Target
    faults: list[Fault] = field(default_factory=list)

    def put(self, at: int, value: bytes, name: str, offset: int | None = None, after: bool = False) -> Fault:
        """A fault."""
        return Fault(at, value, name, at if offset is None else offset, after)

    def field(self, path: str, form: str, value: float, name: str, told: str | None = None) -> Fault:
        """An element of the header or the frame at another value."""
        return self.put(self.t.at(path), struct.pack(form, value), name, self.t.at(told or path))

    def wrong(self, at: int, name: str, offset: int, after: bool = False) -> Fault:
        """A byte changed."""
        return self.put(at, bytes([self.t.data[at] ^ 0x55]), name, offset, after)


def both(t: Target, first: Fault, second: Fault, chunks: bool = True) -> Refused:
    """The file with two faults, of which the first is to be told."""
    data = bytearray(t.data)
    for fault in (second, first):
        if not fault.after:
            data[fault.at : fault.at + len(fault.value)] = fault.value
    data = bytearray(repair(bytes(data), chunks))
    for fault in (second, first):
        if fault.after:
            data[fault.at : fault.at + len(fault.value)] = fault.value
    return Refused(bytes(data), first.name, first.offset)


Pair = Callable[[Changes], tuple[Fault, Fault]]


def add(book: Book) -> None:
    """Adds the vectors."""

    def pair(
        klass: str, name: str, text: str, make: Pair, base: Callable[[], Target] = plain, chunks: bool = True
    ) -> None:
        def made() -> Refused:
            t = base()
            return both(t, *make(Changes(t)), chunks)

        book.add(
            f"{klass}-order-of-{name}", text, made, features="order", requirements="D10.1-1", flags="order-of-checks"
        )

    _prologue(pair)
    _header(pair)
    _sections(pair)
    _streams(book, pair)


Add = Callable[..., None]


def _prologue(pair: Add) -> None:
    pair(
        "malformed",
        "signature-and-crc",
        "signature, and the prologue's CRC-32",
        lambda c: (c.put(0, b"\x88", "prologue.signature"), c.wrong(16, "prologue.crc", 16, True)),
    )
    pair(
        "malformed",
        "crc-and-version",
        "the prologue's CRC-32, and the version",
        lambda c: (
            c.put(8, b"\1", "prologue.crc", 16, True),
            c.put(12, b"\0\0\0\0", "prologue.header_length", after=True),
        ),
    )

    def version(c: Changes) -> tuple[Fault, Fault]:
        head = c.t.data[:8] + b"\1\0\0\0" + b"\0\0\0\0"
        return c.put(8, head[8:] + zlib.crc32(head).to_bytes(4, "little"), "prologue.version", after=True), c.wrong(
            30, "header.crc", 0, True
        )

    pair("unsupported", "version-and-header-length", "version 1, and a header_length of 0", version)

    def header_crc(c: Changes) -> tuple[Fault, Fault]:
        return c.wrong(c.t.header_end - 1, "header.crc", c.t.header_end - 4, True), c.field(
            "profile", "B", 9, "header.profile"
        )

    pair("malformed", "header-crc-and-profile", "the header's CRC-32, and the profile", header_crc)


def _header(pair: Add) -> None:
    rows: list[tuple[str, str, str, float, str]] = [
        ("malformed", "position_grid.reserved", "B", 1, "header.reserved"),
        ("unsupported", "profile", "B", 9, "header.profile"),
        ("unsupported", "level", "B", 9, "header.level"),
        ("invalid", "dimensions.render_width", "B", 0, "header.dimension"),
        ("invalid", "anchor_count", "<I", 5000, "header.anchor_count"),
        ("invalid", "chunk_size", "<I", 0, "header.chunk_size"),
        ("invalid", "attribute_lanes_log2", "B", 9, "header.lanes"),
        ("invalid", "base_step[2]", "<f", 0.0, "header.base_step"),
        ("invalid", "position_grid.scale_exponent", "b", 61, "header.position_grid"),
        ("invalid", "render_info.camera_height", "<H", 0, "header.render_info"),
        ("unsupported", "directory[8].type", "B", 0xC5, "directory.unknown_critical"),
        ("malformed", "directory[7].type", "B", 0, "directory.order"),
        ("unsupported", "directory[4].mode", "B", 2, "directory.mode"),
        ("malformed", "directory[1].offset", "<I", 3, "directory.offset"),
    ]
    for first, second in pairwise(rows):
        name = f"{first[4].partition('.')[2]}-and-{second[4].partition('.')[2]}".replace("_", "-")
        pair(
            first[0],
            name,
            f"{first[1]} and {second[1]}",
            lambda c, a=first, b=second: (c.field(*a[1:]), c.field(*b[1:])),
        )
    pair(
        "malformed",
        "reserved-and-profile-last-entry",
        "the last entry's reserved, and the profile",
        lambda c: (
            c.field("directory[8].reserved", "<H", 1, "header.reserved"),
            c.field("profile", "B", 9, "header.profile"),
        ),
    )
    pair(
        "malformed",
        "two-reserved",
        "reserved_1, and the grid's reserved and that of an entry",
        lambda c: (
            c.field("reserved_1", "B", 1, "header.reserved"),
            c.field("directory[0].reserved", "<H", 1, "header.reserved"),
        ),
    )
    pair(
        "invalid",
        "two-dimensions",
        "offset_count, and plane_channels",
        lambda c: (
            c.field("dimensions.offset_count", "B", 0, "header.dimension"),
            c.field("dimensions.plane_channels", "B", 0, "header.dimension"),
        ),
    )
    pair(
        "invalid",
        "anchors-and-level",
        "too many anchors, and a level that is too high",
        lambda c: (
            c.field("anchor_count", "<I", (1 << 20) + 1, "header.anchor_count"),
            c.field("level", "B", 2, "header.level_not_minimal"),
        ),
        main_file,
    )
    pair(
        "invalid",
        "level-and-chunk-size",
        "a level that is too high, and chunk_size",
        lambda c: (
            c.field("level", "B", 2, "header.level_not_minimal"),
            c.field("chunk_size", "<I", 1, "header.chunk_size"),
        ),
        main_file,
    )
    pair(
        "invalid",
        "two-grid-fields",
        "an origin, and scale_mantissa",
        lambda c: (
            c.field("position_grid.origin[2]", "<q", 1 << 62, "header.position_grid"),
            c.field("position_grid.scale_mantissa", "<H", 0, "header.position_grid"),
        ),
    )
    info = "header.render_info"
    pair(
        "invalid",
        "low-pass-and-near-plane",
        "low_pass is no number, near_plane is negative",
        lambda c: (
            c.field("render_info.low_pass", "<f", float("nan"), info),
            c.field("render_info.near_plane", "<f", -1.0, info),
        ),
    )
    pair(
        "invalid",
        "translation-and-focal",
        "camera_translation is no number, camera_focal is negative",
        lambda c: (
            c.field("render_info.camera_translation[2]", "<f", float("nan"), info, "render_info.camera_translation[0]"),
            c.field("render_info.camera_focal[0]", "<f", -1.0, info),
        ),
    )
    pair(
        "invalid",
        "size-and-focal",
        "camera_height is 0, camera_focal is no number",
        lambda c: (
            c.field("render_info.camera_height", "<H", 0, info),
            c.field("render_info.camera_focal[0]", "<f", float("nan"), info),
        ),
    )


def _sections(pair: Add) -> None:
    pair(
        "unsupported",
        "unknown-and-early-order",
        "an unknown critical section at the end, and the order of the first ones",
        lambda c: (
            c.field("directory[8].type", "B", 0x90, "directory.unknown_critical"),
            c.field("directory[0].type", "B", 0x82, "directory.order"),
        ),
    )
    pair(
        "malformed",
        "section-crc-and-frame",
        "the CRC-32 of the attributes, and the frame's range",
        lambda c: (
            c.wrong(len(c.t.data) - 8, "section.crc", c.t.start(directory.ATTRIBUTES), True),
            c.field("frame.matrix[0]", "<i", 1 << 20, "frame.range"),
        ),
    )
    pair(
        "invalid",
        "frame-items",
        "a translation, and the bounds",
        lambda c: (
            c.field("frame.translation[2]", "<q", 1 << 61, "frame.range"),
            c.field("frame.low[0]", "<i", 1 << 18, "frame.range"),
        ),
    )
    pair(
        "invalid",
        "frame-axes",
        "high of the first axis, and low of the second",
        lambda c: (
            c.field("frame.high[0]", "<i", 1 << 30, "frame.range"),
            c.field("frame.low[1]", "<i", 1 << 30, "frame.range"),
        ),
    )
    pair(
        "invalid",
        "frame-low-and-high",
        "low and high of one axis",
        lambda c: (
            c.field("frame.low[2]", "<i", -(1 << 30), "frame.range"),
            c.field("frame.high[2]", "<i", -(1 << 31), "frame.range"),
        ),
    )
    weights = directory.WEIGHTS
    pair(
        "invalid",
        "frame-and-weights",
        "the frame, and the weights' scale",
        lambda c: (
            c.field("frame.reserved", "B", 1, "frame.range"),
            c.put(c.t.start(weights), b"\xff", "weights.scale"),
        ),
    )
    pair(
        "invalid",
        "scale-and-not-finite",
        "carm_shift, and a weight that is no number",
        lambda c: (
            c.put(c.t.start(weights) + 3, b"\x11", "weights.scale"),
            c.put(value_at(c.t, "hyper", 0, 0, 0), FLOATS["not-a-number"], "weights.not_finite"),
        ),
    )
    pair(
        "invalid",
        "not-finite-and-bound",
        "a rendering network's weight that is no number, and a row of F_h at no exponent",
        lambda c: (
            c.put(value_at(c.t, "colour", 1, 0, 0), FLOATS["infinite"], "weights.not_finite"),
            c.put(value_at(c.t, "hyper", 0, 0, 0), struct.pack("<f", 1e9), "weights.bound"),
        ),
    )
    pair(
        "invalid",
        "bound-and-planes",
        "a row of CARM at no exponent, and the lengths of the planes",
        lambda c: (
            c.put(value_at(c.t, "carm.1", 1, 0, 0), struct.pack("<f", 1e9), "weights.bound"),
            c.put(c.t.start(directory.PLANES_SECTION), b"\xff", "planes.length"),
        ),
    )
    pair(
        "malformed",
        "planes-and-mask-model",
        "the lengths of the planes, and the mask model",
        lambda c: (
            c.wrong(c.t.start(directory.PLANES_SECTION), "planes.length", c.t.start(directory.PLANES_SECTION)),
            c.put(c.t.table, b"\0\0", "chunks.mask_model"),
        ),
    )
    pair(
        "invalid",
        "plane-stream-and-mask-model",
        "the last symbol_crc of the planes, and the mask model",
        lambda c: (
            c.wrong(stream_of(c.t, "planes", 4)[1], "substream.symbol_crc", stream_of(c.t, "planes", 4)[1]),
            c.put(c.t.table, b"\0\0", "chunks.mask_model"),
        ),
    )
    pair(
        "invalid",
        "mask-model-and-chunk-length",
        "the mask model, and a position_length",
        lambda c: (c.put(c.t.table + 2, b"\0\0", "chunks.mask_model"), c.put(c.t.entries, b"\1", "chunks.length")),
        chunks=False,
    )
    pair(
        "invalid",
        "position-model-and-chunk-length",
        "the model of positions, and a position_length",
        lambda c: (
            c.put(c.t.position_model, b"\x29", "chunks.position_model"),
            c.put(c.t.entries, b"\0\0\0\0", "chunks.length"),
        ),
        packed,
        False,
    )
    pair(
        "malformed",
        "chunk-lengths",
        "position_length of chunk 2, and the sum of the mask lengths",
        lambda c: (
            c.put(c.t.entries + 48, b"\1", "chunks.length"),
            c.put(c.t.entries + 8, b"\xff\xff", "chunks.length"),
        ),
        chunks=False,
    )


def _streams(book: Book, pair: Add) -> None:
    positions = directory.POSITIONS

    def crc_behind() -> Refused:
        t = plain()
        at, crc = t.start(positions) + 20, t.entries + 28
        data = bytearray(repair(t.put(at, b"\0\x7c")))
        data[crc] ^= 1
        return Refused(repair(bytes(data), chunks=False), "positions.not_finite", at)

    text = "a position of chunk 0, and the CRC-32 of chunk 1"
    book.add(
        "invalid-order-of-position-and-chunk-crc",
        text,
        crc_behind,
        features="order",
        requirements="D10.1-1",
        flags="order-of-checks",
    )
    pair(
        "invalid",
        "zero-and-infinity",
        "a position of -0, and an infinite one behind it",
        lambda c: (
            c.put(c.t.start(positions) + 6, b"\0\x80", "positions.negative_zero"),
            c.put(c.t.start(positions) + 8, b"\0\xfc", "positions.not_finite"),
        ),
    )

    def late_position(c: Changes) -> tuple[Fault, Fault]:
        at, mask = c.t.sections[positions].end - 2, stream_of(c.t, "masks")
        return c.put(at, b"\0\x80", "positions.negative_zero"), c.wrong(mask[1], "substream.symbol_crc", mask[1])

    pair(
        "invalid",
        "last-position-and-first-mask",
        "a position of the last chunk, and the masks of the first",
        late_position,
    )

    def late_mask(c: Changes) -> tuple[Fault, Fault]:
        mask, attribute = stream_of(c.t, "masks", 2), stream_of(c.t, "attributes")
        return c.wrong(mask[1], "substream.symbol_crc", mask[1]), c.put(
            attribute[1] + 8, b"\0\0\0\0", "substream.state"
        )

    pair(
        "invalid",
        "last-mask-and-first-attribute",
        "the masks of the last chunk, and the attributes of the first",
        late_mask,
    )

    def chunks_in_order(c: Changes) -> tuple[Fault, Fault]:
        one, two = stream_of(c.t, "attributes", 1), stream_of(c.t, "attributes", 2)
        return c.wrong(one[1], "substream.symbol_crc", one[1]), c.put(
            two[1] + 4, b"\xff\xff\xff\xff", "substream.length"
        )

    pair("invalid", "chunks", "symbol_crc of chunk 1, and the length of chunk 2", chunks_in_order)

    def planes_in_order(c: Changes) -> tuple[Fault, Fault]:
        one, two = stream_of(c.t, "planes", 0), stream_of(c.t, "planes", 1)
        return c.wrong(one[1], "substream.symbol_crc", one[1]), c.put(
            two[1] + 4, b"\xff\xff\xff\xff", "substream.length"
        )

    pair("invalid", "sub-planes", "symbol_crc of sub-plane 0, and the length of sub-plane 1", planes_in_order)

    def length_and_state(c: Changes) -> tuple[Fault, Fault]:
        s = stream_of(c.t, "attributes")
        return c.put(s[1] + 4, b"\xff\xff\xff\x7f", "substream.length", s[1]), c.put(
            s[1] + 8, b"\0\0\0\0", "substream.state", s[1]
        )

    pair("malformed", "length-and-state", "the length of a substream, and its first state", length_and_state)

    def packed_chunks(c: Changes) -> tuple[Fault, Fault]:
        parts = position_parts(c.t)
        first = next(at for at, _, _ in parts if c.t.data[at] == 1)
        raw = next(at for at, _, _ in parts if c.t.data[at] == 0)
        return c.wrong(first + 1, "substream.symbol_crc", first + 1), c.put(raw, b"\7", "positions.form")

    pair(
        "invalid",
        "packed-and-raw-chunk",
        "symbol_crc of a packed chunk, and the form of a raw one behind it",
        packed_chunks,
        packed,
    )

    def grid_stream(c: Changes) -> tuple[Fault, Fault]:
        stream, layer = stream_of(c.t, "weights"), next(iter(grid_layers(c.t).values()))
        return c.wrong(stream[1], "substream.symbol_crc", stream[1]), c.put(
            layer + 6, FLOATS["not-a-number"], "weights.not_finite"
        )

    pair(
        "invalid",
        "weight-stream-and-raw-layer",
        "symbol_crc of the weights, and a raw layer's number that is none",
        grid_stream,
        grids,
    )

    def grid_models(c: Changes) -> tuple[Fault, Fault]:
        stream, layers = stream_of(c.t, "weights"), list(grid_layers(c.t).values())
        return c.put(layers[-1], b"\3", "weights.layer"), c.put(stream[1] + 8, b"\0\0\0\0", "substream.state")

    pair(
        "invalid",
        "layer-and-weight-stream",
        "the last layer's form, and the first state of the weights",
        grid_models,
        grids,
    )

    def raw_bound(c: Changes) -> tuple[Fault, Fault]:
        layers = list(grid_layers(c.t).values())
        return c.put(layers[0] + 7, b"\0\xc0\x7f", "weights.not_finite", layers[0] + 6), c.put(
            layers[1], b"\1", "weights.layer"
        )

    pair("invalid", "raw-layer-twice", "a raw layer with a number that is none, and a -0", raw_bound, grids)

    def ends(name: str, text: str, make: Callable[[], Refused]) -> None:
        book.add(
            f"invalid-order-of-{name}",
            text,
            make,
            features="order substream",
            requirements="D10.1-1 D8.8-2",
            flags="order-of-checks",
        )

    def words_and_raw() -> Refused:
        t = far(1000)
        stream = stream_of(t, "attributes")
        count, _, raw_at = words_of(t, stream)
        content = (
            t.data[stream[1] : stream[1] + 4]
            + (count + 1).to_bytes(4, "little")
            + t.data[stream[1] + 8 : raw_at]
            + bytes(2)
        )
        return Refused(_whole(t, content + bytes(40)), "substream.words", stream[1])

    ends("words-and-escape", "a word too many, and an escape of zeros", words_and_raw)

    def state_and_escape() -> Refused:
        refused = with_raw(far(1000), 0, 48, "final_state")
        at = refused.offset + 8
        return Refused(
            repair(
                refused.data[:at]
                + struct.pack("<I", struct.unpack_from("<I", refused.data, at)[0] + 2)
                + refused.data[at + 4 :]
            ),
            "substream.final_state",
            refused.offset,
        )

    ends("state-and-escape", "a final state, and an escape of zeros", state_and_escape)
    ends(
        "escape-and-raw-length",
        "an escape of zeros, and raw bytes that nothing reads",
        lambda: with_raw(far(1000), 0, 800, "escape"),
    )
    ends(
        "range-and-raw-length",
        "a symbol out of range, and raw bytes that nothing reads",
        lambda: with_raw(far(1000), escape_of(24, 0), 800, "symbol_range"),
    )

    def padding_and_crc() -> Refused:
        t = far(300)
        _, value = raw_of(t)
        return with_raw(t, value ^ 1 | 1 << 23, 24, "raw_padding")

    ends("padding-and-crc", "a padding bit, and symbol_crc", padding_and_crc)

    def length_and_crc() -> Refused:
        t = far(300)
        _, value = raw_of(t)
        return with_raw(t, value ^ 1, 32, "raw_length")

    ends("raw-length-and-crc", "a raw byte more, and symbol_crc", length_and_crc)


def _whole(t: Target, content: bytes) -> bytes:
    """The file with other bytes as its one substream of attributes."""
    from .files import with_stream  # noqa: PLC0415

    return with_stream(t, stream_of(t, "attributes"), content)
