"""The facts about a file, as JSON values and as lines of text."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..bitstream.ancillary import TYPES
from ..bitstream.chunks import PARTS as CHUNK_PARTS
from ..bitstream.dimensions import STATIC, mask_contexts
from ..bitstream.directory import DATA, FRAME, INDEX, PLANES_SECTION, WEIGHTS
from ..bitstream.errors import BitstreamError
from ..bitstream.header import PROLOGUE_BYTES
from ..bitstream.limits import PROFILES
from ..bitstream.planes import PLANE_NAMES
from ..bitstream.scene import Ancillary
from ..bitstream.source import pad4
from ..files.text import printable
from .elements import Bytes, Outline, outline_of, parse_elements, read_index
from .parts import part_bytes

# SPEC 5.13: the index fields that are shown, and their names in text.
_SHOWN = {"length": "bytes", "anchor_count": "anchors", "kept_count": "kept offsets"}
# Chunks per step.
_BLOCK = 4096
# The most bytes of an ancillary section that are looked at.
_ANCILLARY_BYTES = 1 << 24
# SPEC 9.3: the digest of a scene, and that of each part by name.
Verdict = tuple[str, dict[str, str]]
# Columns of the bar of a section that is the whole file.
_BAR = 20
_row = f"{{:<14}} {{:>4}} {{:>4}} {{:>10}} {{:>10}} {{:>7}}  {{:<{_BAR}}} {{:>12}}".format


def _plain(value: Any) -> Any:
    """Returns values of construct as JSON values. Bytes become hexadecimal, numbers that JSON lacks become text."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if not k.startswith("_")}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _section_table(data: Bytes, outline: Outline) -> list[dict[str, Any]]:
    """Returns the name, place, size with its padding, and share of the prologue, the header and each section."""
    h = outline.header
    spans: list[tuple[str, str | None, int | None, int, int]] = [
        ("prologue", None, None, 0, min(len(data), PROLOGUE_BYTES))
    ]
    if outline.header_end > PROLOGUE_BYTES:
        spans.append(("header", None, None, PROLOGUE_BYTES, outline.header_end))
    spans += [(p.name, p.type.decode("latin-1"), p.mode, p.start, p.stop) for p in outline.sections]
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


@dataclass(frozen=True, eq=False)
class ChunkSizes:
    """The chunks that a file claims to have. A damaged file may claim a million, thus each is created on demand.

    table: the entries of the index.
    """

    table: NDArray[np.void]

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for first in range(0, len(self.table), _BLOCK):
            for row in self.table[first : first + _BLOCK]:
                bounds = {name: [_plain(float(v)) for v in row[name]] for name in ("low", "high")}
                yield {**{name: int(row[name]) for name in _SHOWN}, **bounds}


def document(data: Bytes, verdict: Verdict | BitstreamError | None, heads: bool = True) -> dict[str, Any]:
    """Returns the facts about a file as JSON values, and its chunks as ChunkSizes.

    Nothing is decoded. Only the header, the tables at the beginning of sections, and the shown ancillary sections are
    read.

    verdict: the digest of an accepted file, or its first error, or None if the file was not decoded. heads: whether the
    heads of the chunks are read, which state the lengths of their parts.
    """
    outline = outline_of(data)
    h, d = outline.header, outline.dimensions
    facts: dict[str, Any] = {
        "bytes": len(data),
        "prologue": _plain(parse_elements("Prologue", data, 0, PROLOGUE_BYTES, "prologue")[1]),
        "header": _plain(h),
        "profile": PROFILES[h.profile].name if h and h.profile in PROFILES else None,
        "sections": _section_table(data, outline),
        "parts": part_bytes(data, outline, heads),
    }
    for place in outline.sections:
        start, end = place.start, place.end
        if place.type == FRAME:
            facts["frame"] = _plain(parse_elements("Frame", data, start, end, "frame")[1])
        elif place.type == WEIGHTS and d:
            scales = parse_elements("WeightScales", data, start, end, "weights")[1]
            facts["weights"] = {"scales": _plain(scales), "networks": _plain(d.network_shapes())}
        elif place.type == PLANES_SECTION:
            table = parse_elements("PlaneTable", data, start, end, "planes")[1]
            facts["planes"] = dict(zip(PLANE_NAMES, table.length, strict=True)) if table else None
        elif place.type == INDEX:
            count = min(mask_contexts(h.dimensions.offset_count), (end - start) // 2)
            facts["mask_model"] = np.frombuffer(data[start : start + 2 * count], "<u2").tolist()
            if place.mode:
                model = parse_elements("PositionModel", data, min(start + pad4(2 * count), end), end, "")[1]
                facts["position_model"] = _plain(model)
            facts["chunks"] = ChunkSizes(read_index(data, outline))
            facts["kept_offsets"] = int(facts["chunks"].table["kept_count"].sum(dtype=np.uint64))
    sections = [
        Ancillary(p.type, p.mode, data[p.start : min(p.end, p.start + _ANCILLARY_BYTES)])
        for p in outline.sections
        if p.type in TYPES
    ]
    facts |= {entry.name: entry.facts(sections) for entry in TYPES.values()}
    facts["accepted"] = None
    if isinstance(verdict, BitstreamError):
        facts |= {"accepted": False, "error": {**json.loads(verdict.to_json()), "text": str(verdict)}}
    elif verdict is not None:
        facts |= {"accepted": True, "digest": {"whole": verdict[0], **verdict[1]}}
    if facts["header"] and not facts["accepted"] and outline.stated_end != len(data):
        facts["stated_bytes"] = outline.stated_end
    return facts


class _Streamed(list[Any]):
    """A list whose items are created while they are written: the encoder with an indent iterates over it."""

    def __init__(self, items: ChunkSizes) -> None:
        super().__init__()
        self._items = items

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Any]:
        return iter(self._items)


