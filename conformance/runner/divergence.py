"""The first difference between a decoder's output or trace and the right one, which refcodec computes."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from refcodec.bitstream import codec, syntax
from refcodec.bitstream.attributes import SCALINGS
from refcodec.bitstream.entropy import TraceRow
from refcodec.bitstream.planes import PLANE_NAMES
from refcodec.bitstream.reconstruction import canonical_head, canonical_parts, digested, part_names
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.splat import HARMONICS
from refcodec.files.text import printable
from refcodec.inspect import dump

from . import probes
from .traces import has_any, lines_of

# The clauses that define the values of a part, and the symbols of a trace with their models.
PART_CLAUSES = {
    "positions": "9.1, 5.14, 7.12",
    "masks": "7.6",
    "planes": "7.3",
    "features": "9.2, 7.8",
    "scalings": "9.2, 7.8",
    "offsets": "9.2, 7.8",
    "weights": "5.8, 7.13",
    "splat": "9.4",
}
SYMBOL_CLAUSES = {
    "weights": "7.13",
    "planes": "7.3, 7.2",
    "positions": "7.12",
    "masks": "7.6",
    "attributes": "7.5, 7.2, 7.7, 7.10",
}
# The number of lines of annotated bytes: a head, the element at the offset, six before it and six after it.
_HEX_LINES = 14
# The longest line of a trace in a message, in characters.
_SHOWN = 80


@dataclass(frozen=True)
class Divergence:
    """The first difference.

    part: of the canonical reconstruction, or "trace". element: in words. expected, found: its values. offset: in the
    output, or for a trace that of the substream in the file. differing: the number of values that differ, in words.
    clauses: of SPEC.md, which define the element.
    """

    part: str
    element: str
    expected: str
    found: str
    offset: int
    differing: str
    clauses: str = "9.3"

    def text(self) -> str:
        """Returns the difference as one line."""
        values = f"{self.found}, {self.expected} expected ({self.differing})"
        return f"{self.part}: {self.element} is {values}; read {self.clauses}"


def _types(scene: Scene) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Returns the type and the shape of each part (SPEC 9.3)."""
    d, n = scene.dimensions, scene.anchor_count
    return {
        "positions": ("<f4", (n, 3)),
        "masks": ("u1", (n, d.offset_count)),
        "planes": ("<i2", (5, d.plane_channels, d.plane_size, d.plane_size)),
        "features": ("<f4", (n, d.features)),
        "scalings": ("<f4", (n, SCALINGS)),
        "offsets": ("<f4", (n, d.offset_count, 3)),
        "weights": ("<f4", (-1,)),
        "splat": ("<f4", (int(scene.masks.sum()), HARMONICS.start + d.colour_outputs)),
    }


def _element(scene: Scene, part: str, at: tuple[int, ...]) -> str:
    """Names the value at an index of a part in the terms of SPEC.md."""
    if part == "planes":
        return f"sub-plane {at[0]} ({PLANE_NAMES[at[0]]}), channel {at[1]}, row {at[2]}, column {at[3]}"
    if part == "weights":
        left = at[0]
        for name, shapes in scene.dimensions.network_shapes().items():
            for layer, (out, fan_in) in enumerate(shapes):
                if left < out * fan_in:
                    return f"{name}, layer {layer}, weight {left % fan_in} of row {left // fan_in}"
                left -= out * fan_in
                if left < out:
                    return f"{name}, layer {layer}, bias {left}"
                left -= out
    if part == "splat":
        anchor, offset = (int(place[at[0]]) for place in np.nonzero(scene.masks))
        return f"anchor {anchor}, offset {offset}, number {at[1]}"
    chunk = f"anchor {at[0]} (chunk {next(i for i, c in enumerate(scene.chunks) if at[0] in c)})"
    if part == "positions":
        return f"{chunk}, {'xyz'[at[1]]}"
    if part == "offsets":
        return f"{chunk}, offset {at[1]}, {'xyz'[at[2]]}"
    return f"{chunk}, {'offset' if part == 'masks' else 'channel'} {at[1]}"


def _shown(value: NDArray) -> str:
    if value.dtype.kind == "f":
        return f"{value[()]!s} ({int(value.view('<u4')[()]):08x})"
    return str(value[()])


