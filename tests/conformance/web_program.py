"""The decoder in WebAssembly and JavaScript, in a process that the tests ask."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from refcodec.bitstream.errors import REGISTRY

ROOT = Path(__file__).resolve().parents[2]
WEB = ROOT / "refcodec" / "web"
PROGRAM = WEB / "cli.js"
SERVER = Path(__file__).with_name("ask_web.mjs")
PACKAGE = json.loads((WEB / "package.json").read_text(encoding="utf-8"))
NODE = shutil.which("node")
MISSING = "there is no node here, so the decoder in WebAssembly is not tested"


class Decoder:
    """c3gs.js in a process that decodes one file after the other."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self._process, self._file = process, folder / "file.c3gs"

    def ask(self, data: bytes, way: str = "bytes", **more: Any) -> dict[str, Any]:
        """Returns what ask_web.mjs says of a file. A fault is none of its answers."""
        self._file.write_bytes(data)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps({"file": str(self._file), "way": way, **more}), file=self._process.stdin, flush=True)
        said: dict[str, Any] = json.loads(self._process.stdout.readline())
        assert "fault" not in said, said["fault"]
        return said

    def verdict(self, data: bytes, way: str = "bytes", **more: Any) -> tuple[str, int]:
        """As compare.first_verdict."""
        said = self.ask(data, way, **more)
        if "error" not in said:
            return said["scene"], -1
        error = said["error"]
        kind = REGISTRY[error["name"]]
        assert (error["code"], error["class"], error["clause"]) == (kind.code, kind.klass, kind.clause)
        return error["name"], error["offset"]


@contextlib.contextmanager
def running(folder: Path) -> Iterator[Decoder]:
    """Starts the process. folder: for the files that it decodes."""
    command = [str(NODE), str(SERVER)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Decoder(process, folder)
        assert process.stdin is not None
        process.stdin.close()
