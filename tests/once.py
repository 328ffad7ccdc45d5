"""What is made once for all processes of a run of tests."""

from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Returns a folder of this run that the first process fills, and the others wait for. make: fills it."""
    root = factory.getbasetemp()
    # Each process of pytest-xdist has a folder of its own in that of the run.
    place = (root.parent if root.name.startswith("popen-") else root) / name
    with FileLock(f"{place}.lock"):
        if not place.exists():
            partly = place.with_name(f"{name}.partly")
            partly.mkdir()
            make(partly)
            partly.rename(place)
    return place
