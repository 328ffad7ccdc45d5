"""Measures of a scene beyond its bytes: one pass over its chunks, in bounded memory.

The decoder supplies the symbols. The decoding process then runs again with a coder (bitstream.entropy.Coder) that codes
nothing and measures the code length of each symbol. Thus the process itself selects the model of each symbol.
"""

import math
from collections.abc import Iterable
from functools import cache
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from ...bitstream.attributes import Attributes, EntropyModel, code_attributes
from ...bitstream.batches import one_thread
from ...bitstream.context import JoinedPlanes, context
from ...bitstream.conventions import Int64
from ...bitstream.dimensions import SCALINGS, Dimensions, layers_of
from ...bitstream.entropy import SymbolName, ValueGroup, placed
from ...bitstream.masks import code_masks, mask_models
from ...bitstream.networks import derive_networks
from ...bitstream.planes import PLANES, assemble_planes, code_planes
from ...bitstream.positions import PACKED, chunk_codes, code_cells
from ...bitstream.reconstruction import world_positions
from ...bitstream.scene import Scene
from ...bitstream.tables import PRECISION, TOTAL, ModelSet
from ...bitstream.weights import code_grids, to_grid
from ...pages.plots import F64

# Anchors per step, and the most anchors of a sample. Both bound the memory.
_ROWS = 8192
SAMPLE_MAX = 1 << 16
# Anchors with at least this many bits are counted together.
BITS_MAX = 1 << 13
# Symbols of a larger magnitude are counted together. A channel has a place for each of the others, after one for those
# below and before one for those above.
LIMIT = 511
_PLACES = 2 * LIMIT + 3


