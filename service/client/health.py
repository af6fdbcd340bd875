"""Health of rigs: checks that were made, and schedules of those that shall be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from service.client.errors import ConflictingError
from service.client.shapes import Delivery, HealthCheck, Run, Schedule, Trend
from service.client.transport import Transport


class HealthChecks:
    """Health checks of a service; `Jobs.submit` of kind health makes one."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def get(self, health_id: str) -> HealthCheck:
        """A check with its whole document."""
        return HealthCheck.model_validate(self._transport.get(f"/health-checks/{health_id}"))

    def list(
        self, rig: str | None = None, alarm: bool | None = None, newest: bool | None = None
    ) -> Iterator[HealthCheck]:
        """Checks, newest first; with ``newest`` only the last one of each rig."""
        return self._transport.pages("/health-checks", HealthCheck.model_validate, rig=rig, alarm=alarm, newest=newest)

    def trend(self, rig_id: str, after: str | None = None) -> Trend:
        """Every monitored figure of a rig over its newest checks, or those before."""
        return Trend.model_validate(self._transport.get(f"/rigs/{rig_id}/trend", after=after))

    def save(self, health_id: str, folder: Path) -> dict[str, Path]:
        """health.json and health.html in a folder."""
        from service.output import json_text, write_text

        page = self._transport.save(f"/health-checks/{health_id}/report.html", folder / "health.html")
        document = write_text(folder / "health.json", json_text(self.get(health_id).document))
        return {"health": document, "health_report": page}


class Schedules:
    """Schedules of health checks."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def create(
        self,
        rig_id: str,
        cron: str,
        timezone: str = "UTC",
        webhook_url: str | None = None,
        webhook_on: str = "alarm",
        options: dict[str, Any] | None = None,
    ) -> Schedule:
        """Check a rig whenever a cron expression says.

        Parameters
        ----------
        cron
            Minute, hour, day, month, weekday.
        webhook_url, webhook_on
            Who is told: of an alarm, or always. The answer shows the secret of its signatures, once.

        Raises
        ------
        RefusedError, ConflictingError, MissingError
            The schedule cannot be kept; says why.
        """
        webhook = None if webhook_url is None else {"url": webhook_url, "on": webhook_on}
        body = {"rig": rig_id, "cron": cron, "timezone": timezone, "options": options or {}, "webhook": webhook}
        return Schedule.model_validate(self._transport.post("/schedules", body))

    def get(self, schedule_id: str) -> Schedule:
        """A schedule."""
        return Schedule.model_validate(self._transport.get(f"/schedules/{schedule_id}"))

    def list(self, rig: str | None = None) -> Iterator[Schedule]:
        """Schedules, newest first."""
        return self._transport.pages("/schedules", Schedule.model_validate, rig=rig)

    def runs(self, schedule_id: str) -> Iterator[Run]:
        """The times at which it was due, and those that were missed, newest first."""
        return self._transport.pages(f"/schedules/{schedule_id}/runs", Run.model_validate)

    def deliveries(self, schedule_id: str) -> Iterator[Delivery]:
        """What its webhook was told, newest first."""
        return self._transport.pages(f"/schedules/{schedule_id}/deliveries", Delivery.model_validate)

    def change(self, schedule: Schedule) -> Schedule:
        """Keep a schedule as it is given here (``schedule.model_copy(update={...})``), if nobody else has changed it.

        The webhook's secret stays.
        """
        path = f"/schedules/{schedule.id}"
        seen = self._transport.send("GET", path)
        if Schedule.model_validate(seen.json()).updated_at != schedule.updated_at:
            raise ConflictingError(
                412, f"the schedule {schedule.id} was changed by someone else; read it again", [], ""
            )

        def made(found: Any) -> bool:
            return _wanted(Schedule.model_validate(found)) == body

        body = _wanted(schedule)
        return Schedule.model_validate(self._transport.put(path, body, path, seen.headers["etag"], made))

    def remove(self, schedule_id: str) -> None:
        """Check no more; what was checked stays."""
        self._transport.send("DELETE", f"/schedules/{schedule_id}")


def _wanted(schedule: Schedule) -> dict[str, Any]:
    names = {"rig", "cron", "timezone", "options", "enabled"}
    body = schedule.model_dump(mode="json", include=names)
    body["webhook"] = None if schedule.webhook is None else schedule.webhook.model_dump(include={"url", "on"})
    return body
