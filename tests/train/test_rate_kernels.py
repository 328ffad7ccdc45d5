"""Kernels of the rate model against the definitions in torch, mostly in float64: values and gradients."""

import copy

import numpy as np
import pytest
import torch
from torch import Tensor

from refcodec.bitstream.tables import SCALE_MIN
from refcodec.train.cpu.likelihood import likelihood
from refcodec.train.cpu.residues import Symbols, WithResidues
from refcodec.train.rate_model.bits import TorchBits
from refcodec.train.rate_model.folded import FoldedMlp
from refcodec.train.rate_model.hyperprior import Contexts, PlaneSamples, plane_neighbours
from refcodec.train.rate_model.model import OFFSETS, PAPER, RateModel
from refcodec.train.rate_model.units import MEAN_UNIT
from refcodec.train.settings import EntropySettings

ROUNDED = pytest.mark.parametrize("rounding", [False, True], ids=["floats", "integers"])


def agree(ours: list[Tensor], wanted: list[Tensor], tolerance: float = 1e-5) -> None:
    """Values or gradients are the same up to a share of the largest."""
    for a, b in zip(ours, wanted, strict=True):
        exact = b.detach().double().numpy()
        np.testing.assert_allclose(a.detach().double().numpy(), exact, rtol=0, atol=tolerance * np.abs(exact).max())


def gradients(value: Tensor, weights: Tensor, inputs: list[Tensor]) -> list[Tensor]:
    """Of the weighted sum of a value."""
    return list(torch.autograd.grad((value * weights.to(value.dtype)).sum(), inputs))


@ROUNDED
def test_the_planes_query(rounding: bool) -> None:
    draw = torch.Generator().manual_seed(1)
    samples = PlaneSamples(torch.randint(0, 65537, (300, 2), generator=draw).numpy(), 9)
    # Some contexts are past 1023, and have no gradient.
    symbols = (60 * torch.randn(5, 4, 9, 9, generator=draw)).requires_grad_()
    rows, more = torch.randint(0, 300, (200,), generator=draw), torch.randn(300, 3, generator=draw)
    ours = Contexts(samples, more).inputs(symbols, rows, rounding)
    wanted = torch.cat([samples.query_torch(symbols, rows, rounding), more[rows]], dim=1)
    assert 0 < float((wanted.abs() == 1023).float().mean()) < 0.5
    weights = torch.randn(200, 11, generator=draw)
    agree([ours], [wanted])
    agree(gradients(ours, weights, [symbols]), gradients(wanted, weights, [symbols]))


@pytest.mark.parametrize("seed", [None, 3], ids=["rounded", "noise"])
def test_residues(seed: int | None) -> None:
    draw = torch.Generator().manual_seed(2)
    values = [torch.randn(40, width, generator=draw).requires_grad_() for width in (5, 2, 7)]
    steps = (torch.rand(40, 3, generator=draw) + 0.1).requires_grad_()
    size = torch.cat([steps[:, i : i + 1].expand_as(v) for i, v in enumerate(values)], dim=1).double()
    given = torch.cat(values, dim=1).double()
    shown, symbols = torch.cat(WithResidues.apply(steps, seed, *values), dim=1), Symbols.apply(steps, seed, *values)
    if seed is None:
        residue = (torch.floor(given / size + 0.5) - given / size).detach()
        assert (symbols == torch.round(symbols)).all()
    else:
        residue = ((shown - given) / size).detach()
        assert float(residue.abs().max()) <= 0.5001
        assert float(residue.std()) == pytest.approx(12**-0.5, rel=0.1)
        assert len(residue.unique()) > 0.99 * residue.numel()
    wanted = given + residue * size, given / size + residue
    agree([shown, symbols], list(wanted))
    inputs, weights = [steps, *values], torch.randn(40, 14, generator=draw)
    for a, b in zip((shown, symbols), wanted, strict=True):
        agree(gradients(a, weights, inputs), gradients(b, weights, inputs))


def test_noise_is_the_seeds_alone() -> None:
    steps, values = torch.ones(100, 2), [torch.zeros(100, 8), torch.zeros(100, 8)]
    one, same, other = (Symbols.apply(steps, seed, *values) for seed in (5, 5, 6))
    assert torch.equal(one, same)
    for a, b in ((one, other), (one[:, :8], one[:, 8:]), (one[1:], one[:-1])):
        assert abs(float(torch.corrcoef(torch.stack([a.flatten(), b.flatten()]))[0, 1])) < 0.15


@ROUNDED
@pytest.mark.parametrize("gridded", [False, True], ids=["free", "grids"])
def test_a_folded_network(rounding: bool, gridded: bool) -> None:
    draw = torch.Generator().manual_seed(4)
    units = torch.exp2(torch.randint(2, 8, (6,), generator=draw).float())
    network = FoldedMlp([6, 12, 4], units, torch.tensor([16.0, 64.0, 8.0, 8.0]), draw, 0.5)
    x = torch.randint(-1023, 1024, (500, 6), generator=draw).float().requires_grad_()
    network.calibrate(x.detach() / 2)
    if gridded:
        network.set_grid(3)
    network.rounding = rounding
    rows, weights = slice(1, 3), torch.randn(500, 2, generator=draw)
    ours = network.outputs(network.activations(x), rows)
    hidden = network.run_torch(0, x, slice(None))
    # Some activations are past 1023, and have no gradient.
    assert (0 < float((hidden >= 1023).float().mean()) < 0.5) or not rounding
    wanted = network.run_torch(1, hidden, rows)
    agree([ours], [wanted])
    inputs = [x, *network.parameters()]
    agree(gradients(ours, weights, inputs), gradients(wanted, weights, inputs))


