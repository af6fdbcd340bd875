"""The rotating rotor: from sweeps at several speeds and the planes' own fits to the rotating part of the result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from service.experiment.data import Experiment, Sweep
from service.identification.arrays import Real
from service.identification.joint.one_rotor import OneRotor
from service.identification.joint.selection import Selected
from service.identification.joint.uncertainty import Uncertainty, uncertainty_of
from service.identification.measured.sweeps import NOT_PLANT, Joined, joined_sweep, speed_of
from service.identification.priors.split import Posterior, Split
from service.identification.rotating.campbell import Campbell, campbell
from service.identification.rotating.fit import RotatingFit, amplitude_of, fit_rotating, noise_of, turning
from service.identification.rotating.held import with_held
from service.identification.rotating.model import RotatingModel, joined, paired
from service.identification.rotating.points import SpeedPoints, speed_points
from service.identification.rotating.start import Begun, begun, not_modes
from service.identification.statistics.estimate import Estimate
from service.identification.statistics.evidence import Evidence
from sim.datasheet import Datasheet
from sim.errors import AmbError
from sim.wording import times

ROUND = 0.005
"""Standard deviation of the logarithm by which the two planes' shapes of one mode may split differently."""

CERTAIN = 3.0
"""Standard deviations from which a polar inertia is on its side of zero."""


