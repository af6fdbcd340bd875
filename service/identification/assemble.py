"""From a selected joint fit to the result of a plane: figures with uncertainty, validation, curves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from service.identification import amplifier as amp
from service.identification.amplifier_fit import AmplifierFit
from service.identification.closed_loop import predicted_closed_loop
from service.identification.combine import amplifier_state_space, plant_poles, plant_state_space, transmission_zeros
from service.identification.etfe import FrequencyResponse, etfe
from service.identification.evidence import Evidence
from service.identification.extended import extended_report
from service.identification.margins import axis_margins, dense_grid
from service.identification.noise import block_noise
from service.identification.plane_model import PlaneModel, Points
from service.identification.points import PlanePoints, same_frequency
from service.identification.refine import Data, Refined, amplitude_of, noise_of
from service.identification.result import (
    AmplifierResult,
    Curves,
    Displacement,
    Estimate,
    ModeResult,
    PlaneResult,
    PoleResult,
    Staged,
)
from service.identification.rigid import rigid_response
from service.identification.selection import Selected
from service.identification.staged import StagedFit
from service.identification.subspace import subspace
from service.identification.uncertainty import Uncertainty, response_std, uncertainty_of
from service.identification.validation import (
    CorrelationTest,
    all_pass,
    independence,
    nrmse_matrix,
    nrmse_percent,
    whiteness,
)
from service.identification.zoh import Complex, Real
from sim.datasheet import Datasheet


def assemble(
    datasheet: Datasheet,
    data: Data,
    held_out: PlanePoints | None,
    u_to_y: FrequencyResponse,
    plant: FrequencyResponse,
    fits: tuple[AmplifierFit, AmplifierFit] | None,
    staged: StagedFit,
    selected: Selected,
) -> PlaneResult:
    """Result of a plane from its joint fit."""
    refined, model, points = selected.refined, selected.refined.model, data.plant
    u = uncertainty_of(refined, selected.splits)
    fit, at_lines = frequency_fit(model, points, refined)
    cross, cross_rms, validation_frf, validation_model = _cross_validation(model, held_out)
    rms, tests = _residual_tests(refined, points)
    passed = all_pass([*tests["whiteness"], *tests["independence"]])
    omega = dense_grid(model)
    omega = omega[omega <= 1.2 * points.omega.max()]
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    peaks = axis_margins(model, controller, u.covariance, u.free, _measured_sensitivity(points))
    total = float(np.sqrt(np.mean(rms**2)))
    warnings = list(points.left_out)
    drifting = points.omega[refined.noise.drifting] / (2 * np.pi)
    if len(drifting):
        many = "1 point" if len(drifting) == 1 else f"{len(drifting)} points"
        where = ", ".join(f"{f:.4g}" for f in np.unique(drifting)[:6])
        warnings.append(f"{many} had not settled, or were marked, and count little ({where} Hz); settle longer there")
    if not u.adequate:
        warnings.insert(
            0,
            f"residuals are {total:.2g} times the noise: something acts that the model does not have; "
            "standard deviations allow for an error of that size, not for a bias that it may bring",
        )
    names = tuple(np.array(model.layout.names)[u.free].tolist())
    return PlaneResult(
        plane=points.plane,
        axes=points.axes,
        model=model,
        covariance=u.covariance,
        parameter_names=names,
        amplifiers=_amplifiers(model, u, data, fits, held_out),
        stiffness=_stiffness(model, u, datasheet, points),
        modes=_modes(model, u, points),
        delay_s=_estimates(model, u, lambda m: np.array([m.delay_s]), ["s"])[0],
        poles=_poles(model, u),
        zeros=transmission_zeros(model),
        extended=extended_report(refined, selected.splits, data, datasheet, u),
        fit_percent=fit,
        cross_validation_fit_percent=cross,
        cross_validation_rms=cross_rms,
        staged=Staged(
            staged.split_rad_s / (2 * np.pi),
            staged.split_evidence,
            staged.rigid_model.ki,
            staged.rigid_model.ks,
            staged.rigid_fit_percent,
            staged.flexible_fit_percent,
            staged.complete_fit_percent,
            np.empty(0) if staged.flexible is None else staged.flexible.nu_rad_s,
            np.empty(0) if staged.flexible is None else staged.flexible.sigma_rad_s,
        ),
        residual_rms=rms,
        residual_rms_total=total,
        tests=tests,
        tests_passed=passed,
        adequate=u.adequate,
        widening=u.widening,
        mode_evidence=_unseen_modes(selected, held_out),
        state_space=plant_state_space(model, points.axes),
        amplifier_state_space=amplifier_state_space(model, points.axes),
        margins=dict(zip("AB", peaks, strict=True)),
        curves=Curves(
            u_to_y,
            plant,
            None if points.I is None else etfe(points, "u->i"),
            _amplifier_scatter(data),
            validation_frf,
            omega,
            model.response(omega),
            response_std(model, u, omega),
            model.plant_response(omega),
            model.amplifier_response(omega, base_band=False),
            at_lines,
            rigid_response(model, staged.rigid_model.ki, staged.rigid_model.ks, omega),
            staged.response(omega),
            validation_model,
        ),
        displacement=Displacement(
            points.omega / (2 * np.pi),
            points.axis,
            np.abs(points.y),
            datasheet.linear_range_m,
            np.abs(points.r[np.arange(len(points.axis)), points.axis]),
            points.u,
        ),
        subspace=subspace(plant, 2 * (2 + model.layout.n_modes)),
        status=refined.fit.status,
        warnings=tuple(warnings),
        covariance_from_data=u.from_data,
        closed_loop=predicted_closed_loop(model, controller, points if held_out is None else held_out),
    )


def frequency_fit(model: PlaneModel, points: PlanePoints, refined: Refined | None = None) -> tuple[Real, Complex]:
    """NRMSE of u->y per entry at the measured amplitudes, and the model's response there, (F, 2, 2)."""
    measured = etfe(points, "u->y")
    amplitude = refined.amplitude if refined is not None else amplitude_of(model, points)
    y = model.predict(Points(points.omega, points.u), amplitude).y
    groups = [g for g in same_frequency(points.omega) if len(np.unique(points.axis[g])) == 2]
    response = np.stack([y[g].T @ np.linalg.pinv(points.u[g].T) for g in groups])
    return nrmse_matrix(measured.value, response), response


