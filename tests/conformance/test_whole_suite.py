"""The project's own decoders on the suite, through the runner."""

import sys
from pathlib import Path

import pytest

from conformance import cli
from conformance.manifest import VECTORS, load
from refcodec import statuses

# test_vectors has the second decoder decode the others.
LONG = [v.id for v in load().vectors if v.operation == "decode" and v.budget.seconds > 10]


def run(name: str, *options: str) -> int:
    """The status of a run with traces, of one of the project's decoders."""
    serving = [sys.executable, "-m", "conformance.runner.serve", name]
    shared = ["--vectors", str(VECTORS), "--jobs", "2", "--slow", "4", "--serve", "--trace"]
    return cli.main(["run", *shared, *options, "--", *serving])


@pytest.mark.slow
@pytest.mark.no_cover
def test_refcodec_passes_the_suite(tmp_path: Path) -> None:
    program = f"{sys.executable} -m refcodec"
    commands = {"gaussians": "gaussians {input} {camera}", "render": "render {input} --cameras {camera} -o"}
    options = [word for name, rest in commands.items() for word in (f"--{name}", f"{program} {rest} {{output}}")]
    assert run("refcodec", *options, "--report", str(tmp_path / "report")) == statuses.DONE
    assert "the reference image" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.no_cover
def test_the_second_decoder_passes_the_longest_vectors() -> None:
    assert len(LONG) > 3
    assert run("spec_decoder", "--select", f"id:{','.join(LONG)}") == statuses.DONE