@dataclass(frozen=True)
class Turned:
    """A rotor identified over several speeds."""

    data: tuple[SpeedPoints, ...]
    refined: RotatingFit
    uncertainty: Uncertainty
    """With mass and sensors given: that of the loop, and of what is read back."""
    told: Uncertainty
    """That of the rotor's figures, with what is not known of mass and sensors where these were held within the
    datasheet's tolerances."""
    campbell: Campbell
    rms: Real
    """(sweeps,) residual over noise."""
    unseen: tuple[tuple[str, float, float], ...]
    """(name, speed, residual over noise of y) of sweeps that no fit has seen."""
    apart: float | None
    """Largest difference of ki and ks from the planes' own fits, in their standard deviations; None where those were
    not made at standstill."""
    warnings: tuple[str, ...]

    @property
    def model(self) -> RotatingModel:
        """The model at its optimum."""
        return self.refined.model

    def estimate(self, name: str, unit: str, nominal: float | None = None) -> Estimate:
        """A parameter with its uncertainty."""
        k = self.model.layout.index(name)
        place = int(np.searchsorted(np.flatnonzero(self.told.free), k))
        std, data = (
            float(np.sqrt(c[place, place])) if self.told.free[k] else 0.0
            for c in (self.told.covariance, self.told.from_data)
        )
        return Estimate(float(self.model.theta[k]), std, unit, nominal, data)

    def document(self) -> dict[str, Any]:
        """As JSON: the section "rotating" of result.json."""
        layout, free = self.model.layout, self.uncertainty.free
        return {
            "sweeps": [
                {
                    "name": p.name,
                    "speed_rad_s": p.speed_rad_s,
                    "points": len(p.omega),
                    "rms_over_sigma": float(rms),
                    "synchronous": [
                        {
                            "order": line.order,
                            "seen": line.seen,
                            "amplitude_m": line.amplitude_m.tolist(),
                            "notched": line.notched,
                            "left_out": line.left_out,
                        }
                        for line in p.lines
                    ],
                }
                for p, rms in zip(self.data, self.rms, strict=True)
            ],
            "unseen": [{"name": n, "speed_rad_s": w, "rms_over_sigma": r} for n, w, r in self.unseen],
            "polar_inertia_kgm2": self.estimate("polar_inertia_kgm2", "kg m2").document(),
            "transverse_inertia_kgm2": self.estimate("transverse_inertia_kgm2", "kg m2").document(),
            "centre_of_gravity_m": self.estimate("centre_of_gravity_m", "m").document(),
            "stiffness": {k: e.document() for k, e in self.stiffness().items()},
            "modes": [self._pair(k) for k in range(len(layout.pairs))],
            "largest_difference_from_planes_in_std": self.apart,
            "campbell": self.campbell.document(),
            "parameters": {
                "values": dict(zip(layout.names, self.model.theta.tolist(), strict=True)),
                "pairs": [list(pair) for pair in layout.pairs],
                "free": [n for n, f in zip(layout.names, free, strict=True) if f],
                "covariance": self.uncertainty.covariance.tolist(),
            },
            "model_adequate": self.uncertainty.adequate,
            "std_widened_by": self.uncertainty.widening,
            "given": {"mass_kg": float(self.model.theta[layout.index("mass_kg")])},
            "status": self.uncertainty.status(self.refined.fit),
            "warnings": list(self.warnings),
        }

    def stiffness(self) -> dict[str, Estimate]:
        """ki and ks of every axis, named as "ki_xA"."""
        return {
            f"{kind}_{plane}{axis}": self.estimate(f"{plane}_{kind}_{axis}", unit)
            for kind, unit in (("ki", "N/A"), ("ks", "N/m"))
            for plane in "xy"
            for axis in "AB"
        }

    def pair_figures(self, k: int) -> tuple[Estimate, Estimate, tuple[Estimate, ...]]:
        """Gyroscopic coupling, rotating damping ratio, and natural frequency and damping ratio in x and in y."""
        a, b = self.model.layout.pairs[k]

        def figures(m: RotatingModel) -> Real:
            x, y = m.planes
            w = np.array([x.natural_frequencies[a], y.natural_frequencies[b]])
            g, h = m.coupling(k)
            zeta = np.array([x.damping_ratios[a], y.damping_ratios[b]])
            return np.array([g, 2 * h / w.sum(), w[0], w[1], *zeta])

        values = figures(self.model)
        std, data = self.told.std(self.model, figures)
        units = ("", "", "rad/s", "rad/s", "", "")
        found = [
            Estimate(float(v), float(s), unit, None, float(d))
            for v, s, d, unit in zip(values, std, data, units, strict=True)
        ]
        return found[0], found[1], tuple(found[2:])

    def _pair(self, k: int) -> dict[str, Any]:
        g, rotating, (w_x, w_y, zeta_x, zeta_y) = self.pair_figures(k)
        fastest = max(abs(p.speed_rad_s) for p in self.data)
        return {
            "gyroscopic": g.document(),
            "splitting_rad_s_per_rad_s": g.document(),
            "splitting_at_fastest_rad_s": abs(g.value) * fastest,
            "rotating_damping_ratio": rotating.document(),
            "natural_frequency_rad_s": {"x": w_x.document(), "y": w_y.document()},
            "damping_ratio": {"x": zeta_x.document(), "y": zeta_y.document()},
        }


