"""What a mode of a fitted plane is: the rotor's, one beyond the band, or a patch on something else."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from service.identification.plane.model import PlaneModel
from service.identification.result.figures import kinds

POINTS: Any = SimpleNamespace(omega=np.array([60.0, 4000.0]))


def known_to(std: float) -> Any:
    def of(model: PlaneModel, figure: Callable[[PlaneModel], np.ndarray]) -> tuple[np.ndarray, None]:
        return np.full_like(figure(model), std), None

    return SimpleNamespace(std=of)


@pytest.mark.parametrize(
    ("zeta", "std", "kind"),
    [
        (0.002, 1e-5, "rotor"),
        (-3e-5, 4.5e-5, "rotor"),  # none that the data tell
        (-3e-5, 4.5e-6, "patch"),  # it would feed the rotor
        (-0.02, 0.2, "patch"),  # no peak that would be told
        (0.9, 0.3, "patch"),
    ],
)
def test_a_mode_is_the_rotors_by_what_is_known_of_its_damping(
    truth: dict[str, PlaneModel], zeta: float, std: float, kind: str
) -> None:
    model = truth["x"]
    theta = model.theta.copy()
    theta[model.layout.mode(0).start + 1] = zeta * model.natural_frequencies[0]
    assert kinds(model.at(theta), known_to(std), POINTS) == (kind, "beyond")
