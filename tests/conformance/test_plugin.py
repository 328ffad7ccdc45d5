"""The guide's decoders: the container in JavaScript, and the decoder in C by the suite's protocol."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_independent import faulty

from conformance import cli
from conformance.manifest import VECTORS, load
from conformance.runner import commands
from conformance.runner.selection import select
from refcodec.bitstream import tables
from refcodec.bitstream.errors import REGISTRY

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = ROOT / "examples" / "plugin-js"
GUIDE = (ROOT / "conformance" / "README.md").read_text(encoding="utf-8")
# What the plug-in checks, as the guide selects it.
SELECTED = "code:1*,2*,3*,401"
NODE = shutil.which("node")
COMPILER = shutil.which("cc")
needs_node = pytest.mark.skipif(
    NODE is None, reason="there is no node here, so the plug-in in JavaScript is not tested"
)
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


def _plugin(file: Path) -> subprocess.CompletedProcess[str]:
    command = [str(NODE), str(PLUGIN / "container.js"), str(file), "unused"]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


@needs_node
def test_the_plugin_passes_the_vectors_of_the_container(tmp_path: Path) -> None:
    options = ["--vectors", str(VECTORS), "--jobs", "2", "--slow", "20", "--report", str(tmp_path)]
    options += ["--describe", str(PLUGIN / "about.json")]
    command = [str(NODE), str(PLUGIN / "container.js"), "{input}", "{output}"]
    assert cli.main(["run", *options, "--select", SELECTED, "--", *command]) == commands.EXIT_RIGHT
    record = json.loads((tmp_path / "report.json").read_text())
    assert {v["status"] for v in record["vectors"]} == {"passed"}
    # It is not taken for a decoder.
    assert cli.main(["run", *options, "--select", "valid-plain", "--", *command]) == commands.EXIT_WRONG


@needs_node
@pytest.mark.parametrize("name", [kind.name for kind in REGISTRY.values() if kind.code < 400 or kind.code == 401])
@settings(max_examples=3)
@given(st.data())
def test_the_plugin_finds_each_fault(tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject) -> None:
    fault = data.draw(faulty(name))
    file = tmp_path_factory.mktemp("plugin") / "file.c3gs"
    file.write_bytes(fault.data)
    done = _plugin(file)
    said = json.loads(done.stderr.splitlines()[-1])
    assert (said["code"], said["offset"]) == (fault.kind.code, fault.offset)
    assert done.returncode == (2 if fault.kind.klass == "unsupported" else 1)


@needs_node
def test_the_plugin_lets_right_containers_through() -> None:
    for file in sorted((VECTORS / "valid").glob("*.c3gs")):
        assert _plugin(file).returncode == 3, file


def test_the_guide_selects_what_is_tested() -> None:
    assert (
        f"--select '{SELECTED}' --describe examples/plugin-js/about.json -- node examples/plugin-js/container.js"
        in GUIDE
    )


def test_every_selection_of_the_guide_selects_something() -> None:
    expressions = re.findall(r"--select '([^']+)'", GUIDE)
    assert len(expressions) > 5
    assert all(select(load().vectors, [expression]) for expression in expressions)


@needs_compiler
def test_the_decoder_in_c_passes_the_suite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "decoder"
    subprocess.run(
        [str(COMPILER), "-std=c11", "-O2", str(ROOT / "conformance" / "c" / "decoder.c"), "-o", str(program)],
        check=True,
    )
    monkeypatch.setenv("C3GS_TABLES", str(tables.tables_file()))
    command = [str(program), "decode", "{input}", "{output}"]
    assert (
        cli.main(["run", "--vectors", str(VECTORS), "--jobs", "2", "--slow", "20", "--", *command])
        == commands.EXIT_RIGHT
    )
    # A reconstruction that cannot be written is no success.
    full = subprocess.run(
        [program, "decode", VECTORS / "tiny-example.c3gs", "/dev/full"],
        check=False,
        capture_output=True,
        env=os.environ,
    )
    assert full.returncode == 3
