"""Every effect of the catalogue that a twin names is in the identification's model, or it is told: none is dropped."""

from dataclasses import replace

import numpy as np
import pytest

from service.identification.loop.margins import sensitivity
from service.identification.measured.points import planes_of
from service.identification.steps.nominal import known_of
from sim import effects as catalogue
from sim.datasheet import Datasheet
from sim.effect import Effect
from sim.effects import CATALOGUE
from sim.folded import Folded, folded
from sim.twin import linear_model, rig_from_datasheet
from tests.support.planes import plane_model_of
from tests.support.synthetic import known_datasheet

TRUTH = known_datasheet()[1]
FREQUENCY_HZ = np.array([12.0, 60.0, 200.0, 429.0, 485.0, 650.0, 900.0, 1000.0])
IMAGES = 1.5e-3
"""The plane's model leaves out what the hold's images do to the displacement: so much of the response at 1 kHz."""


def twin_with(effect: Effect) -> Datasheet:
    return replace(TRUTH, effects=((effect.id, tuple((p.name, p.typical) for p in effect.parameters)),))


def is_told(effect: Effect) -> bool:
    return bool(folded(twin_with(effect)).effects[0].not_in_model)


def differences(sheet: Datasheet, assumed: Folded) -> float:
    """Largest relative difference of i/u, y/u and S between a rig and the model of its planes, of all frequencies."""
    theory = linear_model(rig_from_datasheet(sheet), FREQUENCY_HZ)
    omega, chain = theory.omega_rad_s, assumed.chain
    law = (np.array(assumed.datasheet.numerator), np.array(assumed.datasheet.denominator))
    worst = 0.0
    for plane, pair in planes_of(sheet.axes).items():
        rows, own = np.ix_(range(len(omega)), pair, pair), chain.of(list(pair))
        model = plane_model_of(rig_from_datasheet(assumed.datasheet), plane)
        model = replace(model, known=known_of(assumed.datasheet, plane, sheet.axes, own))
        drive = own.drive_per_logged(omega)
        current = (model.amplifier_response(omega, base_band=False) * own.current_lag(omega))[:, :, None] * drive
        pairs = [
            (theory.i_per_u, current),
            (theory.y_per_u, model.response(omega) @ drive),
            (np.abs(theory.u_per_r), np.abs(sensitivity(model, law, omega))),
        ]
        for true, ours in pairs:
            off = np.linalg.norm(true[rows] - ours, axis=(1, 2)) / np.linalg.norm(true[rows], axis=(1, 2))
            worst = max(worst, float(off.max()))
    return worst


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_every_effect_is_in_the_model_or_told_in_words_of_its_own(effect):
    (known,) = folded(twin_with(effect)).effects
    assert known.effect == effect.id
    assert known.in_model or known.not_in_model
    assert len(known.sentences()) == len(known.not_in_model)
    assert not any("changes of the rig" in clause for clause in known.not_in_model)


@pytest.mark.parametrize("name", [e.id for e in CATALOGUE.values() if e.nonlinear or not is_told(e)])
def test_what_is_not_told_is_in_the_model(name):
    """At small signal and standstill; of a nonlinear effect what it does to small signals."""
    twin = twin_with(CATALOGUE[name])
    assert differences(twin, folded(twin)) < IMAGES


@pytest.mark.parametrize("name", ["loop_delay", "eddy_currents", "channel_crosstalk", "support_resonance"])
def test_without_it_the_model_is_another_one(name):
    twin = twin_with(CATALOGUE[name])
    assert differences(twin, folded(replace(twin, effects=()))) > 10 * IMAGES


def test_an_effect_that_changes_something_new_is_told(monkeypatch):
    """A stronger bias, say: nobody has written how the model would carry it."""

    def stronger(rig, values):
        return replace(rig, magnets=replace(rig.magnets, bias_current_a=1.1 * rig.magnets.bias_current_a))

    new = replace(CATALOGUE["loop_delay"], id="strong_bias", apply=stronger)
    monkeypatch.setitem(catalogue.CATALOGUE, new.id, new)
    (known,) = folded(twin_with(new)).effects
    assert known.in_model == ()
    assert "magnets.bias_current_a" in known.sentences()[0]