def turned(
    experiment: Experiment,
    datasheet: Datasheet,
    planes: dict[str, Selected],
    planes_speed_rad_s: float,
    rotor: OneRotor | None = None,
) -> Turned:
    """Joint fit of the rotating model over every speed of an experiment.

    Parameters
    ----------
    planes
        Joint fits of planes "x" and "y" by themselves, from which the search starts.
    planes_speed_rad_s
        Speed at which those were measured; 0 at standstill.
    rotor
        What those held in place of the datasheet's mass, geometry and sensor gains.

    Raises
    ------
    AmbError
        A rig with one plane, or sweeps that do not excite all axes.
    """
    if set(planes) != {"x", "y"} or len(experiment.axes) != 4:
        raise AmbError("the rotating model needs planes x and y, both excited; excite xA, xB, yA and yB at every speed")
    names = {id(s): f"sweeps/{k}" + (f" ({s.comment})" if s.comment else "") for k, s in enumerate(experiment.sweeps)}
    seen, unseen, warnings = _sweeps(experiment, names)
    if not any(speed_of(j.sweep) for j in seen):
        raise AmbError("no stepped sine at speed is there; measure one")
    data = tuple(speed_points(j.sweep, tuple(experiment.axes), j.name) for j in seen)
    end = max(float(p.omega.max()) for p in data)
    refined, u = _fitted(begun(planes, end, bool(planes_speed_rad_s)), data, datasheet, end)
    layout = refined.model.layout
    alone = sum(p.n_modes for p in layout.planes) - 2 * len(layout.pairs)
    if alone:
        warnings.append(f"{alone} modes are seen in one plane only and are not coupled by the speed")
    if u.adequate:
        warnings += not_modes(planes, refined.model.planes, end)
    else:
        warnings.append(
            f"residuals over all speeds are {times(u.scale)} times the noise: something acts that the rotating model "
            "does not have; standard deviations are widened"
        )
    warnings += [*refined.fit.doubt, *turns_the_other_way(refined.model, u)]
    for points in data:
        warnings += points.left_out
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    fastest = max((p.speed_rad_s for p in data), key=abs)
    top = 1.2 * max(float(p.omega.max()) for p in data)
    return Turned(
        data,
        refined,
        u,
        u if rotor is None else with_held(u, refined, data, rotor),
        campbell(refined.model, controller, u, fastest, top),
        _rms(refined),
        tuple(_unseen(refined.model, unseen, experiment, names)),
        None if planes_speed_rad_s else _apart(refined.model, planes, u),
        tuple(warnings),
    )


def _sweeps(experiment: Experiment, names: dict[int, str]) -> tuple[list[Joined], list[Sweep], list[str]]:
    """Sweeps that are fitted, one a speed, those that check the fit, and what there is to say of others.

    One that was measured plane by plane is one, as for the planes.
    """
    by_speed: dict[float, list[int]] = {}
    checks: list[int] = []
    warnings: list[str] = []
    for k, sweep in enumerate(experiment.sweeps):
        if sweep.kind == "noise" or not sweep.n_points or not np.any(sweep.amplitude_a > 0):
            continue
        if sweep.kind == "multisine":
            # its lines are there at once: what the force law adds to each is not in this model
            warnings.append(f"{names[id(sweep)]} is a multisine and is not in the rotating fit; use stepped sine")
        elif sweep.comment not in NOT_PLANT:
            by_speed.setdefault(speed_of(sweep), []).append(k)
        elif sweep.comment not in ("amplifier", "preliminary"):
            checks.append(k)
    seen = [j for places in by_speed.values() if (j := joined_sweep(experiment, places)) is not None]
    fitted = {k for j in seen for k in j.places}
    checks += [k for places in by_speed.values() for k in places if k not in fitted]
    warnings += [note for j in seen for note in j.notes]
    return seen, [experiment.sweeps[k] for k in sorted(checks)], warnings


def _fitted(
    starts: list[tuple[Begun, Begun]], data: tuple[SpeedPoints, ...], datasheet: Datasheet, end_rad_s: float
) -> tuple[RotatingFit, Uncertainty]:
    """The joint fit from the first start that leads to the noise, or from that which describes the data best."""
    found = []
    for x, y in starts:
        models, n_x = (x[0], y[0]), x[0].layout.n_modes
        pairs = paired(*models)
        splits = common_splits((x[1], y[1]), pairs)
        start = joined(*models, pairs, datasheet.polar_inertia_kgm2 or 0.2 * datasheet.transverse_inertia_kgm2)
        ratios = splits.log_ratios[:n_x], splits.log_ratios[n_x:]
        held = [Split(r, beyond=m.modes[:, 0] > end_rad_s) for r, m in zip(ratios, models, strict=True)]
        refined = fit_rotating(start, data, (held[0], held[1]))
        found.append((refined, uncertainty_of(refined, splits, estimated_weights=True)))
        if found[-1][1].adequate:
            return found[-1]
    return min(found, key=lambda f: _length(f[0]))


