"""Explains the files of SPEC.md Annex D in Markdown: every byte of the first, and raw bits and coder steps of parts.

refcodec.inspect gives the elements of the file, and SPEC.md's syntax tables their meanings. The steps of the coder are
recorded while SPEC.md's blocks decode.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

from conformance import spec_decoder
from refcodec.bitstream import codec
from refcodec.inspect.dump import value_text
from refcodec.inspect.elements import Row, rows
from refcodec.inspect.meaning import meaning
from refcodec.inspect.specification import fields

# The number of bytes that are shown of an element, at most.
SHOWN_BYTES = 8


def hex_dump(data: bytes) -> str:
    """Returns the bytes of the file, 16 on a line."""
    lines = [f"{at:08x}  {data[at : at + 16].hex(' ')}" for at in range(0, len(data), 16)]
    return "\n".join(["```text", *lines, "```"])


# --- elements ---------------------------------------------------------------------------------------------------------


def meaning_of(path: str, known: dict[str, tuple[str, str]]) -> str:
    """Returns the meaning of the element at a path. known: type and meaning of the fields of syntax tables."""
    found = meaning(path)
    return known[f"{found.table}.{found.field}"][1] if found.table else found.words


def _contents(data: bytes, row: Row) -> str:
    part = data[row.start : row.end]
    return part.hex(" ") if len(part) <= SHOWN_BYTES else part[:SHOWN_BYTES].hex(" ") + " ..."


def element_table(data: bytes, spec: str) -> str:
    """Returns the table of all elements: start, length, contents, element, value and meaning. spec: SPEC.md."""
    known = fields(spec)
    lines = ["| start | length | contents | element | value | meaning |", "|---|---|---|---|---|---|"]
    told = ""
    for row in rows(data):
        value = value_text(row) if row.value is not None else ""
        cells = f"| 0x{row.start:03x} | {row.end - row.start} | `{_contents(data, row)}` | {row.path} | {value} |"
        # The items of an array have one meaning.
        array, item = row.path.rstrip("]").rsplit("[", 1) if row.path.endswith("]") else (row.path, "")
        lines.append(f"{cells} {'the same' if item and array == told else meaning_of(row.path, known)} |")
        told = array
    return "\n".join(lines)


# --- the coder, watched -----------------------------------------------------------------------------------------------


class Watch:
    """SPEC.md's decoder, which records symbols, raw fields, values and network outputs, by the identity of streams.

    space: the names of SPEC.md's blocks, some of which are replaced.
    """

    def __init__(self) -> None:
        self.space = spec_decoder.names()
        self.opened: list[dict[str, Any]] = []
        self.networks: list[tuple[list[int], list[int]]] = []
        self.symbols: list[dict[str, Any]] = []
        self.fields: list[dict[str, Any]] = []
        self.values: list[dict[str, Any]] = []
        self.trees: list[int] = []
        for name in ("NETWORK", "DECODE_SYMBOL", "READ_BITS", "DECODE_VALUES", "DECODE_CELLS"):
            original = self.space[name]
            self.space[name] = getattr(self, f"_{name.lower()}")(original)

    def hyper(self, context: list[int]) -> list[int]:
        """Returns the outputs of F_h for one of its inputs."""
        return next(out for inputs, out in self.networks if inputs == context)

    def _network(self, original: Any) -> Any:
        def watched(layers: Any, inputs: list[int]) -> list[int]:
            out: list[int] = original(layers, inputs)
            self.networks.append((inputs, out))
            return out

        return watched

    def _decode_symbol(self, original: Any) -> Any:
        def watched(stream: dict, lane: int, frequencies: list[int]) -> int:
            before, word_at = stream["state"][lane], stream["word_at"]
            symbol: int = original(stream, lane, frequencies)
            took = stream["words"][word_at] if stream["word_at"] > word_at else None
            self.symbols.append({
                "stream": id(stream), "lane": lane, "before": before, "slot": before & 0x3FFF,
                "low": sum(frequencies[:symbol]), "frequency": frequencies[symbol], "symbol": symbol, "word": took,
                "after": stream["state"][lane],
            })  # fmt: skip
            return symbol

        return watched

    def _read_bits(self, original: Any) -> Any:
        def watched(stream: dict, k: int) -> int:
            at = stream["raw_at"]
            value: int = original(stream, k)
            self.fields.append({"stream": id(stream), "at": at, "bits": k, "value": value})
            return value

        return watched

    def _decode_values(self, original: Any) -> Any:
        def watched(stream: dict, family: Any, parameters: list, limit: int) -> list[int]:
            fields = len(self.fields)
            values: list[int] = original(stream, family, parameters, limit)
            chosen = [self.space["SELECT"](m, s) for m, s in parameters]
            self.values.append({
                "stream": id(stream), "parameters": parameters, "chosen": chosen, "values": values,
                "fields": self.fields[fields:], "planes": family is self.space["LAPLACE"],
            })  # fmt: skip
            return values

        return watched

    def _decode_cells(self, original: Any) -> Any:
        def watched(stream: dict, models: list, anchors: int) -> Any:
            self.trees.append(id(stream))
            return original(stream, models, anchors)

        return watched


# The columns of a step of the coder, and their rule.
_STEP, _RULE = "state | slot | model index: slots | word | next state", "---|---|---|---|---"


def _step(symbol: dict[str, Any]) -> str:
    """Returns the cells of a step of the coder."""
    word = "" if symbol["word"] is None else f"0x{symbol['word']:04x}"
    slots = f"{symbol['symbol']}: {symbol['low']} to {symbol['low'] + symbol['frequency'] - 1}"
    return f"0x{symbol['before']:08x} | {symbol['slot']} | {slots} | {word} | 0x{symbol['after']:08x}"


def _watched(data: bytes) -> tuple[Watch, list[int]]:
    """Returns the decoder after it decoded a file, and the identities of the substreams in decoding order."""
    watch = Watch()
    opened = []
    original = watch.space["OPEN"]

    def noted(part: bytes, lanes: int) -> dict:
        # References to the streams keep their identities unique.
        opened.append(original(part, lanes))
        return opened[-1]

    watch.space["OPEN"] = noted
    _decode(watch, data)
    watch.opened = opened
    return watch, [id(stream) for stream in opened]


def _decode(watch: Watch, data: bytes) -> None:
    """Decodes a file. Raises SystemExit if the blocks refuse it."""
    _, error = spec_decoder.verdict(watch.space, data)
    if error:
        raise SystemExit(f"SPEC.md's blocks refuse the worked example: {error}")


def plane_steps(data: bytes, count: int) -> str:
    """Returns the table of the coder's steps for the first `count` symbols of sub-plane 0."""
    watch, streams = _watched(data)
    d = codec.parse_container(data).dimensions
    points = [
        (t, p) for t, group in enumerate(watch.space["PLANE_GROUPS"](d.plane_channels, d.plane_size)) for p in group
    ]
    groups = [g for g in watch.values if g["stream"] == streams[0]]
    parameters, chosen, values = ([x for g in groups for x in g[name]] for name in ("parameters", "chosen", "values"))
    symbols = [s for s in watch.symbols if s["stream"] == streams[0]]
    lines = [
        "| t | channel, row, column | mean, scale index | model: row, column, centre, raw bits | state | slot "
        "| model index: slots | symbol | word | next state |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (t, point), mean_scale, pick, symbol, value in list(
        zip(points, parameters, chosen, symbols, values, strict=True)
    )[:count]:
        m, s = mean_scale
        before, slot, index, word, after = _step(symbol).split(" | ")
        cells = f"{before} | {slot} | {index} | {value} | {word} | {after}"
        lines.append(f"| {t} | {point} | {m}, {s} | {', '.join(map(str, pick))} | {cells} |")
    return "\n".join(lines)


