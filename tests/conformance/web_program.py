"""The decoder in WebAssembly and JavaScript, in a process that the tests ask."""

import contextlib
import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from refcodec.bitstream.errors import REGISTRY

ROOT = Path(__file__).resolve().parents[2]
WEB = ROOT / "refcodec" / "web"
PROGRAM = WEB / "cli.js"
SERVER = Path(__file__).with_name("ask_web.mjs")
PACKAGE = json.loads((WEB / "package.json").read_text(encoding="utf-8"))
NODE = shutil.which("node")
MISSING = "there is no node here, so the programs in JavaScript are not tested"


@contextlib.contextmanager
def asked(program: Path) -> Iterator[Callable[[Any], Any]]:
    """Starts a program of Node that answers each line of JSON with another. Yields a function that asks it."""
    with subprocess.Popen([str(NODE), program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        asks, answers = process.stdin, process.stdout
        assert asks is not None
        assert answers is not None

        def ask(question: Any) -> Any:
            print(json.dumps(question), file=asks, flush=True)
            return json.loads(answers.readline())

        yield ask
        asks.close()


class Decoder:
    """c3gs.js in a process that decodes one file after the other. ask: of `asked`."""

    def __init__(self, ask: Callable[[Any], Any], folder: Path) -> None:
        self._ask, self._file = ask, folder / "file.c3gs"

    def ask(self, data: bytes, way: str = "bytes", **more: Any) -> dict[str, Any]:
        """Returns what ask_web.mjs says of a file. A fault is none of its answers."""
        self._file.write_bytes(data)
        answer: dict[str, Any] = self._ask({"file": str(self._file), "way": way, **more})
        assert "fault" not in answer, answer["fault"]
        return answer

    def verdict(self, data: bytes, way: str = "bytes", **more: Any) -> tuple[str, int]:
        """As compare.first_verdict."""
        answer = self.ask(data, way, **more)
        if "error" not in answer:
            return answer["scene"], -1
        error = answer["error"]
        kind = REGISTRY[error["name"]]
        assert (error["code"], error["class"], error["clause"]) == (kind.code, kind.klass, kind.clause)
        return error["name"], error["offset"]


@contextlib.contextmanager
def running(folder: Path) -> Iterator[Decoder]:
    """Starts the process. folder: for the files that it decodes."""
    with asked(SERVER) as ask:
        yield Decoder(ask, folder)
