"""Laws beyond the catalogue act on the log or on the excitation as they say, however the rig is advanced."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sim.reference import reference_rig
from sim.rig import Noise
from sim.stepping import Record, Simulation
from sim.withheld.unlisted_laws import (
    ClippedLog,
    CoarseLog,
    CurvedProbe,
    FilteredLog,
    HeldLog,
    LooseConnector,
    TamperedSimulation,
    Tampering,
    WrongInjection,
)

RIG = reference_rig(noise=Noise())
FS = 1 / RIG.controller.sample_time_s
N = 3000

LAWS: dict[str, Callable[[], Tampering]] = {
    "clipped": lambda: ClippedLog(1e-6),
    "held": lambda: HeldLog(7),
    "coarse": lambda: CoarseLog(1e-6),
    "filtered current": lambda: FilteredLog("i", (0, 1, 2, 3), 2e3, 1 / FS),
    "filtered displacement": lambda: FilteredLog("y", (1,), 2e3, 1 / FS),
    "loose": lambda: LooseConnector(0, 0.1, 0.0),
    "curved": lambda: CurvedProbe(0.3),
    "injection": lambda: WrongInjection(0.05, 0.2),
}


def excitation() -> np.ndarray:
    r = np.zeros((N, 4))
    r[:, 0] = 0.3 * np.sin(2 * np.pi * 60 * np.arange(N) / FS) * np.minimum(1, np.arange(N) / 500)
    return r


def run(law: Tampering, chunk: int = N) -> Record:
    simulation = TamperedSimulation(RIG, 0, law, campaign_s=1.0)
    parts = [simulation.advance(excitation()[k : k + chunk]) for k in range(0, N, chunk)]
    signals = [np.concatenate([getattr(p, name) for p in parts]) for name in "ruiy"]
    return Record(*signals, exceeded="")


@pytest.fixture(scope="module")
def honest() -> Record:
    return Simulation(RIG).advance(excitation())


def test_no_tampering_is_the_rig_itself(honest: Record) -> None:
    for name in "ruiy":
        np.testing.assert_array_equal(getattr(run(Tampering()), name), getattr(honest, name))


@pytest.mark.parametrize("name", sorted(LAWS))
def test_a_law_shows_in_the_records_but_the_excitation_is_logged_as_asked_for(name: str, honest: Record) -> None:
    found = run(LAWS[name]())
    np.testing.assert_array_equal(found.r, excitation())
    changed = [s for s in "uiy" if not np.allclose(getattr(found, s), getattr(honest, s), rtol=1e-6, atol=0)]
    assert changed


@pytest.mark.parametrize("name", sorted(LAWS))
def test_a_law_does_not_depend_on_how_the_rig_is_advanced(name: str) -> None:
    whole, pieces = run(LAWS[name]()), run(LAWS[name](), chunk=617)
    for signal in "uiy":
        np.testing.assert_allclose(getattr(pieces, signal), getattr(whole, signal), rtol=1e-9, atol=1e-15)


def test_laws_of_the_log_leave_the_loop_alone(honest: Record) -> None:
    for law in (ClippedLog(1e-6), HeldLog(7), CoarseLog(1e-6), CurvedProbe(0.3)):
        np.testing.assert_array_equal(run(law).u, honest.u)


def test_held_samples_repeat_the_one_before(honest: Record) -> None:
    y = run(HeldLog(5)).y
    np.testing.assert_array_equal(y[4::5], honest.y[3::5][: len(y[4::5])])
    np.testing.assert_array_equal(y[0::5], honest.y[0::5])


def test_a_filtered_log_lags_as_a_first_order_filter_does(honest: Record) -> None:
    basis = np.exp(-2j * np.pi * 60 * np.arange(N // 2) / FS)
    ratio = (basis @ run(FilteredLog("i", (0,), 300.0, 1 / FS)).i[-N // 2 :, 0]) / (basis @ honest.i[-N // 2 :, 0])
    pole = np.exp(-2 * np.pi * 300 / FS)
    expected = (1 - pole) / (1 - pole * np.exp(-2j * np.pi * 60 / FS))
    assert abs(ratio - expected) < 0.01


def test_a_connector_works_loose_on_the_way(honest: Record) -> None:
    simulation = TamperedSimulation(RIG, 0, LooseConnector(0, 0.5, 0.2), campaign_s=1.0)
    first = simulation.advance(excitation()[:1500])
    second = simulation.advance(excitation()[1500:])
    np.testing.assert_array_equal(first.y, honest.y[:1500])
    np.testing.assert_allclose(second.y[:, 0], 1.5 * honest.y[1500:, 0])


def test_a_limit_still_ends_a_record() -> None:
    tight = replace(RIG, displacement_limit_m=2e-6)
    record = TamperedSimulation(tight, 0, ClippedLog(1e-6), 1.0).advance(excitation())
    assert record.exceeded == "displacement"
    assert len(record) < N
    assert len(record.r) == len(record.y)
