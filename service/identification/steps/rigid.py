"""Step 4: the rigid rotor as a grey box, theta = {ksA, ksB, kiA, kiB}, below the flexible modes.

M x'' = Ks x + Ki i with M known; x at the bearings follows from y by the exact rigid-body map. At each frequency that
is linear in the four factors, which gives a start that needs no datasheet value of them.
"""

from __future__ import annotations

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane.model import PlaneModel

FAR = 1e3
"""How many times larger or smaller than where it starts a factor may become: beyond, y does not tell it at all."""


def bearing_from_sensor(model: PlaneModel) -> Real:
    """Exact rigid-body map from sensor to bearing displacements, (2, 2)."""
    bearings, sensors = model.rigid_shapes
    return np.asarray(bearings @ np.linalg.inv(sensors))


def levitated(model: PlaneModel, ks: Real) -> Real:
    """Poles of the rigid rotor on its position stiffness, rad/s, (2,)."""
    bearings, _ = model.rigid_shapes
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(bearings.T @ (ks[:, None] * bearings)), 1.0)))


def rigid_response(model: PlaneModel, ki: Real, ks: Real, omega: Real) -> Complex:
    """Rigid plant from coil current to sensed displacement, (P, 2, 2)."""
    bearings, sensors = model.rigid_shapes
    s2 = -(omega**2)
    # modal: (s^2 I - B^T Ks B)^-1
    stiffness = bearings.T @ (ks[:, None] * bearings)
    inner = np.linalg.inv(s2[:, None, None] * np.eye(2) - stiffness)
    return np.asarray(model.sensor_response(omega)[:, :, None] * (sensors @ inner @ (bearings.T * ki)))


def rigid_start(model: PlaneModel, omega: Real, current: Complex, y: Complex) -> tuple[Real, Real]:
    """Factors ki and ks by weighted linear least squares, (2,) each.

    Falls back on the model's own factor where the data give one that is not positive.
    """
    x = (y / model.sensor_response(omega)) @ bearing_from_sensor(model).T
    bearings, _ = model.rigid_shapes
    mass = np.linalg.inv(bearings @ bearings.T)
    force = -(omega[:, None] ** 2) * (x @ mass.T)
    weight = 1.0 / (omega**2 + np.median(omega) ** 2)
    ki, ks = np.empty(2), np.empty(2)
    for j in range(2):
        columns = np.stack([current[:, j], x[:, j]], axis=1) * weight[:, None]
        scale = np.linalg.norm(columns, axis=0)
        scale[scale == 0] = 1.0
        a = np.concatenate([columns.real, columns.imag]) / scale
        b = np.concatenate([(force[:, j] * weight).real, (force[:, j] * weight).imag])
        ki[j], ks[j] = np.linalg.lstsq(a, b, rcond=None)[0] / scale
    good = (ki > 0) & (ks > 0) & np.isfinite(ki) & np.isfinite(ks)
    return np.where(good, ki, model.ki), np.where(good, ks, model.ks)


def rigid_refined(
    model: PlaneModel, ki: Real, ks: Real, omega: Real, current: Complex, y: Complex, sigma: Real, rounds: int = 20
) -> tuple[Real, Real]:
    """Factors that minimise |y - P i|^2 / sigma^2 below the split: the thesis's grey-box fit.

    Gauss-Newton with halving; sigma (P, 2).
    """
    bearings, sensors = model.rigid_shapes
    s2 = -(omega**2)
    sensor = model.sensor_response(omega)

    def terms(theta: Real) -> tuple[Real, Real]:
        inner = np.linalg.inv(s2[:, None, None] * np.eye(2) - bearings.T @ (theta[2:, None] * bearings))
        through = sensor[:, :, None] * (sensors @ inner @ bearings.T)  # y per force
        x = np.einsum("pab,pb->pa", bearings @ inner @ bearings.T, theta[:2] * current)
        e = (y - np.einsum("pab,pb->pa", through, theta[:2] * current)) / sigma
        d = np.concatenate([through * current[:, None, :], through * x[:, None, :]], axis=2) / sigma[:, :, None]
        stack = d.reshape(-1, 4)
        return np.concatenate([e.ravel().real, e.ravel().imag]), np.concatenate([stack.real, stack.imag])

    theta = start = np.concatenate([ki, ks])
    r, jacobian = terms(theta)
    for _ in range(rounds):
        step = np.linalg.lstsq(jacobian * theta, r, rcond=None)[0] * theta
        size = 1.0
        while size > 1e-4:
            trial = theta + size * step
            if np.all((trial > start / FAR) & (trial < start * FAR)):
                now, slope = terms(trial)
                if now @ now <= r @ r * (1 + 1e-12):
                    break
            size /= 2
        else:
            break
        done = np.max(np.abs(size * step / theta)) < 1e-7
        theta, r, jacobian = trial, now, slope
        if done:
            break
    return theta[:2], theta[2:]
