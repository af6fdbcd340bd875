"""A real S3 server as a process of its own: moto's."""

from __future__ import annotations

import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.support.processes import ENVIRONMENT
from tests.support.service import free_port

_SIGNED = "AWS4-HMAC-SHA256 Credential=test/20260101/us-east-1/s3/aws4_request"


class Server:
    """Answers as Amazon's S3 does; asks for valid keys once `guarded`."""

    def __init__(self) -> None:
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        program = Path(sys.executable).with_name("moto_server")
        self._process = subprocess.Popen(
            [program, "-H", "127.0.0.1", "-p", str(port)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=ENVIRONMENT,
        )
        try:
            self._wait()
        except BaseException:
            self.end()
            raise

    def _wait(self) -> None:
        deadline = time.monotonic() + 60
        while True:
            try:
                self._ask("GET", "moto-api/data.json")
                return
            except OSError:
                assert self._process.poll() is None, "the server ended"
                assert time.monotonic() < deadline, "the server did not start"
                time.sleep(0.05)

    def _ask(self, method: str, path: str, body: bytes | None = None) -> None:
        headers = {"content-type": "text/plain", "authorization": _SIGNED}
        request = urllib.request.Request(f"{self.url}/{path}", body, headers, method=method)
        with urllib.request.urlopen(request, timeout=10):
            pass

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Requests with keys that it does not know are refused."""
        self._ask("POST", "moto-api/reset-auth", b"0")
        try:
            yield
        finally:
            self._ask("POST", "moto-api/reset-auth", b"inf")

    def bucket(self, name: str) -> str:
        """URL of the folder ``ambit`` of a new bucket."""
        self._ask("PUT", name)
        return f"s3://{name}/ambit"

    def overwrite(self, url: str, content: bytes) -> None:
        """Put an object, whatever is there."""
        self._ask("PUT", url.removeprefix("s3://"), content)

    def end(self) -> None:
        """It is gone."""
        self._process.kill()
        self._process.wait()
