"""Plain Gaussians: harmonics, PLY files, density control, training."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement
from torch import Tensor

from benchmarks.peers.density import Density
from benchmarks.peers.settings import DensitySettings, SplatSettings
from benchmarks.peers.splats import quality, read_ply, write_ply
from benchmarks.peers.trainer import NAMES, SplatTrainer
from refcodec.convert.harmonics import basis, colours
from refcodec.export.harmonics import ZERO, degree_of
from refcodec.photographs.photographs import PhotographSet
from refcodec.train.settings_file import varied
from refcodec.train.state import restore, save

Splats = dict[str, Tensor]

# --- harmonics --------------------------------------------------------------------------------------------------------


def test_known_values() -> None:
    """Along the axes most harmonics are 0 by symmetry. The others are those of tables of real spherical harmonics."""
    along = basis(torch.eye(3, dtype=torch.float64), 3).numpy()
    pi = math.pi
    one, two, two_zonal = math.sqrt(3 / (4 * pi)), math.sqrt(15 / (16 * pi)), math.sqrt(5 / (16 * pi))
    three, three_one, three_zonal = math.sqrt(35 / (32 * pi)), math.sqrt(21 / (32 * pi)), math.sqrt(7 / (16 * pi))
    x = {2: -one, 5: -two_zonal, 7: two, 12: three_one, 14: -three}
    y = {0: -one, 5: -two_zonal, 7: -two, 8: three, 10: three_one}
    z = {1: one, 5: 2 * two_zonal, 11: 2 * three_zonal}
    for row, values in zip(along, (x, y, z), strict=True):
        wanted = np.zeros(15)
        wanted[list(values)] = list(values.values())
        np.testing.assert_allclose(row, wanted, atol=1e-12)
    assert pytest.approx(1 / math.sqrt(4 * pi)) == ZERO


def test_they_are_orthonormal() -> None:
    """By a quadrature that is exact for these polynomials: Gauss's in the height, even steps around."""
    height, weight = np.polynomial.legendre.leggauss(8)
    turn = 2 * math.pi * np.arange(16) / 16
    flat = np.sqrt(1 - height**2)
    direction = [np.outer(flat, np.cos(turn)), np.outer(flat, np.sin(turn)), np.outer(height, np.ones(16))]
    values = basis(torch.from_numpy(np.stack([d.reshape(-1) for d in direction], axis=1)), 3).numpy()
    area = np.repeat(weight, 16) * 2 * math.pi / 16
    np.testing.assert_allclose(values.T @ (values * area[:, None]), np.eye(15), atol=1e-12)
    np.testing.assert_allclose(area @ values, np.zeros(15), atol=1e-12)


def test_gradients_of_colours(splats: Splats) -> None:
    """By the coefficients and by the means, against finite differences."""
    centre, degree = torch.tensor([5.0, -4.0, 6.0], dtype=torch.float64), degree_of(splats["rest"].shape[1])
    # Far from the cut at 0, where the colour has no derivative.
    inputs = [splats[name][:10].double().requires_grad_() for name in ("base", "rest", "mean")]

    def found(base: Tensor, rest: Tensor, mean: Tensor) -> Tensor:
        return colours(base + 20, rest, mean, centre, degree)

    assert torch.autograd.gradcheck(found, inputs)


def test_a_colour_is_not_negative() -> None:
    base = torch.tensor([[-10.0, 0.0, 1.0]])
    found = colours(base, torch.zeros(1, 0, 3), torch.zeros(1, 3), torch.ones(3), 0)
    assert found[0].tolist() == pytest.approx([0, 0.5, 0.5 + ZERO])


def test_other_numbers_of_harmonics_are_refused() -> None:
    with pytest.raises(ValueError, match="4 harmonics"):
        degree_of(4)


# --- PLY --------------------------------------------------------------------------------------------------------------


def test_a_file_comes_back(splats: Splats, tmp_path: Path) -> None:
    write_ply(splats, tmp_path / "a.ply")
    again = read_ply(tmp_path / "a.ply")
    assert set(again) == set(splats)
    for name, values in splats.items():
        assert torch.equal(again[name], values), name


