"""`refcodec view` and its server, and `refcodec export -o scene.html`."""

import io
import json
import os
import queue
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path

import pytest

from refcodec import viewer
from refcodec.cli.main import main
from refcodec.viewer.bundle import bundle
from refcodec.viewer.server import Server
from tests.chromium import Chromium

CONTENT = bytes(range(256))


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """A server of a page and of 256 bytes."""
    with Server(b"<!doctype html>", lambda: io.BytesIO(CONTENT)) as made:
        thread = threading.Thread(target=made.serve_forever)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def _ask(server: Server, path: str, method: str = "GET", **headers: str) -> tuple[HTTPResponse, bytes]:
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    try:
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        return response, response.read()
    finally:
        connection.close()


def test_the_file(server: Server) -> None:
    response, body = _ask(server, "/scene.c3gs")
    assert (response.status, body) == (200, CONTENT)
    head, nothing = _ask(server, "/scene.c3gs", "HEAD")
    assert (head.status, head.getheader("Content-Length"), nothing) == (200, "256", b"")


def test_nothing_else_is_served(server: Server) -> None:
    assert _ask(server, "/")[1] == b"<!doctype html>"
    assert _ask(server, "/?file=scene.c3gs")[0].status == 200
    for path in ("/scene", "/../scene.c3gs", "/etc/passwd", "/%2e%2e/"):
        assert _ask(server, path)[0].status == 404
    # The name of another site may lead here.
    assert _ask(server, "/", Host="example.org")[0].status == 403
    assert _ask(server, "/", "POST")[0].status == 501
    assert server.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize("sent", [b"", b"GE", b"GET / HTTP/1.1\r\nHost: ", b"GET / HTTP/1.1\r\n\r\n"])