def _compare_part(scene: Scene, part: str, right: bytes, output: bytes, start: int) -> Divergence:
    """Returns the first difference of two unequal parts of the same length."""
    if part == "head":
        at = next(i for i, (a, b) in enumerate(zip(right, output, strict=True)) if a != b)
        if at < 8:
            return Divergence(part, "the eight bytes", right[:8].hex(" "), output[:8].hex(" "), start, "the head")
        fields = [("N", 8, 12)]
        for table, name in (("RenderInfo", "render_info"), ("Dimensions", "dimensions")):
            elements = syntax.parse_elements(table, right, fields[-1][2], name)
            fields += [(element.path, element.start, element.end) for element in elements]
        name, first, end = next(field for field in fields if at < field[2])
        values = [data[first:end].hex(" ") for data in (right, output)]
        return Divergence(part, name, values[0], values[1], start + first, "the head")
    if part == "digests":
        number = next(i for i, (a, b) in enumerate(zip(right, output, strict=True)) if a != b) // 32
        values = [data[32 * number : 32 * number + 32].hex() for data in (right, output)]
        element, place = f"that of the {part_names(scene.render.render_model)[number]}", start + 32 * number
        return Divergence(part, element, values[0], values[1], place, "the parts are right")
    kind, shape = _types(scene)[part]
    a, b = (np.frombuffer(data, kind).reshape(shape) for data in (right, output))
    # Bits are compared: -0 differs from +0, and NaNs may be equal.
    differ = a.view(f"<u{a.itemsize}") != b.view(f"<u{b.itemsize}")
    flat = int(np.argmax(differ))
    at_index = tuple(int(i) for i in np.unravel_index(flat, a.shape))
    count = f"{int(differ.sum())} of {differ.size} values of the part differ"
    place, expected, found = start + flat * a.itemsize, _shown(a[at_index]), _shown(b[at_index])
    return Divergence(part, _element(scene, part, at_index), expected, found, place, count, PART_CLAUSES[part])


def _parts(scene: Scene) -> Iterator[tuple[str, int, bytes]]:
    """Yields the parts of the right output with their offsets (SPEC 9.3). The dependent digests are last."""
    head, listed = canonical_head(scene), digested(scene)
    yield "head", 0, head
    at = len(listed)
    for name, content in canonical_parts(scene):
        yield name, at, content
        at += len(content)
    yield "digests", len(head), listed[len(head) :]


def of_output(data: bytes, output: bytes) -> Divergence | None:
    """Returns the first difference of a decoder's `output` for a valid file; None if the output is right."""
    scene = codec.parse(data).scene
    end = 0
    for part, at, right in _parts(scene):
        got = output[at : at + len(right)]
        common = right[: len(got)]
        if got != common:
            # Right bytes replace missing ones, so that only present values are compared.
            return _compare_part(scene, part, right, got + right[len(got) :], at)
        if len(got) < len(right):
            expected, found = (f"{len(each)} bytes" for each in (right, got))
            return Divergence(part, "the part", expected, found, at, f"the output has {len(output)} bytes")
        end = max(end, at + len(right))
    if len(output) > end:
        return Divergence("end", "the output", f"{end} bytes", f"{len(output)} bytes", end, "what is there is right")
    return None


def of_trace(data: bytes, trace: bytes) -> tuple[Divergence | None, probes.Compared]:
    """Returns the first wrong symbol of a decoder's trace of a valid file, and the comparison of its probes.

    A trace that has only probes has no wrong symbol.
    """
    rows, scene = _symbols(data)
    wrong, symbol = None, None
    # One line more than there are symbols is enough.
    lines = itertools.islice((line for probe, line, _ in lines_of(trace) if not probe), len(rows) + 1)
    for number, (row, line) in enumerate(itertools.zip_longest(rows, lines)):
        if number == 0 and line is None and has_any(trace):
            break
        text = None if line is None else line.decode("utf-8", "replace")
        if row is None or text != f"{row.path} {row.value}":
            wrong, symbol = number, _wrong_symbol(rows, number, text, len(data))
            break
    return symbol, probes.compare(probes.OfScene(scene), trace, wrong)


def _wrong_symbol(rows: list[TraceRow], number: int, line: str | None, end: int) -> Divergence:
    """Returns the difference of a wrong line. number: of the symbol. line: None if missing. end: size of the file."""
    count = f"symbol {number} of {len(rows)}"
    if number == len(rows):
        after = "the line after the last symbol"
        return Divergence("trace", after, "nothing", printable(str(line), _SHOWN), end, count)
    row = rows[number]
    # For the same symbol, the values suffice.
    same, value = line is not None and line.startswith(f"{row.path} "), str(row.value)
    symbol = "nothing" if line is None else printable(line.removeprefix(f"{row.path} "), _SHOWN)
    count += f"; the right model is {row.family}, mean {row.mean}, scale {row.scale}"
    clauses = SYMBOL_CLAUSES[row.path.partition("[")[0].split(".")[0]]
    if row.path.startswith("attributes.features"):
        clauses += ", and for slices behind the first 7.9"
    expected = value if same else f"{row.path} {value}"
    return Divergence("trace", row.path, expected, symbol, row.substream, count, clauses)


def annotated(data: bytes, offset: int) -> list[str]:
    """Returns the bytes around an offset, a line for each syntax element, and marks the line of the offset."""
    head, *lines = list(dump.hex_lines(data, near=offset))[:_HEX_LINES]
    spot = max((i for i, line in enumerate(lines) if int(line[:8], 16) <= offset), default=-1)
    return [f"  {head}", *(f"{'> ' if i == spot else '  '}{line}" for i, line in enumerate(lines))]


def _symbols(data: bytes) -> tuple[list[TraceRow], Scene]:
    """Returns the symbols in the order of the trace (vectors/README.md), and the scene."""
    rows: list[TraceRow] = []
    scene = codec.parse(data, trace=rows.append).scene
    return sorted(rows, key=lambda row: row.substream), scene
