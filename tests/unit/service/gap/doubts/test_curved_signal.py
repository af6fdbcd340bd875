"""A sensor that is not linear is in no catalogue: its curvature is told, and magnets' own is not taken for it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment, Sweep
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.doubts.curvature_instead import curved_instead
from service.gap.doubts.curved_signal import curved_signal
from service.gap.fitting.candidates import Fitter
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import MODEL_FLOOR, Observation, observe
from service.gap.weighing.ranking import ranked
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep
from service.gap.which.search import plain_twin
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model
from tests.support.synthetic import HARMONICS, experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


CUBIC_PER_M2 = 4e6
PLANT = {e.id for e in CATALOGUE.values() if e.path == "plant"}


def with_bent_sensors(rig: Rig, s: Sweep, cubic_per_m2: float) -> Sweep:
    """The sweep in a loop whose sensors add a cubic term, what it makes of the first and third harmonic carried round.

    y = x + c x^3 is X + 3/4 c |X|^2 X at the excited frequency and c/4 X^3 at its third harmonic.
    """
    frequency, line = np.unique(s.frequency_hz, return_inverse=True)
    f, k = HARMONICS.index(1), HARMONICS.index(3)
    once, thrice = (_round(rig, harmonic * frequency) for harmonic in (1, 3))

    def added(X: np.ndarray) -> np.ndarray:
        return 0.75 * cubic_per_m2 * np.abs(X) ** 2 * X

    X = s.Y[:, :, f]
    for _ in range(50):  # what the sensors add moves the rotor, too
        X = s.Y[:, :, f] + np.einsum("pij,pbj->pbi", once[0][line], added(X)) - added(X)
    out = {name: getattr(s, name).copy() for name in ("U", "I", "Y")}
    for (y, u, i), own, at in ((once, added(X), f), (thrice, cubic_per_m2 / 4 * X**3, k)):
        for name, per_added in (("Y", y), ("U", u), ("I", i)):
            out[name][:, :, at] += np.einsum("pij,pbj->pbi", per_added[line], own)
    return replace(s, **out)


def _round(rig: Rig, frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Change of y, u and i in the closed loop per change of the sensors' signals, (F, n, n) each."""
    m = linear_model(rig, frequency_hz)
    y = np.linalg.inv(np.eye(rig.n_axes) + m.y_per_u * m.controller[:, None, None])
    u = -m.controller[:, None, None] * y
    return y, u, m.i_per_u @ u


def test_a_sensor_bent_too_little_for_any_line_to_show_it_is_no_clean_rig() -> None:
    datasheet, truth = known_datasheet(seed=41)
    rig = true_rig(truth)
    measured = experiment(rig)
    bent = replace(measured, sweeps=tuple(with_bent_sensors(rig, s, CUBIC_PER_M2) for s in measured.sweeps))
    report = gap_document(diagnose(*one_plane(bent, datasheet)))
    assert report["verdict"]["kind"] == "none_of_these"
    words = r"curved.*x\^3 with c = ([\d.e+-]+) per m\^2 \(standard deviation ([\d.e+-]+)\)"
    told = re.search(words, report["verdict"]["sentence"])
    assert told is not None
    assert abs(float(told[1]) - CUBIC_PER_M2) < 4 * float(told[2])
    assert report["where"]["amplitude_dependent"] is True


def test_a_bent_sensor_of_which_saturation_explains_some_is_no_saturation() -> None:
    datasheet, truth = known_datasheet(seed=41)
    rig = true_rig(truth)
    measured = experiment(rig)
    bent = tuple(with_bent_sensors(rig, s, -0.25 * CUBIC_PER_M2) for s in measured.sweeps)
    verdict = diagnose(replace(measured, sweeps=bent), datasheet).verdict
    assert verdict.kind == "none_of_these"
    assert "the displacement is curved" in verdict.reasons[0]


