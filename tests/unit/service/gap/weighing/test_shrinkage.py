"""How far a gap shrinks is told where the unseen sweep shows it, and nowhere else."""

import numpy as np
import pytest

from service.gap.measured.observation import observe
from service.gap.weighing.shrinkage import interval_95, shrinkage
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

TWIN = true_rig(known_datasheet(seed=1)[1])
LATE = with_effects(TWIN, {"loop_delay": {"delay_s": 3e-5}})


def unseen(rig):
    return observe(sweep(rig, np.geomspace(13.0, 930.0, 16), 0.3, seed=7), TWIN)


def test_a_gap_that_is_there_closes_with_what_made_it() -> None:
    s = shrinkage(TWIN, LATE, unseen(LATE), "sweeps/1")
    assert s.closure == pytest.approx(1.0, abs=0.02)
    assert s.paths["amplifier"].closure == pytest.approx(1.0, abs=0.02)
    assert s.paths["controller"].closure is None


def test_a_sweep_without_the_gap_tells_no_closure() -> None:
    s = shrinkage(TWIN, LATE, unseen(TWIN), "sweeps/1")
    assert s.closure is None
    assert s.closure_95 == (None, None)
    assert all(c.closure is None for c in (*s.paths.values(), *s.channels.values()))
    assert s.after > s.before


def test_a_controller_held_exactly_hides_no_faint_gap() -> None:
    faint = with_effects(TWIN, {"loop_delay": {"delay_s": 7e-7}})
    s = shrinkage(TWIN, faint, unseen(faint), "sweeps/1")
    parts = [s.paths[path].before for path in ("amplifier", "plant")]
    assert s.paths["controller"].before < 1e-9
    assert s.before == pytest.approx(np.mean(parts))
    assert np.mean([0.0, *parts]) < 1 < s.before  # with the controller in it, nothing would be to close
    assert s.closure is not None


def test_a_gap_that_a_few_lines_of_one_path_show_is_not_diluted_by_the_other_paths() -> None:
    nearer = with_effects(TWIN, {"sensor_position": {"shift_A_m": 1.5e-3, "shift_B_m": 0.0}})
    s = shrinkage(TWIN, nearer, observe(sweep(nearer, np.geomspace(13.0, 130.0, 6), 0.3, seed=7), TWIN), "sweeps/1")
    assert s.paths["plant"].closure == pytest.approx(1.0, abs=0.1)
    assert s.closure == pytest.approx(1.0, abs=0.1)


def test_an_interval_holds_what_lies_between_one_in_forty_on_either_side() -> None:
    evenly = np.linspace(0.0, 1.0, 1001)
    assert interval_95(np.random.default_rng(0).permutation(evenly), 1001) == pytest.approx((0.025, 0.975))


def test_an_interval_is_open_where_resamples_do_not_show_the_gap() -> None:
    assert interval_95([0.9] * 100, 100) == (pytest.approx(0.9), pytest.approx(0.9))
    assert interval_95([0.9] * 90, 100)[0] is None
    assert interval_95([], 100) == (None, None)
