"""Nuisance parameters: the uncertain values of a datasheet, which every candidate is fitted beside.

Each is scaled to its own tolerance, and errors with one cause are correlated. The vector theta that is fitted has a
unit-normal prior; the root of the correlation matrix turns it into deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from sim.datasheet import Datasheet, Tolerance
from sim.rig import FlexibleMode, Rig
from sim.twin import rig_from_datasheet

Real = NDArray[np.float64]

ASSUMED_DOF = 4.0
"""Degrees of freedom of Student's t for assumed tolerances (Lange, Little and Taylor, JASA 84, 1989, pp. 881-896):
within its tolerance a value costs what it would with a normal, at twice it 3.5 instead of 4, at four 8, not 16."""

MODES_CORRELATION, DAMPING_CORRELATION = 0.75, 0.5
"""Correlation of a mode's errors in the two planes, and of its damping's: a datasheet states one mode for both, and
the rotor is nearly the same in them. By tolerances of 0.5 and 50 %, the planes' frequencies then differ by 0.35 % and
their dampings by a factor of 1.6, one sigma; in the reference rig by 0.19 and 0.12 %, by factors of 1.1 and 2.1."""
MAGNETS_CORRELATION = 0.5
"""Correlation of the magnets' errors: one design, one air gap and one bias stand behind them. The reference rig's
magnets had half of the force of their design, all four."""

LARGEST = 2.0
"""Relative tolerance, one sigma, beyond which a value is as good as unknown: of a factor e^2, and four of them are the
most that a fit goes."""
FAR_OFF = 2.5
"""Tolerances from which a value of the datasheet is reported as off."""
BEYOND_DOUBT = 3.5
"""Tolerances from which a single value is so by no chance: of some fifty values one gets there in one of forty rigs."""


@dataclass(frozen=True)
class Nuisance:
    """Nuisance vector theta of unit normals -> deviations from the datasheet -> rig.

    Blocks of the deviations, in order: ki and ks per axis, amplifier gain, frequency and damping per axis, sensor
    gain per axis (all logarithmic), mass, inertia (logarithmic), sensor positions A and B, then per plane and mode
    frequency and damping (logarithmic) and shapes at bearings and sensors. The vector ``theta`` has the same blocks;
    where errors are correlated, each of its values moves the others' deviations along.
    """

    rig: Rig
    """The twin at zero deviation, effects of its datasheet included."""
    sigma: Real
    """(k,) physical size of one tolerance."""
    root: Real
    """(k, k) symmetric root of the correlation: deviations in tolerances are root theta"""
    names: tuple[str, ...]
    stated: bool
    """whether the datasheet states the tolerances; else they are this product's defaults"""
    n_modes: int
    """modes of the datasheet, per plane; an effect that it names may add others to the rig, after these"""

    def __len__(self) -> int:
        return len(self.sigma)

    def at(self, theta: Real, base: Rig | None = None) -> Rig:
        """The rig at ``theta``, (k,); ``base`` may be the datasheet's rig with other effects."""
        rig = base or self.rig
        n = rig.n_axes
        v = iter(np.split(self.off(theta) * self.sigma, self._splits(n)))
        magnets = replace(rig.magnets, ki=rig.magnets.ki * np.exp(next(v)), ks=rig.magnets.ks * np.exp(next(v)))
        amp = rig.amplifiers
        gain, frequency, damping = np.exp(next(v)), np.exp(next(v)), np.exp(next(v))
        amplifiers = replace(
            amp,
            gain=amp.gain * gain,
            natural_frequency_rad_s=amp.natural_frequency_rad_s * frequency,
            damping_ratio=None if amp.damping_ratio is None else amp.damping_ratio * damping,
        )
        sensors = replace(rig.sensors, gain=rig.sensors.gain * np.exp(next(v)))
        mass, inertia, shift = next(v)[0], next(v)[0], next(v)
        a, b = rig.rotor.sensor_from_cog_m
        planes = []
        for plane in rig.rotor.modes:
            modes = []
            for mode in plane[: self.n_modes]:
                d = next(v)
                modes.append(
                    FlexibleMode(
                        mode.natural_frequency_rad_s * float(np.exp(d[0])),
                        mode.damping_ratio * float(np.exp(d[1])),
                        (mode.shape_at_bearings[0] + float(d[2]), mode.shape_at_bearings[1] + float(d[3])),
                        (mode.shape_at_sensors[0] + float(d[4]), mode.shape_at_sensors[1] + float(d[5])),
                        mode.gyroscopic,
                        mode.internal_damping_ratio,
                    )
                )
            planes.append((*modes, *plane[self.n_modes :]))
        rotor = replace(
            rig.rotor,
            mass_kg=rig.rotor.mass_kg * float(np.exp(mass)),
            transverse_inertia_kgm2=rig.rotor.transverse_inertia_kgm2 * float(np.exp(inertia)),
            sensor_from_cog_m=(a + float(shift[0]), b + float(shift[1])),
            modes=tuple(planes),
        )
        return replace(rig, magnets=magnets, amplifiers=amplifiers, sensors=sensors, rotor=rotor)

    def off(self, theta: Real) -> Real:
        """Deviations from the datasheet in its tolerances, (k,)."""
        return np.asarray(self.root @ theta)

    @property
    def per_unit(self) -> Real:
        """(k, k) physical deviations per unit of the vector."""
        return np.asarray(self.sigma[:, None] * self.root)

    def price(self, theta: Real) -> float:
        """Penalty of some of the deviations by their tolerances, as a chi-square.

        Assumed tolerances say little of a value far beyond them: there it is Student's t, not a normal.
        """
        if self.stated:
            return float(theta @ theta)
        return float((ASSUMED_DOF + 1) * np.log1p(theta**2 / ASSUMED_DOF).sum())

    def surprise(self, theta: Real, of: Sequence[int]) -> float:
        """Chi-square of some of the deviations at ``theta``, (k,), with their correlation, whatever the others are.

        ``of`` are their indices.
        """
        correlation, off = (self.root @ self.root)[np.ix_(of, of)], self.off(theta)[list(of)]
        return float(off @ np.linalg.solve(correlation, off))

    def far_off(self, theta: Real, least: float = FAR_OFF) -> list[str]:
        """Values of the datasheet that are off by more than ``least`` of their tolerances, in words, farthest first."""
        return self._in_words(self.off(theta), np.abs(self.off(theta)) > least)

    def clearly_off(self, theta: Real) -> list[str]:
        """Values that are off beyond doubt: one by `BEYOND_DOUBT`, or the same one of several axes by `FAR_OFF`."""
        off = self.off(theta)
        far = np.abs(off) > FAR_OFF
        kinds = np.array([name if name.startswith("mode") else name.rpartition("_")[0] for name in self.names])
        several = np.array([np.sum(far & (kinds == kind)) > 1 for kind in kinds])
        return self._in_words(off, far & (several | (np.abs(off) > BEYOND_DOUBT)))

    def _in_words(self, off: Real, which: NDArray[np.bool_]) -> list[str]:
        """Some of the deviations in words, the farthest first."""
        order = [int(k) for k in np.argsort(-np.abs(off)) if which[k]]
        return [f"{_words(self.names[k])} {_moved(self.names[k], float(off[k] * self.sigma[k]))}" for k in order]

    def _splits(self, n: int) -> Real:
        """Where the blocks of the deviations end, for `numpy.split`."""
        sizes = [n, n, n, n, n, n, 1, 1, 2] + [6] * (self.n_modes * (n // 2))
        return np.cumsum(sizes)[:-1]


def nuisance(datasheet: Datasheet) -> Nuisance:
    """The nuisance parameters of a datasheet."""
    rig, t, n = rig_from_datasheet(datasheet), _bounded(datasheet), datasheet.n_axes
    per_axis = [
        ("ki", t.current_stiffness),
        ("ks", t.position_stiffness),
        ("amplifier_gain", t.amplifier_gain),
        ("amplifier_frequency", t.amplifier_frequency),
        ("amplifier_damping", t.amplifier_damping),
        ("sensor_gain", t.sensor_gain),
    ]
    names = [f"{name}_{axis}" for name, _ in per_axis for axis in datasheet.axes]
    sigma = [s for _, s in per_axis for _ in range(n)]
    names += ["mass", "transverse_inertia", "sensor_position_A", "sensor_position_B"]
    sigma += [t.mass, t.transverse_inertia, t.sensor_position_m, t.sensor_position_m]
    for plane in ("x", "y")[: n // 2]:
        for k, mode in enumerate(datasheet.modes):
            shapes = np.array([*mode.shape_at_bearings, *mode.shape_at_sensors])
            # A shape near a node is known to a share of the mode's size, not of its own small value.
            spread = t.mode_shape * np.maximum(np.abs(shapes), 0.2 * np.abs(shapes).max())
            labels = ("frequency", "damping", "bearing_A", "bearing_B", "sensor_A", "sensor_B")
            names += [f"mode{k + 1}_{label}_{plane}" for label in labels]
            sigma += [t.mode_frequency, t.mode_damping, *spread.tolist()]
    root = _root(_correlation(len(sigma), n, len(datasheet.modes)))
    return Nuisance(
        rig, np.array(sigma, dtype=float), root, tuple(names), datasheet.tolerance_stated, len(datasheet.modes)
    )


def _bounded(datasheet: Datasheet) -> Tolerance:
    """The datasheet's tolerances, none so large that values a few of them away are beyond arithmetic."""
    largest = dict.fromkeys((f.name for f in fields(Tolerance)), LARGEST)
    largest["sensor_position_m"] = min(datasheet.sensor_from_cog_m)
    return Tolerance(**{name: min(getattr(datasheet.tolerance, name), most) for name, most in largest.items()})


def _correlation(k: int, n: int, modes: int) -> Real:
    """Correlation of ``k`` deviations, (k, k): ki and ks of n magnets come first, the planes' modes last."""
    correlation = np.eye(k)
    for block in (slice(0, n), slice(n, 2 * n)):
        correlation[block, block] += MAGNETS_CORRELATION * (1 - np.eye(n))
    if n == 4:
        of_modes = np.tile([MODES_CORRELATION, DAMPING_CORRELATION, *[MODES_CORRELATION] * 4], modes)
        y = k - len(of_modes) + np.arange(len(of_modes))
        x = y - len(of_modes)
        correlation[x, y] = correlation[y, x] = of_modes
    return correlation


def _root(correlation: Real) -> Real:
    """The symmetric root: of all roots, the one whose vector stays nearest to the deviations.

    >>> root = _root(np.array([[1.0, 0.75], [0.75, 1.0]]))
    >>> np.round(root, 3)
    array([[0.911, 0.411],
           [0.411, 0.911]])
    >>> np.round(root @ root, 3)
    array([[1.  , 0.75],
           [0.75, 1.  ]])
    """
    variances, along = np.linalg.eigh(correlation)
    return np.asarray((along * np.sqrt(variances)) @ along.T)


def _words(name: str) -> str:
    """A value's name in words.

    >>> _words("ki_xA"), _words("mode1_frequency_y")
    ('current stiffness xA', 'mode1 frequency y')
    """
    what, _, rest = name.partition("_")
    known = {"ki": "current stiffness", "ks": "position stiffness"}
    return f"{known.get(what, what)} {rest}".replace("_", " ").strip()


def _moved(name: str, by: float) -> str:
    """Error of the datasheet's value where the fitted one is ``by`` above it: datasheet less fit, in words.

    >>> _moved("ki_xA", -0.6), _moved("sensor_position_A", 3e-3), _moved("mode1_bearing_B_x", 0.02)
    ('+82 %', '-3 mm', '-0.02 1/sqrt(kg)')
    >>> _moved("ks_xA", -6.9)
    '+99000 %'
    """
    if name.startswith("sensor_position"):
        return f"{-1e3 * by:+.2g} mm"
    if "_bearing_" in name or "_sensor_" in name:
        return f"{-by:+.2g} 1/sqrt(kg)"
    percent = float(f"{100 * np.expm1(-by):.2g}")
    return f"{percent:+.0f} %" if abs(percent) >= 10 else f"{percent:+.2g} %"
