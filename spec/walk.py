"""Explains the files of SPEC.md Annex D in Markdown: every byte of the first, and raw bits and coder steps of parts.

refcodec.inspect gives the elements of the file, and SPEC.md's syntax tables their meanings. The steps of the coder are
recorded while SPEC.md's blocks decode.
"""

from __future__ import annotations

import re
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from conformance import spec_decoder
from refcodec.bitstream import codec
from refcodec.bitstream.syntax import Element
from refcodec.inspect.anchor import anchor_rows
from refcodec.inspect.dump import value_text
from refcodec.inspect.elements import outline_of, rows
from refcodec.inspect.meaning import meaning
from refcodec.inspect.specification import fields

# The number of bytes that are shown of an element, at most.
SHOWN_BYTES = 8
# Of a longer struct, and of a network, the first bytes are shown.
STRUCT_BYTES, FIRST_BYTES = 96, 16
_NETWORK = re.compile(r"weights\.(?:hyper|sarm|carm\.\d+|opacity|covariance|colour)(?=\.)")


def _struct(path: str) -> str:
    """Returns the struct, substream or network that an element is in."""
    owner, _, rest = path.partition(",")
    network = _NETWORK.match(path)
    return network[0] if network else owner if rest else re.sub(r"\.\w+(?:\[\d+\])?$", "", path)


def _shortened(part: bytes, most: int) -> str:
    """Returns bytes in hexadecimal. 00*12 stands for 12 zero bytes, and +80 for 80 bytes that are left out."""
    shown = part if len(part) <= most else part[:FIRST_BYTES]
    text = re.sub(r"\b00(?: 00){4,}", lambda zeros: f"00*{len(zeros[0].split())}", shown.hex(" "))
    return text if shown == part else f"{text} +{len(part) - len(shown)}"


def struct_table(data: bytes) -> str:
    """Returns the table of the structs of a file: start, bytes, and the names of the struct and of its elements."""
    lines = ["| start | bytes | elements |", "|---|---|---|"]
    for name, group in groupby(rows(data), lambda row: _struct(row.path)):
        some = list(group)
        names = list(dict.fromkeys(re.sub(r"\[\d+\]$", "", row.path.removeprefix(name).lstrip(".")) for row in some))
        inner = [each.strip(", ") for each in names if each]
        words = f": {inner[0]}{f' to {inner[-1]}' if inner[1:] else ''}" if inner else ""
        start, end = some[0].start, some[-1].end
        shown = _shortened(data[start:end], FIRST_BYTES if _NETWORK.match(some[0].path) else STRUCT_BYTES)
        lines.append(f"| 0x{start:03x} | `{shown}` | {name}{words} |")
    return "\n".join(lines)


# --- elements ---------------------------------------------------------------------------------------------------------


def _contents(data: bytes, row: Element) -> str:
    part = data[row.start : row.end]
    return part.hex(" ") if len(part) <= SHOWN_BYTES else part[:SHOWN_BYTES].hex(" ") + " ..."


def element_table(data: bytes, spec: str) -> str:
    """Returns the table of all elements: start, length, contents, element, value and meaning. spec: SPEC.md."""
    known = fields(spec)
    lines = ["| start | length | contents | element | value | meaning |", "|---|---|---|---|---|---|"]
    array_before, model = "", outline_of(data).render_model
    for row in rows(data):
        value = value_text(row) if row.value is not None else ""
        cells = f"| 0x{row.start:03x} | {row.end - row.start} | `{_contents(data, row)}` | {row.path} | {value} |"
        # The items of an array have one meaning.
        array, item = row.path.rstrip("]").rsplit("[", 1) if row.path.endswith("]") else (row.path, "")
        repeated = item and array == array_before
        lines.append(f"{cells} {'the same' if repeated else meaning(row.path, model).text(known)} |")
        array_before = array
    return "\n".join(lines)


# --- the coder, recorded ----------------------------------------------------------------------------------------------


@dataclass
class Call:
    """A call of a function of the blocks. stream: the identity of its substream.

    arguments: those after the stream. word_at, raw_at: of the stream before the call. state: that of the lane before
    and after a symbol. inner: the calls of READ_BITS within this one.
    """

    stream: int
    arguments: tuple[Any, ...]
    result: Any
    word_at: int
    raw_at: int
    state: tuple[int, int]
    words: list[int]
    inner: list[Call]


