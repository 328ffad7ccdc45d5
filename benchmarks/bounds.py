"""Peak memory of each command that takes a file, under a bound: python -m benchmarks.bounds writes a section.

The files claim much memory with few bytes: the length of a section or a chunk is far above the bound, or just below it.
Each file is given by name, by a pipe and by URL.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from conformance.cases.checksums import lengthened

from .resident import usage
from .results import ROOT, machine, mib, table, write_section

EXAMPLE, TRAINED = ROOT / "vectors" / "tiny-example.c3gs", ROOT / "vectors" / "valid" / "trained-snowmiku.c3gs"
BOUND = 200 << 20
# Lengths of a section or a chunk: above the bound, and just below it.
LENGTHS = (1500 << 20, 20 << 20)
KINDS = ("PLNS", "mETa", "DATA")
COMMANDS = (
    *(
        "validate FILE",
        "decode FILE -o OUT",
        "decode FILE -o OUT --chunks 0:1",
        "inspect FILE",
        "inspect FILE --decode",
    ),
    *("inspect FILE --hex", "inspect FILE --html OUT.html", "render FILE -o OUT", "export FILE -o OUT.ply"),
)
# These commands draw valid files. They get no valid file, because the bound does not include images.
DRAWING = ("render", "export")
# Runs a command on each file in turn, and prints the exit statuses after a mark.
_PROGRAM = """
import gc, os, sys
from refcodec.cli.main import main
words, statuses, out = sys.argv[1].split(), set(), os.dup(1)
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
for place in sys.argv[2:]:
    statuses.add(main([place if word == "FILE" else word for word in words]))
    gc.collect()
os.write(out, " ".join(map(str, sorted(statuses))).encode())
"""


class _Handler(BaseHTTPRequestHandler):
    """Answers range requests for the files of a folder."""

    protocol_version = "HTTP/1.1"
    server: _Server

    def log_message(self, *_: object) -> None:
        """Logs nothing."""

    def do_GET(self) -> None:
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        assert asked
        path = self.server.folder / Path(self.path).name
        size = path.stat().st_size
        first, end = int(asked[1]), min(int(asked[2]) + 1, size)
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{end - 1}/{size}")
        self.send_header("Content-Length", str(end - first))
        self.end_headers()
        with path.open("rb") as file:
            file.seek(first)
            while first < end:
                first += self.wfile.write(file.read(min(1 << 20, end - first)))


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    folder: Path

    def handle_error(self, *_: object) -> None:
        """Ignores clients that disconnect."""


@contextlib.contextmanager
def _served(folder: Path) -> Iterator[str]:
    """Serves a folder, and yields the address."""
    with _Server(("127.0.0.1", 0), _Handler) as web:
        web.folder = folder
        threading.Thread(target=web.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{web.server_address[1]}"
        web.shutdown()


def _files(folder: Path) -> list[Path]:
    (folder / "valid").write_bytes(TRAINED.read_bytes())
    for kind in KINDS:
        for length in LENGTHS:
            head, size = lengthened(EXAMPLE.read_bytes(), kind.encode(), length)
            path = folder / f"{kind}-{length >> 20}"
            path.write_bytes(head)
            os.truncate(path, size)
    return sorted(folder.iterdir())


def peak(task: str, files: list[Path], url: str, way: str) -> tuple[int, list[str]]:
    """Returns the peak resident memory of a process that runs a command on each file, and its exit statuses.

    way: `name`, `pipe` or `URL`.
    """
    chosen = [path for path in files if path.name != "valid" or task.split(maxsplit=1)[0] not in DRAWING]
    with tempfile.TemporaryDirectory() as out, contextlib.ExitStack() as writers:
        places = [f"{url}/{path.name}" if way == "URL" else str(path) for path in chosen]
        if way == "pipe":
            places = [f"{out}/pipe-{path.name}" for path in chosen]
            for place, path in zip(places, chosen, strict=True):
                os.mkfifo(place)
                writer = subprocess.Popen(["sh", "-c", 'exec cat "$0" > "$1"', path, place], stderr=subprocess.DEVNULL)
                writers.callback(writer.wait)
                writers.callback(writer.kill)
        words = f"{task.replace('OUT', f'{out}/out')} --max-memory {BOUND}"
        spent = usage([sys.executable, "-c", _PROGRAM, words, *places])
    return spent.peak, spent.printed.split()


def main() -> None:
    """Measures, and writes the section."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        files = _files(Path(name))
        with _served(Path(name)) as url:
            for task in COMMANDS:
                peaks = [peak(task, files, url, way) for way in ("name", "pipe", "URL")]
                statuses = sorted({status for _, own in peaks for status in own}, key=int)
                rows.append([f"`{task}`", *(mib(most) for most, _ in peaks), mib(BOUND), ", ".join(statuses)])
                print(*rows[-1], sep="  ", flush=True)
    lines = [
        "`python -m benchmarks.bounds`",
        "",
        machine(),
        f"{len(files)} files: one is valid, others claim {LENGTHS[0] >> 20} or {LENGTHS[1] >> 20} MiB for a section",
        "or a chunk. Commands that draw do not get the valid one. MiB: the peak resident memory of a process that",
        "takes all files in turn. Status 64: a bound is exceeded. Status 1: a verdict.",
        "",
        *table(["task", "by name", "by pipe", "by URL", "bound", "statuses"], rows),
    ]
    write_section("bounds", "Memory under a bound", lines)


if __name__ == "__main__":
    main()
