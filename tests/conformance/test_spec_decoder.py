"""The second decoder (conformance/spec_decoder): its traces, its command, and what it is made of.

test_decoders.py compares it with the others.
"""

import ast
import io
import json
import os
import re
import shutil
import subprocess
import sys
import traceback
from pathlib import Path

import pytest
from hostile_files import FILES

from conformance import spec_decoder
from conformance.cases.checksums import repair
from conformance.cases.target import Target
from conformance.spec_decoder import __main__ as second_main
from conformance.spec_decoder import program, support
from conformance.spec_decoder.watch import watched
from refcodec import statuses
from refcodec.bitstream import codec, reconstruction
from refcodec.inspect.trace import symbol_trace

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


def test_its_lines_are_those_of_the_specification() -> None:
    """Each line of a block is at its place, and each row of a table, in tracebacks too."""
    lines = program.SPEC.read_text(encoding="utf-8").splitlines()
    made = program.source("\n".join(lines)).splitlines()
    blocks = re.findall(r"^```python\n(.*?)\n```$", "\n".join(lines), re.DOTALL | re.MULTILINE)
    in_place = [line for line, own in zip(made, lines, strict=False) if line and line == own]
    assert in_place == [line for block in blocks for line in block.splitlines() if line]
    row = next(i for i, line in enumerate(lines) if line.startswith("| RAW_MAX | 16 |"))
    assert made[row] == "RAW_MAX = 16"
    with pytest.raises(ZeroDivisionError) as caught:
        program.blocks.RESCALE({"low": [0], "high": [0]}, [1])
    last = traceback.extract_tb(caught.value.__traceback__)[-1]
    assert last.filename == str(program.SPEC)
    assert last.line == lines[(last.lineno or 0) - 1].strip()


def test_a_changed_specification_is_compiled_again(tmp_path: Path) -> None:
    """Compiled code is kept, but never used for another SPEC.md."""
    shutil.copytree(SOURCES[0].parent, tmp_path / "second", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path.parent / "refcodec" / "data").mkdir(parents=True)
    shutil.copy(support.TABLES, tmp_path.parent / "refcodec" / "data")
    text = program.SPEC.read_text(encoding="utf-8")
    for minor in "00374":
        (tmp_path.parent / "SPEC.md").write_text(text.replace("| MINOR | 0 |", f"| MINOR | {minor} |"))
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        words = [sys.executable, "-c", "import second; print(second.blocks.MINOR)"]
        ended = subprocess.run(words, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True)
        assert ended.stdout == f"{minor}\n"
        assert list((tmp_path.parent / "__pycache__").glob("SPEC.*.pyc"))


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