def test_the_layout_is_that_of_3dgs(tmp_path: Path) -> None:
    """Channels of f_rest follow each other, and all properties have the order that 3DGS's own code writes."""
    rest = torch.arange(9.0).reshape(1, 3, 3)
    one = torch.zeros(1, 3)
    splats = {
        "mean": one,
        "base": one,
        "rest": rest,
        "opacity": one[:, 0],
        "scale": one,
        "quaternion": torch.ones(1, 4),
    }
    write_ply(splats, tmp_path / "a.ply")
    ply = PlyData.read(str(tmp_path / "a.ply"))
    names = [p.name for p in ply["vertex"].properties]
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:18] == [f"f_rest_{i}" for i in range(9)]
    assert names[18:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    row = ply["vertex"].data[0]
    assert [row[f"f_rest_{i}"] for i in range(9)] == [0, 3, 6, 1, 4, 7, 2, 5, 8]
    assert (ply.byte_order, ply.text) == ("<", False)


def test_properties_may_stand_in_any_order(splats: Splats, tmp_path: Path) -> None:
    write_ply(splats, tmp_path / "a.ply")
    table = PlyData.read(str(tmp_path / "a.ply"))["vertex"].data
    names = sorted(table.dtype.names, reverse=True)
    other = np.empty(len(table), [(name, "<f4") for name in names])
    for name in names:
        other[name] = table[name]
    PlyData([PlyElement.describe(other, "vertex")], byte_order="<").write(str(tmp_path / "b.ply"))
    again = read_ply(tmp_path / "b.ply")
    assert all(torch.equal(again[name], values) for name, values in splats.items())


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("x y z", "no property f_dc_0"),
        ("x f_rest_0", "has 1 coefficients"),
        ("f_rest_0 f_rest_1 f_rest_2", "has 3 coefficients"),
    ],
)
def test_other_files_are_refused(names: str, words: str, tmp_path: Path) -> None:
    table = np.zeros(2, [(name, "<f4") for name in names.split()])
    PlyData([PlyElement.describe(table, "vertex")]).write(str(tmp_path / "a.ply"))
    with pytest.raises(ValueError, match=words):
        read_ply(tmp_path / "a.ply")
    (tmp_path / "b.ply").write_bytes(b"no file of this kind")
    with pytest.raises(ValueError, match="not a readable PLY"):
        read_ply(tmp_path / "b.ply")


# --- density ----------------------------------------------------------------------------------------------------------


def _after(splats: Splats, settings: DensitySettings, gradient: Tensor, large: bool = False) -> Splats:
    density = Density(settings, 1.0, len(gradient))
    density.note(gradient, torch.ones(len(gradient)))
    change = density.change(splats, large, torch.Generator().manual_seed(1))
    return {name: change.values(name, table, settings.shrink) for name, table in splats.items()}


def _four() -> Splats:
    """Four Gaussians: one that is still, one small and one large that move, one that is transparent and moves."""
    scale = torch.log(torch.tensor([0.001, 0.001, 0.5, 0.5]))
    return {
        "mean": torch.arange(12.0).reshape(4, 3),
        "base": torch.eye(4)[:, :3],
        "rest": torch.zeros(4, 0, 3),
        "opacity": torch.tensor([0.0, 0.0, 0.0, -9.0]),
        "scale": scale[:, None].repeat(1, 3),
        "quaternion": torch.tensor([1.0, 0, 0, 0]).repeat(4, 1),
    }


def test_small_ones_are_cloned_and_large_ones_split() -> None:
    splats = _four()
    found = _after(splats, DensitySettings(most=100), torch.tensor([0.0, 1.0, 1.0, 1.0]))
    # The still one and the cloned one stay, then the copy, then the two children.
    assert torch.equal(found["mean"][:3], splats["mean"][[0, 1, 1]])
    assert found["opacity"].tolist() == [0, 0, 0, 0, 0]
    assert found["scale"][3:].exp().flatten().tolist() == pytest.approx([0.5 / 1.6] * 6)
    away = (found["mean"][3:] - splats["mean"][2]).norm(dim=1)
    assert (away > 0).all()
    assert (away < 5 * 0.5).all()


def test_children_are_drawn_from_their_parent() -> None:
    """Many children of a flat and turned Gaussian have its mean and its covariance."""
    n, turn = 4000, math.radians(30)
    lengths = torch.tensor([0.5, 0.2, 0.01])
    splats = {name: table[2:3].repeat(n, *[1] * (table.dim() - 1)) for name, table in _four().items()}
    splats["scale"] = torch.log(lengths).repeat(n, 1)
    # Around z, from x to y.
    splats["quaternion"] = torch.tensor([math.cos(turn / 2), 0, 0, math.sin(turn / 2)]).repeat(n, 1)
    moved = _after(splats, DensitySettings(most=10 * n), torch.ones(n))["mean"] - splats["mean"][0]
    assert len(moved) == 2 * n
    c, s = math.cos(turn), math.sin(turn)
    wanted = [
        [0.25 * c * c + 0.04 * s * s, 0.21 * c * s, 0],
        [0.21 * c * s, 0.25 * s * s + 0.04 * c * c, 0],
        [0, 0, 1e-4],
    ]
    found = np.cov(moved.double().numpy().T)
    np.testing.assert_allclose(found, wanted, atol=0.01)
    assert found[2, 2] == pytest.approx(1e-4, rel=0.1)
    assert moved.double().mean(dim=0).tolist() == pytest.approx([0, 0, 0], abs=0.03)


