"""Files with one fault in the prologue, the header or the directory."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from refcodec.bitstream import codec, directory, syntax
from refcodec.bitstream.header import PROLOGUE_BYTES
from refcodec.encoder.positions import position_model

from .book import Book, Make, Refused
from .files import Target, repair, resized
from .numbers import Numbers
from .packing import sharp_model
from .scenes import MAIN_SMALLEST, SMALL, lattice, packed_weights, scene, silent
from .structure import drawn

NAN, INFINITY = float("nan"), float("inf")


@cache
def plain() -> Target:
    """A file of three chunks, with ancillary sections."""
    made = drawn("refused", 11, chunk_size=4)
    return Target(codec.emit(replace(made, extensions=((5, 1, b"hello"), (9, 0, b"")))))


@cache
def packed() -> Target:
    """A file in mode 1: two packed chunks, a raw one and a packed one; a raw layer of weights."""
    where = lattice(Numbers("refused-packed"), 11)
    where[6] = where[7]
    made = drawn("refused-packed", 11, chunk_size=3, positions=where, position_model=position_model(where, 3))
    made.networks["colour"][0][1][0] = -0.0
    return Target(codec.emit(packed_weights(made)))


@cache
def main_file() -> Target:
    """A file of profile Main, level 1, in mode 1, without anchors and with weights of 0."""
    made = scene("refused-main", 0, MAIN_SMALLEST)
    networks = {name: silent(layers) for name, layers in made.networks.items()}
    networks["sarm"][-1][1][1] = -40
    model = sharp_model({})
    return Target(
        codec.emit(
            packed_weights(replace(made, networks=networks, planes=np.zeros_like(made.planes), position_model=model))
        )
    )


def patched(base: Callable[[], Target], path: str, form: str, value: Any, name: str, told: str | None = None) -> Make:
    """A file with one element at another value; told: the element that the error names."""

    def make() -> Refused:
        t = base()
        return Refused(repair(t.put(t.at(path), struct.pack(form, value))), name, t.at(told or path))

    return make


def with_prologue(t: Target, at: int, value: int) -> bytes:
    """The file with another number in its prologue, the prologue's CRC-32 right."""
    data = t.put(at, value.to_bytes(4, "little"))
    return data[:16] + zlib.crc32(data[:16]).to_bytes(4, "little") + data[20:]


def add(book: Book) -> None:
    """Adds the vectors."""
    _prologue(book)
    _header(book)
    _dimensions(book)
    _fields(book)
    _directory(book)


def _prologue(book: Book) -> None:
    def add(klass: str, name: str, text: str, make: Make, flags: str = "") -> None:
        book.add(f"{klass}-prologue-{name}", text, make, features="prologue", flags=flags)

    for length in (0, 19):
        add(
            "malformed",
            f"of-{length}-bytes",
            f"a file of {length} bytes",
            lambda length=length: Refused(  # type: ignore[misc]
                plain().data[:length], "prologue.truncated", length
            ),
            "truncation",
        )
    for name, at, value in (("seven-bits", 0, 9), ("last-byte", 7, 13)):
        add(
            "malformed",
            f"signature-{name}",
            f"byte {at} of the signature is {value}",
            lambda at=at, value=value: Refused(  # type: ignore[misc]
                repair(plain().put(at, bytes([value]))), "prologue.signature", 0
            ),
            "signature-partly",
        )
    for at, name in ((8, "version"), (15, "header-length"), (19, "itself")):
        add(
            "malformed",
            f"crc-{name}",
            f"the prologue's CRC-32 does not match: byte {at} is changed",
            lambda at=at: Refused(  # type: ignore[misc]
                plain().put(at, bytes([plain().data[at] ^ 0x40])), "prologue.crc", 16
            ),
            "checksum-unchecked",
        )
    for version in (1, 1 << 24):
        add(
            "unsupported",
            f"version-{version}",
            f"version {version}",
            lambda version=version: Refused(  # type: ignore[misc]
                with_prologue(plain(), 8, version), "prologue.version", 8
            ),
            "version-unchecked",
        )
    for length in (3, 65536):
        add(
            "malformed",
            f"header-length-{length}",
            f"header_length {length}",
            lambda length=length: Refused(  # type: ignore[misc]
                with_prologue(plain(), 12, length), "prologue.header_length", 12
            ),
            "limit-off-by-one",
        )


