"""The two sweeps of a diagnosis: the main one, which is fitted, and the other one, which checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.experiment.data import Sweep
from service.experiment.resting import about_rest
from service.gap.measured.erratic import FEWEST_AXES, Erratic, erratic, erratic_in_words, steepest
from service.gap.measured.excited_together import Together
from service.gap.measured.informative_lines import thinned
from service.gap.measured.observation import GapError, Observation, observe, usable
from service.gap.measured.sweeps import best_check, timed
from sim.rig import Rig


@dataclass(frozen=True)
class Pair:
    """The sweep to fit (main) and the one to check on (other)."""

    main_name: str
    main: Sweep
    name: str
    """of ``other``"""
    other: Sweep
    lines_only: bool
    """whether both are halves of one sweep's lines"""
    together: tuple[Together | None, Together | None]
    """all lines of each, of multisines"""

    @classmethod
    def of(
        cls, main_name: str, main: Sweep, others: Sequence[tuple[str, Sweep]], rig: Rig
    ) -> tuple[Pair, tuple[str, ...]]:
        """The main sweep and the best check among the others, or two halves of its own lines; notes on what is unused.

        ``others`` are (name, sweep); ``rig`` is the twin that is to be fitted.
        """
        if not others:
            main = timed(main)
            together, line = Together.of(usable(main)), np.unique(main.frequency_hz, return_inverse=True)[1]
            name = f"every other line of {main_name}"
            even, odd = main.select(line % 2 == 0), main.select(line % 2 == 1)
            _require_both(main_name, even, odd)
            return cls(main_name, even, name, odd, True, (together, together)), ()
        (name, other), unused = best_check(main, others, rig)
        main, other, notes = timed(main, other), timed(other, main), []
        if main.I is not None and other.I is None:  # a fit to one could not be held against the other
            main = replace(main, I=None)
            notes.append(
                f"{name} has no coil current, so that of {main_name} is not used: amplifier and plant cannot be told "
                "apart, alias classes grow"
            )
        notes += [f"{n} is not used: a diagnosis fits one sweep and checks on one other, here {name}" for n in unused]
        together_each = Together.of(usable(main)), Together.of(usable(other))
        return cls(main_name, main, name, other, False, together_each), tuple(notes)

    def about_rest(self) -> Pair:
        """Both sweeps without their static load: currents and displacements about the resting point."""
        return replace(self, main=about_rest(self.main), other=about_rest(self.other))

    def without_erratic(self, axes: Sequence[str]) -> tuple[Pair, tuple[str, ...], Erratic | None]:
        """Both sweeps without their erratic points, notes on these, and where several axes are erratic at once."""
        main, main_words, of_main = _without_erratic(usable(self.main), self.main_name, axes)
        other, other_words, of_other = _without_erratic(usable(self.other), self.name, axes)
        notes = tuple(
            f"{words}; {'this line is' if several else 'that is'} left out"
            for words, several in (*main_words, *other_words)
        )
        of_rig = next(
            (
                Erratic(words, points, max(steepest(main), steepest(other)))
                for described, points in ((main_words, of_main), (other_words, of_other))
                for words, several in described
                if several
            ),
            None,
        )
        return replace(self, main=main, other=other), notes, of_rig

    def observations(
        self, rig: Rig, hums_hz: Sequence[Sequence[float]], span: tuple[float, float] | None
    ) -> tuple[Observation, Observation]:
        """Observations of both; ``hums_hz`` and ``span`` as in `observe`, hums of each sweep.

        Points without times count as measured in their order, the other sweep after the main one.
        """
        during, after = ((0.0, 1.0), (0.0, 1.0)) if self.lines_only else ((0.0, 0.8), (0.8, 1.0))
        o = observe(thinned(usable(self.main)), rig, during, hums_hz[0], span, self.together[0])
        return o, observe(thinned(usable(self.other)), rig, after, hums_hz[1], span, self.together[1])


def _require_both(name: str, *halves: Sweep) -> None:
    try:
        for half in halves:
            usable(half)
    except GapError as error:
        raise GapError(
            f"{name} is the only sweep, so that half of its lines is fitted and the other half checks: of one half, "
            f"{error}; measure more lines, or a second sweep"
        ) from error


def _without_erratic(sweep: Sweep, name: str, axes: Sequence[str]) -> tuple[Sweep, list[tuple[str, bool]], Sweep]:
    """A sweep without its erratic points, sentences on them, and those on lines where several axes are erratic.

    Such a line is left out as a whole.
    """
    bad = erratic(sweep)
    hz, axes_of = np.unique(sweep.frequency_hz[bad], return_counts=True)
    on_bad_line = np.isin(sweep.frequency_hz, hz[axes_of >= FEWEST_AXES])
    return sweep.select(~(bad | on_bad_line)), erratic_in_words(sweep, bad, axes, name), sweep.select(bad & on_bad_line)
