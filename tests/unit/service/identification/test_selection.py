"""How many modes: what the search for their starts gets wrong is put right by the joint fits."""

import numpy as np
import pytest

from service.identification.closed_loop import closed_loop_poles
from service.identification.etfe import FrequencyResponse, etfe
from service.identification.fit import Options, split_knowledge, start_model
from service.identification.flexible import PoleResidue
from service.identification.plane_model import PlaneModel
from service.identification.points import plane_points
from service.identification.refine import Data
from service.identification.selection import choose_modes, with_modes
from service.identification.staged import staged_fit
from service.identification.synthetic import synthetic_sweep
from sim.datasheet import Datasheet
from sim.errors import AmbError


def _split_peak(two: PoleResidue) -> PoleResidue:
    """Three poles for the first peak, and the second one too sharp for the lines around it."""
    nu, sigma, residue, lag = two.nu_rad_s, two.sigma_rad_s, two.residues, two.lags
    return PoleResidue(
        np.array([0.9995 * nu[0], nu[0], 1.002 * nu[0], nu[1]]),
        np.array([0.3, sigma[0], 0.3, 1e-3]),
        np.stack([0.1 * residue[0], residue[0], 0.1 * residue[0], residue[1]]),
        np.stack([0.1 * lag[0], lag[0], 0.1 * lag[0], lag[1]]),
    )


def test_modes_are_found_although_the_search_took_one_peak_for_three(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    axes = datasheet.axes
    hz = np.unique(np.concatenate([np.geomspace(10, 996, 40), 493 + np.linspace(-4, 4, 12)]))
    data = Data(plane_points(synthetic_sweep(truth, axes, controller, hz, 0.15, seed=1), axes, "x"), None)
    start, _ = start_model(datasheet, "x", axes, data)
    seen = etfe(data.plant, "u->y")
    gain = start.amplifier_response(seen.omega)[:, None]
    plant = FrequencyResponse(seen.omega, seen.value / gain, seen.std / np.abs(gain))
    staged = staged_fit(start, data.plant, plant)
    assert staged.n_modes == 2
    coarse = [*staged.search[:2], staged.search[1], _split_peak(staged.search[1])]
    found = choose_modes(
        staged.rigid_model, data, plant, coarse, 4, staged.lowest_mode_rad_s, split_knowledge(datasheet, Options())
    )
    assert [e.name for e in found.evidence if e.chosen] == ["2 modes"]
    model = found.refined.model
    np.testing.assert_allclose(model.natural_frequencies, truth["x"].natural_frequencies, rtol=1e-3)
    np.testing.assert_allclose(model.ki, truth["x"].ki, rtol=1e-2)


def test_a_fit_that_ended_anywhere_is_told(
    truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    nowhere = truth["x"].modes.copy()
    nowhere[0, :2] = 3e14, -1e8
    with pytest.raises(AmbError, match="ended far from any rotor"):
        closed_loop_poles(with_modes(truth["x"], nowhere), controller)