@pytest.mark.parametrize("count", [1, 4003])
def test_likelihood(count: int) -> None:
    """Bits and their derivatives: likely and unlikely symbols, past both ends of the scales, and some at their mean."""
    draw = torch.Generator().manual_seed(5)
    mean = 60 * torch.randn(count, generator=draw)
    scale = torch.empty(count).uniform_(-40, 60, generator=draw)
    symbol = mean / 16 + torch.randn(count, generator=draw) * torch.exp2(scale / 8)
    symbol[::7] = mean[::7] / 16
    bits, *ours = map(torch.from_numpy, likelihood(mean.numpy(), scale.numpy(), symbol.numpy(), 2.0**-20))
    exact = [v.double().requires_grad_() for v in (mean, scale, symbol)]
    wanted = TorchBits.apply(*exact, True, 2.0**-20)
    agree([bits], [wanted])
    by = gradients(wanted, torch.ones(count), exact)
    # TorchBits has none that leads further past the smallest scale; the kernel leaves this to its callers.
    ours[1][(scale <= SCALE_MIN) & (ours[1] > 0)] = 0
    agree([*ours, -MEAN_UNIT * ours[0]], by, 1e-4)


@ROUNDED
def test_bits_of_attributes(rounding: bool) -> None:
    """Of F_h's last layer, CARM and the likelihoods: against the same model in float64, which has torch's formulas."""
    draw = torch.Generator().manual_seed(6)
    # Some symbols are past the bounds of CARM's inputs.
    spread = np.full(PAPER.width, 400.0)
    model = RateModel(9, 12, np.zeros(PAPER.width), spread, draw, EntropySettings())
    with torch.no_grad():
        for parameter in model.coding_parameters():
            parameter.add_(0.05 * torch.randn(parameter.shape, generator=draw))
        # Some scales are past the smallest one, where likely symbols would have them smaller still.
        model.hyper.weights[1][PAPER.width - 10 : PAPER.width] = 0
        model.hyper.biases[1][2 * PAPER.width - 10 : 2 * PAPER.width] -= 13.65
    symbols, inputs = 450 * torch.randn(61, PAPER.width, generator=draw), 300 * torch.randn(61, 36, generator=draw)
    symbols[:, -10:] /= 1000
    model.calibrate(inputs, symbols[:, : PAPER.carm_inputs], model.symbols(None).detach())
    model.set_grid(2)
    model.set_integers(rounding)
    model.set_gridded(rounding)
    assert (symbols[:, : PAPER.carm_inputs].abs() > 1023).any()
    kept = (torch.rand(61, OFFSETS, generator=draw) < 0.3).float()
    kept[:5] = 0
    hidden = model.activations(inputs).detach()
    small = model.hyper.outputs(hidden, slice(2 * PAPER.width - 10, 2 * PAPER.width)) <= SCALE_MIN
    assert 0.1 < float(small.float().mean()) < 0.9
    weights, both = torch.rand(61, 3, generator=draw), []
    for kind, network in ((torch.float32, model), (torch.float64, copy.deepcopy(model).double())):
        leaves = [v.to(kind).requires_grad_() for v in (hidden, symbols, kept)]
        bits = network.attribute_bits(*leaves)
        trained = [p for name, p in network.named_parameters() if name.startswith(("carm", "hyper.weights.1"))]
        both.append([bits, *gradients(bits, weights, [*leaves, *trained])])
    assert float(both[0][0].detach()[:5].abs().max()) == 0
    agree(*both, 1e-4)


@ROUNDED
@pytest.mark.parametrize("size", [5, 30])
def test_bits_of_planes(rounding: bool, size: int) -> None:
    """Of SARM and the likelihoods: against the same model in float64, which has torch's formulas."""
    draw = torch.Generator().manual_seed(7)
    model = RateModel(size, 8, np.zeros(PAPER.width), np.ones(PAPER.width), draw, EntropySettings())
    with torch.no_grad():
        # Scales past the smallest one, and on both sides of it.
        model.sarm.biases[-1][1] -= 5
    symbols = torch.round(20 * torch.randn(model.latents.shape, generator=draw))
    # Some contexts are past their bounds.
    symbols[:, 0, 1] *= 60
    symbols[:, 1] = 0
    model.calibrate(torch.randn(9, 36, generator=draw), torch.randn(9, PAPER.carm_inputs, generator=draw), symbols)
    model.set_grid(2)
    model.set_integers(rounding)
    model.set_gridded(rounding)
    scales = model.sarm(plane_neighbours(symbols))[:, 1]
    assert 0.1 < float((scales <= SCALE_MIN).float().mean()) < 0.9
    both = []
    for kind, network in ((torch.float32, model), (torch.float64, copy.deepcopy(model).double())):
        planes = symbols.to(kind).requires_grad_()
        bits = network.plane_bits(planes)
        both.append([bits, *torch.autograd.grad(0.3 * bits, [planes, *network.sarm.parameters()])])
    agree(*both, 1e-4)
