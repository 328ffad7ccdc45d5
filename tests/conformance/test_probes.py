"""Probes: three decoders write the same numbers, and the first wrong one tells a planted bug's clause."""

import contextlib
import hashlib
import importlib
import io
import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from c_program import Program

import conformance
from conformance import cli, spec_decoder
from conformance.manifest import VECTORS
from conformance.runner import divergence, probes, traces
from conformance.runner.probes import Compared
from conformance.spec_decoder import program
from refcodec import statuses
from refcodec.bitstream.tables import tables_file
from refcodec.inspect.trace import symbol_trace

# Planes, packed positions, no planes, no inputs of F_h, escapes, raw bits, several slices and chunks.
FILES = [
    "tiny-example.c3gs",
    "valid/packed-positions.c3gs",
    "valid/planeless.c3gs",
    "valid/unencoded.c3gs",
    "valid/escapes-attributes.c3gs",
    "valid/raw-widths.c3gs",
    "valid/main.c3gs",
]
# What _second needs of a package beside its functions.
importlib.import_module(f"{spec_decoder.__name__}.watch")
EXAMPLE = (VECTORS / FILES[0]).read_bytes()


def _refcodec(data: bytes) -> str:
    lines: list[str] = []
    symbol_trace(data, lines.append, probes=True)
    return "".join(lines)


def _second(data: bytes, package: Any = spec_decoder) -> str:
    """What the second decoder, or a wrong one, writes until it ends."""
    file = io.StringIO()
    with package.watch.watched(file, probed=True), contextlib.suppress(package.C3GSError):
        package.decode(data)
    return file.getvalue()


def _probes(trace: str) -> list[str]:
    return sorted(line for line in trace.splitlines() if line.startswith("probe "))


def _compared(trace: str, data: bytes = EXAMPLE) -> Compared:
    return divergence.of_trace(data, trace.encode())[1]


@pytest.mark.parametrize("name", FILES)
def test_three_decoders_write_the_same_probes(name: str, c_decoder: Program, tmp_path: Path) -> None:
    """All numbers are there, and a trace without them is as it was."""
    data = (VECTORS / name).read_bytes()
    first, second = _refcodec(data), _second(data)
    ended = c_decoder.run("decode", VECTORS / name, tmp_path / "out", tmp_path / "probes")
    assert ended.returncode == 0, ended.stderr.decode()
    assert len(_probes(first)) > 5
    assert _probes(first) == _probes(second) == _probes((tmp_path / "probes").read_text())
    plain: list[str] = []
    symbol_trace(data, plain.append)
    for trace in (first, second):
        assert traces.symbols_digest(trace.encode()) == hashlib.sha256("".join(plain).encode()).hexdigest()
        symbol, compared = divergence.of_trace(data, trace.encode())
        assert symbol is None
        assert (compared.first, compared.fault, compared.right) == (None, "", len(_probes(first)))


def _wrong(folder: Path, old: str, new: str) -> Path:
    """The second decoder with a bug, as the package wrong_probes of a folder."""
    place = folder / "packages" / "wrong_probes"
    shutil.copytree(Path(spec_decoder.__file__).parent, place, ignore=shutil.ignore_patterns("__pycache__"))
    text = program.SPEC.read_text(encoding="utf-8")
    assert program.source(text).count(old) == 1
    (folder / "SPEC.md").write_text(text.replace(old, new), encoding="utf-8")
    # The decoder finds SPEC.md and the tables beside its package.
    (folder / "refcodec" / "data").mkdir(parents=True)
    shutil.copy(tables_file(), folder / "refcodec" / "data" / "tables-0.bin")
    return place.parent


