"""What a known plane model in its closed loop answers to an excitation, the force law's excess included.

u follows from r by the closed sampled loop, so the data have the correlation that feedback brings.
"""

from __future__ import annotations

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.joint.refine import amplitude_of
from service.identification.loop.margins import computed_response
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Points, Prediction
from service.identification.plane.zoh import discrete_response


def closed_loop_points(
    model: PlaneModel, controller: tuple[Real, Real], omega: Real, axis: np.ndarray, amplitude_a: Real, rounds: int = 4
) -> tuple[Complex, Complex, Complex]:
    """u, i and y without noise at excitations r of one axis at a time, the force law's excess included.

    Returns
    -------
    u, i, y
        (P, 2) each, u as it reaches the amplifiers.
    """
    r = np.zeros((len(omega), 2), dtype=complex)
    r[np.arange(len(omega)), axis] = amplitude_a
    c = discrete_response(*controller, omega, model.known.sample_time_s)
    g, mixed = computed_response(model, omega), model.known.chain.crosstalk.T
    loop: Complex = np.eye(2) + c[:, None, None] * g
    u = _solved(loop, r)
    for _ in range(rounds):
        y = _predicted(model, omega, u @ mixed).y
        # what the linear model does not say of y comes back through the controller
        beyond = y - np.einsum("pyu,pu->py", g, u)
        u = _solved(loop, r - c[:, None] * beyond)
    p = _predicted(model, omega, u @ mixed)
    return u @ mixed, p.i, p.y


def _solved(loop: Complex, right: Complex) -> Complex:
    return np.asarray(np.linalg.solve(loop, right[:, :, None])[:, :, 0], dtype=np.complex128)


def _predicted(model: PlaneModel, omega: Real, u: Complex) -> Prediction:
    points = Points(omega, u)
    return model.predict(points, amplitude_of(model, points))
