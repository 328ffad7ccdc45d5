"""Peak memory of each command and method that takes a file, under a bound: python -m benchmarks.bounds

It writes a section of RESULTS.md. The files claim much memory with few bytes: the length of a section or a chunk is far
above the bound, or just below it. Each file is given by name, by a pipe and by URL.
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
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from conformance.cases.checksums import lengthened
from refcodec.cli.bounds import PROGRAM

from .results import machine, mib, table, write_section

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE, TRAINED = ROOT / "vectors" / "tiny-example.c3gs", ROOT / "vectors" / "valid" / "trained-snowmiku.c3gs"
BOUND = 200 << 20
# Lengths of a section or a chunk: above the bound, and just below it.
LENGTHS = (1500 << 20, 20 << 20)
KINDS = ("PLNS", "mETa", "DATA")
COMMANDS = (
    "validate FILE",
    "digest FILE",
    "decode FILE -o OUT",
    "decode FILE -o OUT --chunks 0:1",
    "reconstruct FILE OUT",
    "inspect FILE",
    "inspect FILE --decode",
    "inspect FILE --hex",
    "inspect FILE --trace",
    "inspect FILE --anchor 0",
    "inspect FILE --html OUT.html",
    "render FILE -o OUT",
    "eval FILE examples/photographs/caliterra --size 48",
    "export FILE -o OUT.ply",
    "export FILE -o OUT.html",
    "export FILE --scaffold -o OUT",
)
# These commands draw valid files. They get no valid file, because the bound does not include images.
DRAWING = ("render", "eval", "export")
METHODS = (
    "refcodec.decode(place, max_memory=most)",
    "refcodec.open(place, max_memory=most).decode()",
    "list(refcodec.open(place, max_memory=most).chunks())",
    "list(refcodec.open(place, max_memory=most).chunks(range(1)))",
    "refcodec.open(place, max_memory=most).sizes",
    "refcodec.open(place, max_memory=most).metadata",
    "refcodec.open(place, max_memory=most)._repr_html_()",
)
# Runs a task on each file in turn, and prints the exit statuses and the peak memory.
_COMMAND = """
import gc, sys
from benchmarks.resident import resident
from refcodec.cli.main import main
words, statuses = sys.argv[1].split(), set()
for place in sys.argv[2:]:
    statuses.add(main([place if word == "FILE" else word for word in words]))
    gc.collect()
print(*sorted(statuses), resident(), file=sys.stderr)
"""
_METHOD = """
import gc, sys, refcodec
from benchmarks.resident import resident
most, statuses = int(sys.argv[1]), set()
for place in sys.argv[2:]:
    try:
        {}
        statuses.add(0)
    except refcodec.BoundPassedError:
        statuses.add(64)
    except refcodec.BitstreamError as error:
        statuses.add(error.exit_status)
    gc.collect()
print(*sorted(statuses), resident(), file=sys.stderr)
"""


@contextmanager
def _served(folder: Path) -> Iterator[str]:
    """Serves a folder, with range requests, and yields the address."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None:
            pass

        def do_GET(self) -> None:
            asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
            assert asked
            path = folder / Path(self.path).name
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

    class Quiet(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: object) -> None:
            """Ignores clients that disconnect."""

    with Quiet(("127.0.0.1", 0), Handler) as web:
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


def _worst(task: str, files: list[Path], url: str, way: str) -> tuple[int, set[int]]:
    """Returns the peak resident memory of a process that runs a task on each file, and its exit statuses."""
    chosen = [path for path in files if path.name != "valid" or task.split(maxsplit=1)[0] not in DRAWING]
    with tempfile.TemporaryDirectory() as out, contextlib.ExitStack() as writers:
        places = [str(path) for path in chosen]
        if way == "URL":
            places = [f"{url}/{path.name}" for path in chosen]
        elif way == "pipe":
            places = [f"{out}/pipe-{path.name}" for path in chosen]
            for place, path in zip(places, chosen, strict=True):
                os.mkfifo(place)
                writer = subprocess.Popen(["sh", "-c", 'exec cat "$0" > "$1"', path, place], stderr=subprocess.DEVNULL)
                writers.callback(writer.wait)
                writers.callback(writer.kill)
        program, most = _COMMAND, f"{task.replace('OUT', f'{out}/out')} --max-memory {BOUND}"
        if task in METHODS:
            program, most = _METHOD.format(task), str(BOUND - PROGRAM)
        done = subprocess.run(
            [sys.executable, "-c", program, most, *places],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            check=True,
        )
    *statuses, highest = map(int, done.stderr.splitlines()[-1].split())
    return highest, set(statuses)


def section() -> list[str]:
    """Returns the lines of the section."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "files").mkdir()
        files = _files(Path(name) / "files")
        with _served(Path(name) / "files") as url:
            for task in (*COMMANDS, *METHODS):
                found = [_worst(task, files, url, way) for way in ("name", "pipe", "URL")]
                seen = sorted(set.union(*(statuses for _, statuses in found)))
                highest = [mib(most) for most, _ in found]
                rows.append([f"`{task}`", *highest, mib(BOUND), ", ".join(map(str, seen))])
                print(*rows[-1], sep="  ", flush=True)
    return [
        "`python -m benchmarks.bounds`",
        "",
        machine(),
        f"{len(files)} files: one is valid, others claim {LENGTHS[0] >> 20} or {LENGTHS[1] >> 20} MiB for a section",
        "or a chunk. Commands that draw do not get the valid one. MiB: the peak resident memory of a process that",
        "takes all files in turn. For the Python API, the bound excludes the memory assumed for the program itself.",
        "Status 64: a bound is exceeded. Status 1: a verdict.",
        "",
        *table(["task", "by name", "by pipe", "by URL", "bound", "statuses"], rows),
    ]


def main() -> None:
    """Runs the command line."""
    write_section("bounds", "Memory under a bound", section())


if __name__ == "__main__":
    main()
