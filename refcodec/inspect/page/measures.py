"""Measures of a scene beyond its bytes: one pass over its chunks, in bounded memory.

The decoder supplies the symbols. The decoding process then runs again with a coder that measures the code length of
each symbol (lengths).
"""

from __future__ import annotations

from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from ...bitstream.attributes import Attributes, EntropyModel, code_attributes
from ...bitstream.batches import one_thread
from ...bitstream.context import JoinedPlanes, context
from ...bitstream.conventions import Int64
from ...bitstream.dimensions import SCALINGS, Dimensions, layers_of
from ...bitstream.masks import code_masks, mask_models
from ...bitstream.networks import derive_networks
from ...bitstream.planes import PLANES, assemble_planes, code_planes
from ...bitstream.positions import PACKED, chunk_codes, code_cells
from ...bitstream.reconstruction import world_positions
from ...bitstream.scene import Scene
from ...bitstream.weights import code_grids, to_grid
from .lengths import F64, Meter, Tally

# Anchors per step, and the most anchors of a sample. Both bound the memory.
_ROWS = 8192
SAMPLE_MAX = 1 << 16
# Anchors with at least this many bits are counted together.
BITS_MAX = 1 << 13


class Sample:
    """Anchors of a scene at equal distances in file order.

    step: the number of anchors per sampled one. positions: float64 [n, 3], world units. bits: float64 [n], those of its
    attributes. kept: int64 [n], its number of kept offsets.
    """

    step: int

    def __init__(self, anchors: int) -> None:
        """anchors: N."""
        self.step = max(1, -(-anchors // SAMPLE_MAX))
        self._parts: list[tuple[F64, F64, Int64]] = [(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64))]

    def add(self, first: int, positions: NDArray[np.float32], bits: F64, kept: Int64) -> None:
        """Adds the anchors that are in the sample. first: the number of the first anchor in the file."""
        some = slice(-first % self.step, None, self.step)
        self._parts.append((positions[some].astype(np.float64), bits[some], kept[some]))

    def joined(self) -> tuple[F64, F64, Int64]:
        """Returns positions, bits and kept."""
        positions, bits, kept = zip(*self._parts, strict=True)
        return np.concatenate(positions), np.concatenate(bits), np.concatenate(kept)


class Measures:
    """The measures of a scene. `add` takes its anchors in order, and then `finish` the scene.

    tallies: of the scalings, the offsets, each slice of the features, and the planes, by name.
    bits: the code lengths of the symbols of each kind of substream, by the names of DECODED (inspect.meaning). Kinds
        that the file stores raw are missing.
    raw_positions: the bytes of positions that are raw.
    anchor_bits: int64 [BITS_MAX + 1], the number of anchors by whole bits of attributes; the last one has all above.
    mask_counts: int64 [2, contexts], the numbers of masked and kept offsets by the context of SPEC 7.6.
    kept: int64 [K + 1], the number of anchors by kept offsets. kept_bits: their bits of attributes.
    scene: with the planes and networks, and no anchor. It is set by `finish`.
    """

    tallies: dict[str, Tally]
    bits: dict[str, float]
    raw_positions: int
    anchor_bits: NDArray[np.int64]
    mask_counts: NDArray[np.int64]
    kept: NDArray[np.int64]
    kept_bits: NDArray[np.float64]
    sample: Sample

    def __init__(self, d: Dimensions, anchors: int) -> None:
        """anchors: N."""
        slices = {f"features, slice {i}": Tally(width) for i, width in enumerate(d.slices)}
        self.tallies = {"scalings": Tally(SCALINGS), "offsets": Tally(3 * d.offset_count), **slices}
        self.bits = {"attributes": 0.0, "masks": 0.0}
        self.raw_positions = 0
        self.anchor_bits = np.zeros(BITS_MAX + 1, np.int64)
        contexts = d.offset_count * (d.offset_count + 1) // 2
        self.mask_counts = np.zeros((2, contexts), np.int64)
        self.kept = np.zeros(d.offset_count + 1, np.int64)
        self.kept_bits = np.zeros(d.offset_count + 1)
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
        before: Int64 = np.cumsum(masks, axis=1) - masks
        offset = np.arange(d.offset_count)
        at = (offset * (offset + 1) // 2 + before).reshape(-1) + masks.reshape(-1) * self.mask_counts.shape[1]
        self.mask_counts += np.bincount(at, minlength=self.mask_counts.size).reshape(2, -1)
        kept = masks.sum(axis=1)
        self.kept += np.bincount(kept, minlength=len(self.kept))
        self.kept_bits += np.bincount(kept, bits, len(self.kept))
        self.sample.add(self._first + rows.start, places[rows], bits, kept)

    def _add_positions(self, scene: Scene) -> None:
        """SPEC 7.12: adds the code lengths of the trees of packed chunks, and the bytes of raw ones."""
        forms = scene.position_forms or (0,) * len(scene.chunks)
        codes = []
        for chunk, form in zip(scene.chunks, forms, strict=True):
            positions = scene.positions[chunk.start : chunk.stop]
            found = None
            if form == PACKED and scene.position_model is not None:
                found = chunk_codes(positions, scene.position_model.cell_shift)
            if found is None:
                self.raw_positions += 2 * positions.size
            else:
                codes.append(found)
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
