"""The decoder in C (conformance/c) as a program: a pipe, its usage, and other tables. test_decoders.py has the
verdicts."""

import subprocess
from pathlib import Path

import pytest
from c_program import Program
from hostile_files import FILES, SCENES

from refcodec import statuses
from refcodec.bitstream import reconstruction


def test_a_pipe_is_read(c_decoder: Program) -> None:
    """Nothing is sought, so bytes may arrive one after the other."""
    piped = c_decoder.run("digest", "/dev/stdin", input=FILES["raw"])
    assert piped.stdout.split()[1].decode() == reconstruction.digest(SCENES["raw"])[0]
    assert c_decoder.run("digest", "/dev/stdin", input=FILES["raw"][:-1]).returncode == statuses.REJECTED


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("digest",),
        ("encode", "file.c3gs"),
        ("decode", "file.c3gs"),
        ("digest", "nothing.c3gs"),
        ("digest", "."),
        ("decode", "file.c3gs", "nowhere/output"),
        ("decode", "file.c3gs", "/dev/full"),
        ("decode", "/dev/stdin", "output"),
    ],
)
def test_wrong_usage(c_decoder: Program, arguments: tuple[str, ...]) -> None:
    (c_decoder.folder / "file.c3gs").write_bytes(FILES["raw"])
    with subprocess.Popen(["cat", "file.c3gs"], stdout=subprocess.PIPE, cwd=c_decoder.folder) as pipe:
        ended = c_decoder.run(*arguments, cwd=c_decoder.folder, stdin=pipe.stdout)
    assert ended.returncode == statuses.USAGE
    assert ended.stderr.startswith(b"decoder: ")
    assert ended.stdout == b""


@pytest.mark.parametrize("tables", [b"", bytes(99840), bytes(200000)])
def test_other_tables(c_decoder: Program, tmp_path: Path, tables: bytes) -> None:
    file = tmp_path / "tables-0.bin"
    file.write_bytes(tables)
    (c_decoder.folder / "file.c3gs").write_bytes(FILES["raw"])
    for path in (file, tmp_path / "none"):
        ended = c_decoder.run("digest", c_decoder.folder / "file.c3gs", env={"C3GS_TABLES": str(path)})
        assert ended.returncode == statuses.USAGE
