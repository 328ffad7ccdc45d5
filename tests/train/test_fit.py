"""The fitter: real anchors from points, networks for the integer codec, and their gain."""

import signal
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

torch = pytest.importorskip("torch")
log_ndtr = pytest.importorskip("scipy.special").log_ndtr

from refcodec.bitstream import codec  # noqa: E402
from refcodec.bitstream.dimensions import Dimensions  # noqa: E402
from refcodec.bitstream.entropy import select  # noqa: E402
from refcodec.bitstream.header import RenderInfo  # noqa: E402
from refcodec.bitstream.limits import MAIN  # noqa: E402
from refcodec.bitstream.networks import ACTIVATION_MAX, IntNetwork, Layer, derive_layer  # noqa: E402
from refcodec.bitstream.reconstruction import Reconstruction, reconstruct  # noqa: E402
from refcodec.bitstream.scene import Scene  # noqa: E402
from refcodec.bitstream.tables import tables  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.encoder.cloud import AnchorCloud  # noqa: E402
from refcodec.encoder.quantise import packed  # noqa: E402
from refcodec.folder.uncompressed import Uncompressed, read_uncompressed, write_uncompressed  # noqa: E402
from refcodec.folder.write import write_folder  # noqa: E402
from refcodec.inspect.elements import outline_of  # noqa: E402
from refcodec.inspect.page.measures import SceneMeasures  # noqa: E402
from refcodec.inspect.parts import part_bytes  # noqa: E402
from refcodec.photographs.photographs import PhotographSet  # noqa: E402
from refcodec.rendering.view import View  # noqa: E402
from refcodec.train import fit, voxelise  # noqa: E402
from refcodec.train.fit_input import Given, read_given  # noqa: E402
from refcodec.train.rate_model.bits import TorchBits  # noqa: E402
from refcodec.train.rate_model.folded import FoldedMlp  # noqa: E402
from refcodec.train.rate_model.hyperprior import contexts  # noqa: E402
from refcodec.train.rate_model.model import RateModel  # noqa: E402
from refcodec.train.settings import EntropySettings, FitSettings, TrainSettings  # noqa: E402
from refcodec.train.settings_file import varied  # noqa: E402
from refcodec.train.trainer import Trainer  # noqa: E402

F64 = NDArray[np.float64]
STEPS = 40
VOXEL = voxelise.short_mantissa(0.1)


# Threads that wait for each other cost more than they give at this size.
torch.set_num_threads(1)