def _header(book: Book) -> None:
    def add(name: str, text: str, make: Make, flags: str = "", klass: str = "malformed") -> None:
        book.add(f"{klass}-header-{name}", text, make, features="header", flags=flags)

    def cut(length: Callable[[Target], int]) -> Make:
        return lambda: Refused(plain().data[: length(plain())], "header.truncated", length(plain()))

    add("none", "the file ends with its prologue", cut(lambda t: PROLOGUE_BYTES), "truncation")
    add("cut-by-one", "the last byte of the header is missing", cut(lambda t: t.header_end - 1), "truncation")
    for name, place in (("first", lambda t: PROLOGUE_BYTES), ("last", lambda t: t.header_end - 5)):

        def crc(place: Callable[[Target], int] = place) -> Refused:
            t = plain()
            return Refused(t.put(place(t), bytes([t.data[place(t)] ^ 1])), "header.crc", t.header_end - 4)

        add(f"crc-{name}", f"the header's CRC-32 does not match: {name} byte changed", crc, "checksum-unchecked")

    def other_length(change: int) -> Make:
        def make() -> Refused:
            t = plain()
            fields = t.data[PROLOGUE_BYTES : t.header_end - 4]
            head = fields[: len(fields) + change] + bytes(max(0, change))
            made = with_prologue(t, 12, len(head) + 4)[:PROLOGUE_BYTES] + head + zlib.crc32(head).to_bytes(4, "little")
            at = PROLOGUE_BYTES + (len(fields) if change > 0 else len(head) + 4)
            return Refused(made + t.data[t.header_end :], "header.syntax", at)

        return make

    for change in (1, -1, -4):
        add(
            f"{'longer' if change > 0 else 'shorter'}-by-{abs(change)}",
            f"header_length is {abs(change)} {'more' if change > 0 else 'less'} than the fields take",
            other_length(change),
            "header-slack" if change > 0 else "truncation",
        )

    def empty() -> Refused:
        made = with_prologue(plain(), 12, 4)[:PROLOGUE_BYTES] + bytes(4)
        return Refused(made, "header.syntax", PROLOGUE_BYTES + 4)

    add("of-crc-alone", "a header that is its CRC-32 alone", empty, "truncation")

    def longest() -> Refused:
        head = plain().data[PROLOGUE_BYTES : plain().header_end - 4]
        head += bytes(65531 - len(head))
        made = with_prologue(plain(), 12, 65535)[:PROLOGUE_BYTES] + head + zlib.crc32(head).to_bytes(4, "little")
        return Refused(made, "header.syntax", plain().header_end - 4)

    add("longest", "the largest header_length, with zeros behind the fields", longest, "header-slack")

    def counted(field: str, at: str, count: int) -> Make:
        def make() -> Refused:
            t = plain()
            # The list that follows takes what comes behind it, and then the header is too short, or not all of it is used.
            data = repair(t.put(t.at(field), bytes([count])))
            head = data[PROLOGUE_BYTES : t.header_end - 4]
            made = data[: t.header_end - 4] + zlib.crc32(head).to_bytes(4, "little") + data[t.header_end :]
            return Refused(made, "header.syntax", t.header_end)

        return make

    for field in ("dimensions.slice_count", "section_count"):
        name = field.rpartition(".")[2].replace("_", "-")
        add(
            f"{name}-255",
            f"{name.replace('-', '_')} 255, more than the header holds",
            counted(field, field, 255),
            "truncation buffer-too-small",
        )
    reserved = [
        ("reserved_0", "B"),
        ("reserved_1", "B"),
        ("position_grid.reserved", "B"),
        ("directory[0].reserved", "<H"),
        ("directory[8].reserved", "<H"),
    ]
    for path, form in reserved:
        name = path.replace("_", "-").replace(".", "-").replace("[", "-").replace("]", "")
        value = 256 if form == "<H" else 1
        add(
            f"set-{name}",
            f"{path} is {value}",
            patched(plain, path, form, value, "header.reserved"),
            "reserved-unchecked",
        )
    for profile in (2,):
        add(
            f"profile-{profile}",
            f"profile {profile}",
            patched(plain, "profile", "B", profile, "header.profile"),
            "profile-unchecked",
            "unsupported",
        )
    for level in (1,):
        add(
            f"level-{level}",
            f"level {level} of Tiny",
            patched(plain, "level", "B", level, "header.level"),
            "level-limits",
            "unsupported",
        )
    for level in (0, 4):
        add(
            f"main-level-{level}",
            f"level {level} of Main",
            patched(main_file, "level", "B", level, "header.level"),
            "level-limits",
            "unsupported",
        )


