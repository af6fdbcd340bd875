"""How many modes: what the search for their starts gets wrong is put right by the joint fits."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.identification.joint.counting import ADEQUATE
from service.identification.joint.fits import JointFits
from service.identification.joint.residuals import noise_of
from service.identification.joint.selection import Selected, choose_modes
from service.identification.loop.closed_loop import closed_loop_poles
from service.identification.measured.data import Data
from service.identification.measured.etfe import FrequencyResponse, etfe
from service.identification.measured.points import plane_points
from service.identification.options import Options
from service.identification.plane.model import PlaneModel
from service.identification.steps.flexible import PoleResidue
from service.identification.steps.nominal import split_knowledge, start_model
from service.identification.steps.staged import staged_fit
from service.identification.steps.start import joint_start, modes_from, with_modes
from sim.datasheet import Datasheet, Mode, Tolerance
from sim.errors import AmbError
from tests.support.planes import synthetic_sweep


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
    changed: Callable[[Data], Data] = lambda data: data,
):
    axes = datasheet.axes
    data = changed(Data(plane_points(synthetic_sweep(truth, axes, controller, hz, 0.15, seed=seed), axes, "x"), None))
    start, _ = start_model(datasheet, "x", axes, data)
    seen = etfe(data.plant, "u->y")
    gain = start.amplifier_response(seen.omega)[:, None]
    plant = FrequencyResponse(seen.omega, seen.value / gain, seen.std / np.abs(gain))
    return data, plant, staged_fit(start, data.plant, plant)


def assert_the_truth(found: Selected, truth: PlaneModel, rtol: float = 1e-3) -> None:
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
    assert_the_truth(
        choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge), truth["x"]
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_modes_are_found_on_a_dozen_lines_none_of_which_lies_on_a_peak(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray], seed: int
) -> None:
    data, plant, staged = _measured(datasheet, truth, controller, np.geomspace(10, 995, 12), seed)
    start = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
    knowledge = split_knowledge(datasheet, Options())
    found = choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge)
    assert_the_truth(found, truth["x"], rtol=3e-3)


@pytest.mark.parametrize("lines", [25, 30])
@pytest.mark.parametrize("seed", [2, 3])
def test_modes_are_found_between_lines_too_far_apart_to_show_their_peaks(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray], lines: int, seed: int
) -> None:
    """What they do to the lines on either side tells where they are."""
    data, plant, staged = _measured(datasheet, truth, controller, np.geomspace(10, 1000, lines), seed)
    start = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
    knowledge = split_knowledge(datasheet, Options())
    found = choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge)
    assert_the_truth(found, truth["x"], rtol=4e-3)
    assert next(e.rms for e in found.evidence if e.chosen) < 1.3


def test_a_sharp_mode_right_beside_a_line_is_found(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    """One line shows most of it, and the others tell of it, too."""
    modes = truth["x"].modes.copy()
    modes[:, 1] /= 4
    sharp = {plane: with_modes(truth["x"], modes) for plane in truth}
    data, plant, staged = _measured(datasheet, sharp, controller, np.geomspace(10, 1000, 40), 1)
    start = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
    knowledge = split_knowledge(datasheet, Options())
    found = choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge)
    assert_the_truth(found, sharp["x"])


def _wrong(data: Data, how: str) -> Data:
    """Points with what no mode explains: a sensor that lags, or is off at one line."""
    points = data.plant
    factor = np.exp(-20e-6j * points.omega)
    if how == "a line off":
        factor = np.where(points.omega == np.unique(points.omega)[-2], 1.5, 1.0)
    return replace(data, plant=replace(points, Y=points.Y * factor[:, None, None]))


@pytest.mark.parametrize("how", ["a lag", "a line off"])
def test_no_mode_is_put_between_lines_for_what_is_no_mode(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray], how: str
) -> None:
    """On lines that are far apart, of a rotor that has no mode between them: a peak there could take up anything."""
    stiff = {plane: with_modes(model, np.empty((0, 6))) for plane, model in truth.items()}
    data, plant, staged = _measured(
        datasheet, stiff, controller, np.geomspace(10, 1000, 25), 1, lambda d: _wrong(d, how)
    )
    start = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
    knowledge = split_knowledge(datasheet, Options())
    found = choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge)
    assert next(e.rms for e in found.evidence if e.chosen) > ADEQUATE
    assert not np.any(found.refined.model.modes[:, 0] < data.plant.omega.max())


def test_modes_are_found_although_the_search_took_one_peak_for_three(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    data, plant, staged = _coarse(datasheet, truth, controller, 1)
    many = with_modes(staged.rigid_model, modes_from(_split_peak(staged.rational.peaks), staged.rigid_model.ki))
    knowledge = split_knowledge(datasheet, Options())
    assert_the_truth(
        choose_modes(many, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge), truth["x"]
    )


def test_two_modes_that_share_one_peak_are_one(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    """Both are needed beside each other, and a third one, of which the lines see less, for itself."""
    hz = np.unique(np.concatenate([np.geomspace(10, 997, 80), *(f + np.linspace(-6, 6, 7) for f in (492.6, 907.2))]))
    first, second = truth["x"].modes
    second = second * np.array([1.0, 1.0, *np.full(4, 0.2)])
    rig = truth | {"x": with_modes(truth["x"], np.vstack([first, second]))}
    data, plant, staged = _measured(datasheet, rig, controller, hz, 1)
    near = np.array([1.0, 1.0, *np.full(4, np.sqrt(0.5))])
    apart = np.array([0.2 * first[1], 0.0, 0.0, 0.0, 0.0, 0.0])
    twins = with_modes(truth["x"], np.vstack([near * first - apart, near * first + apart, second]))
    knowledge = split_knowledge(datasheet, Options())
    assert_the_truth(
        choose_modes(twins, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge), rig["x"]
    )


def _lines_with_one_off(
    datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray], off: complex
) -> Selected:
    """What is chosen where the highest line is so many times its noise off, as one that had not settled is."""
    peaks = [hz + np.linspace(-6, 6, 7) for hz in (492.6, 907.2)]
    hz = np.unique(np.concatenate([np.geomspace(10, 997, 80), *peaks]))
    data, plant, staged = _measured(datasheet, truth, controller, hz, 1)
    points = data.plant
    last = (points.omega == points.omega.max()) & (points.axis == 1)
    y = points.Y.copy()
    y[last] += off * noise_of(truth["x"], points, None).sigma[last, None, 2:] * np.array([1.0, -1.0])
    data = replace(data, plant=replace(points, Y=y))
    start = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
    knowledge = replace(split_knowledge(datasheet, Options()), end_rad_s=float(points.omega.max()))
    return choose_modes(start, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge)


def test_the_highest_line_alone_makes_no_mode_beyond_the_band(
    datasheet: Datasheet,
    truth: dict[str, PlaneModel],
    controller: tuple[np.ndarray, np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert_the_truth(_lines_with_one_off(datasheet, truth, controller, -5 - 5j), truth["x"])
    # that it would: with the highest line's word a third mode is taken
    monkeypatch.setattr(JointFits, "cost_before_the_end", lambda self, f: (self.cost(f), len(self.residual(f))))
    found = _lines_with_one_off(datasheet, truth, controller, -5 - 5j).refined.model
    assert found.layout.n_modes == 3
    assert found.modes[-1, 0] > 2 * np.pi * 997


def test_chance_makes_no_mode_beyond_the_band(
    datasheet: Datasheet,
    truth: dict[str, PlaneModel],
    controller: tuple[np.ndarray, np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Noise in which a mode at 2.5 kHz would save nineteen of the misfit: one draw of a few hundred has such."""
    peaks = [hz + np.linspace(-6, 6, 15) for hz in (492.6, 907.2)]
    hz = np.unique(np.concatenate([np.geomspace(10, 1000, 130), *peaks]))
    noise = {"current_noise_a": 0.0, "displacement_noise_m": 0.0, "relative_noise": 0.01}
    sweep = synthetic_sweep(truth, datasheet.axes, controller, hz, 0.05, seed=143, **noise)
    data = Data(plane_points(sweep.select(sweep.axis < 2), datasheet.axes, "x"), None)
    known = rotor_model(datasheet, truth["x"])

    def chosen() -> Selected:
        start, _ = start_model(known, "x", known.axes, data)
        seen = etfe(data.plant, "u->y")
        gain = start.amplifier_response(seen.omega)[:, None]
        plant = FrequencyResponse(seen.omega, seen.value / gain, seen.std / np.abs(gain))
        staged = staged_fit(start, data.plant, plant)
        begin = joint_start(staged.rigid_model, staged.rational, data.plant, plant)
        knowledge = replace(split_knowledge(known, Options()), end_rad_s=float(data.plant.omega.max()))
        return choose_modes(begin, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge)

    assert_the_truth(chosen(), truth["x"])
    # that it would: were fifteen enough
    monkeypatch.setattr("service.identification.joint.counting.BEYOND_GAIN", 15.0)
    patched = chosen().refined.model
    assert patched.layout.n_modes == 3
    assert patched.modes[-1, 1] > 0


def rotor_model(datasheet: Datasheet, truth: PlaneModel) -> Datasheet:
    """The datasheet with modes whose shapes split as the rotor's do."""
    modes = tuple(
        Mode(w / (2 * np.pi), 0.002, (m[2], m[3]), (m[4], m[5]))
        for m, w in zip(truth.modes, truth.natural_frequencies, strict=True)
    )
    return replace(datasheet, modes=modes, tolerance=Tolerance(mode_shape=1e-4))


def test_a_fit_that_ended_anywhere_is_told(
    truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    nowhere = truth["x"].modes.copy()
    nowhere[0, :2] = 3e14, -1e8
    with pytest.raises(AmbError, match="ended far from any rotor"):
        closed_loop_poles(with_modes(truth["x"], nowhere), controller)
