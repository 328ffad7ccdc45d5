"""What `refcodec inspect` shows of a file: a summary, every byte with its syntax element, JSON, and the trace of a decoding.

All of it works on damaged files as far as they parse: nothing here raises for whatever bytes, and nothing here judges a file
(refcodec.codec does). Headers are read without checks, so every count is limited by the bytes that are there.
"""

from __future__ import annotations

import io
import json
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import construct as cs
import numpy as np
from numpy.typing import NDArray

from . import syntax
from .codec import Parsed, derive_networks, parse
from .container import CHUNK_ENTRY_BYTES, POSITION_BYTES, PROLOGUE_BYTES, SECTIONS, VERSION, dimensions_of, entries_start
from .conventions import rshift_round
from .entropy import TraceRow
from .errors import BitstreamError
from .geometry import assemble_planes, contract, frame_coordinates, position_integers, positional_encoding, query, rescale
from .limits import PROFILES
from .masks import context_count
from .networks import activation
from .planes import PLANE_NAMES
from .positions import PACKED
from .reconstruction import digest
from .scene import Dimensions, Scene
from .weights import layers_of

# No struct of SYNTAX is longer than the largest header.
_STRUCT_BYTES_MAX = 1 << 16
# Payloads longer than this are folded to their first bytes.
_HEX_BYTES = 16
_FOLDED_BYTES = 8
_NEAR_ROWS = 6
_BAR = 20


@dataclass(frozen=True)
class Row:
    """Some bytes of a file: data[start:end] are the element `path` of the type `kind`; value is None for a payload."""

    start: int
    end: int
    path: str
    kind: str
    value: Any = None


# --- the bytes and their elements -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Outline:
    """The header's fields as far as they parse, unchecked; sections: (type, start, end) in file order, cut to the file; entries:
    bytes of the chunk table before its entries."""

    header: Any
    header_end: int
    dimensions: Dimensions | None
    sections: list[tuple[int, int, int]]

    def mode(self, name: str) -> int:
        """The mode of a section, 0 if there is none."""
        return max((entry.mode for entry in self.header.directory if SECTIONS.get(entry.type) == name), default=0)

    @property
    def position_mode(self) -> int:
        """The mode of the positions."""
        return self.mode("positions")

    @property
    def entries_start(self) -> int:
        """Bytes of the chunk table before its entries (SPEC 5.10)."""
        return entries_start(self.header.dimensions.offset_count, self.position_mode)


def _elements(name: str, data: bytes, start: int, end: int, path: str) -> tuple[list[Row], Any]:
    """The elements of one struct in data[start:end], up to where the bytes end, and the struct if it is whole."""
    stream = io.BytesIO(data[start : min(end, start + _STRUCT_BYTES_MAX)])
    found: list[syntax.Element] = []
    try:
        value = syntax.SCHEMAS[name].parse_stream(stream, at=[path], elements=found)
    except cs.ConstructError:
        value = None
    return [Row(start + e.start, start + e.end, e.path, e.kind, e.value) for e in found], value


def _outline(data: bytes) -> _Outline:
    _, prologue = _elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")
    if prologue is None or prologue.version != VERSION:
        return _Outline(None, min(len(data), PROLOGUE_BYTES), None, [])
    end = min(len(data), PROLOGUE_BYTES + prologue.header_length)
    _, header = _elements("Header", data, PROLOGUE_BYTES, end, "header")
    if header is None:
        return _Outline(None, end, None, [])
    sections, at = [], end
    for entry in header.directory:
        stop = min(len(data), at + entry.length)
        sections.append((entry.type, at, stop))
        at = stop
    dimensions = dimensions_of(header.dimensions) if header.dimensions.slice_width else None
    return _Outline(header, end, dimensions, sections)


def rows(data: bytes) -> Iterator[Row]:
    """Every byte of a file, in file order and without gaps, whatever the bytes are."""
    outline = _outline(data)
    at = 0
    for row in _rows(data, outline):
        yield row
        at = row.end
    if at < len(data):
        yield Row(at, len(data), "bytes that no element uses", "bytes")


