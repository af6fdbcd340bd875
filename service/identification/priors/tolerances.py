"""The datasheet's values as priors: Gaussian about what it says, as wide as its tolerances, when they are asked for.

Amplifiers that no logged current shows are known by them in any case: ki is then no better known than their gain.

Every value becomes one more residual, (parameter - datasheet) / tolerance, beside those of the data: ki, ks,
amplifiers, and frequency, damping and shape of each mode that the datasheet has and the data show. Mass, inertia,
geometry and sensor gains are held at the datasheet's values with and without priors, but where these do not explain the
data (`Tolerances.of_given`); the delay has no tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from service.identification.arrays import Real
from service.identification.plane.layout import SHIFTS
from service.identification.plane.model import PlaneModel
from sim.datasheet import Datasheet

NEAR, FAR = 0.05, 0.15
"""A mode is the datasheet's within five tolerances of its frequency, but a share between these of it."""
NODE = 0.1
"""A shape's value is known to the tolerance of this share of its largest at least: nodes move."""
EXACT = 1e-6
"""Relative tolerance of mass, geometry and sensor gains that have none: what no sweep can tell."""
STRAINED = 3.3
"""Tolerances off beyond which data and datasheet disagree: chance does that once in a thousand."""
MODE_ROWS = 5


@dataclass(frozen=True)
class _Mode:
    frequency: float
    """rad/s"""
    damping: float
    shape: Real
    """(4,) bearings A and B, sensors A and B."""


