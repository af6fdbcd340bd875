"""Campaigns on the simulated rig for tests: small plans, rigs with something wrong on the way, comparisons."""

from pathlib import Path
from typing import Any

import numpy as np

from drivers.simulated.driver import SimulatedController
from service.campaign.aims import Profile
from service.campaign.run import run_campaign
from service.experiment.data import Experiment
from sim.reference import reference_datasheet, reference_rig
from sim.twin import linear_model

SMALL = Profile(
    accuracy=0.005, points=24, validation_points=5, amplifier_points=5, coarse_points=8, rig_seconds=100.0
)  # fmt: skip
PEAKS = Profile(
    accuracy=0.005,
    from_hz=380.0,
    points=45,
    validation_points=4,
    amplifier_points=2,
    coarse_points=6,
    rig_seconds=120.0,
)
SHEET = reference_datasheet()


def campaign(rig: Any, folder: Path, profile: Profile = SMALL, sheet: Any = SHEET, **options: Any) -> Experiment:
    controller = rig if not hasattr(rig, "rotor") else SimulatedController(rig, seed=1)
    return run_campaign(controller, sheet, folder, profile=profile, **options)


def assert_same(one: Experiment, other: Experiment) -> None:
    assert [s.comment for s in one.sweeps] == [s.comment for s in other.sweeps]
    for a, b in zip(one.sweeps, other.sweeps, strict=True):
        assert a.flags == b.flags
        for name in ("frequency_hz", "axis", "amplitude_a", "U", "I", "Y"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=0, err_msg=name)


def plant(sweep, n=4):
    """Frequencies and G = Y U^-1, (F, n, n)."""
    f = np.unique(sweep.frequency_hz)
    assert sweep.n_points == n * len(f)
    assert np.array_equal(sweep.axis, np.tile(np.arange(n), len(f)))
    U, Y = (x[:, :, 1].mean(axis=1).reshape(len(f), n, n).swapaxes(1, 2) for x in (sweep.U, sweep.Y))
    return f, Y @ np.linalg.inv(U)


def relative_error(sweep, rig):
    f, G = plant(sweep)
    truth = linear_model(rig, f).y_per_u
    plane = np.kron(np.eye(2), np.ones((2, 2)))
    return f, np.linalg.norm((G - truth) * plane, axis=(1, 2)) / np.linalg.norm(truth * plane, axis=(1, 2))


class Faulty:
    """A simulated rig with something wrong on the way: ``fault(n)`` may raise before the n-th measurement."""

    def __init__(self, fault, rig=None):
        self.inner = SimulatedController(rig or reference_rig(), seed=1)
        self.fault, self.n, self.stops = fault, 0, 0

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def measure(self, tone):
        self.n += 1
        self.fault(self.n)
        return self.inner.measure(tone)

    def stop(self):
        self.stops += 1
        self.inner.stop()


def interrupted_at(n, error):
    def fault(k):
        if k == n:
            raise error

    return fault
