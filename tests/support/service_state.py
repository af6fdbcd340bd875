"""A service with a history: rigs, an experiment with its file, keys, jobs that ended and jobs that did not."""

from __future__ import annotations

from service.access import keys
from service.access.audit import Action, audited
from service.access.keys import LOCAL, Scope
from service.config import Settings
from service.jobs.engine import Dispatcher
from service.storage import audit, jobs, migrate, rigs
from service.storage import keys as key_rows
from service.storage.blobs import Blobs
from service.storage.database import Database, now
from service.storage.ids import new_id
from service.storage.tables import ExperimentRow, JournalPart
from sim.reference import reference_datasheet
from sim.rig_file import to_toml


def lived_in(settings: Settings) -> dict[str, str]:
    """Fill an empty service; ids of what is in it."""
    from dbos import DBOS

    database = Database(settings.database)
    migrate.upgrade(database)
    DBOS.migrate(settings.jobs_database)
    blobs = Blobs(settings.store)
    content = b"an experiment" * 1000
    sha256 = blobs.put(content)
    made = {"sha256": sha256}
    with database.write() as session:
        rig = rigs.create(session, "bench 3 äöü", to_toml(reference_datasheet()), "modbus://h:1", "", "local")
        record, key = keys.issue(new_id("key"), "laptop", Scope.operator)
        key_rows.add(session, key_rows.row(record, "local"))
        session.add(
            ExperimentRow(
                id=new_id("exp"), rig_id=rig.id, rig_version=1, job_id=None, source="uploaded", purpose="commissioning",
                complete=True, file_sha256=sha256, file_bytes=len(content), media_type="application/x-hdf5",
                file_name="a\tb\\n.h5", summary={"rig": "x", "sweeps": [{"to_hz": 1e3}]}, created_at=now(),
                created_by="local",
            )
        )  # fmt: skip
        done, queued, running = (jobs.submit(session, "experiment", rig.id, 1, "laptop") for _ in range(3))
        done.state, running.state = jobs.DONE, jobs.RUNNING
        session.add(JournalPart(job_id=running.id, offset=0, content=bytes(range(256))))
        audit.record(session, audited(LOCAL, Action.rig_created, rig.id, rig=rig.id))
        made |= {"rig": rig.id, "key": key, "done": done.id, "queued": queued.id, "running": running.id}
    dispatcher = Dispatcher(settings)
    for job in (queued, running):
        dispatcher.dispatch(job)
    dispatcher.close()
    database.close()
    return made
