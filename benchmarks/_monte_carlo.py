"""Monte Carlo of the identification on the reference plant: against the Cramer-Rao bound, and against what it reports.

320 points as of the thesis (Tables 5-1, 5-3, 5-5 and Appendix A), noise relative to each signal. The datasheet's ki is
88 % off, ks 37 %.

u, i and y hardly tell how a mode's shape splits between bearings and sensors
(`service.identification.priors.split`). With a rotor model in the datasheet the splits are known, and a deviation is
noise: `splits_known` compares it with the bound. Without, the bound of an estimate from data alone is up to thousands
of times that, and what is assumed of shapes takes its place. `no_mode_known` compares the procedure with an estimator
that is told the exact noise and where to begin, and assumes the same: it has no more to learn. And `splits_drawn` asks
whether the reported deviations are what they say, by rotors whose splits are drawn from what is assumed.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.joint.refine import Refined, amplitude_of, refine
from service.identification.joint.residuals import Weights
from service.identification.joint.uncertainty import uncertainty_of
from service.identification.measured.data import Data
from service.identification.measured.points import plane_points
from service.identification.options import Options
from service.identification.plane.combine import levitated_frequencies
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Points
from service.identification.priors.split import Knowledge, Posterior, Split, log_prior, log_ratios
from service.identification.result.commissioning import PlaneResult
from service.identification.statistics.whitening import whitener
from service.identification.steps.nominal import split_knowledge
from service.identification.steps.start import with_split
from sim.datasheet import Datasheet, Mode, Tolerance
from sim.reference import reference_datasheet, reference_rig
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep

Real = NDArray[np.float64]

PARAMETERS = ("kiA", "kiB", "ksA", "ksB", "w1", "w2", "w1 levitated", "w2 levitated", "zeta1", "zeta2")
INSIDE = 1.96
SPLITS = np.linspace(-1.5, 1.5, 601)
"""ln(|phi_s|/|phi_b|) among which a rotor's are drawn: beyond, a shape at a sensor is four times that beside it."""


def frequencies() -> Real:
    """The lines of a sweep, Hz."""
    peaks = [hz + np.linspace(-6, 6, 15) for hz in (492.6, 907.2)]
    return np.unique(np.concatenate([np.geomspace(10, 1000, 130), *peaks]))


def reference_plane() -> PlaneModel:
    """Plane x of the reference rig."""
    return plane_model_of(reference_rig(), "x")


def experiment(noise: float, seed: int, truth: PlaneModel | None = None) -> Experiment:
    """A sweep of plane x, of the reference plane by default; ``noise`` relative to each signal."""
    sheet = reference_datasheet()
    planes = {"x": truth or reference_plane(), "y": plane_model_of(reference_rig(), "y")}
    sweep = synthetic_sweep(
        planes,
        sheet.axes,
        (np.array(sheet.numerator), np.array(sheet.denominator)),
        frequencies(),
        0.05,
        current_noise_a=0.0,
        displacement_noise_m=0.0,
        relative_noise=noise,
        seed=seed,
    )
    # whole periods of at least 0.3 s, as a campaign records them and says so
    block_s = np.ceil(0.3 * sweep.frequency_hz) / sweep.frequency_hz
    sweep = replace(sweep, block_samples=np.round(block_s * sweep.sample_rate_hz).astype(np.int64))
    return synthetic_experiment(sweep.select(sweep.axis < 2), axes=sheet.axes)


def figures(model: PlaneModel) -> Real:
    """The values of `PARAMETERS`."""
    w = model.natural_frequencies
    return np.concatenate([model.ki, model.ks, w[:2], levitated_frequencies(model)[:2], model.damping_ratios[:2]])


def told_the_noise(
    data: Experiment, truth: PlaneModel, noise: float, held: Split | Knowledge | None = None, max_iterations: int = 60
) -> Refined:
    """The joint fit by an estimator that is told what nobody knows: the exact noise, and where to begin.

    With splits held as they are, or assumed as the procedure assumes them. On the same data it draws the same lots:
    what a ratio of some hundred runs owes to chance is in both, and cancels in their difference.
    """
    points = Data(plane_points(data.main, reference_datasheet().axes, "x"))
    p = truth.predict(Points(points.plant.omega, points.plant.u), amplitude_of(truth, points.plant))
    size = noise * np.abs(np.hstack([p.i, p.y]))
    weights = Weights(whitener(np.einsum("pc,cd->pcd", size**2, np.eye(4)).astype(complex)), None)
    held = held or Split(log_ratios(truth))
    return refine(
        truth,
        points,
        truth.layout.free(),
        weights=weights,
        split=held,
        max_iterations=max_iterations,
        following=isinstance(held, Knowledge),
    )


