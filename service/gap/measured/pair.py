"""The sweep that a diagnosis fits beside the one that it checks on, made ready for both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.experiment.data import Sweep
from service.experiment.resting import about_rest
from service.gap.measured.erratic import FEWEST_AXES, Erratic, erratic, erratic_in_words, steepest
from service.gap.measured.excited_together import Together
from service.gap.measured.informative_lines import thinned
from service.gap.measured.observation import Observation, observe, usable
from service.gap.measured.sweeps import best_check, timed
from sim.rig import Rig


@dataclass(frozen=True)
class Pair:
    """The sweep to fit and the one to check on, with what makes them so."""

    main_name: str
    main: Sweep
    name: str
    other: Sweep
    lines_only: bool
    together: tuple[Together | None, Together | None]
    """of multisines, what their lines do to each other"""

    @classmethod
    def of(
        cls, main_name: str, main: Sweep, others: Sequence[tuple[str, Sweep]], rig: Rig
    ) -> tuple[Pair, tuple[str, ...]]:
        """The main sweep beside the best of the others, or its own lines in two; and what is not used, in words.

        ``others`` are by name; ``rig`` is the twin that is to be fitted.
        """
        main = timed(main)
        if not others:
            together, line = Together.of(usable(main)), np.unique(main.frequency_hz, return_inverse=True)[1]
            name = f"every other line of {main_name}"
            even, odd = main.select(line % 2 == 0), main.select(line % 2 == 1)
            return cls(main_name, even, name, odd, True, (together, together)), ()
        (name, other), unused = best_check(main, others, rig)
        other, notes = timed(other), []
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
        """Both without what the magnets carry."""
        return replace(self, main=about_rest(self.main), other=about_rest(self.other))

    def without_erratic(self, axes: Sequence[str]) -> tuple[Pair, tuple[str, ...], Erratic | None]:
        """Both without their erratic points, what is said of these, and where the rig itself is erratic."""
        main, lost, of_main = _without_erratic(usable(self.main), self.main_name, axes)
        other, lost_there, of_other = _without_erratic(usable(self.other), self.name, axes)
        notes = tuple(
            f"{words}; {'this line is' if several else 'that is'} left out" for words, several in (*lost, *lost_there)
        )
        rig = next(
            (
                Erratic(words, points, max(steepest(main), steepest(other)))
                for told, points in ((lost, of_main), (lost_there, of_other))
                for words, several in told
                if several
            ),
            None,
        )
        return replace(self, main=main, other=other), notes, rig

    def observations(
        self, rig: Rig, hums_hz: Sequence[Sequence[float]], span: tuple[float, float] | None
    ) -> tuple[Observation, Observation]:
        """Both as a diagnosis fits them; ``hums_hz`` are of each, as of `observe`.

        A file that does not date its points has them in their order, the other sweep after the main one.
        """
        during, after = ((0.0, 1.0), (0.0, 1.0)) if self.lines_only else ((0.0, 0.8), (0.8, 1.0))
        o = observe(thinned(usable(self.main)), rig, during, hums_hz[0], span, self.together[0])
        return o, observe(thinned(usable(self.other)), rig, after, hums_hz[1], span, self.together[1])


def _without_erratic(sweep: Sweep, name: str, axes: Sequence[str]) -> tuple[Sweep, list[tuple[str, bool]], Sweep]:
    """A sweep without its erratic points, what is said of them, and the points; where it is the rig, whole lines."""
    out = erratic(sweep)
    hz, axes_of = np.unique(sweep.frequency_hz[out], return_counts=True)
    lines = np.isin(sweep.frequency_hz, hz[axes_of >= FEWEST_AXES])
    return sweep.select(~(out | lines)), erratic_in_words(sweep, out, axes, name), sweep.select(out & lines)