def _dimensions(book: Book) -> None:
    def add(name: str, text: str, make: Make, flags: str = "limit-off-by-one") -> None:
        book.add(f"invalid-dimension-{name}", text, make, features="dimensions", flags=flags)

    name = "header.dimension"
    tiny: list[tuple[str, str, list[int]]] = [
        ("offset_count", "B", [0, 11]),
        ("slice_width[0]", "B", [0]),
        ("slice_width[1]", "B", [17]),
        ("plane_channels", "B", [0, 9]),
        ("frequency_count", "B", [0, 11]),
        ("plane_size", "<H", [1, 33, 258]),
        ("hyper_width[0]", "B", [0, 65]),
        ("sarm_width[0]", "B", [0]),
        ("sarm_width[1]", "B", [17]),
        ("carm_width[0]", "B", [0, 65]),
        ("render_width", "B", [0, 65]),
    ]
    main: list[tuple[str, str, list[int]]] = [
        ("offset_count", "B", [9, 11]),
        ("slice_width[0]", "B", [4]),
        ("slice_width[3]", "B", [21]),
        ("plane_channels", "B", [7, 9]),
        ("frequency_count", "B", [9, 11]),
        ("plane_size", "<H", [257]),
        ("hyper_width[0]", "B", [15, 129]),
        ("sarm_width[0]", "B", [15, 17]),
        ("carm_width[0]", "B", [15, 129]),
        ("render_width", "B", [49, 51]),
    ]
    for base, label, rows in ((plain, "", tiny), (main_file, "main-", main)):
        for field, form, values in rows:
            for value in values:
                short = field.replace("_", "-").replace("[", "-").replace("]", "")
                make = patched(base, f"dimensions.{field}", form, value, name)
                add(f"{label}{short}-{value}", f"{field} {value} in {'Main' if label else 'Tiny'}", make)

    def counted(base: Callable[[], Target], counter: str, widths: str, values: list[int]) -> Make:
        def make() -> Refused:
            t = base()

            def change(fields: Any) -> None:
                fields.dimensions[counter] = len(values)
                fields.dimensions[widths] = values

            data = t.with_header(change)
            path = f"dimensions.{counter}"
            at = next(e.start for e in syntax.parse_elements("Header", data, PROLOGUE_BYTES, "") if e.path == path)
            return Refused(data, name, at)

        return make

    lists: list[tuple[Callable[[], Target], str, str, str, list[list[int]]]] = [
        (plain, "", "slice_count", "slice_width", [[], [1] * 5]),
        (plain, "", "hyper_layers", "hyper_width", [[], [4] * 3]),
        (plain, "", "sarm_layers", "sarm_width", [[], [4] * 3]),
        (plain, "", "carm_layers", "carm_width", [[], [4] * 3]),
        (main_file, "main-", "slice_count", "slice_width", [[5, 10, 15], [5, 10, 15, 20, 5]]),
        (main_file, "main-", "hyper_layers", "hyper_width", [[], [16, 16]]),
        (main_file, "main-", "sarm_layers", "sarm_width", [[16], [16] * 3]),
        (main_file, "main-", "carm_layers", "carm_width", [[], [16, 16]]),
    ]
    for source, label, counter, widths, choices in lists:
        for values in choices:
            short = counter.replace("_", "-")
            text = f"{counter} {len(values)} in {'Main' if label else 'Tiny'}"
            add(f"{label}{short}-{len(values)}", text, counted(source, counter, widths, values))

    @cache
    def one_slice() -> Target:
        return Target(codec.emit(drawn("refused-one-slice", 2, replace(SMALL, slices=(3,), carm_width=()))))

    add(
        "carm-for-nothing",
        "CARM has a hidden layer, though there is one slice",
        counted(one_slice, "carm_layers", "carm_width", [4]),
        "carm-slices",
    )

    def other_slices() -> Refused:
        t = main_file()
        at = t.at("dimensions.slice_width[0]")
        return Refused(repair(t.put(at, bytes([5, 10, 20, 15]))), name, at)

    add("main-slices", "slices of Main in another order", other_slices, "main-carm")

    def level_plane() -> Refused:
        t = main_file()
        return Refused(
            repair(t.put(t.at("dimensions.plane_size"), struct.pack("<H", 129))), name, t.at("dimensions.plane_size")
        )

    add("main-plane-size-129", "plane_size 129 at level 1", level_plane, "level-limits")


