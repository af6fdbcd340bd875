"""Figures of a plane's result, each with its standard deviation: stiffness, modes, poles, amplifiers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import eig

from service.identification.arrays import Complex, Real
from service.identification.joint.uncertainty import Uncertainty
from service.identification.loop.margins import heights, sensitivity_peaks
from service.identification.measured.data import Data
from service.identification.measured.noise import block_noise
from service.identification.measured.points import PlanePoints
from service.identification.plane import amplifier as amp
from service.identification.plane.combine import levitated_frequencies
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Posterior
from service.identification.result.parts import AmplifierResult, Correlations, ModeResult, RootResult
from service.identification.statistics.estimate import Estimate
from service.identification.statistics.evidence import Evidence
from service.identification.statistics.validation import nrmse_percent
from service.identification.steps.amplifier_fit import AmplifierFit
from sim.datasheet import Datasheet

MOST_DAMPED = 0.3
"""Damping ratio from which a mode has no peak, and is none of a rotor."""
DOUBT = 3.0
"""Standard deviations that an estimate may be off by chance."""


def stiffness(model: PlaneModel, u: Uncertainty, datasheet: Datasheet, points: PlanePoints) -> dict[str, Estimate]:
    """Ks (N/m) and ki (N/A) of both bearings beside what the datasheet says."""
    places = [datasheet.axes.index(a) for a in points.axes]
    nominal = [datasheet.position_stiffness_n_per_m[k] for k in places]
    nominal += [datasheet.current_stiffness_n_per_a[k] for k in places]
    found = estimates(model, u, lambda m: np.concatenate([m.ks, m.ki]), ["N/m", "N/m", "N/A", "N/A"], nominal)
    return dict(zip(["ksA", "ksB", "kiA", "kiB"], found, strict=True))


def modes(model: PlaneModel, u: Uncertainty, points: PlanePoints, splits: Posterior | None) -> tuple[ModeResult, ...]:
    """Flexible modes by natural frequency; a mode that no rotor has is told as beyond the band, or as a patch."""
    n = model.layout.n_modes
    if n == 0:
        return ()

    def figures(m: PlaneModel) -> Real:
        return np.concatenate(
            [m.natural_frequencies, m.damping_ratios, levitated_frequencies(m), m.modes[:, 2:6].ravel()]
        )

    units = ["rad/s"] * n + [""] * n + ["rad/s"] * n + ["1/sqrt(kg)"] * (4 * n)
    found = estimates(model, u, figures, units)
    out, kind = [], kinds(model, u, points)
    for k in range(n):
        shapes = found[3 * n + 4 * k : 3 * n + 4 * k + 4]
        if splits is not None and splits.shapes is not None:
            linear = 0.25 * splits.covariance[k, k]
            shapes = [_with_split(s, splits.shapes[k, j // 2] - linear) for j, s in enumerate(shapes)]
        at = (shapes[0], shapes[1]), (shapes[2], shapes[3])
        out.append(ModeResult(found[k], found[n + k], found[2 * n + k], *at, kind[k]))
    return tuple(sorted(out, key=lambda m: m.natural_frequency_rad_s.value))


def kinds(model: PlaneModel, u: Uncertainty, points: PlanePoints) -> tuple[str, ...]:
    """What each mode is: the rotor's, what lies beyond the band, or a patch, which damps as no rotor does.

    One that damps next to nothing may well be found to damp less than that.
    """
    zeta, std = model.damping_ratios, u.std(model, lambda m: m.damping_ratios)[0]
    least = np.where(DOUBT * std < MOST_DAMPED, -DOUBT * std, 0.0)
    is_mode = (least < zeta) & (zeta < MOST_DAMPED)
    within = model.natural_frequencies <= points.omega.max()
    return tuple(np.where(~is_mode, "patch", np.where(within, "rotor", "beyond")).tolist())


def _with_split(shape: Estimate, beyond_linear: float) -> Estimate:
    """A shape's figure, told how much further its split moves it than the linear law that frequencies follow."""
    variance = shape.std**2 + beyond_linear * shape.value**2
    return replace(shape, std=float(np.sqrt(max(variance, (shape.std_from_data or 0.0) ** 2))))


