"""The small suite, made once for all tests of the runner."""

from __future__ import annotations

import pytest
from small_suite import Suite, build


@pytest.fixture(scope="session")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    return build(tmp_path_factory.mktemp("suite"), tmp_path_factory.mktemp("answers"))
