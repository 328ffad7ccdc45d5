"""The encoder's choices (SPEC.md Annex B): any anchors can be written, and each choice has its stated property."""

from dataclasses import replace

import numpy as np
import pytest
from random_scenes import random_networks

from conformance.cases.scenes import TINY_DIMENSIONS
from conformance.manifest import VECTORS
from refcodec.bitstream import codec
from refcodec.bitstream import frame as frames
from refcodec.bitstream.context import contract, frame_coordinates, rescale
from refcodec.bitstream.header import PositionGrid
from refcodec.bitstream.limits import TINY
from refcodec.bitstream.positions import position_integers
from refcodec.bitstream.reconstruction import reconstruct, world_positions
from refcodec.bitstream.scene import Scene, take_anchors
from refcodec.bitstream.source import Piece
from refcodec.encoder import quantise
from refcodec.encoder.cloud import AnchorCloud
from refcodec.encoder.frame import choose_frame
from refcodec.encoder.layers import coarse_layers
from refcodec.encoder.masks import mask_model
from refcodec.encoder.positions import choose_grid, morton_order, pack_positions, to_fp16
from refcodec.encoder.sizes import choose_lanes, choose_plane_size


def cloud_of(positions: np.ndarray, rng: np.random.Generator, keep: float = 0.6) -> AnchorCloud:
    """A cloud of the tests' Tiny dimensions."""
    d, n = TINY_DIMENSIONS, len(positions)
    return AnchorCloud(
        positions.astype(np.float32),
        rng.normal(0, 4, (n, d.features)).astype(np.float32),
        rng.normal(-3, 1, (n, 6)).astype(np.float32),
        rng.normal(0, 1, (n, d.offset_count, 3)).astype(np.float32),
        rng.random((n, d.offset_count)) < keep,
    )


def quantised(cloud: AnchorCloud, rng: np.random.Generator, **options: object):
    d = TINY_DIMENSIONS
    grid = choose_grid(cloud.positions)
    settings = {
        "dimensions": d,
        "networks": random_networks(d, rng, 0.3),
        "frame": choose_frame(to_fp16(cloud.positions, grid)),
        "grid": grid,
        "planes": rng.integers(-3, 4, (5, d.plane_channels, d.plane_size, d.plane_size)).astype(np.int16),
        "plane_shift": 4,
        "carm_shift": np.zeros(d.carm_inputs, np.uint8),
        "base_step": (0.5, 0.0625, 0.25),
        "profile": TINY,
        **options,
    }
    return quantise.quantise(cloud, **settings)


def test_lattice_is_exact_within_2048_voxels():
    rng = np.random.default_rng(0)
    voxel = 3.0 / 1024
    lattice = rng.integers(-2000, 2001, (500, 3)) + np.array([12345, -70000, 8])
    grid = choose_grid((lattice * voxel).astype(np.float32), voxel)
    half = to_fp16((lattice * voxel).astype(np.float32), grid)
    assert 1 << 15 <= grid.scale_mantissa < 1 << 16
    assert np.array_equal(half.astype(np.float64), np.round(half.astype(np.float64)))
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    integers = np.array(grid.origin, dtype=np.int64) + grid.scale_mantissa * position_integers(half)
    assert np.array_equal(integers * 2.0 ** (grid.scale_exponent - 24), lattice * voxel)
    assert unit == voxel


@pytest.mark.parametrize("scale", [1e-6, 1.0, 3e5])
def test_grid_without_a_voxel_uses_the_range_of_fp16(scale):
    positions = (np.random.default_rng(1).uniform(-1, 1, (1000, 3)) * scale + 5 * scale).astype(np.float32)
    grid = choose_grid(positions)
    half = to_fp16(positions, grid).astype(np.float64)
    assert 500 < np.abs(half).max() < 2048
    assert not (half.astype(np.float16).view(np.uint16) == 0x8000).any()
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    world = half * unit + np.array([o * 2.0 ** (grid.scale_exponent - 24) for o in grid.origin])
    assert np.abs(world - positions).max() <= 0.5 * unit


