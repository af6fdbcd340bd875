"""Signs of life, whatever the clocks of the machines say."""

import time
from datetime import datetime, timedelta

import pytest

from service.errors import ConflictError
from service.storage import database as module
from service.storage import workers
from service.storage.tables import WorkerRow
from tests.support.databases import BOTH, migrated

TIMEOUT_S = 30.0


@pytest.fixture(params=BOTH)
def database(request, tmp_path):
    with migrated(request.param, tmp_path) as database:
        yield database


@pytest.fixture
def machine_with(monkeypatch):
    """From now on this is a machine whose clock differs by so many seconds."""

    def begin(seconds):
        class Clock(datetime):
            @classmethod
            def now(cls, tz=None):
                return datetime.now(tz) + timedelta(seconds=seconds)

        monkeypatch.setattr(module, "datetime", Clock)

    return begin


@pytest.fixture
def beating(database):
    """A worker of another machine, which has just given a sign of life."""
    with database.write() as session:
        workers.sign_on(session, "A", "wrk_a")
        session.get(WorkerRow, "A").machine = "another"
    with database.write() as session:
        assert workers.beat(session, "A", "wrk_a")


@pytest.mark.parametrize("seconds", [40.0, -40.0])
@pytest.mark.usefixtures("beating")
def test_a_worker_that_lives_is_not_silent_by_the_clock_of_another_machine(database, machine_with, seconds):
    """Else its job would be taken from it, while it moves a rotor, every few seconds anew."""
    machine_with(seconds)
    with database.read() as session:
        assert workers.silent(session, TIMEOUT_S) == []
        assert workers.count_alive(session) == 1
        assert workers.named(session, "A") is not None
        assert workers.elsewhere(session).name == "A"
    with database.write() as session, pytest.raises(ConflictError, match="runs on another"):
        workers.sign_on(session, "A", "wrk_b")


@pytest.mark.parametrize("seconds", [40.0, -40.0])
def test_a_worker_that_died_is_silent_whatever_its_own_clock_said(database, machine_with, seconds):
    machine_with(seconds)
    with database.write() as session:
        workers.sign_on(session, "A", "wrk_a")
        assert workers.beat(session, "A", "wrk_a")
    machine_with(0.0)
    time.sleep(0.2)
    with database.read() as session:
        assert workers.silent(session, 0.1) == ["A"]
        assert workers.silent(session, TIMEOUT_S) == []


@pytest.mark.usefixtures("beating")
def test_a_worker_that_ended_in_good_order_is_not_alive(database):
    with database.write() as session:
        workers.sign_off(session, "A", "wrk_a")
    with database.read() as session:
        assert workers.count_alive(session) == 0
        assert workers.living(session) == []
