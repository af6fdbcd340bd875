"""Messages that no webhook hears, however many: a worker's jobs are done all the same, and each is sent again."""

import pytest

from service.config import Settings
from service.health import webhook
from service.storage import schedules
from service.storage.database import Database, now
from service.storage.ids import new_id
from service.storage.tables import ScheduleRow
from tests.support.processes import wait_for
from tests.support.service import QUICK, free_port, reference_sheet, rig_device, service

pytestmark = pytest.mark.slow
MANY = 80


def unheard(home, rig_id):
    """A schedule whose messages find no receiver; its id."""
    database = Database(Settings(home=home).database)
    with database.write() as session:
        row = ScheduleRow(
            id=new_id("sch"), rig_id=rig_id, cron="0 6 * * *", options={}, enabled=False,
            webhook_url=f"http://127.0.0.1:{free_port()}/hook", webhook_secret=webhook.new_secret(),
            created_at=now(), updated_at=now(), created_by="me",
        )  # fmt: skip
        session.add(row)
        session.flush()
        for _ in range(MANY):
            schedules.add_delivery(session, row, new_id("whd"), {"type": "health.missed"})
    database.close()
    return row.id


def test_jobs_are_done_one_after_the_other_on_a_rig_while_messages_wait(tmp_path):
    rig = rig_device(tmp_path)
    try:
        with service(tmp_path / "home", "sqlite", requests_per_s=10_000) as running:
            rig_id = running.add_rig(reference_sheet(), rig.url)
            schedule = unheard(running.home, rig_id)

            def pending():
                found = running.get(f"/schedules/{schedule}/deliveries", params={"limit": 1000})["items"]
                return [message for message in found if message["state"] == "pending"]

            def attempts():
                return [message["attempts"] for message in pending()]

            wait_for(lambda: sum(map(bool, attempts())) >= 64, "first attempts", 60)
            jobs = [running.submit("experiment", rig_id, options={"profile": QUICK, "identify": False}) for _ in "ab"]
            for job in jobs:
                running.done(job)
            wait_for(lambda: min(attempts()) >= 2, "second attempts", 120)
            assert len(attempts()) == MANY
            assert all(message["next_attempt_at"] > message["updated_at"] for message in pending())
            assert "has died" not in running.logs()
    finally:
        rig.device.end()
