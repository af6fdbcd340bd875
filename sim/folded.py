"""A twin's effects folded into its datasheet, as far as a model of linear planes can carry them.

The identification models each plane by a datasheet's values and a chain of known blocks. What an effect changes of the
rig is compared field by field: a field that those two can carry is put there; of every other one it is told why it is
not in the model and what that means. So an effect that is new in the catalogue is folded, or told, never dropped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from sim import actuator
from sim.chain import Chain
from sim.datasheet import Datasheet, Mode
from sim.rig import Rig
from sim.twin import rig_from_datasheet, with_effects

IN_MODEL = {
    "amplifiers.delay_s": "its delay, the mean of the axes, counts as computing delay: the identified delay is what "
    "comes beyond it",
    "amplifiers.lag_s": "its further lag is divided out of the logged currents and counted in the loop: identified "
    "amplifiers are without it",
    "amplifiers.natural_frequency_rad_s": "its amplifiers are where the search starts, and what priors say",
    "amplifiers.damping_ratio": "its amplifiers are where the search starts, and what priors say",
    "amplifiers.gain": "its amplifiers are where the search starts, and what priors say",
    "amplifiers.crosstalk": "it is divided out of the logged control signals and counted in the loop: identified "
    "amplifiers are without it",
    "controller.numerator": "margins and the predicted loop are those of the controller with it",
    "controller.denominator": "margins and the predicted loop are those of the controller with it",
    "logging_offset_samples": "logged control signals are moved to where they belong in time",
    "magnets.eddy_time_constant_s": "ki, poles, zeros and state space of the plant are per flux-making current, behind "
    "the eddy currents; responses from u, margins and the predicted loop include them",
    "magnets.eddy_corner_rad_s": "ki, poles, zeros and state space of the plant are per flux-making current, behind "
    "the eddy currents; responses from u, margins and the predicted loop include them",
    "magnets.eddy_free_share": "ki, poles, zeros and state space of the plant are per flux-making current, behind "
    "the eddy currents; responses from u, margins and the predicted loop include them",
    "magnets.offset_m": "nominal ki and ks are those at its offset",
    "magnets.flux_share": "nominal ki and ks are those of its iron at small currents",
    "magnets.ki": "nominal ki and ks are with it",
    "magnets.ks": "nominal ki and ks are with it",
    "sensors.gain": "displacements are read with its gains",
    "sensors.lag_s": "its lag is part of the sensors, which are held fixed",
    "sensors.delay_s": "its dead time is part of the sensors, which are held fixed",
    "sensors.bandwidth_rad_s": "its lag is part of the sensors, which are held fixed",
    "rotor.mass_kg": "mass and inertia are held at its values",
    "rotor.transverse_inertia_kgm2": "mass and inertia are held at its values",
    "rotor.polar_inertia_kgm2": "a model of several speeds starts from its polar inertia and identifies it",
    "rotor.bearing_from_cog_m": "geometry is held as it says",
    "rotor.sensor_from_cog_m": "geometry is held as it says",
    "rotor.modes.internal_damping_ratio": "at standstill it is damping like any other, of which the nominal modes "
    "have it; a model of several speeds identifies what turns with the rotor",
    "rotor.modes": "the nominal modes are with it; modes are identified whatever the datasheet says",
    "rotor.modes.gyroscopic": "a model of several speeds identifies it with the modes",
    "support": "a housing acts as a mode that moves bearings and sensors alike: it is among the nominal modes, and "
    "among those identified",
}
"""What an effect changes of a rig, where the identification's model carries it, and what its figures then mean."""