def test_what_magnets_bend_more_or_less_than_their_datasheet_says_is_no_sensor() -> None:
    """The cubic terms of their force go with the bias; the twin's are off by a tenth here."""
    datasheet, truth = known_datasheet(seed=42)
    bias = tuple(1.05 * b for b in truth.bias_current_a)
    measured = experiment(true_rig(replace(truth, bias_current_a=bias)), amplitude_a=0.5)
    e, unseen = plain(measured, datasheet, "plant")
    assert curved_signal(e, unseen) is None
    bent = tuple(with_bent_sensors(true_rig(truth), s, 10 * CUBIC_PER_M2) for s in measured.sweeps)
    assert curved_signal(*plain(replace(measured, sweeps=bent), datasheet, "plant")) is not None


def test_a_current_probe_bent_too_little_for_any_line_to_show_it_is_told_of_the_amplifiers() -> None:
    datasheet, truth = known_datasheet(seed=43)
    measured = experiment(true_rig(truth))
    assert curved_signal(*plain(measured, datasheet, "amplifier")) is None
    e, unseen = plain(with_bent_probes(measured, 0.015), datasheet, "amplifier")
    assert e.remaining < 4.0, "no line or band shows it"
    told = re.search(
        r"current is curved.*x\^3 with c = ([\d.e+-]+) per A\^2 \(standard.* ([\d.e+-]+)\)",
        curved_signal(e, unseen) or "",
    )
    assert told is not None
    assert abs(float(told[1]) - 0.015) < 4 * float(told[2])


def test_a_harmonic_of_the_size_of_an_integrator_s_error_is_no_probe_however_little_noise_there_is() -> None:
    datasheet, truth = known_datasheet(seed=43)
    measured = experiment(true_rig(truth), noise=0.02)
    largest = max(float(np.abs(s.I[:, :, HARMONICS.index(1)]).max()) for s in measured.sweeps if s.I is not None)
    for share, told in ((1e-4, False), (1e-2, True)):
        bent = with_bent_probes(measured, 4 * share / largest**2)
        assert (curved_signal(*plain(bent, datasheet, "amplifier")) is not None) is told


def test_a_sensor_that_bends_less_than_two_programs_integrators_do_is_told_where_the_rotor_swings_slowly() -> None:
    datasheet, truth = known_datasheet(seed=44)
    rig = true_rig(truth)
    measured = experiment(rig, noise=0.2)
    largest = max(float(np.abs(s.Y[:, :, HARMONICS.index(1)]).max()) for s in measured.sweeps)
    cubic_per_m2 = 4 * 0.5 * MODEL_FLOOR / largest**2
    assert curved_signal(*plain(measured, datasheet, "plant")) is None
    bent = replace(measured, sweeps=tuple(with_bent_sensors(rig, s, cubic_per_m2) for s in measured.sweeps))
    words = r"x\^3 with c = ([\d.e+-]+) per m\^2 \(standard deviation ([\d.e+-]+)\)"
    told = re.search(words, curved_signal(*plain(bent, datasheet, "plant")) or "")
    assert told is not None
    assert abs(float(told[1]) - cubic_per_m2) < 4 * float(told[2])


def test_what_an_integrator_s_harmonic_of_the_currents_moves_the_rotor_by_is_no_sensor_however_little_noise() -> None:
    datasheet, truth = known_datasheet(seed=44)
    rig = true_rig(truth)
    measured = experiment(rig, noise=0.002, amplitude_a=0.03)
    f, k = HARMONICS.index(1), HARMONICS.index(3)
    sweeps = []
    for s in measured.sweeps:
        Y, U = s.Y.copy(), s.U[:, :, f]
        frequency, line = np.unique(s.frequency_hz, return_inverse=True)
        currents = np.einsum("pij,pbj->pbi", linear_model(rig, frequency).i_per_u[line], U)
        moved = np.einsum("pij,pbj->pbi", linear_model(rig, 3 * frequency).y_per_i[line], currents)
        share = MODEL_FLOOR * np.minimum(3 * s.frequency_hz / 1000, 1)[:, None, None]
        Y[:, :, k] += share * np.abs(moved) * np.exp(3j * np.angle(s.Y[:, :, f]))  # in phase as a curved sensor's
        sweeps.append(replace(s, Y=Y))
    assert curved_signal(*plain(replace(measured, sweeps=tuple(sweeps)), datasheet, "plant")) is None


