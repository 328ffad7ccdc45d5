"""Training: gradients against autograd, units, growth, the rate against the coder's, and whole trainings of seconds."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import refcodec.train.trainer as trainer_module
from benchmarks.ideal import attribute_code_length, plane_code_length
from refcodec.bitstream.codec import emit, parse, parse_container
from refcodec.bitstream.reconstruction import world_positions
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import to_grid
from refcodec.cli.main import main
from refcodec.encoder.quantise import packed
from refcodec.folder.uncompressed import Uncompressed, read_uncompressed
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.render.view import View
from refcodec.train.adam import adam_rows, gather_rows
from refcodec.train.command import report, state_path
from refcodec.train.losses import Photometric
from refcodec.train.rate import HYPERPRIORS, WIDTH, Contexts, LearnedRate
from refcodec.train.scaffold import COLUMNS, OFFSETS, START_EDGE, Scaffold, lattice_positions
from refcodec.train.spawn import Spawn
from refcodec.train.splat import draw
from refcodec.train.state import restore, save
from refcodec.train.trainer import Trainer, TrainSettings

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "photographs"
SMALL = TrainSettings(rate=0.004, steps=160, anchors=800, most_anchors=900)


@pytest.fixture(scope="module")
def photographs() -> PhotographSet:
    return read_photographs(EXAMPLES / "caliterra", (100, 75))


@pytest.fixture(scope="module")
def trained(photographs: PhotographSet) -> Trainer:
    trainer = Trainer(photographs, SMALL)
    assert trainer.run(lambda _: None)
    return trainer


def coded(trainer: Trainer) -> bytes:
    scene = trainer.result()
    assert isinstance(scene, Scene)
    return emit(scene)


def test_the_text_has_these_constants() -> None:
    """SPEC B.8's table and prose."""
    text = (Path(__file__).resolve().parents[2] / "SPEC.md").read_text()
    section = text.split("### B.8 Training")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.+?`(?:, `.+?`)*) \| (.+?) \|", section, re.MULTILINE)
    names = [name for cell, _ in rows for name in re.findall(r"`(\w+)`", cell)]
    assert len(names) == 15
    for cell, value in rows:
        stated = eval(value, {})
        found = [getattr(trainer_module, name) for name in re.findall(r"`(\w+)`", cell)]
        assert (tuple(found) if len(found) > 1 else found[0]) == stated
    assert TrainSettings().plane_period == 4
    assert "every fourth step" in section
    tried = re.search(
        r"of (\d+) to (\d+) bits for the largest weight .* of (\d+) to (\d+) bits less than the integers", section
    )
    assert tried is not None
    assert [(c[0], c[-1]) for c in (trainer_module.RENDER_BITS, trainer_module.COARSER)] == [
        (int(tried[1]), int(tried[2])),
        (int(tried[3]), int(tried[4])),
    ]
    assert TrainSettings().epsilon == 0.01


# --- gradients --------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 1 << 20), anchors=st.integers(1, 20), share=st.floats(0, 1))
def test_spawn_is_the_formula_of_14_3_with_its_gradient(seed: int, anchors: int, share: float) -> None:
    draw = torch.Generator().manual_seed(seed)
    position = torch.randn(anchors, 3, generator=draw)
    given_values = [torch.randn(anchors, width, generator=draw).requires_grad_() for width in (30, 6, 70, 30)]
    chosen = torch.nonzero(torch.rand(anchors * OFFSETS, generator=draw) < share)[:, 0]
    made = Spawn.apply(chosen, OFFSETS, position, *given_values)
    weights = [torch.randn(v.shape, generator=draw) for v in made]
    sum((v * w).sum() for v, w in zip(made, weights, strict=True)).backward()
    exact = [v.detach().double().requires_grad_() for v in given_values]
    offsets, scalings, covariance, colour = exact
    anchor = chosen // OFFSETS
    shape = covariance.reshape(-1, 7)[chosen]
    expected = (
        position.double()[anchor] + offsets.reshape(-1, 3)[chosen] * torch.exp(scalings[anchor, :3]),
        shape[:, 3:],
        torch.exp(scalings[anchor, 3:]) * torch.sigmoid(shape[:, :3]),
        torch.sigmoid(colour.reshape(-1, 3)[chosen]),
    )
    for a, b in zip(made, expected, strict=True):
        np.testing.assert_allclose(a.detach(), b.detach(), rtol=1e-5, atol=1e-5)
    sum((v * w.double()).sum() for v, w in zip(expected, weights, strict=True)).backward()
    for a, b in zip(given_values, exact, strict=True):
        np.testing.assert_allclose(a.grad, b.grad, rtol=1e-4, atol=1e-4)


def test_photometric_gradient() -> None:
    draw = torch.Generator().manual_seed(0)
    image = torch.rand(12, 15, 3, generator=draw).requires_grad_()
    photograph = torch.rand(12, 15, 3, generator=draw)
    Photometric.apply(image, photograph).backward()
    gradient, step = image.grad, 1e-3
    assert gradient is not None
    direction = torch.randn(image.shape, generator=draw)
    # No pixel's L1 may change its sign between the two ends.
    direction[(image.detach() - photograph).abs() < 5 * step] = 0
    ends = [float(Photometric.apply((image + sign * step * direction).detach(), photograph)) for sign in (-1, 1)]
    assert float((gradient * direction).sum()) == pytest.approx((ends[1] - ends[0]) / (2 * step), rel=2e-3)


def test_adam_is_torchs_where_every_row_is_touched() -> None:
    draw = torch.Generator().manual_seed(1)
    table = torch.randn(40, 7, generator=draw)
    expected = table.clone().requires_grad_()
    optimiser = torch.optim.Adam([expected], lr=0.01, eps=1e-15)
    first, second = torch.zeros(40, 7), torch.zeros(40, 7)
    for step in range(1, 30):
        gradient = torch.randn(40, 7, generator=draw)
        expected.grad = gradient.clone()
        optimiser.step()
        order = torch.randperm(40, generator=draw)
        adam_rows(
            table.numpy(),
            first.numpy(),
            second.numpy(),
            step,
            order.numpy(),
            gradient[order].contiguous().numpy(),
            np.float32(0.01),
        )
    np.testing.assert_allclose(table, expected.detach(), rtol=1e-4, atol=1e-5)


@given(st.lists(st.integers(0, 9), unique=True), st.lists(st.integers(0, 9), unique=True))
def test_rows_of_two_lists_are_added_once(one: list[int], two: list[int]) -> None:
    place, found, total = np.full(10, -1), np.zeros(10, np.int64), np.full((10, 2), 99, np.float32)
    count = 0
    expected = np.zeros((10, 2), np.float32)
    for rows, value in ((one, 1), (two, 10)):
        gradient = (value * np.arange(1, 2 * len(rows) + 1)).reshape(-1, 2).astype(np.float32)
        expected[rows] += gradient
        count = gather_rows(np.array(rows, np.int64), gradient, total, place, found, count)
    assert sorted(found[:count]) == sorted({*one, *two})
    np.testing.assert_array_equal(total[:count], expected[found[:count]])


# --- anchors ----------------------------------------------------------------------------------------------------------


def times(photographs: PhotographSet, factor: float) -> PhotographSet:
    """The same scene in another unit."""

    def moved(group):
        return tuple(
            replace(p, camera=replace(p.camera, translation=p.camera.translation * factor), load=lambda p=p: p.image)
            for p in group
        )

    return replace(
        photographs, train=moved(photographs.train), test=moved(photographs.test), points=photographs.points * factor
    )


def test_units(photographs: PhotographSet) -> None:
    scaffold = Scaffold(photographs, 500, torch.Generator().manual_seed(0))
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
    assert (scaffold.lattice % START_EDGE == 0).all()
    # Voxels begin elsewhere than where they were counted.
    assert 250 <= scaffold.count <= 550
    np.testing.assert_array_equal(lattice_positions(scaffold.lattice).astype(np.int64), scaffold.lattice)
    away = np.abs(photographs.points[:, None] - world[None]).max(axis=2).min(axis=0)
    assert away.max() <= units.cell * units.length * START_EDGE / 2 * (1 + 1e-6)


def test_no_anchor_is_left_out_that_could_be_seen(photographs: PhotographSet, trained: Trainer) -> None:
    """The images of a training are those of all anchors; those behind the camera are left out."""
    scene = trained.result()
    assert isinstance(scene, Scene)
    scaffold = trained.scaffold
    for photograph in photographs.test:
        camera = scaffold.units.camera(photograph.camera)
        rows = scaffold.visible(camera)
        images = []
        for anchors in (rows, torch.arange(scaffold.count)):
            values = [scaffold.tables[kind][anchors] for kind in ("features", "offsets", "scalings")]
            _, gaussians, _ = scaffold.gaussians(anchors, camera, *values, None)
            images.append(draw(*gaussians, camera, trained.rasterising)[0].detach())
        assert float((images[0] - images[1]).abs().max()) < 1e-3
    fresh = Scaffold(photographs, 500, torch.Generator().manual_seed(0))
    # The camera looks the other way: no anchor is in front of it.
    turned = replace(
        camera,
        rotation=np.diag([-1.0, 1, -1]) @ camera.rotation,
        translation=np.diag([-1.0, 1, -1]) @ camera.translation,
    )
    assert len(fresh.visible(turned)) < 0.05 * fresh.count < 0.5 * len(fresh.visible(camera))
    share = fresh.views([camera, camera])
    assert set(torch.nonzero(share)[:, 0].tolist()) == set(fresh.visible(camera).tolist())
    assert float(share.mean()) == pytest.approx(1)


def test_growth(photographs: PhotographSet) -> None:
    scaffold = Scaffold(photographs, 300, torch.Generator().manual_seed(0))
    before = {tuple(c) for c in scaffold.lattice.tolist()}
    # Anchor 5 asks for more around its offset 3, three cells away; anchor 7 is transparent.
    scaffold.tables["scalings"][5] = np.log(scaffold.units.cell * scaffold.units.length)
    scaffold.tables["offsets"][5, 9:12] = torch.tensor([40.0, 41.0, 43.0])
    scaffold.gradient[5, 3], scaffold.drawn[5, 3] = 20 * 0.01, 20
    scaffold.seen[:], scaffold.opacity[:] = 30, 30
    scaffold.opacity[7] = 0.0
    gone, feature = tuple(scaffold.lattice[7].tolist()), scaffold.tables["features"][5].clone()
    near = scaffold.lattice[5] + [40, 41, 43]
    for _ in range(8):
        kept = {name: t.clone() for name, t in scaffold.tables.items()}
        scaffold.gradient[5, 3], scaffold.drawn[5, 3] = 20 * 0.01, 20
        scaffold.grow(400, torch.Generator().manual_seed(1))
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
    for name, table in scaffold.tables.items():
        assert (
            table.shape == scaffold.first[name].shape == scaffold.second[name].shape == (scaffold.count, COLUMNS[name])
        )
    assert len(kept["features"]) == len(before)


def test_growth_has_a_limit(photographs: PhotographSet) -> None:
    scaffold = Scaffold(photographs, 300, torch.Generator().manual_seed(0))
    count = scaffold.count
    scaffold.tables["offsets"].uniform_(-30, 30, generator=torch.Generator().manual_seed(2))
    scaffold.gradient[:], scaffold.drawn[:] = 1, 20
    scaffold.grow(count + 17, torch.Generator().manual_seed(1))
    assert scaffold.count == count + 17
    scaffold.grow(count - 5, torch.Generator().manual_seed(1))
    assert scaffold.count == count + 17


def test_no_points(photographs: PhotographSet) -> None:
    empty = replace(photographs, points=np.zeros((0, 3)), colours=np.zeros((0, 3), np.uint8))
    with pytest.raises(ValueError, match="no points"):
        Trainer(empty, SMALL)


# --- the rate ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", HYPERPRIORS)
def test_hyperpriors(name: str, photographs: PhotographSet) -> None:
    """Each hyperprior gives finite bits with a gradient for its planes; step of scalings is one for all anchors."""
    trainer = Trainer(photographs, replace(SMALL, hyperprior=name))
    trainer._start_rate()
    rate, contexts = trainer.rate, trainer.contexts
    assert isinstance(rate, LearnedRate)
    assert isinstance(contexts, Contexts)
    pairs = len(HYPERPRIORS[name].axes)
    assert rate.latents.shape[:2] == (5 * pairs, HYPERPRIORS[name].channels)
    rows = torch.arange(50)
    with torch.no_grad():
        rate.hyper.weights[-1].add_(
            torch.randn(rate.hyper.weights[-1].shape, generator=trainer.random) * rate.hyper.weights[-1].abs().gt(0)
        )
    hidden = rate.hyper.activations(contexts.inputs(rate.symbols(trainer.random), rows, False))
    kept = torch.ones(50, OFFSETS)
    kept[7] = 0
    bits = rate.attribute_bits(hidden, torch.zeros(50, WIDTH), kept)
    assert bits.shape == (50, 3)
    assert (bits[7] == 0).all()
    assert float(bits[8].sum()) > 0
    (bits.sum() + rate.plane_bits(rate.symbols(None)) + rate.steps(hidden).sum()).backward()
    assert rate.latents.grad is not None
    assert torch.isfinite(rate.latents.grad).all()
    assert (rate.latents.grad.abs().sum(dim=(1, 2, 3)) > 0).all()
    assert (rate.hyper.weights[-1].grad[2 * WIDTH + 1] == 0).all()
    steps = rate.steps(hidden)
    assert float(steps[:, 1].std()) == 0


def test_bytes_are_what_was_estimated(trained: Trainer) -> None:
    """Code lengths as training counts them, against the coder's own models of the file's symbols: integers in both."""
    scene = trained.result()
    assert isinstance(scene, Scene)
    estimate = trained.estimate()
    found = attribute_code_length(scene)
    assert estimate["attributes"] * 8 == pytest.approx(found.table, rel=0.01)
    assert estimate["planes"] * 8 == pytest.approx(plane_code_length(scene).table, rel=0.01)
    packing = {s.name: s.end - s.start for s in parse_container(emit(packed(scene, None, None))).sections.values()}
    assert estimate["positions"] == packing["positions"]
    assert estimate["weights"] == packing["weights"]
    assert estimate["attributes"] == pytest.approx(sum(estimate[kind] for kind in ("features", "scalings", "offsets")))


def test_weights_end_on_grids(trained: Trainer) -> None:
    """Every layer can be packed, and training draws with the weights of the file."""
    scene = trained.result()
    assert isinstance(scene, Scene)
    for name, layers in scene.networks.items():
        for number, layer in enumerate(layers):
            grid = to_grid(layer)
            assert grid is not None
            # A few weights grow after the grid was chosen.
            assert np.abs(grid.weight).max() < 4096, (name, number)
    assert trained.scaffold.networks.gridded
    layers = trained.scaffold.networks.layers()
    for name, found in layers.items():
        for (weight, bias), (wanted, wanted_bias) in zip(found, scene.networks[name], strict=True):
            assert (weight == wanted).all()
            assert (bias == wanted_bias).all()


def test_the_file_shows_what_the_training_showed(trained: Trainer, photographs: PhotographSet) -> None:
    """SPEC 14.5: 50 dB between the trainer's image of the quantised scene and that of the decoded file."""
    scene = trained.result()
    assert isinstance(scene, Scene)
    view = View(parse(emit(scene)).scene)
    for photograph in photographs.test[:3]:
        error = float(
            np.mean((view.draw(photograph.camera).clip(0, 1) - trained.show(scene, photograph.camera).numpy()) ** 2)
        )
        assert -10 * np.log10(error + 1e-12) > 50


def test_positions_are_exact(trained: Trainer) -> None:
    scene = trained.result()
    assert isinstance(scene, Scene)
    units = trained.scaffold.units
    lattice = {tuple(c) for c in trained.scaffold.lattice.tolist()}
    cells = (world_positions(scene).astype(np.float64) - units.origin) / (units.cell * units.length)
    np.testing.assert_allclose(cells, np.round(cells), atol=1e-3)
    assert {tuple(c) for c in np.round(cells).astype(int).tolist()} <= lattice


# --- whole trainings --------------------------------------------------------------------------------------------------


def test_what_a_training_says(trained: Trainer) -> None:
    scene = trained.result()
    assert isinstance(scene, Scene)
    said = report(trained, scene)
    assert len(said["quantised"]) == len(trained.photographs.test)
    assert json.loads(json.dumps(said)) == said
    assert said["steps"] == SMALL.steps
    assert len(said["history"]) >= 40
    assert said["history"][-1]["psnr"] > said["history"][0]["psnr"] + 1


def test_going_on_is_not_seen(trained: Trainer, photographs: PhotographSet, tmp_path: Path) -> None:
    """A training that stops and goes on, before and after each milestone, ends with the same file."""
    expected = coded(trained)
    for steps in (30, 125):
        one = Trainer(photographs, SMALL)
        for _ in range(steps):
            one.step()
        save(one, tmp_path / "state")
        two = Trainer(photographs, SMALL)
        restore(two, tmp_path / "state")
        assert two.run(lambda _: None)
        assert coded(two) == expected
    with pytest.raises(ValueError, match="other settings"):
        restore(Trainer(photographs, replace(SMALL, rate=0.01)), tmp_path / "state")
    (tmp_path / "state").write_bytes(b"no state")
    with pytest.raises(ValueError, match="cannot be read"):
        restore(Trainer(photographs, SMALL), tmp_path / "state")


@pytest.mark.parametrize("steps", [5, 100])
def test_an_interrupt_leaves_a_scene_and_a_state(
    steps: int, photographs: PhotographSet, trained: Trainer, tmp_path: Path
) -> None:
    trainer = Trainer(photographs, SMALL)

    def interrupt(t: Trainer) -> None:
        if t.done == steps:
            os.kill(os.getpid(), signal.SIGINT)

    assert not trainer.run(interrupt, tmp_path / "state")
    assert steps <= trainer.done <= steps + 1
    assert parse(coded(trainer)).scene.anchor_count > 100
    again = Trainer(photographs, SMALL)
    restore(again, tmp_path / "state")
    again.run(lambda _: None)
    assert coded(again) == coded(trained)


DIGEST = """
import hashlib, sys
from pathlib import Path
import numba
from refcodec.bitstream.codec import emit
from refcodec.train.command import train
from refcodec.photographs.photographs import read_photographs
from refcodec.train.trainer import TrainSettings
numba.set_num_threads(1)
settings = TrainSettings(rate=0.004, steps=60, anchors=800, most_anchors=900)
found = read_photographs(sys.argv[1], (100, 75))
trainer, _ = train(found, settings, Path(sys.argv[2]), threads=int(sys.argv[3]), device="cpu", resume=False, progress=False)
print(hashlib.sha256(emit(trainer.result())).hexdigest())
"""


def test_same_file_whatever_the_number_of_threads(tmp_path: Path) -> None:
    def run(threads: int) -> str:
        environment = {
            **os.environ,
            "NUMBA_NUM_THREADS": str(threads),
            "OMP_NUM_THREADS": str(threads),
            "OMP_WAIT_POLICY": "PASSIVE",
        }
        command = [sys.executable, "-c", DIGEST.replace("numba.set_num_threads(1)", ""), str(EXAMPLES / "caliterra")]
        command += [str(tmp_path / str(threads)), str(threads)]
        return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout

    assert run(1) == run(2)


def test_another_unit_gives_the_same_scene(trained: Trainer, photographs: PhotographSet) -> None:
    """The same photographs with cameras and points in hundredths of the unit: same anchors, about the same bytes and images."""
    other = Trainer(times(photographs, 100.0), SMALL)
    other.run(lambda _: None)
    one, two = trained.history[-1], other.history[-1]
    assert two["psnr"] == pytest.approx(one["psnr"], abs=0.5)
    assert two["bytes"] == pytest.approx(one["bytes"], rel=0.02)
    assert other.scaffold.units.length == pytest.approx(100 * trained.scaffold.units.length)


@pytest.mark.parametrize(
    "change",
    [{"hyperprior": "triplane"}, {"uniform": False}, {"plane_period": 1}, {"masks": False}, {"epsilon": 0.0004}],
)
def test_switches(change: dict, photographs: PhotographSet) -> None:
    trainer = Trainer(photographs, replace(SMALL, steps=40, **change))
    trainer.run(lambda _: None)
    result = trainer.result()
    if change.get("hyperprior"):
        assert isinstance(result, Uncompressed)
        steps = trainer._steps(torch.arange(trainer.scaffold.count)).detach().numpy()
        symbols = result.values.features / steps[:, :1]
        np.testing.assert_allclose(symbols, np.round(symbols), atol=1e-3)
        assert View(result).draw(photographs.test[0].camera).shape == (75, 100, 3)
    else:
        assert isinstance(result, Scene)
        assert result.masks.all() or change.get("masks", True)


def test_masks_move(trained: Trainer) -> None:
    """In this short time the masks' loss and the rate move all masks together towards the threshold; none passes it for sure."""
    assert float(trained.scaffold.tables["masks"].mean()) < 0


# --- the command ------------------------------------------------------------------------------------------------------


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, scene, file = str(EXAMPLES / "caliterra"), tmp_path / "scene", tmp_path / "scene.c3gs"
    assert main(["train", source, "-o", str(scene), "--steps", "30", "--size", "64", "--progress"]) == 0
    said = capsys.readouterr()
    assert "30 steps" in said.out
    assert "step 30 of 30" in said.err
    assert not state_path(scene).exists()
    assert main(["encode", str(scene), "-o", str(file)]) == 0
    assert main(["eval", str(file), source, "--size", "64", "--json"]) == 0
    measured = json.loads(capsys.readouterr().out)
    facts = json.loads((scene / "training.json").read_text())
    assert facts["anchors"] == measured["anchors"]
    assert facts["bytes"]["weights"] == pytest.approx(measured["parts"]["weights"], abs=100)
    # Over an older result, and from there nothing to go on with.
    assert main(["train", source, "-o", str(scene), "--steps", "5", "--size", "64"]) == 0
    assert main(["train", source, "-o", str(scene), "--resume"]) == 64
    assert "nothing to resume" in capsys.readouterr().err


def test_command_without_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, folder = str(EXAMPLES / "snowmiku"), tmp_path / "scaffold"
    for _ in range(2):
        assert main(["train", source, "-o", str(folder), "--rate", "0", "--steps", "20", "--size", "64"]) == 0
    scene = read_uncompressed(folder)
    assert main(["eval", str(folder), source, "--size", "64", "--json"]) == 0
    found = json.loads(capsys.readouterr().out.split("\n", 2)[2])
    assert found["parts"] == {
        "positions": 12 * scene.anchor_count,
        "attributes": 4 * 86 * scene.anchor_count,
        "weights": 4 * 13860,
    }
    assert main(["render", str(folder), "-o", str(tmp_path / "images")]) == 0
    assert (tmp_path / "images" / "default.png").is_file()
    (folder / "networks.safetensors").write_bytes(b"")
    assert main(["eval", str(folder), source]) == 64
    assert "train it again" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--rate", "2"], "0 to 1"),
        (["--steps", "0"], "at least 1"),
        (["--size", "0x5"], "size"),
        (["--device", "cuda"], "CUDA"),
        (["-o", "."], "not a scene folder"),
    ],
)
def test_command_errors(options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if options == ["--device", "cuda"] and torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    output = [] if options[0] == "-o" else ["-o", str(tmp_path / "scene")]
    assert main(["train", str(EXAMPLES / "caliterra"), *output, *options]) == 64
    assert message in capsys.readouterr().err


def test_the_bitstream_side_does_not_import_training() -> None:
    code = "import sys\nfrom refcodec.bitstream import codec\nfrom refcodec.render import view\nfrom refcodec.evaluate import evaluation\n"
    code += "print([m for m in sys.modules if m == 'torch' or m.startswith('refcodec.train')])"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


def test_a_nerf_folder_with_transparent_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A red ball without ground, seen from around it, without points: it is learnt over white."""
    frames = []
    (tmp_path / "images").mkdir()
    across, down = np.meshgrid(np.arange(32) - 15.5, np.arange(32) - 15.5)
    ball = np.zeros((32, 32, 4), np.uint8)
    ball[across**2 + down**2 < 64] = (220, 30, 20, 255)
    for number in range(16):
        angle = 2 * np.pi * number / 16
        pose = np.array(
            [
                [np.cos(angle), 0, np.sin(angle), 4 * np.sin(angle)],
                [0, 1, 0, 0],
                [-np.sin(angle), 0, np.cos(angle), 4 * np.cos(angle)],
            ]
        )
        Image.fromarray(ball).save(tmp_path / "images" / f"r_{number}.png")
        frames.append({"file_path": f"images/r_{number}.png", "transform_matrix": pose.tolist()})
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    scene, file = tmp_path / "scene", tmp_path / "scene.c3gs"
    assert main(["train", str(tmp_path), "-o", str(scene), "--steps", "150"]) == 0
    assert main(["encode", str(scene), "-o", str(file)]) == 0
    capsys.readouterr()
    assert parse(file.read_bytes()).scene.render.background == (255, 255, 255)
    assert main(["eval", str(file), str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean"]["psnr"] > 15