# Of each bug old text, new text, the numbers that are wrong first, and their clauses.
BUGS = {
    "gamma": ("SINE_LENGTH // 4", "SINE_LENGTH // 8", "gamma", ("7.5.5",)),
    "shift of the frame": ('frame["shift"][r])', 'frame["shift"][r] + 1)', "v", ("7.5.1",)),
    "contraction": ("((2 * n - unit) * unit) // n", "(unit * unit) // n", "w", ("7.5.2",)),
    "clamp to the cube": ("1 << UNIT_BITS) for x, a", "(1 << UNIT_BITS) - 30000) for x, a", "u", ("7.5.3",)),
    "shift of samples": ("LERP_BITS - plane_shift", "LERP_BITS - plane_shift + 1", "samples.r1", ("7.5.4",)),
    "clamp of a layer": ("CLAMP(t, 0, ACTIVATION_MAX)", "CLAMP(t, 0, 3)", "means", ("7.2", "7.7")),
    "CARM is not added": ("hyper[n][c] + dm", "hyper[n][c] - dm", "slice.1.means", ("7.9",)),
    "clamp of steps": ("STEP_LENGTH - 1) for x", "STEP_LENGTH - 2) for x", "steps", ("7.8",)),
}
# SARM is a network too. Without planes F_h is the first one.
FILE_OF = {"clamp of a layer": "valid/planeless.c3gs"}


