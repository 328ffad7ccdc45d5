"""Cases of clauses 5.12, 6.12 and 7.6: masks. Their substreams' faults are in entropy_substreams.py."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from refcodec.bitstream.dimensions import mask_contexts

from .book import Book
from .numbers import Numbers
from .samplers import drawn
from .scenes import TINY_DIMENSIONS


def add(book: Book) -> None:
    """Adds the vectors."""
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