def _fields(book: Book) -> None:
    def add(name: str, text: str, make: Make, feature: str, flags: str = "limit-off-by-one") -> None:
        book.add(f"invalid-{name}", text, make, features=feature, flags=flags)

    for value in (4097, 0xFFFFFFFF):
        add(
            f"anchor-count-{value}",
            f"anchor_count {value} in Tiny",
            patched(plain, "anchor_count", "<I", value, "header.anchor_count"),
            "header",
            "level-limits buffer-too-small",
        )
    for level, most in ((1, 1 << 17), (2, 1 << 20), (3, 1 << 24)):

        def crowd(level: int = level, most: int = most) -> Refused:
            t = main_file()
            data = bytearray(t.put(t.at("anchor_count"), struct.pack("<I", most + 1)))
            data[t.at("level")] = level
            return Refused(repair(bytes(data)), "header.anchor_count", t.at("anchor_count"))

        add(
            f"anchor-count-main-{level}",
            f"one anchor more than level {level} of Main allows",
            crowd,
            "main header",
            "level-limits",
        )
    for level, anchors, size in ((2, 1 << 17, 128), (3, 1 << 20, 256)):

        def higher(level: int = level, anchors: int = anchors, size: int = size) -> Refused:
            t = main_file()
            data = bytearray(t.put(t.at("anchor_count"), struct.pack("<I", anchors)))
            at = t.at("dimensions.plane_size")
            data[at : at + 2] = struct.pack("<H", size)
            data[t.at("level")] = level
            return Refused(repair(bytes(data)), "header.level_not_minimal", t.at("level"))

        text = f"level {level}, though level {level - 1} allows {anchors} anchors and planes of {size}"
        add(f"level-{level}-of-{anchors}-{size}", text, higher, "main header", "level-limits level-not-minimal")
    for value in (0, 65537):
        add(
            f"chunk-size-{value}",
            f"chunk_size {value}",
            patched(plain, "chunk_size", "<I", value, "header.chunk_size"),
            "header",
        )
    for value in (255, 65537):
        add(
            f"chunk-size-main-{value}",
            f"chunk_size {value} in Main",
            patched(main_file, "chunk_size", "<I", value, "header.chunk_size"),
            "main header",
        )
    for part in ("plane", "mask", "attribute"):
        for value in (9,) if part != "mask" else (9, 32):
            path = f"{part}_lanes_log2"
            add(
                f"{part}-lanes-{value}",
                f"{path} {value}",
                patched(plain, path, "B", value, "header.lanes"),
                "header lanes",
                "limit-off-by-one shift-overflow",
            )
    below, above = float.fromhex("0x1.fffffep-61"), float.fromhex("0x1.000002p+60")
    for item, step, text in (
        (0, below, "below the least"),
        (1, above, "above-the-largest"),
        (2, -1.0, "negative"),
        (1, NAN, "not-a-number"),
        (2, INFINITY, "infinite"),
    ):
        label = text.replace(" ", "-")
        make = patched(plain, f"base_step[{item}]", "<f", step, "header.base_step")
        add(
            f"base-step-{item}-{label}",
            f"base_step {item} is {text.replace('-', ' ')}",
            make,
            "header steps",
            "float-limits limit-off-by-one",
        )
    grid = "header.position_grid"
    for item, number in ((0, 1 << 62), (1, -(1 << 62)), (2, -(1 << 63))):
        label = f"{'minus' if number < 0 else 'plus'}-{item}-{abs(number).bit_length()}"
        add(
            f"origin-{label}",
            f"origin {item} is {number}",
            patched(plain, f"position_grid.origin[{item}]", "<q", number, grid),
            "position-grid",
            "limit-off-by-one signed-limits",
        )
    add(
        "scale-mantissa-0",
        "scale_mantissa 0",
        patched(plain, "position_grid.scale_mantissa", "<H", 0, grid),
        "position-grid",
    )
    for number in (61, -61, -128):
        label = f"{'minus' if number < 0 else 'plus'}-{abs(number)}"
        add(
            f"scale-exponent-{label}",
            f"scale_exponent {number}",
            patched(plain, "position_grid.scale_exponent", "b", number, grid),
            "position-grid",
            "limit-off-by-one signed-limits",
        )
    _render_info(book)


