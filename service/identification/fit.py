"""The identification of a rig: from an experiment and a datasheet to a commissioning result."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.experiment.dead import require_live_channels
from service.experiment.incomplete import incomplete
from service.experiment.resting import held_at, load_in_words, resting_current
from service.experiment.stated import stated_amplitudes
from service.experiment.units import must_be_in_si, odd_rotor, odd_stiffness
from service.identification.amplifier_fit import AmplifierFit, amplifier_fits
from service.identification.assemble import assemble
from service.identification.block_length import block_samples
from service.identification.coupling import cross_planes
from service.identification.coupling import told as told_coupling
from service.identification.etfe import FrequencyResponse, etfe
from service.identification.known import led_back
from service.identification.logged import checked
from service.identification.plane_model import Known, Layout, PlaneModel
from service.identification.points import PlanePoints, check_excitation, plane_points, planes_of
from service.identification.residuals import Data
from service.identification.result import CommissioningResult, PlaneResult
from service.identification.rotating import turned
from service.identification.selection import Selected, choose_modes
from service.identification.split import Knowledge
from service.identification.staged import StagedFit, staged_fit
from service.identification.start import joint_start
from service.identification.sweeps import chosen_sweeps
from service.identification.tolerances import Tolerances
from service.identification.transient import LASTING, Transient, settled, told
from service.identification.zoh import Real
from sim.chain import Chain
from sim.datasheet import Datasheet
from sim.errors import AmbError
from sim.folded import folded
from sim.twin import rig_from_datasheet

END_SLOPE = 4.0
"""Change of the first mode's shape towards a free shaft's end, in largest values at bearings and sensors per bearing
span. A uniform beam's slope at its end is 4.65 per length (Blevins, Formulas for Natural Frequency and Mode Shape,
table 8-1) of the value there; over the usual 0.7 to 0.85 of it, and of the smaller values within, it is 4 to 6, less
where discs bend the shape."""


FITS = 0.7
"""Share of a plane's time that its fits take; the rest are the figures with their deviations."""


@dataclass(frozen=True)
class Options:
    """How to identify. The defaults need no thought."""

    closeness: bool = True
    """Whether a mode's shape is taken to change little from a bearing to its sensor (`split.Knowledge`)."""
    datasheet_modes: bool = True
    """Whether the datasheet's modes, where it has any, tell how shapes split between bearings and sensors. Nothing else
    of them is used."""
    priors: bool = False
    """Whether the datasheet's values count as priors, as wide as its tolerances (`tolerances.Tolerances`). By default
    its ki, ks, amplifiers and modes are not trusted at all."""


