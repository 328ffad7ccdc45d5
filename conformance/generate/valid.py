"""Valid files as the reference encoder writes them."""

from __future__ import annotations

from dataclasses import replace

from refcodec.quantise import position_model
from refcodec.scene import Lanes, Scene

from .numbers import Numbers
from .recipes import Book, Seen
from .scenes import lattice, packed_weights, scene


def add(book: Book) -> None:
    """Adds the vectors."""
    book.valid("plain", "a small file of profile Tiny", lambda: scene("plain"), features="substreams", requirements="D8.2-1")
    book.valid("empty", "no anchors", lambda: scene("empty", 0), features="container")

    def packed() -> Scene:
        where = lattice(Numbers("packed"), 40)
        return scene("packed", 40, positions=where, chunk_size=16, position_model=position_model(where, 16))

    book.valid(
        "packed-positions", "chunks of a lattice, packed", packed, features="packed-positions", requirements="D7.12-1",
        flags="tree-order-wrong",
    )  # fmt: skip
    book.valid(
        "packed-weights", "weights as integers", lambda: packed_weights(scene("packed-weights")), features="packed-weights",
        requirements="D7.13-1",
    )  # fmt: skip
    book.valid(
        "many-lanes", "more lanes than symbols", lambda: scene("many-lanes", 5, lanes=Lanes(5, 6, 8)), features="substreams",
        requirements="D8.3-1", flags="final-state-unchecked",
    )  # fmt: skip
    book.valid(
        "ancillary", "sections that no decoder knows", lambda: replace(scene("ancillary"), extensions=((1, 7, b""), (127, 255, b"x"))),
        features="container", requirements="D12.1-1",
    )  # fmt: skip
    camera = {
        "width": 64, "height": 48, "focal": [50.0, 50.0], "principal_point": [32.0, 24.0],
        "rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "translation": [0.0, 0.0, 0.0],
    }  # fmt: skip
    book.add("valid-camera-ahead", "Gaussians of a camera", lambda: Seen("valid/plain.c3gs", camera), features="cameras")
