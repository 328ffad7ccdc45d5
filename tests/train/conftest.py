"""A small set of photographs, and a training run of some seconds on it."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("torch")
pytest.importorskip("numba")

from refcodec.bitstream.scene import Scene
from refcodec.cli.main import main
from refcodec.convert.views import transforms
from refcodec.photographs.photographs import PhotographSet, read_photographs
from refcodec.rendering.camera import Camera, looking
from refcodec.train.settings import TrainSettings
from refcodec.train.settings_file import varied
from refcodec.train.trainer import Trainer

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "photographs"
# Few grids to choose from: each is judged by drawing photographs, which takes most of a short training.
FEW_GRIDS = {"weights.rendering_bits": (7, 8), "weights.coarser": (1, 2), "weights.judges": 1}
SMALL = varied(TrainSettings(), {"steps": 160, "start.anchors": 800, "growth.most": 900, **FEW_GRIDS})


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that must be refused, in one line on stderr, and returns that line."""

    def run(*words: object) -> str:
        capsys.readouterr()
        assert main(list(map(str, words))) == 64
        printed = capsys.readouterr()
        assert (printed.out, printed.err.count("\n")) == ("", 1)
        return printed.err

    return run


@pytest.fixture(scope="session")
def examples() -> Path:
    return EXAMPLES


@pytest.fixture(scope="session")
def small() -> TrainSettings:
    """Settings of a training of seconds."""
    return SMALL


@pytest.fixture(scope="session")
def photographs() -> PhotographSet:
    return read_photographs(EXAMPLES / "caliterra", (100, 75))


@pytest.fixture(scope="session")
def trained(photographs: PhotographSet) -> Trainer:
    """A training that came to its end."""
    trainer = Trainer(photographs, SMALL)
    assert trainer.run(lambda _: None)
    return trainer


@pytest.fixture(scope="session")
def coded(trained: Trainer) -> Scene:
    scene = trained.result()
    assert isinstance(scene, Scene)
    return scene


@pytest.fixture
def write_ball(tmp_path: Path) -> Callable[[str, str], PhotographSet]:
    """Writes photographs of a ball of radius 0.5 around (0.2, 0, 0) to a folder of this name, in NeRF's format.

    The cameras are on a circle and a wave around it. The second argument is the mode of the images, as Pillow has it.
    """

    def write(name: str, mode: str) -> PhotographSet:
        folder, size, focal, middle = tmp_path / name, 48, 24 / math.tan(0.35), np.array([0.2, 0, 0])
        folder.mkdir()
        cameras = []
        row, column = np.mgrid[:size, :size] + 0.5
        rays = np.stack([(column - size / 2) / focal, (row - size / 2) / focal, np.ones_like(row)], axis=2)
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        for number in range(24):
            turn = 2 * math.pi * number / 24
            centre = 4.0 * np.array([math.cos(turn), math.sin(turn), 0.6 * math.sin(3 * turn)])
            rotation = looking(-centre, np.array([0.0, 0.0, 1.0]))
            ball = rotation @ (middle - centre)
            image = np.zeros((size, size, 4), np.uint8)
            image[(ball**2).sum() - (rays @ ball) ** 2 < 0.5**2] = (200, 60, 20, 255)
            lens = focal, focal, size / 2, size / 2
            cameras.append(Camera(f"{number}.png", size, size, *lens, rotation, -rotation @ centre))
            Image.fromarray(image).convert(mode).save(folder / cameras[-1].name)
        (folder / "transforms.json").write_text(json.dumps(transforms(cameras)))
        return read_photographs(folder)

    return write