def with_bent_probes(measured: Experiment, cubic_per_a2: float) -> Experiment:
    """The experiment as logged by current probes that add a cubic term."""
    sweeps = []
    for s in measured.sweeps:
        assert s.I is not None
        I = s.I.copy()
        I[:, :, HARMONICS.index(3)] += cubic_per_a2 / 4 * s.I[:, :, HARMONICS.index(1)] ** 3
        sweeps.append(replace(s, I=I))
    return replace(measured, sweeps=tuple(sweeps))


def plain(measured: Experiment, datasheet: Datasheet, path: str) -> tuple[Explained, tuple[Observation, np.ndarray]]:
    """The plain twin's part, and what it leaves of the other sweep."""
    nu = nuisance(datasheet)
    main, other = (observe(s, nu.rig) for s in measured.sweeps)
    part = next(p for p in parts(nu, (main,)) if p.path == path)
    ground = Ground(nu, part, (main,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        null, left = plain_twin(fitter, ground)
    e = Explained(ground, tuple(ranked(null, [])), left, left)
    return e, on_sweep(e, null, other)


def test_an_effect_that_explains_less_than_a_bent_sensor_would_does_not_stand_for_it() -> None:
    """A soft stop that the rotor only just reaches makes a harmonic 3, too."""
    datasheet, truth = known_datasheet(seed=41)
    rig = true_rig(truth)
    measured = experiment(rig)
    bent = replace(measured, sweeps=tuple(with_bent_sensors(rig, s, CUBIC_PER_M2) for s in measured.sweeps))
    e, unseen = plain(bent, datasheet, "plant")

    def named(effect: str, gain: float) -> Explained:
        """An explanation that takes so much chi-square off the main sweep, and nothing off the other."""
        null = e.null.candidate
        (chi, size), *others = null.fit.groups
        fit = replace(null.fit, effects=(effect,), values=({},), groups=((chi - gain, size), *others))
        best = replace(e.null, candidate=replace(null, effects=(effect,), fit=fit))
        return replace(e, order=(best, e.null))

    assert "x^3" in (curved_instead(named("touchdown_contact", 20.0), unseen, unseen) or "")
    assert "x^3" in (curved_instead(named("support_resonance", 20.0), unseen, unseen) or "")
    assert curved_instead(named("touchdown_contact", 5000.0), unseen, unseen) is None
    clean, unseen_clean = plain(measured, datasheet, "plant")
    assert (
        curved_instead(replace(named("touchdown_contact", 0.0), plain=clean.plain), unseen_clean, unseen_clean) is None
    )


@pytest.mark.parametrize("cubic_per_m2", [1e7, -5e7, 2e8])
def test_a_bent_sensor_is_told_with_its_curvature_and_not_as_the_force_that_bends_like_it(cubic_per_m2: float) -> None:
    """From plainly seen to a third of the signal; mixtures would bend to it in minutes, so none are looked for."""
    datasheet, truth = known_datasheet(seed=45)
    rig = true_rig(truth)
    measured = experiment(rig)
    bent = replace(measured, sweeps=tuple(with_bent_sensors(rig, s, cubic_per_m2) for s in measured.sweeps))
    report = gap_document(diagnose(*one_plane(bent, datasheet)))
    assert report["verdict"]["kind"] == "none_of_these"
    told = re.search(r"curved.*x\^3 with c = ([\d.e+-]+) per m\^2", report["verdict"]["sentence"])
    assert told is not None
    assert float(told[1]) == pytest.approx(cubic_per_m2, rel=0.1)
    of_plant = [c for c in report["candidates"] if len(c["effects"]) > 1 and c["effects"][1] in PLANT]
    assert not of_plant


@pytest.mark.parametrize("stiffer", [0.01, 0.1])
def test_a_ring_s_force_is_told_with_its_curvature_and_not_as_a_stop(stiffer: float) -> None:
    """``stiffer``: what it adds to the magnets' stiffness at the largest swing; a stop bends to all that stiffens."""
    datasheet, truth = known_datasheet(seed=46)
    rig = true_rig(truth)
    measured = experiment(rig)
    largest = max(float(np.abs(s.Y[:, :, HARMONICS.index(1)]).max()) for s in measured.sweeps)
    cubic = stiffer * truth.position_stiffness_n_per_m[0] / largest**2
    ringed = replace(measured, sweeps=tuple(with_ring(rig, s, cubic) for s in measured.sweeps))
    report = gap_document(diagnose(*one_plane(ringed, datasheet)))
    assert report["verdict"]["kind"] == "none_of_these"
    told = re.search(r"-k x\^3 with k = ([\d.e+-]+) N/m\^3", report["verdict"]["sentence"])
    assert told is not None, report["verdict"]["sentence"]
    assert float(told[1]) == pytest.approx(cubic, rel=0.1)


def test_a_ring_too_faint_to_be_told_from_a_stop_is_told_beside_it() -> None:
    datasheet, truth = known_datasheet(seed=46)
    rig = true_rig(truth)
    measured = experiment(rig)
    largest = max(float(np.abs(s.Y[:, :, HARMONICS.index(1)]).max()) for s in measured.sweeps)
    cubic = 0.003 * truth.position_stiffness_n_per_m[0] / largest**2
    ringed = replace(measured, sweeps=tuple(with_ring(rig, s, cubic) for s in measured.sweeps))
    d = diagnose(*one_plane(ringed, datasheet))
    assert d.verdict.effects == ("touchdown_contact",)
    assert any("not told apart either: a ring whose force grows smoothly" in note for note in d.notes)


def with_ring(rig: Rig, s: Sweep, cubic: float) -> Sweep:
    """The sweep in a loop whose bearings add a force -k x^3, what it makes of harmonics 1 and 3 carried round."""
    frequency, line = np.unique(s.frequency_hz, return_inverse=True)
    f, k = HARMONICS.index(1), HARMONICS.index(3)
    once, thrice = (_pushed(rig, harmonic * frequency) for harmonic in (1, 3))
    free = linear_model(rig, frequency)
    x0 = np.einsum("pij,pbj->pbi", free.bearing_per_u[line], s.U[:, :, f])
    x = x0
    for _ in range(100):
        x = 0.5 * x + 0.5 * (x0 + np.einsum("pij,pbj->pbi", once[0][line], -0.75 * cubic * np.abs(x) ** 2 * x))
    out = {name: getattr(s, name).copy() for name in ("U", "I", "Y")}
    for passed, force, at in ((once, -0.75 * cubic * np.abs(x) ** 2 * x, f), (thrice, -cubic / 4 * x**3, k)):
        for name, per_force in zip(("Y", "U", "I"), passed[1:], strict=True):
            out[name][:, :, at] += np.einsum("pij,pbj->pbi", per_force[line], force)
    return replace(s, **out)


def _pushed(rig: Rig, frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Change of the bearings' displacement, y, u and i in the closed loop per force at the bearings, (F, n, n) each."""
    m = linear_model(rig, frequency_hz)
    y = np.linalg.solve(np.eye(rig.n_axes) + m.y_per_u * m.controller[:, None, None], m.y_per_force)
    u = -m.controller[:, None, None] * y
    return m.bearing_per_force + m.bearing_per_u @ u, y, u, m.i_per_u @ u
