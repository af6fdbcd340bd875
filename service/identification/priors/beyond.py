"""What is known of modes beyond the band, whose peaks no line shows.

What they leave within the band is smooth, and two of them that lie close together, with large shapes of opposite signs,
fit whatever the last lines hold: what one adds and the other takes away then passes for ki and ks. No rotor has such
modes. A shape of unit modal mass is of the order of the rigid one, 1/sqrt(m): that of a free uniform beam is twice as
large at its ends, and as large in the root mean square; at the ends of a tapered shaft it is three or four times that.
And material and fits damp a mode by parts in a thousand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.plane.model import PlaneModel

BEYOND_ROWS = 5
"""Residuals of knowledge per mode: of its damping, and of its shape at bearings and sensors."""
USUAL_DAMPING, ITS_SPREAD, LEAST_DAMPING = 0.005, 0.01, 0.0005
"""Damping ratio; data alone would give whatever fits the last lines, negative values too, and with them a rotor that
shakes itself to pieces. While modes are counted it is known within an absolute spread, which costs no steps; in the
last fit within a factor e, and below the least one, where a logarithm would find no end, along its tangent."""
USUAL_SHAPE = 3.0
"""Standard deviation of a shape at a bearing or sensor, in units of 1/sqrt(m); wide, for one mode stands for many."""


def beyond_rows(model: PlaneModel, beyond: NDArray[np.bool_], counting: bool = False) -> tuple[Real, Real]:
    """Residuals of what is known of modes beyond the band.

    Parameters
    ----------
    model
        With n modes and ``size`` parameters.
    beyond
        (n,) which of its modes lie there.
    counting
        Whether modes are still counted: damping then has a normal density, else a log-normal one, continued along its
        tangent below `LEAST_DAMPING`.

    Returns
    -------
    rows : (5 k,), of k modes beyond, in standard deviations of what is known
        ln of the damping ratio over the usual one, or their difference; the shape at bearings A, B and sensors A, B.
    jacobian : (5 k, size), of the rows per unit of each parameter
    """
    places = np.flatnonzero(beyond)
    rows, jacobian = np.zeros(BEYOND_ROWS * len(places)), np.zeros((BEYOND_ROWS * len(places), model.layout.size))
    mass_at = model.layout.extended.start
    mass = float(model.theta[mass_at])
    to_unit = np.sqrt(mass) / USUAL_SHAPE
    for row, k in zip(range(0, len(rows), BEYOND_ROWS), places, strict=True):
        nu, sigma = model.modes[k, :2]
        zeta, at = sigma / nu, model.layout.mode(int(k)).start
        if counting:
            rows[row], per_zeta = (zeta - USUAL_DAMPING) / ITS_SPREAD, 1.0 / ITS_SPREAD
        else:
            least = max(zeta, LEAST_DAMPING)
            rows[row], per_zeta = np.log(least / USUAL_DAMPING) + (zeta - least) / least, 1.0 / least
        jacobian[row, at : at + 2] = np.array([-zeta, 1.0]) / nu * per_zeta
        shape = slice(row + 1, row + BEYOND_ROWS)
        rows[shape] = model.modes[k, 2:6] * to_unit
        jacobian[shape, at + 2 : at + 6] = np.eye(4) * to_unit
        jacobian[shape, mass_at] = rows[shape] / (2 * mass)
    return rows, jacobian
