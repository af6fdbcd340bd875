"""A fit whose steps ran out goes on before another effect beside it is looked for."""

from collections.abc import Iterable
from dataclasses import replace

import pytest

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.fitted import OUT_OF_STEPS
from service.gap.which.refits import cost, refitted_from_best
from tests.unit.service.gap.where.test_dependence import plant


class Going(Fitter):
    """Takes so much off a fit's cost each time, and then some more steps, or none."""

    def __init__(self, gains: Iterable[float]) -> None:
        super().__init__()
        self.gains, self.asked = list(gains), 0

    def run(self, tasks: Iterable[Task]) -> list[Candidate]:
        self.asked += 1
        (task,) = tasks
        return [at(1000.0 - sum(self.gains[: self.asked]), task.effects)]


def at(chi_square: float, effects: tuple[str, ...] = ("magnetic_saturation",)) -> Candidate:
    null = plant("none")[0].null.candidate
    fit = replace(null.fit, effects=effects, groups=((chi_square, 100),), penalty=0.0, status=OUT_OF_STEPS)
    return replace(null, effects=effects, fit=replace(fit, values=({},)))


@pytest.mark.parametrize(
    ("gains", "asked", "ends"), [((300, 200, 0), 3, 500), ((300, 200, 100, 50), 3, 400), ((1, 300), 1, 1000)]
)
def test_the_best_fit_goes_on_while_that_gains_something(gains: tuple[float, ...], asked: int, ends: float) -> None:
    fitter, other = Going(gains), at(1200.0, ("eddy_currents",))
    found = refitted_from_best(fitter, plant("none")[0].ground, [other, at(1000.0)])
    assert fitter.asked == asked
    assert [cost(c) for c in found] == [1200.0, ends]


def test_one_that_settled_stays() -> None:
    fitter, best = Going([300.0]), at(1000.0)
    still = replace(best, fit=replace(best.fit, status="converged"))
    assert refitted_from_best(fitter, plant("none")[0].ground, [still]) == [still]
    assert fitter.asked == 0