def _cross_validation(
    model: PlaneModel, points: PlanePoints | None
) -> tuple[Real | None, Real | None, FrequencyResponse | None, Complex | None]:
    """Fit and rms/sigma on points that no step of the fit has seen, the response there, measured and of the model."""
    if points is None:
        return None, None, None, None
    groups = [g for g in same_frequency(points.omega) if len(np.unique(points.axis[g])) == 2]
    amplitude = amplitude_of(model, points)
    y = model.predict(Points(points.omega, points.u), amplitude).y
    sigma = noise_of(model, points, amplitude).sigma[:, -2:]
    e = np.abs(points.y - y) / sigma
    rms = np.full((2, 2), np.nan)
    for k in range(2):
        if np.any(points.axis == k):
            rms[:, k] = np.sqrt(np.mean(e[points.axis == k] ** 2, axis=0))
    if len(groups) < 3:
        return None, rms, None, None
    fit, response = frequency_fit(model, points)
    return fit, rms, etfe(points, "u->y"), response


def _unseen_modes(selected: Selected, points: PlanePoints | None) -> tuple[Evidence, ...]:
    """The evidence on the number of modes, with how each candidate does on points that no fit has seen."""
    if points is None:
        return selected.evidence
    # one noise for all of them: that of the chosen model
    chosen = selected.refined.model
    sigma = noise_of(chosen, points, amplitude_of(chosen, points)).sigma[:, -2:]
    out = []
    for e, model in zip(selected.evidence, selected.candidates, strict=True):
        y = model.predict(Points(points.omega, points.u), amplitude_of(model, points)).y
        out.append(replace(e, unseen_rms=float(np.sqrt(np.mean(np.abs((points.y - y) / sigma) ** 2)))))
    return tuple(out)


