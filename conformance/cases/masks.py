"""Cases of clauses 5.11, 6.12 and 7.6: the mask model and masks.

The faults of their substreams are in entropy_substreams.py.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from refcodec.bitstream.dimensions import mask_contexts

from .book import Book
from .fault import Draw, Drawn, Edit, fault, one_field
from .numbers import Numbers
from .samplers import drawn
from .scenes import TINY_DIMENSIONS
from .target import Target
from .targets import five_cells, packed, plain


@fault("index.mask_model")
def mask_model(t: Target, number: int, value: int) -> Edit:
    """A frequency of the mask model is outside its limits."""
    return one_field(t, f"index.mask_model.frequency[{number}]", value)


@mask_model.drawn
def _(draw: Draw, t: Target) -> Drawn:
    contexts = mask_contexts(t.header.dimensions.offset_count)
    return t, draw.integer(0, contexts - 1), draw.choice([0, 1 << 14, 65535])


@fault("index.padding")
def padding(t: Target, at: int, value: int) -> Edit:
    """A byte of the padding after the mask model is not zero."""
    start = t.at("index.mask_model.padding")
    return Edit({start + at: bytes([value])}, start)


@padding.drawn
def _(draw: Draw, t: Target) -> Drawn:
    if "index.mask_model.padding" not in t.elements:
        return None
    return t, draw.integer(0, 1), draw.integer(1, 255)


def add(book: Book) -> None:
    """Adds the vectors."""
    for number, value in ((0, 0), (2, 1 << 14), (1, 65535)):
        title, make = f"a frequency of {value} in the mask model", mask_model.of(plain, number, value)
        book.add(f"invalid-mask-model-{value}", title, make, features="masks", flags="limit-off-by-one")
    for name, base, at in (("first", plain, 0), ("last", packed, 1), ("one-model", five_cells, 1)):
        title, make = f"padding of the mask model that is not zero: {name.replace('-', ' ')}", padding.of(base, at, 1)
        book.add(f"malformed-mask-model-padding-{name}", title, make, features="masks", flags="padding-unchecked")
    four = replace(TINY_DIMENSIONS, offset_count=4)
    for name, title, kept in (("none", "no offset is kept", False), ("all", "every offset is kept", True)):
        book.valid(
            f"masks-{name}",
            title,
            partial(drawn, f"masks-{kept:d}", 9, four, masks=np.full((9, 4), kept), chunk_size=5),
            features="masks attributes",
            requirements="D7.6-1 D7.10-1",
            flags="masked-offsets",
        )
    every = np.array([[n >> k & 1 for k in range(6)] for n in range(64)], dtype=bool)
    six = replace(TINY_DIMENSIONS, offset_count=6, slices=(1,), carm_width=())
    book.valid(
        "masks-every",
        "every mask of six offsets",
        partial(drawn, "masks-every", 64, six, masks=every),
        features="masks",
        requirements="D7.6-1 D7.10-1",
        flags="mask-context masked-offsets",
    )
    frequencies = [1, 2, (1 << 14) - 1, (1 << 14) - 2, 1 << 13]
    model = Numbers("mask-model-extreme").chosen(frequencies, mask_contexts(5)).astype(np.uint16)
    five = replace(TINY_DIMENSIONS, offset_count=5)
    book.valid(
        "mask-model-extreme",
        "the least and the largest frequencies of a mask bit",
        partial(drawn, "mask-model-extreme", 40, five, mask_model=model),
        features="masks",
        requirements="D7.6-1 R6.10-1 D8.2-1",
        flags="mask-context limit-off-by-one",
    )
    model = np.arange(1, mask_contexts(10) + 1).astype(np.uint16) * 280
    ten = replace(TINY_DIMENSIONS, offset_count=10, slices=(1,), carm_width=())
    book.valid(
        "mask-contexts",
        "a frequency of its own for each of 55 contexts",
        partial(drawn, "mask-contexts", 60, ten, mask_model=model),
        features="masks",
        requirements="D7.6-1",
        flags="mask-context",
    )
