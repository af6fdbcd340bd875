"""Ctrl-C while processes of a pool still load: they end, and none says a word."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

LOADING = """
import os, sys, time
if "--multiprocessing-fork" in sys.orig_argv:
    open(os.path.join(os.environ["LOADING"], str(os.getpid())), "w").close()
    time.sleep(1.0)
"""
COMMAND = """
import os, signal, sys, time
from service.pool import workers

if __name__ == "__main__":
    pool = workers(3)
    try:
        waiting = [pool.submit(time.sleep, 600) for _ in range(3)]
        for future in waiting:
            future.result()
    except KeyboardInterrupt:
        pool.shutdown(cancel_futures=True)
        sys.exit("interrupted")
"""


def test_ctrl_c_while_processes_load_ends_them_all_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(LOADING)
    (tmp_path / "command.py").write_text(COMMAND)
    loading = tmp_path / "loading"
    loading.mkdir()
    command = subprocess.Popen(
        [sys.executable, str(tmp_path / "command.py")],
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, sys.path)]), "LOADING": str(loading)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 60
        while len(list(loading.iterdir())) < 3:
            assert command.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        os.killpg(command.pid, signal.SIGINT)  # as a terminal does
        _, said = command.communicate(timeout=60)
    finally:
        if command.poll() is None:
            os.killpg(command.pid, signal.SIGKILL)
    assert said == "interrupted\n"
    assert command.returncode == 1
    for process in loading.iterdir():
        assert not Path("/proc", process.name).exists()