@cache
def _frequency_bits() -> F64:
    """The code length of a symbol by its frequency, 0 to 2^14, in bits. No symbol has frequency 0."""
    return np.array([0.0, *(PRECISION - math.log2(f) for f in range(1, TOTAL + 1))])


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

    symbols: their number. bits: their code length. counts: int64 [channels, places], by value.
    channel_bits: float64 [channels].
    """

    symbols: int
    bits: float
    counts: Int64
    channel_bits: F64

    def __init__(self, channels: int) -> None:
        self.symbols = 0
        self.bits = 0.0
        self.counts = np.zeros((channels, _PLACES), dtype=np.int64)
        self.channel_bits = np.zeros(channels)

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
        channels = len(self.channel_bits)
        place = channel * _PLACES + np.clip(value, -LIMIT - 1, LIMIT + 1) + LIMIT + 1
        self.counts += np.bincount(place, minlength=channels * _PLACES).reshape(channels, _PLACES)
        self.channel_bits += np.bincount(channel, bits, channels)
        return np.asarray(bits)

    @property
    def beyond(self) -> int:
        """The number of symbols beyond LIMIT in magnitude."""
        return int(self.counts[:, 0].sum() + self.counts[:, -1].sum())

    @property
    def entropy(self) -> float:
        """The empirical entropy of the symbols in bits: each channel by itself, without a context."""
        return sum(map(_empirical, self.counts))


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
        given = group.given
        assert given is not None
        tally, channel = next(self._tallies)
        if channel is None:
            channels = len(tally.channel_bits)
            channel = np.repeat(np.arange(channels), len(given) // channels)
        self.bits.append(tally.add(group.models, group.mean, group.scale, given, channel))
        return given

    def plain(self, models: ModelSet, index: Int64, counts: list[int], name: SymbolName, given: Int64 | None) -> Int64:
        assert given is not None
        self.bits.append(plain_bits(models, index, given))
        return given

    @property
    def total(self) -> float:
        """The code length of all symbols in bits."""
        return float(sum(each.sum() for each in self.bits))


class Sample:
    """Anchors of a scene at equal distances in file order.

    step: the number of anchors per sampled one.
    """

    step: int

    def __init__(self, anchors: int) -> None:
        """anchors: N."""
        self.step = max(1, -(-anchors // SAMPLE_MAX))
        self._parts: list[tuple[F64, F64]] = [(np.zeros((0, 3)), np.zeros(0))]

    def add(self, first: int, positions: NDArray[np.float32], bits: F64) -> None:
        """Adds the anchors that are in the sample. first: the number of the first anchor in the file."""
        some = slice(-first % self.step, None, self.step)
        self._parts.append((positions[some].astype(np.float64), bits[some]))

    def joined(self) -> tuple[F64, F64]:
        """Returns positions, float64 [n, 3], world units, and the bits of the attributes of each, float64 [n]."""
        positions, bits = zip(*self._parts, strict=True)
        return np.concatenate(positions), np.concatenate(bits)


class SceneMeasures:
    """The measures of a scene. `add` takes its anchors in order, and then `finish` the scene.

    tallies: of the scalings, the offsets, each slice of the features, and the planes, by name.
    bits: the code lengths of the symbols of each kind of substream, by the names of DECODED (inspect.meaning). Kinds
        that the file stores raw are missing.
    raw_positions: the bytes of positions that are raw.
    anchor_bits: int64 [BITS_MAX + 1], the number of anchors by whole bits of attributes; the last one has all above.
    scene: with the planes and networks, and no anchor. It is set by `finish`.
    """

    tallies: dict[str, Tally]
    bits: dict[str, float]
    raw_positions: int
    anchor_bits: NDArray[np.int64]
    sample: Sample

    def __init__(self, d: Dimensions, anchors: int) -> None:
        """anchors: N."""
        slices = {f"features, slice {i}": Tally(width) for i, width in enumerate(d.slices)}
        self.tallies = {"scalings": Tally(SCALINGS), "offsets": Tally(3 * d.offset_count), **slices}
        self.bits = {"attributes": 0.0, "masks": 0.0}
        self.raw_positions = 0
        self.anchor_bits = np.zeros(BITS_MAX + 1, np.int64)
        self.sample = Sample(anchors)
        self.scene: Scene | None = None
        self._first = 0
        self._model: EntropyModel | None = None
        self._planes: JoinedPlanes | None = None

    def add(self, scene: Scene) -> None:
        """Adds anchors. scene: with only these anchors, in their chunks."""
        with one_thread():
            if self._model is None:
                networks = derive_networks(scene.networks)
                self._model = EntropyModel.of(networks, scene.carm_shift, scene.dimensions.slices)
                self._planes = assemble_planes(scene.planes)
            self._add_positions(scene)
            places = world_positions(scene)
            for start in range(0, scene.anchor_count, _ROWS):
                self._add_rows(scene, slice(start, min(start + _ROWS, scene.anchor_count)), places)
        self._first += scene.anchor_count

    def _add_rows(self, scene: Scene, rows: slice, places: NDArray[np.float32]) -> None:
        """Adds some anchors. places: the world positions of all anchors of the scene."""
        assert self._model is not None
        assert self._planes is not None
        d, a, masks = scene.dimensions, scene.attributes, scene.masks[rows]
        n = len(masks)
        chunk = [range(n)]
        given = Attributes(a.features[rows], a.scalings[rows], a.offsets[rows], a.steps[rows])
        contexts = context(scene.frame, self._planes, scene.plane_shift, d.frequency_count, scene.positions[rows])
        # SPEC 7.10: scalings, offsets, slices.
        width = 3 * d.offset_count
        coded = np.flatnonzero(np.repeat(masks, 3, axis=1))
        channels = [np.tile(np.arange(SCALINGS), n), coded % width, *(np.tile(np.arange(w), n) for w in d.slices)]
        meter = Meter(zip(self.tallies.values(), channels, strict=True))
        code_attributes(meter, self._model, contexts, masks, chunk, given)
        scalings, offsets, *slices = meter.bits
        bits = scalings.reshape(n, -1).sum(axis=1) + np.bincount(coded // width, offsets, n)
        for each in slices:
            bits += each.reshape(n, -1).sum(axis=1)
        self.bits["attributes"] += float(bits.sum())
        self.anchor_bits += np.bincount(np.minimum(bits, BITS_MAX).astype(np.int64), minlength=BITS_MAX + 1)
        # SPEC 7.6
        meter = Meter()
        code_masks(meter, mask_models(scene.mask_model), d.offset_count, chunk, masks)
        self.bits["masks"] += meter.total
        self.sample.add(self._first + rows.start, places[rows], bits)

    def _add_positions(self, scene: Scene) -> None:
        """SPEC 7.12: adds the code lengths of the trees of packed chunks, and the bytes of raw ones."""
        forms = scene.position_forms or (0,) * len(scene.chunks)
        codes = []
        for chunk, form in zip(scene.chunks, forms, strict=True):
            positions = scene.positions[chunk.start : chunk.stop]
            tree = None
            if form == PACKED and scene.position_model is not None:
                tree = chunk_codes(positions, scene.position_model.cell_shift)
            if tree is None:
                self.raw_positions += 2 * positions.size
            else:
                codes.append(tree)
        if codes and scene.position_model is not None:
            meter = Meter()
            counts = [len(code) for code in codes]
            code_cells(meter, scene.position_model.models(), [], counts, np.concatenate(codes))
            self.bits["positions"] = self.bits.get("positions", 0.0) + meter.total

    def finish(self, scene: Scene) -> None:
        """Adds the planes and the weights. scene: with them, and without anchors."""
        d, self.scene = scene.dimensions, scene
        if d.plane_channels:
            # SPEC 7.3: a group holds the points of a wavefront, by sub-plane, then by channel.
            sarm, blocks = derive_networks({"sarm": scene.networks["sarm"]})["sarm"], PLANES * d.plane_channels
            tally = Tally(blocks)
            code_planes(Meter(repeat((tally, None))), sarm, d.plane_channels, d.plane_size, scene.planes)
            self.tallies["planes"] = tally
            self.bits["planes"] = tally.bits
        if scene.weight_scales is not None and scene.weight_forms is not None:
            # SPEC 7.13
            layers = [layer for network in scene.networks.values() for layer in network]
            packed = np.flatnonzero(scene.weight_forms).tolist()
            grids = [grid for i in packed if (grid := to_grid(layers[i])) is not None]
            shapes = layers_of(d)
            meter = Meter(repeat((Tally(1), None)))
            code_grids(meter, [shapes[i] for i in packed], scene.weight_scales[packed], grids)
            self.bits["weights"] = meter.total
