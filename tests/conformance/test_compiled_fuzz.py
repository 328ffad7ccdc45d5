"""The target of the fuzzer in C, and the command that runs it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from c_program import COMPILER, SANITIZERS

from conformance.cli.main import main
from conformance.fuzz import compiled
from conformance.manifest import VECTORS
from refcodec import statuses


@pytest.mark.no_cover
def test_the_vectors(tmp_path: Path) -> None:
    """The vectors, and what the mutator makes of them, give no difference and no report of a sanitizer."""
    if COMPILER is None:
        pytest.skip("there is no C compiler here")
    (tmp_path / "empty.c").write_text("int main(void) { return 0; }\n")
    tried = [COMPILER, *SANITIZERS, tmp_path / "empty.c", "-o", tmp_path / "empty"]
    if subprocess.run(tried, capture_output=True, check=False).returncode:
        pytest.skip("the compiler has no sanitizers here")
    program = tmp_path / "replay"
    subprocess.run(compiled.command(COMPILER, program, replay=True), check=True)
    # Every third vector: the others repeat the same code.
    files = sorted(VECTORS.rglob("*.c3gs"))[::3]
    ended = subprocess.run([program, *files], capture_output=True, text=True, check=False, env=compiled.environment())
    assert ended.returncode == 0, ended.stdout + ended.stderr


def _fake(state: Path, text: str) -> None:
    """A program in the place of the target."""
    path = state / "fuzz"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def test_runs_add_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = "echo '#8 pulse cov: 12 ft: 34 corp: 5/6Kb' >&2; echo 'stat::number_of_executed_units: 8' >&2"
    _fake(tmp_path, said)
    arguments = ["fuzz-c", "--hours", "0.001", "--state", str(tmp_path)]
    assert main(arguments) == statuses.DONE
    assert main(arguments) == statuses.DONE
    assert "16 inputs in 0.00 hours of all runs, 0 failed\n12 edges" in capsys.readouterr().out
    (tmp_path / f"crash-{40 * '0'}").touch()
    assert main(arguments) == statuses.REJECTED
    assert "1 failed" in capsys.readouterr().out


def test_a_program_that_does_not_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _fake(tmp_path, "exit 1")
    assert main(["fuzz-c", "--state", str(tmp_path)]) == statuses.REJECTED
    assert "status 1" in capsys.readouterr().out


def test_the_corpus_is_minimised(tmp_path: Path) -> None:
    """The fake keeps what begins with `a`."""
    _fake(tmp_path, 'for last; do before=$to; to=$last; done; cp "$to"/a* "$before"')
    (tmp_path / "corpus").mkdir()
    for name in ("a1", "a2", "b"):
        (tmp_path / "corpus" / name).touch()
    assert main(["fuzz-c", "--minimise", "--state", str(tmp_path)]) == statuses.DONE
    assert {path.name for path in (tmp_path / "corpus").iterdir()} == {"a1", "a2"}


def test_it_needs_a_compiler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert main(["fuzz-c", "--state", str(tmp_path)]) == statuses.USAGE
    assert "clang" in capsys.readouterr().err
    monkeypatch.setattr("shutil.which", lambda name: "false")
    assert main(["fuzz-c", "--state", str(tmp_path)]) == statuses.USAGE
    assert main(["fuzz-c", "--hours", "0", "--state", str(tmp_path)]) == statuses.USAGE
