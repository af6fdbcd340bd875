from pathlib import Path

import h5py
import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep

AXES = ("xA", "xB", "yA", "yB")


def made_sweep(n_points=3, blocks=4, n_axes=4, kind="stepped-sine", comment="main", seed=0) -> Sweep:
    rng = np.random.default_rng(seed)
    shape = (n_points, blocks, 4, n_axes)

    def signal():
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    axis = np.arange(n_points) % n_axes
    R = np.zeros(shape, dtype=complex)
    amplitude = np.zeros(n_points) if kind == "noise" else 0.1 + 0.1 * np.arange(n_points)
    R[np.arange(n_points), :, 1, axis] = amplitude[:, None]
    return Sweep(
        kind=kind,
        frequency_hz=10.0 + 5.0 * np.arange(n_points),
        axis=axis.astype(np.int64),
        amplitude_a=amplitude,
        harmonics=(0, 1, 2, 3),
        R=R,
        U=signal(),
        I=signal(),
        Y=signal(),
        comment=comment,
        flags=("",) * (n_points - 1) + ("not settled",),
        block_samples=np.full(n_points, 2000),
        time_s=np.arange(n_points, dtype=float),
        point_speed_rad_s=np.linspace(0.0, 3.0, n_points),
    )


@pytest.fixture
def experiment() -> Experiment:
    return Experiment(
        "a rig", AXES, (made_sweep(), made_sweep(kind="noise", comment="noise", seed=1)), {"controller": "a controller"}
    )


def records(frequency_hz, axis, n_axes=4, seconds=0.5, rate=10_000.0, seed=0, gain=2e-6):
    """Records of a stepped sine whose u is r, i is 0.9 r and y is gain * r, with a little noise."""
    rng = np.random.default_rng(seed)
    start, r = [0], []
    for f, a in zip(frequency_hz, axis, strict=True):
        n = round(seconds * rate)
        x = np.zeros((n, n_axes))
        x[:, a] = 0.2 * np.cos(2 * np.pi * f / rate * np.arange(n) + 0.3)
        r.append(x)
        start.append(start[-1] + n)
    r = np.concatenate(r)
    noise = 1e-9 * rng.standard_normal(r.shape)
    return {
        "frequency_hz": np.array(frequency_hz),
        "axis": np.array(axis, dtype=np.int8),
        "amplitude_a": np.full(len(axis), 0.2),
        "sample_start": np.array(start),
        "r": r,
        "u": r + 0.01,
        "i": 0.9 * r,
        "y": gain * r + noise,
    }


@pytest.fixture
def recorded() -> dict:
    return records([20.0, 33.3, 100.0, 251.7], [0, 1, 2, 3])


@pytest.fixture
def write_hdf5(tmp_path):
    """Writes a file of one sweep, as a program that follows the contract would."""

    def write(datasets, attributes=None, root=None, name="experiment.h5") -> Path:
        path = tmp_path / name
        with h5py.File(path, "w") as file:
            top = {"format": "amb-experiment", "version": 1, "rig": "r", "axes": '["xA", "xB", "yA", "yB"]'}
            for key, value in (top | (root or {})).items():
                if value is not None:
                    file.attrs[key] = value
            group = file.create_group("sweeps/0")
            own = {"kind": "stepped-sine", "speed_rad_s": 0.0, "sample_rate_hz": 10_000.0, "comment": "main"}
            for key, value in (own | (attributes or {})).items():
                if value is not None:
                    group.attrs[key] = value
            for key, value in datasets.items():
                group[key] = value
        return path

    return write


@pytest.fixture
def demodulated(experiment) -> dict:
    s = experiment.sweeps[0]
    return {
        "frequency_hz": s.frequency_hz,
        "axis": s.axis,
        "amplitude_a": s.amplitude_a,
        "harmonics": np.array(s.harmonics),
        "R": s.R,
        "U": s.U,
        "I": s.I,
        "Y": s.Y,
    }
