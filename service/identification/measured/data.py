"""What a plane is fitted to: its points, and what the datasheet says beside them."""

from __future__ import annotations

from dataclasses import dataclass

from service.identification.measured.points import PlanePoints
from service.identification.priors.tolerances import Tolerances


@dataclass(frozen=True)
class Data:
    """The plane's points, and points that tell of the amplifiers only."""

    plant: PlanePoints
    amplifier: PlanePoints | None = None
    prior: Tolerances | None = None
    """What the datasheet says, where it is asked to tell beside the data."""
    released: Tolerances | None = None
    """What of the datasheet's mass, geometry and sensor gains a fit may move, and how well each is known; None where
    they are held."""
    loose: Tolerances | None = None
    """The same of what is held at other values than the datasheet's, which were found so: what the data tell with these
    held is not all known."""