def _unseen_amplifier(
    fit: AmplifierFit, channel: int, points: PlanePoints | None, model: PlaneModel
) -> tuple[Evidence, ...]:
    """The evidence on an amplifier's order, with how each order does on currents that no fit has seen."""
    if points is None or points.I is None or points.i is None or not np.any(points.axis == channel):
        return fit.evidence
    own = points.select(points.axis == channel)
    assert own.I is not None
    assert own.i is not None
    ratio = own.i[:, channel] / own.u[:, channel]
    away = own.I[:, :, channel] - ratio[:, None] * own.U[:, :, channel]
    sigma = block_noise(away[:, :, None], own.omega).sigma[:, 0]
    out = []
    for e, (_, parameters, delay) in zip(fit.evidence, fit.fits, strict=True):
        late = delay + model.known.computing_delay_s
        i = amp.sampled(own.omega, parameters, late, model.known.sample_time_s)[0] * own.u[:, channel]
        out.append(replace(e, unseen_rms=float(np.sqrt(np.mean(np.abs((own.i[:, channel] - i) / sigma) ** 2)))))
    return tuple(out)


def _residual_tests(refined: Refined, points: PlanePoints) -> tuple[Real, dict[str, list[CorrelationTest]]]:
    """rms/sigma per channel and excited axis, and the correlation tests of the displacement's residuals."""
    p = refined.model.predict(Points(points.omega, points.u), refined.amplitude)
    sigma = refined.noise.sigma
    e, shown = np.asarray((points.y - p.y) / sigma[:, -2:], dtype=np.complex128), p.y
    channels = [f"y_{a}" for a in points.axes]
    if points.i is not None:
        e, shown = np.hstack([(points.i - p.i) / sigma[:, :2], e]), np.hstack([p.i, p.y])
        channels = [f"i_{a}" for a in points.axes] + channels
    rms = np.array(
        [[np.sqrt(np.mean(np.abs(e[points.axis == k, c]) ** 2)) for k in range(2)] for c in range(e.shape[1])]
    )
    tests: dict[str, list[CorrelationTest]] = {"whiteness": [], "independence": []}
    for c in range(e.shape[1] - 2, e.shape[1]):
        for k in range(2):
            rows = points.axis == k
            name = f"{channels[c]} from {points.axes[k]}"
            tests["whiteness"].append(whiteness(name, e[rows, c]))
            tests["independence"].append(independence(name, e[rows, c], shown[rows, c]))
    return rms, tests


def _measured_sensitivity(points: PlanePoints) -> FrequencyResponse | None:
    try:
        return etfe(points, "r->u")
    except ValueError:  # two axes excited at once, with the same r: S cannot be told apart
        return None


def _estimates(model: PlaneModel, u: Uncertainty, of: Any, units: list[str], nominal: Any = None) -> list[Estimate]:
    values = of(model)
    total, data = u.std(model, of)
    return [
        Estimate(float(v), float(t), unit, None if nominal is None else float(nominal[k]), float(d))
        for k, (v, t, d, unit) in enumerate(zip(values, total, data, units, strict=True))
    ]


def _stiffness(model: PlaneModel, u: Uncertainty, datasheet: Datasheet, points: PlanePoints) -> dict[str, Estimate]:
    places = [datasheet.axes.index(a) for a in points.axes]
    nominal = [datasheet.position_stiffness_n_per_m[k] for k in places]
    nominal += [datasheet.current_stiffness_n_per_a[k] for k in places]
    found = _estimates(model, u, lambda m: np.concatenate([m.ks, m.ki]), ["N/m", "N/m", "N/A", "N/A"], nominal)
    return dict(zip(["ksA", "ksB", "kiA", "kiB"], found, strict=True))