def _content(data: bytes, start: str) -> str:
    """Returns the bytes of a substream, in hexadecimal. start: what the paths of its elements begin with."""
    within = [row for row in rows(data) if row.path.startswith(start)]
    return data[within[0].start : within[-1].end].hex(" ")


def cell_steps(data: bytes) -> str:
    """Returns the positions of the first chunk: bytes, models, and the table of the coder's steps, node by node."""
    watch, _ = _watched(data)
    model = codec.parse(data).scene.position_model
    assert model is not None
    symbols = iter([s for s in watch.symbols if s["stream"] == watch.trees[0]])
    lines = [f"| level | node | model | {_STEP} | children |", f"|---|---|---|{_RULE}|---|"]
    nodes, used = [(0, 0, 0)], set()
    for level in range(15, -1, -1):
        halves: list[list[int]] = [[], []]
        for half in range(2):
            for n, node in enumerate(nodes):
                number = 6 * min(level, 2) + (1 + halves[0][n].bit_count() if half else 0)
                symbol = next(symbols)
                halves[half].append(symbol["symbol"])
                used.add(number)
                children = ", ".join(str(4 * half + i) for i in range(4) if symbol["symbol"] >> i & 1)
                lines.append(f"| {level} | {node} | {number} | {_step(symbol)} | {children} |")
        nodes = [
            (2 * x + (k & 1), 2 * y + (k >> 1 & 1), 2 * z + (k >> 2))
            for (x, y, z), low, high in zip(nodes, *halves, strict=True)
            for k in range(8)
            if (low | high << 4) >> k & 1
        ]
    content = _content(data, "positions[chunk 0].")
    models = [f"| {n} | {', '.join(map(str, model.frequency[n].tolist()))} |" for n in sorted(used)]
    head = ["```text", content, "```", "", "| model | frequencies |", "|---|---|", *models, ""]
    cells = textwrap.fill(f"The cells are {', '.join(map(str, nodes))}.", 120)
    return "\n".join([*head, *lines, "", cells])


