"""Who may excite, and until when; on a clock that the test turns."""

import pytest

from drivers.device.lease import LeaseTable
from drivers.errors import LeaseError


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def table(clock: Clock) -> LeaseTable:
    return LeaseTable(clock, watchdog_s=0.2)


def test_lease_runs_out_when_nobody_renews_it(table: LeaseTable, clock: Clock) -> None:
    token = table.acquire("one", 5.0)
    assert table.holder() == ("one", 5.0)
    clock.now += 4.9
    assert table.holds(token)
    clock.now += 0.2
    assert not table.holds(token)
    assert table.holder() == ("", 0.0)
    table.acquire("two", 5.0)


def test_heartbeat_renews_and_feeds_the_watchdog(table: LeaseTable, clock: Clock) -> None:
    token = table.acquire("one", 5.0)
    for count in range(1, 200):
        clock.now += 0.15
        assert table.beat(token, count)
        assert not table.silent()
    assert table.holder()[1] == 5.0
    clock.now += 0.21
    assert table.silent()


def test_counter_that_stands_still_is_no_sign_of_life(table: LeaseTable, clock: Clock) -> None:
    """A frame that a broken bus repeats for ever does not keep the excitation on."""
    token = table.acquire("one", 5.0)
    assert table.beat(token, 1)
    clock.now += 0.15
    assert not table.beat(token, 1)
    clock.now += 0.1
    assert table.silent()


def test_stranger_cannot_feed_release_or_take(table: LeaseTable) -> None:
    token = table.acquire("one", 5.0)
    assert not table.beat(token + 1, 1)
    assert not table.release(token + 1)
    with pytest.raises(LeaseError, match=r"'one' for another 5\.0 s"):
        table.acquire("two", 5.0)
    with pytest.raises(LeaseError):
        table.require(token + 1)
    with pytest.raises(LeaseError):
        table.require(0)


def test_asking_again_with_the_same_token_is_harmless(table: LeaseTable, clock: Clock) -> None:
    assert table.acquire("one", 5.0, token=77) == 77
    clock.now += 3
    assert table.acquire("one", 5.0, token=77) == 77
    assert table.holder() == ("one", 5.0)


def test_lease_of_the_own_process_never_lapses(table: LeaseTable, clock: Clock) -> None:
    token = table.acquire("here", 5.0, attached=True)
    clock.now += 1e6
    assert table.holds(token)
    assert not table.silent()
    assert table.holder() == ("here", 5.0)


def test_nobody_holds_no_lease(table: LeaseTable) -> None:
    with pytest.raises(LeaseError, match="does not hold the rig's lease"):
        table.require(5)
    assert table.silence_s() == float("inf")