def json_lines(facts: dict[str, Any]) -> Iterator[str]:
    """Yields the lines of the facts of `document` as one JSON text."""
    line = ""
    for part in json.JSONEncoder(indent=1, default=_Streamed).iterencode(facts):
        *whole, rest = (line + part).split("\n")
        yield from whole
        line = rest
    yield line


def summary(facts: dict[str, Any], name: str) -> Iterator[str]:
    """Yields the facts of `document` as lines of text. name: that of the file."""
    p, h = facts["prologue"], facts["header"]
    version = f"C3GS version {p['major']}.{p['minor']}" if p else "C3GS version unknown"
    # SPEC 6.1: in any other file the fields have no meaning.
    signed = not p or b"C3GS".hex() in p["signature"]
    stated = facts.get("stated_bytes")
    wrong = "" if stated is None else ", NOT WHOLE" if facts["bytes"] < stated else ", TOO LONG"
    version += wrong and f"{wrong}: its header states {stated} bytes"
    yield f"{name}: {facts['bytes']} bytes, {version if signed else 'not a C3GS file'}"
    if not signed:
        return
    if h:
        yield from _header_lines(facts, h)
    yield ""
    yield _row("section", "type", "mode", "offset", "bytes", "share", "", "bits/anchor")
    for s in facts["sections"]:
        kind, mode = ("" if s["type"] is None else printable(s["type"])), ("" if s["mode"] is None else s["mode"])
        bits = "-" if s["bits_per_anchor"] is None else f"{s['bits_per_anchor']:.2f}"
        bar = "#" * round(_BAR * s["share"])
        yield _row(s["name"], kind, mode, s["offset"], s["bytes"], f"{s['share']:.1%}", bar, bits)
        if kind == DATA.decode():
            yield from _data_lines(facts, h["anchor_count"])
    whole_bits = f"{8 * facts['bytes'] / h['anchor_count']:.2f}" if h and h["anchor_count"] else "-"
    yield _row("whole", "", "", "", facts["bytes"], f"{1:.1%}", "", whole_bits)
    yield ""
    yield from _chunk_lines(facts)
    if facts["accepted"]:
        yield f"accepted; digest {facts['digest']['whole']}"
    elif facts["accepted"] is None:
        yield "not decoded; refcodec validate reports whether it is accepted, and inspect --decode also the digest"
    else:
        yield f"NOT ACCEPTED: {facts['error']['code']} {facts['error']['name']}: {facts['error']['text']}"


def _header_lines(facts: dict[str, Any], h: dict[str, Any]) -> Iterator[str]:
    d = h["dimensions"]

    def widths(values: list[int]) -> str:
        return "-".join(map(str, values)) or "none"

    yield f"profile      {facts['profile'] or 'unknown'} ({h['profile']}), level {h['level']}"
    kept = ""
    if "kept_offsets" in facts:
        kept = f", {facts['kept_offsets']} of {h['anchor_count'] * d['offset_count']} offsets kept"
    yield f"anchors      {h['anchor_count']}, {d['offset_count']} offsets each{kept}"
    yield f"features     {sum(d['slice_width'])} in slices {widths(d['slice_width'])}"
    size = f"{d['plane_channels']} x {d['plane_size']} x {d['plane_size']}"
    yield f"planes       5 of {size}, {d['frequency_count']} frequencies"
    hidden = ", ".join(f"{n} {widths(d[f'{n}_width'])}" for n in ("hyper", "sarm", "carm"))
    yield f"networks     hidden {hidden}, render {d['render_width']}"
    # SPEC 6.5: most scenes are view-dependent.
    if model := h["render_info"]["render_model"]:
        degree = math.isqrt(d["colour_outputs"] // 3) - 1
        yield f"render model {model}" + (f", static, harmonics of degree {degree}" if model == STATIC else "")
    lanes = (f"{part}s {1 << h[f'{part}_lanes_log2']}" for part in ("plane", "mask", "attribute"))
    yield f"lanes        {', '.join(lanes)}"
    steps = zip(("features", "scalings", "offsets"), h["base_step"], strict=True)
    yield f"base steps   {', '.join(f'{kind} {np.float32(float(step))!s}' for kind, step in steps)}"

    for entry in TYPES.values():
        for label, text in entry.lines(facts[entry.name], printable):
            yield f"{label:<12} {text}"


def _data_lines(facts: dict[str, Any], anchors: int) -> Iterator[str]:
    """Yields the sizes of the parts of all chunks."""
    for name in (*CHUNK_PARTS, "heads") if "heads" in facts["parts"] else ():
        size = facts["parts"][name]
        share = size / max(1, facts["bytes"])
        bits = f"{8 * size / anchors:.2f}" if anchors else "-"
        yield _row(f"  {name}", "", "", "", size, f"{share:.1%}", "", bits)


def _chunk_lines(facts: dict[str, Any]) -> Iterator[str]:
    chunks = facts.get("chunks")
    if not chunks:
        return
    yield f"{len(chunks)} chunks of at most {facts['header']['chunk_size']} anchors"
    yield f"{'of a chunk':<18} {'smallest':>10} {'mean':>12} {'largest':>10}"
    for field, words in _SHOWN.items():
        sizes = chunks.table[field]
        mean = int(sizes.sum(dtype=np.uint64)) / len(sizes)
        yield f"  {words:<16} {sizes.min():>10} {mean:>12.1f} {sizes.max():>10}"