def layer_steps(data: bytes) -> str:
    """Returns the substream of the weights: bytes, and the table of the coder's steps for its only packed layer."""
    watch, streams = _watched(data)
    scene = codec.parse(data).scene
    names = [(name, layer) for name, layers in scene.networks.items() for layer in range(len(layers))]
    assert scene.weight_forms is not None
    assert scene.weight_scales is not None
    (packed,) = scene.weight_forms.nonzero()[0].tolist()
    network, layer = names[packed]
    count, inputs = scene.networks[network][layer][0].shape
    words = [f"{what} of row {r}" for what in ("difference", "bias") for r in range(count)]
    words += [f"weight {i} of row {r}" for r in range(count) for i in range(inputs)]
    groups = [g for g in watch.values if g["stream"] == streams[0]]
    symbols = [s for s in watch.symbols if s["stream"] == streams[0]]
    lines = [
        f"| what | mean, scale index | model: row, column, centre, raw bits | lane | {_STEP} | symbol |",
        f"|---|---|---|---|{_RULE}|---|",
    ]
    parameters, chosen, values = ([x for g in groups for x in g[name]] for name in ("parameters", "chosen", "values"))
    for what, (m, s), pick, symbol, value in zip(words, parameters, chosen, symbols, values, strict=True):
        model = ", ".join(map(str, pick))
        lines.append(f"| {what} | {m}, {s} | {model} | {symbol['lane']} | {_step(symbol)} | {value} |")
    at = next(row.start for row in rows(data) if row.path == "weights.symbol_crc")
    end = next(row.start for row in rows(data) if row.start > at and not row.path.startswith("weights."))
    form = next(row.start for row in rows(data) if row.path == f"weights.{network}.{layer}.form")
    head = [
        "```text",
        f"LayerModel  {data[form : form + 8].hex(' ')}",
        f"substream   {data[at:end].hex(' ')}",
        "```",
        "",
    ]
    weight, bias = scene.networks[network][layer]
    shown = [f"| {r} | {', '.join(map(str, weight[r].tolist()))} | {bias[r]} |" for r in range(count)]
    return "\n".join([*head, *lines, "", "| row | weights | bias |", "|---|---|---|", *shown])