class Recorder:
    """The calls of SPEC.md's blocks while they decode a file, by function. Raises SystemExit if they refuse it.

    streams: the identities of the substreams, in decoding order. space: the names of the blocks.
    """

    def __init__(self, data: bytes) -> None:
        self.space = spec_decoder.names()
        self.calls: dict[str, list[Call]] = defaultdict(list)
        opened: list[dict[str, Any]] = []
        for name in ("DECODE_SYMBOL", "READ_BITS", "DECODE_VALUES", "DECODE_CELLS"):
            self.space[name] = self._recorded(name, self.space[name])
        open_ = self.space["OPEN"]
        # References to the streams keep their identities unique.
        self.space["OPEN"] = lambda *given: opened.append(open_(*given)) or opened[-1]  # type: ignore[func-returns-value]
        _, error = spec_decoder.verdict(self.space, data)
        if error:
            raise SystemExit(f"SPEC.md's blocks refuse the worked example: {error}")
        self._opened, self.streams = opened, [id(stream) for stream in opened]

    def _recorded(self, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def recorded(stream: dict[str, Any], *given: Any) -> Any:
            lane = given[0] if name == "DECODE_SYMBOL" else 0
            word_at, raw_at, state, fields = (
                stream["word_at"], stream["raw_at"], stream["state"][lane], len(self.calls["READ_BITS"]),
            )  # fmt: skip
            result = original(stream, *given)
            taken = stream["words"][word_at : stream["word_at"]]
            inner, states = self.calls["READ_BITS"][fields:], (state, stream["state"][lane])
            self.calls[name].append(Call(id(stream), given, result, word_at, raw_at, states, taken, inner))
            return result

        return recorded

    def of(self, name: str, stream: int) -> list[Call]:
        """Returns the calls of a function for a substream."""
        return [call for call in self.calls[name] if call.stream == stream]

    def symbols(self, stream: int) -> Iterator[tuple[tuple[int, int], tuple[int, ...], Call, int]]:
        """Yields (mean, scale index), the result of SELECT, the step of the coder and the symbol, in coding order."""
        steps = iter(self.of("DECODE_SYMBOL", stream))
        for group in self.of("DECODE_VALUES", stream):
            for parameters, value in zip(group.arguments[1], group.result, strict=True):
                yield parameters, self.space["SELECT"](*parameters), next(steps), value


# The columns of a step of the coder, and their rule.
_STEP, _RULE = "state | slot | model index: slots | word | next state", "---|---|---|---|---"


def _step(symbol: Call, between: str = "") -> str:
    """Returns the cells of a step of the coder. between: a cell before the word."""
    frequencies = symbol.arguments[1]
    low, (before, after) = sum(frequencies[: symbol.result]), symbol.state
    slots = f"{symbol.result}: {low} to {low + frequencies[symbol.result] - 1}"
    word = f"0x{symbol.words[0]:04x}" if symbol.words else ""
    return f"0x{before:08x} | {before & 0x3FFF} | {slots} | {between}{word} | 0x{after:08x}"


def plane_steps(data: bytes, count: int) -> str:
    """Returns the table of the coder's steps for the first `count` symbols of sub-plane 0."""
    recorder, d = Recorder(data), codec.parse_container(data).dimensions
    groups = recorder.space["PLANE_GROUPS"](d.plane_channels, d.plane_size)
    points = [(t, point) for t, group in enumerate(groups) for point in group]
    lines = [
        "| t | channel, row, column | mean, scale index | model: row, column, centre, raw bits | state | slot "
        "| model index: slots | symbol | word | next state |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (t, point), ((m, s), model, symbol, value) in zip(
        points[:count], recorder.symbols(recorder.streams[0]), strict=False
    ):
        cells = f"{', '.join(map(str, model))} | {_step(symbol, f'{value} | ')}"
        lines.append(f"| {t} | {point} | {m}, {s} | {cells} |")
    return "\n".join(lines)


def cell_steps(data: bytes) -> str:
    """Returns the positions of the first chunk: bytes, models, and the table of the coder's steps, node by node."""
    recorder = Recorder(data)
    model = codec.parse(data).scene.position_model
    assert model is not None
    symbols = iter(recorder.of("DECODE_SYMBOL", recorder.calls["DECODE_CELLS"][0].stream))
    lines = [f"| level | node | model | {_STEP} | children |", f"|---|---|---|{_RULE}|---|"]
    nodes, used = [(0, 0, 0)], set()
    for level in range(15, -1, -1):
        halves: list[list[int]] = [[], []]
        for half in range(2):
            for n, node in enumerate(nodes):
                number = 6 * min(level, 2) + (1 + halves[0][n].bit_count() if half else 0)
                symbol = next(symbols)
                halves[half].append(symbol.result)
                used.add(number)
                children = ", ".join(str(4 * half + i) for i in range(4) if symbol.result >> i & 1)
                lines.append(f"| {level} | {node} | {number} | {_step(symbol)} | {children} |")
        nodes = [
            (2 * x + (k & 1), 2 * y + (k >> 1 & 1), 2 * z + (k >> 2))
            for (x, y, z), low, high in zip(nodes, *halves, strict=True)
            for k in range(8)
            if (low | high << 4) >> k & 1
        ]
    within = [row for row in rows(data) if row.path.startswith("positions[chunk 0].")]
    models = [f"| {n} | {', '.join(map(str, model.frequency[n].tolist()))} |" for n in sorted(used)]
    content = data[within[0].start : within[-1].end].hex(" ")
    head = ["```text", content, "```", "", "| model | frequencies |", "|---|---|", *models, ""]
    cells = textwrap.fill(f"The cells are {', '.join(map(str, nodes))}.", 120)
    return "\n".join([*head, *lines, "", cells])


def layer_steps(data: bytes) -> str:
    """Returns the substream of the weights: bytes, and the table of the coder's steps for its only packed layer."""
    recorder, scene = Recorder(data), codec.parse(data).scene
    assert scene.weight_forms is not None
    names = [(name, layer) for name, layers in scene.networks.items() for layer in range(len(layers))]
    (packed,) = scene.weight_forms.nonzero()[0].tolist()
    network, layer = names[packed]
    weight, bias = scene.networks[network][layer]
    count, inputs = weight.shape
    words = [f"{what} of row {r}" for what in ("difference", "bias") for r in range(count)]
    words += [f"weight {i} of row {r}" for r in range(count) for i in range(inputs)]
    lines = [
        f"| what | mean, scale index | model: row, column, centre, raw bits | lane | {_STEP} | symbol |",
        f"|---|---|---|---|{_RULE}|---|",
    ]
    for what, ((m, s), model, symbol, value) in zip(words, recorder.symbols(recorder.streams[0]), strict=True):
        chosen = ", ".join(map(str, model))
        lines.append(f"| {what} | {m}, {s} | {chosen} | {symbol.arguments[0]} | {_step(symbol)} | {value} |")
    starts = {row.path: row.start for row in rows(data)}
    at, form = starts["weights.symbol_crc"], starts[f"weights.{network}.{layer}.form"]
    end = next(start for path, start in starts.items() if start > at and not path.startswith("weights."))
    model_bytes, stream_bytes = data[form : form + 8].hex(" "), data[at:end].hex(" ")
    head = ["```text", f"LayerModel  {model_bytes}", f"substream   {stream_bytes}", "```", ""]
    shown = [f"| {r} | {', '.join(map(str, weight[r].tolist()))} | {bias[r]} |" for r in range(count)]
    return "\n".join([*head, *lines, "", "| row | weights | bias |", "|---|---|---|", *shown])


def first_anchor(data: bytes) -> str:
    """Returns the table of what clauses 7.4 to 7.10 compute for the first anchor."""
    made = [f"| {what} | {clause} | {values} |" for what, clause, values in anchor_rows(codec.parse(data).scene, 0)]
    return "\n".join(["| what | clause | value |", "|---|---|---|", *made])


def raw_fields(data: bytes) -> str:
    """Returns the table of all raw bits of the last attribute substream: start, length, contents and meaning.

    A start is a byte and a bit. Contents have the last bit first. Raises SystemExit if bits are missing.
    """
    recorder = Recorder(data)
    raw = next(r for r in reversed(list(rows(data))) if r.path.endswith(".raw"))
    lines = ["| start | length | contents | meaning |", "|---|---|---|---|"]
    end = 0
    for start, bits, value, words in _fields(recorder):
        if start != end:
            raise SystemExit(f"raw bits {end} to {start} are missing")
        end = start + bits
        lines.append(f"| 0x{raw.start + start // 8:03x}+{start % 8} | {bits} | `{value:0{bits}b}` | {words} |")
    padding = 8 * (raw.end - raw.start) - end
    if padding:
        lines.append(f"| 0x{raw.start + end // 8:03x}+{end % 8} | {padding} | `{0:0{padding}b}` | padding (8.8) |")
    return "\n".join(lines)


def _fields(recorder: Recorder) -> Iterator[tuple[int, int, int, str]]:
    """Yields (bit, length, value, meaning) of each raw field of the last substream, except empty fields."""
    for number, group in enumerate(recorder.of("DECODE_VALUES", recorder.streams[-1])):
        low, rest = group.inner[: len(group.result)], group.inner[len(group.result) :]
        for n, (field, value) in enumerate(zip(low, group.result, strict=True)):
            if k := field.arguments[0]:
                words = f"low {k} bits of symbol {n} of group {number}, which is {value}"
                yield field.raw_at, k, field.result, words
        while rest:
            sign, *rest = rest
            zeros = next(n for n, field in enumerate(rest) if field.result)
            first, size, rest = rest[0].raw_at, rest[zeros + 1], rest[zeros + 2 :]
            yield sign.raw_at, 1, sign.result, f"an escape of group {number}: sign"
            yield first, zeros + 1, 1 << zeros, f"its prefix: z = {zeros}"
            if zeros:
                yield size.raw_at, zeros, size.result, f"n - 2^z, so n = {(1 << zeros) + size.result}"
