"""A mode that changes with its own swing is in no catalogue: it is told, and another resonance is not taken for it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.fitting.amplifiers_uncertainty import inherited_from
from service.gap.fitting.candidates import Task, fit_task
from service.gap.fitting.jacobian import swing_of
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.fitting.predict import displacement
from service.gap.fitting.stage import EXACT, PROBE
from service.gap.measured.observation import observe
from service.gap.which.changing_mode import changing_mode
from sim import actuator, rotor
from sim.rig import Rig
from sim.twin import linear_model, with_effects
from tests.support.synthetic import HARMONICS, experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow

SECOND = 1
"""The mode at 908 Hz, of two."""


def moved(rig: Rig, frequency: float, damping: float) -> Rig:
    """The second mode of the x plane at so much of its frequency, with so much more damping."""
    first, second = rig.rotor.modes[0]
    second = replace(
        second,
        natural_frequency_rad_s=second.natural_frequency_rad_s * frequency,
        damping_ratio=second.damping_ratio + damping,
    )
    return replace(rig, rotor=replace(rig.rotor, modes=((first, second), *rig.rotor.modes[1:])))


def closed(rig: Rig, hz: float, axis: int, excitation_a: float) -> dict[str, np.ndarray]:
    """U, I, Y of a tone, and the modal coordinates Q of the rotor."""
    model, m, point = linear_model(rig, np.array([hz])), rotor.mechanics(rig), actuator.operating_point(rig)
    U = model.u_per_r[0][:, axis] * excitation_a
    I, s = model.i_per_u[0] @ U, 2j * np.pi * hz
    stiffness = m.stiffness - m.force_map @ np.diag(point.ks) @ m.bearing_map
    Q = np.linalg.solve(m.mass * s**2 + m.damping * s + stiffness, m.force_map @ (point.ki * I))
    return {"U": U, "I": I, "Y": model.y_per_u[0] @ U, "Q": Q}


def with_changing_mode(rig: Rig, s: Sweep, frequency: float, damping: float, largest: float) -> Sweep:
    """The sweep of a rig whose second mode in x changes by so much at the swing ``largest``, in x alone excited."""
    out = {name: getattr(s, name).copy() for name in ("U", "I", "Y")}
    at = 2 + SECOND
    for p in np.flatnonzero((s.axis < 2) & (np.abs(s.frequency_hz / 908.5 - 1) < 0.1)):
        tone = float(s.frequency_hz[p]), int(s.axis[p]), float(s.amplitude_a[p])
        plain = closed(rig, *tone)
        square = abs(plain["Q"][at]) ** 2
        for _ in range(40):
            share = square / largest
            now = closed(moved(rig, 1 + frequency * share, damping * share), *tone)
            square = 0.5 * square + 0.5 * abs(now["Q"][at]) ** 2
        for name, signal in out.items():
            signal[p, :, HARMONICS.index(1)] += now[name] - plain[name]
    return replace(s, **out)


@pytest.mark.parametrize(("frequency", "damping"), [(-2e-3, 0.0), (0.0, 5e-3)])
def test_a_mode_that_changes_with_its_swing_is_told_and_no_other_resonance(frequency: float, damping: float) -> None:
    datasheet, truth = known_datasheet(seed=51)
    rig = true_rig(truth)
    measured = experiment(rig)
    largest = max(
        abs(closed(rig, float(s.frequency_hz[p]), int(s.axis[p]), float(s.amplitude_a[p]))["Q"][2 + SECOND]) ** 2
        for s in measured.sweeps
        for p in np.flatnonzero(s.axis < 2)
    )
    changing = tuple(with_changing_mode(rig, s, frequency, damping, largest) for s in measured.sweeps)
    report = gap_document(diagnose(*one_plane(replace(measured, sweeps=changing), datasheet)))
    assert report["verdict"]["kind"] == "none_of_these"
    sentence = report["verdict"]["sentence"]
    told = re.search(
        r"the mode at 9\d\d(?:\.\d)? Hz changes with its own swing.*?its (frequency|damping ratio)", sentence
    )
    assert told is not None, sentence
    assert told[1] == ("frequency" if frequency else "damping ratio")


def test_a_true_resonance_beside_a_mode_stays_one() -> None:
    datasheet, truth = known_datasheet(seed=52)
    beside = {"frequency_hz": 880.0, "damping_ratio": 0.003, "bearing_A_per_sqrt_kg": 0.02}
    sensors = {"bearing_B_per_sqrt_kg": 0.01, "sensor_A_per_sqrt_kg": 0.02, "sensor_B_per_sqrt_kg": 0.01}
    rig = with_effects(true_rig(truth), {"extra_flexible_mode": {**beside, **sensors}})
    verdict = diagnose(*one_plane(experiment(rig), datasheet)).verdict
    assert "extra_flexible_mode" in {*verdict.effects, *(name for group in verdict.indistinguishable for name in group)}


def test_what_a_mode_s_own_change_adds_is_what_a_rotor_with_that_mode_does() -> None:
    """One entry of the dynamic stiffness changed: exact, however large (Sherman and Morrison)."""
    datasheet, truth = known_datasheet(seed=53)
    measured, sheet = one_plane(experiment(true_rig(truth)), datasheet)
    rig = nuisance(sheet).rig
    o = observe(measured.sweeps[0], rig)
    swing = swing_of(rig, o, SECOND)
    mode, s = rig.rotor.modes[0][SECOND], 2j * np.pi * o.points_hz
    w, zeta = mode.natural_frequency_rad_s, mode.damping_ratio
    change = (1.01 * w) ** 2 - w**2 + 2 * (1.01 * w * (zeta + 0.002) - w * zeta) * s
    pushed = -change * swing.coordinate[:, 0] / (1 + swing.own[:, 0] * change)
    expected = displacement(moved(rig, 1.01, 0.002), o)
    np.testing.assert_allclose(displacement(rig, o) + swing.seen[:, :, 0] * pushed[:, None], expected, rtol=1e-9)


def test_a_plant_that_is_kept_behind_amplifiers_explained_anew_is_held_against_these() -> None:
    """What was uncertain of the amplifiers when it was fitted is no parameter of the ground it stands on now."""
    datasheet, truth = known_datasheet(seed=3)
    nu = nuisance(datasheet)
    o = observe(experiment(true_rig(truth)).sweeps[0], nu.rig)
    _, amplifiers, plant = parts(nu, (o,))
    of_amplifiers = Ground(nu, amplifiers, (o,), np.zeros(len(nu)))
    delay = fit_task(Task(of_amplifiers, ("loop_delay",), (({"delay_s": 2e-6},),), of_amplifiers.theta, (EXACT,)))
    behind = Ground(nu, plant, (o,), delay.fit.theta, inherited=inherited_from(of_amplifiers, delay))
    null = fit_task(Task(behind, (), ((),), behind.theta, (PROBE,)))
    assert null.fit.inherited, "else nothing is tried here"
    now = np.where(np.isin(np.arange(len(nu)), amplifiers.active), 0.5, 0.0)
    anew = replace(behind, theta=now, found=(("loop_delay", {"delay_s": 9e-6}),), inherited=None)
    rig = anew.fitted_rig(null.fit.theta, null.fit.inherited)
    np.testing.assert_array_equal(rig.amplifiers.delay_s, 9e-6)
    np.testing.assert_array_equal(rig.amplifiers.gain, anew.rig(now).amplifiers.gain)
    np.testing.assert_array_equal(rig.magnets.ki, nu.at(null.fit.theta).magnets.ki)
    assert changing_mode(anew, null) is not None
