"""A record of the lines that vectors reach, for the manual."""

from __future__ import annotations

from pathlib import Path

import pytest

from conformance.manifest import load
from spec import coverage


@pytest.fixture(scope="session")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a record in which the first two vectors reach each line that needs one."""
    suite, sites = load(), coverage.probed().sites
    names = [vector.id for vector in suite.vectors[:2]]
    path = tmp_path_factory.mktemp("record") / "coverage.json"
    path.write_text(coverage.record(sites, [[] if site.argued() else names for site in sites], suite), encoding="utf-8")
    return path