@pytest.mark.parametrize("bug", BUGS)
def test_the_first_wrong_number_tells_the_clause(bug: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new, name, clauses = BUGS[bug]
    monkeypatch.syspath_prepend(_wrong(tmp_path, old, new))
    try:
        package = importlib.import_module("wrong_probes")
        importlib.import_module("wrong_probes.watch")
        data = (VECTORS / FILE_OF.get(bug, FILES[0])).read_bytes()
        compared = _compared(_second(data, package), data)
    finally:
        for known in [known for known in sys.modules if known.partition(".")[0] == "wrong_probes"]:
            del sys.modules[known]
    assert (compared.first.name, compared.first.clauses) == (name, clauses)


def test_a_run_tells_the_first_wrong_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is in the summary, in the record and in the report, and the diagnosis begins with it."""
    place = _wrong(tmp_path, *BUGS["gamma"][:2])
    code = f"import sys; sys.path.insert(0, {str(place)!r}); from wrong_probes.__main__ import main; "
    code += "sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "decode", "{input}", "{output}", "--trace", "{trace}", "--probes"]
    options = ["--select", "valid-worked-example", "--slow", "20", "--report", str(tmp_path / "report")]
    assert cli.main(["run", *options, "--", *command]) == statuses.REJECTED
    line = "the first number that differs is gamma[1] of anchor 0: found 0, wanted 723 (SPEC 7.5.5)"
    printed = capsys.readouterr().out
    assert f"    probe: {line}\n" in printed
    assert f"\n{line}\n  read 7.5.5 (Positional encoding)" in printed
    record = json.loads((tmp_path / "report" / "report.json").read_text())
    wanted = {"name": "gamma", "anchor": 0, "index": 1, "found": 0, "wanted": 723, "clauses": ["7.5.5"]}
    assert record["vectors"][0]["probe"] == wanted
    assert record["diagnosis"]["text"][0] == line
    assert line in (tmp_path / "report" / "report.html").read_text()


def test_a_wrong_bug_in_c_is_told_though_the_file_is_refused(c_decoder: Program, tmp_path: Path) -> None:
    """What was written before an error is there."""
    file = tmp_path / "cut.c3gs"
    data = bytearray((VECTORS / FILES[1]).read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)
    ended = c_decoder.run("decode", file, tmp_path / "out", tmp_path / "probes")
    assert ended.returncode == 1
    compared = _compared((tmp_path / "probes").read_text(), (VECTORS / FILES[1]).read_bytes())
    assert (compared.first, compared.fault) == (None, "")
    assert compared.right > 0


HOSTILE = {
    "probe P[0] 1 nan 3\n": "not a probe: probe P[0] 1 nan 3",
    "probe P[0] 4194304 12582912\n": "P[0] has 2 numbers, 3 expected",
    "probe P[0] 1.5 2 3\n": "not a probe: probe P[0] 1.5 2 3",
    "probe colour[0] 1\n": "this file has no numbers colour; it has P, v, w, u",
    "probe P[5] 1 2 3\n": "there is no anchor 5: the file has 5",
    "probe P[9999999999] 1 2 3\n": "there is no anchor 9999999999",
    "probe P[0] 4194304 12582912 -4194304\n" * 2: "P[0] is repeated",
    "probe P[0] " + "1 " * (4 << 20) + "\n": "a probe of more than 65536 bytes",
    "probe " + "x" * 10_000 + "\n": "not a probe: probe xxxxxxxx",
    "probe \x1b[2J\n": "not a probe: probe \\x1b[2J",
    "probe \n": "not a probe: probe",
}


@pytest.mark.parametrize("trace", HOSTILE, ids=lambda text: text[:20])
def test_hostile_probes_are_told_in_one_line(trace: str) -> None:
    compared = _compared(trace)
    assert compared.first is None
    (line,) = compared.lines(symbol=False)
    assert line.isprintable()
    assert len(line) < 300
    assert HOSTILE[trace] in line
    assert traces.symbols_digest(trace.encode()) == hashlib.sha256().hexdigest()


def test_many_probes_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those behind the bound are not compared, and many wrong lines are one line of a report."""
    monkeypatch.setattr(probes, "PROBES", 50)
    compared = _compared("probe x\n" * 60 + "probe P[0] 0 0 0\n")
    assert (compared.first, compared.faults) == (None, 50)
    (line,) = compared.lines(symbol=False)
    assert line == "probe: line 1 of the trace: not a probe: probe x (50 lines are not valid probes)"


def test_what_is_behind_a_wrong_symbol_is_not_told() -> None:
    """It comes of the symbol. The probes before it are right, which is told."""
    right = _refcodec(EXAMPLE)
    head, _, tail = right.partition("attributes.scalings[0,0] ")
    trace = f"{head}attributes.scalings[0,0] 12345{tail[tail.index(chr(10)) :]}".replace("steps[0] 0", "steps[0] 1")
    symbol, compared = divergence.of_trace(EXAMPLE, trace.encode())
    assert symbol.element == "attributes.scalings[0,0]"
    assert compared.first is None
    (line,) = compared.lines(symbol=True)
    assert line == f"probe: the {head.count('probe ')} probes before the first wrong symbol are right"


def test_numbers_that_were_not_written_leave_doubt() -> None:
    """A number may be wrong by the clauses of those that it comes from."""
    first = _compared("probe u[0] 0 0 0\n").first
    assert first.clauses == ("7.5.3", "7.5.2", "7.5.1", "7.4")
    first = _compared("probe P[0] 4194304 12582912 -4194304\nprobe samples.r1[0] 0\n").first
    assert first.clauses == ("7.5.4", "7.3", "7.5.3", "7.5.2", "7.5.1")


def test_a_trace_without_probes_says_nothing_of_them() -> None:
    lines: list[str] = []
    symbol_trace(EXAMPLE, lines.append)
    symbol, compared = divergence.of_trace(EXAMPLE, "".join(lines).encode())
    assert symbol is None
    assert compared == Compared()
    # An empty trace lacks its first symbol.
    symbol, compared = divergence.of_trace(EXAMPLE, b"")
    assert symbol.found == "nothing"
    assert compared == Compared()


def test_the_manual_names_all_probes() -> None:
    """README.md has the names that the decoders write, and no other."""
    text = (Path(conformance.__file__).with_name("README.md")).read_text(encoding="utf-8")
    table = text.partition("### Probes")[2].partition("\n## ")[0]
    named = {name for row in re.findall(r"^\| (`.+?) \|", table, re.MULTILINE) for name in re.findall(r"`(.+?)`", row)}
    written = {line.split()[1].partition("[")[0] for line in _probes(_refcodec(EXAMPLE))}
    assert {name.replace(".I.", ".1.") for name in named} == written
