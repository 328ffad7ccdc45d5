"""Decoding beside SPZ: the scenes that are decoded. The libraries of others are not part of the tests."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.large import TRAINED
from benchmarks.peers.speed import LibraryError, built, decoded, repeated, static_scene
from refcodec.bitstream.codec import emit, parse
from refcodec.formats.splats import Splats


def test_a_static_scene_has_the_symbols_of_the_other(tmp_path: Path) -> None:
    scene = parse(TRAINED.read_bytes()).scene
    path = tmp_path / "static.c3gs"
    path.write_bytes(emit(static_scene(scene)))
    assert np.array_equal(parse(path.read_bytes()).scene.attributes.features, scene.attributes.features)
    found = decoded(path)
    assert found["count"] == scene.masks.sum()
    assert found["seconds"] >= found["symbols"] + found["values"] + found["Gaussians"] > 0
    assert "Gaussians" not in decoded(TRAINED)


def test_repeated_gaussians(make_splats: Callable[[int, int], dict[str, torch.Tensor]]) -> None:
    splats = Splats(**{name: value.numpy() for name, value in make_splats(50, 1).items()})
    found = repeated(splats, 120)
    assert {len(value) for value in vars(found).values()} == {120}
    # Copies differ in their places only.
    assert len(np.unique(found.scale, axis=0)) == 50
    assert len(np.unique(found.mean, axis=0)) == 120
    assert found.mean.dtype == np.float32


@pytest.mark.skipif(shutil.which("c++") is None, reason="libraries are compiled with c++")
def test_a_library_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(LibraryError, match="failed"):
        built("spz", tmp_path, tmp_path)