def identify(
    experiment: Experiment,
    datasheet: Datasheet,
    options: Options | None = None,
    progress: Callable[[float], None] | None = None,
) -> CommissioningResult:
    """Identify every plane of a rig that the experiment excites.

    Parameters
    ----------
    experiment
        The main sweep is fitted, with others that excite axes which it does not; one with comment "amplifier" helps
        with the amplifiers; the first other one is kept for cross-validation and no step of any fit sees it.
    datasheet
        Geometry, mass properties, bias current, controller; its ki, ks, amplifiers and modes are not trusted unless
        ``options`` ask for them as priors. Effects that it names are part of the model as far as that can have them
        (`sim.folded`), and the result says which.
    progress
        Told the fraction that is done, after the fits and after the figures of every plane.

    Raises
    ------
    AmbError
        Data that cannot be identified: one line that names what is missing and the remedy.
    """
    options = options or Options()
    twin = folded(datasheet)
    datasheet = twin.datasheet
    if tuple(experiment.axes) != tuple(datasheet.axes):
        raise AmbError(
            f"the experiment has axes {', '.join(experiment.axes)} and the datasheet {', '.join(datasheet.axes)}; "
            "give the datasheet of the rig that was measured"
        )
    must_be_in_si(experiment, datasheet)
    doubts = incomplete(experiment) + odd_rotor(datasheet) + stated_amplitudes(experiment)
    log = checked(experiment, datasheet, twin.chain)
    experiment = led_back(log.experiment, log.chain)
    chosen = chosen_sweeps(experiment)
    require_live_channels(chosen.main.sweep, tuple(experiment.axes), chosen.main.name)
    main, speeds = chosen.main.sweep, chosen.speeds_rad_s
    amplifier_sweep = None if chosen.amplifier is None else chosen.amplifier.sweep
    validation = None if chosen.validation is None else chosen.validation.sweep

    warnings = [sentence for e in twin.effects for sentence in e.sentences()]
    warnings += [*doubts, *log.warnings, *chosen.notes]
    rig = rig_from_datasheet(datasheet)
    if (resting := resting_current(main, rig)) is not None:
        warnings.append(f"{load_in_words(held_at(rig, resting), rig)}: what is identified is under this load")
    if main.speed_rad_s:
        remedy = "" if len(speeds) > 1 else "; a sweep at standstill, or at another speed, tells more"
        warnings.append(
            f"planes measured at {main.speed_rad_s:.4g} rad/s: gyroscopic coupling is not in their models{remedy}"
        )
    if validation is None:
        warnings.append("no sweep is left for cross-validation: the fit is judged on the data that it was made from")
    found: dict[str, FittedPlane] = {}
    say = progress or (lambda fraction: None)
    pairs = planes_of(tuple(experiment.axes))
    steps = len(pairs) + any(speeds)
    for k, (plane, pair) in enumerate(pairs.items()):
        if not np.any(np.isin(main.axis, pair) & (main.amplitude_a > 0)):
            warnings.append(f"plane {plane} is not excited in {chosen.main.name} and not identified")
            continue
        try:
            found[plane] = fit_plane(
                main, amplifier_sweep, validation, tuple(experiment.axes), plane, datasheet, options, twin.chain
            )
        except AmbError as error:
            if not (odd := odd_rotor(datasheet)):
                raise
            raise AmbError(f"{odd[0]} The fit ended with: {error}") from error
        say((k + 1) * FITS / steps)
    if validation is not None and all(f.held_out is None for f in found.values()):
        warnings.append(
            "the sweep that was left for cross-validation cannot be used (blocks or points too few): the fit is judged "
            "on the data that it was made from"
        )
    found = _settled_alike(found, main, tuple(experiment.axes), datasheet, options)
    planes = {}
    for k, (plane, f) in enumerate(found.items()):
        planes[plane] = f.result(datasheet)
        say((len(pairs) * FITS + (k + 1) * (1 - FITS)) / steps)
    fitted = {plane: f.selected for plane, f in found.items()}
    if not planes:
        raise AmbError("no plane of the rig is excited on both of its axes; excite xA and xB, one after the other")
    of = {name: [p.stiffness[name + end] for p in planes.values() for end in "AB"] for name in ("ki", "ks")}
    ratios = {name: np.array([e.value / e.nominal for e in estimates if e.nominal]) for name, estimates in of.items()}
    warnings = odd_stiffness({name: x[x > 0] for name, x in ratios.items()}) + warnings
    across = () if main.speed_rad_s else cross_planes(main, tuple(experiment.axes))
    warnings += [told_coupling(c) for c in across if c.coupled]
    rotating = None
    if any(speeds):
        try:
            rotating = turned(experiment, datasheet, fitted, main.speed_rad_s)
            warnings += [f"rotating: {w}" for w in rotating.warnings]
        except AmbError as error:  # the planes' results stand
            warnings.append(f"measured at speed, but the rotating model was not fitted: {error}")
    return CommissioningResult(
        datasheet.name,
        tuple(experiment.axes),
        planes,
        chosen.main.name,
        None if chosen.validation is None else chosen.validation.name,
        float(main.speed_rad_s),
        tuple(warnings),
        rotating=rotating,
        cross_planes=across,
        known_effects=twin.effects,
    )


@dataclass(frozen=True)
class FittedPlane:
    """One plane after all its fits, and what they were made from."""

    data: Data
    held_out: PlanePoints | None
    u_to_y: FrequencyResponse
    plant: FrequencyResponse
    amplifiers: tuple[AmplifierFit, AmplifierFit] | None
    staged: StagedFit
    selected: Selected
    transients: tuple[Transient, ...] = ()
    """What rang in the points and was taken out."""
    measured: PlanePoints | None = None
    """The points before, where anything was."""

    def result(self, datasheet: Datasheet) -> PlaneResult:
        """Figures with uncertainty, validation, curves."""
        found = assemble(
            datasheet,
            self.data,
            self.held_out,
            self.u_to_y,
            self.plant,
            self.amplifiers,
            self.staged,
            self.selected,
        )
        more = [told(t) for t in self.transients if t.left > LASTING]
        if self.data.prior is not None:
            more += self.data.prior.strained(found.model)
        return replace(found, warnings=(*found.warnings, *more))


