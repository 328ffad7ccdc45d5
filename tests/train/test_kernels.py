"""Kernels of train.cpu against the definitions in torch, and Adam against torch's own."""

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from refcodec.train.adam import adam_torch, added, joined
from refcodec.train.cpu.adam import adam_rows, share_rows
from refcodec.train.cpu.photometric import Photometric
from refcodec.train.cpu.spawn import Spawn
from refcodec.train.losses import photometric_torch
from refcodec.train.rate_model.model import OFFSETS
from refcodec.train.spawn import spawn_torch


@given(
    seed=st.integers(0, 1 << 20),
    anchors=st.integers(1, 20),
    share=st.floats(0, 1),
    degree=st.none() | st.integers(0, 3),
)
def test_spawn(seed: int, anchors: int, share: float, degree: int | None) -> None:
    draw = torch.Generator().manual_seed(seed)
    position = torch.randn(anchors, 3, generator=draw)
    centre = None if degree is None else torch.randn(3, generator=draw)
    colours = 30 * ((degree or 0) + 1) ** 2
    inputs = [torch.randn(anchors, width, generator=draw) for width in (30, 6, 70, colours)]
    chosen = torch.nonzero(torch.rand(anchors * OFFSETS, generator=draw) < share)[:, 0]
    weights = [torch.randn(len(chosen), width, generator=draw) for width in (3, 4, 3, 3)]
    results = []
    for make in (Spawn.apply, spawn_torch):
        values = [v.clone().requires_grad_() for v in inputs]
        gaussians = make(chosen, OFFSETS, position, *values, centre)
        sum((v * w).sum() for v, w in zip(gaussians, weights, strict=True)).backward()
        results.append([*(v.detach() for v in gaussians), *(v.grad for v in values)])
    for compiled, torchs in zip(*results, strict=True):
        torch.testing.assert_close(torchs, compiled, rtol=1e-5, atol=1e-5)


@given(seed=st.integers(0, 1 << 20), height=st.integers(1, 30), width=st.integers(1, 30), ssim=st.floats(0, 1))
def test_photometric(seed: int, height: int, width: int, ssim: float) -> None:
    draw = torch.Generator().manual_seed(seed)
    image, photograph = torch.rand(2, height, width, 3, generator=draw)
    results = []
    for loss in (Photometric.apply, photometric_torch):
        seen = image.clone().requires_grad_()
        value = loss(seen, photograph, ssim)
        value.backward()
        results.append((value.detach(), seen.grad * image.numel()))
    torch.testing.assert_close(results[1][0], results[0][0], rtol=1e-5, atol=1e-6)
    # One pixel's share of the loss has a gradient of about one.
    torch.testing.assert_close(results[1][1], results[0][1], rtol=1e-4, atol=1e-4)


@given(seed=st.integers(0, 1 << 20), steps=st.integers(1, 5000))
def test_adam_on_rows(seed: int, steps: int) -> None:
    draw = torch.Generator().manual_seed(seed)
    table, first = torch.randn(2, 40, 7, generator=draw)
    second, rate = torch.rand(40, 7, generator=draw), np.float32(0.01)
    rows = [torch.randperm(40, generator=draw)[:n] for n in (25, 10)]
    gradients = [torch.randn(len(r), 7, generator=draw) for r in rows]
    union, place = joined(rows)
    total = added(place, gradients, len(union))
    expected = torch.zeros(40, 7).index_add_(0, torch.cat(rows), torch.cat(gradients))
    assert union.tolist() == sorted({*rows[0].tolist(), *rows[1].tolist()})
    torch.testing.assert_close(total, expected[union], rtol=0, atol=0)
    compiled, torchs = ([v.clone() for v in (table, first, second)] for _ in range(2))
    adam_rows(*(v.numpy() for v in compiled), steps, union.numpy(), total.numpy(), rate)
    adam_torch(torchs[0], torchs[1], torchs[2], steps, union, total, float(rate))
    for a, b in zip(torchs, compiled, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6)


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
        tables, ordered = (v.numpy() for v in (table, first, second)), gradient[order].contiguous().numpy()
        adam_rows(*tables, step, order.numpy(), ordered, np.float32(0.01))
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
