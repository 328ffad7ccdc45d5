"""A browser for the tests of the viewer, a trained scene, and its photographs."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.chromium import Chromium, find

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def browser() -> Iterator[Chromium]:
    """A browser that cannot reach any network."""
    program = find()
    if program is None:
        pytest.skip("there is no Chromium here, so the page is not opened")
    with Chromium(program, 640, 480) as opened:
        yield opened


@pytest.fixture(scope="session")
def trained() -> Path:
    """The file of a trained scene."""
    return ROOT / "vectors" / "valid" / "trained-caliterra.c3gs"


@pytest.fixture(scope="session")
def photographs() -> Path:
    """The photographs that it was trained with."""
    return ROOT / "examples" / "photographs" / "caliterra"
