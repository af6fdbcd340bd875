"""A caller gets its burst and its rate, no caller pays for another, and a million callers do not fill the memory."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.access.errors import RateError
from service.access.rate import Limiter, Rate


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_burst_then_rate():
    clock = Clock()
    limiter = Limiter(Rate(10.0, 5), clock)
    for _ in range(5):
        limiter.take("a")
    with pytest.raises(RateError) as refused:
        limiter.take("a")
    assert refused.value.retry_after_s == pytest.approx(0.1)
    limiter.take("b")
    clock.now += 0.1
    limiter.take("a")


@given(st.lists(st.floats(0, 2), min_size=1, max_size=200))
def test_no_pattern_of_requests_gets_more_than_burst_plus_rate(pauses):
    clock = Clock()
    limiter = Limiter(Rate(3.0, 4), clock)
    passed = 0
    for pause in pauses:
        clock.now += pause
        passed += limiter.wait_s("a") == 0
    assert passed <= 4 + 3.0 * sum(pauses) + 1e-6


@given(st.floats(0.1, 100), st.integers(1, 20))
def test_whoever_waits_as_told_is_let_through(per_s, burst):
    clock = Clock()
    limiter = Limiter(Rate(per_s, burst), clock)
    for _ in range(burst):
        limiter.take("a")
    clock.now += limiter.wait_s("a") * (1 + 1e-9) + 1e-9
    assert limiter.wait_s("a") == 0


def test_number_of_buckets_is_bounded():
    limiter = Limiter(Rate(1.0, 1), Clock(), callers=100)
    for k in range(10_000):
        limiter.take(f"10.0.{k // 256}.{k % 256}")
    assert len(limiter._buckets) == 100


@pytest.mark.parametrize(("per_s", "burst"), [(0, 1), (-1, 1), (1, 0), (float("nan"), 1)])
def test_a_rate_that_lets_nothing_through_is_a_mistake(per_s, burst):
    with pytest.raises(ValueError):
        Rate(per_s, burst)