@dataclass(frozen=True)
class Tolerances:
    """What a datasheet says of one plane, and how well it knows."""

    names: tuple[str, ...]
    """Parameters with a value of their own, as in the model's layout."""
    values: Real
    stds: Real
    modes: tuple[_Mode, ...]
    mode_frequency: float
    mode_damping: float
    mode_shape: float
    """Relative."""
    remedy: str = "identify without priors"
    """Where the data disagree, beside a wider tolerance."""

    def of_amplifiers(self) -> Tolerances:
        """What is said of the amplifiers alone, for data that do not show them."""
        kept = [k for k, name in enumerate(self.names) if name.startswith("amplifier")]
        names = tuple(self.names[k] for k in kept)
        return replace(
            self, names=names, values=self.values[kept], stds=self.stds[kept], modes=(), remedy="log the coil currents"
        )

    @classmethod
    def of(cls, datasheet: Datasheet, axes: tuple[str, str]) -> Tolerances:
        """For the plane of these two axes."""
        told, t = datasheet, datasheet.tolerance
        entries: list[tuple[str, float, float]] = []
        for end, axis in zip("AB", (told.axes.index(a) for a in axes), strict=True):
            w = 2 * np.pi * told.amplifier_natural_frequency_hz[axis]
            entries += [
                (f"ki_{end}", told.current_stiffness_n_per_a[axis], t.current_stiffness),
                (f"ks_{end}", told.position_stiffness_n_per_m[axis], t.position_stiffness),
                (f"amplifier_{end}_gain", told.amplifier_gain[axis], t.amplifier_gain),
                (f"amplifier_{end}_natural_frequency_rad_s", w, t.amplifier_frequency),
            ]
            if told.amplifier_damping_ratio is not None:
                damping = told.amplifier_damping_ratio[axis]
                entries.append((f"amplifier_{end}_damping_ratio", damping, t.amplifier_damping))
        names, values, relative = zip(*entries, strict=True)
        modes = tuple(
            _Mode(
                2 * np.pi * m.frequency_hz,
                m.damping_ratio,
                np.array([*m.shape_at_bearings, *m.shape_at_sensors], dtype=float),
            )
            for m in told.modes
        )
        return cls(
            names,
            np.array(values, dtype=float),
            np.array(values) * np.array(relative),
            modes,
            t.mode_frequency,
            t.mode_damping,
            t.mode_shape,
        )

    @classmethod
    def of_given(cls, datasheet: Datasheet, axes: tuple[str, str]) -> Tolerances:
        """What it says of mass, inertia, geometry and sensor gains, for the plane of these two axes.

        The centre of gravity is known as well as where the sensors are. A value without tolerance may move by `EXACT`.
        """
        t, told = datasheet.tolerance, datasheet
        arm = sum(told.sensor_from_cog_m) / 2
        entries = [
            ("mass_kg", told.mass_kg, t.mass, told.mass_kg),
            (
                "transverse_inertia_kgm2",
                told.transverse_inertia_kgm2,
                t.transverse_inertia,
                told.transverse_inertia_kgm2,
            ),
            ("centre_of_gravity_m", 0.0, t.sensor_position_m / arm, arm),
        ]
        for end, axis in zip("AB", (told.axes.index(a) for a in axes), strict=True):
            gain = told.sensor_gain[axis]
            entries.append((f"sensor_gain_{end}", gain, t.sensor_gain, gain))
        entries += [(name, 0.0, t.sensor_position_m / arm, arm) for name in SHIFTS]
        names, values, relative, sizes = zip(*entries, strict=True)
        stds = np.maximum(relative, EXACT) * np.array(sizes)
        return cls(names, np.array(values), stds, (), t.mode_frequency, t.mode_damping, t.mode_shape)

    def rows(self, model: PlaneModel) -> tuple[Real, Real]:
        """Residuals of unit variance and their Jacobian, (n,) and (n, size), in the same number for every model.

        What the model does not have - a mode, an amplifier of the datasheet's order - has a residual of zero.
        """
        layout = model.layout
        n = len(self.names)
        residual = np.zeros(n + MODE_ROWS * len(self.modes))
        jacobian = np.zeros((len(residual), layout.size))
        for row, (name, value, std) in enumerate(zip(self.names, self.values, self.stds, strict=True)):
            if name in layout.names and self._comparable(name, model):
                place = layout.index(name)
                residual[row] = (model.theta[place] - value) / std
                jacobian[row, place] = 1.0 / std
        for k, told in enumerate(self.modes):
            near = self._nearest(told, model)
            if near is not None:
                at = slice(n + MODE_ROWS * k, n + MODE_ROWS * (k + 1))
                residual[at], jacobian[at] = self._of_mode(told, near, model)
        return residual, jacobian

    def strained(self, model: PlaneModel) -> tuple[str, ...]:
        """Where the estimate lies far outside the tolerances, one line each."""
        labels = [*self.names]
        for k in range(len(self.modes)):
            labels += [f"mode_{k + 1}_{what}" for what in ("frequency", "damping", "shape", "shape", "shape")]
        off: dict[str, float] = {}
        for label, r in zip(labels, self.rows(model)[0], strict=True):
            off[label] = max(abs(float(r)), off.get(label, 0.0))
        return tuple(
            f"{label} lies {r:.2g} tolerances off the datasheet's value, which was a prior of this fit; "
            f"widen its tolerance, or {self.remedy}"
            for label, r in off.items()
            if r > STRAINED
        )

    def _comparable(self, name: str, model: PlaneModel) -> bool:
        """A natural frequency is another thing for an amplifier of another order."""
        if not name.startswith("amplifier") or name.endswith("gain"):
            return True
        end = name.split("_")[1]
        told = 2 if f"amplifier_{end}_damping_ratio" in self.names else 1
        return model.layout.amplifier_orders["AB".index(end)] == told

    def _nearest(self, told: _Mode, model: PlaneModel) -> int | None:
        """The model's mode that is the datasheet's, when it is the nearest both ways."""
        if not model.layout.n_modes:
            return None
        w = model.natural_frequencies
        k = int(np.argmin(np.abs(w - told.frequency)))
        rival = min((abs(m.frequency - w[k]) for m in self.modes), default=np.inf)
        away = abs(w[k] - told.frequency)
        return k if away <= rival and away < np.clip(5 * self.mode_frequency, NEAR, FAR) * told.frequency else None

    def _of_mode(self, told: _Mode, k: int, model: PlaneModel) -> tuple[Real, Real]:
        """Rows of frequency, damping and shape; no damping, or no motion at bearings or sensors, is one not known."""
        at, size = model.layout.mode(k).start, model.layout.size
        nu, sigma, *rest = model.modes[k]
        shape, w = np.array(rest), model.natural_frequencies[k]
        d_w = np.zeros(size)
        d_w[at] = nu / w
        d_w[at + 2 : at + 4] = model.ks * shape[:2] / w
        d_w[2:4] = shape[:2] ** 2 / (2 * w)
        d_zeta = -sigma / w**2 * d_w
        d_zeta[at + 1] += 1.0 / w
        residual, jacobian = np.zeros(MODE_ROWS), np.zeros((MODE_ROWS, size))
        std = self.mode_frequency * told.frequency
        residual[0], jacobian[0] = (w - told.frequency) / std, d_w / std
        if told.damping > 0:
            std = self.mode_damping * told.damping
            residual[1], jacobian[1] = (sigma / w - told.damping) / std, d_zeta / std
        if not (told.shape[:2].any() and told.shape[2:].any()):
            return residual, jacobian
        # how a shape splits between bearings and sensors is known already (`split`): the three other directions
        expected = told.shape * (1.0 if shape @ told.shape >= 0 else -1.0)
        spread = self.mode_shape * np.maximum(np.abs(expected), NODE * np.abs(expected).max())
        b, s = expected[:2], expected[2:]
        split = np.concatenate([-b / max(float(b @ b), 1e-24), s / max(float(s @ s), 1e-24)]) * spread
        across = null_space(split[None, :]).T
        residual[2:] = across @ ((shape - expected) / spread)
        jacobian[2:, at + 2 : at + 6] = across / spread
        return residual, jacobian