def test_a_client_that_goes_away(sent: bytes, server: Server, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is said of a connection that is reset, wherever its request ends. A fault is told all the same."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        client = socket.create_connection(listening.getsockname())
        # No time to linger: the connection is not closed but reset.
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.sendall(sent)
        accepted, address = listening.accept()
        client.close()
    server.process_request_thread(accepted, address)
    assert capsys.readouterr().err == ""
    try:
        raise ZeroDivisionError
    except ZeroDivisionError:
        server.handle_error(accepted, address)
    assert "ZeroDivisionError" in capsys.readouterr().err


@pytest.fixture
def viewed(trained: Path, tmp_path: Path) -> Iterator[tuple[str, Path, subprocess.Popen[str]]]:
    """The address that `refcodec view` says, the file, and its process."""
    file = tmp_path / "scene.c3gs"
    shutil.copy(trained, file)
    command = [sys.executable, "-m", "refcodec", "view", str(file), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        match = re.match(r"(http://127\.0\.0\.1:\d+/) shows ", process.stdout.readline())
        assert match is not None
        yield match[1], file, process
        process.kill()


def test_view(browser: Chromium, viewed: tuple[str, Path, subprocess.Popen[str]]) -> None:
    """The page shows the file as it is when it is loaded, and Ctrl-C ends the command."""
    url, file, process = viewed
    browser.asked.clear()
    browser.open(url)
    browser.run("c3gs.settle()")
    assert browser.run("c3gs.header.anchor_count") == 2182
    assert {address for address in browser.asked if address.startswith("http")} == {url, f"{url}scene.c3gs"}
    file.write_bytes(file.read_bytes()[:30000])
    browser.open(f"{url}?file=/scene.c3gs")
    browser.until("!document.getElementById('error').hidden")
    assert "error 311" in browser.run("document.getElementById('error').innerText")
    browser.open(f"{url}?file=/nothing.c3gs")
    browser.until("!document.getElementById('error').hidden")
    assert "answers 404" in browser.run("document.getElementById('error').innerText")
    browser.open(f"{url}?file=http://[")
    browser.until("!document.getElementById('error').hidden")
    assert "no address" in browser.run("document.getElementById('error').innerText")
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0


def test_a_file_is_chosen(browser: Chromium, trained: Path, viewed: tuple[str, Path, subprocess.Popen[str]]) -> None:
    """Another file takes the place of the first one."""
    browser.open(viewed[0])
    browser.run("c3gs.settle()")
    chooser = browser.ask("Runtime.evaluate", {"expression": "document.getElementById('file')"})
    other = trained.with_name("empty.c3gs")
    given = {"files": [str(other)], "objectId": chooser["result"]["objectId"]}
    browser.ask("DOM.setFileInputFiles", given)
    browser.until("c3gs.header?.anchor_count === 0")
    browser.run("c3gs.settle()")
    assert browser.run("document.getElementById('title').innerText") == "empty.c3gs"


def test_what_view_serves(
    trained: Path,
    photographs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It opens the browser. The page has the photographs, and the file of a scene folder is that of its encoding."""
    pytest.importorskip("PIL", reason="photographs need the packages of the extra render")
    opened: queue.Queue[str] = queue.Queue()
    served: list[Server] = []

    def serve(server: Server) -> None:
        served.append(server)
        raise KeyboardInterrupt

    monkeypatch.setattr(Server, "serve_forever", serve)
    monkeypatch.setattr("webbrowser.open", opened.put)
    folder = tmp_path / "scene"
    assert main(["decode", str(trained), "-o", str(folder)]) == 0
    for words in ([str(trained)], [str(folder)], [str(trained), "--photographs", str(photographs), "--size", "40"]):
        assert main(["view", *words]) == 0
        with served[-1].file() as file:
            assert file.read() == trained.read_bytes()
    assert {opened.get(timeout=60) for _ in served} == {server.url for server in served}
    pages = [server.page.decode() for server in served]
    assert [text.count("data:image/jpeg") for text in pages] == [0, 0, 8]
    assert "Ctrl-C" in capsys.readouterr().out


def test_a_browser_that_waits_for_the_page(trained: Path, tmp_path: Path) -> None:
    """Browsers of the terminal let go of the command only when they end."""
    program, fetched = tmp_path / "browser.py", tmp_path / "page.html"
    program.write_text(
        "import sys, urllib.request\n"
        "page = urllib.request.urlopen(sys.argv[1], timeout=60).read()\n"
        f"open({str(fetched)!r}, 'wb').write(page)\n"
    )
    environment = os.environ | {"BROWSER": f"{sys.executable} {program} %s"}
    command = [sys.executable, "-m", "refcodec", "view", str(trained)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as process:
        try:
            end = time.monotonic() + 60
            while not (fetched.exists() and fetched.stat().st_size) and time.monotonic() < end:
                time.sleep(0.05)
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0
        finally:
            process.kill()
    assert fetched.read_bytes().startswith(b"<!doctype html>")


def test_export(trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page says its size, and replaces only what refcodec wrote. A folder has its file's page, but for the name."""
    output = tmp_path / "scene.html"
    assert main(["export", str(trained), "-o", str(output)]) == 0
    length = output.stat().st_size
    assert capsys.readouterr().out == f"{output}: {length:,} bytes, including the file of 53,052\n"
    before = output.read_bytes()
    assert main(["export", str(trained), "-o", str(output)]) == 0
    assert output.read_bytes() == before
    folder = tmp_path / "trained-caliterra"
    assert main(["decode", str(trained), "-o", str(folder)]) == 0
    other = tmp_path / "other.html"
    assert main(["export", str(folder), "-o", str(other)]) == 0
    assert other.read_bytes() == before.replace(b"trained-caliterra.c3gs", b"trained-caliterra")
    output.write_bytes(b"<!doctype html>\n<title>mine</title>")
    capsys.readouterr()
    assert main(["export", str(trained), "-o", str(output)]) == 64
    assert "a page that refcodec wrote" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('import * as a from "./a.js";\n', "import"),
        ("export default 1;\n", "export"),
        ('export { a as b } from "./other.js";\n', "another name"),
        ('import { a } from "./module.js";\n', "itself"),
    ],
)
def test_forms_that_no_bundle_has(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "module.js").write_text(text)
    (tmp_path / "other.js").write_text("export const a = 1;\n")
    with pytest.raises(ValueError, match=message):
        bundle(tmp_path / "module.js")


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node here")
def test_a_budget_is_kept() -> None:
    """Also if the bounds of one chunk are larger than those of all others together by more than 2^53."""
    module = (Path(viewer.__file__).parent / "budget.js").as_uri()
    chunks = [{"number": i, "kept": 9, "low": [0] * 3, "high": [side] * 3} for i, side in enumerate([1e9, 1e-4, 1e-4])]
    program = f"console.log((await import('{module}')).planned({json.dumps(chunks)}, 3, 5).quotas.join())"
    done = subprocess.run(["node", "--input-type=module", "-e", program], capture_output=True, check=True)
    assert done.stdout == b"5,0,0\n"
