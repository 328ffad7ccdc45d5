"""Cases of clauses 6.10 and 6.11: valid files with chunks of any size, and positions of either form."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from refcodec.bitstream import codec
from refcodec.bitstream.header import Lanes
from refcodec.bitstream.positions import PACKED, RAW
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from .book import Book
from .cells import cheap, cuboid, placed
from .numbers import Numbers
from .samplers import drawn
from .scenes import lattice, packed_weights
from .target import Target


def add(book: Book) -> None:
    """Adds the vectors."""
    _sizes(book)
    _forms(book)


def _sizes(book: Book) -> None:
    for size, anchors, title in (
        (1, 4, "chunks of one anchor"),
        (3, 7, "the last chunk is shorter than the others"),
        (4, 8, "all chunks are full"),
        (65536, 5, "a chunk that could hold more than there is"),
    ):
        book.valid(
            f"chunks-of-{size}",
            title,
            partial(drawn, f"chunks-{size}", anchors, chunk_size=size),
            features="chunks",
            requirements="D7.6-1 D7.10-1",
            flags="last-chunk",
        )
    rows: list[tuple[str, int, tuple[int, ...], str]] = [
        ("uneven", 4, (1, 4, 2, 4, 3), "chunks of one to four anchors, in no order"),
        ("rising", 8, (1, 2, 3, 8), "chunks that are longer one after the other"),
        ("each-anchor", 4096, (1,) * 7, "a chunk for each anchor, though one would hold all"),
        ("halves", 4096, (5, 5), "two chunks that are far from full"),
    ]
    for name, size, counts, title in rows:
        book.valid(
            f"chunks-{name}",
            title,
            partial(drawn, f"chunks-{name}", sum(counts), chunk_size=size, chunk_anchors=counts),
            features="chunks",
            requirements="R6.10-5 R6.10-6 R6.2-8 D7.10-1",
            flags="chunk-sizes last-chunk",
        )
    same: dict[str, tuple[int, ...]] = {"one": (9,), "three": (4, 1, 4), "nine": (1,) * 9}
    for name, counts in same.items():
        book.valid(
            f"chunks-same-scene-{name}",
            f"one scene that is coded in {name} chunk{'s' if len(counts) > 1 else ''}: the digest is the same",
            partial(_same, chunk_size=9, chunk_anchors=counts),
            features="chunks",
            requirements="D9.3-1 R6.10-6",
            flags="chunk-sizes",
        )
    book.valid(
        "cells-short-chunk",
        "a last chunk of one anchor, in far fewer bytes than the others",
        _short,
        features="packed-positions chunks",
        requirements="R6.10-5",
        flags="last-chunk chunk-sizes",
    )


def _same(**changes: Any) -> Scene:
    """Returns the same scene in given chunks. Its symbols do not depend on them."""
    return replace(drawn("chunks-same", 9), **changes)


def _short() -> Scene:
    made = cheap("outside-short", cuboid(5, 11, 11)[:601], chunk_size=600)
    assert Target(codec.emit(made)).header.chunk_count == 2
    return made


def _forms(book: Book) -> None:
    book.valid(
        "chunks-packed",
        "chunks of seven anchors, packed",
        _packed,
        features="chunks packed-positions packed-weights",
        requirements="D7.12-1 D7.13-1",
        flags="last-chunk",
    )
    for name, forms, title in (
        ("raw-by-choice", (RAW, PACKED, RAW, PACKED), "every second chunk raw, all of which could be packed"),
        ("all-raw-by-choice", (RAW,) * 4, "all chunks raw, and a model of positions that none of them uses"),
        ("packed-last", (RAW, RAW, RAW, PACKED), "the last chunk packed, the others raw"),
    ):
        book.valid(
            f"chunks-{name}",
            title,
            partial(_chosen, forms),
            features="chunks packed-positions raw-positions",
            requirements="R6.11-3 R6.11-4 D7.12-1",
            flags="raw-chunk canonical-form",
        )
    book.valid(
        "chunks-uneven-packed",
        "chunks of one to five anchors, packed but for one",
        _uneven_packed,
        features="chunks packed-positions",
        requirements="R6.10-5 R6.11-3 D7.12-1",
        flags="chunk-sizes raw-chunk",
    )


def _packed() -> Scene:
    where = lattice(Numbers("packed-chunks"), 50)
    made = drawn("packed-chunks", 50, positions=where, chunk_size=7, lanes=Lanes(0, 0, 0))
    return packed_weights(replace(made, position_model=position_model(where, 7)))


def _chosen(forms: tuple[int, ...]) -> Scene:
    where = lattice(Numbers("chunks-chosen"), 15)
    return placed("chunks-chosen", where, position_model(where, 4), chunk_size=4, position_forms=forms)


def _uneven_packed() -> Scene:
    counts, where = (2, 5, 1, 4, 3), lattice(Numbers("chunks-uneven-packed"), 15)
    made = drawn("chunks-uneven-packed", 15, positions=where, chunk_size=5, chunk_anchors=counts)
    return replace(made, position_model=position_model(where, 5), position_forms=(1, 1, 1, 0, 1))
