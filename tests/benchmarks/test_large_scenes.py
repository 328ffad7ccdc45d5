"""The large scenes that benchmarks code: trained symbols, repeated, with the sizes of a large scene."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.large import TRAINED, large_file
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.positions import PACKED
from refcodec.bitstream.scene import Scene
from refcodec.encoder.positions import morton_order
from refcodec.encoder.sizes import choose_width


@pytest.fixture(scope="module")
def trained() -> Scene:
    return parse(TRAINED.read_bytes()).scene


def test_copies(trained: Scene) -> None:
    """Each copy has the trained symbols, packed positions, and the networks of a large scene."""
    count, more = trained.anchor_count, 300
    data = large_file(trained, 2 * count + more)
    scene, order = parse(data).scene, morton_order(trained.positions)
    assert emit(scene) == data
    for first, rows in ((0, order), (count, order), (2 * count, order[:more])):
        own = slice(first, first + len(rows))
        assert np.array_equal(scene.positions[own], trained.positions[rows])
        assert np.array_equal(scene.masks[own], trained.masks[rows])
        for kind in ("features", "scalings", "offsets"):
            assert np.array_equal(getattr(scene.attributes, kind)[own], getattr(trained.attributes, kind)[rows])
    assert set(scene.position_forms or ()) == {PACKED}
    assert scene.dimensions.hyper_width == scene.dimensions.carm_width == (choose_width(421_600),)