def _rows(data: bytes, outline: _Outline) -> Iterator[Row]:
    yield from _elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")[0]
    if outline.header_end > PROLOGUE_BYTES:
        header = _elements("Header", data, PROLOGUE_BYTES, outline.header_end, "header")[0]
        yield from header
        used = header[-1].end if header else PROLOGUE_BYTES
        yield from _payload(used, outline.header_end, outline.header_end, "header, bytes that no field uses", "bytes")
    for kind, start, end in outline.sections:
        used = start
        for row in _section_rows(data, outline, kind, start, end):
            yield row
            used = row.end
        name = SECTIONS.get(kind, f"extension_{kind:02x}")
        yield from _payload(used, end, end, name if used == start else f"{name}, bytes that no element uses", "bytes")


def _payload(start: int, stop: int, end: int, path: str, kind: str) -> Iterator[Row]:
    """One row for data[start:stop], cut at `end`; nothing if it is empty."""
    stop = min(stop, end)
    if start < stop:
        yield Row(start, stop, path, kind)


def _section_rows(data: bytes, outline: _Outline, kind: int, start: int, end: int) -> Iterator[Row]:
    h = outline.header
    name = SECTIONS.get(kind)
    if name == "frame":
        yield from _elements("Frame", data, start, end, "frame")[0]
    elif name == "weights":
        yield from _weight_rows(data, outline, start, end)
    elif name == "planes":
        found, table = _elements("PlaneTable", data, start, end, "planes")
        yield from found
        at = found[-1].end if found else start
        for plane, length in zip(PLANE_NAMES, table.length if table else [], strict=False):
            yield from _substream_rows(data, at, min(end, at + length), 1 << h.plane_lanes_log2, f"planes.{plane}")
            at = min(end, at + length)
    elif name == "chunk_table":
        contexts = context_count(h.dimensions.offset_count)
        for i in range(min(contexts, (end - start) // 2)):
            at = start + 2 * i
            yield Row(at, at + 2, f"chunk_table.mask_model[{i}]", "u16", int.from_bytes(data[at : at + 2], "little"))
        if outline.position_mode:
            yield from _elements("PositionModel", data, start + 2 * contexts, end, "chunk_table.position_model")[0]
        for number, at in enumerate(range(start + outline.entries_start, end - CHUNK_ENTRY_BYTES + 1, CHUNK_ENTRY_BYTES)):
            yield from _elements("ChunkEntry", data, at, at + CHUNK_ENTRY_BYTES, f"chunk_table.entry[{number}]")[0]
    elif name in ("positions", "masks", "attributes"):
        yield from _chunk_rows(data, outline, name, start, end)
    else:
        yield from _payload(start, end, end, f"extension_{kind:02x}", "bytes")


def _weight_rows(data: bytes, outline: _Outline, start: int, end: int) -> Iterator[Row]:
    found, scales = _elements("WeightScales", data, start, end, "weights")
    yield from found
    if scales is None or outline.dimensions is None:
        return
    at, mode = found[-1].end, outline.mode("weights")
    for name, out, fan_in in layers_of(outline.dimensions):
        if mode:
            found, model = _elements("LayerModel", data, at, end, f"weights.{name}")
            yield from found
            at = found[-1].end if found else at
            if model is None or model.form:
                continue
        for part, count, shape in (("weight", out * fan_in, f"{out},{fan_in}"), ("bias", out, f"{out}")):
            yield from _payload(at, at + 4 * count, end, f"weights.{name}.{part}", f"f32[{shape}]")
            at = min(end, at + 4 * count)
    if mode:
        yield from _substream_rows(data, at, end, 1 << outline.header.attribute_lanes_log2, "weights")


def _substream_rows(data: bytes, start: int, end: int, lanes: int, path: str) -> Iterator[Row]:
    """SPEC 5.14; what is cut off is left out."""
    found, head = _elements("SubstreamHead", data, start, end, path)
    yield from found
    if head is None:
        at = found[-1].end if found else start
        yield from _payload(at, end, end, path, "bytes")
        return
    at = found[-1].end
    words_at = min(end, at + 4 * lanes)
    raw_at = min(end, words_at + 2 * head.word_count)
    yield from _payload(at, words_at, end, f"{path}.state", f"u32[{lanes}]")
    yield from _payload(words_at, raw_at, end, f"{path}.word", f"u16[{head.word_count}]")
    yield from _payload(raw_at, end, end, f"{path}.raw", f"u8[{end - raw_at}]")


def _chunk_table(data: bytes, outline: _Outline) -> NDArray[np.int64]:
    """The chunk table's entries that are there: [chunks, 6], fields as in SPEC 5.10."""
    for kind, start, end in outline.sections:
        if SECTIONS.get(kind) == "chunk_table":
            at = start + outline.entries_start
            return np.frombuffer(data, "<u4", 6 * max(0, (end - at) // CHUNK_ENTRY_BYTES), min(at, end)).astype(np.int64).reshape(-1, 6)
    return np.zeros((0, 6), np.int64)


def _chunk_anchors(header: Any, number: int) -> int:
    """Anchors of a chunk."""
    return int(min(header.chunk_size, max(0, header.anchor_count - number * header.chunk_size)))


def _chunk_rows(data: bytes, outline: _Outline, name: str, start: int, end: int) -> Iterator[Row]:
    h = outline.header
    column = ("positions", "masks", "attributes").index(name)
    at = start
    for number, length in enumerate(_chunk_table(data, outline)[:, 2 * column].tolist()):
        if at == end:
            return
        stop, path = min(end, at + length), f"{name}[chunk {number}]"
        if name == "positions" and outline.position_mode and at < stop:
            yield Row(at, at + 1, f"{path}.form", "u8", data[at])
            at += 1
        if name == "positions" and not (outline.position_mode and data[at - 1] == PACKED):
            kind = f"f16[{_chunk_anchors(h, number)},3]"
            yield from _payload(at, stop, end, path, kind)
        else:
            lanes = 1 << (h.attribute_lanes_log2 if name == "attributes" else h.mask_lanes_log2)
            yield from _substream_rows(data, at, stop, lanes, path)
        at = stop


# --- text: hex --------------------------------------------------------------------------------------------------------


def _value_text(row: Row) -> str:
    if row.value is None:
        return f"{row.end - row.start} bytes"
    if isinstance(row.value, bytes):
        return ""
    if row.path.endswith(("crc", ".type")):
        return f"0x{row.value:0{2 * (row.end - row.start)}x}"
    if row.kind == "f32":
        return str(np.float32(row.value))
    return str(row.value)


def _hex(data: bytes, row: Row) -> str:
    folded = row.end - row.start > _HEX_BYTES
    shown = data[row.start : row.start + _FOLDED_BYTES if folded else row.end].hex(" ")
    return shown + " ..." if folded else shown


def _error_line(error: BitstreamError) -> str:
    return f"{error.offset:08x}  ^^ error {error.kind.code} {error.kind.name}: {error}"


def _rows_near(data: bytes, near: int | None) -> Iterator[Row]:
    """All rows, or those of the element at a byte and of a few before and after it."""
    if near is None:
        yield from rows(data)
        return
    before: deque[Row] = deque(maxlen=_NEAR_ROWS)
    after = _NEAR_ROWS
    for row in rows(data):
        # A byte past the end is looked for at the end.
        if row.end <= min(near, len(data) - 1):
            before.append(row)
        elif after >= 0:
            yield from before
            before.clear()
            yield row
            after -= 1


def hex_lines(data: bytes, errors: Sequence[BitstreamError] = (), near: int | None = None) -> Iterator[str]:
    """Offset, bytes, path, type and value of each element; errors of the file after the elements that they point at.

    near: a byte; the elements around it alone.
    """
    yield f"{'offset':<8}  {'bytes':<47}  {'element':<44}  {'type':<12}  value"
    waiting = deque(sorted(errors, key=lambda error: error.offset))
    for row in _rows_near(data, near):
        if near is not None:
            while waiting and waiting[0].offset < row.start:
                waiting.popleft()
        line = f"{row.start:08x}  {_hex(data, row):<47}  {row.path:<44}  {row.kind:<12}  {_value_text(row)}"
        yield line.rstrip()
        while waiting and waiting[0].offset < row.end:
            yield _error_line(waiting.popleft())
    if near is None or near >= len(data):
        yield f"{len(data):08x}  end of file"
        for error in waiting:
            yield _error_line(error)


# --- the summary ------------------------------------------------------------------------------------------------------


def _plain(value: Any) -> Any:
    """Containers of construct as JSON values: bytes in hexadecimal, numbers that JSON lacks as text."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if not k.startswith("_")}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _section_table(data: bytes, outline: _Outline) -> list[dict[str, Any]]:
    """Name, place, size and share of the prologue, the header and each section."""
    h = outline.header
    spans: list[tuple[str, int | None, int | None, int, int]] = [("prologue", None, None, 0, min(len(data), PROLOGUE_BYTES))]
    if outline.header_end > PROLOGUE_BYTES:
        spans.append(("header", None, None, PROLOGUE_BYTES, outline.header_end))
    for entry, (kind, start, end) in zip(h.directory if h else [], outline.sections, strict=True):
        spans.append((SECTIONS.get(kind, f"extension_{kind:02x}"), kind, entry.mode, start, end))
    anchors = h.anchor_count if h else 0
    return [
        {
            "name": name,
            "type": kind,
            "mode": mode,
            "offset": start,
            "bytes": end - start,
            "share": (end - start) / max(1, len(data)),
            "bits_per_anchor": 8 * (end - start) / anchors if anchors else None,
        }
        for name, kind, mode, start, end in spans
    ]


def document(data: bytes, verdict: Parsed | BitstreamError) -> dict[str, Any]:
    """The facts about a file as JSON values; verdict: what codec.parse returned or raised."""
    outline = _outline(data)
    h, d = outline.header, outline.dimensions
    found: dict[str, Any] = {
        "bytes": len(data),
        "prologue": _plain(_elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")[1]),
        "header": _plain(h),
        "profile": PROFILES[h.profile].name if h and h.profile in PROFILES else None,
        "sections": _section_table(data, outline),
    }
    for kind, start, end in outline.sections:
        if SECTIONS.get(kind) == "frame":
            found["frame"] = _plain(_elements("Frame", data, start, end, "frame")[1])
        elif SECTIONS.get(kind) == "weights" and d:
            scales = _elements("WeightScales", data, start, end, "weights")[1]
            found["weights"] = {"scales": _plain(scales), "networks": _plain(d.network_shapes())}
        elif SECTIONS.get(kind) == "planes":
            table = _elements("PlaneTable", data, start, end, "planes")[1]
            found["planes"] = dict(zip(PLANE_NAMES, table.length, strict=True)) if table else None
        elif SECTIONS.get(kind) == "chunk_table":
            count = min(context_count(h.dimensions.offset_count), (end - start) // 2)
            found["mask_model"] = np.frombuffer(data, "<u2", count, start).tolist()
            if outline.position_mode:
                model = _elements("PositionModel", data, start + 2 * count, end, "chunk_table.position_model")[1]
                found["position_model"] = _plain(model)
            found["chunks"] = [
                {"anchors": _chunk_anchors(h, number), "position_bytes": p, "mask_bytes": m, "attribute_bytes": a}
                for number, (p, _, m, _, a, _) in enumerate(_chunk_table(data, outline).tolist())
            ]
    if isinstance(verdict, BitstreamError):
        found["accepted"], found["error"] = False, {**json.loads(verdict.to_json()), "text": str(verdict)}
    else:
        whole, parts = digest(verdict.scene)
        found |= {"accepted": True, "kept_offsets": int(verdict.scene.masks.sum()), "digest": {"whole": whole, **parts}}
    return found


def summary(facts: dict[str, Any], name: str) -> Iterator[str]:
    """The facts of `document` as lines of text."""
    p, h = facts["prologue"], facts["header"]
    version = f"version {p['version']}" if p else "version unknown"
    yield f"{name}: {facts['bytes']} bytes, C3GS {version}"
    if h:
        yield from _header_lines(facts, h)
    yield ""
    yield f"{'section':<14} {'type':>4} {'mode':>4} {'offset':>10} {'bytes':>10} {'share':>7}  {'':<{_BAR}} {'bits/anchor':>12}"
    for s in facts["sections"]:
        kind, mode = ("" if s["type"] is None else f"{s['type']:02x}"), ("" if s["mode"] is None else s["mode"])
        bits = "-" if s["bits_per_anchor"] is None else f"{s['bits_per_anchor']:.2f}"
        bar = "#" * round(_BAR * s["share"])
        yield f"{s['name']:<14} {kind:>4} {mode:>4} {s['offset']:>10} {s['bytes']:>10} {s['share']:>7.1%}  {bar:<{_BAR}} {bits:>12}"
    whole_bits = f"{8 * facts['bytes'] / h['anchor_count']:.2f}" if h and h["anchor_count"] else "-"
    yield f"{'whole':<14} {'':>4} {'':>4} {'':>10} {facts['bytes']:>10} {1:>7.1%}  {'':<{_BAR}} {whole_bits:>12}"
    yield ""
    yield from _chunk_lines(facts)
    if facts["accepted"]:
        yield f"accepted; digest {facts['digest']['whole']}"
    else:
        yield f"NOT ACCEPTED: {facts['error']['code']} {facts['error']['name']}: {facts['error']['text']}"


def _header_lines(facts: dict[str, Any], h: dict[str, Any]) -> Iterator[str]:
    d = h["dimensions"]

    def widths(values: list[int]) -> str:
        return "-".join(map(str, values)) or "none"

    yield f"profile      {facts['profile'] or 'unknown'} ({h['profile']}), level {h['level']}"
    kept = f", {facts['kept_offsets']} of {h['anchor_count'] * d['offset_count']} offsets kept" if facts["accepted"] else ""
    yield f"anchors      {h['anchor_count']}, {d['offset_count']} offsets each{kept}"
    yield f"features     {sum(d['slice_width'])} in slices {widths(d['slice_width'])}"
    yield f"planes       5 of {d['plane_channels']} x {d['plane_size']} x {d['plane_size']}, {d['frequency_count']} frequencies"
    hidden = ", ".join(f"{n} {widths(d[f'{n}_width'])}" for n in ("hyper", "sarm", "carm"))
    yield f"networks     hidden {hidden}, render {d['render_width']}"
    yield "lanes        " + ", ".join(f"{part}s {1 << h[f'{part}_lanes_log2']}" for part in ("plane", "mask", "attribute"))
    steps = ", ".join(
        f"{kind} {np.float32(float(step))!s}" for kind, step in zip(("features", "scalings", "offsets"), h["base_step"], strict=True)
    )
    yield f"base steps   {steps}"


def _chunk_lines(facts: dict[str, Any]) -> Iterator[str]:
    chunks = facts.get("chunks")
    if not chunks:
        return
    yield f"{len(chunks)} chunks of {facts['header']['chunk_size']} anchors, the last one of {chunks[-1]['anchors']}"
    yield f"{'bytes of a chunk':<18} {'smallest':>10} {'mean':>12} {'largest':>10}"
    for part in ("position", "mask", "attribute"):
        sizes = [c[f"{part}_bytes"] for c in chunks]
        yield f"  {part + 's':<16} {min(sizes):>10} {sum(sizes) / len(sizes):>12.1f} {max(sizes):>10}"


# --- the trace --------------------------------------------------------------------------------------------------------


def trace(data: bytes, write: Callable[[str], object]) -> Parsed:
    """Decodes a file and writes one line per syntax element and per symbol, in decoding order.

    Columns, separated by tabs: path, type or family of models, mean, scale, value ("-" where there is none). Raises the
    BitstreamError of a file that is not accepted, after the lines that come before it.
    """
    write("path\tkind\tmean\tscale\tvalue\n")
    waiting = deque(_trace_parts(data))
    stage = ""

    def show(part: int, end: int) -> None:
        """Writes the elements up to those of a part, or to the byte `end`."""
        while waiting and waiting[0][0] <= part:
            for row in waiting.popleft()[1]:
                if row.start > end:
                    return
                write(f"{row.path}\t{row.kind}\t-\t-\t{_value_text(row) or row.value.hex()}\n")

    def symbol(row: TraceRow) -> None:
        nonlocal stage
        # Elements stand before the first symbol that is decoded after them.
        now = row.path[:5]
        if now != stage:
            stage = now
            show(_ORDER[now], len(data))
        write(f"{row.path}\t{row.family}\t{row.mean}\t{row.scale}\t{row.value}\n")

    try:
        parsed = parse(data, trace=symbol)
    except BitstreamError as error:
        # What was read before the error, and the element that it points at.
        show(_LAST, error.offset)
        raise
    show(_LAST, len(data))
    return parsed


def symbol_trace(data: bytes, write: Callable[[str], object]) -> Parsed:
    """Decodes a file and writes its symbol trace (vectors/README.md): a line `path value` for each symbol, substream after substream in
    file order, of each in the order of its CRC-32 (SPEC 8.8).

    Raises the BitstreamError of a file that is not accepted, after the lines of what was decoded.
    """
    # Of the symbols that are read side by side, in text: a row takes many times as much.
    found: dict[int, io.StringIO] = {}

    def add(row: TraceRow) -> None:
        found.setdefault(row.substream, io.StringIO()).write(f"{row.path} {row.value}\n")

    try:
        return parse(data, trace=add)
    finally:
        for _, text in sorted(found.items()):
            write(text.getvalue())


def anchor_rows(scene: Scene, number: int) -> Iterator[tuple[str, str, str]]:
    """What clauses 7.4 to 7.9 compute for an anchor, from its position to its distributions, and its symbols: as in Annex D.4, the
    quantity, its clause, its numbers. Raises IndexError for an anchor that the scene does not have.
    """
    if not 0 <= number < scene.anchor_count:
        raise IndexError(number)

    def row(what: str, clause: str, values: Iterable[object]) -> tuple[str, str, str]:
        return what, clause, ", ".join(str(value) for value in values)

    d, at = scene.dimensions, slice(number, number + 1)
    p = position_integers(scene.positions[at])
    v = frame_coordinates(scene.frame, p)
    w = contract(v)
    u = rescale(scene.frame, w)
    for what, clause, values in (("P of x, y, z", "7.4", p), ("v", "7.5.1", v), ("w", "7.5.2", w), ("u", "7.5.3", u)):
        yield row(what, clause, values[0])
    planes = assemble_planes(scene.planes)
    for r, plane in enumerate(planes, 1):
        yield row(f"samples of the plane of r = {r}", "7.5.4", query(plane, u[:, :2], scene.plane_shift)[0])
    yield row("positional encoding", "7.5.5", positional_encoding(u[:, 2], d.frequency_count)[0])
    networks, width = derive_networks(d, scene.carm_shift, scene.networks), d.attribute_width
    hyper = networks.entropy.hyper(networks.contexts(scene, scene.frame, planes, scene.plane_shift, scene.positions[at])).astype(np.int64)[
        0
    ]
    mean, scale = hyper[:width], hyper[width : 2 * width]
    yield row("means that F_h gives", "7.7", mean)
    yield row("scale indices that F_h gives", "7.7", scale)
    yield row("outputs for the step indices", "7.8", hyper[2 * width :])
    features, done = scene.attributes.features[at].astype(np.int64), 0
    for i, columns in enumerate(d.slices):
        part = slice(done, done + columns)
        change = np.zeros(2 * columns, np.int64)
        if i:
            earlier = activation(rshift_round(features[:, :done], networks.entropy.carm_shift[:done]))
            change = networks.entropy.carm[i - 1](earlier).astype(np.int64)[0]
        pairs = zip((mean[part] + change[:columns]).tolist(), (scale[part] + change[columns:]).tolist(), strict=True)
        yield row(f"slice {i}: mean and scale index of each channel", "7.9", pairs)
        yield row(f"slice {i}: symbols", "7.10", features[0, part])
        done += columns
    yield row("scalings: symbols", "7.10", scene.attributes.scalings[number])
    kept = zip(scene.masks[number], scene.attributes.offsets[number].tolist(), strict=True)
    yield row("offsets: symbols", "7.10", (tuple(offset) if mask else "masked" for mask, offset in kept))
    yield row("step indices of features, scalings, offsets", "7.8", scene.attributes.steps[number])


# Beginnings of the symbols' paths, and the parts of _trace_parts that come before them.
_ORDER = {"weigh": 0, "plane": 0, "posit": 1, "masks": 1, "attri": 2}
_LAST = 2


def _trace_parts(data: bytes) -> Iterator[tuple[int, Iterator[Row]]]:
    """The elements that are not symbols, in file order, by the part of the decoding that they belong to."""
    outline = _outline(data)

    yield 0, _rows(data, replace(outline, sections=[]))
    parts = {"chunk_table": 1, "positions": 1, "masks": 1, "attributes": _LAST}
    for kind, start, end in outline.sections:
        name = SECTIONS.get(kind, "")
        if name == "positions" and not outline.position_mode:
            yield 1, _position_rows(data, start, end)
        else:
            yield parts.get(name, 0 if name else _LAST), _section_rows(data, outline, kind, start, end)


def _position_rows(data: bytes, start: int, end: int) -> Iterator[Row]:
    """Positions value by value."""
    values = np.frombuffer(data, "<f2", max(0, end - start) // POSITION_BYTES * 3, start)
    for i, value in enumerate(values):
        yield Row(start + 2 * i, start + 2 * i + 2, f"positions[{i // 3},{i % 3}]", "f16", value)
