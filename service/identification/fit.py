"""The identification of a rig: from an experiment and a datasheet to a commissioning result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from service.experiment.data import Experiment
from service.experiment.dead import require_live_channels
from service.experiment.incomplete import incomplete
from service.experiment.resting import held_at, load_in_words, resting_current
from service.experiment.speeds import at_standstill, changed_speed
from service.experiment.stated import stated_amplitudes
from service.experiment.units import must_be_in_si, odd_rotor, odd_stiffness
from service.identification.measured.coupling import cross_planes
from service.identification.measured.coupling import told as told_coupling
from service.identification.measured.known import led_back
from service.identification.measured.logged import checked
from service.identification.measured.points import planes_of
from service.identification.measured.sweeps import Chosen, chosen_sweeps, speed_of
from service.identification.options import Options
from service.identification.plane_fit import FittedPlane, fit_plane, settled_alike
from service.identification.priors.given import Given
from service.identification.priors.tolerances import Tolerances
from service.identification.result.commissioning import CommissioningResult, PlaneResult
from service.identification.rotating.turned import turned
from service.identification.within_tolerances import Within, within_tolerances
from sim.chain import Chain
from sim.datasheet import ASSUMED, Datasheet
from sim.errors import AmbError
from sim.folded import Folded, folded
from sim.twin import rig_from_datasheet

FITS = 0.7
"""Share of a plane's time that its fits take; the rest are the figures with their deviations."""

Progress = Callable[[float], None]


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
    options, say, twin = options or Options(), progress or (lambda fraction: None), folded(datasheet)
    prepared = _prepared(experiment, twin)
    within = _fitted_planes(prepared, options, say)
    fitted, doubts = within.planes, list(within.doubts)
    planes = _results(prepared, fitted, say)
    main, of_planes = prepared.chosen.main, {plane: f.selected for plane, f in fitted.items()}
    across = cross_planes(main.sweep, prepared.axes) if at_standstill(main.sweep.speed_rad_s) else ()
    doubts += [told_coupling(c) for c in across if c.coupled]
    rotating, of_speed = None, []
    if any(prepared.chosen.speeds_rad_s):
        try:
            at = speed_of(main.sweep)
            rotating = turned(prepared.experiment, prepared.datasheet, of_planes, at, within.rotor)
            of_speed = [f"rotating: {w}" for w in rotating.warnings]
        except AmbError as error:  # the planes' results stand
            of_speed = [f"measured at speed, but the rotating model was not fitted: {error}"]
    validation = prepared.chosen.validation
    return CommissioningResult(
        prepared.datasheet.name,
        prepared.axes,
        planes,
        main.name,
        None if validation is None else validation.name,
        float(main.sweep.speed_rad_s),
        # the rotor first: with another one's mass or distances no stiffness is the datasheet's
        (*odd_rotor(prepared.datasheet), *_odd_stiffness(planes), *prepared.warnings, *doubts, *of_speed),
        rotating=rotating,
        cross_planes=across,
        known_effects=twin.effects,
        adjusted=within.adjusted,
        controller_differs=prepared.controller_differs,
    )


@dataclass(frozen=True)
class _Prepared:
    """An experiment whose sweeps are chosen and led back to where the model begins, and its doubts in words."""

    experiment: Experiment
    datasheet: Datasheet
    chain: Chain
    """known blocks of the loop that lie between the log and the model"""
    chosen: Chosen
    warnings: tuple[str, ...]
    controller_differs: bool
    """whether the log is not of the datasheet's controller"""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(self.experiment.axes)


