"""The large scenes that benchmarks code: trained symbols, repeated, with the sizes of a large scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.large import TRAINED, large, large_file, resized_planes, widened
from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.networks import IntNetwork, derive_layer
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


def test_same_planes_give_the_same_contexts(trained: Scene) -> None:
    """With planes of the trained size, the steps that networks and contexts give are those of the training."""
    scene, order = parse(large_file(trained, trained.anchor_count + 200)).scene, morton_order(trained.positions)
    assert np.array_equal(scene.planes, trained.planes)
    rows = np.concatenate([order, order[:200]])
    assert np.array_equal(scene.attributes.steps, trained.attributes.steps[rows])


def test_larger_planes_cost_about_the_same_bits(tmp_path: Path) -> None:
    """Planes of another size change the contexts by rounding alone."""
    found = large(TRAINED, 20_000, tmp_path)
    before, after = found.attribute_bits
    assert found.figures()["planes"] == [5, 8, 28]
    assert after == pytest.approx(before, rel=0.02)


def test_fewer_anchors_than_the_trained_scene(trained: Scene) -> None:
    scene = parse(large_file(trained, 300)).scene
    assert np.array_equal(scene.positions, trained.positions[morton_order(trained.positions)[:300]])


def test_a_file_is_made_once(tmp_path: Path) -> None:
    """It is found by what it was made from."""
    first = large(TRAINED, 300, tmp_path)
    first.path.write_bytes(first.path.read_bytes())
    made = first.path.stat().st_mtime_ns
    assert large(TRAINED, 300, tmp_path) == first
    assert first.path.stat().st_mtime_ns == made
    assert large(TRAINED.with_name("trained-caliterra.c3gs"), 300, tmp_path).path != first.path
    assert len(list(tmp_path.iterdir())) == 2


def test_widened_networks_have_the_same_outputs() -> None:
    generator = np.random.default_rng(4)
    shapes = ((7, 5), (6, 7), (3, 6))
    layers = [
        (generator.normal(0, 0.3, shape).astype(np.float32), generator.normal(0, 9, shape[0]).astype(np.float32))
        for shape in shapes
    ]
    wide = widened(layers, (20, 11))
    assert [weight.shape for weight, _ in wide] == [(20, 5), (11, 20), (3, 11)]
    # The new units compute what trained ones do.
    assert all(np.abs(weight).sum(axis=1).min() > 0 for weight, _ in wide)
    inputs = generator.integers(-1023, 1024, (50, 5))
    outputs = [IntNetwork([derive_layer(*layer) for layer in each])(inputs) for each in (layers, wide)]
    assert outputs[0].any()
    assert np.array_equal(*outputs)


def test_resized_planes() -> None:
    """Interpolation keeps a slope and the corners, across the quadrants of the finer plane."""
    ramp = np.arange(4)[:, None] * 30 + np.arange(4) * 90
    whole = np.arange(8)[:, None] * 30 + np.arange(8) * 90
    quadrants = [whole[:4, :4], whole[:4, 4:], whole[4:, :4], whole[4:, 4:]]
    planes = np.stack([ramp, *quadrants])[:, None].astype(np.int16)
    assert np.array_equal(resized_planes(planes, 4), planes)
    finer = resized_planes(planes, 10)
    assert finer.shape == (5, 1, 10, 10)
    assert np.array_equal(finer[0, 0], np.arange(10)[:, None] * 10 + np.arange(10) * 30)
    assert finer[1, 0, 0, 0] == 0
    assert finer[4, 0, -1, -1] == 7 * 120


def test_a_scene_without_planes_is_refused(trained: Scene) -> None:
    planeless = parse((TRAINED.parent / "context-planeless.c3gs").read_bytes()).scene
    with pytest.raises(ValueError, match="no planes"):
        large_file(planeless, 10)
