"""From a selected joint fit to the result of a plane: figures with uncertainty, validation, curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.identification.joint.refine import Refined
from service.identification.joint.selection import Selected
from service.identification.joint.uncertainty import Uncertainty, response_std, uncertainty_of, with_given
from service.identification.loop.closed_loop import closed_loop_poles
from service.identification.loop.margins import axis_margins, beyond_measured, dense_grid, measured_sensitivity
from service.identification.loop.predicted import predicted_closed_loop
from service.identification.measured.data import Data
from service.identification.measured.etfe import FrequencyResponse, etfe
from service.identification.measured.known import computed
from service.identification.measured.points import PlanePoints
from service.identification.plane.combine import (
    amplifier_state_space,
    plant_poles,
    plant_state_space,
    pole_pencil,
    transmission_zeros,
    zero_pencil,
)
from service.identification.plane.model import PlaneModel
from service.identification.priors.given import Given
from service.identification.result.commissioning import PlaneResult
from service.identification.result.extended import extended_report
from service.identification.result.figures import (
    amplifier_scatter,
    amplifiers,
    correlations,
    estimates,
    modes,
    roots,
    stiffness,
)
from service.identification.result.judged import (
    cross_validation,
    frequency_fit,
    off_unseen,
    residual_tests,
    total_rms,
    unseen_modes,
    unseen_splits,
)
from service.identification.result.parts import Curves, Displacement, Staged
from service.identification.result.supports import told_supports
from service.identification.statistics.estimate import Estimate
from service.identification.statistics.validation import all_pass
from service.identification.steps.amplifier_fit import AmplifierFit
from service.identification.steps.rigid import rigid_response
from service.identification.steps.staged import StagedFit
from service.identification.steps.subspace import subspace
from sim.datasheet import Datasheet
from sim.wording import times


def assemble(
    datasheet: Datasheet,
    data: Data,
    held_out: PlanePoints | None,
    u_to_y: FrequencyResponse,
    plant: FrequencyResponse,
    fits: tuple[AmplifierFit, AmplifierFit] | None,
    staged: StagedFit,
    selected: Selected,
    given: Given | None = None,
) -> PlaneResult:
    """Result of a plane from its joint fit; ``given``: what that held in place of the datasheet's values."""
    refined, model, points = selected.refined, selected.refined.model, data.plant
    u = uncertainty_of(refined, selected.splits, inflation=refined.noise.inflation, estimated_weights=True)
    if given is not None:
        u = with_given(u, refined, data, given.covariance)
    fit, at_lines = frequency_fit(model, points, refined.amplitude)
    cross, cross_rms, validation_frf, validation_model = cross_validation(model, held_out, refined.reach)
    off = off_unseen(model, u, held_out, refined.reach)
    rms, tests = residual_tests(refined, points)
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    omega = dense_grid(model, closed_loop_poles(model, controller))
    omega = omega[omega <= 1.2 * points.omega.max()]
    seen = measured_sensitivity(computed(points, model.known.chain))
    peaks = axis_margins(model, controller, u.covariance, u.free, seen)
    beyond = beyond_measured(model, controller, points.axes, float(points.omega.max()) / (2 * np.pi))
    total = total_rms(rms)
    found_modes = modes(model, u, points, selected.splits)
    return PlaneResult(
        plane=points.plane,
        axes=points.axes,
        model=model,
        covariance=u.covariance,
        parameter_names=tuple(np.array(model.layout.names)[u.free].tolist()),
        amplifiers=amplifiers(model, u, data, fits, held_out),
        stiffness=stiffness(model, u, datasheet, points),
        modes=found_modes,
        delay_s=_delay(model, u, points),
        poles=roots(model, u, plant_poles(model), pole_pencil),
        zeros=roots(model, u, transmission_zeros(model), zero_pencil),
        correlations=correlations(model, u, controller),
        extended=extended_report(refined, selected.splits, data, datasheet, u),
        fit_percent=fit,
        cross_validation_fit_percent=cross,
        cross_validation_rms=cross_rms,
        off_unseen=off,
        staged=_staged(staged, held_out),
        residual_rms=rms,
        residual_rms_total=total,
        tests=tests,
        tests_passed=all_pass([*tests["whiteness"], *tests["independence"]]),
        adequate=u.adequate,
        widening=u.widening,
        mode_evidence=unseen_modes(selected, held_out),
        state_space=plant_state_space(model, points.axes),
        amplifier_state_space=amplifier_state_space(model, points.axes),
        margins=dict(zip("AB", peaks, strict=True)),
        zones_db=datasheet.sensitivity_zones_db,
        curves=Curves(
            u_to_y,
            plant,
            None if points.I is None else etfe(points, "u->i"),
            amplifier_scatter(data),
            validation_frf,
            omega,
            model.response(omega),
            response_std(model, u, omega),
            at_lines,
            rigid_response(model, staged.rigid_model.ki, staged.rigid_model.ks, omega),
            staged.response(omega),
            validation_model,
        ),
        displacement=_displacement(points, datasheet),
        subspace=subspace(plant, 2 * (2 + model.layout.n_modes)),
        status=u.status(refined.fit),
        warnings=(
            *_warnings(points, refined, u, total),
            *([_told_unseen(off)] if off else []),
            *([f"margins and zone of the loop are not known: {beyond.peak}"] if beyond.peak else []),
            *([f"margins are those of the measured band: {beyond.gain}"] if beyond.gain and not beyond.peak else []),
            *told_supports(found_modes, datasheet),
        ),
        beyond_measured=beyond.peak,
        covariance_from_data=u.from_data,
        closed_loop=predicted_closed_loop(model, controller, points if held_out is None else held_out),
    )


