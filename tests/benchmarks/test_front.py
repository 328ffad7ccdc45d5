"""The table of README.md follows from RESULTS.md."""

from __future__ import annotations

import pytest

from benchmarks import front
from benchmarks.results import RESULTS

SECTION = """<!-- peers-200: begin -->
## Peers

### one, 200 pixels

| method | cap or lambda_r | seeds | bytes | PSNR, dB | SSIM | processor, s |
| --- | --- | --- | --- | --- | --- | --- |
| 3DGS, SPZ, 4000 steps | 4000 | 3 | 80,000 ± 222 | 30.00 ± 0.20 | 0.8 | 11 ± 0 |
| 3DGS, SPZ, 4000 steps | 8000 | 3 | 160,000 ± 222 | 31.00 ± 0.20 | 0.8 | 11 ± 0 |
| Scaffold-GS, 4000 steps | 0 | 3 | 4,831,061 ± 238,696 | 33.29 ± 0.07 | 0.9 | 83 ± 13 |

| PSNR, dB | 3DGS, SPZ, 4000 steps | 3DGS, SOG, 4000 steps | C3GS, 4000 steps | Scaffold-GS, 4000 steps |
| --- | --- | --- | --- | --- |
| 30.00 | 80.0 | 95.4, 0.84 | 26.4, 3.03 | beyond its 33.29 dB |
| 31.00 | 160.0 | 173.1, 0.92 | 40.0, 4.00 | beyond its 33.29 dB |
| 32.00 | 320.0 | beyond its 29.54 to 31.78 dB | 80.0, 4.00 | beyond its 33.29 dB |
| BD-rate |  | +9.2 % | -69.9 % | no answer |
<!-- peers-200: end -->
"""


def test_the_table_is_current() -> None:
    readme, results = (path.read_text(encoding="utf-8") for path in (front.README, RESULTS))
    assert front.current(readme, results) == readme


def test_a_row_is_that_of_the_section() -> None:
    """At the highest PSNR that all methods reach."""
    (row,) = front.rows(SECTION)
    assert row == front.Row("one", 31.0, 40.0, 160.0, 173.1, (4831061, 33.29))
    assert (
        front.lines([row])[-1]
        == "| one, 31.0 dB | **40 KB** | 160 KB, 4.0 times | 173 KB, 4.3 times | 4,831 KB at 33.3 dB |"
    )


def test_equal_quality_needs_a_curve_that_rises() -> None:
    falling = SECTION.replace("31.00 ± 0.20", "29.00 ± 0.20")
    with pytest.raises(front.FrontError):
        front.rows(falling)
    with pytest.raises(front.FrontError, match="lacks one of"):
        front.rows(SECTION.replace("C3GS", "D3GS"))
