"""Descriptions of the format for other programs: c3gs.ksy for Kaitai Struct, and c3gs.magic for file(1).

Both are made from the syntax tables. They describe valid files, and check nothing that a decoder must check.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

from refcodec.bitstream.header import SIGNATURE
from refcodec.bitstream.limits import PROFILES
from refcodec.bitstream.syntax import SYNTAX, parse_elements, size_of
from refcodec.inspect import specification

from .example import EXAMPLE
from .made import ROOT, Made

KAITAI, MAGIC = ROOT / "spec" / "c3gs.ksy", ROOT / "spec" / "c3gs.magic"
# SPEC G.1.
MEDIA_TYPE = "model/vnd.c3gs"

# Kaitai Struct has no numbers of 16 bits with a point: these are their bits.
_SCALARS = {"u8": "u1", "u16": "u2", "u32": "u4", "u64": "u8", "i8": "s1", "i16": "s2", "i32": "s4", "i64": "s8"}
_SCALARS |= {"f16": "u2", "f32": "f4"}
_PADDED = "(4 - _io.pos % 4) % 4"
# What a syntax table says in other words than those of a field.
_LENGTHS = {"K (K + 1) / 2": "_root.header.dimensions.offset_count * (_root.header.dimensions.offset_count + 1) / 2"}
# SPEC 12.3: what a later minor version may have put behind the known fields, before the named field.
_FURTHER = {("Header", "header_crc"): "_io.size - _io.pos - 4"}
_TOP = """\
# Made by `python -m spec` from the syntax tables of SPEC.md.
meta:
  id: c3gs
  title: "C3GS: a bitstream for learned 3D Gaussian scenes"
  file-extension: c3gs
  xref:
    mime: {media_type}
  license: Apache-2.0
  endian: le
doc: |
  Format version 0. Numbers of type f16 are their bits. The coded symbols are words and raw bits here: SPEC.md
  chapters 7 and 8 decode them. The values of weights are bytes. A damaged ancillary section, which a decoder ignores,
  is an error here.
seq:
  - id: prologue
    type: prologue
  - id: header
    type: header
    size: prologue.header_length
  - id: sections
    type: section(_index)
    repeat: expr
    repeat-expr: header.section_count
types:
"""
# SPEC 5.6 to 5.17: what is in a section, and in what order.
_ORDER = """\
  section:
    doc: "A section and its padding."
    params:
      - id: number
        type: u2
    seq:
      - id: content
        size: entry.length
        type:
          switch-on: entry.type
          cases:
            '"FRAM"': frame
            '"WGTS"': weights
            '"PLNS"': planes
            '"INDX"': index(entry.mode)
            '"DATA"': data
            '"mETa"': metadata
            '"cAMs"': cameras
      - id: padding
        size: (4 - entry.length % 4) % 4
    instances:
      entry:
        value: _root.header.directory[number]
  weights:
    seq:
      - id: scales
        type: weight_scales
      - id: values
        size-eos: true
  planes:
    seq:
      - id: table
        type: plane_table
      - id: substreams
        type: padded(table.length[_index], _root.header.plane_lanes_log2)
        repeat: expr
        repeat-expr: 5
  index:
    params:
      - id: mode
        type: u1
    seq:
      - id: mask_model
        type: mask_model
      - id: position_model
        type: position_model
        if: mode == 1
      - id: chunks
        type: chunk_entry
        repeat: expr
        repeat-expr: _root.header.chunk_count
  data:
    seq:
      - id: chunks
        type: whole_chunk
        repeat: eos
  whole_chunk:
    seq:
      - id: head
        type: chunk
      - id: positions
        type: positions(head.position_length)
        if: head.position_form == 0
      - id: packed_positions
        type: padded(head.position_length, _root.header.mask_lanes_log2)
        if: head.position_form == 1
      - id: masks
        type: padded(head.mask_length, _root.header.mask_lanes_log2)
      - id: attributes
        type: padded(head.attribute_length, _root.header.attribute_lanes_log2)
  positions:
    params:
      - id: length
        type: u4
    seq:
      - id: coordinate
        type: u2
        repeat: expr
        repeat-expr: length / 2
      - id: padding
        size: (4 - length % 4) % 4
  padded:
    params:
      - id: length
        type: u4
      - id: lanes_log2
        type: u1
    seq:
      - id: substream
        size: length
        type: substream(lanes_log2)
      - id: padding
        size: (4 - length % 4) % 4