def first_anchor(data: bytes) -> str:
    """Returns the table of what clauses 7.4 to 7.10 compute for the first anchor."""
    watch = Watch()
    space = watch.space
    seen: dict[str, list[Any]] = {}
    names = ("POSITION_INTEGER", "FRAME_COORDINATES", "CONTRACT", "RESCALE", "QUERY", "GAMMA", "CONTEXT")
    for name in names:
        original = space[name]

        def noted(*arguments: Any, name: str = name, original: Any = original) -> Any:
            value = original(*arguments)
            seen.setdefault(name, []).append(value)
            return value

        space[name] = noted
    _decode(watch, data)
    scene = codec.parse(data).scene
    header = codec.parse_container(data)
    width = header.dimensions.attribute_width
    # The groups of attributes come after those of the planes.
    groups = watch.values[sum(1 for g in watch.values if g["planes"]) :]
    chunk, slices, kept = len(scene.chunks[0]), header.dimensions.slices, scene.masks[0]
    lines = ["| what | clause | value |", "|---|---|---|"]

    def row(what: str, clause: str, value: Any) -> None:
        lines.append(f"| {what} | {clause} | {', '.join(map(str, value))} |")

    row("P of x, y, z", "7.4", seen["POSITION_INTEGER"][:3])
    row("v", "7.5.1", seen["FRAME_COORDINATES"][0])
    row("w", "7.5.2", seen["CONTRACT"][0])
    row("u", "7.5.3", seen["RESCALE"][0])
    row("samples of the plane of r = 1", "7.5.4", seen["QUERY"][0])
    row("samples of the plane of r = 2", "7.5.4", seen["QUERY"][1])
    row("positional encoding", "7.5.5", seen["GAMMA"][0])
    hyper = watch.hyper(seen["CONTEXT"][0])
    row("means that F_h gives", "7.7", hyper[:width])
    row("scale indices that F_h gives", "7.7", hyper[width : 2 * width])
    row("outputs for the step indices", "7.8", hyper[2 * width :])
    row("scalings: symbols", "7.10", groups[0]["values"][:6])
    values = iter(groups[1]["values"])
    row("offsets: symbols", "7.10", [tuple(next(values) for _ in range(3)) if mask else "masked" for mask in kept])
    for i, columns in enumerate(slices):
        group = groups[2 + i]
        assert len(group["values"]) == chunk * columns
        row(f"slice {i}: mean and scale index of each channel", "7.9", group["parameters"][:columns])
        row(f"slice {i}: symbols", "7.10", group["values"][:columns])
    steps = [max(0, min(x, 63)) for x in hyper[2 * width :]]
    row("step indices of features, scalings, offsets", "7.8", steps)
    return "\n".join(lines)


def raw_fields(data: bytes) -> str:
    """Returns the table of all raw bits of the last attribute substream: start, length, contents and meaning.

    A start is a byte and a bit. Contents have the last bit first. Raises SystemExit if bits are missing.
    """
    watch, streams = _watched(data)
    groups = [g for g in watch.values if g["stream"] == streams[-1]]
    raw = next(r for r in reversed(list(rows(data))) if r.path.endswith(".raw"))
    lines = ["| start | length | contents | meaning |", "|---|---|---|---|"]
    end = 0
    for start, bits, value, words in _fields(groups):
        if start != end:
            raise SystemExit(f"raw bits {end} to {start} are missing")
        end = start + bits
        lines.append(f"| 0x{raw.start + start // 8:03x}+{start % 8} | {bits} | `{value:0{bits}b}` | {words} |")
    padding = 8 * (raw.end - raw.start) - end
    if padding:
        lines.append(f"| 0x{raw.start + end // 8:03x}+{end % 8} | {padding} | `{0:0{padding}b}` | padding (8.8) |")
    return "\n".join(lines)


def _fields(groups: list[dict[str, Any]]) -> Iterator[tuple[int, int, int, str]]:
    """Yields (bit, length, value, meaning) of each raw field of groups of values, except empty fields."""
    for number, group in enumerate(groups):
        fields = iter(group["fields"])
        for n, ((_, _, _, k), value) in enumerate(zip(group["chosen"], group["values"], strict=True)):
            field = next(fields)
            if k:
                yield field["at"], k, field["value"], f"low {k} bits of symbol {n} of group {number}, which is {value}"
        name = f"of group {number}"
        rest = list(fields)
        while rest:
            sign = rest.pop(0)
            zeros = 0
            while rest[zeros]["value"] == 0 and rest[zeros]["bits"] == 1:
                zeros += 1
            first = rest[0]["at"]
            size = rest[zeros + 1]
            rest = rest[zeros + 2 :]
            yield sign["at"], 1, sign["value"], f"an escape {name}: sign"
            yield first, zeros + 1, 1 << zeros, f"its prefix: z = {zeros}"
            if zeros:
                yield size["at"], zeros, size["value"], f"n - 2^z, so n = {(1 << zeros) + size['value']}"
