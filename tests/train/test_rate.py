"""The rate in training against the coder's."""

import copy

import numpy as np
import pytest
import torch

from refcodec.bitstream.codec import emit, parse
from refcodec.bitstream.networks import derive_networks
from refcodec.bitstream.reconstruction import world_positions
from refcodec.bitstream.scene import Scene
from refcodec.bitstream.weights import to_grid
from refcodec.encoder.quantise import packed
from refcodec.inspect.elements import outline_of
from refcodec.inspect.page.measures import SceneMeasures
from refcodec.inspect.parts import part_bytes
from refcodec.photographs.photographs import PhotographSet
from refcodec.rendering.view import View
from refcodec.train.estimate import estimate as estimate_of
from refcodec.train.rate_model.model import OFFSETS
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.trainer import Trainer
from refcodec.train.views import show


def test_the_rate_has_gradients(photographs: PhotographSet, small: TrainSettings) -> None:
    """Bits are finite and reach the planes; the step of scalings is one for all anchors."""
    trainer = Trainer(photographs, small)
    assert trainer.rate is not None
    trainer.rate.start()
    model, contexts = trainer.rate.started(), trainer.rate.contexts
    rows = torch.arange(50)
    weights = model.hyper.weights[-1]
    with torch.no_grad():
        weights.add_(torch.randn(weights.shape, generator=trainer.random) * weights.abs().gt(0))
    hidden = model.activations(contexts.inputs(model.symbols(trainer.random), rows, False))
    kept = torch.ones(50, OFFSETS)
    kept[7] = 0
    bits = model.attribute_bits(hidden, torch.zeros(50, model.columns.width), kept)
    assert bits.shape == (50, 3)
    assert (bits[7] == 0).all()
    assert float(bits[8].detach().sum()) > 0
    (bits.sum() + model.plane_bits(model.symbols(None)) + model.steps(hidden).sum()).backward()
    assert model.latents.grad is not None
    assert torch.isfinite(model.latents.grad).all()
    assert (model.latents.grad.abs().sum(dim=(1, 2, 3)) > 0).all()
    assert (weights.grad[2 * model.columns.width + 1] != 0).any()
    model.hold_scalings()
    assert (weights.grad[2 * model.columns.width + 1] == 0).all()
    assert float(model.steps(hidden)[:, 1].std()) == 0


def test_bytes_are_what_was_estimated(trained: Trainer, coded: Scene) -> None:
    """Code lengths as training counts them, against the coder's own models of the file's symbols: integers in both."""
    estimate = estimate_of(trained)
    measures = SceneMeasures(coded.dimensions, coded.anchor_count)
    measures.add(coded)
    measures.finish(coded)
    assert estimate["attributes"] * 8 == pytest.approx(measures.bits["attributes"], rel=0.01)
    # Planes of so few anchors take 400 bytes: 1 % of them is less than the models' rounding makes.
    assert estimate["planes"] * 8 == pytest.approx(measures.bits["planes"], abs=64)
    file = emit(packed(coded, None, None))
    packing = part_bytes(file, outline_of(file))
    assert estimate["positions"] == packing["positions"]
    assert estimate["weights"] == packing["weights"]
    assert estimate["attributes"] == pytest.approx(sum(estimate[kind] for kind in ("features", "scalings", "offsets")))


FEW = {"entropy.channels": 0, "entropy.frequencies": 0, "entropy.layers": 0, "entropy.slices": [10] * 5}


def test_a_training_without_a_hyperprior(photographs: PhotographSet, small: TrainSettings) -> None:
    """It has no frame and no planes, and one step for each kind of attributes."""
    trainer = Trainer(photographs, varied(small, {"steps": 60, **FEW}))
    trainer.run(lambda _: None)
    scene = trainer.result()
    assert isinstance(scene, Scene)
    data = emit(packed(scene, None, None))
    d = parse(data).scene.dimensions
    assert (d.plane_channels, d.frequency_count, d.plane_size) == (0, 0, 0)
    assert (d.hyper_width, d.sarm_width, d.carm_width, d.slices) == ((), (), (), (10,) * 5)
    assert scene.frame is None
    assert (scene.attributes.steps == scene.attributes.steps[:1]).all()
    estimate, sizes = estimate_of(trainer), part_bytes(data, outline_of(data))
    assert estimate["planes"] == 0
    assert estimate["attributes"] == pytest.approx(sizes["attributes"], rel=0.02)
    assert estimate["weights"] == pytest.approx(sizes["weights"], abs=3)


def test_weights_end_on_grids(trained: Trainer, coded: Scene) -> None:
    """Every layer can be packed, and training draws with the weights of the file."""
    for name, layers in coded.networks.items():
        for number, layer in enumerate(layers):
            grid = to_grid(layer)
            assert grid is not None
            # A few weights grow after the grid was chosen.
            assert np.abs(grid.weight).max() < 4096, (name, number)
    assert trained.scaffold.networks.gridded
    for name, drawn in trained.scaffold.networks.layers().items():
        for (weight, bias), (wanted, wanted_bias) in zip(drawn, coded.networks[name], strict=True):
            assert (weight == wanted).all()
            assert (bias == wanted_bias).all()


def test_any_weights_fit_the_file(trained: Trainer) -> None:
    """Networks that grew beyond SPEC 7.2's bounds are cut to them: nothing that was learned is lost."""
    assert trained.rate is not None
    model = copy.deepcopy(trained.rate.started())
    with torch.no_grad():
        for number, parameter in enumerate(model.coding_parameters()):
            parameter.mul_(1e6 if number % 2 else 3e4)
    for coarser in (0, 3):
        model.set_grid(coarser)
        assert {"hyper", "sarm", "carm.1"} <= derive_networks(model.networks()).keys()


def test_the_file_shows_what_the_training_showed(trained: Trainer, coded: Scene, photographs: PhotographSet) -> None:
    """SPEC 14.5: 50 dB between the trainer's image of the quantised scene and that of the decoded file."""
    view = View(parse(emit(coded)).scene)
    for photograph in photographs.test[:3]:
        shown = show(trained.scaffold, trained.drawing, coded, photograph.camera).numpy()
        error = float(np.mean((view.draw(photograph.camera).clip(0, 1) - shown) ** 2))
        assert -10 * np.log10(error + 1e-12) > 50


def test_positions_are_exact(trained: Trainer, coded: Scene) -> None:
    units = trained.scaffold.units
    lattice = {tuple(c) for c in trained.scaffold.lattice.tolist()}
    cells = (world_positions(coded).astype(np.float64) - units.origin) / (units.cell * units.length)
    np.testing.assert_allclose(cells, np.round(cells), atol=1e-3)
    assert {tuple(c) for c in np.round(cells).astype(int).tolist()} <= lattice
