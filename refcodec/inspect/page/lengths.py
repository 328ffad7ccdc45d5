"""Code lengths and histograms of symbols, and the curves that their models expect.

A Tally counts the symbols of one kind. A Meter is a coder (bitstream.entropy.Coder) that codes nothing and feeds
tallies. Thus the decoding process itself selects the model of each symbol.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cache

import numpy as np

from ...bitstream.conventions import Int64
from ...bitstream.entropy import SymbolName, ValueGroup, placed
from ...bitstream.tables import PRECISION, TOTAL, ModelSet, tables
from ...pages.plots import F64, Plot, histogram

# Symbols of a larger magnitude are counted together. The histogram of a channel has a place for each of the others,
# after one for those below and before one for those above.
LIMIT = 511
_PLACES = 2 * LIMIT + 3
# Distinct models per step, which bounds the memory.
_BLOCK = 4096
# The code length of an escape beside its model's symbol (SPEC 8.7), in the mean: a sign, and an Elias-gamma code whose
# prefix of z zeros has the probability 2^-(z + 1).
_ESCAPE_BITS = 4.0
# Prefixes of escapes that a curve has.
_PREFIXES = LIMIT.bit_length() + 1


@cache
def _frequency_bits() -> F64:
    """The code length of a symbol by its frequency, 0 to 2^14, in bits. No symbol has frequency 0."""
    return np.array([0.0, *(PRECISION - math.log2(f) for f in range(1, TOTAL + 1))])


@cache
def _entropies(family: str) -> F64:
    """The mean code length of each model of a family, with its escape, in bits, float64 [models]."""
    models: ModelSet = getattr(tables(), family)
    frequency = (models.upper - models.lower).astype(np.int64)
    ends = np.append(models.offset[1:], len(frequency))
    weighted = frequency * _frequency_bits()[frequency] / TOTAL
    found = np.add.reduceat(weighted, models.offset)
    escape = np.where(models.radius > 0, frequency[ends - 1] / TOTAL * _ESCAPE_BITS, 0.0)
    return np.asarray(found + escape)


def escape_bits(away: Int64, radius: Int64) -> Int64:
    """SPEC 8.7: returns the code lengths of escapes without their models' symbols, int64 bits.

    away: distances from the centre, past the radius. Both are int64 [n].
    """
    return 2 * np.frexp((np.abs(away) - radius).astype(np.float64))[1].astype(np.int64)


def plain_bits(models: ModelSet, index: Int64, symbol: Int64) -> F64:
    """SPEC 8.2: returns the code lengths of symbols other than values, float64 [n] bits. index: of their models."""
    at = models.offset.take(index) + symbol
    return np.asarray(_frequency_bits()[models.upper.take(at) - models.lower.take(at)])


class Tally:
    """Symbols of one kind, counted.

    symbols: their number. bits: their code length. expected: the mean code length that their models promise.
    counts: int64 [channels, places], the histogram of each channel. channel_bits: float64 [channels].
    """

    symbols: int
    bits: float
    expected: float
    counts: Int64
    channel_bits: F64

    def __init__(self, channels: int) -> None:
        self.symbols = 0
        self.bits = self.expected = 0.0
        self.counts = np.zeros((channels, _PLACES), dtype=np.int64)
        self.channel_bits = np.zeros(channels)
        # The difference of each place of the curve to the one before it.
        self._change = np.zeros(2 * LIMIT + 2)

    def add(self, models: ModelSet, mean: Int64, scale: Int64, value: Int64, channel: Int64) -> F64:
        """Counts values and returns their code lengths, float64 [n] bits.

        models, mean, scale, value: as for bitstream.entropy.placed. channel: int64 [n], the channel of each.
        """
        model, index, away, raw = placed(models, mean, scale, value)
        bits = plain_bits(models, model, index) + raw
        radius = models.radius.take(model)
        escaped = np.flatnonzero(index > 2 * radius)
        bits[escaped] += escape_bits(away[escaped], radius[escaped])
        self.symbols += len(value)
        self.bits += float(bits.sum())
        self.expected += float(_entropies(models.family)[model].sum()) + float(raw.sum())
        channels = len(self.channel_bits)
        place = channel * _PLACES + np.clip(value, -LIMIT - 1, LIMIT + 1) + LIMIT + 1
        self.counts += np.bincount(place, minlength=channels * _PLACES).reshape(channels, _PLACES)
        self.channel_bits += np.bincount(channel, bits, channels)
        self._add_curve(models, model, (value >> raw) - away, raw)
        return np.asarray(bits)

    def _add_curve(self, models: ModelSet, model: Int64, centre: Int64, raw: Int64) -> None:
        """Adds the probabilities of all values of some models. centre, raw: int64 [n], as SELECT gives them."""
        # No part of the table of such a distant model is within the limit.
        most = int(models.radius.max()) + LIMIT + 2
        near = np.abs(centre) <= most
        if not near.all():
            model, centre, raw = model[near], centre[near], raw[near]
        span = 2 * most + 1
        key, times = np.unique((raw * span + centre + most) * len(models.offset) + model, return_counts=True)
        for first in range(0, len(key), _BLOCK):
            some = key[first : first + _BLOCK]
            rest, model = some // len(models.offset), some % len(models.offset)
            raw, centre = rest // span, rest % span - most
            self._add_models(models, model, centre, raw, times[first : first + _BLOCK].astype(np.float64))

    def _add_models(self, models: ModelSet, model: Int64, centre: Int64, raw: Int64, times: F64) -> None:
        """Adds the probabilities of some models. times: float64 [n], how often each was used."""
        radius = models.radius.take(model)
        # SPEC 8.4: the symbols of a model but its escape, one after the other.
        length = 2 * radius + 1
        number = np.arange(int(length.sum())) - np.repeat(np.cumsum(length) - length, length)
        at = np.repeat(models.offset.take(model), length) + number
        frequency = (models.upper.take(at) - models.lower.take(at)).astype(np.float64)
        high = np.repeat(centre - radius, length) + number
        self._spread(high, high + 1, np.repeat(raw, length), np.repeat(times, length) * frequency / TOTAL)
        # SPEC 8.7: an escape is 2^z to 2^(z+1) - 1 past the radius with probability 2^-(z+1), on either side.
        escape = models.offset.take(model) + 2 * radius + 1
        frequency = (models.upper.take(escape) - models.lower.take(escape)).astype(np.float64)
        for z in range(_PREFIXES):
            near, far, weight = radius + (1 << z), radius + (2 << z), times * frequency / TOTAL / (4 << z)
            self._spread(centre + near, centre + far, raw, weight)
            self._spread(centre - far + 1, centre - near + 1, raw, weight)

    def _spread(self, first: Int64, end: Int64, raw: Int64, weight: F64) -> None:
        """Distributes weights evenly over the values first * 2^raw to end * 2^raw - 1, which raw bits select."""
        each = weight / np.exp2(np.maximum(raw, 0)) / (end - first)
        for bound, sign in ((first, 1), (end, -1)):
            place = np.clip(bound << raw, -LIMIT, LIMIT + 1) + LIMIT
            self._change += sign * np.bincount(place, each, 2 * LIMIT + 2)

    @property
    def histogram(self) -> Int64:
        """The frequency of each value from -LIMIT to LIMIT, int64 [2 LIMIT + 1]."""
        return np.asarray(self.counts[:, 1:-1].sum(axis=0))

    @property
    def curve(self) -> F64:
        """The expected frequency of each value from -LIMIT to LIMIT: the sum of its probabilities."""
        return np.maximum(np.cumsum(self._change)[:-1], 0.0)

    def plot(self, title: str) -> Plot:
        """Returns the plot of the histogram and the curve."""
        return histogram(title, self.histogram, self.curve, "symbol, quantisation steps", "frequency")

    @property
    def beyond(self) -> int:
        """The number of symbols beyond LIMIT in magnitude."""
        return int(self.counts[:, 0].sum() + self.counts[:, -1].sum())

    @property
    def entropy(self) -> float:
        """The empirical entropy of the symbols in bits: each channel by itself, without a context."""
        return sum(map(_empirical, self.counts))

    @property
    def misfit(self) -> float:
        """The divergence of the histogram from the curve in bits: a lower bound of the cost of the misfit."""
        met = np.append(self.histogram, self.beyond).astype(np.float64)
        expected = np.append(self.curve, max(self.symbols - float(self.curve.sum()), 0.0))
        some = met > 0
        # A rounded sum can be zero for a symbol that occurred. Its model gave it at least 2^-14.
        expected = np.maximum(expected[some], met[some] / TOTAL)
        return float((met[some] * np.log2(met[some] / expected)).sum())


def _empirical(counts: Int64) -> float:
    """The empirical entropy of symbols with these counts, times how many there are."""
    some = counts[counts > 0].astype(np.float64)
    return float((some * np.log2(some.sum() / some)).sum())


class Meter:
    """A coder that feeds values to tallies, and keeps the code lengths of all symbols.

    bits: the code lengths of each group of symbols, in coding order, float64.
    """

    def __init__(self, tallies: Iterable[tuple[Tally, Int64 | None]] = ()) -> None:
        """tallies: for each group of values its tally and the channel of each value, int64 [n].

        None stands for values in as many equal parts as the tally has channels, one after the other.
        """
        self._tallies = iter(tallies)
        self.bits: list[F64] = []

    def values(self, group: ValueGroup) -> Int64:
        """As Encoder.values."""
        given = group.given
        assert given is not None
        tally, channel = next(self._tallies)
        if channel is None:
            channels = len(tally.channel_bits)
            channel = np.repeat(np.arange(channels), len(given) // channels)
        self.bits.append(tally.add(group.models, group.mean, group.scale, given, channel))
        return given

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        """As Encoder.plain."""
        assert given is not None
        self.bits.append(plain_bits(models, index, given))
        return given

    @property
    def total(self) -> float:
        """The code length of all symbols in bits."""
        return float(sum(each.sum() for each in self.bits))
