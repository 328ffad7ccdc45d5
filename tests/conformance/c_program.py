"""The decoder in C (conformance/c), compiled, and its results for a file."""

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conformance.fuzz.compare import Verdict
from refcodec.bitstream import tables
from refcodec.bitstream.errors import REGISTRY

SOURCE = Path(__file__).resolve().parents[2] / "conformance" / "c" / "decoder.c"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
FLAGS = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror"]
SANITIZERS = ["-fsanitize=undefined,address", "-fno-sanitize-recover=all"]


@dataclass(frozen=True)
class Program:
    """A compiled decoder. folder: for what it reads and writes."""

    path: Path
    folder: Path

    def run(self, *arguments: str | Path, **options: Any) -> subprocess.CompletedProcess[bytes]:
        """Runs it, with the tables of refcodec. options: of subprocess.run."""
        environment = {**os.environ, "C3GS_TABLES": str(tables.tables_file()), **options.pop("env", {})}
        return subprocess.run(
            [self.path, *arguments], capture_output=True, check=False, env=environment, timeout=60, **options
        )

    def verdict(self, data: bytes, **options: Any) -> Verdict:
        """Its verdict on a file: name and offset of its error, or the digest and -1. options: of subprocess.run."""
        file = self.folder / "file.c3gs"
        file.write_bytes(data)
        return read(self.run("digest", file, **options))


def compiled(folder: Path, *, sanitizers: bool = True) -> Program:
    """Compiles the decoder. sanitizers: whether with them, if their libraries are here."""
    assert COMPILER is not None
    path = folder / "decoder"
    for flags in ([*FLAGS, *SANITIZERS], FLAGS) if sanitizers else (FLAGS,):
        ended = subprocess.run([COMPILER, *flags, SOURCE, "-o", path], capture_output=True, text=True, check=False)
        if not ended.returncode:
            return Program(path, folder)
    raise AssertionError(ended.stderr)


def read(ended: subprocess.CompletedProcess[bytes]) -> Verdict:
    """The verdict that a run of `decoder digest` ended with."""
    if ended.returncode == 0:
        return ended.stdout.split()[1].decode(), -1
    assert ended.returncode in (1, 2), ended.stderr.decode()
    refusal = json.loads(ended.stderr.splitlines()[-1])
    kind = REGISTRY[refusal["name"]]
    assert refusal["code"] == kind.code
    assert ended.returncode == (2 if kind.klass == "unsupported" else 1)
    return kind.name, refusal["offset"]
