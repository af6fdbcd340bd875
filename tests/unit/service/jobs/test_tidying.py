"""What nobody comes back for goes."""

import os
import time

from service.config import Settings
from service.jobs.worker import Worker
from service.storage.migrate import upgrade


def test_uploads_and_exports_of_a_killed_process_are_removed_and_those_under_way_are_not(tmp_path):
    worker = Worker(Settings(home=tmp_path, worker_name="w1"))
    upgrade(worker.context.database)
    work = worker.settings.work
    left, under_way = [work / "uploads" / "upload-1", work / "exports" / "tmp1"], work / "uploads" / "upload-2"
    for folder in (*left, under_way):
        folder.mkdir(parents=True)
        (folder / "received.h5").write_bytes(b"half a file")
    part = tmp_path / "store" / "incoming" / "a.1"
    part.parent.mkdir(parents=True)
    part.write_bytes(b"half a file")
    killed = time.time() - 86_460.0
    for folder in (*left, part):
        os.utime(folder, (killed, killed))
    try:
        worker._tidy()
    finally:
        worker.context.database.close()
    assert [path.exists() for path in (*left, part, under_way)] == [False, False, False, True]
