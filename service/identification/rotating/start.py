"""With which modes of the planes a rotating fit begins.

A plane that was measured while the rotor turned holds more than the rotor's modes: through the gyroscopic coupling its
response has the poles of the other plane in closed loop with its own controller, with residues as small as the coupling
squared. A plane's own model, which has no coupling, takes them for modes of its own, or patches them up within the band
and beyond it. The rotating model has the other plane, and they are no modes of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.joint.selection import Selected
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Posterior
from service.identification.steps.start import with_modes

FAINT = 0.05
"""Residue, in units of the plane's largest within the band, below which a mode may be the other plane's."""
SAME = 0.005
"""Relative difference of frequency up to which a plane's mode by itself is one of the rotating model."""

Begun = tuple[PlaneModel, Posterior | None]
"""A plane with the modes that are kept, and what is known of their splits."""


def begun(planes: dict[str, Selected], end_rad_s: float, turning: bool) -> list[tuple[Begun, Begun]]:
    """Starts of the rotating fit, each a pair of planes x and y, that with the fewest modes first.

    Parameters
    ----------
    planes
        Joint fits of planes "x" and "y" by themselves.
    end_rad_s
        Of the band.
    turning
        Whether they were measured while the rotor turned: then the first start has those modes alone that can be the
        rotor's, where these are not all.
    """
    both = [(p.refined.model, p.splits) for p in (planes["x"], planes["y"])]
    all_modes = (both[0], both[1])
    if not turning:
        return [all_modes]
    kept = [_own(model, end_rad_s) for model, _ in both]
    if all(np.all(k) for k in kept):
        return [all_modes]
    x, y = (_with(begin, k) for begin, k in zip(both, kept, strict=True))
    return [(x, y), all_modes]


def not_modes(planes: dict[str, Selected], found: tuple[PlaneModel, PlaneModel], end_rad_s: float) -> list[str]:
    """A sentence for each plane that shows what the rotating model, ``found``, has no mode for."""
    out = []
    for name, model in zip("xy", found, strict=True):
        nu = np.sort(planes[name].refined.model.modes[:, 0])
        near = np.abs(model.modes[:, 0] / nu[:, None] - 1.0) < SAME
        places = nu[(nu <= end_rad_s) & ~near.any(axis=1)] / (2 * np.pi)
        if len(places):
            told = ", ".join(f"{hz:.4g}" for hz in places)
            out.append(
                f"what plane {name} by itself has at {told} Hz is the other plane's loop, and no mode of the rotor"
            )
    return out


def _own(model: PlaneModel, end_rad_s: float) -> NDArray[np.bool_]:
    """Which modes can be the plane's own: those within the band that are not faint, and the loudest one beyond it."""
    m = model.modes
    residue = np.linalg.norm(m[:, 2:4], axis=1) * np.linalg.norm(m[:, 4:6], axis=1)
    beyond = m[:, 0] > end_rad_s
    kept = ~beyond & (residue > FAINT * np.max(residue[~beyond], initial=0.0))
    if np.any(beyond):
        kept[np.argmax(np.where(beyond, residue / m[:, 0] ** 2, -1.0))] = True
    return np.asarray(kept)


def _with(begin: Begun, kept: NDArray[np.bool_]) -> Begun:
    model, splits = begin
    return with_modes(model, model.modes[kept]), None if splits is None else _of(splits, kept)


def _of(splits: Posterior, kept: NDArray[np.bool_]) -> Posterior:
    shapes: Real | None = None if splits.shapes is None else splits.shapes[kept]
    return Posterior(splits.log_ratios[kept], splits.covariance[np.ix_(kept, kept)], shapes)
