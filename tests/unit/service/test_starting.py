"""What starts often starts soon: a library that takes half a second is loaded where it is needed, not before."""

import subprocess
import sys

import pytest

from tests.support.processes import ENVIRONMENT

SLOW = {"scipy.signal", "scipy.stats", "scipy.interpolate", "plotly", "control"}
"""Each takes a third of a second or more; the first three load one another."""
HEAVY = {"scipy.optimize", "numba", "service.identification.fit"}


@pytest.mark.parametrize(
    ("begins_with", "never"),
    [
        ("import service.api.app", SLOW | HEAVY | {"h5py", "scipy"}),
        ("import service.jobs.supervised, service.jobs.campaigns", SLOW | HEAVY),
        ("import drivers.device.__main__, sim.reference as r; r.reference_rig()", SLOW | {"scipy.optimize"}),
        ("import service.identification.fit, service.gap.diagnose, service.checkup", SLOW),
    ],
    ids=["api", "worker", "simulated rig", "calculations"],
)
def test_what_starts_often_loads_no_slow_library(begins_with: str, never: set[str]) -> None:
    code = f"{begins_with}; import sys; print(*sorted({never} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=ENVIRONMENT, check=True)
    assert done.stdout.split() == []
