"""The table of round trips: what holds a scene as it is loses nothing, and cameras come back as they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.exports.making import Source
from benchmarks.rounds import SCENE, cameras_json, decibels, folder_round
from refcodec.convert.notes import read_cameras

TRAINED = Path(__file__).resolve().parents[2] / "vectors" / "valid" / "trained-caliterra.c3gs"


def test_a_folder_and_cameras(folder: Path, tmp_path: Path) -> None:
    source = Source("caliterra", TRAINED, folder, 40)
    found = folder_round(source, SCENE, tmp_path)["coded"]
    assert (found["bytes"], found["near"]) == (TRAINED.stat().st_size, None)
    # What is there is not made again.
    assert folder_round(source, SCENE, tmp_path)["coded"] == found
    assert found["shown"] > 15
    grey = decibels(source, source.view.draw, lambda camera: np.full((camera.height, camera.width, 3), 0.5))
    assert grey is not None
    assert 5 < grey < 30
    read = read_cameras(cameras_json(source, tmp_path / "cameras.json"))
    for camera, again in zip(source.fitted, read, strict=True):
        np.testing.assert_allclose(again.rotation, camera.rotation, atol=1e-6)
        np.testing.assert_allclose(again.centre, camera.centre, atol=1e-5)
