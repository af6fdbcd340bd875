"""Modes chosen once are not searched for again in nearly the same data, but where these speak against the choice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest

from service.identification.joint.fits import JointFits
from service.identification.joint.selection import Selected, choose_modes
from service.identification.measured.data import Data
from service.identification.measured.etfe import FrequencyResponse, etfe
from service.identification.measured.points import PlanePoints, plane_points
from service.identification.options import Options
from service.identification.plane.model import PlaneModel
from service.identification.steps.nominal import split_knowledge, start_model
from service.identification.steps.staged import StagedFit, staged_fit
from service.identification.steps.start import joint_start, with_modes
from sim.datasheet import Datasheet
from tests.support.planes import synthetic_sweep

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Measured:
    """What modes are chosen from."""

    sheet: Datasheet
    points: PlanePoints

    @cached_property
    def data(self) -> Data:
        return Data(self.points)

    @cached_property
    def plant(self) -> FrequencyResponse:
        seen = etfe(self.points, "u->y")
        gain = self.start.amplifier_response(seen.omega)
        return FrequencyResponse(seen.omega, seen.value / gain[:, None], seen.std / np.abs(gain)[:, None])

    @cached_property
    def start(self) -> PlaneModel:
        return start_model(self.sheet, "x", self.sheet.axes, self.data)[0]

    @cached_property
    def staged(self) -> StagedFit:
        return staged_fit(self.start, self.points, self.plant)

    def chosen(self, before: Selected | None = None) -> Selected:
        begin = joint_start(self.staged.rigid_model, self.staged.rational, self.points, self.plant)
        knowledge = replace(split_knowledge(self.sheet, Options()), end_rad_s=float(self.points.omega.max()))
        lowest = self.staged.lowest_mode_rad_s
        return choose_modes(begin, self.staged.rigid_model, self.data, self.plant, lowest, knowledge, before)


@pytest.fixture(scope="module")
def measured(datasheet: Datasheet, truth: dict[str, PlaneModel], controller: tuple[np.ndarray, np.ndarray]) -> Measured:
    peaks = [hz + np.linspace(-6, 6, 7) for hz in (492.6, 907.2)]
    hz = np.unique(np.concatenate([np.geomspace(10, 997, 80), *peaks]))
    sweep = synthetic_sweep(truth, datasheet.axes, controller, hz, 0.15, seed=1)
    return Measured(datasheet, plane_points(sweep, datasheet.axes, "x"))


@pytest.fixture(scope="module")
def other(measured: Measured) -> Measured:
    """The same points with a little more noise in them, as where something was taken out."""
    rng = np.random.default_rng(0)
    shape = measured.points.Y.shape
    size = np.abs(measured.points.Y - measured.points.y[:, None]).mean(axis=(0, 1))
    more = 0.3 * size * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    return replace(measured, points=replace(measured.points, Y=measured.points.Y + more))


@pytest.fixture(scope="module")
def choice(measured: Measured) -> Selected:
    return measured.chosen()


def number(selected: Selected) -> list[str]:
    return [e.name for e in selected.evidence if e.chosen]


def not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    def begun(*_: object) -> None:
        raise AssertionError("searched from the start")

    monkeypatch.setattr(JointFits, "begun", begun)


def test_a_choice_that_stands_gives_what_a_search_would(
    other: Measured, choice: Selected, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched = other.chosen()
    not_searched(monkeypatch)
    again = other.chosen(choice)
    assert number(again) == number(searched) == ["2 modes"]
    a, b = again.refined, searched.refined
    shapes = np.concatenate([np.arange(m.start + 2, m.stop) for m in map(b.model.layout.mode, range(2))])
    told = np.flatnonzero(b.fit.free & ~np.isin(np.arange(b.model.layout.size), shapes))  # no data tell their splits
    std = np.sqrt(np.diag(np.linalg.inv(b.fit.jacobian.T @ b.fit.jacobian)))[
        np.searchsorted(np.flatnonzero(b.fit.free), told)
    ]
    assert np.max(np.abs(a.model.theta - b.model.theta)[told] / std) < 0.02
    assert again.evidence[0].name == "1 mode"  # told with its neighbours
    assert again.evidence[0].rms > 10 * again.evidence[1].rms


@pytest.mark.parametrize("wrong", [1, 3])
def test_a_choice_against_which_the_data_speak_is_made_anew(other: Measured, choice: Selected, wrong: int) -> None:
    modes = choice.refined.model.modes
    if wrong == 3:  # one that the other data had
        modes = np.vstack([modes, [4000.0, 8.0, 0.004, 0.003, 0.004, 0.003]])
    models = [with_modes(choice.refined.model, modes[:n]) for n in (wrong - 1, wrong)]
    evidence = tuple(
        replace(choice.evidence[0], name=f"{m.layout.n_modes} modes", chosen=m is models[-1]) for m in models
    )
    before = replace(choice, evidence=evidence, candidates=tuple(models))
    found = other.chosen(before)
    assert number(found) == ["2 modes"]
    assert np.allclose(found.refined.model.modes[:, 0], choice.refined.model.modes[:, 0], rtol=1e-3)


@pytest.fixture(scope="module")
def unexplained(measured: Measured) -> tuple[Measured, Selected]:
    """Signals that no model explains, the sensors' gains change with frequency, and what is found in them."""
    points = measured.points
    bent = 1 + 0.02 * np.sin(points.omega / 500.0)[:, None, None]
    now = replace(measured, points=replace(points, Y=points.Y * bent))
    return now, now.chosen()


@pytest.mark.parametrize("rms", [4.0, 1000.0])
def test_a_search_that_found_no_model_is_repeated_where_much_less_is_wrong_now(
    unexplained: tuple[Measured, Selected], rms: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, lost = unexplained
    assert lost.refined.relative > 0
    asked = []
    begun = JointFits.begun
    monkeypatch.setattr(JointFits, "begun", lambda self, *rest: asked.append(1) or begun(self, *rest))
    place = next(k for k, e in enumerate(lost.evidence) if e.chosen)
    here = lost.evidence[place].rms
    worse = replace(lost.evidence[place], cost=lost.evidence[place].cost * (rms / here) ** 2)
    before = replace(lost, evidence=(*lost.evidence[:place], worse, *lost.evidence[place + 1 :]))
    found = now.chosen(before)
    assert bool(asked) == (here < 0.5 * rms)
    assert number(found) == number(lost)


def test_a_mode_that_only_these_data_show_is_found(
    measured: Measured,
    choice: Selected,
    truth: dict[str, PlaneModel],
    controller: tuple[np.ndarray, np.ndarray],
) -> None:
    """One so small that the model without it is all but adequate."""
    plane = truth["x"]
    small = with_modes(plane, np.vstack([plane.modes, [4400.0, 20.0, 0.007, 0.007, 0.007, 0.007]]))
    hz = np.unique(measured.points.omega) / (2 * np.pi)
    sweep = synthetic_sweep({"x": small}, measured.sheet.axes[:2], controller, hz, 0.15, seed=1)
    points = plane_points(sweep, measured.sheet.axes[:2], "x")
    found = replace(measured, points=points).chosen(choice)
    assert number(found) == ["3 modes"]
    assert found.evidence[1].rms < 1.5
    assert found.refined.model.modes[1, 0] == pytest.approx(4400.0, rel=1e-2)
