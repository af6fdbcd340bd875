"""A calculation is seldom interrupted by another one of its kind, and still comes after requests and rigs."""

import ctypes
import os
import platform
import sys

import pytest

from service.jobs import slices
from service.jobs.calculator import Calculator

_SCHED_GETATTR = {number: number + 1 for number in slices._SCHED_SETATTR.values()}


def asked_of_the_kernel(pid):
    """Nice value and slice of a process, ns, as the kernel has them."""
    number = _SCHED_GETATTR[slices._SCHED_SETATTR[platform.machine()]]
    answer = ctypes.create_string_buffer(slices._SCHED_ATTR.size)
    assert ctypes.CDLL(None).syscall(number, pid, answer, len(answer), 0) == 0
    _, _, _, nice, _, runtime_ns, _, _ = slices._SCHED_ATTR.unpack(answer)
    return nice, runtime_ns


@pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() not in slices._SCHED_SETATTR, reason="no slices to ask for here"
)
def test_a_child_that_calculates_has_long_slices_and_is_nice():
    calculator = Calculator()
    child = calculator._take()
    try:
        child.ask({"function": "health_plan", "arguments": {}}, lambda: False, lambda *_: None)  # it has begun
        nice, slice_ns = asked_of_the_kernel(child.process.pid)
    finally:
        child.kill()
    assert nice >= os.getpriority(os.PRIO_PROCESS, 0) + 10 or nice == 19
    if tuple(map(int, platform.release().split("-")[0].split(".")[:2])) >= (6, 12):
        assert slice_ns == slices.SLICE_NS


def test_another_processor_or_system_is_left_as_it_is(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "unknown")
    assert not slices.lengthen()
