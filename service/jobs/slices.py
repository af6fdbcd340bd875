"""How long a calculation runs before another one has its turn on the same core.

Where more calculations run than there are cores, Linux changes between them every few milliseconds, and each time the
caches are filled again, which costs every one of them CPU time (`benchmarks/api.py workers` shows what is left of it).
Requests and rigs do not wait for the end of a slice: a process that wakes with a shorter one comes first.
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
import sys

SLICE_NS = 100_000_000
"""The longest that Linux grants."""
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}
"""Numbers of the system call; most C libraries have no function for it."""
_SCHED_ATTR = struct.Struct("=IIQiIQQQ")
"""struct sched_attr of Linux 3.14: size, policy, flags, nice, priority, runtime, deadline, period."""


def lengthen() -> bool:
    """Ask for long slices for this process and those that it starts; whether the kernel took the request.

    Kernels before 6.12 take it and change nothing; elsewhere than on Linux there is nothing to ask.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if sys.platform != "linux" or number is None:
        return False
    policy, nice = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    if policy not in (os.SCHED_OTHER, os.SCHED_BATCH):
        return False
    request = _SCHED_ATTR.pack(_SCHED_ATTR.size, policy, 0, nice, 0, SLICE_NS, 0, 0)
    return int(ctypes.CDLL(None).syscall(number, 0, ctypes.create_string_buffer(request), 0)) == 0