@pytest.mark.parametrize("most", [200, 201, 230, 1000])
def test_the_cap_holds(most: int, splats: Splats) -> None:
    """And there is room for all that it allows."""
    gradient = torch.rand(200, generator=torch.Generator().manual_seed(3)) + 1
    alive = int((torch.sigmoid(splats["opacity"]) >= 0.005).sum())
    found = _after(splats, DensitySettings(most=most), gradient)
    assert len(found["mean"]) == min(most, 2 * alive)


def test_those_of_the_largest_gradients_grow() -> None:
    splats = {name: table[1:2].repeat(5, *[1] * (table.dim() - 1)) for name, table in _four().items()}
    splats["mean"] = torch.arange(15.0).reshape(5, 3)
    found = _after(splats, DensitySettings(most=7), torch.tensor([3.0, 1, 5, 2, 4]))
    assert sorted(found["mean"][5:, 0].tolist()) == [6, 12]


def test_large_ones_are_pruned_after_a_reset() -> None:
    assert len(_after(_four(), DensitySettings(most=100), torch.zeros(4))["mean"]) == 3
    assert len(_after(_four(), DensitySettings(most=100), torch.zeros(4), large=True)["mean"]) == 2


# --- training ---------------------------------------------------------------------------------------------------------

SMALL = varied(
    SplatSettings(),
    {"steps": 60, "size": 60, "degree": 2, "density.most": 700, "density.period": 10, "density.reset_period": 25},
)


def test_a_training_learns_within_its_cap(photographs: PhotographSet) -> None:
    settings = varied(SMALL, {"density.reset_period": 1000})
    trainer = SplatTrainer(photographs, settings)
    before = quality(trainer.result(), photographs.test, trainer.view)["psnr"]
    counts = [trainer.count]
    assert trainer.run(lambda t: counts.append(t.count))
    assert counts[0] == 350
    assert max(counts) == 700
    assert quality(trainer.result(), photographs.test, trainer.view)["psnr"] > before + 3


def test_moments_follow_their_gaussians(photographs: PhotographSet) -> None:
    """After a change the optimiser holds a row for each Gaussian, and zeros for those that are new."""
    trainer = SplatTrainer(photographs, SMALL)
    for _ in range(9):
        trainer.step()
    before = {name: trainer.optimiser.state[trainer.splats[name]]["exp_avg"].clone() for name in NAMES}
    count = trainer.count
    trainer.step()
    assert trainer.count > count
    for name in NAMES:
        moment = trainer.optimiser.state[trainer.splats[name]]["exp_avg"]
        assert len(moment) == trainer.count
        assert moment.shape[1:] == before[name].shape[1:]
    new = trainer.optimiser.state[trainer.splats["mean"]]["exp_avg"]
    assert int((new == 0).all(dim=1).sum()) >= trainer.count - count


def test_an_interrupted_training_goes_on_as_if_it_had_not_been(photographs: PhotographSet, tmp_path: Path) -> None:
    """Bit for bit, through changes and resets, and degrees that begin on the way."""
    whole = SplatTrainer(photographs, SMALL)
    assert whole.run(lambda _: None)
    part = SplatTrainer(photographs, SMALL)
    for _ in range(37):
        part.step()
    save(part, tmp_path / "state")
    again = SplatTrainer(photographs, SMALL)
    restore(again, tmp_path / "state")
    assert again.done == 37
    assert again.run(lambda _: None)
    for name in NAMES:
        assert torch.equal(again.splats[name], whole.splats[name]), name


def test_another_training_is_not_resumed(photographs: PhotographSet, tmp_path: Path) -> None:
    save(SplatTrainer(photographs, SMALL), tmp_path / "state")
    other = SplatTrainer(photographs, varied(SMALL, {"density.most": 800}))
    with pytest.raises(ValueError, match=r"density.most is 700, not 800"):
        restore(other, tmp_path / "state")


def test_opacities_are_reset(photographs: PhotographSet) -> None:
    trainer = SplatTrainer(photographs, SMALL)
    highest = []
    for _ in range(26):
        trainer.step()
        highest.append(float(torch.sigmoid(trainer.splats["opacity"].detach()).max()))
    assert highest[23] > 0.1
    assert highest[24] == pytest.approx(0.01)
    assert all(one != two for one, two in pairwise(highest))
