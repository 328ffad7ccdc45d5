"""Gradients against autograd: Gaussians from anchors, the image's loss, Adam on rows of a table."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from refcodec.train.cpu.adam import adam_rows, share_rows
from refcodec.train.cpu.photometric import Photometric
from refcodec.train.cpu.spawn import Spawn
from refcodec.train.rate_model.model import OFFSETS


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
    Photometric.apply(image, photograph, 0.2).backward()
    gradient, step = image.grad, 1e-3
    assert gradient is not None
    direction = torch.randn(image.shape, generator=draw)
    # No pixel's L1 may change its sign between the two ends.
    direction[(image.detach() - photograph).abs() < 5 * step] = 0
    ends = [float(Photometric.apply((image + sign * step * direction).detach(), photograph, 0.2)) for sign in (-1, 1)]
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
def test_gradients_of_shared_rows_are_added(one: list[int], two: list[int]) -> None:
    place, total = np.full(10, -1), np.ones((len(one), 2), np.float32)
    place[one] = np.arange(len(one))
    gradient = np.arange(2 * len(two), dtype=np.float32).reshape(-1, 2)
    apart = share_rows(np.array(two, np.int64), gradient, place, total)
    assert [two[i] for i in apart] == [row for row in two if row not in one]
    expected = np.zeros((10, 2), np.float32)
    expected[one] = 1
    for row, value in zip(two, gradient, strict=True):
        expected[row] += value
    np.testing.assert_array_equal(total, expected[one])
