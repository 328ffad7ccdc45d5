"""The second decoder (conformance/spec_decoder): its traces, its command, and what it is made of.

test_decoders.py compares it with the others.
"""

from __future__ import annotations

import ast
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest
from hostile_files import FILES

from conformance import spec_decoder
from conformance.cases.checksums import repair
from conformance.cases.target import Target
from conformance.spec_decoder import __main__ as second_main
from conformance.spec_decoder.watch import watched
from refcodec import statuses
from refcodec.bitstream import codec, reconstruction
from refcodec.inspect.trace import symbol_trace
from spec import decoder

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted((ROOT / "conformance" / "spec_decoder").glob("*.py"))
EXAMPLE = ROOT / "vectors" / "tiny-example.c3gs"


def test_traces() -> None:
    """Both decoders write the same lines, and of a file that is refused what comes before the fault."""
    data = FILES["packed"]
    first: list[str] = []
    second = io.StringIO()
    symbol_trace(data, first.append)
    with watched(second):
        spec_decoder.decode(data)
    assert "".join(first) == second.getvalue()
    places = ["weights", "planes", "masks[0", "attributes.scalings[0", "attributes.offsets[0", "attributes.features[0"]
    starts = [second.getvalue().index("\n" + place) if n else 0 for n, place in enumerate(places)]
    assert second.getvalue().startswith("weights")
    assert starts == sorted(starts)
    # Chunk after chunk: the masks of the second one come behind the attributes of the first one.
    assert second.getvalue().index("\nmasks[4,0]") > second.getvalue().rindex("\nattributes.features[3,")
    cut = io.StringIO()
    with pytest.raises(spec_decoder.C3GSError), watched(cut):
        spec_decoder.decode(data[:-1])
    assert second.getvalue().startswith(cut.getvalue())
    assert "attributes.features[3," in cut.getvalue()


# --- what it is made of -----------------------------------------------------------------------------------------------


def test_it_imports_the_standard_library_alone() -> None:
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                assert name.partition(".")[0] in sys.stdlib_module_names, f"{path.name} imports {name}"


def test_it_is_what_the_specification_says() -> None:
    """`python -m spec` would write the same file."""
    assert [made.path.name for made in decoder.made() if made.is_current()] == ["blocks.py"]


# --- its command ------------------------------------------------------------------------------------------------------


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole, parts = reconstruction.digest(codec.parse(EXAMPLE.read_bytes()).scene)

    def command(*arguments: str | Path) -> tuple[int, str, str]:
        status = second_main.main([str(argument) for argument in arguments])
        return status, *capsys.readouterr()

    assert command("digest", EXAMPLE) == (0, f"whole  {whole}\n", "")
    status, out, _ = command("digest", "--parts", EXAMPLE)
    assert (status, dict(line.split() for line in out.splitlines())) == (0, {"whole": whole, **parts})
    assert command("validate", EXAMPLE) == (0, "", "")
    output = tmp_path / "output"
    assert command("decode", EXAMPLE, output) == (0, "", "")
    scene = codec.parse(EXAMPLE.read_bytes()).scene
    wanted = reconstruction.digested(scene) + b"".join(part for _, part in reconstruction.canonical_parts(scene))
    assert output.read_bytes() == wanted
    bad = tmp_path / "bad.c3gs"
    bad.write_bytes(EXAMPLE.read_bytes()[:-1])
    status, _, err = command("validate", bad)
    assert (status, json.loads(err.splitlines()[-1])["code"]) == (statuses.REJECTED, 311)
    bad.write_bytes(repair(Target(EXAMPLE.read_bytes()).put(20, b"\7")))
    assert command("digest", bad)[0] == statuses.UNSUPPORTED
    for wrong in ((), ("validate", tmp_path / "none"), ("decode", EXAMPLE, tmp_path / "none" / "output")):
        status, out, err = command(*wrong)
        assert (status, out) == (statuses.USAGE, "")
        assert err


def test_its_statuses_are_those_of_the_project() -> None:
    """It may not import them."""
    own = second_main.REJECTED, second_main.UNSUPPORTED, second_main.USAGE_ERROR
    assert own == (statuses.REJECTED, statuses.UNSUPPORTED, statuses.USAGE)


def test_command_in_a_process_of_its_own() -> None:
    words = [sys.executable, "-m", "conformance.spec_decoder", "digest", EXAMPLE]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"whole  {reconstruction.digest(codec.parse(EXAMPLE.read_bytes()).scene)[0]}\n"
    assert subprocess.run(words[:3], capture_output=True, check=False, cwd=ROOT).returncode == statuses.USAGE