"""
# The items behind the structs with a count.
_ITEMS = {"Metadata": "Entry", "Cameras": "Camera"}


def made() -> Iterator[Made]:
    """Yields both descriptions."""
    yield Made.text(KAITAI, kaitai())
    yield Made.text(MAGIC, magic())


def kaitai() -> str:
    """Returns the description for Kaitai Struct."""
    meanings = specification.fields(specification.text())
    tables = "".join(_type(name, meanings) for name in SYNTAX)
    return _TOP.format(media_type=MEDIA_TYPE) + _ORDER + tables


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def _type(name: str, meanings: dict[str, tuple[str, str]]) -> str:
    lines = [f"  {_snake(name)}:"]
    if name == "Substream":
        lines += ["    params:", "      - id: lanes_log2", "        type: u1"]
    lines.append("    seq:")
    for field, kind in SYNTAX[name]:
        if (name, field) in _FURTHER:
            lines += ["      - id: further", f"        size: {_FURTHER[name, field]}"]
        lines += [f"      - id: {field}", *(f"        {line}" for line in _field(kind, field))]
        lines.append(f"        doc: {json.dumps(meanings[f'{name}.{field}'][1], ensure_ascii=False)}")
    if name == "Camera":
        # Behind its own field, and without the name.
        fixed = sum(_size(kind) for field, kind in SYNTAX[name] if field not in ("length", "name", "padding"))
        lines += ["      - id: further", f"        size: length - {fixed} - (name_length + 3) / 4 * 4"]
    if name in _ITEMS:
        item = _snake(_ITEMS[name])
        lines += ["      - id: items", f"        type: {item}", "        repeat: expr", "        repeat-expr: count"]
    return "\n".join(lines) + "\n"


def _field(kind: str, field: str) -> Iterator[str]:
    """Yields the lines of a field. kind: its type in a syntax table."""
    array = re.fullmatch(r"(\w+)\[(.+)\]", kind)
    if kind == "padding":
        yield f"size: {_PADDED}"
    elif kind.startswith("bytes to "):
        yield "size-eos: true"
    elif kind == "bytes[8]":
        yield f"contents: [{', '.join(f'0x{byte:02x}' for byte in SIGNATURE)}]"
    elif array and array[1] == "bytes":
        yield f"size: {array[2]}"
        # Letters are easier to compare than bytes.
        if field in ("type", "key", "value", "name"):
            yield "type: str"
            yield f"encoding: {'ASCII' if field in ('type', 'key') else 'UTF-8'}"
    elif array:
        yield f"type: {_SCALARS.get(array[1]) or _snake(array[1])}"
        yield "repeat: expr"
        yield f"repeat-expr: {'1 << lanes_log2' if array[2] == 'lanes' else _LENGTHS.get(array[2], array[2])}"
    else:
        yield f"type: {_SCALARS.get(kind) or _snake(kind)}"


def _size(kind: str) -> int:
    """Returns the bytes of a scalar, or of an array of them."""
    scalar, _, count = kind.rstrip("]").partition("[")
    return int(scalar[1:]) // 8 * int(count or 1)


def magic() -> str:
    """Returns the description for file(1): signature, version, profile, level and counts."""
    data = EXAMPLE.read_bytes()
    places = {e.path: e.start for e in parse_elements("Prologue", data)}
    places |= {e.path: e.start for e in parse_elements("Header", data, size_of("Prologue"))}
    signature = "".join(chr(byte) if 0x20 < byte < 0x7F else f"\\x{byte:02x}" for byte in SIGNATURE)
    lines = [
        "# Made by `python -m spec` from the syntax tables of SPEC.md. Use: file -m c3gs.magic FILE",
        f"0\tstring\t{signature}\tC3GS scene of 3D Gaussians",
        f"!:mime\t{MEDIA_TYPE}",
        "!:ext\tc3gs",
        f">{places['major']}\tuleshort\tx\t\\b, version %u",
        f">{places['minor']}\tuleshort\tx\t\\b.%u",
        *(f">{places['profile']}\tubyte\t{n}\t\\b, profile {p.name}" for n, p in sorted(PROFILES.items())),
        f">{places['level']}\tubyte\tx\tlevel %u",
        f">{places['anchor_count']}\tulelong\tx\t\\b, anchors: %u",
        f">{places['chunk_count']}\tulelong\tx\t\\b, chunks: %u",
    ]
    return "\n".join(lines) + "\n"