def _render_info(book: Book) -> None:
    rows: list[tuple[str, str, float, str]] = [
        ("up_axis", "B", 6, "6"),
        ("near_plane", "<f", NAN, "not-a-number"),
        ("near_plane", "<f", INFINITY, "infinite"),
        ("near_plane", "<f", 0.0, "zero"),
        ("near_plane", "<f", -1.0, "negative"),
        ("distance_unit", "<f", NAN, "not-a-number"),
        ("distance_unit", "<f", 0.0, "zero"),
        ("distance_unit", "<f", -1.0, "negative"),
        ("alpha_max", "<f", NAN, "not-a-number"),
        ("alpha_max", "<f", -0.0, "minus-zero"),
        ("alpha_max", "<f", float.fromhex("0x1.000002p+0"), "above-one"),
        ("low_pass", "<f", NAN, "not-a-number"),
        ("low_pass", "<f", INFINITY, "infinite"),
        ("low_pass", "<f", -(2.0**-149), "negative"),
        ("camera_width", "<H", 0, "zero"),
        ("camera_height", "<H", 0, "zero"),
        ("camera_focal[0]", "<f", NAN, "not-a-number"),
        ("camera_focal[1]", "<f", INFINITY, "infinite"),
        ("camera_focal[1]", "<f", 0.0, "zero"),
        ("camera_focal[0]", "<f", -1.0, "negative"),
        ("camera_rotation[0]", "<f", -INFINITY, "infinite"),
        ("camera_rotation[3]", "<f", NAN, "not-a-number"),
        ("camera_translation[0]", "<f", NAN, "not-a-number"),
        ("camera_translation[2]", "<f", -INFINITY, "infinite"),
    ]
    for field, form, value, text in rows:
        path = f"render_info.{field}"
        # SPEC 10.2: an item of an array is told by its array.
        told = path.partition("[")[0] + "[0]" if "[" in path else path
        label = field.replace("_", "-").replace("[", "-").replace("]", "")
        make = patched(plain, path, form, int(value) if form in ("B", "<H") else value, "header.render_info", told)
        book.add(
            f"invalid-{label}-{text}",
            f"{field} is {text.replace('-', ' ')}",
            make,
            features="render-info",
            flags="float-limits",
        )
    for sign, text in ((-0.0, "zeros"),):

        def rotation(sign: float = sign) -> Refused:
            t = plain()
            at = t.at("render_info.camera_rotation[0]")
            return Refused(repair(t.put(at, struct.pack("<4f", sign, 0.0, sign, 0.0))), "header.render_info", at)

        book.add(
            f"invalid-camera-rotation-{text}",
            f"camera_rotation of {text.replace('-', ' ')}",
            rotation,
            features="render-info",
            flags="float-limits",
        )


