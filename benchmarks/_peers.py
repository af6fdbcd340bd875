"""Other tools on the same data: black boxes from the measured response, and two from a record in time.

Each peer gets what it asks for, at settings that its documentation or the common reference proposes; a tool that is not
installed is named and left out.
"""

from __future__ import annotations

import contextlib
import io
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from service.identification.measured.etfe import FrequencyResponse
from service.identification.plane.combine import plant_poles
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import PlaneResult
from service.identification.statistics.validation import nrmse_matrix
from service.identification.steps.subspace import subspace
from sim.reference import reference_rig
from sim.stepping import Simulation

Response = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Peer:
    """What one tool made of the data."""

    name: str
    seconds: float
    """CPU"""
    response: Response
    """(F,) rad/s -> (F, 2, 2)"""
    poles: np.ndarray
    """rad/s"""
    from_control: bool = False
    """Whether the model is from control current, amplifiers included, and not from coil current."""


@dataclass(frozen=True)
class Scores:
    """What one tool scores on one data set."""

    milliseconds: float
    fit: np.ndarray
    """(4,) NRMSE on data that the tool has not seen, percent."""
    rms: np.ndarray
    """(4,) residual over noise, of the same."""
    error: np.ndarray
    """(4,) distance from the true response over noise."""
    unstable: tuple[int, int]
    """Unstable poles, of how many."""
    off: np.ndarray
    """Distance of the nearest pole from each unstable one of the truth, percent."""
    zeta: np.ndarray
    """(2,) percent; nan where no pole is near the mode."""


@dataclass(frozen=True)
class Case:
    """One data set, and what was made of it here."""

    plane: PlaneResult
    joint: tuple[float, float, PlaneModel]
    """CPU of the joint fit alone and of its start, and its model."""
    whole_s: float
    """CPU of the whole procedure."""


def table(cases: list[Case], truth: PlaneModel, noise: float) -> None:
    """One table of time, fit, rms/sigma, pole and damping errors: medians of time, root mean squares of errors."""
    rows: dict[str, list[Scores]] = {}
    for seed, (case, other) in enumerate(zip(cases, [*cases[1:], cases[0]], strict=True)):
        plant, control, (seconds, start, model) = case.plane.curves.plant, other.plane.curves.measured, case.joint
        whole = case.plane.model
        own = [
            Peer("joint physical fit, 16 parameters", seconds, model.plant_response, plant_poles(model)),
            Peer("the same with its start", start + seconds, model.plant_response, plant_poles(model)),
            Peer("whole procedure with validation", case.whole_s, whole.plant_response, plant_poles(whole)),
            Peer("(truth)", 0.0, truth.plant_response, plant_poles(truth)),
        ]
        for peer in (*own, *peers(plant, noise, seed)):
            scores = _scores(peer, control if peer.from_control else other.plane.curves.plant, truth)
            rows.setdefault(peer.name, []).append(scores)
    print(
        f"\nPeers on the same data: {len(cases)} data sets of {2 * len(plant.omega)} points, {100 * noise:g} % noise\n"
        f"{'tool':40}{'CPU ms':>8}  {'NRMSE % 11/12/21/22':23}{'rms/sigma':>14}{'error/sigma':>14}{'unstable':>12}"
        f"{'poles off %':>18}{'zeta1, zeta2 off %':>20}"
    )
    for name, found in rows.items():
        fit, rms, error = (np.mean([getattr(s, key) for s in found], axis=0) for key in ("fit", "rms", "error"))
        off, zeta = (np.sqrt(np.mean([getattr(s, key) ** 2 for s in found], axis=0)) for key in ("off", "zeta"))
        bad, of = found[0].unstable
        print(
            f"{name:40}{np.median([s.milliseconds for s in found]):8.1f}  {'/'.join(f'{x:.1f}' for x in fit):23}"
            f"{f'{rms.min():.2f}-{rms.max():.4g}':>14}{f'{error.min():.2f}-{error.max():.4g}':>14}"
            f"{f'{bad} of {of}':>12}"
            f"{', '.join(f'{x:.2g}' for x in off):>18}"
            f"{', '.join('missed' if np.isnan(x) else f'{x:.2f}' for x in zeta):>20}"
        )
    print(
        "The joint fit is told the noise, as the subspace fits are; its start is the procedure's.\n"
        "NRMSE and rms/sigma are of the next data set, which the tool has not seen: of its own it may fit the noise.\n"
        "error/sigma is from the true response, of whose 8 poles 2 are unstable. One many sigma off leads in time only."
    )


def _scores(peer: Peer, measured: FrequencyResponse, truth: PlaneModel) -> Scores:
    """Scores of a tool's model on ``measured``, which it has not seen."""
    with np.errstate(all="ignore"):
        model = peer.response(measured.omega)
    fit = nrmse_matrix(measured.value, model).ravel()
    exact = (truth.response if peer.from_control else truth.plant_response)(measured.omega)
    rms, error = (
        np.sqrt(np.mean(np.abs((reference - model) / measured.std) ** 2, axis=0)).ravel()
        for reference in (measured.value, exact)
    )
    true = plant_poles(truth)
    found = peer.poles[np.isfinite(peer.poles)]
    unstable = [p for p in true if p.real > 1 and abs(p.imag) < 1]
    off = np.array([100 * np.min(np.abs(found - p)) / abs(p) for p in unstable])
    zetas = []
    for w in truth.modes[:2, 0]:
        here, there = (x[np.argmin(np.abs(x - 1j * w))] for x in (found, true))
        missed = abs(here - 1j * w) > 0.01 * w
        zetas.append(np.nan if missed else 100 * (here.real / abs(here) / (there.real / abs(there)) - 1))
    counts = int(np.sum(found.real > 1.0)), len(found)
    return Scores(1e3 * peer.seconds, fit, rms, error, counts, off, np.array(zetas))


