"""The guide's decoders: the container in JavaScript, and the decoder in C by the suite's protocol.

The plug-in is the container of the decoder for browsers, whose verdicts test_decoders.py has.
"""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from c_program import Program
from web_program import MISSING, NODE, asked

from conformance import cli
from conformance.manifest import VECTORS, load
from conformance.runner.selection import select
from refcodec import statuses
from refcodec.bitstream import tables

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "examples" / "plugin-js"
SERVER = Path(__file__).with_name("serve_container.mjs")
# A command may continue on a second line.
GUIDE = re.sub(r"\\\n *", "", (ROOT / "docs" / "decoder.md").read_text(encoding="utf-8"))
# What the plug-in checks, as the guide selects it.
SELECTED = "code:1*,2*,3*,40*"
# A few of these, of every class, for which it is started as the guide says.
STARTED = "code:1*,205,302,304"
needs_node = pytest.mark.skipif(NODE is None, reason=MISSING)


@pytest.fixture(scope="module")
def plugin() -> Iterator[Callable[[Path], dict[str, Any]]]:
    """What the plug-in answers to a file: status and stderr. One process serves all of them."""
    if NODE is None:
        pytest.skip(MISSING)
    with asked(SERVER) as ask:
        yield lambda file: ask({"input": str(file), "output": "unused"})


@pytest.mark.slow
@needs_node
def test_the_plugin_passes_the_vectors_of_the_container(tmp_path: Path) -> None:
    options = ["--vectors", str(VECTORS), "--jobs", "2", "--slow", "20", "--report", str(tmp_path)]
    options += ["--describe", str(PLUGIN / "about.json")]

    def run(selected: str, *command: str) -> tuple[int, set[str]]:
        status = cli.main(["run", *options, "--select", selected, *command])
        record = json.loads((tmp_path / "report.json").read_text())
        return status, {v["status"] for v in record["vectors"]}

    command = ["--", str(NODE), str(PLUGIN / "container.js"), "{input}", "{output}"]
    assert run(SELECTED, "--serve", "--", str(NODE), str(SERVER)) == (statuses.DONE, {"passed"})
    assert run(STARTED, *command) == (statuses.DONE, {"passed"})
    # It is not taken for a decoder.
    assert run("valid-plain", *command)[0] == statuses.REJECTED


@needs_node
def test_the_plugin_lets_right_containers_through(plugin: Callable[[Path], dict[str, Any]]) -> None:
    files = sorted((VECTORS / "valid").glob("*.c3gs"))
    assert len(files) > 100
    for file in files:
        assert plugin(file)["status"] == 3, file


def test_the_guide_selects_what_is_tested() -> None:
    assert (
        f"--select '{SELECTED}' --describe examples/plugin-js/about.json -- node examples/plugin-js/container.js"
        in GUIDE
    )


def test_every_selection_of_the_guide_selects_something() -> None:
    expressions, suite = re.findall(r"--select '([^']+)'", GUIDE), load()
    assert len(expressions) > 5
    assert all(select(suite.vectors, [expression]) for expression in expressions)


@pytest.mark.slow
@pytest.mark.no_cover
def test_the_decoder_in_c_passes_the_suite(c_decoder: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    """With sanitizers, whose reports are crashes."""
    monkeypatch.setenv("C3GS_TABLES", str(tables.tables_file()))
    command = [str(c_decoder.path), "decode", "{input}", "{output}"]
    assert cli.main(["run", "--vectors", str(VECTORS), "--jobs", "2", "--slow", "20", "--", *command]) == statuses.DONE
