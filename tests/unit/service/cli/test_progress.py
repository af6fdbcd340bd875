"""What a person who waits is told: a line now and then in a log, a bar on a terminal."""

import sys
from dataclasses import replace

from service.campaign.progress import Progress
from service.cli.progress import campaign_progress, percent_progress


def report(phase, done, total=100, points_per_s=2.0):
    return Progress(phase, done, total, points_per_s, (total - done) / 2.0, 1.5 * done, f"{phase} {done}")


def on_a_terminal(monkeypatch):
    """From now on stderr is a terminal of 100 columns."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)


def test_a_log_has_a_line_for_every_part_and_not_for_every_point(capsys):
    with campaign_progress() as show:
        for done in range(1, 101):
            show(report("noise" if done <= 10 else "main", done))
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in lines] == ["noise", "main sweep", "main sweep"]
    assert lines[-1].startswith("main sweep: 100 of 100 points")


def test_time_left_is_not_told_before_the_rate_is_worth_believing(capsys):
    for done, told in ((5, False), (50, True)):
        with campaign_progress() as show:
            show(report("main", done))
        assert ("left" in capsys.readouterr().err) is told
    with campaign_progress() as show:
        show(report("main", 50, points_per_s=0.0))  # all of them from an earlier run
    assert "left" not in capsys.readouterr().err


def test_a_terminal_shows_part_points_and_time_left(capsys, monkeypatch):
    on_a_terminal(monkeypatch)
    with campaign_progress() as show:
        show(report("peaks", 60))
    shown = capsys.readouterr().err
    assert "peaks" in shown
    assert "60/100" in shown
    assert "20 s left" in shown


def test_a_record_that_a_slow_line_brings_is_told_with_its_time(capsys, monkeypatch):
    told = "the next one comes over a slow line in some 2 min 47 s"
    waiting = replace(report("noise", 0, points_per_s=0.0), wait_s=167.0)
    with campaign_progress() as show:
        show(waiting)
        show(replace(waiting, done=1))  # at once, though it is of the same part
    assert [told in line for line in capsys.readouterr().err.splitlines()] == [True, True]
    on_a_terminal(monkeypatch)
    with campaign_progress() as show:
        show(waiting)
    assert told in capsys.readouterr().err


def test_a_calculation_is_shown_on_a_terminal_and_silent_in_a_log(capsys, monkeypatch):
    on_a_terminal(monkeypatch)
    with percent_progress("reading") as tell:
        assert tell is not None
        tell("fitting loop_delay", 40.0)
    shown = capsys.readouterr().err
    assert "fitting loop_delay" in shown
    assert "40%" in shown
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False)
    with percent_progress("reading") as tell:
        assert tell is None
    assert capsys.readouterr().err == ""