@pytest.mark.parametrize("voxel", [2.0**-10, None])
def test_a_sky_sets_no_grid(voxel):
    """The bulk is as exact as without the few positions far out, on either side."""
    bulk = np.random.default_rng(2).integers(-900, 900, (500, 3)) * 2.0**-10 + 3
    positions = np.concatenate([bulk, [[40.0, 0.0, 3.0], [40.0, 9.0, 3.0]]]).astype(np.float32)
    grid = choose_grid(positions, voxel)
    unit = grid.scale_mantissa * 2.0**grid.scale_exponent
    origin = np.array(grid.origin) * 2.0 ** (grid.scale_exponent - 24)
    world = to_fp16(positions, grid).astype(np.float64) * unit + origin
    error = np.abs(world - positions).max(axis=1)
    assert error[:-2].max() <= (0 if voxel else 2.0**-10)
    assert error.max() < 0.02


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_positions_that_are_not_finite_are_refused(bad):
    positions = np.zeros((3, 3), np.float32)
    positions[1, 2] = bad
    with pytest.raises(ValueError, match="NaN or infinite"):
        choose_grid(positions)


def test_position_past_fp16_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        to_fp16(np.full((1, 3), 1e6, np.float32), PositionGrid((0, 0, 0), 32768, -15))


def assert_valid(frame: frames.Frame):
    """The frame keeps SPEC 6.7, and coordinates come out in range."""
    assert np.abs(frame.matrix).max() < frames.MATRIX_BOUND
    assert np.abs(frame.translation).max() < frames.TRANSLATION_BOUND
    assert frame.shift.min() >= 0
    assert frame.shift.max() <= frames.FRAME_SHIFT_MAX
    assert (frame.low < frame.high).all()
    assert (frame.low >= -frames.FRAME_RANGE_BOUND).all()
    assert (frame.high <= frames.FRAME_RANGE_BOUND).all()
    data = frames.emit_frame(frame)
    assert np.array_equal(frames.parse_frame(Piece(data, 0)).matrix, frame.matrix)


DEGENERATE = {
    "none": np.zeros((0, 3)),
    "one": np.array([[3.0, -4.0, 100.0]]),
    "two": np.array([[3.0, -4.0, 100.0], [3.0, -4.0, 101.0]]),
    "equal": np.full((50, 3), 7.25),
    "line": np.outer(np.linspace(-3, 1000, 200), [1.0, 2.0, -1.0]),
    "plane": np.stack([*np.random.default_rng(3).normal(0, 5, (2, 300)), np.full(300, 2.0)], axis=1),
    "tiny": np.random.default_rng(4).integers(-2, 3, (60, 3)) * 2.0**-24,
    "huge": np.random.default_rng(5).uniform(-65000, 65000, (60, 3)),
    "outlier": np.concatenate([np.random.default_rng(6).normal(0, 1, (500, 3)), [[60000.0, 0.0, 0.0]]]),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_every_set_has_a_frame(name):
    positions = DEGENERATE[name].astype(np.float16)
    frame = choose_frame(positions)
    assert_valid(frame)
    u = rescale(frame, contract(frame_coordinates(frame, position_integers(positions))))
    assert ((u >= 0) & (u <= 1 << 16)).all()


def test_frame_is_that_of_the_principal_axes():
    rng = np.random.default_rng(7)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    positions = (rng.normal(size=(20000, 3)) * [50, 20, 3] @ rotation.T + [100, -30, 8]).astype(np.float16)
    frame = choose_frame(positions)
    v = frame_coordinates(frame, position_integers(positions)) / (1 << 16)
    inner = np.abs(v).max(axis=1) < 3
    covariance = np.cov(v[inner].T)
    # The widest axis loses most to the cut at 95 %, so its deviation is a little short.
    assert np.allclose(np.diag(covariance), 1, atol=0.3)
    assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 0.05
    length = np.linalg.norm(frame.matrix / 2.0 ** frame.shift[:, None], axis=1)
    assert (np.diff(length) > 0).all()


def test_plane_size_and_lanes_stay_in_their_limits():
    sizes = [choose_plane_size(n) for n in (0, 1, 1000, 30000, 114000, 421600, 1 << 24)]
    assert sizes == sorted(sizes)
    assert sizes[0] >= 2
    assert sizes[-1] == sizes[-2] == 128
    for anchors in (0, 1, 5000, 1 << 20):
        lanes = choose_lanes(anchors, 200.0)
        assert 0 <= min(lanes.plane, lanes.mask, lanes.attribute) <= max(lanes.plane, lanes.mask, lanes.attribute) <= 6
    assert 4 << choose_lanes(1 << 20, 200.0).attribute <= 0.002 * 4096 * 200 / 8


def test_mask_model_counts():
    masks = np.array([[True, True], [True, False], [True, False], [False, True]])
    # Contexts: first offset; second after none; second after one.
    assert mask_model(masks).tolist() == [round(16384 * 3 / 4), 16383, round(16384 / 3)]
    assert mask_model(np.zeros((0, 2), bool)).tolist() == [8192] * 3
    assert mask_model(np.zeros((9, 1), bool)).tolist() == [1]


def test_carm_shifts_bring_symbols_into_range():
    features = np.array([[1023, -1024, 70000, 0], [-1023, 5, 9, 0]], np.int32)
    shifts = quantise.carm_shifts(features, 3)
    assert shifts.dtype == np.uint8
    assert (np.abs(features[:, :3]) >> shifts <= 1023).all()
    assert shifts.tolist() == [0, 1, 7]


@pytest.mark.parametrize("anchors", [0, 1, 300])
def test_a_quantised_cloud_survives_the_file(anchors):
    rng = np.random.default_rng(anchors)
    cloud = cloud_of(rng.normal(0, 10, (anchors, 3)), rng)
    scene = quantised(cloud, rng)
    data = codec.emit(scene)
    assert codec.emit(codec.parse(data).scene) == data
    kept = cloud.masks.any(axis=1)
    assert scene.anchor_count == kept.sum()
    if not anchors:
        return
    # Each value comes back within half a step, whatever the order.
    back = reconstruct(scene)
    order = np.lexsort(np.round(world_positions(scene), 2).T)
    wanted = np.lexsort(np.round(cloud.positions[kept], 2).T)
    step = 0.0625 * 2.0 ** ((scene.attributes.steps[:, 1].astype(float) - 32) / 8)
    gap = np.abs(np.sort(back.scalings[order][:, 0]) - np.sort(cloud.scalings[kept][wanted][:, 0]))
    assert (gap <= 0.51 * step.max()).all()


def test_anchors_follow_a_morton_curve_and_the_order_is_stable():
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], np.float16)
    shuffled = np.random.default_rng(0).permutation(8)
    assert np.array_equal(corners[shuffled][morton_order(corners[shuffled])], corners)
    assert morton_order(np.zeros((5, 3), np.float16)).tolist() == [0, 1, 2, 3, 4]


