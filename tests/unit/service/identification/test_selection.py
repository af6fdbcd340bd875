"""How many modes: what the search for their starts gets wrong is put right by the joint fits."""

import numpy as np
import pytest

from service.identification.closed_loop import closed_loop_poles
from service.identification.etfe import FrequencyResponse, etfe
from service.identification.fit import Options, split_knowledge, start_model
from service.identification.flexible import PoleResidue
from service.identification.plane_model import PlaneModel
from service.identification.points import plane_points
from service.identification.residuals import Data
from service.identification.selection import Selected, choose_modes
from service.identification.staged import staged_fit
from service.identification.start import joint_start, modes_from, with_modes
from service.identification.synthetic import synthetic_sweep
from sim.datasheet import Datasheet
from sim.errors import AmbError


def _split_peak(one: PoleResidue) -> PoleResidue:
    """Three poles for the one peak, and one on a line of its own."""
    nu, sigma, residue, lag = one.nu_rad_s, one.sigma_rad_s, one.residues, one.lags
    return PoleResidue(
        np.array([0.9995 * nu[0], nu[0], 1.002 * nu[0], 2000.0]),
        np.array([0.3, sigma[0], 0.3, 1e-3]),
        np.stack([0.1 * residue[0], residue[0], 0.1 * residue[0], 0.1 * residue[0]]),
        np.stack([0.1 * lag[0], lag[0], 0.1 * lag[0], 0.1 * lag[0]]),
    )


def _coarse(datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray], seed: int):
    """Points that tell the first peak, and of the second one its feet alone; the measured plant; the staged steps."""
    hz = np.unique(np.concatenate([np.geomspace(10, 996, 40), 493 + np.linspace(-4, 4, 12)]))
    return _measured(datasheet, truth, controller, hz, seed)


def _measured(
    datasheet: Datasheet,
    truth: dict[str, PlaneModel],
    controller: tuple[np.ndarray, np.ndarray],
    hz: np.ndarray,
    seed: int,
):
    axes = datasheet.axes
    data = Data(plane_points(synthetic_sweep(truth, axes, controller, hz, 0.15, seed=seed), axes, "x"), None)
    start, _ = start_model(datasheet, "x", axes, data)
    seen = etfe(data.plant, "u->y")
    gain = start.amplifier_response(seen.omega)[:, None]
    plant = FrequencyResponse(seen.omega, seen.value / gain, seen.std / np.abs(gain))
    return data, plant, staged_fit(start, data.plant, plant)


def _is_the_truth(found: Selected, truth: PlaneModel, rtol: float = 1e-3) -> None:
    assert [e.name for e in found.evidence if e.chosen] == ["2 modes"]
    model = found.refined.model
    np.testing.assert_allclose(model.natural_frequencies, truth.natural_frequencies, rtol=rtol)
    np.testing.assert_allclose(model.ki, truth.ki, rtol=1e-2)


@pytest.mark.parametrize("seed", [1, 2])
def test_modes_are_found_where_lines_tell_one_peak_and_the_feet_of_another(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray], seed: int
) -> None:
    data, plant, staged = _coarse(datasheet, truth, controller, seed)
    start = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
    knowledge = split_knowledge(datasheet, Options())
    _is_the_truth(choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge), truth["x"])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_modes_are_found_on_a_dozen_lines_none_of_which_lies_on_a_peak(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray], seed: int
) -> None:
    data, plant, staged = _measured(datasheet, truth, controller, np.geomspace(10, 995, 12), seed)
    start = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
    knowledge = split_knowledge(datasheet, Options())
    found = choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge)
    _is_the_truth(found, truth["x"], rtol=3e-3)


def test_modes_are_found_although_the_search_took_one_peak_for_three(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    data, plant, staged = _coarse(datasheet, truth, controller, 1)
    many = with_modes(staged.rigid_model, modes_from(_split_peak(staged.rational.peaks), staged.rigid_model.ki))
    knowledge = split_knowledge(datasheet, Options())
    _is_the_truth(choose_modes(many, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge), truth["x"])


def test_a_fit_that_ended_anywhere_is_told(
    truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    nowhere = truth["x"].modes.copy()
    nowhere[0, :2] = 3e14, -1e8
    with pytest.raises(AmbError, match="ended far from any rotor"):
        closed_loop_poles(with_modes(truth["x"], nowhere), controller)
