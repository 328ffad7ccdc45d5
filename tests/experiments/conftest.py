"""The substitute for refcodec, and an experiment that uses it."""

import shutil
import sys
from pathlib import Path

import pytest

# Nothing of the package is imported before.
for package in ("numba", "PIL", "skimage", "scipy", "matplotlib", "bjontegaard", "msgspec", "torch"):
    pytest.importorskip(package, reason="experiments need the packages of the extras train, render and rd")

from refcodec.experiments import jobs  # noqa: E402

PHOTOGRAPHS = Path(__file__).resolve().parents[2] / "examples" / "photographs" / "caliterra"
TEXT = """
lambdas = [0.01, 0.04]
seeds = [0]
steps = 2
baseline = "a"
[[scenes]]
name = "one"
photographs = "photographs"
size = 40
[[methods]]
name = "a"
[[methods]]
name = "whole"
kind = "uncompressed"
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands are those of the fake."""
    monkeypatch.setattr(jobs, "PROGRAM", (sys.executable, str(Path(__file__).with_name("fake.py"))))
    monkeypatch.setattr(jobs, "_LOOK", 0.01)


@pytest.fixture
def place(tmp_path: Path, fake: None) -> Path:
    """A folder with an experiment, x.toml, and its photographs."""
    shutil.copytree(PHOTOGRAPHS, tmp_path / "photographs")
    (tmp_path / "x.toml").write_text(TEXT)
    return tmp_path
