"""Anchors: units, visibility to a camera, growth."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from refcodec.photographs.photographs import PhotographSet
from refcodec.rendering.camera import Camera
from refcodec.train.scaffold import Scaffold
from refcodec.train.schedule import Clock
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.splat import draw
from refcodec.train.stage import Run
from refcodec.train.stages.growth import Growth
from refcodec.train.start import lattice_positions
from refcodec.train.trainer import Trainer
from refcodec.train.visible import visible, visible_torch


def beginning(photographs: PhotographSet, anchors: int) -> Scaffold:
    settings = varied(TrainSettings(), {"start.anchors": anchors, "start.behind": 1.0})
    return Scaffold(photographs, settings, torch.Generator().manual_seed(0))


def growth(scaffold: Scaffold, most: int, pixels: int = 10**6, views: int = 1000, **changes: Any) -> Growth:
    run, part = Run(), Growth()
    run.settings, run.scaffold, run.stages = varied(TrainSettings(), {"growth.most": most, **changes}), scaffold, []
    run.clock, run.random = Clock(run.settings.phases, run.settings.steps), torch.Generator().manual_seed(1)
    run.photographs, run.device = cast(Any, SimpleNamespace(pixels=pixels, train=[None] * views)), scaffold.device
    part.join(run)
    return part


def test_units(photographs: PhotographSet) -> None:
    scaffold, cells = beginning(photographs, 500), TrainSettings().start.cells
    units = scaffold.units
    camera = photographs.train[3].camera
    local = units.camera(camera)
    world = units.origin + scaffold.lattice * (units.cell * units.length)
    np.testing.assert_allclose(
        (world @ camera.rotation.T + camera.translation) / units.length,
        scaffold.position.double().numpy() @ local.rotation.T + local.translation,
        atol=1e-5,
    )
    # Anchors begin in the middle of voxels that have points, and fp16 holds them exactly.
    assert (scaffold.lattice % cells == 0).all()
    # Voxels begin elsewhere than where they were counted.
    assert 250 <= scaffold.count <= 550
    np.testing.assert_array_equal(lattice_positions(scaffold.lattice).astype(np.int64), scaffold.lattice)
    away = np.abs(photographs.points[:, None] - world[None]).max(axis=2).min(axis=0)
    assert away.max() <= units.cell * units.length * cells / 2 * (1 + 1e-6)


def test_visible_anchors_are_those_of_the_formula_in_torch() -> None:
    draw = torch.Generator().manual_seed(3)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=draw, dtype=torch.float64))[0].numpy()
    camera = Camera("", 200, 150, 210.0, 190.0, 90.0, 80.0, turn, np.array([0.3, -0.2, 4]))
    position = 6 * torch.randn(4000, 3, generator=draw)
    tables = {name: torch.randn(4000, columns, generator=draw) for name, columns in (("offsets", 30), ("scalings", 6))}
    tables["scalings"] -= 2
    seen, wanted = (f(position, tables, 1.5, camera, 0.1) for f in (visible, visible_torch))
    assert 400 < len(seen) < 3600
    assert seen.dtype == wanted.dtype
    # An anchor at the very edge may be on either side of it.
    assert len(set(seen.tolist()) ^ set(wanted.tolist())) <= 2


@pytest.mark.slow
def test_no_anchor_is_left_out_that_could_be_seen(photographs: PhotographSet, trained: Trainer) -> None:
    """The images of a training are those of all anchors; those behind the camera are left out."""
    scaffold = trained.scaffold
    for photograph in photographs.test:
        camera = scaffold.units.camera(photograph.camera)
        images = []
        for anchors in (scaffold.visible(camera), torch.arange(scaffold.count)):
            values = {kind: table[anchors] for kind, table in scaffold.tables.items()}
            _, gaussians, _ = scaffold.gaussians(anchors, camera, values, None)
            images.append(draw(gaussians, camera, trained.drawing)[0].detach())
        assert float((images[0] - images[1]).abs().max()) < 1e-3
    fresh = beginning(photographs, 500)
    # The camera looks the other way: no anchor is in front of it.
    turn = np.diag([-1.0, 1, -1])
    turned = replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation)
    assert len(fresh.visible(turned)) < 0.05 * fresh.count < 0.5 * len(fresh.visible(camera))
    share = fresh.views([camera, camera])
    assert set(torch.nonzero(share)[:, 0].tolist()) == set(fresh.visible(camera).tolist())
    assert float(share.mean()) == pytest.approx(1)


def test_growth(photographs: PhotographSet) -> None:
    scaffold = beginning(photographs, 300)
    before = {tuple(c) for c in scaffold.lattice.tolist()}
    # Anchor 5 asks for more around its offset 3, some cells away; anchor 7 is transparent.
    scaffold.tables["scalings"][5] = np.log(scaffold.units.cell * scaffold.units.length)
    scaffold.tables["offsets"][5, 9:12] = torch.tensor([40.0, 41.0, 43.0])
    part = growth(scaffold, 400)
    part.seen[:], part.opacity[:] = 30, 30
    part.opacity[7] = 0.0
    gone, feature = tuple(scaffold.lattice[7].tolist()), scaffold.tables["features"][5].clone()
    near = scaffold.lattice[5] + [40, 41, 43]
    # Which offsets grow is drawn by lot, too.
    for _ in range(8):
        part.gradient[5, 3], part.drawn[5, 3] = 20 * 0.01, 20
        part.grow()
        part.anchors_changed()
        if scaffold.count > len(before) - 1:
            break
    after = {tuple(c) for c in scaffold.lattice.tolist()}
    assert len(after) == scaffold.count
    assert gone not in after
    assert before - {gone} <= after
    new = sorted(after - before)
    assert 1 <= len(new) <= 3
    assert all(np.abs(np.array(c) - near).max() <= 2 for c in new)
    born = len(before) - 1
    assert torch.equal(scaffold.tables["features"][born], feature)
    assert (scaffold.tables["offsets"][born:] == 0).all()
    assert (scaffold.tables["masks"][born:] == TrainSettings().masks.start).all()
    for name, table in scaffold.tables.items():
        shape = (scaffold.count, {"features": 12, "offsets": 30, "scalings": 6, "masks": 10}[name])
        assert table.shape == scaffold.first[name].shape == scaffold.second[name].shape == shape


def test_growth_has_a_limit(photographs: PhotographSet) -> None:
    """Of anchors, by pixels and by photographs: more would overfit 18 small ones, or 15 larger ones."""
    scaffold = beginning(photographs, 300)
    count, least, each = scaffold.count, TrainSettings().growth.pixels, TrainSettings().growth.each
    scaffold.tables["offsets"].uniform_(-30, 30, generator=torch.Generator().manual_seed(2))
    for most, pixels, views, expected in (
        (10 * count, least * (count + 9) + 1, 1000, count + 9),
        (count + 17, 10**6, 1000, count + 17),
        (count - 5, 10**6, 1000, count + 17),
        (10**6, 10**9, count // each + 1, (count // each + 1) * each),
    ):
        part = growth(scaffold, most, pixels, views)
        part.gradient[:], part.drawn[:] = 1, 20
        part.grow()
        assert scaffold.count == expected


def test_growth_takes_its_time_from_the_phases(photographs: PhotographSet) -> None:
    """It grows every period while its phase lasts, its first and last step included."""
    part, times = growth(beginning(photographs, 100), 1, steps=1000, **{"growth.period": 10}), []
    part.grow = lambda: times.append(part.run.clock.done)  # type: ignore[method-assign]
    for part.run.clock.done in range(1, 1001):
        part.after_step()
    assert times == list(range(30, 401, 10))


def test_no_points(photographs: PhotographSet, small: TrainSettings) -> None:
    empty = replace(photographs, points=np.zeros((0, 3)), colours=np.zeros((0, 3), np.uint8))
    with pytest.raises(ValueError, match="no points"):
        Trainer(empty, small)
