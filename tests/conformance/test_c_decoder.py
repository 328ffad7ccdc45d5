"""The decoder in C (conformance/c): it gives what refcodec gives, and the compiler's sanitizers are silent."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_independent import faulty

from conformance.fuzz import compare
from refcodec.bitstream import codec, reconstruction, tables
from refcodec.bitstream.errors import REGISTRY

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "conformance" / "c" / "decoder.c"
TABLES = Path(str(tables.tables_file()))
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
FLAGS = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror"]
SANITIZERS = ["-fsanitize=undefined,address", "-fno-sanitize-recover=all"]

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


@pytest.fixture(scope="module")
def decode(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes], compare.Verdict]:
    """The verdict of the C decoder on a file."""
    folder = tmp_path_factory.mktemp("c")
    program, file = folder / "decoder", folder / "file.c3gs"
    with_sanitizers = [str(COMPILER), *FLAGS, *SANITIZERS, str(SOURCE), "-o", str(program)]
    if subprocess.run(with_sanitizers, capture_output=True, check=False).returncode:
        # Their libraries are a package of their own in places.
        subprocess.run([str(COMPILER), *FLAGS, str(SOURCE), "-o", str(program)], check=True)
    names = {kind.code: kind.name for kind in REGISTRY.values()}

    def verdict(data: bytes) -> compare.Verdict:
        file.write_bytes(data)
        environment = {**os.environ, "C3GS_TABLES": str(TABLES)}
        result = subprocess.run(
            [program, "digest", file], capture_output=True, text=True, check=False, env=environment, timeout=60
        )
        if result.returncode == 0:
            return result.stdout.split()[1], -1
        assert result.returncode in (1, 2), result.stderr
        found = json.loads(result.stderr.splitlines()[-1])
        assert result.returncode == (2 if REGISTRY[names[found["code"]]].klass == "unsupported" else 1)
        return names[found["code"]], found["offset"]

    return verdict


@pytest.mark.no_cover
@pytest.mark.parametrize("name", REGISTRY)
@settings(max_examples=3)
@given(st.data())
def test_fault(decode: Callable[[bytes], compare.Verdict], name: str, data: st.DataObject) -> None:
    fault = data.draw(faulty(name))
    assert decode(fault.data) == (name, fault.offset)


@pytest.mark.slow
@pytest.mark.no_cover
@given(compare.families())
@settings(max_examples=10)
def test_it_agrees(
    decode: Callable[[bytes], compare.Verdict], made: list[tuple[bytes, compare.Verdict | None]]
) -> None:
    for data, _ in made:
        assert decode(data) == compare.first_verdict(data)


def test_the_example(decode: Callable[[bytes], compare.Verdict]) -> None:
    data = (ROOT / "vectors" / "tiny-example.c3gs").read_bytes()
    assert decode(data) == (reconstruction.digest(codec.parse(data).scene)[0], -1)