def _prepared(experiment: Experiment, twin: Folded) -> _Prepared:
    """The experiment ready to be fitted to its folded datasheet; raises `AmbError` where it cannot be."""
    datasheet = twin.datasheet
    if tuple(experiment.axes) != tuple(datasheet.axes):
        raise AmbError(
            f"the experiment has axes {', '.join(experiment.axes)} and the datasheet {', '.join(datasheet.axes)}; "
            "give the datasheet of the rig that was measured"
        )
    must_be_in_si(experiment, datasheet)
    doubts = incomplete(experiment) + changed_speed(experiment) + stated_amplitudes(experiment)
    log = checked(experiment, datasheet, twin.chain)
    experiment = led_back(log.experiment, log.chain)
    chosen = chosen_sweeps(experiment)
    require_live_channels(chosen.main.sweep, tuple(experiment.axes), chosen.main.name)
    warnings = [sentence for e in twin.effects for sentence in e.sentences()]
    warnings += [*doubts, *log.warnings, *chosen.notes]
    rig, main = rig_from_datasheet(datasheet), chosen.main.sweep
    if (resting := resting_current(main, rig)) is not None:
        warnings.append(f"{load_in_words(held_at(rig, resting), rig)}: what is identified is under this load")
    if not at_standstill(main.speed_rad_s):
        remedy = "" if len(chosen.speeds_rad_s) > 1 else "; a sweep at standstill, or at another speed, tells more"
        warnings.append(
            f"planes measured at {main.speed_rad_s:.4g} rad/s: gyroscopic coupling is not in their models{remedy}"
        )
    if chosen.validation is None:
        warnings.append("no sweep is left for cross-validation: the fit is judged on the data that it was made from")
    return _Prepared(experiment, datasheet, twin.chain, chosen, tuple(warnings), log.controller_differs)


def _fitted_planes(p: _Prepared, options: Options, say: Progress) -> Within:
    """Every plane that is excited on both of its axes, fitted, and doubts in words."""
    main, pairs = p.chosen.main, planes_of(p.axes)
    amplifier, validation = (None if s is None else s.sweep for s in (p.chosen.amplifier, p.chosen.validation))
    found: dict[str, FittedPlane] = {}
    doubts: list[str] = []
    for k, (plane, pair) in enumerate(pairs.items()):
        if not np.any(np.isin(main.sweep.axis, pair) & (main.sweep.amplitude_a > 0)):
            doubts.append(f"plane {plane} is not excited in {main.name} and not identified")
            continue
        try:
            found[plane] = fit_plane(main.sweep, amplifier, validation, p.axes, plane, p.datasheet, options, p.chain)
        except AmbError as error:
            if not (odd := odd_rotor(p.datasheet)):
                raise
            raise AmbError(f"{odd[0]} The fit ended with: {error}") from error
        say((k + 1) * FITS / _steps(p))
    if not found:
        raise AmbError("no plane of the rig is excited on both of its axes; excite xA and xB, one after the other")
    if validation is not None and all(f.held_out is None for f in found.values()):
        doubts.append(
            "the sweep that was left for cross-validation cannot be used (blocks or points too few): the fit is judged "
            "on the data that it was made from"
        )

    def alike(planes: dict[str, FittedPlane]) -> dict[str, FittedPlane]:
        return settled_alike(planes, main.sweep, p.axes, p.datasheet, options)

    def again(plane: str, released: Tolerances | None, given: Given | None) -> FittedPlane:
        of = (main.sweep, amplifier, validation, p.axes, plane, p.datasheet, options, p.chain, released, given)
        return fit_plane(*of)

    settled = alike(found)
    told = {plane: Tolerances.of_given(p.datasheet, f.data.plant.axes) for plane, f in settled.items()}
    within = within_tolerances(settled, told, again)
    planes = alike(within.planes) if within.adjusted else within.planes
    assumed = [ASSUMED] if within.doubts and not p.datasheet.tolerance_stated else []
    return replace(within, planes=planes, doubts=(*doubts, *within.doubts, *assumed))


def _results(p: _Prepared, fitted: Mapping[str, FittedPlane], say: Progress) -> dict[str, PlaneResult]:
    """Figures of every plane with their deviations."""
    planes = {}
    for k, (plane, f) in enumerate(fitted.items()):
        planes[plane] = f.result(p.datasheet)
        say((len(planes_of(p.axes)) * FITS + (k + 1) * (1 - FITS)) / _steps(p))
    return planes


def _steps(p: _Prepared) -> int:
    """Steps of the whole identification that take about as long: planes, and the rotating model."""
    return len(planes_of(p.axes)) + any(p.chosen.speeds_rad_s)


def _odd_stiffness(planes: Mapping[str, PlaneResult]) -> list[str]:
    """Doubts about stiffnesses that are far off the datasheet's, in words."""
    of = {name: [p.stiffness[name + end] for p in planes.values() for end in "AB"] for name in ("ki", "ks")}
    ratios = {name: np.array([e.value / e.nominal for e in estimates if e.nominal]) for name, estimates in of.items()}
    return odd_stiffness({name: x[x > 0] for name, x in ratios.items()})
