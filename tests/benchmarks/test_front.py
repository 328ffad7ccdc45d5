"""The table of README.md follows from RESULTS.md."""

from __future__ import annotations

import pytest

from benchmarks import front
from benchmarks.results import RESULTS

SECTION = """<!-- peers-200: begin -->
## Peers

### one, 200 pixels

| PSNR, dB | 3DGS, SPZ, 4000 steps | 3DGS, SOG, 4000 steps | C3GS, 4000 steps | C3GS, static, 4000 steps |
| --- | --- | --- | --- | --- |
| 30.00 | 80.0 | 95.4, 0.84 | 26.4, 3.03 | 20.0, 4.00 |
| 31.00 | 160.0 | 173.1, 0.92 | 40.0, 4.00 | beyond its 30.29 dB |
| 32.00 | 320.0 | beyond its 29.54 to 31.78 dB | beyond its 31.29 dB | beyond its 30.29 dB |
| BD-rate |  | +9.2 % | -69.9 % | no answer |

### two, 200 pixels

<!-- peers-200: end -->
"""


def test_the_table_is_current() -> None:
    readme, results = (path.read_text(encoding="utf-8") for path in (front.README, RESULTS))
    assert front.current(readme, results) == readme


def test_a_row_is_that_of_the_section() -> None:
    """At the highest PSNR that a scene of C3GS reaches; a scene without one has no row."""
    (row,) = front.rows(SECTION)
    assert row == front.Row("one", 31.0, (40.0, None), 160.0)
    assert front.lines([row])[-1] == "| one, 31.0 dB | **40 KB**, 4.0 times smaller | - | 160 KB |"


def test_it_needs_a_scene() -> None:
    with pytest.raises(front.FrontError):
        front.rows(SECTION.replace("C3GS", "D3GS"))
