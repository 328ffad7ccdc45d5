"""The comparison of static scenes with the tables of RESULTS.md."""

from __future__ import annotations

import pytest

from benchmarks.peers.figures import Figure, Point, Scene
from benchmarks.results import RESULTS
from benchmarks.static import psnr_at, rows, shown


def point(size: float, psnr: float) -> Point:
    return Point(0.004, 1, Figure(size, None), Figure(psnr, None), Figure(0.9, None), Figure(10, None))


def test_the_section_of_peers_is_read() -> None:
    peers = shown(RESULTS.read_text())
    for scene in ("brighton_aerial", "caliterra", "playbot", "snowmiku"):
        for kind in ("C3GS", "3DGS, SPZ"):
            sizes = [p.bytes.mean for p in peers[scene, 200, kind]]
            assert len(sizes) >= 4
            assert sizes == sorted(sizes)
            assert all(5 < p.psnr.mean < 60 and p.seeds == 3 for p in peers[scene, 200, kind])


def test_rows() -> None:
    own, spz = [point(100, 30), point(400, 32)], [point(1000, 31), point(4000, 33)]
    peers = {("a", 200, "C3GS"): own, ("a", 200, "3DGS, SPZ"): spz, ("a", 400, "C3GS"): spz}
    assert psnr_at(own, 200) == pytest.approx(31)
    assert psnr_at(own, 99) is None
    found = rows([Scene("a", 200, {"static": [point(200, 32), point(900, 34)]})], peers)
    assert found[0][6:9] == ["+1.00", "2,000", "10.0"]
    assert found[1][6:9] == ["", "", ""]
