"""Starting values of an effect, found in what the twin leaves unexplained.

A resonance starts where the twin fails most, a slew limit at the largest rate of current, a stop at the clearance
whose force answers best to the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import displacement_jacobian, residue_columns, stacked
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import current, linear_answer, weight, whole_displacement
from service.gap.measured.observation import Observation
from sim import imbalance
from sim.effect import Effect
from sim.rig import Rig

Complex = NDArray[np.complex128]

CLEARANCES = (0.3, 0.45, 0.6, 0.75, 0.9)
"""Shares of each axis's largest displacement at which a stop is looked for."""
DAMPED = 0.02
"""Damping ratio of a resonance that is looked for: wide enough not to fall between two lines."""
DAMPINGS = (0.001, 0.003, 0.006, 0.06)
"""Those at which the best is looked at more closely: it may stand between two lines and show at one of them alone..."""
BESIDE = 17
"""... at so many frequencies from the one beside it to the other."""
APART = 8
"""Frequencies looked at, lines and what lies between two, between which a second resonance is not looked for."""
SLIGHT = 1e-3
"""Drift that is tried: small enough for its answer to be proportional."""
SLEWS = tuple(np.geomspace(0.7, 1.02, 25).tolist())
"""Shares of the largest slope of a current's excited frequency at which a slew limit is looked for: a current that
slews all the time is a triangle, 4/pi as steep in this as it is."""
SEEN = (0.0, 0.5, 1.0)
"""Shares of a current loop's damping that act on the slope the coil has, of the loops that are tried."""
SOFT = 0.02
"""Stiffness of the stop that is tried, as a share of the magnets': small enough for its answer to be proportional."""


def peaks_of_failure(z: Complex, o: Observation, count: int = 2) -> list[float]:
    """Frequencies where a twin leaves most unexplained, Hz, largest first; z (P, H, n) weighted residuals."""
    total = np.bincount(
        o.line, weights=np.log1p(np.abs(z[:, o.fundamental]) ** 2).sum(axis=1), minlength=len(o.frequency_hz)
    )
    per_line = total / np.maximum(np.bincount(o.line, minlength=len(o.frequency_hz)), 1)
    padded = np.pad(per_line, 1, constant_values=-np.inf)  # a line at the end has one neighbour, one alone none
    inner = (per_line >= padded[:-2]) & (per_line >= padded[2:])
    order = np.argsort(np.where(inner, -per_line, 0.0))
    return [float(o.frequency_hz[k]) for k in order[:count]]


def starts(effect: Effect, rig: Rig, z: Complex, o: Observation, ground: Ground) -> list[dict[str, float]]:
    """Starting values of an effect's parameters, several where its answer has several valleys.

    ``z`` (P, H, n) are the weighted residuals that ``rig`` leaves and the effect is to explain.
    """
    effect = effect.of(ground.nuisance.rig)
    base = {
        p.name: p.typical if p.scale == "log" or not p.strength else p.null + 0.2 * (p.typical - p.null)
        for p in effect.parameters
    }
    if effect.id in ("support_resonance", "extra_flexible_mode"):
        found = resonances(effect, rig, z, o, ground)
        others = (peaks_of_failure(z, o, 1)[0], base["frequency_hz"])
        return [{**base, **f} for f in (*found, *({"frequency_hz": f} for f in dict.fromkeys(others)))]
    if effect.id == "amplifier_bandwidth":  # the largest change is stated: on which side that is, is another valley
        sides = product(*((0.0, -0.5) for name in imbalance.NAMES[: rig.n_planes]))
        return [{**base, **dict(zip(imbalance.NAMES, side, strict=False))} for side in sides]
    if effect.id == "eddy_currents":
        return [base, {**base, "time_constant_s": 1e-5, "corner_rad_s": 2e4}]
    if effect.id == "touchdown_contact":
        return stops(effect, base, rig, z, o)
    if effect.id == "amplifier_voltage_limit":
        return slews(effect, rig, z, o)
    if effect.id == "magnetic_saturation":
        saturation = next(p for p in effect.parameters if p.name == "saturation_inverse_per_a")
        by_flux = {"saturation_inverse_per_a": saturation.low, "flux_power": 5.0}
        return [{**base, "flux_share": 0.0}, *({**by_flux, "flux_share": share} for share in (0.35, 0.5, 0.7))]
    if effect.id == "magnetic_hysteresis":
        flux = float(np.quantile(np.abs(o.U if o.I is None else o.I)[:, o.fundamental].max(axis=1), 0.9))
        middles = (0.25 * flux, 0.6 * flux)
        return [base, *({**base, "narrowest_a": 0.5 * m, "widest_inverse_per_a": 1 / (1.5 * m)} for m in middles)]
    if effect.id == "thermal_drift":
        if rig.drift is not None:  # stated over the same time
            duration = next(p for p in effect.parameters if p.name == "duration_s")
            base["duration_s"] = float(np.clip(rig.drift.duration_s, duration.low, duration.high))
        return [drifts(effect, base, rig, z, o, ground)]
    if effect.id == "off_centre_rotor":
        return [{k: sign * v for k, v in base.items()} for sign in (1.0, -1.0)]
    return [base]