_SMALL = (
    "it acts by amplitude, and the model's {what} is linear: {figures} are means over the amplitudes that were measured"
)
_SEAL_DAMPS = (
    "its damping acts at the bearings, and the model has that of modes alone: their damping ratios are with it, and "
    "the margins without what it adds to the rigid body's"
)
NOT_IN_MODEL = {
    "controller.apart": "the model has one controller for all axes: margins and the predicted loop are those of its "
    "mean",
    "rotor.discs": "its disc couples tilts and modes with one another, and a model of several speeds couples each with "
    "its own copy in the other plane alone",
    "rotor.gyroscopic_between": "it couples modes with others, and a model of several speeds couples each with its own "
    "copy in the other plane alone",
    "amplifiers.slew_limit_a_per_s": _SMALL.format(what="amplifier", figures="amplifiers and delay"),
    "amplifiers.slope_noise_share": _SMALL.format(what="amplifier", figures="amplifiers and delay"),
    "amplifiers.slew_seen": _SMALL.format(what="amplifier", figures="amplifiers and delay"),
    "magnets.saturation_current_a": _SMALL.format(what="iron", figures="ki and ks"),
    "magnets.flux_share": _SMALL.format(what="iron", figures="ki and ks"),
    "magnets.flux_power": _SMALL.format(what="iron", figures="ki and ks"),
    "magnets.hysteresis_rad": _SMALL.format(what="iron", figures="ki, ks and the delay"),
    "magnets.hysteresis_narrowest_a": _SMALL.format(what="iron", figures="ki, ks and the delay"),
    "magnets.hysteresis_widest_inverse_per_a": _SMALL.format(what="iron", figures="ki, ks and the delay"),
    "magnets.hysteresis_density": _SMALL.format(what="iron", figures="ki, ks and the delay"),
    "magnets.hysteresis_displacement_share": _SMALL.format(what="iron", figures="ki, ks and the delay"),
    "magnets.hysteresis_reference_a": _SMALL.format(what="iron", figures="ki, ks and the delay"),
    "magnets.offset_m": "the even harmonics of its offset are not in the model, and the third-order terms of the force "
    "are a centred rotor's: nothing at small displacements",
    "magnets.cross_coupling_rad": "it couples the planes, which are identified one by one: ki and ks are what acts "
    "within a plane, and the margins those of planes by themselves",
    "magnets.cross_coupling_symmetric": "it couples the planes, which are identified one by one: ki and ks are what "
    "acts within a plane, and the margins those of planes by themselves",
    "magnets.eddy_displacement_share": "the model's position stiffness is a spring, which does not lag: ki and ks are "
    "means over the frequencies that were measured",
    "magnets.turned_whole": "it couples the planes, which are identified one by one: ki and ks are what acts within a "
    "plane, and the margins those of planes by themselves",
    "seal_cross_stiffness_n_per_m": "it couples the planes, which are identified one by one: the damping that it takes "
    "from a whirl is not in the margins",
    "seal_cross_stiffness_by_speed_ns_per_m": "it couples the planes, which are identified one by one: the damping "
    "that it takes from a whirl is not in the margins",
    "seal_damping_ns_per_m": _SEAL_DAMPS,
    "seal_damping_times_speed_n_per_m": _SEAL_DAMPS,
    "seal_bow_per_sqrt_kg": "it is where modes move the shaft at a seal, which couples the planes: nothing without one",
    "drift": "the model's magnets do not change with time: ki and ks are means over the experiment, and residuals grow "
    "with what they changed meanwhile",
    "contact": "the model's rotor is free: where it touches, ki, ks and damping ratios are wrong; keep displacements "
    "below the clearance",
    "disturbances": "it is not in proportion to the excitation: points at its frequencies are noisier, the figures "
    "hold",
}
"""The same of what no linear model of planes can have: why, and what that means for the figures."""

UNKNOWN = "what it changes of the rig ({field}) is not in the model: figures and margins are those of a rig without it"


@dataclass(frozen=True)
class KnownEffect:
    """An effect that a twin names, and what became of it in the identification's model."""

    effect: str
    parameters: tuple[tuple[str, float], ...]
    in_model: tuple[str, ...]
    """Where the model carries it, and what figures then mean, a clause each; () for nothing of it."""
    not_in_model: tuple[str, ...]
    """Why the model lacks it, and what that means for the figures; () for nothing."""

    def sentences(self) -> tuple[str, ...]:
        """What the model lacks of it, in sentences."""
        return tuple(f"the twin's {self.effect} is not in the model: {clause}" for clause in self.not_in_model)