def bound(truth: PlaneModel, noise: float) -> Real:
    """Cramer-Rao bound with the exact noise, the shapes' splits held."""
    fit = told_the_noise(experiment(noise, 0), truth, noise, max_iterations=1)
    return uncertainty_of(fit, Posterior(log_ratios(truth), np.zeros((2, 2)))).std(truth, figures)[1]


def assumed(sheet: Datasheet) -> Knowledge:
    """What the procedure assumes of splits with a datasheet."""
    return replace(split_knowledge(sheet, Options()), end_rad_s=float(2 * np.pi * frequencies().max()))


def with_rotor_model(sheet: Datasheet) -> Datasheet:
    """The datasheet with the rotor model's modes, whose shapes split as the rotor's do."""
    truth = reference_plane()
    modes = tuple(
        Mode(w / (2 * np.pi) * 1.005, 0.002, (m[2], m[3]), (m[4], m[5]))
        for m, w in zip(truth.modes, truth.natural_frequencies, strict=True)
    )
    return replace(sheet, modes=modes, tolerance=Tolerance(mode_shape=1e-4))


@dataclass(frozen=True)
class Runs:
    """What came of many runs: (runs, parameters) each."""

    exact: Real
    found: Real
    std: Real
    """Reported."""
    part: Real
    """Of it, what noise brings with the splits held."""
    told: Real
    """Of the estimator that is told the noise."""
    failed: int
    """Runs that did not find two modes; they are in none of the arrays."""
    seconds: Real
    """CPU per plane."""

    @property
    def spread(self) -> Real:
        """Standard deviation of what was found, (parameters,)."""
        return np.asarray(self.found.std(axis=0, ddof=1))

    def ends(self) -> None:
        """What is said below a table."""
        print(
            f"runs that did not find two modes: {self.failed}; "
            f"CPU per plane: median {np.median(self.seconds):.2f} s, max {max(self.seconds):.2f} s"
        )


def runs(seeds: range, noise: float, sheet: Datasheet, held: Knowledge | None, drawn: bool = False) -> Runs:
    """Identify many experiments; ``drawn``: of rotors whose splits are drawn from ``held``."""
    truth = reference_plane()
    rows, seconds, failed = [], [], 0
    for seed in seeds:
        if drawn:
            assert held is not None
            truth = with_drawn_splits(reference_plane(), held, seed)
        data = experiment(noise, seed, truth)
        start = time.process_time()
        plane = identify(data, sheet).planes["x"]
        seconds.append(time.process_time() - start)
        if len(plane.modes) != 2:
            failed += 1
            continue
        told = figures(told_the_noise(data, truth, noise, held).model)
        rows.append((figures(truth), *of_result(plane), told))
    exact, found, std, part, by_told = (np.array(x) for x in zip(*rows, strict=True))
    return Runs(exact, found, std, part, by_told, failed, np.array(seconds))


def of_result(plane: PlaneResult) -> tuple[Real, Real, Real]:
    """Value, reported std, and its part from data alone."""
    s, m = plane.stiffness, plane.modes[:2]
    found = [s["kiA"], s["kiB"], s["ksA"], s["ksB"]]
    found += [x.natural_frequency_rad_s for x in m] + [x.levitated_frequency_rad_s for x in m]
    found += [x.damping_ratio for x in m]
    value, std, data = np.array([(e.value, e.std, e.std_from_data) for e in found], dtype=float).T
    return value, std, data


def with_drawn_splits(model: PlaneModel, held: Knowledge, seed: int) -> PlaneModel:
    """The plane with splits drawn from what is assumed of them, mode by mode; the products of shapes stay."""
    density = np.exp(log_prior(model, np.repeat(SPLITS[:, None], model.layout.n_modes, axis=1), held))
    below = np.cumsum(density / density.sum(axis=0), axis=0)
    drawn = np.random.default_rng(seed).random(model.layout.n_modes)
    ratios = [np.interp(q, below[:, k], SPLITS) for k, q in enumerate(drawn)]
    return with_split(model, np.array(ratios))