def slews(effect: Effect, rig: Rig, z: Complex, o: Observation) -> list[dict[str, float]]:
    """For each kind of current loop the slew limit that leaves least, best first; z (P, H, n) as of `starts`.

    Near the limit of a loop that winds up the current jumps to lag by half a period, so its valley is narrow. Where
    the current was not logged, limits are not told so finely.
    """
    rate, limits = largest_rate(o, rig), {p.name: p for p in effect.parameters}["slew_inverse_s_per_a"]

    def values(share: float, seen: float) -> dict[str, float]:
        inverse = float(np.clip(1 / (share * rate), limits.low, limits.high))
        return {"slew_inverse_s_per_a": inverse, "slope_seen": seen}

    if o.I is None or np.isfinite(rig.amplifiers.slew_limit_a_per_s).any():
        return [values(share, seen) for share in (0.9, np.pi / 4) for seen in (0.1, 0.9)]
    without, w = current(rig, o), weight(o, "i")
    kinds = SEEN[:1] if rig.amplifiers.damping_ratio is None else SEEN

    def left(one: dict[str, float]) -> float:
        change = (current(effect.on(rig, **one), o) - without) * w
        return float(np.sum(np.abs(z - change) ** 2))

    best = [min(((left(v := values(s, seen)), v) for s in SLEWS), key=lambda one: one[0]) for seen in kinds]
    return [v for _, v in sorted(best, key=lambda one: one[0])]


def largest_rate(o: Observation, rig: Rig | None = None) -> float:
    """Largest slope of the coil current, A/s.

    Where the current was not logged it is that of the small-signal ``rig``, or else of the control signal.
    """
    if o.I is not None or rig is None:
        currents = (o.U if o.I is None else o.I)[:, o.fundamental]
    else:  # of an amplifier far above its bandwidth, much less than the control signal asks for
        currents = linear_answer(rig, o)[:, : rig.n_axes]
    return float((np.abs(currents).max(axis=1) * 2 * np.pi * o.points_hz).max())


def resonances(
    effect: Effect, rig: Rig, z: Complex, o: Observation, ground: Ground, count: int = 2
) -> list[dict[str, float]]:
    """Where one more resonance would explain most that the datasheet's values cannot, best first.

    A score test: the resonance is so light that its answer is proportional to its residues, and what the values of the
    datasheet could do as well is projected out. A housing moves both ends alike; what is ``shaped`` moves them by the
    residue of rank one that is nearest, and gets that shape.
    """
    shaped = effect.id == "extra_flexible_mode"
    if rig.support is not None and not shaped:
        return []
    f, w, basis = o.fundamental, weight(o, "y")[:, o.fundamental], _basis(rig, o, ground)
    columns = residue_columns(rig, o) * w[..., None, None]
    columns = columns.reshape(*w.shape, 4) if shaped else columns.sum(axis=(2, 3))[..., None]
    wanted, s = stacked(z[:, f, :, None]), 2j * np.pi * o.points_hz
    wanted -= basis @ (basis.T @ wanted)

    def score(own_hz: float, damping_ratio: float) -> tuple[float, NDArray[np.float64]]:
        own = 2 * np.pi * own_hz
        light = stacked(columns / (s**2 + 2 * damping_ratio * own * s + own**2)[:, None, None])
        along, known = (light.T @ wanted)[:, 0], basis.T @ light
        power = light.T @ light - known.T @ known
        residue = np.linalg.solve(power + 1e-9 * np.trace(power) * np.eye(len(power)), along)
        return float(along @ residue) if shaped or residue[0] > 0 else 0.0, residue

    between = np.sqrt(o.frequency_hz[:-1] * o.frequency_hz[1:])
    grid = np.sort(np.concatenate([o.frequency_hz, between]))
    order = np.argsort([-score(own, DAMPED)[0] for own in grid])
    best = [int(order[0])]
    best += [int(k) for k in order if abs(int(k) - best[0]) > APART][: count - 1]
    found = []
    for k in best:
        low, high = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        tried = [(own, damping) for damping in (DAMPED, *DAMPINGS) for own in np.geomspace(low, high, BESIDE)]
        own, damping = max(tried, key=lambda at: score(*at)[0])
        shape = _shape(effect, score(own, damping)[1]) if shaped else {}
        found.append({"frequency_hz": float(own), "damping_ratio": float(damping), **shape})
    return found


def _basis(rig: Rig, o: Observation, ground: Ground) -> NDArray[np.float64]:
    """What the datasheet's values can do within their tolerances to a sweep's weighted fundamentals, (2 P n, a).

    Columns are orthonormal together with the tolerances as data, so that what is projected on them is what is left of
    it once the values have followed.
    """
    w = weight(o, "y")[:, o.fundamental]
    J = displacement_jacobian(ground.nuisance, rig, o, ground.part.from_control)[:, :, ground.part.active]
    rows = stacked(J * w[..., None])
    return np.linalg.qr(np.concatenate([rows, np.eye(rows.shape[1])]))[0][: len(rows)]