@dataclass(frozen=True)
class Folded:
    """What a twin says, in terms of a model of linear planes."""

    datasheet: Datasheet
    """Without effects, its values with what they change."""
    chain: Chain
    """Known blocks of all axes."""
    effects: tuple[KnownEffect, ...]


def folded(datasheet: Datasheet) -> Folded:
    """Datasheet and chain with a twin's effects in them, and what is in neither.

    Raises
    ------
    EffectError
        An unknown effect or parameter, or one that this rig cannot have.
    """
    plain = replace(datasheet, effects=())
    rig = bare = rig_from_datasheet(plain)
    effects = []
    for name, parameters in datasheet.effects:
        before, rig = rig, with_effects(rig, {name: dict(parameters)})
        effects.append(_known(name, parameters, before, rig))
    if not effects:
        return Folded(plain, _chain(bare), ())
    return Folded(_with_values(plain, bare, rig), _chain(rig), tuple(effects))


def _known(name: str, parameters: tuple[tuple[str, float], ...], before: Rig, after: Rig) -> KnownEffect:
    changed = list(dict.fromkeys(_changed(before, after)))
    inside = [IN_MODEL[field] for field in changed if field in IN_MODEL]
    outside = [
        NOT_IN_MODEL.get(field, UNKNOWN.format(field=field))
        for field in changed
        if field in NOT_IN_MODEL or field not in IN_MODEL
    ]
    if not changed:
        inside = ["at its parameters it changes nothing"]
    return KnownEffect(name, parameters, tuple(dict.fromkeys(inside)), tuple(dict.fromkeys(outside)))


def _changed(before: Any, after: Any, path: str = "") -> Iterator[str]:
    """Fields of a rig that differ, as "magnets.ki"."""
    for f in fields(before):
        a, b = getattr(before, f.name), getattr(after, f.name)
        name = f"{path}{f.name}"
        if name == "rotor.modes":
            yield from _changed_modes(a, b)
        elif is_dataclass(a) and type(a) is type(b) and not path:
            yield from _changed(a, b, f"{name}.")
        elif not _same(a, b):
            yield name


