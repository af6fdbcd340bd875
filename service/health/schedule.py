"""When checks are due, and which were missed: arithmetic on cron expressions, no clock of its own.

>>> from datetime import datetime, timezone
>>> at = datetime(2026, 3, 1, 12, 0, tzinfo=timezone.utc)
>>> next_run("30 6 * * *", at).isoformat()
'2026-03-02T06:30:00+00:00'
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from zoneinfo import ZoneInfo

from croniter import CroniterBadCronError, CroniterBadDateError, croniter

from sim.errors import AmbError

SHORTEST = timedelta(minutes=5)
"""A rig is not checked more often: a check takes minutes."""
TELLS = 400
"""Intervals of an expression that are looked at, to find its shortest."""
MOST_MISSED = 1000
DRAWN = "RrHh"
"""Beginnings of a field that `croniter` draws anew whenever it is asked, or from a name that a schedule lacks."""

OF_A_MACHINE = ("localtime", "posixrules")
"""What some systems keep beside the time zones: links to the one that the machine was given."""


class ScheduleError(AmbError):
    """A schedule that cannot be kept: the message says why."""


def checked(cron: str, timezone: str = "UTC") -> str:
    """The expression, when it is one of five fields whose times exist and are far enough apart.

    Raises
    ------
    ScheduleError
        It is not.

    >>> checked(" 0 6 * *  1-5")
    '0 6 * * 1-5'
    """
    expression = " ".join(cron.split())
    zone = _zone(timezone)
    if len(expression.split()) != 5:
        raise ScheduleError(
            f"schedule {cron!r} is no cron expression of five fields (minute hour day month weekday); "
            "'0 6 * * *' is every day at six"
        )
    if drawn := [field for field in expression.split() if field[0] in DRAWN]:
        raise ScheduleError(
            f"schedule {cron!r} cannot be kept: {drawn[0]!r} is drawn by chance; give the numbers, as 30 for the minute"
        )
    start = datetime(2026, 1, 1, tzinfo=UTC).astimezone(zone)
    times: list[datetime] = []
    try:
        runs = croniter(expression, start)
        while len(times) < TELLS:
            times.append(runs.get_next(datetime))
    except (CroniterBadCronError, CroniterBadDateError, ValueError, KeyError) as error:
        if not times:  # one that is due so seldom that the calendar ends before is kept
            raise ScheduleError(f"schedule {cron!r} cannot be read: {str(error).splitlines()[0]}") from error
    shortest = min((b.astimezone(UTC) - a.astimezone(UTC) for a, b in pairwise(times)), default=SHORTEST)
    if shortest < SHORTEST:
        raise ScheduleError(
            f"schedule {cron!r} runs every {shortest.total_seconds():.0f} s; a check takes minutes: leave at least "
            f"{SHORTEST.total_seconds() / 60:.0f} minutes between two"
        )
    return expression


def next_run(cron: str, after: datetime, timezone: str = "UTC") -> datetime:
    """First due time after an instant, UTC. The expression is read in the schedule's own time zone."""
    return _next(cron, after.astimezone(_zone(timezone)))


def due_runs(cron: str, since: datetime, until: datetime, timezone: str = "UTC") -> list[datetime]:
    """Due times in (since, until], UTC; at most the last thousand."""
    zone = _zone(timezone)
    found: list[datetime] = []
    now = since
    while (now := _next(cron, now.astimezone(zone))) <= until:
        found.append(now)
        if len(found) > 2 * MOST_MISSED:
            del found[:MOST_MISSED]
    return found[-MOST_MISSED:]


def _next(cron: str, after: datetime) -> datetime:
    """First due time after an instant of a zone, UTC.

    A time of day that comes twice, as clocks are put back, is due the first time only, but for what runs every hour.
    One that does not come, as they are put forward, is due when they are (so do Vixie's cron, and croniter).
    """
    try:
        runs = croniter(cron, after)
        found: datetime = runs.get_next(datetime)
        while found.fold and runs.expanded[1] != ["*"]:
            found = runs.get_next(datetime)
    except (CroniterBadCronError, CroniterBadDateError) as error:
        raise ScheduleError(f"schedule {cron!r} cannot be read: {str(error).splitlines()[0]}") from error
    return found.astimezone(UTC)


@dataclass(frozen=True)
class Kept:
    """How a schedule was kept over some time."""

    missed: tuple[datetime, ...]
    """Due times at which no check began, UTC: the service was down, or the rig was busy for too long."""
    pending: datetime | None
    """A due time that has passed and may still begin."""
    next: datetime
    """The next due time."""


def kept(
    cron: str,
    since: datetime,
    now: datetime,
    started: Sequence[datetime],
    timezone: str = "UTC",
    grace: timedelta = timedelta(minutes=15),
) -> Kept:
    """Which due times were missed.

    Parameters
    ----------
    since
        When the schedule was made, or what was told before.
    started
        When checks of this schedule began (or were enqueued).
    grace
        So long after its due time a check may begin. A check belongs to the last due time before it that has none.
    """
    due = due_runs(cron, since, now, timezone)
    begun = sorted(s.astimezone(UTC) for s in started)
    missed = []
    pending = None
    for k, time in enumerate(due):
        until = due[k + 1] if k + 1 < len(due) else None
        mine = [s for s in begun if s >= time and (until is None or s < until)]
        if mine:
            continue
        if until is None and now - time <= grace:
            pending = time
        else:
            missed.append(time)
    return Kept(tuple(missed), pending, next_run(cron, now, timezone))


def _zone(name: str) -> ZoneInfo:
    if name in OF_A_MACHINE:
        raise ScheduleError(
            f"the time zone {name!r} is another one on every machine; give its name, as 'Europe/Zurich'"
        )
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError) as error:
        raise ScheduleError(f"no time zone {name!r} is known here; give one such as 'Europe/Zurich'") from error