def peers(plant: FrequencyResponse, noise: float, seed: int) -> Iterator[Peer]:
    """Every tool that is installed."""
    for order, rows in ((8, None), (12, 24)):
        spent = []
        for _ in range(7):
            begin = time.process_time()
            black = subspace(plant, order, rows)
            spent.append(time.process_time() - begin)
        yield Peer(f"own subspace (McKelvey), order {order}", float(np.median(spent)), black.response, black.poles)
    slow = (lambda _: _sippy("N4SID", 2.0, seed), lambda _: _sippy("PARSIM-K", 0.5, seed))
    for make in (_vector_fitting, lambda p: _aaa(p, noise), _loewner, *slow):
        try:
            with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
                warnings.simplefilter("ignore")
                peer = make(plant)
            yield peer
        except ImportError as error:
            print(f"(left out, with numpy {np.__version__}: {error}; make bench installs what pyproject.toml lists)")


def _vector_fitting(plant: FrequencyResponse) -> Peer:
    import skrf
    from skrf.vectorFitting import VectorFitting

    scale = np.abs(plant.value).max()
    network = skrf.Network(frequency=skrf.Frequency.from_f(plant.frequency_hz, unit="hz"), s=plant.value / scale, z0=50)
    begin = time.process_time()
    fitting = VectorFitting(network)
    fitting.vector_fit(n_poles_real=4, n_poles_cmplx=2)
    spent = time.process_time() - begin

    def response(omega: np.ndarray) -> np.ndarray:
        hz = omega / (2 * np.pi)
        return scale * np.array([[fitting.get_model_response(a, b, hz) for b in range(2)] for a in range(2)]).transpose(
            2, 0, 1
        )

    poles = np.asarray(fitting.poles)
    return Peer(
        "scikit-rf vector fitting, as shipped", spent, response, np.concatenate([poles, poles[poles.imag > 0].conj()])
    )


def _aaa(plant: FrequencyResponse, noise: float) -> Peer:
    from scipy.interpolate import AAA

    s = np.concatenate([1j * plant.omega, -1j * plant.omega])
    begin = time.process_time()
    found = [
        AAA(s, np.concatenate([plant.value[:, a, b], plant.value[:, a, b].conj()]), rtol=noise, clean_up=False)
        for a in range(2)
        for b in range(2)
    ]
    poles = np.concatenate([f.poles() for f in found])
    spent = time.process_time() - begin

    def response(omega: np.ndarray) -> np.ndarray:
        return np.stack([f(1j * omega) for f in found], axis=1).reshape(-1, 2, 2)

    return Peer(f"scipy AAA, four SISO, rtol {noise:g}", spent, response, poles)


def _loewner(plant: FrequencyResponse) -> Peer:
    from pymor.core.logger import set_log_levels
    from pymor.reductors.loewner import LoewnerReductor

    set_log_levels({"pymor": "ERROR"})
    begin = time.process_time()
    model = LoewnerReductor(1j * plant.omega, plant.value).reduce(r=40)
    poles = np.asarray(model.poles())
    spent = time.process_time() - begin

    def response(omega: np.ndarray) -> np.ndarray:
        return np.stack([model.transfer_function.eval_tf(1j * w) for w in omega])

    return Peer("pymor Loewner, r = 40", spent, response, poles)


def _record(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """u, A, and y, µm, of the x plane under random excitation with the loop closed, (N, 2) each."""
    rig = reference_rig()
    simulation, rng = Simulation(rig, seed=seed), np.random.default_rng(seed)
    r = np.zeros((round(seconds / rig.controller.sample_time_s), 4))
    r[:, :2] = 0.3 * rng.standard_normal((len(r), 2))
    record = simulation.advance(r)
    return record.u[:, :2], 1e6 * record.y[:, :2]


def _sippy(method: str, seconds: float, seed: int) -> Peer:
    from sippy_unipi import system_identification

    u, y = _record(seconds, seed)
    begin = time.process_time()
    model = system_identification(y.T, u.T, method, SS_fixed_order=12, SS_f=20, SS_p=20)
    spent = time.process_time() - begin
    period = reference_rig().controller.sample_time_s
    a, b, c, d = (np.asarray(x, dtype=float) for x in (model.A, model.B, model.C, model.D))
    with np.errstate(divide="ignore"):
        poles = np.log(np.linalg.eigvals(a).astype(complex)) / period

    def response(omega: np.ndarray) -> np.ndarray:
        z = np.exp(1j * omega * period)[:, None, None]
        return 1e-6 * (c @ np.linalg.solve(z * np.eye(len(a)) - a, np.broadcast_to(b + 0j, (len(omega), *b.shape))) + d)

    return Peer(f"SIPPY {method}, {seconds:g} s record, order 12", spent, response, poles, from_control=True)
