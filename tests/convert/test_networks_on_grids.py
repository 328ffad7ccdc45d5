"""The rendering networks of a converted scene: on grids that are as coarse as the rounded features allow."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("scipy")

from family import LAYOUTS, Model  # noqa: E402
from random_scenes import random_scene  # noqa: E402

from refcodec.bitstream import codec  # noqa: E402
from refcodec.bitstream.cameras import cameras  # noqa: E402
from refcodec.bitstream.dimensions import RENDERING  # noqa: E402
from refcodec.bitstream.reconstruction import reconstruct  # noqa: E402
from refcodec.bitstream.scene import Scene  # noqa: E402
from refcodec.bitstream.weights import to_grid  # noqa: E402
from refcodec.convert.checkpoint import read_checkpoint  # noqa: E402
from refcodec.convert.networks import on_grids  # noqa: E402
from refcodec.encoder.cloud import AnchorCloud  # noqa: E402
from refcodec.encoder.quantise import order_anchors, packed, varying  # noqa: E402
from refcodec.encoder.weights import quantise_rendering  # noqa: E402
from refcodec.rendering.camera import Camera  # noqa: E402
from refcodec.rendering.gaussians import gaussians  # noqa: E402
from refcodec.rendering.view import View  # noqa: E402
from refcodec.train.fit import base_steps, fit  # noqa: E402
from refcodec.train.fit_input import Given  # noqa: E402
from refcodec.train.settings import FitSettings  # noqa: E402

torch.set_num_threads(1)

TRAINED = Path(__file__).resolve().parents[2] / "vectors" / "valid" / "trained-caliterra.c3gs"


def given(layout: str, folder: Path, count: int = 500) -> Given:
    """A converted model."""
    Model(LAYOUTS[layout], count).write(folder)
    plain = read_checkpoint(folder).scene
    v = plain.values
    cloud = AnchorCloud(v.positions, v.features, v.scalings, v.offsets, plain.masks)
    return Given(cloud, plain.voxel, None, plain.networks, plain.render, plain.cameras)


def fitted(source: Given, rate: float) -> Scene:
    return fit(source, FitSettings(steps=0, lambda_r=rate)).scene


def bits(scene: Scene, name: str) -> int:
    """Of the largest integer of a network."""
    grids = [to_grid(layer) for layer in scene.networks[name]]
    return max(int(np.abs(grid.weight).max()).bit_length() + 1 for grid in grids if grid)


@pytest.mark.parametrize("layout", ["hac", "scaffold, plain"])
def test_coarser_features_allow_coarser_grids(layout: str, tmp_path: Path) -> None:
    source = given(layout, tmp_path)
    sizes, before = [], None
    for rate in (0.0001, 0.004, 0.1):
        scene = fitted(source, rate)
        coarse = on_grids(scene, source.cloud)
        assert all(to_grid(layer) for name in RENDERING for layer in coarse.networks[name])
        lengths = [len(codec.emit(packed(each, None, None))) for each in (scene, coarse)]
        weights = sum(4 * (w.size + b.size) for name in RENDERING for w, b in scene.networks[name])
        # Of 32 bits each network keeps less than half.
        assert lengths[0] - lengths[1] > weights / 2
        sizes.append(sum(bits(coarse, name) for name in RENDERING))
        before = coarse
    assert sizes[0] > sizes[1] > sizes[2]
    # What is on a grid stays.
    assert before is not None
    again = on_grids(before, source.cloud)
    assert all(again.networks[name] is before.networks[name] for name in RENDERING)


def test_grids_change_less_than_rounded_features(tmp_path: Path) -> None:
    """From a camera that did not judge."""
    source = given("hac", tmp_path)
    scene = fitted(source, 0.004)
    coarse = on_grids(scene, source.cloud)
    values, camera = reconstruct(scene), Camera("", 8, 8, 8, 8, 4, 4, np.eye(3), np.array([3.0, -1.0, 14.0]))

    def opacities(features: np.ndarray, networks: dict) -> np.ndarray:
        g = gaussians(replace(values, features=features), scene.masks, networks, camera, scene.render.distance_unit)
        dense = np.zeros(scene.masks.shape)
        dense[g.anchor, g.offset] = g.opacity
        return dense

    # The model's anchors have places of their own, by which they are found.
    rows = np.lexsort(source.cloud.positions[source.cloud.masks.any(axis=1)].T)
    own = np.empty_like(values.features)
    own[np.lexsort(values.positions.T)] = source.cloud.features[source.cloud.masks.any(axis=1)][rows]
    true, rounded, both = (
        opacities(own, scene.networks),
        opacities(values.features, scene.networks),
        opacities(values.features, coarse.networks),
    )
    assert 0 < np.square(both - rounded).sum() < 0.2 * np.square(rounded - true).sum()


def test_exact_features_keep_exact_networks(tmp_path: Path) -> None:
    """Where rounding changes nothing, a grid may change nothing."""
    source = given("hac", tmp_path)
    scene = fitted(source, 0.004)
    cloud = replace(source.cloud, features=np.zeros_like(source.cloud.features))
    zeros = replace(scene.attributes, features=np.zeros_like(scene.attributes.features))
    exact = replace(scene, attributes=zeros)
    same = on_grids(exact, cloud)
    assert all(same.networks[name] is exact.networks[name] for name in RENDERING)


def test_what_is_on_a_grid_and_what_is_empty(tmp_path: Path) -> None:
    source = given("hac", tmp_path)
    scene = fitted(source, 0.004)
    gridded = replace(scene, networks=quantise_rendering(scene.networks, 12))
    assert on_grids(gridded, source.cloud).networks["colour"] is gridded.networks["colour"]
    none = replace(source, cloud=replace(source.cloud, masks=np.zeros_like(source.cloud.masks)))
    empty = fit(none, FitSettings(steps=0)).scene
    assert on_grids(empty, none.cloud) is empty


def test_networks_on_grids_and_the_lattice_stay() -> None:
    """A trained scene is fitted again. What is lost is lost to the steps of attributes."""
    scene = codec.parse(TRAINED.read_bytes()).scene
    cloud = AnchorCloud(*vars(reconstruct(scene)).values(), scene.masks)
    edge = scene.grid.scale_mantissa * 2.0**scene.grid.scale_exponent
    networks = {name: scene.networks[name] for name in RENDERING}
    source = Given(cloud, edge, None, networks, scene.render, cameras(scene.ancillary))
    fitted = fit(source, FitSettings(steps=0)).scene
    coded = on_grids(fitted, cloud)
    for name in RENDERING:
        assert all(to_grid(layer) for layer in coded.networks[name])
        assert all(np.array_equal(a[0], b[0]) for a, b in zip(coded.networks[name], scene.networks[name], strict=True))
    assert np.array_equal(coded.positions, np.rint(coded.positions))
    camera = View(scene).orbit(1)[0].resized(48, 36)
    right, made = (View(each).draw(camera).clip(0, 1) for each in (scene, coded))
    assert -10 * np.log10(np.mean((right - made) ** 2)) > 36


def test_features_that_are_constant_have_no_say_in_a_step() -> None:
    """A model may have more features than it uses, as the wider of its layers asks."""
    rng = np.random.default_rng(0)
    n = 50
    features = np.zeros((n, 9), np.float32)
    features[:, :3] = rng.normal(0, 0.3, (n, 3))
    none = np.zeros((n, 2, 3), np.float32)
    cloud = AnchorCloud(none[:, 0], features, np.zeros((n, 6), np.float32), none, np.ones((n, 2), bool))
    (narrow, wide) = (base_steps(c, FitSettings().scene)[0] for c in (replace(cloud, features=features[:, :3]), cloud))
    assert narrow == wide < 0.2
    assert varying(np.zeros(3)).tolist() == [0, 0, 0]


def test_networks_that_show_nothing() -> None:
    """A camera may see none of the Gaussians that judge the grids of networks."""
    scene = random_scene(5, 40)
    scene = replace(scene, masks=np.ones_like(scene.masks))
    networks = dict(scene.networks)
    (first, (last, end)) = networks["opacity"]
    networks["opacity"] = [first, (last * 0, end * 0 - 1)]
    dark = replace(scene, networks=networks)
    ordered, _ = order_anchors(AnchorCloud(*vars(reconstruct(dark)).values(), dark.masks), dark.grid)
    assert not len(gaussians(reconstruct(dark), dark.masks, dark.networks, View(dark).orbit(1)[0], 1.0).anchor)
    assert on_grids(dark, ordered).networks.keys() == dark.networks.keys()
