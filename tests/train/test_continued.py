"""Training that continues from a scene: it begins with the same image, and keeps the dimensions."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

torch = pytest.importorskip("torch")
pytest.importorskip("numba")

from refcodec.bitstream.codec import parse  # noqa: E402
from refcodec.bitstream.header import RenderInfo  # noqa: E402
from refcodec.bitstream.reconstruction import Reconstruction  # noqa: E402
from refcodec.cli.main import main  # noqa: E402
from refcodec.convert.views import transforms  # noqa: E402
from refcodec.encoder.cloud import AnchorCloud  # noqa: E402
from refcodec.folder.uncompressed import Uncompressed, write_uncompressed  # noqa: E402
from refcodec.photographs.photographs import PhotographSet, read_photographs  # noqa: E402
from refcodec.rendering.view import View, eight_bits  # noqa: E402
from refcodec.train.continued import CONTINUED, MASKED, beginning, continued_settings  # noqa: E402
from refcodec.train.fit_input import Given, read_given  # noqa: E402
from refcodec.train.settings import PRESETS, Phase  # noqa: E402
from refcodec.train.settings_file import varied  # noqa: E402
from refcodec.train.trainer import Trainer  # noqa: E402

FEATURES, OFFSETS, WIDTH, VOXEL = 20, 5, 24, 0.25


def model(voxel: float | None = VOXEL) -> Uncompressed:
    """A scene of other dimensions than those of a training from points, in units of its own."""
    rng = np.random.default_rng(2)
    cells = np.unique(rng.integers(-6, 6, (150, 3)), axis=0)
    n = len(cells)

    def normal(*shape: int, size: float = 1.0) -> np.ndarray:
        return rng.normal(0, size, shape).astype(np.float32)

    networks = {
        name: [
            (normal(WIDTH, FEATURES + 4, size=0.2), normal(WIDTH, size=0.2)),
            (normal(out * OFFSETS, WIDTH, size=0.3), normal(out * OFFSETS, size=0.3)),
        ]
        for name, out in (("opacity", 1), ("covariance", 7), ("colour", 3))
    }
    values = Reconstruction(
        (cells * VOXEL).astype(np.float32), normal(n, FEATURES), normal(n, 6, size=0.2) - 1.5, normal(n, OFFSETS, 3)
    )
    masks = rng.random((n, OFFSETS)) < 0.7
    masks[0] = True
    values = replace(values, offsets=np.where(masks[:, :, None], values.offsets, np.float32(0)))
    render = RenderInfo(background=(255, 255, 255), distance_unit=2.5, near_plane=0.01, up_axis=4, low_pass=0.25)
    return Uncompressed(values, masks, networks, render, voxel=voxel)


def photographed(scene: Uncompressed, folder: Path, count: int = 8) -> Path:
    """Photographs of a scene, in NeRF's format."""
    view = View(scene)
    cameras = [replace(own.resized(48, 48), name=f"{own.name}.png") for own in view.orbit(count)]
    folder.mkdir()
    for camera in cameras:
        Image.fromarray(eight_bits(view.draw(camera))).save(folder / camera.name)
    (folder / "transforms.json").write_text(json.dumps(transforms(cameras)))
    return folder


def written(folder: Path, voxel: float | None = VOXEL) -> tuple[Uncompressed, Given, PhotographSet]:
    """A scene and photographs of it, as they are read from their folders `scene` and `photographs`."""
    scene = model(voxel)
    write_uncompressed(scene, folder / "scene")
    photographs = read_photographs(photographed(scene, folder / "photographs"), 48, scene.render.background)
    return scene, read_given(folder / "scene"), photographs


@pytest.mark.slow
@pytest.mark.parametrize("voxel", [VOXEL, None])
def test_it_begins_with_what_the_scene_shows(voxel: float | None, tmp_path: Path) -> None:
    """With a lattice of the scene positions are exact, and without one nearly so."""
    scene, given, photographs = written(tmp_path, voxel)
    settings = continued_settings(given, varied(PRESETS["fast"], {"steps": 4}))
    assert sum(settings.entropy.slices) == FEATURES
    # One wrong anchor far out is left out, and does not make the lattice of all coarse.
    positions = given.cloud.positions.copy()
    positions[-1] = 1e6
    given, whole = replace(given, cloud=replace(given.cloud, positions=positions)), given
    begun = beginning(given, photographs, settings)
    assert len(begun.lattice) == len(positions) - 1
    assert begun.units.cell * begun.units.length <= VOXEL
    given = whole
    trainer = Trainer(photographs, settings, given=given)
    assert trainer.scaffold.count == len(scene.masks)
    for photograph in photographs.train:
        drawn = trainer.draw(photograph.camera).detach().numpy()
        error = float(np.mean((drawn.clip(0, 1) - photograph.image / 255) ** 2))
        assert photograph.image.std() > 20
        assert -10 * np.log10(error) > (50 if voxel else 40)


@pytest.mark.slow
def test_it_ends_with_a_file_of_the_same_dimensions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, _, _ = written(tmp_path)
    words = ["train", str(tmp_path / "photographs"), "-o", str(tmp_path / "better"), "--size", "48", "--steps", "25"]
    assert main([*words, "--from", str(tmp_path / "scene"), "--keep-state"]) == 0
    assert "anchors of the scene to continue" in capsys.readouterr().err
    assert main(["encode", str(tmp_path / "better"), "-o", str(tmp_path / "a.c3gs")]) == 0
    coded = parse((tmp_path / "a.c3gs").read_bytes()).scene
    assert coded.render.low_pass == scene.render.low_pass
    d = coded.dimensions
    assert (d.features, d.offset_count, d.render_width) == (FEATURES, OFFSETS, WIDTH)
    # A saved training goes on from the same scene alone.
    more = [*words[:-1], "30", "--resume"]
    assert main(more) == 64
    assert main([*more, "--from", str(tmp_path / "scene")]) == 0
    # Training can continue from a coded scene, too.
    assert main([*words[:3], str(tmp_path / "third"), *words[4:], "--from", str(tmp_path / "better")]) == 0


def test_masks_and_phases(tmp_path: Path) -> None:
    scene, given, photographs = written(tmp_path)
    settings = continued_settings(given, PRESETS["fast"])
    assert settings.phases == CONTINUED
    own = (Phase("all", 0.0, {"rate": "on"}),)
    assert continued_settings(given, replace(PRESETS["fast"], phases=own)).phases == own
    begun = beginning(given, photographs, settings)
    assert np.array_equal(begun.tables["masks"] > MASKED, scene.masks[np.lexsort(scene.values.positions.T[::-1])])
    plain = varied(settings, {"rate.lambda_r": 0.0})
    with pytest.raises(ValueError, match="has masks"):
        beginning(given, photographs, plain)
    empty = AnchorCloud(*(values[:0] for values in vars(given.cloud).values()))
    with pytest.raises(ValueError, match="no anchors"):
        beginning(replace(given, cloud=empty), photographs, settings)