def _changed_modes(before: Any, after: Any) -> Iterator[str]:
    turning = {"gyroscopic": 0.0, "internal_damping_ratio": 0.0}
    at_rest = [[[replace(m, **turning) for m in plane] for plane in modes] for modes in (before, after)]
    if at_rest[0] != at_rest[1]:
        yield "rotor.modes"
    for name in turning:
        own = [[[v for m in plane if (v := getattr(m, name))] for plane in modes] for modes in (before, after)]
        if own[0] != own[1]:
            yield f"rotor.modes.{name}"


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return bool(np.array_equal(a, b))
    if is_dataclass(a) and type(a) is type(b):
        return all(_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return bool(a == b)


def _chain(rig: Rig) -> Chain:
    amplifiers, magnets, sensors = rig.amplifiers, rig.magnets, rig.sensors
    return Chain(
        crosstalk=amplifiers.crosstalk,
        logging_offset_samples=rig.logging_offset_samples,
        amplifiers=amplifiers if amplifiers.lag_s > 0 else None,
        delay_s=float(np.mean(amplifiers.delay_s)) + rig.controller.computing_delay_s,
        sample_time_s=rig.controller.sample_time_s,
        eddy_time_constant_s=magnets.eddy_time_constant_s,
        eddy_corner_rad_s=magnets.eddy_corner_rad_s,
        eddy_free_share=magnets.eddy_free_share,
        sensor_lag_s=sensors.lag_s,
        sensor_delay_s=sensors.delay_s,
    )


def _with_values(datasheet: Datasheet, bare: Rig, rig: Rig) -> Datasheet:
    """The datasheet with the values of a rig that effects have changed."""
    amplifiers, rotor, law = rig.amplifiers, rig.rotor, rig.controller
    point = actuator.operating_point(rig)
    polar = rotor.whole_polar_inertia_kgm2
    changed_polar = polar != bare.rotor.whole_polar_inertia_kgm2 and polar > 0
    return replace(
        datasheet,
        mass_kg=rotor.mass_kg,
        transverse_inertia_kgm2=rotor.transverse_inertia_kgm2,
        polar_inertia_kgm2=polar if changed_polar else datasheet.polar_inertia_kgm2,
        bearing_from_cog_m=rotor.bearing_from_cog_m,
        sensor_from_cog_m=rotor.sensor_from_cog_m,
        modes=_modes(rig),
        current_stiffness_n_per_a=tuple(point.ki.tolist()),
        position_stiffness_n_per_m=tuple(point.ks.tolist()),
        amplifier_gain=tuple(amplifiers.gain.tolist()),
        amplifier_natural_frequency_hz=tuple((amplifiers.natural_frequency_rad_s / (2 * math.pi)).tolist()),
        amplifier_damping_ratio=None if amplifiers.damping_ratio is None else tuple(amplifiers.damping_ratio.tolist()),
        sensor_gain=tuple(rig.sensors.gain.tolist()),
        sensor_bandwidth_hz=_bandwidth_hz(rig),
        computing_delay_s=law.computing_delay_s + float(np.mean(amplifiers.delay_s)),
        numerator=tuple(np.asarray(law.numerator, dtype=float).tolist()),
        denominator=tuple(np.asarray(law.denominator, dtype=float).tolist()),
    )


def _bandwidth_hz(rig: Rig) -> tuple[float, ...] | None:
    bandwidth = rig.sensors.bandwidth_rad_s / (2 * math.pi)
    return None if np.all(np.isinf(bandwidth)) else tuple(bandwidth.tolist())


def _modes(rig: Rig) -> tuple[Mode, ...]:
    """Modes of one plane by frequency, those of the support among them."""
    modes = [
        Mode(
            m.natural_frequency_rad_s / (2 * math.pi),
            m.damping_ratio + m.internal_damping_ratio,
            m.shape_at_bearings,
            m.shape_at_sensors,
        )
        for m in rig.rotor.modes[0]
    ]
    return tuple(sorted([*modes, *_of_support(rig)], key=lambda m: m.frequency_hz))


def _of_support(rig: Rig) -> list[Mode]:
    """Modes that act as housing and pedestals, the mean of the planes: magnets and sensors see rotor less housing."""
    support = rig.support
    if support is None:
        return []
    share, hz = support.pedestals, support.natural_frequency_rad_s / (2 * math.pi)
    hz *= math.sqrt(support.plane_frequency_ratio)
    damping = support.damping_ratio
    at_a, at_b = (float(np.mean(support.shares[end::2])) if support.shares else 1.0 for end in (0, 1))
    mean = (at_a + at_b) / 2
    of_both = (1 - share) * mean
    lean = (math.sqrt(at_a / mean), math.sqrt(at_b / mean))
    lever, more = float(np.mean(rig.rotor.bearing_from_cog_m)), support.rocking_imbalance
    beyond_a, beyond_b = np.subtract(rig.rotor.sensor_from_cog_m, rig.rotor.bearing_from_cog_m) / lever
    bearings, sensors = (more + 1.0, more - 1.0), (more + 1.0 + float(beyond_a), more - 1.0 - float(beyond_b))
    of_rocking, of_one = damping * support.rocking_damping_quotient, damping * support.damping_quotient
    rocking_hz = hz * support.rocking_frequency_ratio * math.sqrt(support.rocking_plane_quotient)
    parts = (
        (of_both, lean, lean, hz, damping),
        (support.rocking * of_both, bearings, sensors, rocking_hz, of_rocking),
        (share * at_a, (1.0, 0.0), (1.0, 0.0), hz, damping),
        (share * at_b, (0.0, 1.0), (0.0, 1.0), hz * support.frequency_ratio, of_one),
    )
    out = []
    for part, *shapes, own, own_damping in parts:
        if part > 0:
            size = math.sqrt(part / support.mass_kg)
            out.append(Mode(own, own_damping, *((size * a, size * b) for a, b in shapes)))
    return out
