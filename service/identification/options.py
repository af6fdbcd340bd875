"""What a user chooses of an identification."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """How to identify. The defaults need no thought."""

    closeness: bool = True
    """Whether a mode's shape is taken to change little from a bearing to its sensor (`priors.split.Knowledge`)."""
    datasheet_modes: bool = True
    """Whether the datasheet's modes, where it has any, tell how shapes split between bearings and sensors. Nothing else
    of them is used."""
    priors: bool = False
    """Whether the datasheet's values count as priors, as wide as its tolerances (`tolerances.Tolerances`). By default
    its ki, ks, amplifiers and modes are not trusted at all."""