def test_values_that_no_symbol_can_hold_are_refused():
    rng = np.random.default_rng(2)
    cloud = cloud_of(rng.normal(0, 1, (4, 3)), rng, keep=1.0)
    features = cloud.features.copy()
    features[2, 1] = 1e9
    with pytest.raises(ValueError, match="steps from zero"):
        quantised(replace(cloud, features=features), rng)
    features[2, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        quantised(replace(cloud, features=features), rng)


def test_layers_show_the_whole_scene_first() -> None:
    """The anchors are the same. Those of layer 0 fill the first chunks, cover more than others, and leave no gaps."""
    scene = codec.parse((VECTORS / "valid" / "trained-snowmiku.c3gs").read_bytes()).scene
    layers = coarse_layers(scene)
    assert coarse_layers(take_anchors(scene, slice(0))).tolist() == []
    counts = np.bincount(layers)
    assert np.array_equal(np.cumsum(counts), [len(layers) // 4, len(layers)])
    again = codec.parse(codec.emit(pack_positions(scene, layers))).scene
    assert [len(chunk) for chunk in again.chunks] == counts.tolist()

    def rows(some: Scene, chosen: np.ndarray | slice) -> np.ndarray:
        return np.unique(np.concatenate([some.positions[chosen], some.attributes.features[chosen]], axis=1), axis=0)

    assert np.array_equal(rows(again, slice(None)), rows(scene, slice(None)))
    assert np.array_equal(rows(again, slice(counts[0])), rows(scene, layers == 0))
    area = np.exp(np.sort(reconstruct(scene).scalings[:, 3:], axis=1)[:, 1:].sum(axis=1)) * scene.masks.sum(axis=1)
    assert area[layers == 0].mean() > 2 * area[layers == 1].mean()
    first = np.flatnonzero(layers[morton_order(scene.positions)] == 0)
    assert np.diff(first, prepend=-1, append=len(layers)).max() < 24