def _directory(book: Book) -> None:
    def add(klass: str, name: str, text: str, make: Make, flags: str = "") -> None:
        book.add(f"{klass}-{name}", text, make, features="directory", flags=flags)

    for entry, kind in ((0, 0x80), (3, 0x88), (8, 0xC5)):
        make = patched(plain, f"directory[{entry}].type", "B", kind, "directory.unknown_critical")
        add(
            "unsupported",
            f"section-{kind:02x}-as-entry-{entry}",
            f"entry {entry} is a critical section {kind:02X}",
            make,
            "critical-skipped",
        )
    types: list[tuple[str, str, dict[int, int], int]] = [
        ("swapped", "the planes come before the weights", {1: 0x83, 2: 0x82}, 1),
        ("twice", "two sections of masks", {6: 0x86}, 6),
        ("ancillary-among", "an ancillary section among the critical ones", {2: 0x05}, 2),
        ("ancillary-first", "an ancillary section before the critical ones", {0: 0x01}, 0),
        ("ancillary-zero", "an ancillary section of type 00", {7: 0x00}, 7),
        ("ancillary-twice", "two ancillary sections of one type", {8: 0x05}, 8),
        ("ancillary-falls", "ancillary types that fall", {7: 0x0A}, 8),
        ("critical-behind", "a critical section behind the ancillary ones", {8: 0x87}, 8),
    ]
    for name, text, changes, wrong in types:

        def order(changes: dict[int, int] = changes, wrong: int = wrong) -> Refused:
            t = plain()
            data = bytearray(t.data)
            for entry, kind in changes.items():
                data[t.at(f"directory[{entry}].type")] = kind
            return Refused(repair(bytes(data)), "directory.order", t.at(f"directory[{wrong}].type"))

        add("malformed", f"order-{name}", text, order, "section-order")
    for count in (0, 6):

        def few(count: int = count) -> Refused:
            t = plain()

            def change(fields: Any) -> None:
                fields.section_count, fields.directory = count, fields.directory[:count]

            return Refused(t.with_header(change), "directory.order", t.at("section_count"))

        add("malformed", f"sections-{count}", f"{count} sections", few, "section-order truncation")
    for entry, (section, mode) in enumerate(zip(directory.SECTIONS.values(), (1, 2, 1, 1, 2, 1, 1), strict=True)):
        label = section.replace("_", "-")
        for value in (mode,):
            make = patched(plain, f"directory[{entry}].mode", "B", value, "directory.mode")
            add(
                "unsupported",
                f"mode-{label}-{value}",
                f"mode {value} of the {section.replace('_', ' ')}",
                make,
                "mode-unchecked",
            )
    for entry, change, text in (
        (0, 1, "one late"),
        (3, 4, "a gap"),
        (5, -2, "an overlap"),
        (8, 1, "the last section, one late"),
    ):

        def moved(entry: int = entry, change: int = change) -> Refused:
            t = plain()
            at = t.at(f"directory[{entry}].offset")
            right = int.from_bytes(t.data[at : at + 4], "little")
            return Refused(repair(t.put(at, (right + change).to_bytes(4, "little"))), "directory.offset", at)

        add(
            "malformed",
            f"offset-{entry}-{text.replace(',', '').replace(' ', '-')}",
            f"entry {entry}: {text}",
            moved,
            "offsets-trusted",
        )
    add(
        "malformed",
        "offset-huge",
        "a section at the end of the address space",
        lambda: Refused(
            repair(plain().put(plain().at("directory[2].offset"), b"\xff" * 4)),
            "directory.offset",
            plain().at("directory[2].offset"),
        ),
        "offsets-trusted buffer-too-small",
    )
    for base, label in ((plain, ""), (packed, "packed-")):
        for kind, change in (
            (directory.FRAME, 1),
            (directory.FRAME, -1),
            (directory.WEIGHTS, 4),
            (directory.WEIGHTS, -4),
            (directory.CHUNK_TABLE, 24),
            (directory.CHUNK_TABLE, -1),
            (directory.POSITIONS, 6),
            (directory.POSITIONS, -6),
        ):
            if label and kind != directory.CHUNK_TABLE:
                continue

            def sized(base: Callable[[], Target] = base, kind: int = kind, change: int = change) -> Refused:
                t = base()
                content = t.content(kind)
                content = content + bytes(change) if change > 0 else content[:change]
                entry = list(directory.SECTIONS).index(kind)
                return Refused(resized(t.data, kind, content), "directory.length", t.at(f"directory[{entry}].length"))

            section = directory.SECTIONS[kind]
            add(
                "malformed",
                f"length-{label}{section.replace('_', '-')}-{'plus' if change > 0 else 'minus'}-{abs(change)}",
                f"{section.replace('_', ' ')}{' in mode 1' if label else ''}: {change:+} bytes against what the header implies",
                sized,
                "lengths-trusted",
            )
    add(
        "malformed",
        "behind-the-end",
        "a byte behind the last section",
        lambda: Refused(plain().data + b"\0", "directory.file_length", len(plain().data)),
        "trailing-bytes",
    )
    for name, place in (
        ("by-one", lambda t: t.sections[directory.ATTRIBUTES].end + 4),
        ("within-attributes", lambda t: t.start(directory.ATTRIBUTES) + 5),
        ("behind-header", lambda t: t.header_end),
    ):

        def cut(place: Callable[[Target], int] = place) -> Refused:
            return Refused(plain().data[: place(plain())], "directory.file_length", place(plain()))

        add("malformed", f"file-cut-{name}", f"the file is cut, {name.replace('-', ' ')}", cut, "truncation")
    for kind in (directory.FRAME, directory.WEIGHTS, directory.ATTRIBUTES, 5):

        def crc(kind: int = kind) -> Refused:
            t = plain()
            at = t.sections[kind].end - 1
            return Refused(t.put(at, bytes([t.data[at] ^ 0x80])), "section.crc", t.start(kind))

        section = directory.SECTIONS.get(kind, "ancillary section")
        add(
            "malformed",
            f"crc-{section.replace('_', '-').replace(' ', '-')}",
            f"the CRC-32 of the {section.replace('_', ' ')} does not match",
            crc,
            "checksum-unchecked",
        )

    def empty_crc() -> Refused:
        t = plain()
        elements = {e.path: e.start for e in syntax.parse_elements("Header", t.data, PROLOGUE_BYTES, "")}
        data = bytearray(t.put(elements["directory[8].crc"], b"\1\0\0\0"))
        end = t.header_end
        data[end - 4 : end] = zlib.crc32(data[PROLOGUE_BYTES : end - 4]).to_bytes(4, "little")
        return Refused(bytes(data), "section.crc", t.start(9))

    add(
        "malformed",
        "crc-of-nothing",
        "the CRC-32 of an empty ancillary section is not 0",
        empty_crc,
        "checksum-unchecked",
    )
