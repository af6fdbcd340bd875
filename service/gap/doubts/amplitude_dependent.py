"""Whether a gap that linear effects are to explain changes with amplitude, which no linear effect does.

Where the currents of a sweep rise with frequency, what depends on the one looks like what depends on the other: in
noise that keeps a hysteresis loop moving its harmonics vanish, and eddy currents explain most of the rest. A sweep at
another amplitude tells: a linear gap is the same there.
"""

from __future__ import annotations

from service.gap.fitting.unknowns import CHANGING
from service.gap.measured.condition import conditions_of
from service.gap.measured.observation import Observation
from service.gap.weighing.verdict import LEAVES, HeldOut
from service.gap.which.between_sweeps import change_between
from service.gap.which.explained import Explained
from sim.effects import CATALOGUE
from sim.wording import in_words

PROVEN = 8.0
"""Normal deviate from which the change is believed: of some two hundred rigs of two programs, those with linear effects
had 3 at most."""


def changes_with_amplitude(e: Explained, other: Observation, there: HeldOut) -> str | None:
    """Why the linear effects of the best explanation are rejected, in words; None where they are not, or not linear.

    ``other`` is another sweep; unless it has another amplitude and the same speed it tells nothing. ``there`` is how
    the explanation fares on it: it must leave something, too.
    """
    effects = e.order[0].candidate.effects
    if not effects or any(CATALOGUE[name].nonlinear or name in CHANGING for name in effects):
        return None
    if max(e.remaining - LEAVES, there.left - LEAVES) <= 0:
        return None
    amplitude, speed = conditions_of(e.ground.observations[0], other)
    if not amplitude or speed or change_between(e, other) < PROVEN:
        return None
    words = " and ".join(map(in_words, effects))
    return f"the gap is another one at another amplitude, and {words} does not change with it"