def roots(
    model: PlaneModel, u: Uncertainty, at: Complex, pencil: Callable[[PlaneModel], tuple[Real, Real]]
) -> tuple[RootResult, ...]:
    """Poles or zeros of the levitated plant, rad/s, each with the region where it lies.

    Parameters
    ----------
    at
        Those to tell of.
    pencil
        Matrices whose generalised eigenvalues they are. An eigenvalue z with left and right vectors w, v moves by
        w^H dA v / w^H M v (Stewart and Sun, Matrix Perturbation Theory, VI.2), which is exact where differences of the
        real parts of lightly damped roots would be lost in rounding.
    """
    if len(at) == 0:
        return ()
    a, mass = pencil(model)
    values, left, right = eig(a, mass, left=True, right=True)  # type: ignore[misc]
    places = [int(np.argmin(np.abs(np.where(np.isfinite(values), values, np.inf) - p))) for p in at]
    w, v = left[:, places].conj(), right[:, places]
    norm = np.einsum("ik,ij,jk->k", w, mass, v)

    def moved(m: PlaneModel) -> Real:
        z = np.einsum("ik,ij,jk->k", w, pencil(m)[0], v) / norm
        return np.concatenate([z.real, z.imag])

    gradient = u.gradient(model, moved).reshape(2, len(at), -1)
    covariance = np.einsum("akn,nm,bkm->kab", gradient, u.covariance, gradient)
    size = np.sqrt(np.maximum(np.einsum("kaa->k", covariance), 0.0))
    return tuple(RootResult(complex(p), float(s), c) for p, s, c in zip(at, size, covariance, strict=True))


def correlations(
    model: PlaneModel, u: Uncertainty, controller: tuple[Real, Real], also: Mapping[str, str] | None = None
) -> Correlations:
    """Correlations of all figures of a plane, modes by rising natural frequency.

    ``also``: further parameters by the names to show them with.
    """
    more = [model.layout.index(name) for name in (also or {}).values()]
    order = np.argsort(model.natural_frequencies)
    peaks = sensitivity_peaks(model, controller)

    def every(m: PlaneModel) -> Real:
        of_modes = [m.natural_frequencies[order], m.damping_ratios[order], m.modes[order, 2:6].ravel()]
        return np.concatenate([m.ks, m.ki, [m.delay_s], *of_modes, heights(m, controller, peaks), m.theta[more]])

    numbers = range(1, len(order) + 1)
    places = ("bearing A", "bearing B", "sensor A", "sensor B")
    names = ["ksA", "ksB", "kiA", "kiB", "delay"]
    names += [f"natural frequency {k}" for k in numbers] + [f"damping ratio {k}" for k in numbers]
    names += [f"shape {k}, {place}" for k in numbers for place in places]
    names += ["sensitivity peak A", "sensitivity peak B", *(also or {})]
    gradient = u.gradient(model, every)
    covariance = gradient @ u.covariance @ gradient.T
    std = np.sqrt(np.diag(covariance))
    std[std == 0] = 1.0  # what no data moves, as the delay without currents
    return Correlations(tuple(names), np.clip(covariance / np.outer(std, std), -1.0, 1.0))


def amplifiers(
    model: PlaneModel,
    u: Uncertainty,
    data: Data,
    fits: tuple[AmplifierFit, AmplifierFit] | None,
    held_out: PlanePoints | None,
) -> dict[str, AmplifierResult]:
    """Both amplifiers, their fits in NRMSE percent, and how each order does on currents that no fit has seen."""
    out = {}
    scatter = amplifier_scatter(data)
    delay = model.delay_s + model.known.computing_delay_s
    for j, (axis, a) in enumerate(zip("AB", model.amplifiers, strict=True)):
        place = model.layout.amplifiers[j]
        names = amp.PARAMETER_NAMES[: a.order + 1]
        units = ["A/A", "rad/s", "", "rad/s"][: a.order + 1]

        def of(m: PlaneModel, place: slice = place) -> Real:
            return m.theta[place]

        found = estimates(model, u, of, units)
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


def amplifier_scatter(data: Data) -> tuple[tuple[Real, Complex, Real], tuple[Real, Complex, Real]] | None:
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


def estimates(
    model: PlaneModel,
    u: Uncertainty,
    of: Callable[[PlaneModel], Real],
    units: Sequence[str],
    nominal: Sequence[float] | None = None,
) -> list[Estimate]:
    """What ``of`` takes from the model, (n,), each with its deviation, all told and from the data alone."""
    values = of(model)
    total, data = u.std(model, of)
    return [
        Estimate(float(v), float(t), unit, None if nominal is None else float(nominal[k]), float(d))
        for k, (v, t, d, unit) in enumerate(zip(values, total, data, units, strict=True))
    ]
