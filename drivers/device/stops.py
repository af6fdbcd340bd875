"""Who has yet to hear of a stop: what somebody else says is kept until the host that excites the rig knows of it."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T", str, int)

KEPT = 256
"""Hosts that are remembered; of more, those that leased the rig, or said stop, longest ago are forgotten."""


class Stops:
    """Stops of others than the holder, counted, and how many of them each holder has heard of.

    A host is known by the name under which it leases the rig. One that comes back, because its lease lapsed, or as
    another worker that takes its job over, hears what was said meanwhile. A new name has nothing to hear: what was said
    before it came was meant for others.

    A host was *told* when its tone ended, or was refused, for a stop. It *knows* when it has gone on after that, with
    another tone or by giving the lease back: an answer may be lost on the way, and a lease that lapses says nothing.

    Not safe from several threads; the device has a lock.
    """

    def __init__(self) -> None:
        self._said = 0
        self._known: dict[str, int] = {}
        self._by: dict[int, int] = {}
        self._holder = ""
        self._told = 0

    def leased(self, holder: str, token: int) -> None:
        """A lease begins. What the host itself said before, under the token that it had drawn, it need not hear."""
        own = self._by.pop(token, 0)
        self._holder = holder
        self._told = self._known.pop(holder, self._said)
        if self._told == self._said - own:
            self._told = self._said
        self._known[holder] = self._told
        _forget(self._known)

    def say(self, token: int) -> None:
        """Somebody else than the holder says stop."""
        self._said += 1
        if token:
            self._by[token] = self._by.pop(token, 0) + 1
            _forget(self._by)

    @property
    def untold(self) -> bool:
        """Whether something was said that the holder was not told."""
        return self._said > self._told

    def tell(self) -> None:
        """The holder is told of all that was said."""
        self._told = self._said

    def known(self) -> None:
        """The holder goes on: it knows what it was told."""
        self._known[self._holder] = self._told


def _forget(remembered: dict[T, int]) -> None:
    """The first that came, when there are too many."""
    if len(remembered) > KEPT:
        del remembered[next(iter(remembered))]
