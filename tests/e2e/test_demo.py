"""The device process that the demo starts is gone when the demo is."""

import os
import signal
from pathlib import Path

import pytest

from tests.support.command import Running, wait_until


def _device_of(demo: int) -> int:
    """The device process that a demo has started."""
    for entry in Path("/proc").iterdir():
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == demo and b"--until-stdin-closes" in (entry / "cmdline").read_bytes():
                return int(entry.name)
        except (OSError, ValueError, IndexError):
            continue
    return 0


def _alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds the device process in /proc, as on Linux")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=["Ctrl-C", "killed"])
def test_the_device_ends_with_the_demo(number, tmp_path):
    demo = Running("demo", "--quick", "--out", tmp_path)
    try:
        wait_until(lambda: any(" points" in line for line in demo.said), "the first points")
        device = _device_of(demo.process.pid)
        assert device
        if number == signal.SIGKILL:
            os.kill(demo.process.pid, number)
        else:
            demo.interrupt(number)
        assert demo.wait() == (1 if number == signal.SIGINT else -signal.SIGKILL)
        wait_until(lambda: not _alive(device), "the end of the device", 20)
        assert (tmp_path / "experiment.journal").exists()
    finally:
        demo.end()
