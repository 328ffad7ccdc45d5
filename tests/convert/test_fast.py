"""Splat files as static scenes without training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("torch")

import refcodec
from refcodec.bitstream.cameras import rotation_matrix
from refcodec.bitstream.header import RenderInfo
from refcodec.bitstream.reconstruction import gaussians
from refcodec.bitstream.splat import HARMONICS as COLOURS
from refcodec.bitstream.splat import LENGTHS, LOGIT, MEAN, QUATERNION
from refcodec.cli.main import main
from refcodec.convert import fast as module
from refcodec.convert.fast import HARMONICS, LENGTH, LOGIT_LEAST, TURN, fast
from refcodec.export.ply import ply_bytes
from refcodec.export.splats import Splats
from refcodec.render.harmonics import REST


def splats_of(seed: int, count: int, degree: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    arrays = {
        "mean": random.normal(0, 2, (count, 3)),
        "base": random.normal(0, 1, (count, 3)),
        "rest": random.normal(0, 0.2, (count, REST[degree], 3)),
        "opacity": random.normal(0, 2, count),
        "scale": random.normal(-3, 1, (count, 3)),
        "quaternion": random.normal(0, 1, (count, 4)),
    }
    return {name: values.astype(np.float32) for name, values in arrays.items()}


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STEPS", 4)


def covariances(lengths: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    unit = quaternion.astype(np.float64) / np.linalg.norm(quaternion, axis=1, keepdims=True)
    axes = rotation_matrix(unit) * np.exp(lengths.astype(np.float64))[:, None]
    found: np.ndarray = axes @ axes.transpose(0, 2, 1)
    return found


@settings(max_examples=8)
@given(seed=st.integers(0, 1 << 20), count=st.integers(1, 40), degree=st.integers(0, 3))
def test_each_number_is_within_its_step(seed: int, count: int, degree: int) -> None:
    """Half a step, and what the sums of 9.4 round: the order of the Gaussians changes, and invisible ones are gone."""
    arrays = splats_of(seed, count, degree)
    arrays["opacity"][0] = 1
    seen = arrays["opacity"] >= LOGIT_LEAST
    scene = fast(arrays, RenderInfo(render_model=1))
    numbers = gaussians(scene)
    assert len(numbers) == seen.sum()
    own = [np.abs(arrays["mean"][seen] - mean).sum(axis=1).argmin() for mean in numbers[:, MEAN]]
    assert sorted(own) == list(range(len(own)))
    wanted = {name: values[seen][own] for name, values in arrays.items()}
    colours = numbers[:, COLOURS].reshape(len(own), -1, 3)
    width = 3 * (REST[degree] + 1)
    error = np.concatenate([wanted["base"][:, None], wanted["rest"]], axis=1) - colours
    # The components turn the errors.
    assert np.abs(error).max() <= 0.51 * HARMONICS * np.sqrt(width) + 0.01
    assert np.abs(numbers[:, LOGIT] - wanted["opacity"].clip(max=module.LOGIT_MOST)).max() <= 0.51 * module.LOGIT
    right = covariances(wanted["scale"], wanted["quaternion"])
    near = covariances(numbers[:, LENGTHS], numbers[:, QUATERNION])
    size = np.trace(right, axis1=1, axis2=2)
    assert (np.abs(right - near).max(axis=(1, 2)) <= 2 * (LENGTH + TURN) * size).all()


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, folder, file = tmp_path / "a.ply", tmp_path / "scene", tmp_path / "scene.c3gs"
    source.write_bytes(ply_bytes(Splats(**splats_of(3, 60, 1))))
    assert main(["convert", str(source), "-o", str(folder), "--fast", "--coarseness", "0.5"]) == 0
    assert main(["encode", str(folder), "-o", str(file)]) == 0
    assert 40 < len(refcodec.gaussians(file).mean) <= 60
    capsys.readouterr()
    for words, reason in (
        (["--fast", "--views", "9"], "omit --views"),
        (["--fast", "--static"], "omit --static"),
        (["--coarseness", "2"], "add --fast"),
    ):
        assert main(["convert", str(source), "-o", str(tmp_path / "other"), *words]) == 64
        assert reason in capsys.readouterr().err
