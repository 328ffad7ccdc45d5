"""Files at a URL: only the needed ranges are fetched, and no answer of the server is trusted."""

import re
import socket
import struct
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from random_scenes import random_scene

from refcodec.bitstream import codec
from refcodec.bitstream.directory import DATA
from refcodec.bitstream.reader import Reader, decode_chunk
from refcodec.bitstream.reconstruction import chunk_digest, digest
from refcodec.bitstream.source import WholeFile
from refcodec.cli.main import main
from refcodec.files import remote
from refcodec.files.remote import RemoteFile, is_url
from refcodec.statuses import UsageError

pytest.importorskip("fsspec")
pytest.importorskip("aiohttp")

HEAD = 1 << 13
SCENE = codec.emit(random_scene(51, 3000, chunk_size=100))
Captured = pytest.CaptureFixture[str]


@dataclass
class Server:
    """A web server with one file. way: how it answers. asked: the ranges that were asked for, as first byte and end."""

    url: str
    data: bytes
    way: str = "right"
    asked: list[tuple[int, int]] = field(default_factory=list)


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setattr(remote, "HEAD_BYTES", HEAD)

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None:
            pass

        def do_GET(self) -> None:
            asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
            assert asked
            size, way, later = len(served.data), served.way, bool(served.asked)
            first, end = int(asked[1]), min(int(asked[2]) + 1, size)
            served.asked.append((first, end))
            body = served.data[first:end]
            ways: dict[str, tuple[int, bytes, dict[str, str]]] = {
                "missing": (404, b"", {}),
                "busy": (503, b"", {}),
                "redirects": (302, b"", {"Location": served.url}),
                "ignores": (200, served.data, {}),
                "no range": (206, body, {"Content-Range": "all of it\x1b[2J"}),
                "ETag": (206, body, {"ETag": f'"{later}"'}),
                "Last-Modified": (206, body, {"Last-Modified": f'"{later}"'}),
                "no ETag": (206, body, {} if later else {"ETag": '"a"'}),
            }
            changes: dict[str, tuple[int, bytes, dict[str, str]]] = {
                "shorter": (206, body[:-1], {}),
                "longer": (206, body + b"x", {}),
                "endless": (206, body, {"Content-Length": str(1 << 40)}),
                "cut": (206, body[:10], {"Content-Length": str(len(body))}),
                "other range": (206, body, {"Content-Range": f"bytes {first + 1}-{end}/{size}"}),
                "other length": (206, body, {"Content-Range": f"bytes {first}-{end - 1}/{size + 1}"}),
            }
            if later and way == "silent":
                over.wait()
            elif later and way in ("hangs up", "resets"):
                if way == "resets":
                    self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            elif first >= size:
                self.send(416, b"", {"Content-Range": f"bytes */{size}"})
            else:
                status, body, headers = {**ways, **(changes if later else {})}.get(way, (206, body, {}))
                stated = {"Content-Range": f"bytes {first}-{end - 1}/{size}"} if status == 206 else {}
                self.send(status, body, {**stated, **headers})
                while later and way == "endless":
                    self.wfile.write(bytes(1 << 16))
            self.close_connection = later and way in ("hangs up", "resets", "cut", "silent")

        def send(self, status: int, body: bytes, headers: dict[str, str]) -> None:
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

    over = threading.Event()

    class Quiet(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: object) -> None:
            """A client that hangs up is what some tests are about."""

    with Quiet(("127.0.0.1", 0), Handler) as web:
        served = Server(f"http://127.0.0.1:{web.server_address[1]}/scene.c3gs", SCENE)
        thread = threading.Thread(target=web.serve_forever, daemon=True)
        thread.start()
        yield served
        over.set()
        web.shutdown()
        thread.join()


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_commands_take_urls(server: Server, tmp_path: Path, capsys: Captured) -> None:
    local = tmp_path / "scene.c3gs"
    local.write_bytes(SCENE)
    assert len(SCENE) > 8 * HEAD
    wanted = digest(codec.parse(SCENE).scene)[0]
    assert main(["digest", server.url]) == 0
    assert capsys.readouterr().out == wanted + "\n"
    assert main(["validate", server.url]) == 0
    assert "is accepted" in capsys.readouterr().out
    for name, folder in ((server.url, "remote"), (str(local), "local")):
        assert main(["decode", name, "-o", str(tmp_path / folder)]) == 0
    assert files(tmp_path / "remote") == files(tmp_path / "local")
    capsys.readouterr()
    for options in (["--decode"], ["--near", "3000"]):
        shown = []
        for name in (server.url, str(local)):
            assert main(["inspect", name, *options]) == 0
            shown.append(capsys.readouterr().out.splitlines()[-1])
        assert shown[0] == shown[1]


