"""Which rig a device simulates: a datasheet or the reference rig, effects, noise and a seed; or a withheld case."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drivers.device.withheld import datasheet_beside, sealed_in
from sim import rig_file
from sim.effects import effect
from sim.errors import EffectError, OptionsError
from sim.reference import reference_rig
from sim.rig import Noise, Rig
from sim.stepping import Simulation
from sim.withheld import CAMPAIGN_S
from sim.withheld.given import Given
from sim.withheld.seal import named_after


@dataclass(frozen=True)
class RigOptions:
    """What is simulated."""

    rig: Path | None = None
    """Datasheet; None for the reference rig, or for one that is drawn with what is withheld."""
    seed: int = 0
    """Of the noise."""
    effects: tuple[str, ...] = ()
    """Each ``id``, ``id=value`` of its first parameter, or ``id:name=value,name=value``."""
    withheld: int | None = None
    """Seed of a case of the blind trial, drawn and told to no one but the sealed file."""
    sealed: Path = Path("withheld.json")
    campaign_s: float = CAMPAIGN_S
    """Rig time that a campaign on the withheld case will take, for a law that sets in on the way."""
    noise: bool = True
    gravity_m_per_s2: float | None = None
    speed_rad_s: float | None = None


@dataclass(frozen=True)
class BuiltRig:
    """A rig, its simulation, and what may be known of what was withheld in it."""

    rig: Rig
    simulation: Simulation
    commitment: str = ""
    """SHA-256 of nonce and truth, as `sim.withheld.seal` has it; empty when nothing is withheld."""
    datasheet: Path | None = None
    """What to know before the experiment; None when nothing is withheld."""

    @property
    def identity(self) -> str | None:
        """What the device calls itself, so that an experiment tells which sealed truth it is of; None: as any rig."""
        return f"{named_after(self.commitment)}, simulated rig {self.rig.name}" if self.commitment else None


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
    """The rig of these options; writes the sealed file, and the datasheet of a drawn rig, when a case is withheld.

    Raises
    ------
    DatasheetError, EffectError, LevitationError
        As their messages say.
    OptionsError
        Options that a withheld case has no use for.
    AmbError
        A file that cannot be written.
    """
    given = _given(options)
    if options.withheld is not None:
        return _withheld(options, options.withheld, given)
    if given is not None:
        rig = given.rig()
    else:
        noise = None if options.noise else Noise()
        rig = reference_rig(options.speed_rad_s or 0.0, options.gravity_m_per_s2 or 0.0, noise)
    for text in options.effects:
        name, values = parse_effect(text)
        rig = effect(name).on(rig, **values)
    return BuiltRig(rig, Simulation(rig, options.seed))


def _given(options: RigOptions) -> Given | None:
    if options.rig is None:
        return None
    sheet, gravity, speed = rig_file.read(options.rig), options.gravity_m_per_s2, options.speed_rad_s
    return Given(sheet, options.noise, gravity or 0.0, speed or 0.0)


def _withheld(options: RigOptions, seed: int, given: Given | None) -> BuiltRig:
    """The case of that number in the trial of that seed: kinds come in the trial's shares as seeds go on."""
    from sim.withheld.case import draw  # it takes half a second that no other rig needs

    if options.effects:
        raise OptionsError(
            "an effect beside a withheld case would be taken for one: write it into the datasheet of --rig"
        )
    if given is None and (not options.noise or (options.gravity_m_per_s2, options.speed_rad_s) != (None, None)):
        raise OptionsError(
            "a withheld case draws noise, gravity and speed with its rig: give --rig, too, to choose them"
        )
    case = draw(seed, seed, given)
    commitment = sealed_in(options.sealed, case)
    datasheet = options.rig or datasheet_beside(options.sealed, case)
    return BuiltRig(case.rig, case.simulation(options.seed, options.campaign_s), commitment, datasheet)
