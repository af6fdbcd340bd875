"""A host believes the newest status only, and who wants to stop does not wait for a bus that is down."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.dialogue import Dialogue
from drivers.errors import BusError, CancelledError


class _Answers:
    """Links of which each reading gives the next status: its boot, and the number of its snapshot."""

    description = "test bus"
    raw_bytes_per_s = None

    def __init__(self, *answers: tuple[int, int]) -> None:
        self.left = list(answers)

    def link(self, urgent: bool = False) -> Any:
        return self

    def read(self, group: str) -> dict[str, Any]:
        if not self.left:
            raise BusError("no answer")
        boot, snapshot = self.left.pop(0)
        return {"boot_id": boot, "snapshot": snapshot}

    def close(self) -> None:
        pass


@pytest.mark.parametrize("stale", [7, 6], ids=["the same", "an older one"])
def test_a_status_that_was_given_before_is_asked_for_again(stale: int) -> None:
    dialogue = Dialogue(_Answers((1, 7), (1, stale), (1, 8)), patience_s=10.0)
    assert [dialogue.status()["snapshot"] for _ in range(2)] == [7, 8]


def test_a_bus_that_gives_nothing_but_the_last_status_fails() -> None:
    dialogue = Dialogue(_Answers((1, 7), (1, 7)), patience_s=0.0)
    dialogue.status()
    with pytest.raises(BusError, match="test bus: the controller answered with an older status"):
        dialogue.status()


def test_a_controller_that_has_restarted_counts_anew() -> None:
    dialogue = Dialogue(_Answers((1, 7), (2, 1)), patience_s=0.0)
    assert [dialogue.status()["snapshot"] for _ in range(2)] == [7, 1]


def test_a_count_that_begins_anew_is_believed_once_it_goes_on() -> None:
    """A vendor's counter may have 16 bits, which some twenty minutes of a campaign use up, or no boot_id beside it."""
    dialogue = Dialogue(_Answers((0, 65535), *((0, n) for n in range(20))), patience_s=1.0)
    assert dialogue.status()["snapshot"] == 65535
    first = dialogue.status()["snapshot"]
    assert isinstance(first, int)
    assert first < 10
    assert dialogue.status()["snapshot"] == first + 1


def test_older_statuses_one_after_the_other_are_not_believed_when_they_do_not_go_on() -> None:
    dialogue = Dialogue(_Answers((1, 70), *((1, n) for n in (6, 6, 7, 6, 8, 7, 71))), patience_s=10.0)
    assert [dialogue.status()["snapshot"] for _ in range(2)] == [70, 71]


def test_one_answer_that_a_stop_has_spoilt_on_a_shared_line_is_asked_for_again() -> None:
    dialogue = Dialogue(_Answers((1, 7), (1, 7), (1, 8)), patience_s=10.0)
    dialogue.status()
    dialogue.impatient.set()
    assert dialogue.status()["snapshot"] == 8


def test_who_wants_to_stop_does_not_wait_for_a_bus_that_is_down() -> None:
    dialogue = Dialogue(_Answers(), patience_s=60.0)
    dialogue.impatient.set()
    with pytest.raises(CancelledError, match="the controller's watchdog ends the excitation"):
        dialogue.status()