def drifts(
    effect: Effect, base: dict[str, float], rig: Rig, z: Complex, o: Observation, ground: Ground
) -> dict[str, float]:
    """The drift of magnets, and which of them drift most, that explains most that the datasheet's values cannot.

    Of a small drift the answer is proportional to each axis's, so eight answers tell those of all.
    """
    f, w, basis = o.fundamental, weight(o, "y")[:, o.fundamental], _basis(rig, o, ground)
    without, corners = whole_displacement(rig, o)[:, f], list(product((1.0, -1.0), repeat=rig.n_planes))

    def answer(factor: str, corner: tuple[float, ...]) -> NDArray[np.float64]:
        of = dict(zip(imbalance.NAMES, corner, strict=False))
        small = {**base, "ki_change": 0.0, "ks_change": 0.0, **of, factor: SLIGHT}
        change = (whole_displacement(effect.on(rig, **small), o)[:, f] - without) * w / SLIGHT
        return stacked(change[..., None])[:, 0]

    columns = np.stack([answer(factor, c) for factor in ("ki_change", "ks_change") for c in corners], axis=-1)
    wanted = stacked(z[:, f, :, None])[:, 0]
    known = basis.T @ columns
    power = columns.T @ columns - known.T @ known
    along = columns.T @ wanted - known.T @ (basis.T @ wanted)

    def strengths(imbalances: Sequence[float]) -> tuple[float, dict[str, float]]:
        """Chi-square that the best ki and ks with such imbalances take off, and these."""
        share = np.array([np.prod([(1 + s * i) / 2 for s, i in zip(c, imbalances, strict=True)]) for c in corners])
        split = np.kron(np.eye(2), share[:, None])
        found = np.linalg.lstsq(split.T @ power @ split, split.T @ along)[0]
        names = (*imbalance.NAMES[: len(corners[0])], "ki_change", "ks_change")
        return float(found @ split.T @ along), dict(zip(names, (*imbalances, *found), strict=True))

    grid = product(np.linspace(-1.0, 1.0, 9), repeat=rig.n_planes)
    best = max((strengths(imbalances) for imbalances in grid), key=lambda one: one[0])[1]
    known_by = {p.name: p for p in effect.parameters}
    return {**base, **{name: float(np.clip(v, known_by[name].low, known_by[name].high)) for name, v in best.items()}}


def _shape(effect: Effect, residue: NDArray[np.float64]) -> dict[str, float]:
    """The mode shape whose residue, (4,), is nearest: displacement at A and B for forces at A, then at B."""
    u, size, v = np.linalg.svd(residue.reshape(2, 2))
    at_sensors, at_bearings = np.sqrt(size[0]) * u[:, 0], np.sqrt(size[0]) * v[0]
    known = {p.name: p for p in effect.parameters}
    shapes = {
        f"{place}_{end}_per_sqrt_kg": float(shape[k])
        for place, shape in (("sensor", at_sensors), ("bearing", at_bearings))
        for k, end in enumerate("AB")
    }
    return {name: float(np.clip(v, known[name].low, known[name].high)) for name, v in shapes.items()}


def stops(
    effect: Effect, base: dict[str, float], rig: Rig, z: Complex, o: Observation, count: int = 2
) -> list[dict[str, float]]:
    """The clearances and sides, best first, whose soft stop answers most to the residuals, with the fitting stiffness.

    The force of a stop is proportional to its stiffness where the rotor was seen to move, so one soft stop tells
    the best stiffness of each clearance by linear regression.
    """
    if rig.contact is not None:
        return [base]
    swing = np.abs(o.Y[:, o.fundamental]).max(axis=0)
    soft = SOFT * float(np.max(rig.magnets.ks))
    known = {p.name: p for p in effect.parameters}
    limits = known["stiffness_n_per_m"]
    without, w = whole_displacement(rig, o), weight(o, "y")
    found = []
    for share in CLEARANCES:
        clearances = {
            name: float(np.clip(share * s, known[name].low, known[name].high))
            for name, s in zip((f"clearance_{axis}_m" for axis in rig.axes), swing, strict=True)
        }
        for side in (0.0, 1.0, -1.0):
            values = {**base, **clearances, "side": 0.9 * side, "stiffness_n_per_m": max(soft, limits.low)}
            change = (whole_displacement(effect.on(rig, **values), o) - without) * w
            power = float(np.vdot(change, change).real)
            along = float(np.vdot(change, z).real)
            if along <= 0 or power <= 0:
                continue
            stiffness = values["stiffness_n_per_m"] * along / power
            values["stiffness_n_per_m"] = float(np.clip(stiffness, limits.low, limits.high))
            found.append((along**2 / power, values))
    found.sort(key=lambda f: -f[0])
    return [values for _, values in found[:count]] or [base]