def fit_plane(
    main: Sweep,
    amplifier_sweep: Sweep | None,
    validation: Sweep | None,
    axes: tuple[str, ...],
    plane: str,
    datasheet: Datasheet,
    options: Options | None = None,
    chain: Chain | None = None,
) -> FittedPlane:
    """Identify one plane: the six steps, then the joint refinement.

    ``chain``: what is known of the axes beside the datasheet; the sweeps are led back to where the model begins
    (`known.led_back`).
    """
    options = options or Options()
    own = Chain() if chain is None else chain.of(list(planes_of(axes)[plane]))
    points = plane_points(main, axes, plane)
    check_excitation(points)
    told = Tolerances.of(datasheet, points.axes)
    prior = told if options.priors else told.of_amplifiers() if points.I is None else None
    data = Data(points, _amplifier_points(amplifier_sweep, axes, plane), prior)
    found = _fit_points(data, datasheet, axes, options, own)
    found = _settled(found, main, axes, datasheet, options, _block_s(main, points))
    held_out = None
    if validation is not None:
        with suppress(AmbError):  # what cannot be used checks nothing, and costs nothing
            held_out = plane_points(validation, axes, plane)
    if held_out is not None and len(held_out.omega) == 0:
        held_out = None
    return replace(found, held_out=held_out)


def _settled(
    found: FittedPlane,
    main: Sweep,
    axes: tuple[str, ...],
    datasheet: Datasheet,
    options: Options,
    block_s: Real | float | None,
    suspected: bool = False,
) -> FittedPlane:
    """The plane fitted once more without what was still ringing, where anything was; the last two: see `settled`."""
    if main.kind != "stepped-sine" or main.speed_rad_s:
        return found
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    refined = found.selected.refined
    measured = found.measured or found.data.plant
    data, transients = settled(
        replace(found.data, plant=measured), refined.model, refined.fit.free, controller, block_s, suspected
    )
    if data.plant is measured or (refined.relative and not transients):
        return found  # what noise alone kept up is not worth a further fit of a model that does not explain the data
    again = _fit_points(data, datasheet, axes, options, refined.model.known.chain, found.selected)
    return replace(again, held_out=found.held_out, transients=transients, measured=measured)


def _settled_alike(
    found: dict[str, FittedPlane], main: Sweep, axes: tuple[str, ...], datasheet: Datasheet, options: Options
) -> dict[str, FittedPlane]:
    """Planes in which no start still rang, looked at again where one did in another: they were recorded alike.

    With the length of blocks that the other's told, and asked for less evidence than by themselves.
    """
    shown = [t for f in found.values() for t in f.transients]
    if not shown:
        return found
    loudest = max(shown, key=lambda t: t.evidence)
    out = {}
    for plane, f in found.items():
        told = _block_s(main, f.data.plant)
        block_s = loudest.block_s if told is None else told
        out[plane] = f if f.transients else _settled(f, main, axes, datasheet, options, block_s, suspected=True)
    return out


def _block_s(main: Sweep, points: PlanePoints) -> Real | None:
    """Length of each point's blocks, (P,) s, where file or lines tell it."""
    samples = block_samples(main)
    return None if samples is None else samples[points.index] / main.sample_rate_hz


def _fit_points(
    data: Data,
    datasheet: Datasheet,
    axes: tuple[str, ...],
    options: Options,
    chain: Chain,
    before: Selected | None = None,
) -> FittedPlane:
    """The six steps and the joint refinement; ``before`` is what was chosen with what still rang in the points."""
    points = data.plant
    u_to_y = etfe(points, "u->y")
    start, fits = start_model(datasheet, points.plane, axes, data, chain)
    gain = start.amplifier_response(u_to_y.omega)
    plant = FrequencyResponse(u_to_y.omega, u_to_y.value / gain[:, None, :], u_to_y.std / np.abs(gain)[:, None, :])
    staged = staged_fit(start, points, plant)
    knowledge = replace(split_knowledge(datasheet, options), end_rad_s=float(points.omega.max()))
    begin = joint_start(staged.rigid_model, staged.rational, points, plant)
    selected = choose_modes(begin, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge, before)
    return FittedPlane(data, None, u_to_y, plant, fits, staged, selected)