def turns_the_other_way(model: RotatingModel, u: Uncertainty) -> list[str]:
    """What there is to say of a polar inertia below zero, beyond doubt: that the speeds have the wrong sign."""
    figures, _ = u.std(model, lambda m: np.array([m.polar_inertia]))
    value, std = model.polar_inertia, float(figures[0])
    if not value < -CERTAIN * std:
        return []
    return [
        f"the polar inertia comes out as {value:.3g} kg m2, which no rotor has: the shaft turns the other way than the "
        "sign of speed_rad_s says, which is positive from x to y; give every speed the other sign, as forward and "
        "backward whirl are swapped here"
    ]


def _length(refined: RotatingFit) -> float:
    """Description length of the data."""
    n = len(refined.fit.residual)
    return Evidence("", refined.fit.n_free, n, refined.fit.cost).mdl


def common_splits(planes: tuple[Posterior | None, Posterior | None], pairs: tuple[tuple[int, int], ...]) -> Posterior:
    """What is known of the splits of both planes' shapes, a pair's two copies being one shape of a round shaft.

    Each pair has the mean of what its planes say, by their precisions, with the planes' knowledge taken as one piece
    and not two: both rest on the same assumptions about shapes.
    """
    held = [Posterior(np.empty(0), np.empty((0, 0))) if p is None else p for p in planes]
    ratios = np.concatenate([h.log_ratios for h in held])
    covariance = np.asarray(block_diag(*[h.covariance for h in held]))
    n_x = len(held[0].log_ratios)
    mean = np.eye(len(ratios))
    for a, b in pairs:
        places = [a, n_x + b]
        precision = 1.0 / np.diag(covariance)[places]
        mean[np.ix_(places, places)] = precision / precision.sum()
    both = mean @ covariance @ mean.T
    # the planes' errors are alike: no mean of the two is better than the better one
    for a, b in pairs:
        places = [a, n_x + b]
        best = float(np.min(np.diag(covariance)[places]))
        grow = np.ones(len(ratios))
        grow[places] = np.sqrt(best / np.diag(both)[places])
        both = both * np.outer(grow, grow)
    return Posterior(mean @ ratios, both + ROUND**2 * np.eye(len(ratios)))


def _rms(refined: RotatingFit) -> Real:
    """Residual over noise of each sweep, from its part of the joint fit's residuals."""
    out, at = [], 0
    for weight in refined.weights:
        n = 2 * weight.shape[0] * weight.shape[1]
        out.append(float(np.sqrt(np.mean(refined.fit.residual[at : at + n] ** 2))))
        at += n
    return np.array(out)


def _unseen(
    model: RotatingModel, sweeps: list[Sweep], experiment: Experiment, names: dict[int, str]
) -> list[tuple[str, float, float]]:
    out = []
    for sweep in sweeps:
        try:
            points = speed_points(sweep, tuple(experiment.axes), names[id(sweep)])
        except AmbError:  # too short a sweep tells nothing of the fit
            continue
        amplitude = amplitude_of(model, points)
        y = model.predict(turning(points), amplitude).y
        e = (points.y - y) / noise_of(model, points, amplitude).sigma[:, -4:]
        out.append((points.name, points.speed_rad_s, float(np.sqrt(np.mean(np.abs(e) ** 2)))))
    return out


def _apart(model: RotatingModel, planes: dict[str, Selected], u: Uncertainty) -> float:
    worst, layout = 0.0, model.layout
    covariance = np.zeros((layout.size, layout.size))
    covariance[np.ix_(u.free, u.free)] = u.covariance
    for k, name in enumerate("xy"):
        own = planes[name]
        alone = uncertainty_of(own.refined, own.splits)
        std = np.sqrt(np.diag(alone.covariance)[:4] + np.diag(covariance)[layout.own[k].start :][:4])
        worst = max(worst, float(np.max(np.abs(model.plane(k).theta[:4] - own.refined.model.theta[:4]) / std)))
    return worst