def test_few_ranges_are_fetched(server: Server, tmp_path: Path, capsys: Captured) -> None:
    section = codec.parse_container(SCENE).section(DATA)
    assert section.start < HEAD
    assert main(["inspect", server.url]) == 0
    assert "30 chunks of at most 100 anchors" in capsys.readouterr().out
    assert server.asked == [(0, HEAD)]
    server.asked.clear()
    index = Reader(WholeFile(SCENE)).open().index
    assert main(["decode", server.url, "-o", str(tmp_path / "part"), "--chunks", "25:28"]) == 0
    assert server.asked == [(0, HEAD), (index[25].start, index[28].start)]
    lines = [f"chunk {n} {chunk_digest(decode_chunk(WholeFile(SCENE), n))}" for n in range(25, 28)]
    assert capsys.readouterr().out.splitlines() == lines
    server.asked.clear()
    assert main(["validate", server.url]) == 0
    assert len(server.asked) == 2


WAYS = {
    "missing": "the server answers 404 Not Found",
    "busy": "the server answers 503 Service Unavailable",
    "redirects": "the server redirects too often",
    "ignores": "the server does not send ranges",
    "shorter": "the server sends",
    "longer": "the server sends more",
    "endless": "the server sends more",
    "other range": "the server sends another range",
    "other length": "it changed while it was read: its length was",
    "ETag": 'it changed while it was read: its ETag was "False", and is "True" now',
    "Last-Modified": "it changed while it was read: its Last-Modified was",
    "no range": "the server sends another range",
    "cut": "the connection broke",
    "hangs up": "the connection broke",
    "resets": "the connection broke",
    "silent": "the server sends nothing for 0 s",
}


@pytest.mark.parametrize("way", WAYS)
def test_servers_that_lie(
    server: Server, way: str, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line that says why, status 64, and no folder."""
    if way == "silent":
        monkeypatch.setattr(remote, "TIMEOUT", 0.2)
    server.way = way
    assert main(["decode", server.url, "-o", str(tmp_path / "scene")]) == 64
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1, err
    assert f"cannot read {server.url}: {WAYS[way]}" in err
    assert "\x1b" not in err
    assert not (tmp_path / "scene").exists()


def test_a_slow_server_is_given_up(server: Server, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    """The time of all answers together is bounded, by their bytes."""
    clock = iter(range(0, 10**9, 200))
    monkeypatch.setattr(remote, "monotonic", lambda: next(clock))
    with RemoteFile(server.url) as file:
        # The head took 200 s, and so does each range. 300 s are allowed, and a second for each 2^14 bytes.
        assert file.read(HEAD, 10) == SCENE[HEAD : HEAD + 10]
        with pytest.raises(UsageError, match="fewer than 16384 bytes a second"):
            file.read(HEAD, 10)
    assert len(server.asked) == 2


@pytest.mark.parametrize("size", [0, 1, 100, 70_000])
def test_verdicts_are_those_of_the_file(server: Server, size: int, tmp_path: Path, capsys: Captured) -> None:
    """Also where the file ends before or behind what is held, and is empty. Not every server repeats its validators."""
    server.way = "no ETag"
    server.data = SCENE[:size]
    (tmp_path / "cut").write_bytes(SCENE[:size])
    messages = []
    for name in (server.url, str(tmp_path / "cut")):
        assert main(["validate", name]) == 1
        messages.append(capsys.readouterr().err.splitlines()[-1])
    assert messages[0] == messages[1]


def test_any_url_of_fsspec(tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "scene.c3gs").write_bytes(SCENE)
    with RemoteFile(f"file://{tmp_path}/scene.c3gs") as file:
        assert file.length() == len(SCENE)
        assert file.read(100_000, 1000) == SCENE[100_000:101_000]
        assert file.read(5, 10) == SCENE[5:15]
        assert file.read(len(SCENE) - 5, 10) == SCENE[-5:]
        assert file.read(len(SCENE), 10) == b""
    assert main(["validate", f"file://{tmp_path}/scene.c3gs"]) == 0
    assert main(["validate", f"file://{tmp_path}/nothing.c3gs"]) == 64
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_urls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    """An existing file may look like one. Without a server or a package the error is one line."""
    monkeypatch.chdir(tmp_path)
    Path("s3:").mkdir()
    Path("s3:/a").write_bytes(b"")
    assert [is_url(name) for name in ("https://a/b.c3gs", "a/b.c3gs", "s3://a")] == [True, False, False]
    for url in ("http://127.0.0.1:1/scene.c3gs", "nothing://x", "http://"):
        assert main(["validate", url]) == 64
        assert len(capsys.readouterr().err.splitlines()) == 1
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    with pytest.raises(UsageError, match=r"pip install 'refcodec\[http\]'"):
        RemoteFile("https://a/b.c3gs")