def splits_known(seeds: range, noise: float) -> None:
    """Table of what noise does where the splits are known, against the Cramer-Rao bound."""
    r = runs(seeds, noise, with_rotor_model(reference_datasheet()), None)
    crb = bound(reference_plane(), noise)
    _title("shapes' splits known", seeds, noise)
    paired = np.sqrt(1 + np.var(r.found - r.told, axis=0, ddof=1) / crb**2)
    _table(
        {
            "bias/sd": (r.found.mean(axis=0) - r.exact[0]) / r.spread,
            "sd %": 100 * r.spread / r.exact[0],
            "sd/CRB": r.spread / crb,
            "told/CRB": r.told.std(axis=0, ddof=1) / crb,
            "paired": paired,
            "reported/sd": r.part.mean(axis=0) / r.spread,
            "reported/paired": r.part.mean(axis=0) / (crb * paired),
            "cover 95 %": np.mean(np.abs(r.found - r.found.mean(axis=0)) < INSIDE * r.part, axis=0),
            "reported": np.mean(np.abs(r.found - r.exact) < INSIDE * r.std, axis=0),
        }
    )
    print("told: an estimator that is told the exact noise, on the same runs: its own ratio to the bound is chance")
    print(
        "paired: sd/CRB from the differences to it, which an efficient estimate does not correlate with: little chance"
    )
    print("reported/paired: reported sd over the bound times paired, the Monte Carlo sd without most of its chance")
    print("coverage: noise's own 95 % intervals about the mean; reported: whole intervals about the truth")
    r.ends()


def no_mode_known(seeds: range, noise: float) -> None:
    """Table of the same rotor in every run, its splits unknown, beside an estimator that is told the noise."""
    sheet = reference_datasheet()
    r = runs(seeds, noise, sheet, assumed(sheet))
    _title("no mode known", seeds, noise)
    told = r.told.std(axis=0, ddof=1)
    _table(
        {
            "bias/sd": (r.found.mean(axis=0) - r.exact[0]) / r.spread,
            "sd %": 100 * r.spread / r.exact[0],
            "sd/told": r.spread / told,
            "paired": np.sqrt(1 + np.var(r.found - r.told, axis=0, ddof=1) / told**2),
            "reported": np.mean(np.abs(r.found - r.exact) < INSIDE * r.std, axis=0),
        }
    )
    print("told: an estimator that is told the exact noise and assumes the same of splits, on the same runs")
    print("reported: share of whole 95 % intervals about the truth. Rotor and splits are the same in every run: where")
    print("they are most of a deviation, intervals cover always or, one rotor in twenty, never")
    r.ends()


def splits_drawn(seeds: range, noise: float) -> None:
    """Table of rotors whose splits are drawn: whether the reported deviations are what they say."""
    sheet = reference_datasheet()
    r = runs(seeds, noise, sheet, assumed(sheet), drawn=True)
    _title("no mode known, splits drawn from what is assumed of them", seeds, noise)
    z = (r.found - r.exact) / r.std
    _table(
        {
            "rms error %": 100 * np.sqrt(np.mean((r.found / r.exact - 1) ** 2, axis=0)),
            "reported %": 100 * np.sqrt(np.mean((r.std / r.exact) ** 2, axis=0)),
            "mean z": z.mean(axis=0),
            "rms z": np.sqrt(np.mean(z**2, axis=0)),
            "cover 50 %": np.mean(np.abs(z) < 0.6745, axis=0),
            "cover 95 %": np.mean(np.abs(z) < INSIDE, axis=0),
        }
    )
    print("z: error over reported standard deviation, splits included")
    r.ends()


def _title(what: str, seeds: range, noise: float) -> None:
    print(
        f"\nMonte Carlo, {what}: {len(seeds)} runs, {100 * noise:g} % noise, {len(frequencies()) * 2} points, "
        "6 blocks, from the datasheet"
    )


def _table(columns: dict[str, Real]) -> None:
    print(f"{'':14}" + "".join(f"{h:>16}" for h in columns))
    for k, name in enumerate(PARAMETERS):
        row = (f"{x[k]:16.4f}" if "%" in h and "cover" not in h else f"{x[k]:16.3f}" for h, x in columns.items())
        print(f"{name:14}" + "".join(row))
