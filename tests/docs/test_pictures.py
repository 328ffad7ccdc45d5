"""The pictures of the manual are small, and each has the command that made it. README.md's shows real bytes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import refcodec
from refcodec.bitstream.cameras import cameras, with_cameras
from refcodec.bitstream.codec import emit, parse

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"
SCENE = ROOT / "examples" / "scenes" / "caliterra.c3gs"


def test_every_picture_has_its_command() -> None:
    page = (PICTURES / "README.md").read_text(encoding="utf-8")
    pictures = [path for path in sorted(PICTURES.iterdir()) if path.suffix != ".md"]
    assert pictures
    for path in pictures:
        (row,) = [line for line in page.splitlines() if line.startswith(f"| [{path.name}]({path.name}) | `")]
        assert path.stat().st_size < 200_000, row


def test_the_bars_have_one_scale() -> None:
    pytest.importorskip("PIL")
    pytest.importorskip("numba")
    from docs.draw import BAR, COLOURS, GAP, LINE, Panel, grouped, picture  # noqa: PLC0415

    sizes = grouped(refcodec.decode(SCENE).sizes)
    assert sum(sizes.values()) == SCENE.stat().st_size
    assert set(sizes) == set(COLOURS)
    image = np.zeros((20, 200, 3), np.uint8)
    made = np.asarray(picture([Panel(image, "", {"attributes": 4000}), Panel(image, "", {"masks": 1000})]))
    row = made[GAP + 20 + GAP // 2 + LINE + BAR // 2]
    lengths = [int((row == COLOURS[name]).all(axis=1).sum()) for name in ("attributes", "masks")]
    assert lengths[0] == pytest.approx(200, abs=1)
    assert lengths[1] == pytest.approx(50, abs=1)


def test_the_picture_shows_the_file_of_the_examples() -> None:
    """What its right panel says is the length of a file that is here, with one camera as RESULTS.md has it: 134 KB."""
    scene = parse(SCENE.read_bytes()).scene
    assert scene.ancillary == with_cameras((), cameras(scene.ancillary))
    alone = emit(replace(scene, ancillary=with_cameras((), cameras(scene.ancillary)[:1])))
    assert f"{len(alone) / 1000:.0f} KB" == "134 KB"
