"""The trace and the probes of a file: what the blocks compute, written while they decode.

A trace has a line `PATH VALUE` for each symbol. The symbols of a substream are in the order of its CRC-32 (8.8). A
probe has the values of one step of the decoding process for one anchor.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any, TextIO

from .program import blocks

# SPEC 7.3: sub-planes 0 to 4
SUB_PLANES = ("r1", "r2.top_left", "r2.top_right", "r2.bottom_left", "r2.bottom_right")
# Only the first probes of a file matter. No more characters than this are written.
CHARACTERS_MAX = 16 << 20


class Watch:
    """Watches the functions of the blocks. Methods have the names of the functions in small letters.

    file: gets the lines. probed: whether probes are written, too.
    """

    def __init__(self, file: TextIO, probed: bool) -> None:
        self._file, self._probed, self._left = file, probed, CHARACTERS_MAX
        # The names of the symbols of the groups to come.
        self._groups: Iterator[Iterable[str]] = iter(())
        self._v: dict[str, Any] = {}
        self._sub_plane = self._chunk = -1
        # The number of the first anchor of a chunk, and of the anchors before the context that is computed.
        self._first = self._anchor = 0
        self._samples = 0
        # Of the chunk whose attributes are decoded: the outputs of F_h, the number of the group, and the numbers of the
        # channels, of the anchors and of each slice's channels.
        self._hyper: list[list[int]] | None = None
        self._group = self._total = self._count = 0
        self._slices: list[int] = []

    def _probe(self, name: str, anchor: int, values: Iterable[int]) -> None:
        line = f"probe {name}[{anchor}]{''.join(f' {value}' for value in values)}\n"
        self._left -= len(line)
        if self._probed and self._left >= 0:
            self._file.write(line)

    # SPEC 8.8
    def note_symbols(self, call: Callable[..., None], stream: Any, values: list[int]) -> None:
        """Writes a group of symbols."""
        call(stream, values)
        self._file.writelines(f"{name} {value}\n" for name, value in zip(next(self._groups), values, strict=False))

    # SPEC Annex H
    def check_header(self, call: Callable[..., None], h: Any) -> None:
        """Keeps the fields of the header."""
        self._v = h["value"]
        call(h)

    # SPEC 5.8, 7.13
    def decode_weights(self, call: Callable[..., Any], stream: Any, shapes: Any, layers: Any, raw: Any) -> Any:
        """Names the symbols of the weights."""
        names = [
            f"{f'carm.{network}' if isinstance(network, int) else network}.{n}"
            for network, own in blocks.SHAPES(self._v)
            for n in range(len(own))
        ]
        few, many = [], []
        for name, (rows, inputs), layer in zip(names, shapes, layers, strict=True):
            if layer["form"]:
                few += [f"weights.{name}.{part}[{n}]" for part in ("exponent", "bias") for n in range(rows)]
                many += [f"weights.{name}.weight[{n}]" for n in range(rows * inputs)]
        self._groups = iter((few, many))
        return call(stream, shapes, layers, raw)

    # SPEC 7.3
    def decode_plane(self, call: Callable[..., Any], stream: Any, sarm: Any, channels: int, size: int) -> Any:
        """Names the symbols of a sub-plane."""
        self._sub_plane += 1
        name = SUB_PLANES[self._sub_plane]
        groups = blocks.PLANE_GROUPS(channels, size)
        self._groups = ([f"planes.{name}[{k},{i},{j}]" for k, i, j in group] for group in groups)
        return call(stream, sarm, channels, size)

    # SPEC 7.12
    def decode_positions(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Names the symbols of a chunk's tree, whose levels are those of any substream of positions."""
        self._chunk += 1
        name = f"positions[chunk {self._chunk}]"
        levels = range(blocks.CELL_LEVELS - 1, -1, -1)
        self._groups = (_numbered(f"{name}.level[{level}].{half}") for level in levels for half in ("low", "high"))
        return call(*arguments)

    # SPEC 7.6
    def decode_masks(self, call: Callable[..., Any], stream: Any, model: Any, offsets: int, anchors: int) -> Any:
        """Names the symbols of the masks."""
        self._groups = ([f"masks[{self._first + n},{k}]" for n in range(anchors)] for k in range(offsets))
        return call(stream, model, offsets, anchors)

    # SPEC 7.5: a call for each anchor, in file order
    def context(self, call: Callable[..., Any], frame: Any, planes: Any, shift: Any, pairs: Any, bits: Any) -> Any:
        """Writes the position of an anchor."""
        self._samples = 0
        self._probe("P", self._anchor, [blocks.POSITION_INTEGER(b) for b in bits])
        out = call(frame, planes, shift, pairs, bits)
        self._anchor += 1
        return out

    # SPEC 7.5.4
    def query(self, call: Callable[..., list[int]], *arguments: Any) -> list[int]:
        """Writes the samples of a plane, first of r = 1, then of r = 2."""
        self._samples += 1
        return self.written(f"samples.r{self._samples}", call(*arguments))

    def written(self, name: str, values: list[int]) -> list[int]:
        """Writes the result of a function of WRITTEN."""
        self._probe(name, self._anchor, values)
        return values

    # SPEC 7.10
    def decode_attributes(
        self, call: Callable[..., Any], stream: Any, networks: Any, shift: Any, slices: Any, contexts: Any, masks: Any
    ) -> Any:
        """Names the symbols of a chunk's attributes, and writes the step indices at their end."""
        anchors, features = range(len(contexts)), sum(slices)
        geometry = features + 6
        kept = [[geometry + 3 * k + axis for k, bit in enumerate(mask) if bit for axis in range(3)] for mask in masks]
        groups: list[list[range] | list[list[int]]] = [[range(features, geometry) for _ in anchors], kept]
        groups += [[range(sum(slices[:i]), sum(slices[: i + 1])) for _ in anchors] for i in range(len(slices))]
        first = self._first
        self._groups = iter(
            [[_channel(first + n, c, features) for n, own in enumerate(group) for c in own] for group in groups]
        )
        # Without an anchor there is no chunk. The first outputs are those of F_h, one for each anchor.
        self._hyper, self._group = [], -1
        self._total, self._slices, self._count = geometry + 3 * len(masks[0]), slices, len(contexts)
        symbols, steps = call(stream, networks, shift, slices, contexts, masks)
        self._hyper = None
        for n, own in enumerate(steps):
            self._probe("steps", first + n, own)
        self._first += len(contexts)
        return symbols, steps

    # SPEC 7.8
    def network(self, call: Callable[..., list[int]], layers: Any, inputs: list[int]) -> list[int]:
        """Keeps the outputs of F_h."""
        out = call(layers, inputs)
        if self._hyper is not None and len(self._hyper) < self._count:
            self._hyper.append(out)
        return out

    # SPEC 7.7, 7.8, 7.9: what is known before each group of symbols
    def decode_values(self, call: Callable[..., Any], stream: Any, family: Any, parameters: Any, limit: int) -> Any:
        """Writes the predictions of a group of attributes: of the scalings, the offsets, then slice after slice."""
        if self._hyper is not None:
            self._group += 1
            d, i = self._total, self._group - 2
            if self._group == 0:
                for n, out in enumerate(self._hyper):
                    for name, values in (
                        ("means", out[:d]),
                        ("scales", out[d : 2 * d]),
                        ("step_outputs", out[2 * d :]),
                    ):
                        self._probe(name, self._first + n, values)
            elif i > 0:
                width = self._slices[i]
                for n in range(self._count):
                    own = parameters[n * width : (n + 1) * width]
                    self._probe(f"slice.{i}.means", self._first + n, [mean for mean, _ in own])
                    self._probe(f"slice.{i}.scales", self._first + n, [scale for _, scale in own])
        return call(stream, family, parameters, limit)


