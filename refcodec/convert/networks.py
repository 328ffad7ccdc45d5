"""Puts the rendering networks of a converted scene on grids, so that a file can pack them (SPEC.md B.5).

Training chooses grids by rate and distortion on photographs. Here there are none. Instead, the change of the Gaussians
by a grid is compared with that by the rounded features, which the rate of the fit determines.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.cameras import cameras
from ..bitstream.dimensions import RENDERING
from ..bitstream.networks import Layer
from ..bitstream.reconstruction import Reconstruction, reconstruct
from ..bitstream.scene import Scene
from ..bitstream.weights import to_grid
from ..encoder.cloud import AnchorCloud
from ..encoder.quantise import order_anchors
from ..encoder.weights import quantise_rendering
from ..rendering.camera import Camera, default_camera
from ..rendering.gaussians import gaussians

F64 = NDArray[np.float64]
Networks = Mapping[str, list[Layer]]

# Bits of the largest weight of a layer, ascending.
BITS = range(4, 17)
# The squared error that a grid may add, relative to that of the rounded features.
SHARE = 0.1
# Numbers of anchors and cameras for the comparison, and camera distances from the middle of the scene, in its radii.
ANCHORS, CAMERAS = 2048, 6
NEAREST, FARTHEST = 0.5, 3.0


def on_grids(scene: Scene, cloud: AnchorCloud) -> Scene:
    """Returns a fitted scene with each rendering network on the coarsest grid that hardly changes its Gaussians.

    cloud: the anchors before rounding. A network that is already on a grid, or that no grid suits, is not changed.
    """
    sample = _sample(scene, cloud)
    if sample is None:
        return scene
    networks = dict(scene.networks)
    shown = sample.shown(sample.coded, scene.networks)
    most = {name: SHARE * error for name, error in _errors(sample.shown(sample.given, scene.networks), shown).items()}
    left = [name for name in RENDERING if any(to_grid(layer) is None for layer in scene.networks[name])]
    for bits in BITS:
        coarser = quantise_rendering(scene.networks, bits)
        errors = _errors(shown, sample.shown(sample.coded, coarser)) if left else {}
        for name in [name for name in left if errors[name] <= most[name]]:
            networks[name] = coarser[name]
            left.remove(name)
    return replace(scene, networks=networks)


@dataclass(frozen=True, eq=False)
class _Sample:
    """Some anchors, with original and coded features, and the cameras that see them."""

    given: Reconstruction
    coded: Reconstruction
    masks: NDArray[np.bool_]
    cameras: list[Camera]
    distance_unit: float

    def shown(self, values: Reconstruction, networks: Networks) -> dict[str, F64]:
        """Returns the visible values of all offsets of the anchors, by name, with opacity 0 for missing ones."""
        shape = (len(self.cameras), *self.masks.shape)
        sizes = {"opacity": 1, "lengths": 3, "quaternion": 4, "colour": 3}
        outputs = {name: np.zeros((*shape, size)) for name, size in sizes.items()}
        for number, camera in enumerate(self.cameras):
            g = gaussians(values, self.masks, dict(networks), camera, self.distance_unit)
            for name, array in outputs.items():
                array[number, g.anchor, g.offset] = getattr(g, name).reshape(len(g.anchor), sizes[name])
        return outputs


def _sample(scene: Scene, cloud: AnchorCloud) -> _Sample | None:
    """Returns it for a scene, None for one without anchors."""
    coded, count = reconstruct(scene), scene.anchor_count
    if not count:
        return None
    rows = np.unique(np.linspace(0, count - 1, ANCHORS).astype(np.int64))
    ordered, _ = order_anchors(cloud, scene.grid)
    parts = coded.positions[rows], coded.scalings[rows], coded.offsets[rows]
    given, rounded = (
        Reconstruction(parts[0], features[rows], *parts[1:]) for features in (ordered.features, coded.features)
    )
    return _Sample(given, rounded, scene.masks[rows], _cameras(scene, coded.positions), scene.render.distance_unit)


def _cameras(scene: Scene, positions: NDArray[np.float32]) -> list[Camera]:
    """Returns up to CAMERAS stated cameras of a scene, and others around it."""
    wide = positions.astype(np.float64)
    middle = np.median(wide, axis=0)
    radius = max(float(np.quantile(np.linalg.norm(wide - middle, axis=1), 0.9)), 1e-6)
    random = np.random.default_rng(0)
    direction = random.normal(size=(CAMERAS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    away = radius * random.uniform(NEAREST, FARTHEST, (CAMERAS, 1))
    # Only the position of a camera matters.
    around = [Camera("", 1, 1, 1, 1, 0, 0, np.eye(3), -centre) for centre in middle + away * direction]
    return ([default_camera(camera) for camera in cameras(scene.ancillary)] + around)[:CAMERAS]


def _errors(wanted: dict[str, F64], actual: dict[str, F64]) -> dict[str, float]:
    """Returns the squared error of the outputs of each network, those of shape and colour weighted by opacity."""
    weight = np.minimum(wanted["opacity"], actual["opacity"])
    tiny = np.finfo(np.float32).tiny
    lengths = np.log(np.maximum(wanted["lengths"], tiny)) - np.log(np.maximum(actual["lengths"], tiny))
    # 8 (1 - cos(angle / 2)) is the square of a small angle.
    angle = 8 * (1 - np.abs((wanted["quaternion"] * actual["quaternion"]).sum(axis=-1, keepdims=True)))
    errors = (
        (wanted["opacity"] - actual["opacity"]) ** 2,
        weight * (lengths**2 + angle),
        weight * (wanted["colour"] - actual["colour"]) ** 2,
    )
    return {name: float(error.sum()) for name, error in zip(RENDERING, errors, strict=True)}
