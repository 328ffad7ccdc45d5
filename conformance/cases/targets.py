"""The valid files to which faults are applied.

Files with different seeds are similar. The suite uses seed 0, and the fuzzer draws others.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, lru_cache

import numpy as np

from refcodec.bitstream import codec
from refcodec.bitstream.directory import SECTIONS
from refcodec.bitstream.header import Lanes, restamped
from refcodec.bitstream.scene import Ancillary, Scene
from refcodec.bitstream.tables import tables
from refcodec.encoder.positions import position_model

from ..manifest import VECTORS
from .numbers import Numbers
from .samplers import drawn
from .scenes import (
    CONSTANT,
    MAIN_SMALLEST,
    PLANELESS,
    SMALLEST,
    TINY_DIMENSIONS,
    UNENCODED,
    lattice,
    only_symbols,
    placed,
    scene,
    settled,
    sharp_model,
)
from .target import Target
from .weights import QUIET_SARM, constant, packed_weights, with_weights

# The place of an ancillary section after all critical ones.
BEHIND = len(SECTIONS)
# Seeds that the fuzzer draws.
SEEDS = 6
# Usual dimensions: small networks, because hundreds of files of the suite are one of these with a fault.
_SMALL = replace(TINY_DIMENSIONS, hyper_width=(2,), carm_width=(2,), render_width=1)
# The first substream of attributes, which is the only one of some files.
ATTRIBUTES_0 = "attributes[chunk 0]"


def stored(path: str) -> bytes:
    """Returns a file of the suite. It may be of the major version before (`python -m release --major`)."""
    return restamped((VECTORS / path).read_bytes())


def target_of(make: Callable[..., Scene]) -> Callable[..., Target]:
    """Returns a function that returns the file of a scene, which is made once. Also a decorator."""
    return lru_cache(maxsize=64)(lambda *args, **kwargs: Target(codec.emit(make(*args, **kwargs))))


@target_of
def plain() -> Scene:
    """A file of three chunks in mode 0. Two ancillary sections, the last one empty, end it."""
    behind = (Ancillary(b"noTE", 1, b"hello", BEHIND), Ancillary(b"moRE", 0, b"", BEHIND))
    return replace(drawn("refused", 11, _SMALL, chunk_size=4), ancillary=behind)


@target_of
def strewn() -> Scene:
    """A file of two chunks in mode 0 with ancillary sections before, among and after the critical ones."""
    texts = (b"a", b"bcd", b"efghi", b"jk", b"l")
    every = tuple(Ancillary(b"noTE", 0, text, after) for after, text in enumerate(texts, 1))
    made = drawn("refused-strewn", 5, _SMALL, chunk_size=3)
    return replace(made, ancillary=(Ancillary(b"moRE", 0, b"first"), *every))


@target_of
def packed() -> Scene:
    """A file in mode 1: two packed chunks, a raw and a packed one. The layer colour.0 is raw."""
    where = lattice(Numbers("refused-packed"), 11)
    where[6] = where[7]
    made = drawn("refused-packed", 11, _SMALL, chunk_size=3, positions=where, position_model=position_model(where, 3))
    return packed_weights(with_weights(made, ("colour.0", 0, None, -0.0)))


# Files without planes, without a positional encoding, and without both.
planeless = target_of(lambda: drawn("refused-planeless", 2, PLANELESS))
unencoded = target_of(lambda: drawn("refused-unencoded", 2, UNENCODED))
unpredicted = target_of(lambda: drawn("refused-constant", 2, CONSTANT))
# A file of a later minor version, with eight more bytes in the header.
later = target_of(lambda: replace(drawn("refused-later", 2, SMALLEST), minor=3, later=b"\1\2\3\4\5\6\7\x08"))


@target_of
def main_file() -> Scene:
    """A file of profile Main, level 10, in mode 1, without anchors and with zero weights."""
    made = scene("refused-main", 0, MAIN_SMALLEST, position_model=sharp_model())
    zeros = with_weights(made, *((name, slice(None), 0, 0) for name in made.networks), QUIET_SARM[-1])
    return packed_weights(replace(zeros, planes=np.zeros_like(made.planes)))


_BARE = replace(_SMALL, offset_count=1, slices=(1, 2, 2))


@target_of
def bare() -> Scene:
    """A file of minor version 1 in mode 0, without anchors. An ancillary section ends it."""
    return replace(
        scene("refused-bare", 0, _BARE, lanes=Lanes(3, 0, 0)),
        minor=1,
        ancillary=(Ancillary(b"noTE", 1, b"hello", BEHIND),),
    )


@target_of
def bare_packed() -> Scene:
    """A file of minor version 1 in mode 1, without anchors. The layer hyper.0 is raw."""
    made = scene("refused-bare-packed", 0, _BARE, position_model=sharp_model(), lanes=Lanes(0, 0, 0))
    return replace(packed_weights(settled(with_weights(made, ("hyper.0", 0, None, -0.0)))), minor=1)


@target_of
def later_main() -> Scene:
    """main_file, of a later minor version."""
    return replace(codec.parse(main_file().data).scene, minor=3, later=b"\1\2\3\4")


@target_of
def grids(seed: int = 0) -> Scene:
    """A file in mode 1. The first layer is raw because of a bias of -0, the others are packed."""
    d = replace(SMALLEST, slices=(1, 1), carm_width=(2,)) if seed % 2 else SMALLEST
    made = scene("refused-grids", 2, d, seed, lanes=Lanes(0, 0, (1 + seed) % 3))
    return packed_weights(settled(with_weights(made, ("hyper.0", 0, None, -0.0))))


@target_of
def five_cells(seed: int = 0) -> Scene:
    """A file of five anchors in one packed chunk."""
    return placed("refused-cells", lattice(Numbers("refused-cells", seed), 5), chunk_size=5, seed=seed)


@target_of
def far(symbol: int, scale: int = -40, seed: int = 0) -> Scene:
    """A file of one anchor. Its feature is far from its mean of 0. All else takes almost no bits.

    Thus the raw bytes of its attributes are those of one value. scale: the feature's scale index.
    """
    networks = constant(SMALLEST, Numbers("refused-far", seed))
    made = scene("refused-far", 1, SMALLEST, seed, networks=networks, masks=np.zeros((1, 1), bool))
    with_weights(made, ("hyper.-1", SMALLEST.attribute_width, None, scale))
    return only_symbols(replace(made, lanes=Lanes(0, 0, seed % 3)), features=np.array([[symbol]]))


@cache
def radius() -> int:
    """Returns the radius of the model of far's feature with the least scale. Values beyond it are escaped."""
    return int(tables().gauss.radius[8])


def beyond(more: int) -> Target:
    """Returns far's file of a feature beyond the radius. more: by this number."""
    return far(radius() + more)
