"""Files with one fault each, checksums repaired so that the fault is what a decoder meets: for each code of SPEC.md 10.2 a strategy
that makes files with it from valid ones, and says the offset."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st

from refcodec.bitstream import codec, dimensions, directory, syntax, weights
from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.entropy import Encoder
from refcodec.bitstream.errors import REGISTRY, ErrorKind
from refcodec.bitstream.header import PROLOGUE_BYTES, Lanes
from refcodec.bitstream.positions import CELL_INDEX, HALVES, PACKED, POSITION_MODELS, RAW, chunk_codes, code_cells
from refcodec.encoder.positions import pack_positions
from refcodec.encoder.weights import exact_networks, quantise_rendering, weight_scales

from .files import Target, grid_layers, lanes_of, position_parts, repair, resized, with_positions, with_stream
from .random_scenes import MAIN_DIMENSIONS, random_scene, with_steps

NAN, INFINITY = struct.pack("<f", float("nan")), struct.pack("<f", float("inf"))
HUGE = struct.pack("<I", 0xFFFFFFFF)


@dataclass(frozen=True)
class Fault:
    """A file that must be refused: name of the error (SPEC 10.2) and its offset."""

    data: bytes
    name: str
    offset: int

    @property
    def kind(self) -> ErrorKind:
        """The row of the registry: code and clause."""
        return REGISTRY[self.name]


# The dimensions of files for faults that need a scene of their own.
SMALLEST = Dimensions(1, (1, 1), 1, 1, 2, (2,), (2,), (2,), 1)

Make = Callable[[st.DrawFn, Target], tuple[bytes, int]]
FAULTS: dict[str, Make] = {}


def _fault(name: str) -> Callable[[Make], Make]:
    """Registers what makes files with the named error."""

    def register(make: Make) -> Make:
        FAULTS[name] = make
        return make

    return register


class NoPlaceError(Exception):
    """The file has nothing that could have this fault."""


def _need(condition: object) -> None:
    if not condition:
        raise NoPlaceError


def _set(name: str, *choices: tuple[str, str, list[Any]]) -> None:
    """A fault that is one header or frame element at one wrong value: (path, struct format, values). An item of the render
    information's arrays is told by its array (SPEC 10.2)."""
    flat = [(path, form, value) for path, form, values in choices for value in values]

    def make(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
        path, form, value = draw(st.sampled_from(flat))
        at = t.at(path)
        told = path.partition("[")[0] + "[0]" if path.startswith("render_info.camera_") and "[" in path else path
        return repair(t.put(at, struct.pack(form, value))), t.at(told)

    FAULTS[name] = make


# --- prologue and header (SPEC 6.1 to 6.5, 11) ------------------------------------------------------------------------


@_fault("prologue.truncated")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    length = draw(st.integers(0, PROLOGUE_BYTES - 1))
    return t.data[:length], length


@_fault("prologue.signature")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    at = draw(st.integers(0, 7))
    return repair(t.put(at, bytes([t.data[at] ^ draw(st.integers(1, 255))]))), 0


@_fault("prologue.crc")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    at = draw(st.integers(8, PROLOGUE_BYTES - 1))
    return t.put(at, bytes([t.data[at] ^ draw(st.integers(1, 255))])), 16


def _prologue(t: Target, at: int, value: int) -> bytes:
    data = t.put(at, value.to_bytes(4, "little"))
    return data[:16] + zlib.crc32(data[:16]).to_bytes(4, "little") + data[20:]


@_fault("prologue.version")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    return _prologue(t, 8, draw(st.integers(1, 0xFFFFFFFF))), 8


@_fault("prologue.header_length")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    return _prologue(t, 12, draw(st.one_of(st.integers(0, 3), st.integers(65536, 0xFFFFFFFF)))), 12


@_fault("header.truncated")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    length = draw(st.integers(PROLOGUE_BYTES, t.header_end - 1))
    return t.data[:length], length


@_fault("header.crc")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    at = draw(st.integers(PROLOGUE_BYTES, t.header_end - 1))
    return t.put(at, bytes([t.data[at] ^ draw(st.integers(1, 255))])), t.header_end - 4


@_fault("header.syntax")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    """Bytes between the last field and the CRC-32, or a header that ends before its fields do."""
    fields = t.data[PROLOGUE_BYTES : t.header_end - 4]
    length = draw(st.integers(0, len(fields) + 40).filter(lambda n: n != len(fields)))
    head = fields[:length] + bytes(max(0, length - len(fields)))
    made = (
        _prologue(t, 12, len(head) + 4)[:PROLOGUE_BYTES]
        + head
        + zlib.crc32(head).to_bytes(4, "little")
        + t.data[t.header_end :]
    )
    return made, PROLOGUE_BYTES + (len(fields) if length > len(fields) else length + 4)


_set("header.reserved", ("reserved_0", "B", [1, 255]), ("reserved_1", "B", [1, 128]), ("position_grid.reserved", "B", [1, 255]),
     ("directory[0].reserved", "<H", [1]), ("directory[6].reserved", "<H", [65535, 256]))  # fmt: skip
_set("header.profile", ("profile", "B", [2, 3, 255]))
_set("header.level", ("level", "B", [1, 2, 255]))

_BAD_LISTS = {"slice": [0, 5], "hyper": [0, 3], "sarm": [0, 3], "carm": [3]}


@_fault("header.dimension")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    d = t.fields.dimensions
    scalars = [
        ("offset_count", 11),
        ("plane_channels", 9),
        ("frequency_count", 11),
        ("plane_size", 33),
        ("render_width", 65),
    ]
    lists = [(f"{name}_width[{i}]", high) for name, high in (("slice", 17), ("hyper", 65), ("sarm", 17), ("carm", 65))
             for i in range(len(d[f"{name}_width"]))]  # fmt: skip
    kind = draw(st.sampled_from(["scalar", "item", "count", "carm"]))
    if kind in ("scalar", "item"):
        path, high = draw(st.sampled_from(scalars if kind == "scalar" else lists))
        at = t.at(f"dimensions.{path}")
        low = [0, 1] if path == "plane_size" else [0]
        return repair(
            t.put(at, struct.pack("<H" if path == "plane_size" else "B", draw(st.sampled_from([*low, high, 255]))))
        ), at
    if kind == "carm":
        # A hidden layer without a second slice, or the reverse.
        name, count = "carm", 0 if d.carm_layers else 1
    else:
        name, count = draw(st.sampled_from([(n, c) for n, counts in _BAD_LISTS.items() for c in counts]))
    counter = "slice_count" if name == "slice" else f"{name}_layers"

    def change(fields: Any) -> None:
        fields.dimensions[counter] = count
        fields.dimensions[f"{name}_width"] = [1] * count

    return t.with_header(change), _path_at(t, change, f"dimensions.{counter}")


def _path_at(t: Target, change: Callable[[Any], None], path: str) -> int:
    """Where an element is once the header is changed."""
    data = t.with_header(change)
    return next(e.start for e in syntax.parse_elements("Header", data, PROLOGUE_BYTES, "") if e.path == path)


_set("header.anchor_count", ("anchor_count", "<I", [4097, 1 << 24, 0xFFFFFFFF]))


@cache
def _main_file() -> bytes:
    return codec.emit(random_scene(33, 1, replace(MAIN_DIMENSIONS, plane_size=2)))


@_fault("header.level_not_minimal")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    main = Target(_main_file())
    return repair(main.put(main.at("level"), bytes([draw(st.sampled_from([2, 3]))]))), main.at("level")


_set("header.chunk_size", ("chunk_size", "<I", [0, 65537, 0xFFFFFFFF]))
_set("header.lanes", *((f"{part}_lanes_log2", "B", [9, 31, 32, 255]) for part in ("plane", "mask", "attribute")))
_set(
    "header.base_step",
    *((f"base_step[{i}]", "<f", [0.0, -1.0, 2.0**-61, 2.0**61, float("nan"), float("inf")]) for i in range(3)),
)
_set(
    "header.position_grid",
    *((f"position_grid.origin[{i}]", "<q", [1 << 62, -(1 << 62), -(1 << 63)]) for i in range(3)),
    ("position_grid.scale_mantissa", "<H", [0]),
    ("position_grid.scale_exponent", "b", [61, -61, -128, 127]),
)
_BAD = [float("nan"), float("inf"), -float("inf")]
_set(
    "header.render_info",
    ("render_info.up_axis", "B", [6, 255]),
    ("render_info.near_plane", "<f", [0.0, -1.0, *_BAD]),
    ("render_info.distance_unit", "<f", [0.0, -1.0, *_BAD]),
    ("render_info.alpha_max", "<f", [0.0, -0.5, 1.0001, *_BAD]),
    ("render_info.low_pass", "<f", [-1.0, *_BAD]),
    ("render_info.camera_width", "<H", [0]),
    ("render_info.camera_height", "<H", [0]),
    *((f"render_info.camera_focal[{i}]", "<f", [0.0, -1.0, *_BAD]) for i in range(2)),
    *((f"render_info.camera_rotation[{i}]", "<f", _BAD) for i in range(4)),
    *((f"render_info.camera_translation[{i}]", "<f", _BAD) for i in range(3)),
)


# --- directory (SPEC 6.6, 12.1) ---------------------------------------------------------------------------------------


@_fault("directory.unknown_critical")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    entry = draw(st.integers(0, len(t.fields.directory) - 1))
    at = t.at(f"directory[{entry}].type")
    return repair(t.put(at, bytes([draw(st.sampled_from([0x80, 0x88, 0xFF]))]))), at


@_fault("directory.order")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    count = len(t.fields.directory)
    kind = draw(st.sampled_from(["swap", "repeat", "ancillary", "zero", "few"]))
    if kind == "few":
        left = draw(st.integers(0, 6))

        def change(fields: Any) -> None:
            fields.section_count, fields.directory = left, fields.directory[:left]

        return t.with_header(change), t.at("section_count")
    entry = draw(st.integers(0, 5 if kind == "swap" else count - 1))
    at = t.at(f"directory[{entry}].type")
    if kind == "swap":
        other = t.at(f"directory[{entry + 1}].type")
        data = bytearray(t.data)
        data[at], data[other] = data[other], data[at]
        return repair(bytes(data)), at
    if kind == "repeat":
        _need(entry > 0)
        return repair(t.put(at, t.data[t.at(f"directory[{entry - 1}].type") :][:1])), at
    _need(kind == "zero" or entry < 7)
    return repair(t.put(at, b"\0" if kind == "zero" else b"\x05")), at


@_fault("directory.mode")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    entry = draw(st.integers(0, 6))
    at = t.at(f"directory[{entry}].mode")
    least = 1 + directory.MODES.get(list(directory.SECTIONS)[entry], 0)
    return repair(t.put(at, bytes([draw(st.integers(least, 255))]))), at


@_fault("directory.offset")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    entry = draw(st.integers(0, len(t.fields.directory) - 1))
    at = t.at(f"directory[{entry}].offset")
    right = t.fields.directory[entry].offset
    wrong = draw(st.sampled_from([right + 1, right - 1, 0, len(t.data), 0xFFFFFFFF]).filter(lambda x: x != right))
    return repair(t.put(at, wrong.to_bytes(4, "little"))), at


@_fault("directory.length")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    modes = {kind: section.mode for kind, section in t.sections.items()}
    implied = directory.section_lengths(t.header.dimensions, t.header.anchor_count, len(t.header.chunks), modes)
    kinds = [k for k in implied if t.content(k)]
    kind = draw(st.sampled_from(kinds))
    content = t.content(kind)
    content = (
        content + draw(st.binary(min_size=1, max_size=7))
        if draw(st.booleans())
        else content[: -draw(st.integers(1, 6))]
    )
    return resized(t.data, kind, content), t.at(f"directory[{list(directory.SECTIONS).index(kind)}].length")


@_fault("directory.file_length")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    if draw(st.booleans()):
        return t.data + draw(st.binary(min_size=1, max_size=9)), len(t.data)
    length = draw(st.integers(t.header_end, len(t.data) - 1))
    return t.data[:length], length


@_fault("section.crc")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    section = draw(st.sampled_from([s for s in t.sections.values() if s.end > s.start]))
    at = draw(st.integers(section.start, section.end - 1))
    return t.put(at, bytes([t.data[at] ^ draw(st.integers(1, 255))])), section.start


# --- frame, weights, planes, chunk table, positions (SPEC 6.7 to 6.11) ------------------------------------------------

_set(
    "frame.range",
    *((f"frame.matrix[{i}]", "<i", [1 << 20, -(1 << 20), -(1 << 31)]) for i in range(9)),
    *((f"frame.translation[{i}]", "<q", [1 << 61, -(1 << 61), -(1 << 63)]) for i in range(3)),
    *((f"frame.shift[{i}]", "B", [61, 255]) for i in range(3)),
    ("frame.reserved", "B", [1, 255]),
    *((f"frame.low[{i}]", "<i", [1 << 18, -(1 << 18) - 1]) for i in range(3)),
    *((f"frame.high[{i}]", "<i", [(1 << 18) + 1, -(1 << 18)]) for i in range(3)),
)


@_fault("weights.scale")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    start, inputs = t.start(directory.WEIGHTS), t.header.dimensions.carm_inputs
    item = draw(st.integers(0, 1 + inputs))
    wrong = (
        [weights.PLANE_SHIFT_MAX + 1, 255]
        if item == 0
        else [inputs + 1, 255]
        if item == 1
        else [weights.CARM_SHIFT_MAX + 1, 255]
    )
    return repair(t.put(start + item, bytes([draw(st.sampled_from(wrong))]))), start + item


def _first_value(t: Target) -> int:
    """Where the values begin, in mode 0."""
    _need(not t.sections[directory.WEIGHTS].mode)
    return t.start(directory.WEIGHTS) + 2 + t.header.dimensions.carm_inputs


@_fault("weights.not_finite")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    value = draw(st.integers(0, (t.sections[directory.WEIGHTS].end - _first_value(t)) // 4 - 1))
    at = _first_value(t) + 4 * value
    return repair(t.put(at, draw(st.sampled_from([NAN, INFINITY, b"\1\0\x80\xff", b"\1\0\x80\x7f"])))), at


@_fault("weights.bound")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    """A weight that no exponent makes small enough, or a bias."""
    rows, at = [], _first_value(t)
    for name, shapes in t.header.dimensions.network_shapes().items():
        for out, fan_in in shapes:
            if name not in ("opacity", "covariance", "colour"):
                rows += [(at + 4 * fan_in * r, fan_in, at + 4 * (out * fan_in + r)) for r in range(out)]
            at += 4 * out * (fan_in + 1)
    first, fan_in, bias = draw(st.sampled_from(rows))
    if draw(st.booleans()):
        return repair(t.put(bias, struct.pack("<f", draw(st.sampled_from([2.0**24, -(2.0**24), 3.4e38]))))), first
    weight = first + 4 * draw(st.integers(0, fan_in - 1))
    return repair(t.put(weight, struct.pack("<f", draw(st.sampled_from([1023.5, -1023.75, 1024.0, -3.4e38]))))), first


@cache
def _grids_target(seed: int) -> Target:
    """A file whose first layer is raw in mode 1 and whose other layers are packed; no symbol of a weight is raw bits."""
    scene = random_scene(seed, 2, SMALLEST, lanes=Lanes(0, 0, seed % 3))
    networks = quantise_rendering(exact_networks(scene.networks), 6)
    networks["hyper"][0][1][0] = -0.0
    return Target(codec.emit(with_steps(replace(scene, networks=networks, weight_scales=weight_scales(networks)))))


@_fault("weights.length")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    """A section that ends within its table, its models or the raw layer's values."""
    t = _grids_target(draw(st.integers(0, 5)))
    start = t.start(directory.WEIGHTS)
    length = list(grid_layers(t).values())[-1] + 5 - start
    return resized(t.data, directory.WEIGHTS, t.content(directory.WEIGHTS)[: draw(st.integers(0, length))]), start


@_fault("weights.layer")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    t = _grids_target(draw(st.integers(0, 5)))
    starts = list(grid_layers(t).values())
    kind = draw(st.sampled_from(["form", "exponent", "raw", "scale"]))
    at = starts[0] if kind in ("raw", "scale") else draw(st.sampled_from(starts))
    if kind == "form":
        return repair(t.put(at, bytes([draw(st.integers(2, 255))]))), at
    if kind == "scale":
        field = at + draw(st.integers(3, 5))
        return repair(t.put(field, bytes([draw(st.integers(1, 255))]))), field
    wrong = [1, -1, 149, -104] if kind == "raw" else [150, -105, 32767, -32768]
    return repair(t.put(at + 1, struct.pack("<h", draw(st.sampled_from(wrong))))), at + 1


def _with_grids(t: Target, change: Callable[[list[Any]], Any]) -> tuple[bytes, int]:
    """The file with other integers in its packed layers, coded rightly; change returns the number of the layer that it made wrong."""
    scene = codec.parse(t.data).scene
    scales = scene.weight_scales
    assert scales is not None
    layers = [layer for network in scene.networks.values() for layer in network]
    grids: list[Any] = [weights.to_grid(layer) for layer in layers]
    wrong = change(grids)
    packed = [i for i, grid in enumerate(grids) if grid is not None]
    encoder = Encoder(1, 1 << scene.lanes.attribute)
    shapes = dimensions.layers_of(scene.dimensions)
    weights.code_grids(encoder, [shapes[i] for i in packed], scales[packed], [grids[i] for i in packed])
    starts = list(grid_layers(t).values())
    start, stream_at = t.start(directory.WEIGHTS), starts[-1] + 6
    models = bytearray(t.data[start:stream_at])
    models[starts[wrong] + 1 - start : starts[wrong] + 3 - start] = struct.pack("<h", grids[wrong].exponent)
    return resized(t.data, directory.WEIGHTS, bytes(models) + encoder.finish()[0]), starts[wrong]


@_fault("weights.exponent")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    """A row whose integers are all even; a first difference that the model's exponent should be; one that leads out of the limits."""
    t, kind = _grids_target(draw(st.integers(0, 5))), draw(st.sampled_from(["even", "first", "outside", "zero"]))

    def change(grids: list[Any]) -> int:
        number = draw(st.integers(1, len(grids) - 1))
        g = grids[number]
        parts = {
            "difference": g.difference.copy(),
            "weight": g.weight.copy(),
            "bias": g.bias.copy(),
            "exponent": g.exponent,
        }
        if kind == "even":
            parts["weight"][0], parts["bias"][0] = 2, 4
        elif kind == "first":
            parts["weight"][0, 0] = parts["difference"][0] = 1
        elif kind == "outside":
            parts["difference"][-1] = draw(st.sampled_from([-1, 1])) * 1000
        else:
            # All zero, with an exponent that says nothing.
            parts["difference"][:], parts["weight"][:], parts["bias"][:], parts["exponent"] = 0, 0, 0, 7
        grids[number] = weights.GridLayer(**parts)
        return number

    return _with_grids(t, change)


@_fault("weights.raw")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    """The raw layer without its -0."""
    t = _grids_target(draw(st.integers(0, 5)))
    at = next(iter(grid_layers(t).values()))
    out, fan_in = t.header.dimensions.network_shapes()["hyper"][0]
    return repair(t.put(at + 6 + 4 * out * fan_in, bytes(4))), at


@_fault("planes.length")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    start = t.start(directory.PLANES_SECTION)
    if draw(st.booleans()):
        return resized(
            t.data, directory.PLANES_SECTION, t.content(directory.PLANES_SECTION)[: draw(st.integers(0, 19))]
        ), start
    at = start + 4 * draw(st.integers(0, 4))
    old = int.from_bytes(t.data[at : at + 4], "little")
    return repair(t.put(at, draw(st.sampled_from([old + 1, old - 1, 0xFFFFFFFF])).to_bytes(4, "little"))), start


@_fault("chunks.mask_model")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    k = t.header.dimensions.offset_count
    at = t.table + 2 * draw(st.integers(0, k * (k + 1) // 2 - 1))
    return repair(t.put(at, draw(st.sampled_from([0, 1 << 14, 65535])).to_bytes(2, "little"))), at


@_fault("chunks.length")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    _need(t.header.chunks)
    entry = t.entries + 24 * draw(st.integers(0, len(t.header.chunks) - 1))
    column = draw(st.integers(0, 2))
    old = int.from_bytes(t.data[entry + 8 * column : entry + 8 * column + 4], "little")
    new = draw(st.sampled_from([old + 1, old - 1, 0xFFFFFFFF]))
    told = entry if column == 0 and not t.position_mode else t.start(directory.CHUNKED[column])
    if column == 0 and t.position_mode and draw(st.booleans()):
        new, told = 0, entry
    return repair(t.put(entry + 8 * column, new.to_bytes(4, "little")), chunks=False), told


@_fault("chunks.crc")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    _need(t.header.chunks)
    column, chunk = draw(st.integers(0, 2)), draw(st.integers(0, len(t.header.chunks) - 1))
    at = t.entries + 24 * chunk + 8 * column + 4
    part = t.start(directory.CHUNKED[column])
    for before in range(chunk):
        part += int.from_bytes(t.data[t.entries + 24 * before + 8 * column :][:4], "little")
    return repair(t.put(at, bytes([t.data[at] ^ draw(st.integers(1, 255))])), chunks=False), part


@_fault("chunks.position_model")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    _need(t.position_mode)
    if draw(st.booleans()):
        return repair(t.put(t.position_model, bytes([draw(st.integers(CELL_INDEX + 1, 255))]))), t.position_model
    model, symbol = draw(st.integers(0, POSITION_MODELS - 1)), draw(st.integers(0, HALVES - 1))
    first = t.position_model + 1 + 2 * HALVES * model
    values = list(struct.unpack_from("<16H", t.data, first))
    other = (symbol + 1) % HALVES
    # A sum that is wrong, or a right one with a 0 in the wrong place.
    if draw(st.booleans()):
        values[symbol] = (values[symbol] + draw(st.integers(1, 65535))) % 65536
    else:
        values[symbol], values[other] = (0, values[other] + values[symbol]) if values[symbol] else (values[other], 0)
    return repair(t.put(first, struct.pack("<16H", *values))), first


def _position(draw: st.DrawFn, t: Target, bad: st.SearchStrategy[int]) -> tuple[bytes, int]:
    # In mode 1 a raw chunk's numbers are behind its form.
    skip = t.position_mode
    parts = [part for part in position_parts(t) if not skip or t.data[part[0]] == RAW]
    _need(parts)
    start, _, anchors = draw(st.sampled_from(parts))
    at = start + skip + 2 * draw(st.integers(0, 3 * anchors - 1))
    return repair(t.put(at, draw(bad).to_bytes(2, "little"))), at


@_fault("positions.form")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    _need(t.position_mode and t.header.chunks)
    number = draw(st.integers(0, len(t.header.chunks) - 1))
    start, _, anchors = position_parts(t)[number]
    if draw(st.booleans()):
        return repair(t.put(start, bytes([draw(st.integers(2, 255))]))), start
    size = draw(st.integers(-(-anchors // 16), 6 * anchors + 9).filter(lambda n: n != 1 + 6 * anchors))
    return with_positions(t, number, bytes(size)), start


@cache
def _packed_target(seed: int) -> Target:
    """A file of five anchors whose cells stand in their order."""
    scene = random_scene(seed, 5, SMALLEST, lanes=Lanes(0, 1, 0))
    rng = np.random.default_rng(seed)
    lattice = rng.permutation(1000)[:5][:, None] // np.array([1, 10, 100]) % 10
    return Target(codec.emit(pack_positions(with_steps(replace(scene, positions=lattice.astype(np.float16))))))


@_fault("positions.raw")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    t = _packed_target(draw(st.integers(0, 9)))
    positions = codec.parse(t.data).scene.positions
    return with_positions(t, 0, b"\0" + positions.astype("<f2").tobytes()), t.start(directory.POSITIONS)


def _other_cells(t: Target, change: Callable[[Any], Any]) -> tuple[bytes, int]:
    """The file with other cells, coded rightly."""
    scene = codec.parse(t.data).scene
    model = scene.position_model
    assert model is not None
    code = change(chunk_codes(scene.positions, model.cell_shift))
    encoder = Encoder(1, 1 << scene.lanes.mask)
    code_cells(encoder, model.models(), [0], [len(code)], code)
    return with_positions(t, 0, bytes([PACKED]) + encoder.finish()[0]), t.start(directory.POSITIONS)


@_fault("positions.count")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    t = _packed_target(draw(st.integers(0, 9)))
    if draw(st.booleans()):
        return _other_cells(t, lambda code: code[:4])
    # A sibling of a cell, so that no level but the last has more nodes than there are anchors.
    return _other_cells(
        t, lambda code: np.unique(np.append(code, next(c for c in code[4] ^ np.arange(1, 8) if c not in code)))
    )


@_fault("positions.cell")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    """The last cell, where the integer has more bits than an fp16."""
    return _other_cells(_packed_target(draw(st.integers(0, 9))), lambda code: np.append(code[:4], (1 << 48) - 1))


@_fault("positions.not_finite")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    return _position(draw, t, st.one_of(st.integers(0x7C00, 0x7FFF), st.integers(0xFC00, 0xFFFF)))


@_fault("positions.negative_zero")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    return _position(draw, t, st.just(0x8000))


# --- substreams (SPEC 8) ----------------------------------------------------------------------------------------------


def _stream(draw: st.DrawFn, t: Target) -> tuple[int, int, int, int]:
    """One substream: (section, start, length, where its length is stored)."""
    return draw(st.sampled_from(t.substreams))


@_fault("substream.length")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    stream = _stream(draw, t)
    kind, start, length, _ = stream
    if draw(st.booleans()):
        return with_stream(t, stream, t.data[start : start + draw(st.integers(0, 7 + 4 * lanes_of(t, kind)))]), start
    room = (length - 8 - 4 * lanes_of(t, kind)) // 2
    return repair(t.put(start + 4, draw(st.sampled_from([room + 1, 1 << 31, 0xFFFFFFFF])).to_bytes(4, "little"))), start


@_fault("substream.state")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    kind, start, _, _ = _stream(draw, t)
    at = start + 8 + 4 * draw(st.integers(0, lanes_of(t, kind) - 1))
    return repair(t.put(at, draw(st.integers(0, 0xFFFF)).to_bytes(4, "little"))), start


@_fault("substream.words")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    """Words that no lane takes."""
    stream = _stream(draw, t)
    kind, start, length, _ = stream
    words = int.from_bytes(t.data[start + 4 : start + 8], "little")
    end = 8 + 4 * lanes_of(t, kind) + 2 * words
    more = draw(st.integers(1, 3))
    part = t.data[start : start + length]
    content = part[:4] + (words + more).to_bytes(4, "little") + part[8:end] + bytes(2 * more) + part[end:]
    return with_stream(t, stream, content), start


@_fault("substream.final_state")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    """A lane that no symbol uses, not at its final state."""
    idle = [
        s
        for s in t.substreams
        if s[0] == directory.MASKS and lanes_of(t, directory.MASKS) > min(t.header.chunk_size, 4096)
    ]
    _need(idle)
    _, start, _, _ = draw(st.sampled_from(idle))
    at = start + 8 + 4 * (lanes_of(t, directory.MASKS) - 1)
    return repair(t.put(at, draw(st.integers(0x10001, 0xFFFFFFFF)).to_bytes(4, "little"))), start


def _far_symbol(seed: int, symbol: int, lanes: int) -> tuple[Target, int, int]:
    """A file whose first feature is an escape of one anchor without offsets: its target, the attribute substream, its raw bytes."""
    scene = random_scene(seed, 1, SMALLEST, gain=0.0, lanes=Lanes(0, 0, lanes), keep=0.0)
    # All means are -20 steps; every symbol but one is there.
    scene.networks["hyper"][-1][1][:] = -320.0
    for values in (scene.attributes.features, scene.attributes.scalings):
        values[:] = -20
    scene.attributes.features[0, 0] = symbol
    scene = replace(scene, attributes=replace(scene.attributes, steps=codec.derive_steps(scene)))
    t = Target(codec.emit(scene))
    start = t.start(directory.ATTRIBUTES)
    return t, start, start + 8 + 4 * (1 << lanes) + 2 * struct.unpack_from("<I", t.data, start + 4)[0]


@_fault("substream.escape")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    """Zeros where a prefix should end."""
    t, start, raw = _far_symbol(draw(st.integers(0, 99)), draw(st.sampled_from([-1, 1])) << 20, draw(st.integers(0, 3)))
    return repair(t.data[:raw] + bytes(len(t.data) - raw)), start


@_fault("substream.symbol_range")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    """The largest symbol, a little further from its mean."""
    sign = draw(st.sampled_from([-1, 1]))
    t, start, raw = _far_symbol(draw(st.integers(0, 99)), sign * ((1 << 23) - 1), draw(st.integers(0, 3)))
    # The escape: a sign, its prefix, then the low bits of its size, which become all ones.
    bits = int.from_bytes(t.data[raw:], "little")
    prefix = (bits >> 1 & -(bits >> 1)).bit_length() - 1
    bits |= ((1 << prefix) - 1) << (prefix + 2)
    return repair(t.data[:raw] + bits.to_bytes(len(t.data) - raw, "little")), start


@_fault("substream.raw_length")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    stream = _stream(draw, t)
    _, start, length, _ = stream
    return with_stream(t, stream, t.data[start : start + length] + draw(st.binary(min_size=1, max_size=3))), start


@_fault("substream.raw_padding")
def _(draw: st.DrawFn, _: Target) -> tuple[bytes, int]:
    """An escape of 2 z + 2 bits, which do not fill their last byte, and one of the bits after it."""
    z = draw(st.sampled_from([z for z in range(6, 21) if (2 * z + 2) % 8]))
    t, start, raw = _far_symbol(draw(st.integers(0, 99)), 3 << (z - 1), draw(st.integers(0, 3)))
    bits = int.from_bytes(t.data[raw:], "little")
    used = 2 * z + 2
    bits |= 1 << draw(st.integers(used, 8 * (len(t.data) - raw) - 1))
    return repair(t.data[:raw] + bits.to_bytes(len(t.data) - raw, "little")), start


@_fault("substream.symbol_crc")
def _(draw: st.DrawFn, t: Target) -> tuple[bytes, int]:
    _, start, _, _ = _stream(draw, t)
    at = start + draw(st.integers(0, 3))
    return repair(t.put(at, bytes([t.data[at] ^ draw(st.integers(1, 255))]))), start


def draw_fault(draw: st.DrawFn, target: Target, name: str) -> Fault | None:
    """A file with the named fault, made from a valid file of profile Tiny; None if that file has no place for it."""
    try:
        data, offset = FAULTS[name](draw, target)
    except NoPlaceError:
        return None
    return Fault(data, name, offset)
