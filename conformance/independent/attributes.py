"""Clauses 6.13 and 7.7 to 7.10: the attributes."""

from .conventions import ATTRIBUTE_SYMBOL_MAX, STEP_LENGTH, activation, clamp, shift_round
from .entropy import Substream
from .header import Header
from .tables import Family
from .trace import Trace
from .weights import Weights


class AttributeDecoder:
    """Decodes the attributes of a chunk, stage by stage."""

    def __init__(
        self, stream: Substream, header: Header, weights: Weights, gauss: Family, trace: Trace | None, first: int
    ) -> None:
        """first: the number of the chunk's first anchor, for the trace."""
        self._stream = stream
        self._trace = trace
        self._first_anchor = first
        self._slices: list[int] = header["slice_width"]
        self._features = header.features
        self._channels = header.channels
        self._weights = weights
        self._gauss = gauss

    # SPEC 7.7, 7.8, 7.10
    def run(self, contexts: list[list[int]], masks: list[list[int]]) -> tuple[list[list[int]], list[list[int]]]:
        """Return for each anchor its D symbols, and for each anchor its three step indices.

        contexts: the inputs of F_h for each anchor. masks: the K bits of each anchor.
        """
        hyper = self._weights.networks["hyper"]
        d = self._channels
        predictions = [hyper(context) for context in contexts]
        symbols = [[0] * d for _ in contexts]
        geometry = self._features + 6
        self._stage([range(self._features, geometry)] * len(contexts), predictions, symbols)
        kept = [[geometry + 3 * k + axis for k, bit in enumerate(mask) if bit for axis in range(3)] for mask in masks]
        self._stage(kept, predictions, symbols)
        first = 0
        for i, width in enumerate(self._slices):
            if i:
                for y, prediction in zip(symbols, predictions):
                    self._correct(i, first, width, y, prediction)
            self._stage([range(first, first + width)] * len(contexts), predictions, symbols)
            first += width
        steps = [[clamp(x, 0, STEP_LENGTH - 1) for x in prediction[2 * d :]] for prediction in predictions]
        return symbols, steps

    # SPEC 7.9
    def _correct(self, i: int, first: int, width: int, y: list[int], prediction: list[int]) -> None:
        """Add the outputs of carm.i to the prediction of slice i."""
        inputs = [activation(shift_round(y[c], self._weights.carm_shift[c])) for c in range(first)]
        change = self._weights.networks[f"carm.{i}"](inputs)
        for n in range(width):
            prediction[first + n] += change[n]
            prediction[self._channels + first + n] += change[width + n]

    # SPEC 7.10
    def _stage(
        self, channels: list[range] | list[list[int]], predictions: list[list[int]], symbols: list[list[int]]
    ) -> None:
        """Decode one group, the given channels of each anchor, into symbols."""
        d = self._channels
        parameters = [(p[c], p[d + c]) for p, coded in zip(predictions, channels) for c in coded]
        values = self._stream.values(self._gauss, parameters, ATTRIBUTE_SYMBOL_MAX)
        if self._trace:
            self._trace.attributes(self._first_anchor, self._features, channels, values)
        rest = iter(values)
        for y, coded in zip(symbols, channels):
            for c in coded:
                y[c] = next(rest)
