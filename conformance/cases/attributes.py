"""Cases of clauses 5.14, 6.13 and 7.7 to 7.10: hyperprior, steps, CARM and the stages of attributes.

The faults of their substreams are in entropy_substreams.py.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.scene import Scene

from .book import Book
from .numbers import Int64, Numbers
from .samplers import Sampler, sampled
from .scenes import constant, dyadic, networks, scene

# Four slices, with small offsets and networks.
SLICES = Dimensions(2, (3, 4, 2, 3), 1, 1, 3, (8,), (3,), (12,), 2)


def add(book: Book) -> None:
    """Adds the vectors."""
    none, inputs = np.zeros(SLICES.carm_inputs, np.int64), SLICES.carm_inputs
    book.valid(
        "carm",
        "slices that depend on each other",
        partial(_carm, "carm", none, 100),
        features="carm attributes",
        requirements="D7.9-1 D7.10-1 D7.7-1",
        flags="carm-ignored carm-slices stage-order",
    )
    book.valid(
        "carm-shifts",
        "inputs of CARM that are shifted, ties of either sign",
        partial(_carm, "carm-shifts", Numbers("carm").integers(1, 4, inputs), 600),
        features="carm",
        requirements="D7.9-1",
        flags="carm-rounding",
    )
    book.valid(
        "carm-largest-shift",
        "the largest carm_shift",
        partial(_carm, "carm-largest-shift", none + 16, 1 << 20),
        features="carm",
        requirements="D7.9-1 R6.8-1",
        flags="carm-rounding limit-off-by-one",
    )
    book.valid(
        "carm-clamp",
        "inputs of CARM beyond the largest activation",
        partial(_carm, "carm-clamp", none, 40000),
        features="carm",
        requirements="D7.9-1",
        flags="activation-clamp",
    )
    book.valid(
        "channel-order",
        "a mean and a scale of its own for each channel",
        _channels,
        features="attributes",
        requirements="D7.7-1 D7.10-1 D8.5-1",
        flags="channel-order stage-order",
    )
    book.valid(
        "steps",
        "step indices from one end of the table to the other, and beyond",
        _steps,
        features="steps",
        requirements="D7.8-1 D9.2-1 DA-1",
        flags="step-clamp step-kinds",
    )


def _carm(name: str, shift: Int64, spread: int) -> Scene:
    """Returns a scene whose slices depend on each other.

    shift: carm_shift, int64 [inputs]. spread: the largest mean, in sixteenths of a symbol.
    """
    numbers = Numbers(name)
    carm = {network: layers for network, layers in networks(SLICES, numbers).items() if network.startswith("carm")}
    for layers in carm.values():
        w, b = layers[-1]
        w[:] = dyadic(numbers.integers(-100, 100, *w.shape), 7)
        b[:] = dyadic(numbers.integers(-40, 40, len(b)), 1)
    mean = numbers.integers(-spread, spread, SLICES.attribute_width)
    hyper = constant(SLICES, numbers, mean, numbers.integers(-10, 20, SLICES.attribute_width))
    made = scene(name, 25, SLICES, networks={**hyper, **carm}, carm_shift=shift.astype(np.uint8))
    return sampled(made, Sampler(numbers, 30))


def _channels() -> Scene:
    numbers, channel = Numbers("channel-order"), np.arange(SLICES.attribute_width)
    found = constant(SLICES, numbers, 160 * channel - 1500, channel - 20)
    return sampled(scene("channel-order", 12, SLICES, networks=found), Sampler(numbers, 0))


def _steps() -> Scene:
    numbers = Numbers("steps")
    found = networks(SLICES, numbers)
    w, b = found["hyper"][-1]
    w[-3:] = dyadic(numbers.integers(-90, 90, 3, w.shape[1]), 3)
    b[-3:] = 0, 32, 63
    return sampled(scene("steps", 60, SLICES, networks=found), Sampler(numbers, 0))