def points(count: int = 2500, seed: int = 0) -> voxelise.PointCloud:
    """A bumpy ground with a texture: neighbours resemble each other."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-3, 3, (count, 2))
    height = 0.3 * np.sin(2 * xy[:, 0]) * np.cos(3 * xy[:, 1]) + rng.normal(0, 0.01, count)
    shade = 0.5 + 0.4 * np.sin(3 * xy[:, 0] + xy[:, 1])
    colours = np.clip(np.stack([shade, shade**2, 1 - shade], axis=1) + rng.normal(0, 0.03, (count, 3)), 0, 1)
    return voxelise.PointCloud(
        np.column_stack([xy, height]).astype(np.float32), np.round(colours * 255).astype(np.uint8)
    )


@pytest.fixture(scope="module")
def cloud() -> AnchorCloud:
    given = points()
    return voxelise.voxelise(given.points, given.colours, VOXEL)


def fitted(cloud: AnchorCloud, steps: int = STEPS, voxel: float | None = VOXEL) -> fit.FitResult:
    return fit.fit(Given(cloud, voxel), FitSettings(steps=steps))


def coded_alike(scene: Scene) -> None:
    """A file of the scene is written again as it is."""
    data = codec.emit(scene)
    assert codec.emit(codec.parse(data).scene) == data


@pytest.fixture(scope="module")
def result(cloud: AnchorCloud) -> fit.FitResult:
    return fitted(cloud)


def test_readers(tmp_path):
    text = "# comment\n1 0.5 1.5 -2 10 20 30 0.7 1 2 3 4\n2 1 2 3 255 0 1 0.1\n"
    (tmp_path / "points3D.txt").write_text(text)
    cloud_of = voxelise.read_points(tmp_path / "points3D.txt")
    assert cloud_of.points.tolist() == [[0.5, 1.5, -2.0], [1.0, 2.0, 3.0]]
    assert cloud_of.colours.tolist() == [[10, 20, 30], [255, 0, 1]]
    np.savez(tmp_path / "a.npz", means3d=cloud_of.points, colors=cloud_of.colours)
    assert np.array_equal(voxelise.read_points(tmp_path / "a.npz").points, cloud_of.points)
    np.savez(tmp_path / "b.npz", means3d=cloud_of.points)
    with pytest.raises(ValueError, match="colors"):
        voxelise.read_points(tmp_path / "b.npz")
    with pytest.raises(ValueError, match="expected"):
        voxelise.read_points(tmp_path / "c.obj")
    np.savez(tmp_path / "d.npz", means3d=cloud_of.points * np.nan, colors=cloud_of.colours)
    with pytest.raises(ValueError, match="NaN"):
        voxelise.read_points(tmp_path / "d.npz")
    rows = [struct.pack("<Q3d3BdQ", 7, *p, *c, 0.5, 0) for p, c in zip(cloud_of.points, cloud_of.colours, strict=True)]
    (tmp_path / "points3D.bin").write_bytes(struct.pack("<Q", len(rows)) + b"".join(rows))
    kinds = [(axis, "f4") for axis in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")]
    table = np.array([(*p, *c) for p, c in zip(cloud_of.points, cloud_of.colours, strict=True)], kinds)
    PlyData([PlyElement.describe(table, "vertex")]).write(str(tmp_path / "points.ply"))
    for name in ("points3D.bin", "points.ply"):
        again = read_given(tmp_path / name).cloud
        assert np.array_equal(again.features, read_given(tmp_path / "points3D.txt").cloud.features)
        assert np.array_equal(again.positions, read_given(tmp_path / "points3D.txt").cloud.positions)


@pytest.mark.parametrize(
    ("colours", "expected"),
    [
        (np.array([[0.0, 0.5, 1.0]]), [0, 128, 255]),
        (np.array([[0, 1, 255]], np.int64), [0, 1, 255]),
        (np.array([[0, 1, 256]], np.int64), None),
        (np.array([[-1, 0, 0]], np.int8), None),
        (np.array([[0.0, 0.0, 128.0]]), None),
        (np.array([[0.0, 0.0, np.nan]]), None),
        (np.array([[True, False, True]]), None),
    ],
)
def test_colours_of_points(colours, expected, tmp_path):
    """Floats from 0 to 1 were cut to 0, and larger integers wrapped."""
    np.savez(tmp_path / "a.npz", means3d=np.zeros((1, 3)), colors=colours)
    if expected is None:
        with pytest.raises(ValueError, match="neither integers from 0 to 255 nor floats from 0 to 1"):
            voxelise.read_points(tmp_path / "a.npz")
    else:
        assert voxelise.read_points(tmp_path / "a.npz").colours.tolist() == [expected]


def test_anchors_are_voxels_and_offsets_reach_points(cloud):
    given = points()
    lattice = cloud.positions.astype(np.float64) / VOXEL
    assert np.abs(lattice - np.round(lattice)).max() < 1e-4
    assert len(np.unique(cloud.positions, axis=0)) == len(cloud.positions)
    centres = cloud.positions[:, None] + cloud.offsets * np.exp(cloud.scalings[:, None, :3])
    for k in (0, 9):
        reached = np.linalg.norm(given.points[:, None] - centres[None, :20, k], axis=2).min(axis=0)
        assert reached.max() < 1e-4
    assert cloud.masks[:, 0].all()
    assert not cloud.masks.all()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_tiny_clouds(count):
    given = points(count)
    cloud = voxelise.voxelise(given.points, given.colours)
    assert cloud.features.shape == (len(cloud.positions), 50)
    assert all(np.isfinite(a).all() for a in (cloud.features, cloud.scalings, cloud.offsets))
    coded_alike(fitted(cloud, 3, None).scene)


def test_clouds_of_unusual_values(cloud):
    """No kept offset gives an empty scene. Wide lattices get a grid of their own, large symbols a shift for CARM."""
    empty = fitted(replace(cloud, masks=np.zeros_like(cloud.masks)), 3, None)
    assert (empty.report["dropped"], empty.scene.anchor_count) == (len(cloud.positions), 0)
    far = points(50).points * np.array([1, 1, 1e6], np.float32)
    wide = fitted(voxelise.voxelise(far, points(50).colours, 0.5), 1, 0.5).scene
    assert wide.grid.scale_mantissa * 2.0**wide.grid.scale_exponent > 0.5
    features = cloud.features.copy()
    features[:, 7] *= 5000
    large = fitted(replace(cloud, features=features), 5).scene
    assert large.carm_shift[7] > 0
    for scene in (empty.scene, wide, large):
        coded_alike(scene)


def test_an_empty_cloud_and_a_bad_voxel_are_refused():
    with pytest.raises(ValueError, match="no points"):
        voxelise.voxelise(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    with pytest.raises(ValueError, match="not positive"):
        voxelise.voxelise(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), -1.0)


def test_display_networks_show_the_colours():
    cloud = voxelise.voxelise(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8))
    d = fit.fit_dimensions(cloud, EntropySettings())
    networks = voxelise.display_networks(d)
    x = np.zeros((1, 54), np.float32)
    x[0, :3] = [1.5, -2.0, 0.25]
    x[0, 50:] = [0.6, 0.0, 0.8, 3.0]

    def run(name: str) -> np.ndarray:
        (w0, b0), (w1, b1) = networks[name]
        return np.maximum(x @ w0.T + b0, 0) @ w1.T + b1

    assert np.allclose(run("colour").reshape(10, 3), x[0, :3])
    assert np.tanh(run("opacity")).min() > 0.99
    assert np.array_equal(run("covariance").reshape(10, 7), np.tile([0, 0, 0, 1, 0, 0, 0], (10, 1)))
    with pytest.raises(ValueError, match="hidden units"):
        voxelise.display_networks(Dimensions(1, (3,), 1, 1, 2, (1,), (1,), (), 5))


# --- code lengths in float64, with nothing rounded --------------------------------------------------------------------


def bin_bits(family: str, mean: F64, log2_scale: F64, symbol: F64) -> F64:
    """-log2 of the mass of [symbol - 1/2, symbol + 1/2].

    mean: in steps. log2_scale: of the deviation (gauss) or of b (laplace).
    """
    scale, away = np.exp2(log2_scale), np.abs(symbol - mean)
    near, far = (away - 0.5) / scale, (away + 0.5) / scale
    # log(U(near) - U(far)) without cancellation in the tail, where U is the upper tail.
    if family == "gauss":
        log_near, log_far = log_ndtr(-near), log_ndtr(-far)
    else:
        log_near, log_far = (np.where(t >= 0, -t, np.log(2 - np.exp(-np.abs(t)))) - np.log(2) for t in (near, far))
    with np.errstate(divide="ignore"):
        return -(log_near + np.log(-np.expm1(np.minimum(log_far - log_near, 0)))) / np.log(2)


def float_network(layers: list[Layer], inputs: F64) -> F64:
    """SPEC 7.2: hidden activations are clamped to [0, 1023]."""
    for i, (weight, bias) in enumerate(layers):
        inputs = inputs @ weight.astype(np.float64).T + bias.astype(np.float64)
        if i < len(layers) - 1:
            inputs = np.clip(inputs, 0, ACTIVATION_MAX)
    return inputs


def measured(scene: Scene) -> SceneMeasures:
    """Measures of a scene by the tables of the format."""
    measures = SceneMeasures(scene.dimensions, scene.anchor_count)
    measures.add(scene)
    measures.finish(scene)
    return measures


def test_bits_and_their_gradient_are_those_of_the_distributions():
    rng = np.random.default_rng(0)
    mean, scale = rng.normal(0, 40, 200), rng.uniform(-30, 40, 200)
    symbol = np.round(mean / 16 + rng.normal(0, 1, 200) * 2 ** (scale / 8))
    for family in ("gauss", "laplace"):
        how = family == "gauss", 2.0**-20
        exact = bin_bits(family, mean / 16, scale / 8, symbol)
        ours = TorchBits.apply(*map(torch.tensor, (mean, scale, symbol)), *how).numpy()
        likely = exact < 8
        assert likely.sum() > 100
        assert np.abs(ours - exact)[likely].max() < 0.02
        assert (ours <= 20.01).all()
        inputs = [torch.tensor(a[likely], requires_grad=True) for a in (mean, scale)]
        given = torch.tensor(symbol[likely])
        assert torch.autograd.gradcheck(
            lambda m, s, x=given, how=how: TorchBits.apply(m, s, x, *how), inputs, eps=1e-5, atol=1e-4
        )


def test_bin_bits_are_those_of_the_frequency_models():
    for family, models in (("gauss", tables().gauss), ("laplace", tables().laplace)):
        for scale in (-16, 0, 20):
            mean = np.full(3, 5, np.int64)
            m, centre, raw = select(mean, np.full(3, scale, np.int64))
            assert not raw.any()
            x = np.arange(-1, 2)
            at = models.offset[m] + x - centre + models.radius[m]
            p = (models.upper[at].astype(float) - models.lower[at]) / (1 << 14)
            exact = bin_bits(family, mean / 16, np.full(3, scale / 8), x.astype(float))
            # The mode takes what the rounding of all others leaves.
            assert np.allclose(np.maximum(2**-exact, 2.0**-14), p, atol=2.0**-9)


def test_folding_is_exact_and_the_integers_follow():
    generator = torch.Generator().manual_seed(1)
    units = torch.exp2(torch.randint(2, 8, (6,), generator=generator).float())
    network = FoldedMlp([6, 12, 4], units, torch.tensor([16.0, 64.0, 8.0, 8.0]), generator, 0.5)
    inputs = torch.randint(-1023, 1024, (500, 6), generator=generator).float()
    network.calibrate(inputs)
    layers = network.layers()
    with torch.no_grad():
        wanted = network(inputs).numpy()
    assert np.allclose(float_network(layers, inputs.numpy().astype(np.float64)), wanted, rtol=1e-4, atol=1e-3)
    integers = IntNetwork([derive_layer(*layer) for layer in layers])(inputs.numpy().astype(np.int64))
    assert np.abs(integers - wanted).max() < 0.02 * np.abs(wanted).max()


def test_the_scene_can_be_written_and_read(result):
    coded_alike(result.scene)
    assert result.report["steps"] == STEPS
    assert (result.scene.attributes.steps == 32).all()


def test_contexts_in_training_are_those_of_the_codec(result):
    scene = result.scene
    d, rows = scene.dimensions, torch.arange(scene.anchor_count)
    made = contexts(scene.frame, scene.positions, d.plane_size, d.frequency_count)
    inputs = made.inputs(torch.tensor(scene.planes.astype(np.float32)), rows, True).numpy()
    wanted = codec.Coding(scene).contexts()
    assert np.array_equal(inputs, wanted)


def test_training_pays_and_the_coded_size_is_that_of_the_models(cloud, result):
    untrained = fitted(cloud, 0)
    assert len(codec.emit(result.scene)) < len(codec.emit(untrained.scene))
    data = codec.emit(result.scene)
    parts, coded = part_bytes(data, outline_of(data)), measured(result.scene)
    for kind in ("attributes", "planes"):
        assert coded.bits[kind] <= 8 * parts[kind]
    tallies = [tally for name, tally in coded.tallies.items() if name != "planes"]
    assert sum(t.symbols for t in tallies) == 56 * result.scene.anchor_count + 3 * int(result.scene.masks.sum())
    assert coded.bits["attributes"] < sum(tally.entropy for tally in tallies)


@pytest.mark.parametrize("changes", [{}, {"channels": 0, "frequencies": 0}], ids=["hyperprior", "constants"])
def test_a_fit_that_was_stopped_goes_on_to_the_same_result(
    changes: dict[str, int], cloud: AnchorCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped after a step, and within one, which is finished."""
    given = Given(cloud, VOXEL)
    settings = FitSettings(steps=12, entropy=EntropySettings(**changes))
    whole = fit.fit(given, settings)

    def stop(stage: str, done: int, total: int) -> None:
        assert (stage, total) == ("fit", 12)
        if done == 5:
            signal.raise_signal(signal.SIGINT)

    state = tmp_path / "new" / "folder" / "state"
    stopped = fit.fit(given, settings, progress=stop, state=state)
    assert stopped.report["steps"] == 5
    codec.emit(stopped.scene)
    bits, steps = RateModel.attribute_bits, iter(range(6, 20))

    def signalled(*arguments: Any) -> Any:
        if next(steps) == 8:
            signal.raise_signal(signal.SIGINT)
        return bits(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(RateModel, "attribute_bits", signalled)
        assert fit.fit(given, settings, state=state).report["steps"] == 8
    resumed = fit.fit(given, settings, state=state)
    assert codec.emit(resumed.scene) == codec.emit(whole.scene)
    with pytest.raises(ValueError, match="of other settings; seed is 0, not 1"):
        fit.fit(given, replace(settings, seed=1), state=state)
    state.write_bytes(b"\x80\x04N.")  # a pickle is not read
    with pytest.raises(ValueError, match="cannot be read"):
        fit.fit(given, settings, state=state)


ENTROPY = {
    "no planes": {"channels": 0},
    "no frequencies": {"frequencies": 0},
    "no hyperprior": {"channels": 0, "frequencies": 0},
    "no hidden layers": {"layers": 0},
    "as few as there can be": {"channels": 0, "frequencies": 0, "layers": 0, "slices": (50,)},
    "two hidden layers": {"layers": 2},
    "ten slices": {"slices": (5,) * 10},
}


@pytest.mark.parametrize("changes", ENTROPY.values(), ids=ENTROPY)
def test_dimensions_of_other_entropy_models(changes: dict, cloud: AnchorCloud) -> None:
    """The file has them, the codec's steps are those of the training, and what is trained pays."""
    entropy = replace(EntropySettings(), **changes)
    result = fit.fit(Given(cloud, VOXEL), FitSettings(steps=STEPS, entropy=entropy))
    data = codec.emit(result.scene)
    d = codec.parse(data).scene.dimensions
    assert (d.plane_channels, d.frequency_count, d.slices) == (entropy.channels, entropy.frequencies, entropy.slices)
    assert (d.plane_size == 0) == (d.sarm_width == ()) == (entropy.channels == 0)
    inputs = entropy.channels + entropy.frequencies > 0
    assert d.hyper_width == (16,) * (entropy.layers if inputs else 0)
    assert d.carm_width == (16,) * (entropy.layers if len(d.slices) > 1 else 0)
    untrained = fit.fit(Given(cloud, VOXEL), FitSettings(steps=0, entropy=entropy))
    assert len(data) < len(codec.emit(untrained.scene))
    bits = measured(result.scene).bits["attributes"]
    assert 8 * part_bytes(data, outline_of(data))["attributes"] == pytest.approx(bits, rel=0.02)


def test_the_default_dimensions_of_scaffold_gs(cloud: AnchorCloud, tmp_path: Path) -> None:
    """32 features, 10 offsets and networks of 32 hidden units: fitted, encoded and decoded by the commands."""
    rng = np.random.default_rng(8)

    def layer(out: int, fan_in: int) -> tuple[np.ndarray, np.ndarray]:
        bound = fan_in**-0.5
        return tuple(rng.uniform(-bound, bound, shape).astype(np.float32) for shape in ((out, fan_in), (out,)))

    networks = {
        name: [layer(32, 36), layer(outputs, 32)]
        for name, outputs in (("opacity", 10), ("covariance", 70), ("colour", 30))
    }
    values = Reconstruction(cloud.positions, cloud.features[:, :32], cloud.scalings, cloud.offsets)
    model = Uncompressed(values, cloud.masks, networks, RenderInfo())
    write_uncompressed(model, tmp_path / "scaffold")
    paths = {name: str(tmp_path / name) for name in ("scaffold", "fitted", "scene.c3gs", "decoded")}
    assert main(["fit", paths["scaffold"], "-o", paths["fitted"], "--steps", "30"]) == 0
    assert main(["encode", paths["fitted"], "-o", paths["scene.c3gs"]]) == 0
    assert main(["decode", paths["scene.c3gs"], "-o", paths["decoded"]]) == 0
    scene = codec.parse((tmp_path / "scene.c3gs").read_bytes()).scene
    d = scene.dimensions
    assert (d.features, d.offset_count, d.render_width, d.slices) == (32, 10, 32, (3, 7, 9, 13))
    assert scene.profile == MAIN
    for name, layers in networks.items():
        for (weight, bias), (kept, kept_bias) in zip(layers, scene.networks[name], strict=True):
            assert (weight == kept).all()
            assert (bias == kept_bias).all()
    # Each anchor is there, and each of its values is at most half a step from what it was.
    coded = reconstruct(scene)
    order, wanted = np.lexsort(coded.positions.T), np.lexsort(cloud.positions.T)
    assert len(order) == int(cloud.masks.any(axis=1).sum()) == len(wanted)
    np.testing.assert_allclose(coded.positions[order], cloud.positions[wanted], atol=1e-3)
    for name, step in (("features", scene.base_step[0]), ("scalings", scene.base_step[1])):
        away = getattr(coded, name)[order] - getattr(values, name)[wanted]
        assert np.abs(away).max() <= 0.501 * step


# --- a trained scene --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plain(photographs: PhotographSet, small: TrainSettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an uncompressed scene that was trained for seconds."""
    trainer = Trainer(photographs, varied(small, {"rate.lambda_r": 0.0, "steps": 400}))
    trainer.run(lambda _: None)
    result, folder = trainer.result(), tmp_path_factory.mktemp("plain") / "scene"
    assert isinstance(result, Uncompressed)
    write_uncompressed(result, folder)
    return folder


def decibels(one: View, two: View, photographs: PhotographSet) -> float:
    """PSNR between drawings of two scenes, from the cameras of the held-out photographs."""
    pairs = [(one.draw(p.camera), two.draw(p.camera)) for p in photographs.test]
    return float(-10 * np.log10(np.mean([(a.clip(0, 1) - b.clip(0, 1)) ** 2 for a, b in pairs])))


def test_a_trained_scene_keeps_its_looks(plain: Path, photographs: PhotographSet) -> None:
    """The file of the fitted scene shows what the uncompressed scene shows: the same networks, rounded attributes."""
    before = read_uncompressed(plain)
    for path in (plain, plain / "point_cloud.ply"):
        scene = fit.fit(read_given(path), FitSettings(steps=STEPS)).scene
        for name, layers in before.networks.items():
            for (weight, bias), (kept, kept_bias) in zip(layers, scene.networks[name], strict=True):
                assert (weight == kept).all()
                assert (bias == kept_bias).all()
        assert scene.render == before.render
        file = codec.emit(packed(scene, None, None))
        assert decibels(View(before), View(codec.parse(file).scene), photographs) > 43
    # Balls in the colours of features would be far from it.
    balls = replace(scene, networks={**scene.networks, **voxelise.display_networks(scene.dimensions)})
    assert decibels(View(before), View(balls), photographs) < 20


def test_a_coded_scene_is_fitted_again(coded: Scene, photographs: PhotographSet, tmp_path: Path) -> None:
    """Its positions stay where they are, on its own grid. Its values are rounded anew, scalings ten times as finely."""
    write_folder(coded, tmp_path / "scene")
    settings = varied(FitSettings(), {"steps": STEPS, "scene.scalings": 0.01})
    scene = fit.fit(read_given(tmp_path / "scene"), settings).scene
    assert scene.grid == coded.grid
    np.testing.assert_array_equal(scene.positions, coded.positions)
    np.testing.assert_array_equal(scene.masks, coded.masks)
    assert decibels(View(coded), View(scene), photographs) > 47


def test_what_is_missing_is_said(plain: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    """A trained point cloud without its networks is refused, and so are networks without the rest of their scene."""
    cloud, networks = (plain / name for name in ("point_cloud.ply", "networks.safetensors"))
    bare, half, wrong = (tmp_path / name for name in ("bare.ply", "half", "wrong"))
    bare.write_bytes(cloud.read_bytes())
    half.mkdir()
    for file in (cloud, networks):
        (half / file.name).write_bytes(file.read_bytes())
    (half / "other.ply").write_bytes(cloud.read_bytes())
    scene = read_uncompressed(plain)
    layers = {**scene.networks, "opacity": [(w[: len(b) // 2], b[: len(b) // 2]) for w, b in scene.networks["opacity"]]}
    write_uncompressed(replace(scene, networks=layers), wrong)
    for path, message in (
        (bare, "networks.safetensors is not beside it"),
        (half, "neither scene.json nor render.json"),
        (half / "point_cloud.ply", "neither scene.json nor render.json"),
        (half / "other.ply", "it is not point_cloud.ply"),
        (wrong, "opacity.1.bias is float32[5], but must be float32[10]"),
        (tmp_path / "none", "expected"),
    ):
        assert message in refused("fit", path, "-o", tmp_path / "new", "--steps", 1)
        assert not (tmp_path / "new").exists()
