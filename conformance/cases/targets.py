"""The valid files to which faults are applied.

Files with different seeds are similar. The suite uses seed 0, and the fuzzer draws others.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.directory import SECTIONS
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.scene import Ancillary
from refcodec.bitstream.tables import tables
from refcodec.encoder.positions import position_model

from .cells import placed, sharp_model
from .numbers import Numbers
from .samplers import drawn
from .scenes import (
    CONSTANT,
    MAIN_SMALLEST,
    PLANELESS,
    SMALLEST,
    TINY_DIMENSIONS,
    UNENCODED,
    constant,
    lattice,
    packed_weights,
    scene,
    settled,
    silent,
    with_symbols,
)
from .target import Target

# The place of an ancillary section after all critical ones.
BEHIND = len(SECTIONS)
# Seeds that the fuzzer draws.
SEEDS = 6
# Usual dimensions: small networks, because hundreds of files of the suite are one of these with a fault.
_SMALL = replace(TINY_DIMENSIONS, hyper_width=(2,), carm_width=(2,), render_width=1)
# The first substream of attributes, which is the only one of some files.
ATTRIBUTES_0 = "attributes[chunk 0]"


@cache
def plain() -> Target:
    """Returns a file of three chunks in mode 0. Two ancillary sections, the last one empty, end it."""
    made = drawn("refused", 11, _SMALL, chunk_size=4)
    behind = (Ancillary(b"noTE", 1, b"hello", BEHIND), Ancillary(b"moRE", 0, b"", BEHIND))
    return Target(codec.emit(replace(made, ancillary=behind)))


@cache
def strewn() -> Target:
    """Returns a file of two chunks in mode 0 with ancillary sections before, among and after the critical ones."""
    made = drawn("refused-strewn", 5, _SMALL, chunk_size=3)
    texts = (b"a", b"bcd", b"efghi", b"jk", b"l")
    every = tuple(Ancillary(b"noTE", 0, text, after) for after, text in enumerate(texts, 1))
    return Target(codec.emit(replace(made, ancillary=(Ancillary(b"moRE", 0, b"first"), *every))))


@cache
def packed() -> Target:
    """Returns a file in mode 1: two packed chunks, a raw and a packed one. The layer colour.0 is raw."""
    where = lattice(Numbers("refused-packed"), 11)
    where[6] = where[7]
    made = drawn("refused-packed", 11, _SMALL, chunk_size=3, positions=where, position_model=position_model(where, 3))
    made.networks["colour"][0][1][0] = -0.0
    return Target(codec.emit(packed_weights(made)))


@cache
def planeless() -> Target:
    """Returns a file without planes."""
    return Target(codec.emit(drawn("refused-planeless", 2, PLANELESS)))


@cache
def unencoded() -> Target:
    """Returns a file without a positional encoding."""
    return Target(codec.emit(drawn("refused-unencoded", 2, UNENCODED)))


@cache
def unpredicted() -> Target:
    """Returns a file without planes and without a positional encoding."""
    return Target(codec.emit(drawn("refused-constant", 2, CONSTANT)))


@cache
def later() -> Target:
    """Returns a file of a later minor version, with eight more bytes in the header."""
    return Target(codec.emit(replace(drawn("refused-later", 2, SMALLEST), minor=3, later=b"\1\2\3\4\5\6\7\x08")))


@cache
def main_file() -> Target:
    """Returns a file of profile Main, level 1, in mode 1, without anchors and with zero weights."""
    made = scene("refused-main", 0, MAIN_SMALLEST)
    networks = {name: silent(layers) for name, layers in made.networks.items()}
    networks["sarm"][-1][1][1] = -40
    quiet = replace(made, networks=networks, planes=np.zeros_like(made.planes), position_model=sharp_model())
    return Target(codec.emit(packed_weights(quiet)))


@cache
def grids(seed: int = 0) -> Target:
    """Returns a file in mode 1. The first layer is raw because of a bias of -0, the others are packed."""
    d = replace(SMALLEST, slices=(1, 1), carm_width=(2,)) if seed % 2 else SMALLEST
    made = scene("refused-grids", 2, d, seed, lanes=Lanes(0, 0, (1 + seed) % 3))
    made.networks["hyper"][0][1][0] = -0.0
    return Target(codec.emit(packed_weights(settled(made))))


@cache
def five_cells(seed: int = 0) -> Target:
    """Returns a file of five anchors in one packed chunk."""
    where = lattice(Numbers("refused-cells", seed), 5)
    return Target(codec.emit(placed("refused-cells", where, chunk_size=5, seed=seed)))


@lru_cache(maxsize=64)
def far(symbol: int, scale: int = -40, seed: int = 0) -> Target:
    """Returns a file of one anchor. Its feature is far from its mean of 0. All else takes almost no bits.

    Thus the raw bytes of its attributes are those of one value. scale: the feature's scale index.
    """
    zero = np.zeros(SMALLEST.attribute_width, np.int64)
    networks = constant(SMALLEST, Numbers("refused-far", seed), zero, zero - 40)
    made = scene("refused-far", 1, SMALLEST, seed, networks=networks)
    made.networks["hyper"][-1][1][SMALLEST.attribute_width] = scale
    made = replace(made, masks=np.zeros((1, 1), bool), lanes=Lanes(0, 0, seed % 3))
    return Target(codec.emit(with_symbols(made, features=np.array([[symbol]]), scalings=np.zeros((1, 6)))))


@cache
def radius() -> int:
    """Returns the radius of the model of far's feature with the least scale. Values beyond it are escaped."""
    return int(tables().gauss.radius[8])
