"""The compression for gsplat's trainer."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

for package in ("torch", "numba", "PIL", "skimage", "scipy"):
    pytest.importorskip(package)

import torch  # noqa: E402
from plain import made, write  # noqa: E402

import refcodec  # noqa: E402
from refcodec.api import convert  # noqa: E402
from refcodec.formats.splats import Splats  # noqa: E402
from refcodec.gsplat import FILE, KEYS, C3gsCompression  # noqa: E402


def tensors(splats: Splats) -> dict[str, torch.Tensor]:
    arrays = {name: torch.from_numpy(getattr(splats, own).copy()) for name, own in KEYS.items()}
    return arrays | {"sh0": arrays["sh0"][:, None]}


@torch.no_grad()
def compressed(method: Any, folder: Path, splats: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Returns decompressed splats, as run_compression of the trainer gets them."""
    held = torch.nn.ParameterDict({name: torch.nn.Parameter(own.clone()) for name, own in splats.items()})
    method.compress(str(folder), held)
    return method.decompress(str(folder))  # type: ignore[no-any-return]


def test_the_file_is_that_of_convert(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    splats = made(150, 1)
    splats.mean[7] = np.nan
    found = compressed(C3gsCompression(), tmp_path, tensors(splats))
    assert "bytes, 149 of 150 Gaussians, 4" in capsys.readouterr().out
    convert(write(splats, tmp_path / "a.ply"), tmp_path / "a.c3gs", fast=True)
    assert (tmp_path / FILE).read_bytes() == (tmp_path / "a.c3gs").read_bytes()
    assert all(map(torch.equal, found.values(), tensors(refcodec.splats(tmp_path / "a.c3gs")).values()))


def test_it_returns_what_gsplat_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a camera as the trainer has it. Gaussians and axes have another order, and gsplat crops to a square."""
    theirs = pytest.importorskip("gsplat.compression.png_compression")
    from gsplat.cuda._torch_impl import _quat_scale_to_covar_preci as shapes  # noqa: PLC0415

    # The k-means of harmonics needs CUDA.
    for name in ("compress", "decompress"):
        monkeypatch.setattr(theirs, f"_{name}_kmeans", getattr(theirs, f"_{name}_npz"))
    given = tensors(made(102, 3))
    given["opacities"].clip_(-1)
    png = compressed(theirs.PngCompression(use_sort=False, verbose=False), tmp_path, given)
    # It looks along x.
    pose = [[0, 0, 1, -4], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]
    views = [(pose, [[200, 0, 120], [0, 210, 100], [0, 0, 1]], (240, 200))]
    ours = compressed(C3gsCompression(psnr=60, cameras=views, verbose=False), tmp_path, given)
    assert refcodec.decode(tmp_path / FILE).camera.centre.round(6).tolist() == [-4, 0, 0]
    kinds = [{name: (own.shape[1:], own.dtype, own.device) for name, own in found.items()} for found in (ours, png)]
    assert kinds[0] == kinds[1]
    far, order = torch.cdist(given["means"], ours["means"]).min(dim=1)
    assert (len(set(order.tolist())), far.max() < 0.002) == (102, True)
    a, b = (shapes(own["quats"], own["scales"].exp(), compute_preci=False)[0] for own in (given, ours))
    assert ((a - b[order]).norm(dim=(1, 2)) < 0.05 * a.norm(dim=(1, 2))).all()
    assert all((ours[name][order] - given[name]).abs().max() < 0.05 for name in ("opacities", "sh0", "shN"))


def test_no_gaussians_and_other_tensors(tmp_path: Path) -> None:
    given, method = tensors(made(1, 2)), C3gsCompression(verbose=False)
    none = {name: own[:0] for name, own in given.items()}
    found = compressed(method, tmp_path, none)
    assert all(found[name].shape == own.shape for name, own in none.items())
    for changed in ({"features": given["sh0"]}, {"shN": given["shN"][:, :2]}, {"scales": none["scales"]}):
        with pytest.raises(ValueError, match="must have"):
            method.compress(tmp_path, {**given, **changed})