def split_knowledge(datasheet: Datasheet, options: Options) -> Knowledge:
    """What the datasheet tells of the modes' splits."""
    (a, b), (sa, sb) = datasheet.bearing_from_cog_m, datasheet.sensor_from_cog_m
    scale = float(np.clip(END_SLOPE * 0.5 * (abs(sa - a) + abs(sb - b)) / (a + b), 0.05, 0.5))
    modes = datasheet.modes if options.datasheet_modes else ()
    modes = tuple(m for m in modes if any(m.shape_at_bearings) and any(m.shape_at_sensors))
    ratios = [np.log(np.linalg.norm(m.shape_at_sensors) / np.linalg.norm(m.shape_at_bearings)) for m in modes]
    return Knowledge(
        scale if options.closeness else None,
        (sa > a, sb > b),
        2 * np.pi * np.array([m.frequency_hz for m in modes]),
        np.array(ratios),
        float(np.hypot(1.0, 1.0) * datasheet.tolerance.mode_shape),
    )


def _amplifier_points(sweep: Sweep | None, axes: tuple[str, ...], plane: str) -> PlanePoints | None:
    if sweep is None or sweep.I is None:
        return None
    points = plane_points(sweep, axes, plane)
    return points if len(points.omega) else None


def start_model(
    datasheet: Datasheet, plane: str, axes: tuple[str, ...], data: Data, chain: Chain | None = None
) -> tuple[PlaneModel, tuple[AmplifierFit, AmplifierFit] | None]:
    """Plane with the datasheet's values, and amplifiers fitted where currents are logged (step 3).

    ``chain``: what else is known of the plane.
    """
    pair = list(planes_of(axes)[plane])
    nominal = [_nominal_amplifier(datasheet, k) for k in pair]
    fits = None
    parameters, delay = nominal, 0.0
    if data.plant.I is not None:
        sets = [data.plant] + ([data.amplifier] if data.amplifier is not None else [])
        fits = amplifier_fits(sets, (nominal[0], nominal[1]), datasheet.sample_time_s, datasheet.computing_delay_s)
        parameters = [f.parameters for f in fits]
        delay = float(np.mean([f.delay_s for f in fits]))
    known = known_of(datasheet, plane, axes, chain)
    orders = (len(parameters[0]) - 1, len(parameters[1]) - 1)
    theta = np.concatenate(
        [
            [datasheet.current_stiffness_n_per_a[k] for k in pair],
            [datasheet.position_stiffness_n_per_m[k] for k in pair],
            *parameters,
            [delay],
            [datasheet.mass_kg, datasheet.transverse_inertia_kgm2, 0.0],
            [datasheet.sensor_gain[k] for k in pair],
        ]
    )
    return PlaneModel(known, Layout(orders), theta), fits


def known_of(datasheet: Datasheet, plane: str, axes: tuple[str, ...], chain: Chain | None = None) -> Known:
    """What the datasheet tells of a plane and no fit changes, with the plane's ``chain`` of known blocks."""
    pair = list(planes_of(axes)[plane])
    bandwidth = datasheet.sensor_bandwidth_hz
    return Known(
        datasheet.bearing_from_cog_m,
        datasheet.sensor_from_cog_m,
        np.array([datasheet.bias_current_a[k] for k in pair]),
        datasheet.sample_time_s,
        datasheet.computing_delay_s,
        np.full(2, np.inf) if bandwidth is None else 2 * np.pi * np.array([bandwidth[k] for k in pair]),
        Chain() if chain is None else chain,
    )


def _nominal_amplifier(datasheet: Datasheet, axis: int) -> tuple[float, ...]:
    w = 2 * np.pi * datasheet.amplifier_natural_frequency_hz[axis]
    gain = datasheet.amplifier_gain[axis]
    if datasheet.amplifier_damping_ratio is None:
        return (gain, w)
    return (gain, w, datasheet.amplifier_damping_ratio[axis])
