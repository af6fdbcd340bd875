"""Whether the datasheet is of another rig, as its values would be off by more than its tolerances allow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.verdict import LEAVES, MIXTURE_SHARE, SURE_OF_NONE, WHOLE_OF_ANOTHER_LAW, Verdict
from sim.wording import in_words

IMPLAUSIBLE = 5.0
"""Deviate of the nuisance values' penalty, as a chi-square, from which they are off beyond chance."""
RESONANCES = ("extra_flexible_mode", "support_resonance")
BELOW = 1.001
"""Share of the lowest line's frequency up to which a resonance lies below every line."""
HOPELESS = 0.35
"""Share of the nuisance values at their bounds from which no further effects are searched for, if every explanation has
it. The smallest of all explanations' shares was at most 0.03 on rigs with two gross effects, and 0.4 to 0.65 with
datasheets of other rotors."""


SET_THE_SCALE = frozenset({"magnetic_saturation", "magnetic_hysteresis", "touchdown_contact"})
"""Nonlinear effects beside which no error of the datasheet is named, nor another rig's datasheet where they explain
nearly all. The current or displacement at which their law bends gives the scale of masses and gains, which are aliases
of the magnets' stiffnesses else: an error of the law would be theirs."""
DRAWING = SET_THE_SCALE | {"amplifier_voltage_limit"}
"""Effects of which the error of a law may draw the datasheet's values off: a voltage that ends in real coils, with the
windup of their current controllers, drew amplifiers' frequencies by four tolerances where it explained 99 %."""
STRANGE = 0.03
"""Relative gap from which such a datasheet is said to be another rig's: with those of other rotors it was 0.09 to 0.17.
With a smaller gap the values are biased by something in this rig that no effect describes."""


def at_bound(fit: Fit) -> NDArray[np.bool_]:
    """Which of the nuisance values fitted are at their bounds, (a,)."""
    return np.asarray(np.abs(fit.theta[fit.active]) > 0.999 * TOLERANCE_BOUND)


def hopeless(ground: Ground, fits: Iterable[Fit]) -> bool:
    """Whether every explanation has so many nuisance values at their bounds that no further effect would help."""
    own = len(ground.part.active)
    return own > 0 and all(int(at_bound(fit)[:own].sum()) >= HOPELESS * own for fit in fits)


def far_off(ground: Ground, fit: Fit) -> str | None:
    """The datasheet's values that are farthest off, in words, where all together are off beyond chance; else None."""
    own, names = ground.part.active, ground.nuisance.names
    k, off = len(own), ground.nuisance.price(fit.theta[own])
    if off <= k + IMPLAUSIBLE * np.sqrt(2 * k):
        return None
    away = ground.nuisance.off(fit.theta)
    worst = sorted(own, key=lambda j: -abs(fit.theta[j]))[:3]
    values = ", ".join(f"{in_words(names[j])} by {away[j]:+z.1f}" for j in worst)
    return f"its values would be off, or apart where they are alike in a rig, by many tolerances ({values})"


def drawn_by_its_law(best: Ranked, remaining: float) -> bool:
    """Whether the error of an effect's law may have drawn the datasheet's values off.

    The effect explains nearly all of a gap so large that the rest is far beyond noise, as of a stop with damping and
    friction: beside that rest the tolerances hardly count. Or it leaves a hundredth of the gap, with what the values
    bear: as of a voltage that ends in real coils beside slower amplifiers, whose frequencies were drawn off by three
    tolerances. ``remaining`` is the significance of what is left.
    """
    bends = not DRAWING.isdisjoint(best.candidate.effects)
    allowed = MIXTURE_SHARE if remaining > LEAVES else WHOLE_OF_ANOTHER_LAW
    return bends and best.unexplained <= allowed


def free_body(ground: Ground, fit: Fit) -> str | None:
    """What a resonance that explains a part is, in words, where it is another body of the rotor and no resonance.

    Far below every line a resonance answers as a free body does beside the rotor, and a fit that takes it to the
    lowest frequency that it may have wants such a body: what is off is the mass or the inertia, by more than the
    effect of that name may be.
    """
    lowest_hz = min(float(o.frequency_hz.min()) for o in ground.observations)
    for name, values in zip(fit.effects, fit.values, strict=True):
        hz = values.get("frequency_hz")
        if name in RESONANCES and hz is not None and fit.ends.get((name, "frequency_hz")) == "low":
            if hz > BELOW * lowest_hz:
                continue
            return (
                f"what explains it best, {in_words(name)} at {hz:.3g} Hz or less and so below every line, is a rotor "
                "of another mass_kg or transverse_inertia_kgm2"
            )
    return None


def with_datasheet_off(verdict: Verdict, away: str, relative_gap: float) -> Verdict:
    """The verdict on a part whose datasheet would be off beyond chance; ``away`` says by what (`far_off`).

    ``relative_gap`` is that of the plain twin, over the part's output.
    """
    if relative_gap >= STRANGE and not verdict.nonlinear:
        reason = (
            f"the datasheet seems to be of another rig, or a law that no effect has acts in this one; {away}: check it"
        )
        return Verdict("none_of_these", (), (), SURE_OF_NONE, (reason,), another_rig=True)
    if not verdict.effects:
        return replace(verdict, reasons=(*verdict.reasons, f"beside that, {away}: check the datasheet"))
    words = " and ".join(map(in_words, verdict.effects))
    reason = f"the best explanation, {words}, holds only with a datasheet that is not this rig's; {away}"
    return Verdict("none_of_these", (), (), SURE_OF_NONE, (reason,))
