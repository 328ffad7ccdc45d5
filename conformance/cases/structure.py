"""Valid files: the header, the dimensions, chunks, lanes, profiles, and what a file is made of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from refcodec.bitstream.dimensions import Dimensions
from refcodec.bitstream.header import Lanes, PositionGrid, RenderInfo
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import position_model

from ..manifest import VECTORS
from .book import Book
from .numbers import Numbers
from .sampling import Sampler, sampled
from .scenes import LARGEST, MAIN_SMALLEST, SMALL, SMALLEST, lattice, packed_weights, scene, silent

SMALLEST_F32 = 2.0**-149
LARGEST_F32 = float(np.finfo(np.float32).max)


def add(book: Book) -> None:
    """Adds the vectors."""
    example = VECTORS / "tiny-example.c3gs"
    book.valid(
        "worked-example",
        "the example of Annex D",
        example.read_bytes,
        features="substream attributes",
        requirements="D7.3-1 D7.6-1 D7.10-1 D8.2-1",
    )
    book.valid(
        "plain",
        "a small file of profile Tiny",
        lambda: drawn("plain", 12),
        features="substream attributes carm planes masks",
        requirements="D7.2-2 D7.3-1 D7.5-1 D7.6-1 D7.7-1 D7.9-1 D7.10-1 D8.2-1 D8.5-1",
        flags="context-order carm-ignored stage-order",
    )
    _sizes(book)
    _dimensions(book)
    _chunks(book)
    _lanes(book)
    _header(book)
    _ancillary(book)
    _main(book)


def drawn(name: str, anchors: int, d: Dimensions = SMALL, **changes: Any) -> Scene:
    """A scene whose symbols are drawn from its models."""
    return sampled(scene(name, anchors, d, **changes), Sampler(Numbers(f"{name}/symbols")))


def sparse(made: Scene) -> Scene:
    """The scene with few weights that are not zero, packed: large networks in few bytes."""
    numbers = Numbers("sparse")
    kept = {
        name: [(np.where(numbers.integers(0, 15, *w.shape) == 0, w, 0).astype(np.float32), b) for w, b in layers]
        for name, layers in made.networks.items()
    }
    return packed_weights(replace(made, networks=kept))


def _sizes(book: Book) -> None:
    book.valid(
        "smallest",
        "one anchor, and every dimension as small as it can be",
        lambda: drawn("smallest", 1, SMALLEST),
        features="dimensions",
        requirements="D7.10-1",
    )

    def largest() -> Scene:
        made = sparse(scene("largest", 2, LARGEST, lanes=Lanes(3, 1, 6)))
        flat = replace(
            made, networks={**made.networks, "sarm": silent(made.networks["sarm"])}, planes=np.zeros_like(made.planes)
        )
        return sampled(packed_weights(flat), Sampler(Numbers("largest/symbols")), planes=False)

    book.valid(
        "largest",
        "every dimension of Tiny as large as it can be",
        largest,
        features="dimensions packed-weights",
        requirements="D7.2-2 D7.5-1",
        flags="buffer-too-small",
    )
    book.valid(
        "empty",
        "no anchors, and no chunks",
        lambda: scene("empty", 0),
        features="empty",
        requirements="D7.3-1",
        flags="empty-refused",
    )

    def empty_packed() -> Scene:
        made = scene("empty-packed", 0)
        return packed_weights(replace(made, position_model=position_model(made.positions, 4096)))

    book.valid(
        "empty-packed",
        "no anchors, in mode 1 of positions and weights",
        empty_packed,
        features="empty packed-positions packed-weights",
        requirements="D7.13-1",
        flags="empty-refused",
    )


def _dimensions(book: Book) -> None:
    """Each dimension at its least and its largest, the others as usual."""
    bounds: dict[str, list[Any]] = {
        "offset_count": [1, 10],
        "plane_channels": [1, 8],
        "plane_size": [2, 3, 32],
        "render_width": [1, 64],
        "hyper_width": [(64,), (5, 64)],
        "sarm_width": [(1,), (16, 1)],
        "carm_width": [(1,), (4, 64)],
        "slices": [(16,), (1, 1), (1, 16), (2, 1, 3), (3, 1, 2, 1)],
    }
    for name, values in bounds.items():
        for value in values:
            d = replace(SMALL, **{name: value})
            if len(d.slices) == 1:
                d = replace(d, carm_width=())
            text = "-".join(map(str, value)) if isinstance(value, tuple) else str(value)
            label = f"{name.replace('_', '-')}-{text}"

            def make(label: str = label, d: Dimensions = d) -> Scene:
                return drawn(f"dimension-{label}", 5, d)

            more = {
                "offset_count": "D7.6-1",
                "plane_size": "D7.3-1 D7.3-2 D7.5.4-1",
                "slices": "D7.9-1 D7.10-1",
                "carm_width": "D7.9-1",
            }.get(name, "D7.2-2")
            flags = {"offset_count": "mask-context", "plane_size": "wavefront-order", "slices": "carm-slices"}.get(
                name, ""
            )
            book.valid(
                f"dimension-{label}", f"{name} {text}", make, features="dimensions", requirements=more, flags=flags
            )


def _chunks(book: Book) -> None:
    for size, anchors, text in (
        (1, 4, "chunks of one anchor"),
        (3, 7, "the last chunk is shorter than the others"),
        (4, 8, "all chunks are full"),
        (65536, 5, "a chunk that could hold more than there is"),
    ):

        def make(size: int = size, anchors: int = anchors) -> Scene:
            return drawn(f"chunks-{size}", anchors, chunk_size=size)

        book.valid(
            f"chunks-of-{size}", text, make, features="chunks", requirements="D7.6-1 D7.10-1", flags="last-chunk"
        )

    def crowded() -> Scene:
        where = lattice(Numbers("packed-chunks"), 50)
        made = drawn("packed-chunks", 50, positions=where, chunk_size=7, lanes=Lanes(0, 0, 0))
        return packed_weights(replace(made, position_model=position_model(where, 7)))

    book.valid(
        "chunks-packed",
        "chunks of seven anchors, packed",
        crowded,
        features="chunks packed-positions packed-weights",
        requirements="D7.12-1 D7.13-1",
        flags="last-chunk",
    )


def _lanes(book: Book) -> None:
    for part in ("plane", "mask", "attribute"):
        for log2 in (0, 3, 8):

            def make(part: str = part, log2: int = log2) -> Scene:
                return drawn(f"lanes-{part}-{log2}", 21, lanes=replace(Lanes(1, 2, 1), **{part: log2}), chunk_size=16)

            text = f"{1 << log2} lanes of each substream of {part}s"
            book.valid(
                f"lanes-{part}-{log2}",
                text,
                make,
                features="lanes substream",
                requirements="D8.2-1 D8.3-1",
                flags="lane-order idle-lanes group-continues",
            )

    def positions() -> Scene:
        where = lattice(Numbers("lanes-positions"), 30)
        made = drawn("lanes-positions", 30, positions=where, lanes=Lanes(0, 3, 0))
        return replace(made, position_model=position_model(where, 4096))

    book.valid(
        "lanes-positions",
        "substreams of positions have the lanes of masks",
        positions,
        features="lanes packed-positions",
        requirements="D8.3-1 D7.12-1",
        flags="lanes-of-another-part",
    )
    book.valid(
        "lanes-weights",
        "the substream of weights has the lanes of attributes",
        lambda: packed_weights(drawn("lanes-weights", 3, lanes=Lanes(0, 1, 3))),
        features="lanes packed-weights",
        requirements="D8.3-1 D7.13-1",
        flags="lanes-of-another-part",
    )


def _header(book: Book) -> None:
    info = RenderInfo()
    extremes = {
        "least": RenderInfo(
            (0, 0, 0),
            0,
            SMALLEST_F32,
            SMALLEST_F32,
            SMALLEST_F32,
            0.0,
            1,
            1,
            (SMALLEST_F32, SMALLEST_F32),
            (0.0, 0.0, 0.0, SMALLEST_F32),
            (-LARGEST_F32,) * 3,
        ),
        "largest": RenderInfo(
            (255, 255, 255),
            5,
            LARGEST_F32,
            LARGEST_F32,
            1.0,
            LARGEST_F32,
            65535,
            65535,
            (LARGEST_F32, LARGEST_F32),
            (LARGEST_F32,) * 4,
            (LARGEST_F32,) * 3,
        ),
        "negative-zeros": replace(
            info, low_pass=-0.0, camera_rotation=(-0.0, 1.0, -0.0, 0.0), camera_translation=(-0.0,) * 3
        ),
    }
    for name, render in extremes.items():

        def make(render: RenderInfo = render) -> Scene:
            return scene("render-info", 2, SMALLEST, render=render)

        book.valid(
            f"render-info-{name}",
            f"render information, {name.replace('-', ' ')}",
            make,
            features="render-info",
            requirements="R6.5-1",
            flags="limit-off-by-one",
        )
    grids = {
        "least": PositionGrid((1 - (1 << 62),) * 3, 1, -60),
        "largest": PositionGrid(((1 << 62) - 1,) * 3, 65535, 60),
        "ties": PositionGrid(((1 << 24) + 1, (1 << 24) + 3, -(1 << 24) - 1), 1, 0),
        "more-ties": PositionGrid(((1 << 25) - 1, -(1 << 25) + 1, -(1 << 24) - 3), 3, 5),
        "cancelled": PositionGrid((-(7 << 24), 5, 0), 7, -24),
    }
    for name, grid in grids.items():

        def grid_make(grid: PositionGrid = grid) -> Scene:
            bits = np.array(
                [[0, 1, 2], [0x8001, 0x3C00, 0xBC00], [0x7BFF, 0xFBFF, 0], [3, 5, 0x8007], [0x3C00, 0, 0x0400]],
                np.uint16,
            )
            return scene("position-grid", 5, SMALLEST, grid=grid, positions=bits.view(np.float16))

        book.valid(
            f"position-grid-{name}",
            f"a position grid: {name.replace('-', ' ')}",
            grid_make,
            features="position-grid reconstruction",
            requirements="R6.4-1 D9.1-1 D7.4-1",
            flags="limit-off-by-one world-rounding",
        )


def _ancillary(book: Book) -> None:
    for name, text, sections in (
        (
            "ends",
            "the least and the largest ancillary types, empty and not, with modes that mean nothing",
            ((1, 255, b""), (0x3F, 1, b"?"), (0x40, 2, b""), (0x7F, 254, b"last")),
        ),
        ("all", "all 127 ancillary types", tuple((kind, kind, bytes([kind])) for kind in range(1, 128))),
    ):

        def make(sections: tuple[tuple[int, int, bytes], ...] = sections) -> Scene:
            return replace(drawn("ancillary", 2, SMALLEST), extensions=sections)

        book.valid(
            f"ancillary-{name}",
            text,
            make,
            features="ancillary directory",
            requirements="D12.1-1 R6.6-2 R6.6-6",
            flags="ancillary-refused",
        )


def _main(book: Book) -> None:
    book.valid(
        "main",
        "a small file of profile Main, in two chunks, positions and weights raw",
        lambda: drawn("main", 258, MAIN_SMALLEST, chunk_size=256),
        features="main chunks",
        requirements="R11.1-2 R11.1-3 D7.9-1 D7.10-1",
        flags="main-carm",
    )

    def packed() -> Scene:
        where = lattice(Numbers("main-packed"), 300)
        d = replace(MAIN_SMALLEST, plane_size=9, hyper_width=(20,), carm_width=(24,))
        made = sparse(scene("main-packed", 300, d, positions=where, chunk_size=256, lanes=Lanes(2, 3, 4)))
        return replace(
            sampled(made, Sampler(Numbers("main-packed/symbols"))), position_model=position_model(where, 256)
        )

    book.valid(
        "main-packed",
        "a file of profile Main in mode 1",
        packed,
        features="main packed-positions packed-weights chunks",
        requirements="D7.12-1 D7.13-1 D7.9-1",
        flags="main-carm",
    )

    def wide() -> Scene:
        d = replace(MAIN_SMALLEST, plane_size=3, hyper_width=(128,), carm_width=(128,))
        return sampled(sparse(scene("main-wide", 5, d, lanes=Lanes(3, 1, 6))), Sampler(Numbers("main-wide/symbols")))

    book.valid(
        "main-wide",
        "the widest networks of Main",
        wide,
        features="main dimensions packed-weights",
        requirements="R11.1-2 D7.2-2",
        flags="buffer-too-small",
    )
    book.valid(
        "main-empty",
        "no anchors in Main",
        lambda: sparse(scene("main-empty", 0, replace(MAIN_SMALLEST, plane_size=4))),
        features="main empty packed-weights",
        requirements="R11.2-2",
    )

    def planes() -> Scene:
        made = sparse(scene("main-planes", 3, replace(MAIN_SMALLEST, plane_size=129), lanes=Lanes(6, 0, 6)))
        quiet = silent(made.networks["sarm"])
        # A scale so small that a symbol of 0 costs next to nothing.
        quiet[-1][1][:] = [0, -40]
        flat = np.zeros_like(made.planes)
        numbers = Numbers("main-planes/symbols")
        for at in numbers.integers(0, flat.size - 1, 60).tolist():
            flat.reshape(-1)[at] = numbers.integer(-2, 2)
        found = packed_weights(replace(made, networks={**made.networks, "sarm": quiet}, planes=flat))
        return sampled(found, Sampler(numbers), planes=False)

    book.valid(
        "main-level-2",
        "planes that only level 2 allows",
        planes,
        features="main planes",
        requirements="R11.2-1 R11.2-3 D7.3-1 D7.3-2",
        flags="level-limits",
        seconds=60,
    )
