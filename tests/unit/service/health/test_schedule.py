"""Cron arithmetic: due, kept, missed."""

import re
from datetime import UTC, datetime, timedelta

import pytest

from service.health.schedule import ScheduleError, checked, due_runs, kept, next_run


def at(text: str) -> datetime:
    return datetime.fromisoformat(text).replace(tzinfo=UTC)


def test_next_run_is_after_and_never_at_the_instant():
    assert next_run("0 6 * * *", at("2026-03-01T06:00")) == at("2026-03-02T06:00")
    assert next_run("0 6 * * *", at("2026-03-01T05:59:59")) == at("2026-03-01T06:00")


def test_an_expression_is_read_in_its_own_time_zone_over_a_change_of_clocks():
    # Zurich goes from UTC+1 to UTC+2 on 29 March 2026
    runs = due_runs("30 6 * * *", at("2026-03-28T00:00"), at("2026-03-31T00:00"), "Europe/Zurich")
    assert runs == [at("2026-03-28T05:30"), at("2026-03-29T04:30"), at("2026-03-30T04:30")]


@pytest.mark.parametrize(
    ("cron", "autumn", "spring"),
    [
        ("30 2 * * *", ["00:30"], ["01:00"]),
        ("30 1-3 * * *", ["23:30", "00:30", "02:30"], ["00:30", "01:00", "01:30"]),
        ("0 */2 * * *", ["22:00", "00:00", "03:00"], ["23:00", "01:00", "02:00"]),
        ("30 * * * *", ["22:30", "23:30", "00:30", "01:30", "02:30"], ["23:30", "00:30", "01:30", "02:30"]),
    ],
)
def test_a_check_is_due_once_in_the_hour_that_comes_twice_and_in_that_which_does_not_come(cron, autumn, spring):
    """Zurich's 02:00 to 03:00 comes twice on 25 October 2026, at 00:00 and 01:00 UTC, and not at all on 29 March."""
    for night, hours, expected in (("2026-10-24T21:45", 5.5, autumn), ("2026-03-28T22:45", 4.0, spring)):
        runs = due_runs(cron, at(night), at(night) + timedelta(hours=hours), "Europe/Zurich")
        assert [r.strftime("%H:%M") for r in runs] == expected


def test_a_service_that_starts_in_the_repeated_hour_does_not_check_again():
    assert next_run("30 2 * * *", at("2026-10-25T01:10"), "Europe/Zurich") == at("2026-10-26T01:30")


def test_a_service_that_was_down_has_missed_runs_that_show():
    cron = "0 6 * * *"
    started = [at("2026-03-01T06:00:02"), at("2026-03-05T06:00:01")]
    found = kept(cron, at("2026-03-01T00:00"), at("2026-03-06T05:00"), started)
    assert found.missed == (at("2026-03-02T06:00"), at("2026-03-03T06:00"), at("2026-03-04T06:00"))
    assert found.pending is None
    assert found.next == at("2026-03-06T06:00")


def test_a_run_may_be_late_but_not_forever():
    cron, since = "0 6 * * *", at("2026-03-01T00:00")
    soon = kept(cron, since, at("2026-03-01T06:10"), [])
    assert soon.pending == at("2026-03-01T06:00")
    assert soon.missed == ()
    late = kept(cron, since, at("2026-03-01T06:20"), [], grace=timedelta(minutes=15))
    assert late.missed == (at("2026-03-01T06:00"),)
    begun = kept(cron, since, at("2026-03-01T09:00"), [at("2026-03-01T08:59")])
    assert begun.missed == ()


def test_one_check_serves_one_due_time_only():
    found = kept("0 * * * *", at("2026-03-01T00:30"), at("2026-03-01T03:30"), [at("2026-03-01T02:05")])
    assert found.missed == (at("2026-03-01T01:00"), at("2026-03-01T03:00"))


@pytest.mark.parametrize(
    "wrong", ["", "every day", "0 6 * *", "61 6 * * *", "* * * * *", "*/2 * * * *", "0 0 30 2 *", "0 6 * * * *"]
)
def test_a_schedule_that_cannot_be_kept_is_refused(wrong):
    with pytest.raises(ScheduleError):
        checked(wrong)


@pytest.mark.parametrize(
    ("cron", "field"),
    [
        ("R * * * *", "R"),
        ("0 r * * *", "r"),
        ("0 R(1-5) * * *", "R(1-5)"),
        ("R/30 * * * *", "R/30"),
        ("H 6 * * *", "H"),
    ],
)
def test_a_field_that_is_drawn_is_refused(cron, field):
    """It is another time whenever one asks: at times within minutes of the last one, and no run of it can be missed."""
    with pytest.raises(ScheduleError, match=re.escape(f"{field!r} is drawn by chance; give the numbers")):
        checked(cron)


def test_names_of_days_and_months_are_not_taken_for_such():
    assert checked("0 6 * MAR,oct Thu-fri") == "0 6 * MAR,oct Thu-fri"


def test_a_good_schedule_is_kept_as_it_is():
    assert checked("*/30 6-18 * * mon-fri", "Europe/Zurich") == "*/30 6-18 * * mon-fri"
    with pytest.raises(ScheduleError, match="time zone"):
        checked("0 6 * * *", "Mars/Olympus")


def test_a_schedule_that_is_due_once_in_decades_is_kept():
    """On a 29 February that is the fifth Monday: the calendar ends before a few hundred of them."""
    assert checked("0 6 29 2 1#5") == "0 6 29 2 1#5"
    assert next_run("0 6 29 2 1#5", at("2026-01-01T00:00")) == at("2044-02-29T06:00")


@pytest.mark.parametrize("zone", ["localtime", "posixrules"])
def test_a_time_zone_that_differs_by_machine_is_refused(zone):
    with pytest.raises(ScheduleError, match="another one on every machine"):
        checked("0 6 * * *", zone)


def test_a_long_absence_is_cut_to_the_latest_thousand():
    runs = due_runs("*/5 * * * *", at("2026-01-01T00:00"), at("2026-01-15T00:00"))
    assert len(runs) == 1000
    assert runs[-1] == at("2026-01-15T00:00")
