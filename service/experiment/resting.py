"""The static load: the mean current that holds the rotor where nothing excites it, told by the log.

A lying rotor hangs in its magnets, one off their centre is pulled aside, and an integrator holds either at the sensors'
zero with a mean current. Position stiffness grows with it, ks (1 + (i/i0)^2), and a datasheet states neither the weight
on an axis nor where the load comes from. So the twin works where the rig does: at the current that was measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from sim import actuator
from sim.rig import Rig

Real = NDArray[np.float64]

NOTICED = 0.005
"""Share of the bias current from which a mean current is a load: it makes ks 0.0025 % larger."""


def resting_current(sweep: Sweep, rig: Rig) -> Real | None:
    """Mean coil current of every axis over the finite points, A, (n,); None where next to nothing, or not logged."""
    if 0 not in sweep.harmonics:
        return None
    k, amplifiers = sweep.harmonics.index(0), rig.amplifiers
    if sweep.I is not None:
        current = _mean(sweep.I, k)
    else:
        current = amplifiers.gain * (amplifiers.crosstalk @ _mean(sweep.U, k))
    return current if np.any(np.abs(current) > NOTICED * rig.magnets.bias_current_a) else None


def about_rest(sweep: Sweep) -> Sweep:
    """The sweep with the means of u and i counted from those of all its points; as it is where it has none."""
    if 0 not in sweep.harmonics:
        return sweep
    k = sweep.harmonics.index(0)

    def counted(X: NDArray[np.complex128]) -> NDArray[np.complex128]:
        X = X.copy()
        X[:, :, k] -= _mean(X, k)
        return X

    return replace(sweep, U=counted(sweep.U), I=None if sweep.I is None else counted(sweep.I))


def held_at(rig: Rig, current_a: Real) -> Rig:
    """The rig with a load that this current holds, (n,)."""
    most = 0.99 * rig.magnets.current_limit_a
    return replace(rig, static_current_a=np.clip(current_a, -most, most))


def load_in_words(rig: Rig, plain: Rig) -> str:
    """What the load makes of the magnets, in words; ``plain`` is the rig without it."""
    assert rig.static_current_a is not None
    more = 100 * (actuator.operating_point(rig).ks / actuator.operating_point(plain).ks - 1).max()
    amperes = ", ".join(f"{axis} {i:.2f} A" for axis, i in zip(rig.axes, rig.static_current_a, strict=True))
    return (
        f"mean currents hold a static load ({amperes}), which makes position stiffness up to {more:.2g} % larger than "
        "the datasheet states for the unloaded bearings"
    )


def _mean(X: NDArray[np.complex128], k: int) -> Real:
    finite = np.isfinite(X).all(axis=(1, 2, 3))
    return np.asarray(X[finite, :, k].real.mean(axis=(0, 1))) if finite.any() else np.zeros(X.shape[-1])
