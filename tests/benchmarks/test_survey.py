"""Rows for the survey of 3DGS compression: means over seeds, then over scenes."""

from __future__ import annotations

from typing import Any

from benchmarks.survey import HEAD, rows


def result(rate: float, psnr: float, size: int) -> dict[str, Any]:
    settings = {"rate": {"lambda_r": rate}}
    mean = {"psnr_3dgs": psnr, "ssim_3dgs": 0.9}
    return {"definition": {"settings": settings}, "mean": mean, "bytes": size, "anchors": 10}


def test_a_row_has_all_scenes() -> None:
    found = [
        ("one", "pro", result(0.004, 30, 100)),
        ("one", "pro", result(0.004, 32, 300)),
        ("two", "pro", result(0.004, 21, 1000)),
        ("one", "pro", result(0.015, 20, 10)),
        ("one", "static", result(0.004, 33, 200)),
        ("two", "static", result(0.004, 23, 400)),
        ("one", "uncompressed", result(0, 40, 9000)),
        ("two", "uncompressed", result(0, 40, 9000)),
        ("three", "static", result(0.004, 0, 0)),
    ]
    made = rows(found, ["one", "two"])
    assert all(len(row) == len(HEAD) for row in made)
    assert [row[:7] for row in made] == [
        ("c3gs", "-rate-0.004", "26.00", "0.900", "", "600", "10.0"),
        ("c3gs-static", "-rate-0.004", "28.00", "0.900", "", "300", "10.0"),
    ]
    assert made[0][-1] == "2 scenes, 1 seeds or more"
    assert not rows(found, ["one", "four"])