def _modes(model: PlaneModel, u: Uncertainty, points: PlanePoints) -> tuple[ModeResult, ...]:
    n = model.layout.n_modes
    if n == 0:
        return ()

    def figures(m: PlaneModel) -> Real:
        modes = m.modes
        levitated = modes[:, 0]
        return np.concatenate([m.natural_frequencies, m.damping_ratios, levitated, modes[:, 2:6].ravel()])

    units = ["rad/s"] * n + [""] * n + ["rad/s"] * n + ["1/sqrt(kg)"] * (4 * n)
    found = _estimates(model, u, figures, units)
    out = []
    for k in range(n):
        shapes = found[3 * n + 4 * k : 3 * n + 4 * k + 4]
        w, zeta = found[k].value, found[n + k].value
        kind = "rotor" if w <= points.omega.max() and 0 < zeta < 0.3 else "beyond" if 0 < zeta < 0.3 else "patch"
        out.append(
            ModeResult(found[k], found[n + k], found[2 * n + k], (shapes[0], shapes[1]), (shapes[2], shapes[3]), kind)
        )
    return tuple(sorted(out, key=lambda m: m.natural_frequency_rad_s.value))


def _poles(model: PlaneModel, u: Uncertainty) -> tuple[PoleResult, ...]:
    at = plant_poles(model)

    def near(m: PlaneModel) -> Real:
        moved = plant_poles(m)
        paired = np.array([moved[np.argmin(np.abs(moved - p))] for p in at])
        return np.concatenate([paired.real, paired.imag])

    std, _ = u.std(model, near)
    n = len(at)
    return tuple(PoleResult(complex(p), float(np.hypot(std[k], std[n + k]))) for k, p in enumerate(at))


def _amplifiers(
    model: PlaneModel,
    u: Uncertainty,
    data: Data,
    fits: tuple[AmplifierFit, AmplifierFit] | None,
    held_out: PlanePoints | None,
) -> dict[str, AmplifierResult]:
    out = {}
    scatter = _amplifier_scatter(data)
    delay = model.delay_s + model.known.computing_delay_s
    for j, (axis, a) in enumerate(zip("AB", model.amplifiers, strict=True)):
        place = model.layout.amplifiers[j]
        names = amp.PARAMETER_NAMES[: a.order + 1]
        units = ["A/A", "rad/s", "", "rad/s"][: a.order + 1]

        def of(m: PlaneModel, place: slice = place) -> Real:
            return m.theta[place]

        found = _estimates(model, u, of, units)
        fit = first = float("nan")
        first_order = None
        if scatter is not None and fits is not None:
            omega, ratio, _ = scatter[j]
            t = model.known.sample_time_s
            fit = nrmse_percent(ratio, amp.sampled(omega, np.array(a.parameters), delay, t)[0])
            _, low, low_delay = fits[j].fits[0]
            # the thesis's first-order model has no delay of its own
            low_delay += model.known.computing_delay_s
            first = nrmse_percent(ratio, amp.sampled(omega, low, low_delay, t)[0])
            first_order = (tuple(low.tolist()), low_delay)
        out[axis] = AmplifierResult(
            a.order,
            a.poles,
            a.dc_gain,
            dict(zip(names, found, strict=True)),
            fit,
            first,
            _unseen_amplifier(fits[j], j, held_out, model) if fits is not None else (),
            first_order,
        )
    return out


def _amplifier_scatter(data: Data) -> tuple[tuple[Real, Complex, Real], tuple[Real, Complex, Real]] | None:
    """Per axis (omega, i/u, std) at the points that excite it."""
    if data.plant.I is None:
        return None
    out = []
    for j in range(2):
        omega, ratio, std = [], [], []
        for points in (data.plant, data.amplifier):
            if points is None or points.I is None:
                continue
            rows = points.axis == j
            r = points.I[rows, :, j] / points.U[rows, :, j]
            omega.append(points.omega[rows])
            ratio.append(r.mean(axis=1))
            std.append(r.std(axis=1, ddof=1) / np.sqrt(r.shape[1]))
        w = np.concatenate(omega)
        order = np.argsort(w)
        out.append((w[order], np.concatenate(ratio)[order], np.concatenate(std)[order]))
    return out[0], out[1]
