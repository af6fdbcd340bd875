"""A simulated rig in a process of its own, ``ambit rig serve``, for as long as a context lasts.

The device lives in a session of its own, so that Ctrl-C reaches its host alone, and the host can stop in good order.
It holds the other end of a pipe: when the host is gone, however it went, the pipe closes and the device ends with its
excitation off.
"""

from __future__ import annotations

import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import IO

from drivers.errors import ControllerError

START_S = 60.0
"""Time to say where it is; a slow disk and an empty compiler cache included."""
END_S = 10.0


@dataclass(frozen=True)
class DeviceProcess:
    """A device that serves."""

    url: str
    """For `drivers.url.connect`."""
    pid: int


@contextmanager
def device_process(*options: str) -> Iterator[DeviceProcess]:
    """A device that serves while the context lasts.

    Parameters
    ----------
    options
        Of ``ambit rig serve``: ``"--seed", "1", "--protocol", "canopen"``. Modbus TCP on a free port of the
        loopback when nothing else is said.

    Raises
    ------
    ControllerError
        It ended, or said nothing, instead of telling its URL.
    """
    command = [sys.executable, "-m", "service", "rig", "serve", "--until-stdin-closes", *options]
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as said:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
            start_new_session=True,
        )
        try:
            yield DeviceProcess(_told_url(process, said), process.pid)
        finally:
            _end(process)


def _told_url(process: subprocess.Popen[str], said: IO[str]) -> str:
    assert process.stdout is not None
    if not select.select([process.stdout], [], [], START_S)[0]:
        raise ControllerError(f"the device process said nothing within {START_S:.0f} s; is the machine overloaded?")
    url = process.stdout.readline().strip()
    if not url:
        process.wait(END_S)
        said.seek(0)
        last = (said.read().strip().splitlines() or ["it said nothing"])[-1]
        raise ControllerError(f"the device process ended with status {process.returncode}: {last}")
    return url


def _end(process: subprocess.Popen[str]) -> None:
    """Ask, insist, kill; and reap."""
    assert process.stdin is not None
    assert process.stdout is not None
    with suppress(OSError):
        process.stdin.close()
    for insist in (process.terminate, process.kill, lambda: None):
        try:
            process.wait(END_S)
            break
        except subprocess.TimeoutExpired:
            insist()
    process.stdout.close()
