"""Rate of requests: one token bucket for each caller, and never more buckets than memory allows."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from service.access.errors import RateError

ROUNDING = 1e-9
"""So much of a token may be missing: whoever waited as told is let through."""


@dataclass(frozen=True)
class Rate:
    """Requests that one caller may make.

    Attributes
    ----------
    per_s
        Lasting rate, 1/s.
    burst
        Requests at once after a pause.
    """

    per_s: float
    burst: int

    def __post_init__(self) -> None:
        if not (self.per_s > 0 and self.burst >= 1):
            raise ValueError("a rate is positive, and a burst at least 1")


class Limiter:
    """Token buckets by caller; safe among threads.

    >>> now = [0.0]
    >>> limiter = Limiter(Rate(per_s=2.0, burst=1), clock=lambda: now[0])
    >>> limiter.wait_s("a"), limiter.wait_s("a"), limiter.wait_s("b")
    (0.0, 0.5, 0.0)
    >>> now[0] = 0.5
    >>> limiter.wait_s("a")
    0.0
    """

    def __init__(self, rate: Rate, clock: Callable[[], float] = time.monotonic, callers: int = 10_000) -> None:
        self.rate = rate
        self._clock = clock
        self._callers = callers
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def wait_s(self, caller: str, cost: float = 1.0) -> float:
        """0 and a token taken, or the seconds until there will be one and nothing taken.

        Parameters
        ----------
        cost
            Tokens to take, at most the burst.
        """
        with self._lock:
            now = self._clock()
            tokens, then = self._buckets.pop(caller, (float(self.rate.burst), now))
            tokens = min(float(self.rate.burst), tokens + (now - then) * self.rate.per_s)
            enough = tokens >= cost - ROUNDING
            self._buckets[caller] = (max(0.0, tokens - cost) if enough else tokens, now)
            while len(self._buckets) > self._callers:  # the one that has been silent longest is full again anyway
                self._buckets.popitem(last=False)
            return 0.0 if enough else (cost - tokens) / self.rate.per_s

    def take(self, caller: str, cost: float = 1.0) -> None:
        """Let one request through.

        Raises
        ------
        RateError
            Too many; carries the seconds to wait.
        """
        if wait := self.wait_s(caller, cost):
            raise RateError(
                f"more than {self.rate.per_s:g} requests a second; wait {wait:.1f} s and try again", retry_after_s=wait
            )