def _numbered(name: str) -> Iterator[str]:
    return (f"{name}[{n}]" for n in count())


# SPEC 7.7
def _channel(anchor: int, channel: int, features: int) -> str:
    if channel < features:
        return f"attributes.features[{anchor},{channel}]"
    if channel < features + 6:
        return f"attributes.scalings[{anchor},{channel - features}]"
    offset, axis = divmod(channel - features - 6, 3)
    return f"attributes.offsets[{anchor},{offset},{axis}]"


# SPEC 7.5.1, 7.5.2, 7.5.3, 7.5.5: functions whose results are probes, with their names.
WRITTEN = {"FRAME_COORDINATES": "v", "CONTRACT": "w", "RESCALE": "u", "GAMMA": "gamma"}
WATCHED = (
    "NOTE_SYMBOLS", "CHECK_HEADER", "DECODE_WEIGHTS", "DECODE_PLANE", "DECODE_POSITIONS", "DECODE_MASKS", "CONTEXT",
    *WRITTEN, "QUERY", "DECODE_ATTRIBUTES", "NETWORK", "DECODE_VALUES",
)  # fmt: skip


def _watched(name: str, call: Callable[..., Any], watch: Watch) -> Callable[..., Any]:
    if name in WRITTEN:
        return lambda *arguments: watch.written(WRITTEN[name], call(*arguments))
    method = getattr(watch, name.lower())
    return lambda *arguments: method(call, *arguments)


@contextmanager
def watched(file: TextIO, probed: bool = False) -> Iterator[None]:
    """Writes the trace of the one file that is decoded meanwhile, with its probes if `probed`."""
    watch = Watch(file, probed)
    kept = {name: getattr(blocks, name) for name in WATCHED}
    try:
        for name, call in kept.items():
            setattr(blocks, name, _watched(name, call, watch))
        yield
    finally:
        vars(blocks).update(kept)
