"""The target of the fuzzer in C: the vectors, and what its mutator makes of them, give no difference and no report."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from c_program import COMPILER, SANITIZERS

from conformance.fuzz import compiled
from conformance.manifest import VECTORS


@pytest.mark.no_cover
def test_the_vectors(tmp_path: Path) -> None:
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
