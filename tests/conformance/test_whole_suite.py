"""The project's own decoders on the whole suite, through the runner."""

from __future__ import annotations

import sys

import pytest

from conformance import cli
from conformance.manifest import VECTORS
from conformance.runner import commands

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("refcodec", ["--gaussians", f"{sys.executable} -m refcodec gaussians {{input}} {{camera}} {{output}}"]),
        ("independent", []),
    ],
)
def test_it_passes(name: str, more: list[str]) -> None:
    options = ["--vectors", str(VECTORS), "--jobs", "2", "--slow", "4", "--serve", *more]
    assert (
        cli.main(["run", *options, "--trace", "--", sys.executable, "-m", "conformance.runner.serve", name])
        == commands.EXIT_RIGHT
    )
