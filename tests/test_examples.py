"""The programs of examples/python do what they state."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import refcodec

ROOT = Path(__file__).resolve().parents[1]
PYTHON = ROOT / "examples" / "python"
TRAINED = ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"


def python(program: str, *words: str | Path) -> list[str]:
    command = [sys.executable, str(PYTHON / program), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_the_notebook_runs() -> None:
    """All its cells, on its own file, which comes back byte for byte. It names no place of one machine."""
    pytest.importorskip("numba")
    lines = python("notebook.py")
    scene = refcodec.decode(TRAINED)
    assert repr(scene) in lines
    assert f"encoded again: {TRAINED.stat().st_size:,} bytes, the same file: True" in lines
    assert lines[-1].startswith("error 441, SPEC.md 6.11, byte ")
    text = (PYTHON / "notebook.py").read_text(encoding="utf-8")
    assert not re.findall(r"[\"'](?:/|~|[A-Z]:)", text)
    assert text.count("# %%") > 10


def test_a_crop_keeps_anchors_as_they_are(tmp_path: Path) -> None:
    target = tmp_path / "middle.c3gs"
    lines = python("crop.py", TRAINED, target, "0.5")
    whole, middle = refcodec.decode(TRAINED), refcodec.decode(target)
    with pytest.raises(subprocess.CalledProcessError):
        python("crop.py", target, target, "0.5")
    assert refcodec.decode(target).digest() == middle.digest()
    assert lines[1] == f"{middle.anchor_count} anchors, {target.stat().st_size} bytes"
    assert whole.anchor_count / 2 <= middle.anchor_count < whole.anchor_count * 0.6
    # Each anchor of the middle is one of the whole scene, with the same features.
    rows = {row.tobytes() for row in np.hstack([whole.positions, whole.features])}
    assert {row.tobytes() for row in np.hstack([middle.positions, middle.features])} < rows
