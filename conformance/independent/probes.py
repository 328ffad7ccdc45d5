"""Probes: the numbers that are computed for anchors, written into the trace beside the symbols.

Nothing here decodes. The decoder's own methods are watched while they run.
"""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TextIO

from .attributes import AttributeDecoder
from .context import ContextSource

# The first probes of a file are those that count. More characters are not written.
CHARACTERS_MAX = 16 << 20


class _Probes:
    """What the watched methods tell of one file."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._left = CHARACTERS_MAX
        self._anchor = -1
        self._plane = 0

    def write(self, name: str, anchor: int, values: Iterable[int]) -> None:
        """Write a probe."""
        line = f"probe {name}[{anchor}]{''.join(f' {value}' for value in values)}\n"
        self._left -= len(line)
        if self._left >= 0:
            self._file.write(line)

    # SPEC 7.5: one call for each anchor, in file order
    def context(self, call: Callable[..., list[int]], source: ContextSource, position: tuple[int, int, int]) -> Any:
        """Watch a context. The number of the anchor is told by the count of calls."""
        self._anchor += 1
        self.write("P", self._anchor, position)
        self._plane = 0
        return call(source, position)

    # SPEC 7.5.1, 7.5.2, 7.5.3: v and w are the values of one variable, one after the other
    def coordinates(self, call: Callable[..., list[int]], *arguments: Any) -> list[int]:
        """Watch the map of a position to the unit cube."""
        seen: list[list[int]] = []

        def look(frame: FrameType, event: str, _: Any) -> Any:
            v = frame.f_locals.get("v")
            if isinstance(v, list) and len(v) == 3 and (not seen or event == "return"):
                seen.append(list(v))
            return look

        before = sys.gettrace()
        sys.settrace(lambda frame, event, _: look if frame.f_code.co_name == "_unit_coordinates" else None)
        try:
            u = call(*arguments)
        finally:
            sys.settrace(before)
        for name, values in zip(("v", "w"), seen):
            self.write(name, self._anchor, values)
        self.write("u", self._anchor, u)
        return u

    # SPEC 7.5.4
    def query(self, call: Callable[..., list[int]], *arguments: Any) -> list[int]:
        """Watch the samples of a plane, first of r = 1, then of r = 2."""
        values = call(*arguments)
        self._plane += 1
        self.write(f"samples.r{self._plane}", self._anchor, values)
        return values

    # SPEC 7.5.5
    def gamma(self, call: Callable[..., list[int]], *arguments: Any) -> list[int]:
        """Watch the positional encoding."""
        values = call(*arguments)
        self.write("gamma", self._anchor, values)
        return values

    # SPEC 7.7, 7.8, 7.9: what is known before each group of symbols
    def stage(self, call: Callable[..., None], decoder: Any, channels: Any, predictions: Any, symbols: Any) -> None:
        """Watch the decoding of a group of attributes: the scalings, the offsets, then slice after slice."""
        d, features, first = decoder._channels, decoder._features, decoder._first_anchor
        own = channels[0]
        if own == range(features, features + 6):
            for n, outputs in enumerate(predictions):
                self.write("means", first + n, outputs[:d])
                self.write("scales", first + n, outputs[d : 2 * d])
                self.write("step_outputs", first + n, outputs[2 * d :])
        elif isinstance(own, range) and own.start:
            starts = [sum(decoder._slices[:i]) for i in range(len(decoder._slices))]
            index = starts.index(own.start) if own.start in starts else len(starts)
            for n, outputs in enumerate(predictions):
                self.write(f"slice.{index}.means", first + n, outputs[own.start : own.stop])
                self.write(f"slice.{index}.scales", first + n, outputs[d + own.start : d + own.stop])
        call(decoder, channels, predictions, symbols)

    # SPEC 7.8
    def run(self, call: Callable[..., Any], decoder: Any, contexts: Any, masks: Any) -> Any:
        """Watch the decoding of a chunk's attributes, at whose end the step indices are known."""
        symbols, steps = call(decoder, contexts, masks)
        for n, own in enumerate(steps):
            self.write("steps", decoder._first_anchor + n, own)
        return symbols, steps


def _replace(owner: type, name: str, watch: Callable[..., Any]) -> Callable[[], None]:
    """Put a watch before a method. Return what takes it away."""
    kept = vars(owner)[name]
    call = kept.__func__ if isinstance(kept, staticmethod) else kept

    def watched(*arguments: Any) -> Any:
        return watch(call, *arguments)

    setattr(owner, name, staticmethod(watched) if isinstance(kept, staticmethod) else watched)
    return lambda: setattr(owner, name, kept)


@contextmanager
def probes(file: TextIO) -> Iterator[None]:
    """Write the probes of the one file that is decoded meanwhile."""
    found = _Probes(file)
    watches: tuple[tuple[type, str, Callable[..., Any]], ...] = (
        (ContextSource, "__call__", found.context),
        (ContextSource, "_unit_coordinates", found.coordinates),
        (ContextSource, "_query", found.query),
        (ContextSource, "_gamma", found.gamma),
        (AttributeDecoder, "_stage", found.stage),
        (AttributeDecoder, "run", found.run),
    )
    undo = [_replace(*watch) for watch in watches]
    try:
        yield
    finally:
        for take_away in undo:
            take_away()
