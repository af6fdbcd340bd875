"""Experiments drawn from a known plane model: for Monte Carlo, and for tests of the estimator.

Coil currents and displacements get white noise, block by block.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.identification.arrays import Real
from service.identification.input_design import LineInformation
from service.identification.measured.points import planes_of
from service.identification.plane.layout import Layout
from service.identification.plane.model import PlaneModel
from service.identification.plane.parameters import Known
from service.identification.synthetic import closed_loop_points
from sim.rig import Rig


def plane_model_of(rig: Rig, plane: str) -> PlaneModel:
    """What a rig without effects is in one plane: the truth that an identification of it should find.

    Crosstalk, support, contact and the other effects of the rig are not in the model.
    """
    pair = list(planes_of(rig.axes)[plane])
    a, r = rig.amplifiers, rig.rotor
    parameters: list[float] = []
    for k in pair:
        parameters += [float(a.gain[k]), float(a.natural_frequency_rad_s[k])]
        if a.damping_ratio is not None:
            parameters.append(float(a.damping_ratio[k]))
    order = 1 if a.damping_ratio is None else 2
    ks = rig.magnets.ks[pair]
    modes = []
    for m in r.modes[list(planes_of(rig.axes)).index(plane)]:
        bearing = np.array(m.shape_at_bearings)
        w = m.natural_frequency_rad_s
        nu = np.sqrt(w**2 - bearing**2 @ ks)
        modes += [nu, m.damping_ratio * w, *m.shape_at_bearings, *m.shape_at_sensors]
    theta = np.concatenate(
        [
            rig.magnets.ki[pair],
            ks,
            parameters,
            [float(a.delay_s[pair].mean())],
            modes,
            [r.mass_kg, r.transverse_inertia_kgm2, 0.0],
            rig.sensors.gain[pair],
            [0.0, 0.0],
        ]
    )
    known = Known(
        r.bearing_from_cog_m,
        r.sensor_from_cog_m,
        rig.magnets.bias_current_a[pair],
        rig.controller.sample_time_s,
        rig.controller.computing_delay_s,
        rig.sensors.bandwidth_rad_s[pair],
    )
    return PlaneModel(known, Layout((order, order), len(modes) // 6), theta)


def synthetic_sweep(
    models: Mapping[str, PlaneModel],
    axes: tuple[str, ...],
    controller: tuple[Real, Real],
    frequency_hz: Real,
    amplitude_a: float | Real,
    *,
    current_noise_a: float = 1e-4,
    displacement_noise_m: float = 1e-9,
    relative_noise: float = 0.0,
    blocks: int = 6,
    seed: int = 0,
    comment: str = "main",
) -> Sweep:
    """A stepped-sine sweep, each axis in turn.

    Parameters
    ----------
    models
        By plane.
    amplitude_a
        Of r, one for all or one per frequency.
    current_noise_a, displacement_noise_m
        Standard deviation of a block's complex amplitude.
    relative_noise
        Standard deviation of the mean over the blocks relative to the magnitude of each signal, added.
    """
    rng = np.random.default_rng(seed)
    n_axes, n = len(axes), len(frequency_hz)
    size = np.broadcast_to(np.asarray(amplitude_a, dtype=float), (n,))
    parts = []
    for model, pair in ((models[p], pair) for p, pair in planes_of(axes).items()):
        for k in range(2):
            axis = np.full(n, k)
            u, i, y = closed_loop_points(model, controller, 2 * np.pi * frequency_hz, axis, size)
            full = [np.zeros((n, blocks, 1, n_axes), dtype=complex) for _ in range(4)]
            full[0][:, :, 0, pair[k]] = size[:, None]
            for out, value in zip(full[1:], (u, i, y), strict=True):
                out[:, :, 0, pair[0] : pair[1] + 1] = value[:, None, :]
            for out, sd in ((full[2], current_noise_a), (full[3], displacement_noise_m)):
                spread = np.sqrt(sd**2 + blocks * (relative_noise * np.abs(out)) ** 2)
                out += spread * (rng.normal(size=out.shape) + 1j * rng.normal(size=out.shape)) / np.sqrt(2)
            parts.append((np.full(n, pair[k]), full))
    r, u_all, i_all, y_all = (np.concatenate([p[1][s] for p in parts]) for s in range(4))
    turns = len(parts)
    return Sweep(
        kind="stepped-sine",
        frequency_hz=np.tile(frequency_hz, turns),
        axis=np.concatenate([p[0] for p in parts]).astype(np.int64),
        amplitude_a=np.tile(size, turns),
        harmonics=(1,),
        R=r,
        U=u_all,
        I=i_all,
        Y=y_all,
        sample_rate_hz=1.0 / next(iter(models.values())).known.sample_time_s,
        comment=comment,
    )


def synthetic_experiment(*sweeps: Sweep, axes: tuple[str, ...], rig: str = "synthetic") -> Experiment:
    """An experiment of these sweeps."""
    return Experiment(rig, axes, tuple(sweeps))


def relative_std(told: LineInformation, power: Real) -> Real:
    """(k,) Cramer-Rao bound of the wanted figures, relative, for powers times seconds (L, 2), A^2 s."""
    covariance = np.linalg.inv(np.einsum("lj,ljab->ab", power, told.matrices) + told.held)
    return np.asarray(np.sqrt(np.einsum("ka,ab,kb->k", told.wanted, covariance, told.wanted)))
