"""Exports a trained scene: integers for the encoder, or floats (SPEC.md Annex B)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..bitstream.attributes import KINDS, SCALINGS, Attributes
from ..bitstream.cameras import NamedCamera, camera_sections
from ..bitstream.chunks import chunk_ranges
from ..bitstream.codec import derive_steps
from ..bitstream.dimensions import Dimensions
from ..bitstream.header import Lanes, RenderInfo
from ..bitstream.limits import MAIN
from ..bitstream.networks import Layer
from ..bitstream.planes import PLANE_SYMBOL_MAX
from ..bitstream.positions import encode_positions
from ..bitstream.reconstruction import Reconstruction
from ..bitstream.scene import Scene
from ..bitstream.source import pad4
from ..bitstream.weights import emit_weights
from ..encoder.masks import mask_model
from ..encoder.positions import morton_order, position_model
from ..encoder.quantise import symbols
from ..encoder.sizes import CHUNK_SIZE, choose_lanes
from ..encoder.weights import exact_networks, weight_scales
from ..folder.uncompressed import Uncompressed
from ..photographs.photographs import PhotographSet
from ..rendering.camera import up_axis
from .rate_model.model import RateModel
from .rate_model.units import PLANE_SHIFT
from .rendering_networks import RenderNetworks
from .scaffold import Scaffold
from .stages.rate import Rate
from .start import lattice_positions


def render_info(scaffold: Scaffold, photographs: PhotographSet) -> RenderInfo:
    """SPEC 6.5 of a scene."""
    return RenderInfo(
        background=photographs.background,
        up_axis=up_axis([p.camera for p in photographs.train], photographs.points),
        near_plane=float(np.float32(scaffold.near * scaffold.units.length)),
        distance_unit=scaffold.units.length,
        low_pass=float(np.float32(scaffold.low_pass)),
        render_model=scaffold.networks.render_model,
    )


def uncompressed(scaffold: Scaffold, render: RenderInfo, cameras: Sequence[NamedCamera]) -> Uncompressed:
    """The scene as it is, in world units."""
    n, k = scaffold.count, scaffold.columns.offsets
    positions = scaffold.units.origin + scaffold.lattice * (scaffold.units.cell * scaffold.units.length)
    tables = {name: table.cpu().numpy().copy() for name, table in scaffold.tables.items()}
    values = Reconstruction(
        positions.astype(np.float32), tables["features"], tables["scalings"], tables["offsets"].reshape(n, k, 3)
    )
    return Uncompressed(values, np.ones((n, k), bool), scaffold.networks.layers(), render, tuple(cameras))


def _dimensions(model: RateModel, coding: dict[str, list[Layer]], rendering: RenderNetworks) -> Dimensions:
    """SPEC 5.3, of a model. coding: its networks."""
    hyper, sarm, carm = (
        tuple(len(bias) for _, bias in coding.get(name, [])[:-1]) for name in ("hyper", "sarm", "carm.1")
    )
    _, channels, plane_size, _ = model.latents.shape
    frequencies = coding["hyper"][0][0].shape[1] // 2 - channels
    columns = model.columns
    shown = rendering.width, rendering.view_inputs, rendering.colour_outputs
    return Dimensions(columns.offsets, columns.slices, channels, frequencies, plane_size, hyper, sarm, carm, *shown)


def weight_bytes(model: RateModel, rendering: RenderNetworks, layers: dict[str, list[Layer]], lanes: Lanes) -> int:
    """Bytes of the section of weights in mode 1 (SPEC 5.8), with its padding. layers: of the rendering networks.

    Raises networks.BoundError.
    """
    coding = model.networks()
    d = _dimensions(model, coding, rendering)
    networks = exact_networks({name: {**coding, **layers}[name] for name in d.network_shapes()})
    content = emit_weights(
        PLANE_SHIFT, np.zeros(d.carm_inputs, np.uint8), networks, weight_scales(networks), d, 1 << lanes.attribute
    )
    return pad4(len(content))


def position_bytes(lattice: NDArray[np.int64], lanes: Lanes) -> int:
    """Bytes of packed positions (SPEC 5.14), of distinct cells int64 [N, 3]."""
    half = lattice_positions(lattice)
    half = half[morton_order(half)]
    counts = [len(chunk) for chunk in chunk_ranges(len(half), CHUNK_SIZE)]
    parts = encode_positions(position_model(half, CHUNK_SIZE), half, counts, 1 << lanes.mask)
    return sum(len(content) for _, content in parts)


def coded_scene(scaffold: Scaffold, rate: Rate, render: RenderInfo, cameras: Sequence[NamedCamera]) -> Scene:
    """The scene of integers: steps follow from the networks, symbols from the steps.

    Anchors without a kept offset are left out. The rest is sorted along a Morton curve (B.1). Raises ValueError for
    values that cannot be written.
    """
    model, kept = rate.started(), rate.masks.decided().cpu().numpy()
    planes = model.symbols(None).detach().cpu().numpy()
    # SPEC B.5, "Static scenes"
    unit = float(scaffold.networks.get_buffer("feature_unit"))
    first, second, third = rate.base_step.tolist()
    base_step = (float(np.float32(unit * first)), second, third)
    rows = np.flatnonzero(kept.any(axis=1))
    half = lattice_positions(scaffold.lattice[rows])
    order = morton_order(half)
    rows, half = rows[order], half[order]
    count, masks = len(rows), kept[rows]
    networks = {**model.networks(), **scaffold.networks.layers()}
    d = _dimensions(model, networks, scaffold.networks)
    features, scalings = np.zeros((count, d.features), np.int32), np.zeros((count, SCALINGS), np.int32)
    offsets, steps = np.zeros((count, d.offset_count, 3), np.int32), np.zeros((count, len(KINDS)), np.uint8)
    scene = Scene(
        profile=MAIN,
        dimensions=d,
        chunk_size=CHUNK_SIZE,
        lanes=choose_lanes(count, 2.0 * d.attribute_width),
        base_step=base_step,
        grid=scaffold.units.grid,
        render=render,
        frame=rate.frame,
        plane_shift=PLANE_SHIFT if d.plane_channels else 0,
        carm_shift=np.zeros(d.carm_inputs, np.uint8),
        networks={name: networks[name] for name in d.network_shapes()},
        planes=np.clip(planes, -PLANE_SYMBOL_MAX, PLANE_SYMBOL_MAX).astype(np.int16),
        mask_model=mask_model(masks),
        positions=half,
        masks=masks,
        attributes=Attributes(features, scalings, offsets, steps),
        ancillary=camera_sections(cameras),
    )
    steps = derive_steps(scene)
    values = {name: scaffold.tables[name].cpu().numpy()[rows] for name in KINDS}
    values["features"] = values["features"] * np.float32(unit)
    values["offsets"] = np.where(masks[:, :, None], values["offsets"].reshape(count, d.offset_count, 3), np.float32(0))
    features, scalings, offsets = (symbols(values[kind], steps[:, i], base_step[i]) for i, kind in enumerate(KINDS))
    return replace(scene, attributes=Attributes(features, scalings, offsets, steps))
