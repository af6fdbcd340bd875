"""Rotors that nobody chose: free shafts of beam elements in magnetic bearings, their modes above the band included."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from service.experiment.data import Experiment
from service.identification.plane.layout import Layout
from service.identification.plane.model import PlaneModel
from service.identification.plane.parameters import Known
from sim.datasheet import Datasheet
from sim.reference import pid_with_biquad, reference_datasheet
from tests.support.planes import synthetic_experiment, synthetic_sweep

KINDS = ("light and stiff", "heavy and flexible", "three modes", "close modes", "node at a sensor")
BAND_HZ = 1000.0
MODES_TO_HZ = 3000.0
ELEMENTS = (5, 4, 6, 4, 5)
"""Of each of five parts of a shaft, whose diameters are drawn."""

Draw = Callable[[float, float], float]
"""A number between two."""


@dataclass(frozen=True)
class Shaft:
    """A free shaft of unit length, mass and bending stiffness."""

    w: np.ndarray
    """(n,) natural frequencies of its flexible modes, ascending."""
    shapes: np.ndarray
    """(n, nodes) displacements of unit modal mass."""
    z: np.ndarray
    """(nodes,) from the centre of gravity."""
    inertia: float

    def shape_at(self, *places: float) -> np.ndarray:
        """(n, places)"""
        return np.array([np.interp(places, self.z, shape) for shape in self.shapes])


@dataclass(frozen=True)
class DrawnRig:
    """One plane of a rotor in its bearings, and what a datasheet tells of it: neither magnets nor modes."""

    model: PlaneModel
    sheet: Datasheet
    modes_in_band: int
    frequency_hz: np.ndarray
    """Lines as a campaign would place them: log-spaced, and several to a peak."""

    def experiment(self, relative_noise: float, seed: int) -> Experiment:
        """A stepped sine on it, straight from the model."""
        sheet = self.sheet
        sweep = synthetic_sweep(
            {"x": self.model},
            sheet.axes,
            (np.array(sheet.numerator), np.array(sheet.denominator)),  # whether it would hold the rotor does not matter
            self.frequency_hz,
            0.05,
            relative_noise=relative_noise,
            current_noise_a=2e-5,
            displacement_noise_m=1e-10,
            seed=seed,
        )
        block = np.ceil(0.3 * sweep.frequency_hz) / sweep.frequency_hz * sweep.sample_rate_hz
        return synthetic_experiment(replace(sweep, block_samples=np.round(block).astype(np.int64)), axes=sheet.axes)


def shaft(diameters: np.ndarray, disc: tuple[float, float], tuned: tuple[float, float, float] | None) -> Shaft:
    """Euler-Bernoulli elements with these diameters.

    Parameters
    ----------
    disc
        Place, 0 to 1, and mass over that of the shaft.
    tuned
        A mass on a spring, which makes a pair of modes of the first one: place, mass over that of the shaft, and
        frequency over that of the first mode.
    """
    n = len(diameters)
    h, size = 1.0 / n, 2 * (n + 1)
    bend = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) / h**3
    weigh = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) * h / 420
    turns = np.outer(*[np.array([1, h, 1, h])] * 2)
    stiffness, mass = np.zeros((size + 1, size + 1)), np.zeros((size + 1, size + 1))
    for k, d in enumerate(diameters):
        at = slice(2 * k, 2 * k + 4)
        stiffness[at, at] += d**4 * bend * turns
        mass[at, at] += d**2 * weigh * turns
    own, z = float(np.sum(diameters**2)) * h, np.linspace(0, 1, n + 1)
    node = 2 * round(disc[0] * n)
    mass[node, node] += disc[1] * own
    rigid = np.zeros((size + 1, 2))
    rigid[0:size:2, 0], rigid[0:size:2, 1], rigid[1:size:2, 1] = 1, z, 1
    if tuned is None:
        stiffness, mass, rigid = stiffness[:size, :size], mass[:size, :size], rigid[:size]
    else:
        at_node = 2 * round(tuned[0] * n)
        first = eigh(stiffness[:size, :size], mass[:size, :size], eigvals_only=True)[2]
        mass[size, size] = tuned[1] * own
        spring = tuned[1] * own * first * tuned[2] ** 2
        both = np.ix_([at_node, size], [at_node, size])
        stiffness[both] += spring * np.array([[1, -1], [-1, 1]])
        rigid[size] = 1, z[at_node // 2]
    square, vectors = eigh(stiffness, mass)
    (total, moment), (_, second) = rigid.T @ mass @ rigid
    inertia = float(second / total - (moment / total) ** 2)
    return Shaft(np.sqrt(square[2:10]), vectors[0:size:2, 2:10].T * np.sqrt(total), z - moment / total, inertia)


def drawn_rig(kind: str, draw: Draw) -> DrawnRig:
    """A rotor of one of `KINDS` in bearings of its size."""
    diameters = np.repeat([draw(0.5, 1.0), 1.0, draw(0.7, 1.4), 1.0, draw(0.5, 1.0)], ELEMENTS)
    tuned = (draw(0.15, 0.85), draw(0.002, 0.01), draw(0.985, 1.015)) if kind == "close modes" else None
    rotor = shaft(diameters, (draw(0.3, 0.7), draw(0.0, 0.3)), tuned)
    mass, mode, hz = {
        "light and stiff": (draw(4, 40), 0, draw(650, 930)),
        "heavy and flexible": (draw(700, 4000), 0, draw(90, 200)),
        "three modes": (draw(60, 600), 2, draw(780, 950)),
        "close modes": (draw(60, 600), 0, draw(350, 600)),
        "node at a sensor": (draw(60, 600), 0, draw(250, 500)),
    }[kind]
    w = rotor.w * 2 * np.pi * hz / rotor.w[mode]
    keep = w < 2 * np.pi * MODES_TO_HZ
    w = w[keep]
    bearing = np.array([draw(0.68, 0.85) * rotor.z[0], draw(0.68, 0.85) * rotor.z[-1]])
    outwards = np.array([-draw(0.02, 0.09), draw(0.02, 0.09)])
    if kind == "node at a sensor":
        sensor = np.array([bearing[0] + outwards[0], _last_node(rotor) + 1e-3 * draw(-1, 1)])
        bearing = sensor - outwards
    else:
        sensor = np.clip(bearing + outwards, 0.98 * rotor.z[0], 0.98 * rotor.z[-1])
    length = (mass / 100.0) ** (1 / 3)
    ki = mass / 280 * 185.0 * np.array([draw(0.8, 1.2), draw(0.8, 1.2)])
    ks = mass / 280 * 1.7e6 * np.array([draw(0.8, 1.2), draw(0.8, 1.2)])
    zeta = 10 ** np.array([draw(-3.0, -2.3) for _ in w])
    phi_b, phi_s = (rotor.shape_at(*p)[keep] / np.sqrt(mass) for p in (bearing, sensor))
    nu = np.sqrt(w**2 - phi_b**2 @ ks)
    amplifiers = [1, draw(8000, 12000), draw(0.7, 0.9), 1, draw(8000, 12000), draw(0.7, 0.9), draw(0.0, 3e-5)]
    modes = np.column_stack([nu, zeta * w, phi_b, phi_s])
    inertia = rotor.inertia * mass * length**2
    theta = np.concatenate([ki, ks, amplifiers, modes.ravel(), [mass, inertia, 0, 1, 1, 0, 0]])
    near, far = ((float(-p[0] * length), float(p[1] * length)) for p in (bearing, sensor))
    model = PlaneModel(Known(near, far, np.full(2, 2.75), 1e-4), Layout((2, 2), len(w)), theta)
    inside = w < 2 * np.pi * BAND_HZ
    steps = np.array([-16, -8, -4, -2, -1.3, -0.8, -0.4, 0, 0.4, 0.8, 1.3, 2, 4, 8, 16])
    peaks = (nu[inside, None] / (2 * np.pi) * (1 + zeta[inside, None] * steps)).ravel()
    lines = np.unique(np.concatenate([np.geomspace(10, BAND_HZ, 110), peaks[peaks < BAND_HZ]]))
    return DrawnRig(model, _datasheet(mass, inertia, near, far), int(inside.sum()), lines)


def _last_node(rotor: Shaft) -> float:
    """Where the first mode's shape last crosses zero."""
    shape, z = rotor.shapes[0], rotor.z
    k = np.flatnonzero(np.diff(np.sign(shape)))[-1]
    return float(z[k] - shape[k] * (z[k + 1] - z[k]) / (shape[k + 1] - shape[k]))


def _datasheet(mass: float, inertia: float, bearing: tuple[float, float], sensor: tuple[float, float]) -> Datasheet:
    numerator, denominator = pid_with_biquad()
    return replace(
        reference_datasheet(),
        axes=("xA", "xB"),
        mass_kg=mass,
        transverse_inertia_kgm2=inertia,
        bearing_from_cog_m=bearing,
        sensor_from_cog_m=sensor,
        current_stiffness_n_per_a=(mass / 280 * 300.0,) * 2,
        position_stiffness_n_per_m=(mass / 280 * 2.2e6,) * 2,
        bias_current_a=(2.75,) * 2,
        amplifier_gain=(1.0,) * 2,
        amplifier_natural_frequency_hz=(1500.0,) * 2,
        amplifier_damping_ratio=(0.8,) * 2,
        sensor_gain=(1.0,) * 2,
        numerator=tuple(numerator.tolist()),
        denominator=tuple(denominator.tolist()),
    )
