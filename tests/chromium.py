"""Headless Chromium with software rendering, driven through a pipe by the DevTools protocol.

No name is resolved, so a page can only reach this machine. Its requests are recorded.
"""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
_OPTIONS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)
# The default time limit for the answer to a command, in seconds.
_PATIENCE = 120.0


class BrowserError(OSError):
    """An error of the browser, or of a script in its page."""


def find() -> str | None:
    """Returns the path of the program, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Chromium:
    """A browser with one page. It is a context manager.

    asked: the addresses that the page and its workers requested. said: their console output and errors.
    """

    def __init__(
        self,
        program: str,
        width: int = 960,
        height: int = 720,
        ratio: float = 1,
        touch: bool = False,
        patience: float = _PATIENCE,
    ) -> None:
        """program: its path. width, height: of the page, in CSS pixels. ratio: device pixels per CSS pixel.

        patience: the time limit for the answer to a command, in seconds.
        """
        self._patience = patience
        self._program = program
        self._screen = {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": touch}
        self._stack = contextlib.ExitStack()
        self._number, self._session, self._read = 0, "", b""
        self._answers: dict[int, dict[str, Any]] = {}
        self.asked: list[str] = []
        self.said: list[str] = []

    def __enter__(self) -> Chromium:
        with contextlib.ExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
            (first, self._to), (self._from, second) = os.pipe(), os.pipe()
            stack.callback(os.close, self._to)
            stack.callback(os.close, self._from)
            # The program reads from descriptor 3 and writes to 4. Here the pipes use other numbers.
            its_in, its_out = (fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (first, second))
            line = f'exec "$0" "$@" 3<&{its_in} 4>&{its_out}'
            options = (*_OPTIONS, f"--user-data-dir={folder}")
            self._process = subprocess.Popen(
                ["/bin/bash", "-c", line, self._program, *options],
                pass_fds=(its_in, its_out),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            stack.callback(self._end)
            for end in (first, second, its_in, its_out):
                os.close(end)
            target = self.ask("Target.createTarget", {"url": "about:blank"})["targetId"]
            self._session = self.ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
            self._begin(self._session)
            self.ask("Page.enable")
            self.ask("Emulation.setDeviceMetricsOverride", self._screen)
            if self._screen["mobile"]:
                self.ask("Emulation.setTouchEmulationEnabled", {"enabled": True})
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _begin(self, session: str) -> None:
        """Watches a page or a worker, and the workers that it starts."""
        self._send("Network.enable", {}, session)
        self._send("Runtime.enable", {}, session)
        self._send("Log.enable", {}, session)
        attach = {"autoAttach": True, "waitForDebuggerOnStart": True, "flatten": True}
        self._send("Target.setAutoAttach", attach, session)
        self._send("Runtime.runIfWaitingForDebugger", {}, session)

    def _send(self, method: str, parameters: dict[str, Any], session: str) -> int:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        data = json.dumps(message | ({"sessionId": session} if session else {})).encode() + b"\0"
        while data:
            data = data[os.write(self._to, data) :]
        return self._number

    def ask(self, method: str, parameters: dict[str, Any] | None = None) -> dict[str, Any]:
        """Returns the result of a command, which goes to the page if there is one. Raises BrowserError."""
        number = self._send(method, parameters or {}, self._session)
        end = time.monotonic() + self._patience
        while number not in self._answers:
            self._listen(end)
        answer = self._answers.pop(number)
        if "error" in answer:
            raise BrowserError(f"{method}: {answer['error']['message']}")
        result: dict[str, Any] = answer["result"]
        return result

    def _listen(self, end: float) -> None:
        """Processes the next messages of the browser."""
        ready, _, _ = select.select([self._from], [], [], max(0.0, end - time.monotonic()))
        if not ready:
            raise BrowserError(f"the browser does not answer; output of the page: {self.said}")
        block = os.read(self._from, 1 << 20)
        if not block:
            raise BrowserError("the browser has ended")
        *messages, self._read = (self._read + block).split(b"\0")
        for message in map(json.loads, messages):
            if "id" in message:
                self._answers[message["id"]] = message
            else:
                self._take(message["method"], message["params"])

    def _take(self, event: str, fields: dict[str, Any]) -> None:
        if event == "Target.attachedToTarget" and fields["targetInfo"]["type"] == "worker":
            self._begin(fields["sessionId"])
        elif event == "Network.requestWillBeSent":
            self.asked.append(fields["request"]["url"])
        elif event == "Runtime.exceptionThrown":
            details = fields["exceptionDetails"]
            self.said.append(details.get("exception", {}).get("description") or details["text"])
        elif event == "Runtime.consoleAPICalled":
            self.said.append(" ".join(str(value.get("value", value.get("description"))) for value in fields["args"]))
        elif event == "Log.entryAdded":
            self.said.append(fields["entry"]["text"])

    def open(self, url: str) -> None:
        """Opens a page and waits until it is loaded. Raises BrowserError."""
        answer = self.ask("Page.navigate", {"url": url})
        if "errorText" in answer:
            raise BrowserError(f"{url}: {answer['errorText']}")
        self.until("document.readyState === 'complete'")

    def run(self, script: str) -> Any:
        """Returns the value of an expression in the page; promises are awaited. Raises BrowserError."""
        given = {"expression": script, "awaitPromise": True, "returnByValue": True}
        answer = self.ask("Runtime.evaluate", given)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise BrowserError(details.get("exception", {}).get("description") or details["text"])
        return answer["result"].get("value")

    def until(self, script: str, seconds: float = 60) -> None:
        """Waits until an expression is true. Raises BrowserError after `seconds`."""
        for _ in self._moments(seconds):
            if self.run(script):
                return
        raise BrowserError(f"not true after {seconds} s: {script}; output of the page: {self.said}")

    @staticmethod
    def _moments(seconds: float) -> Iterator[None]:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            yield
            time.sleep(0.02)

    def screenshot(self) -> bytes:
        """Returns a screenshot of the page as a PNG file."""
        return base64.b64decode(self.ask("Page.captureScreenshot", {"format": "png"})["data"])
