"""Which amplitudes of a tone a controller's map can carry: a vendor's own may have coarser steps than ours."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.device.lockin import AMPLITUDE_STEPS_PER_A
from drivers.objects import Object
from drivers.packing import INTEGERS


@dataclass(frozen=True)
class Amplitudes:
    """Amplitudes that a map carries in both ways, to the controller and back with its result."""

    steps_per_a: int = AMPLITUDE_STEPS_PER_A
    largest_a: float = math.inf

    def carried(self, amplitude_a: float) -> float:
        """The amplitude that is played where this one is wanted, A: towards zero; where steps are fine, as it is.

        >>> Amplitudes(1000).carried(0.1239), Amplitudes(1000).carried(0.3), Amplitudes().carried(0.1234567)
        (0.123, 0.3, 0.1234567)
        """
        if self.steps_per_a >= AMPLITUDE_STEPS_PER_A or not math.isfinite(amplitude_a):
            return amplitude_a
        steps = round(amplitude_a * self.steps_per_a)
        return (steps - int(steps / self.steps_per_a > amplitude_a)) / self.steps_per_a


def amplitudes(objects: Iterable[Object]) -> Amplitudes:
    """What the objects that carry an amplitude have in common; a float carries whole microamperes.

    >>> from dataclasses import replace
    >>> from drivers.objects import RESULT, TONE, Type
    >>> ours = (TONE["amplitude_a"], RESULT["amplitude_a"])
    >>> amplitudes(ours), amplitudes(replace(o, type=Type.U16, per_unit=1000) for o in ours)
    (Amplitudes(steps_per_a=1000000, largest_a=4294.967295), Amplitudes(steps_per_a=1000, largest_a=65.535))
    """
    whole = [o for o in objects if o.type in INTEGERS]
    steps = math.gcd(*(o.per_unit for o in whole)) or AMPLITUDE_STEPS_PER_A
    largest = min((INTEGERS[o.type][1] / o.per_unit for o in whole), default=math.inf)
    return Amplitudes(min(steps, AMPLITUDE_STEPS_PER_A), largest)
