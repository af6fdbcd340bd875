"""Which rig a device simulates: a datasheet or the reference rig, with effects, noise and a seed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from drivers.device.withheld import draw, seal
from sim import rig_file, twin
from sim.effects import effect
from sim.errors import EffectError
from sim.reference import reference_rig
from sim.rig import Noise, Rig


@dataclass(frozen=True)
class RigOptions:
    """What is simulated."""

    rig: Path | None = None
    """Datasheet; None for the reference rig."""
    seed: int = 0
    effects: tuple[str, ...] = ()
    """Each ``id``, ``id=value`` of its first parameter, or ``id:name=value,name=value``."""
    withheld: int | None = None
    """Seed of an effect that is drawn and told to no one but the sealed file."""
    sealed: Path = Path("withheld.json")
    noise: bool = True
    gravity_m_per_s2: float | None = None
    speed_rad_s: float | None = None


@dataclass(frozen=True)
class BuiltRig:
    """A rig, and the commitment to what was withheld in it."""

    rig: Rig
    commitment: str = ""
    """SHA-256 of the sealed file's content; empty when nothing is withheld."""


def parse_effect(text: str) -> tuple[str, dict[str, float]]:
    """Id and values of ``loop_delay``, ``loop_delay=35e-6`` or ``loop_delay:delay_s=35e-6``.

    >>> parse_effect("loop_delay=35e-6")
    ('loop_delay', {'delay_s': 3.5e-05})

    Raises
    ------
    EffectError
        An unknown effect, or text that is not a number.
    """
    name, colon, pairs = text.partition(":")
    if not colon:
        name, equals, value = text.partition("=")
        pairs = f"{effect(name).parameters[0].name}={value}" if equals else ""
    known = effect(name)
    values = {}
    for pair in filter(None, pairs.split(",")):
        parameter, _, value = pair.partition("=")
        try:
            values[parameter] = float(value)
        except ValueError:
            raise EffectError(
                f"cannot read the effect {text!r}: {parameter} needs a number; write {known.id}:{parameter}=1.0"
            ) from None
    return known.id, values


def build_rig(options: RigOptions) -> BuiltRig:
    """The rig of these options; writes the sealed file when an effect is withheld.

    Raises
    ------
    DatasheetError, EffectError
        As their messages say.
    """
    noise = reference_rig().noise if options.noise else Noise()
    rig = reference_rig() if options.rig is None else twin.rig_from_datasheet(rig_file.read(options.rig))
    rig = replace(rig, noise=noise)
    if options.gravity_m_per_s2 is not None:
        rig = replace(rig, gravity_m_per_s2=options.gravity_m_per_s2)
    if options.speed_rad_s is not None:
        rig = replace(rig, speed_rad_s=options.speed_rad_s)
    for text in options.effects:
        name, values = parse_effect(text)
        rig = effect(name).on(rig, **values)
    if options.withheld is None:
        return BuiltRig(rig)
    drawn = draw(rig, options.withheld)
    return BuiltRig(drawn.on(rig), seal(drawn, options.sealed))