def _delay(model: PlaneModel, u: Uncertainty, points: PlanePoints) -> Estimate:
    found = estimates(model, u, lambda m: np.array([m.delay_s]), ["s"])[0]
    # held where no current shows it: nothing is known of it, which no deviation of 0 tells
    return replace(found, std=float("nan"), std_from_data=None) if points.I is None else found


def _warnings(points: PlanePoints, refined: Refined, u: Uncertainty, total: float) -> tuple[str, ...]:
    """What a reader of the result should know of its data, the worst first."""
    warnings = list(points.left_out)
    if points.I is None:
        warnings.insert(
            0,
            "coil currents are not logged: the amplifiers are the datasheet's within its tolerances, the delay is as "
            "told, and ki is known no better than the amplifiers' gain",
        )
    drifting = points.omega[refined.noise.drifting] / (2 * np.pi)
    if len(drifting):
        one = len(drifting) == 1
        many = (
            "1 point had not settled, or was marked, and counts"
            if one
            else (f"{len(drifting)} points had not settled, or were marked, and count")
        )
        where = ", ".join(f"{f:.4g}" for f in np.unique(drifting)[:6])
        warnings.append(f"{many} little ({where} Hz); settle longer there")
    if not u.adequate:
        warnings.insert(
            0,
            f"residuals are {times(total)} times the noise, more than chance makes them: something acts that the model "
            "does not have; standard deviations allow for an error of that size, not for a bias that it may bring"
            if total > 1
            else f"residuals are {times(total)} times the noise, but for an error of the model that had to be allowed "
            "for beside it: something acts that the model does not have",
        )
    return (*refined.fit.doubt, *warnings)


def _told_unseen(off: float) -> str:
    return (
        f"residuals on the sweep that no fit has seen are up to {times(off)} times the noise, beyond what the standard "
        "deviations allow: the model does not hold there, as something depends on the amplitude or has changed between "
        "the sweeps; diagnose the gap (ambit gap diagnose)"
    )


def _staged(fit: StagedFit, held_out: PlanePoints | None) -> Staged:
    return Staged(
        fit.split_rad_s / (2 * np.pi),
        unseen_splits(fit, held_out),
        fit.rigid_model.ki,
        fit.rigid_model.ks,
        fit.rigid_fit_percent,
        fit.flexible_fit_percent,
        fit.complete_fit_percent,
    )


def _displacement(points: PlanePoints, datasheet: Datasheet) -> Displacement:
    return Displacement(
        points.omega / (2 * np.pi),
        points.axis,
        np.abs(points.y),
        datasheet.linear_range_m,
        np.abs(points.r[np.arange(len(points.axis)), points.axis]),
    )
