"""A rig that is asked for, and not drawn with what is withheld."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from sim.datasheet import Datasheet
from sim.reference import reference_noise
from sim.rig import Noise, Rig
from sim.rig_file import parse, to_toml
from sim.twin import non_rotating, rig_from_datasheet


@dataclass(frozen=True)
class Given:
    """A rig that a case is asked to be of, exactly as its twin has it; without one a case draws its rig, too."""

    datasheet: Datasheet
    noise: bool = True
    """That of the reference rig's sensors, as large beside the limits."""
    gravity_m_per_s2: float = 0.0
    speed_rad_s: float = 0.0

    def rig(self) -> Rig:
        """The rig without what is withheld.

        Raises
        ------
        EffectError
            The datasheet names an effect that the rig cannot have.
        """
        d = self.datasheet
        return replace(
            rig_from_datasheet(non_rotating(self.datasheet)),
            noise=reference_noise(d.displacement_limit_m, d.current_limit_a) if self.noise else Noise(),
            gravity_m_per_s2=self.gravity_m_per_s2,
            speed_rad_s=self.speed_rad_s,
        )

    def document(self) -> dict[str, Any]:
        """As it is sealed, plain values; `given_in` reads it back."""
        return {
            "datasheet": to_toml(self.datasheet),
            "noise": self.noise,
            "gravity_m_per_s2": self.gravity_m_per_s2,
            "speed_rad_s": self.speed_rad_s,
        }


def given_in(document: Mapping[str, Any]) -> Given:
    """The rig of `Given.document`."""
    return Given(**{**document, "datasheet": parse(document["datasheet"], "the sealed datasheet")})
