"""A tab of a headless Chromium that a test drives over the DevTools protocol, by a pipe: live pages, real time."""

from __future__ import annotations

import base64
import itertools
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.support.browser import BROWSER, QUIET

HOST = "rotor.test"
"""A name of this machine in the browser: over plain HTTP a page from there has no secure context, as on a network."""
OPTIONS = (
    *QUIET,
    f"--host-resolver-rules=MAP {HOST} 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--window-size=1200,2400",
    "--remote-debugging-pipe",
)


LAUNCH = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(n), fcntl.F_DUPFD, 20) for n in sys.argv[1:3]]
os.dup2(ends[0], 3)
os.dup2(ends[1], 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""The browser reads commands from its descriptor 3 and answers on 4."""


class Tab:
    """A page under control."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._out, self._in = to_browser, from_browser
        self._ids = itertools.count(1)
        self._buffer = b""
        self.complaints: list[str] = []
        """Errors and warnings of the console, exceptions, and what a policy refused."""
        target = self._call("Target.createTarget", {"url": "about:blank"})["targetId"]
        self._session: str | None = None
        self._session = self._call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        for domain in ("Runtime", "Log", "Page"):
            self._call(f"{domain}.enable", {})

    _session = None

    def open(self, url: str) -> None:
        """Go to an address."""
        self._call("Page.navigate", {"url": url})

    def back(self) -> None:
        """To the page before; only after the answer, which would be lost with the page that sends it."""
        self.run("void setTimeout(() => history.back())")

    def run(self, script: str) -> Any:
        """Value of an expression in the page."""
        answer = self._call("Runtime.evaluate", {"expression": script, "returnByValue": True, "awaitPromise": True})
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, script: str, seconds: float = 20.0) -> Any:
        """Wait until an expression is true."""
        deadline = time.monotonic() + seconds
        while True:
            try:
                if found := self.run(f"!!({script})"):
                    return found
            except AssertionError:  # the page is being changed for another
                pass
            assert time.monotonic() < deadline, f"{script} did not come true; {self.complaints}; {self.text()[:2000]}"
            time.sleep(0.05)

    def show_key(self, key: str) -> None:
        """Give the service's page the key that it asks for."""
        self.until("!document.getElementById('key').hidden")
        self.run(f"document.getElementById('key-text').value = {json.dumps(key)}")
        self.run("document.getElementById('key').requestSubmit()")

    def narrow(self, width: int) -> None:
        """A window of a phone's width, px."""
        size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": True}
        self._call("Emulation.setDeviceMetricsOverride", size)

    def wide(self) -> int:
        """How wide the whole page is, px; more than its window where it scrolls sideways."""
        return int(self.run("document.documentElement.scrollWidth"))

    def press(self, key: str) -> None:
        """A key, by its name, wherever the focus is."""
        more = {"text": "\r"} if key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            code = {"Enter": 13, "Escape": 27, "Tab": 9}[key]
            event = {"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code}
            self._call("Input.dispatchKeyEvent", event | (more if kind == "keyDown" else {}))

    def text(self) -> str:
        """What a reader sees."""
        return str(self.run("document.body.innerText"))

    def picture(self, path: Path) -> None:
        """A picture of the window, PNG."""
        found = self._call("Page.captureScreenshot", {"format": "png", "captureBeyondViewport": True})
        path.write_bytes(base64.b64decode(found["data"]))

    def _call(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        number = next(self._ids)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._message()
            if answer.get("id") == number:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self._heard(answer)

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._in], [], [], 30)
            assert ready, "the browser does not answer"
            more = os.read(self._in, 1 << 20)
            assert more, "the browser ended"
            self._buffer += more
        message, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(message))

    def _heard(self, event: dict[str, Any]) -> None:
        about = event.get("params", {})
        match event.get("method"):
            case "Runtime.exceptionThrown":
                self.complaints.append(str(about["exceptionDetails"].get("exception", {}).get("description", about)))
            case "Runtime.consoleAPICalled" if about["type"] in ("error", "warning"):
                self.complaints.append(str([a.get("value") for a in about["args"]]))
            case "Log.entryAdded" if about["entry"]["level"] in ("error", "warning"):
                self.complaints.append(f"{about['entry']['text']} {about['entry'].get('url', '')}")


@contextmanager
def tab() -> Iterator[Tab]:
    """A tab of a browser of its own."""
    assert BROWSER is not None
    commands_in, commands_out = os.pipe()
    answers_in, answers_out = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = subprocess.Popen(
            [
                *(sys.executable, "-c", LAUNCH, str(commands_in), str(answers_out), BROWSER),
                *(*OPTIONS, f"--user-data-dir={profile}"),
            ],
            pass_fds=(commands_in, answers_out),
            env={**os.environ, "TMPDIR": profile},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(commands_in)
        os.close(answers_out)
        try:
            yield Tab(commands_out, answers_in)
        finally:
            os.close(commands_out)
            os.close(answers_in)
            browser.terminate()
            try:
                browser.wait(10)
            except subprocess.TimeoutExpired:
                browser.kill()
                browser.wait()
