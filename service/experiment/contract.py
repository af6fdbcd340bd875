"""The contract of an experiment file: raw datasets of one sweep to a `Sweep`, or one line that says what is wrong.

No file format here: HDF5, MATLAB and tests all hand over plain dictionaries of datasets and attributes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.experiment.demodulate import BLOCKS, HARMONICS, demodulate, time_origin, whole_periods
from service.experiment.errors import ExperimentFileError
from service.experiment.speeds import impossible
from service.remarks import shown

FORMAT = "amb-experiment"
VERSION = 1
KINDS = ("stepped-sine", "multisine", "noise")
MIN_BLOCKS = 2
"""The scatter across blocks is the only measure of noise: one block has none."""
SPECTRAL_BLOCKS = BLOCKS


def text(value: Any) -> str:
    """Text of an attribute or scalar dataset, whatever string type the file used; what is no text in it is marked."""
    if isinstance(value, np.ndarray):
        value = value.item() if value.size == 1 else "".join(str(v) for v in value.ravel())
    decoded = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return shown(decoded)


def number(where: str, name: str, value: Any) -> float:
    """Finite number of an attribute, or an error that names it."""
    try:
        result = float(np.asarray(value).reshape(-1)[0]) if np.size(value) == 1 else float("nan")
    except (TypeError, ValueError):
        result = float("nan")
    if not np.isfinite(result):
        raise ExperimentFileError(f"{where}: attribute {name} must be one finite number, not {_shown(value)}")
    return result


def _shown(value: Any) -> str:
    """A value as an error shows it."""
    return repr(value.item() if isinstance(value, np.generic) else value)


def format_and_version(where: str, format_: Any, version: Any) -> None:
    """Refuse another format or a version that this program does not know."""
    if text(format_) != FORMAT:
        raise ExperimentFileError(f'{where}: attribute format is {text(format_)!r}; it must be "{FORMAT}"')
    if number(where, "version", version) != VERSION:
        raise ExperimentFileError(
            f"{where}: version {text(version)} is unknown; this program reads version {VERSION}: export it as that"
        )


class _Datasets:
    """Datasets of one sweep under names that error messages use."""

    def __init__(self, where: str, datasets: Mapping[str, Any], n_axes: int) -> None:
        self.where, self.datasets, self.n_axes = where, datasets, n_axes

    def fail(self, name: str, problem: str) -> ExperimentFileError:
        return ExperimentFileError(f"{self.where}/{name} {problem}")

    def array(self, name: str, dtype: type[np.generic]) -> NDArray[Any]:
        """A dataset that must exist, be numeric and finite."""
        if name not in self.datasets:
            raise self.fail(name, "is missing; write it as docs/experiment-file.md says")
        raw = np.asarray(self.datasets[name])
        if raw.dtype.kind not in "iufcb":
            raise self.fail(name, f"has type {raw.dtype}; it must hold numbers")
        if raw.dtype.kind == "c" and not np.issubdtype(dtype, np.complexfloating):
            raise self.fail(name, "is complex; it must be real")
        value = raw.astype(dtype)
        bad = ~np.isfinite(value)
        if bad.any():
            first = tuple(int(k) for k in np.argwhere(bad)[0])
            raise self.fail(
                name,
                f"has {int(bad.sum())} values that are not finite, the first at {first}; measure those again",
            )
        return value

    def vector(self, name: str, length: int | None = None) -> NDArray[np.float64]:
        value = self.array(name, np.float64)
        if value.ndim != 1 or (length is not None and len(value) != length):
            wanted = "(P,)" if length is None else f"({length},)"
            raise self.fail(name, f"has shape {value.shape}; it must be {wanted}, one value for each point")
        return value

    def integers(self, name: str, length: int | None = None) -> NDArray[np.int64]:
        value = self.vector(name, length)
        if np.any(value != np.round(value)):
            raise self.fail(name, "must hold whole numbers")
        return value.astype(np.int64)


def sweep(where: str, datasets: Mapping[str, Any], attributes: Mapping[str, Any], n_axes: int) -> Sweep:
    """One sweep, demodulated, from its datasets and attributes.

    Parameters
    ----------
    where
        File and group, the start of every error message.
    datasets
        Arrays by the names of the contract; "flags" is optional.
    attributes
        kind, sample_rate_hz, speed_rad_s, comment.
    n_axes
        Number of axes of the experiment.

    Raises
    ------
    ExperimentFileError
        Anything that breaks the contract.
    """
    for name in ("kind", "sample_rate_hz", "speed_rad_s"):
        if name not in attributes:
            raise ExperimentFileError(f"{where}: attribute {name} is missing; add it as docs/experiment-file.md says")
    kind = text(attributes["kind"])
    if kind not in KINDS:
        raise ExperimentFileError(f"{where}: attribute kind is {kind!r}; it must be one of {', '.join(KINDS)}")
    rate = number(where, "sample_rate_hz", attributes["sample_rate_hz"])
    if rate <= 0:
        raise ExperimentFileError(f"{where}: attribute sample_rate_hz is {rate:g}; it must be positive")
    d = _Datasets(where, datasets, n_axes)
    frequency, axis, amplitude = _points(d, rate, kind)
    flags = _flags(d, len(frequency))
    block_samples = _block_samples(d, frequency, rate) if "block_samples" in datasets else None
    time_s = d.vector("time_s", len(frequency)) if "time_s" in datasets else None
    speeds = _speeds(d, len(frequency)) if "point_speed_rad_s" in datasets else None
    kurtosis = d.vector("kurtosis", n_axes) if "kurtosis" in datasets else None
    shared: dict[str, Any] = {
        "kind": kind,
        "speed_rad_s": _speed(where, attributes["speed_rad_s"]),
        "sample_rate_hz": rate,
        "comment": text(attributes.get("comment", "")),
    }
    if "R" in datasets or "U" in datasets or "Y" in datasets:
        harmonics, values = _demodulated(d, axis, amplitude, excited=kind != "noise")
    elif "sample_start" in datasets or "r" in datasets:
        frequency, axis, amplitude, harmonics, values = _records(d, frequency, axis, amplitude, rate, kind)
        if kind == "noise":  # its points are now spectral lines
            flags, block_samples, time_s, speeds = (), None, None, None
    else:
        raise ExperimentFileError(
            f"{where} holds neither records (sample_start, r, u, i, y) nor demodulated blocks (harmonics, R, U, I, Y)"
        )
    return Sweep(
        frequency_hz=frequency,
        axis=axis,
        amplitude_a=amplitude,
        harmonics=harmonics,
        flags=flags,
        block_samples=block_samples,
        time_s=time_s,
        point_speed_rad_s=speeds,
        kurtosis=kurtosis,
        phase_rad=_phases(d, values["R"]) if "phase_rad" in datasets else None,
        **values,
        **shared,
    )


def _points(d: _Datasets, rate: float, kind: str) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    frequency = d.vector("frequency_hz")
    if not len(frequency):
        raise d.fail("frequency_hz", "has no points; measure at least one")
    axis = d.integers("axis", len(frequency))
    amplitude = d.vector("amplitude_a", len(frequency))
    if kind != "noise" and np.any(frequency <= 0):
        raise d.fail("frequency_hz", f"holds {frequency.min():g} Hz; every excited frequency must be positive")
    if np.any(frequency < 0):
        raise d.fail("frequency_hz", f"holds {frequency.min():g} Hz; a frequency must not be negative")
    if np.any(frequency >= rate / 2):
        raise d.fail(
            "frequency_hz",
            f"holds {frequency.max():g} Hz, at or above the Nyquist frequency {rate / 2:g} Hz; "
            "check the unit and sample_rate_hz",
        )
    if np.any((axis < 0) | (axis >= d.n_axes)):
        wrong = int(axis[(axis < 0) | (axis >= d.n_axes)][0])
        raise d.fail("axis", f"holds {wrong}; it must index the {d.n_axes} axes, 0 to {d.n_axes - 1}")
    if np.any(amplitude < 0):
        raise d.fail("amplitude_a", f"holds {amplitude.min():g} A; an amplitude must not be negative")
    return frequency, axis, amplitude


def _block_samples(d: _Datasets, frequency: NDArray[np.float64], rate: float) -> NDArray[np.int64]:
    samples = d.integers("block_samples", len(frequency))
    short = (samples < 1) | (np.round(frequency * samples / rate) < np.sign(frequency))
    if short.any():
        point = int(np.argmax(short))
        raise d.fail(
            "block_samples",
            f"holds {samples[point]} at point {point}, which is no period of {frequency[point]:g} Hz; a block has "
            "whole periods: check its unit and sample_rate_hz",
        )
    return samples


def _speed(where: str, value: Any) -> float:
    speed_rad_s = number(where, "speed_rad_s", value)
    if why := impossible(speed_rad_s):
        raise ExperimentFileError(f"{where}: attribute speed_rad_s {why}")
    return speed_rad_s


def _speeds(d: _Datasets, n_points: int) -> NDArray[np.float64]:
    speeds = d.vector("point_speed_rad_s", n_points)
    fastest = int(np.argmax(np.abs(speeds)))
    if why := impossible(float(speeds[fastest])):
        raise d.fail("point_speed_rad_s", f"of point {fastest} {why}")
    return speeds


def _phases(d: _Datasets, R: NDArray[np.complex128]) -> NDArray[np.float64]:
    phase = d.array("phase_rad", np.float64)
    if phase.shape != R.shape[:2]:
        raise d.fail("phase_rad", f"has shape {phase.shape}; it must be {R.shape[:2]}: points, blocks")
    return np.asarray(phase)


def _flags(d: _Datasets, n_points: int) -> tuple[str, ...]:
    if "flags" not in d.datasets:
        return ()
    raw = np.atleast_1d(np.asarray(d.datasets["flags"], dtype=object)).ravel()
    if len(raw) != n_points:
        raise d.fail("flags", f"has {len(raw)} values; it must have one for each of the {n_points} points")
    return tuple(text(v) for v in raw)


def _demodulated(
    d: _Datasets, axis: NDArray[np.int64], amplitude: NDArray[np.float64], excited: bool
) -> tuple[tuple[int, ...], dict[str, Any]]:
    harmonics = tuple(int(h) for h in d.integers("harmonics"))
    if 1 not in harmonics or len(set(harmonics)) != len(harmonics) or min(harmonics) < 0:
        raise d.fail("harmonics", f"is {list(harmonics)}; it must hold 1 and no number twice, none negative")
    R = d.array("R", np.complex128)
    n_points = len(axis)
    wanted = f"({n_points}, B, {len(harmonics)}, {d.n_axes})"
    if R.ndim != 4 or (R.shape[0], R.shape[2], R.shape[3]) != (n_points, len(harmonics), d.n_axes):
        raise d.fail("R", f"has shape {R.shape}; it must be {wanted}: points, blocks, harmonics, axes")
    if R.shape[1] < MIN_BLOCKS:
        raise d.fail("R", f"holds {R.shape[1]} block a point; at least {MIN_BLOCKS} are needed to tell the noise")
    values: dict[str, Any] = {"R": R, "I": None}
    for name in ("U", "I", "Y"):
        if name == "I" and name not in d.datasets:
            continue
        value = d.array(name, np.complex128)
        if value.shape != R.shape:
            raise d.fail(name, f"has shape {value.shape}; R has {R.shape}, and both must agree")
        values[name] = value
    one = harmonics.index(1)
    first = np.take_along_axis(R[:, :, one], axis[:, None, None], axis=2)[:, :, 0]
    if excited and np.any((first == 0) & (amplitude > 0)[:, None]):
        point = int(np.argmax(np.any(first == 0, axis=1) & (amplitude > 0)))
        raise d.fail(
            "R", f"is zero in the excited axis of point {point}; set amplitude_a to 0 where nothing is excited"
        )
    # neither another order of harmonics nor another time origin is a loss: all that follows has them in its own
    order = sorted(range(len(harmonics)), key=harmonics.__getitem__)
    harmonics = tuple(harmonics[k] for k in order)
    values = {k: None if v is None else v[:, :, order] for k, v in values.items()}
    R = values["R"]
    origin = np.empty((*R.shape[:3], 1), dtype=np.complex128)
    for k in range(d.n_axes):
        origin[axis == k] = time_origin(R[axis == k], harmonics, k)
    origin[amplitude == 0] = 1
    return harmonics, {k: None if v is None else v * origin for k, v in values.items()}


def _records(
    d: _Datasets,
    frequency: NDArray[np.float64],
    axis: NDArray[np.int64],
    amplitude: NDArray[np.float64],
    rate: float,
    kind: str,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], tuple[int, ...], dict[str, Any]]:
    start = d.integers("sample_start", len(frequency) + 1)
    signals = _signals(d)
    n_samples = len(signals["r"])
    if np.any(np.diff(start) <= 0):
        point = int(np.argmax(np.diff(start) <= 0))
        raise d.fail("sample_start", f"does not rise from point {point} to {point + 1}; offsets must increase")
    if start[0] < 0 or start[-1] > n_samples:
        raise d.fail(
            "sample_start", f"runs from {start[0]} to {start[-1]}, but the signals hold {n_samples} samples: "
            "is the file cut short?"
        )  # fmt: skip
    if kind == "noise":
        start, frequency, axis, amplitude = _spectral_lines(d, start, axis, rate)
    lengths = np.diff(start) if kind != "noise" else np.full(len(frequency), start[1] - start[0])
    offsets = start[:-1] if kind != "noise" else np.full(len(frequency), start[0])
    periods = [whole_periods(int(n), f / rate) for n, f in zip(lengths, frequency, strict=True)]
    blocks = min(BLOCKS, *periods) if len(periods) > 1 else min(BLOCKS, periods[0])
    if blocks < MIN_BLOCKS:
        point = int(np.argmin(periods))
        raise d.fail(
            "sample_start",
            f"gives point {point} {lengths[point]} samples, {periods[point]} whole periods of {frequency[point]:g} Hz; "
            f"at least {MIN_BLOCKS} are needed to tell the noise: record longer",
        )
    collected: dict[str, list[NDArray[np.complex128]]] = {k: [] for k in signals}
    for k, f in enumerate(frequency):
        record = {name: v[offsets[k] : offsets[k] + lengths[k]] for name, v in signals.items()}
        try:
            point_values = demodulate(record, float(f), rate, int(axis[k]), blocks)
        except ValueError as error:
            raise d.fail("sample_start", f"leaves point {k} too short: {error}; record longer") from error
        for name, v in point_values.items():
            collected[name].append(v)
    values: dict[str, Any] = {name.upper(): np.array(v) for name, v in collected.items()}
    values.setdefault("I", None)
    return frequency, axis, amplitude, HARMONICS, values


def _signals(d: _Datasets) -> dict[str, NDArray[np.float64]]:
    signals: dict[str, NDArray[np.float64]] = {}
    for name in ("r", "u", "i", "y"):
        if name == "i" and name not in d.datasets:
            continue
        value = d.array(name, np.float64)
        n_samples = len(signals["r"]) if signals else None
        if value.ndim != 2 or value.shape[1] != d.n_axes or n_samples not in (None, len(value)):
            wanted = f"({'N' if n_samples is None else n_samples}, {d.n_axes})"
            raise d.fail(name, f"has shape {value.shape}; it must be {wanted}: samples, axes")
        signals[name] = value
    return signals


def _spectral_lines(
    d: _Datasets, start: NDArray[np.int64], axis: NDArray[np.int64], rate: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Lines of a zero-excitation record: its first stretch, cut in blocks, read at about 20 lines a decade."""
    samples = int(start[1] - start[0]) // SPECTRAL_BLOCKS
    if samples < 16:
        raise d.fail("sample_start", f"leaves a noise record of {start[1] - start[0]} samples; record at least 100")
    lines = spectral_lines(samples)
    return start[:2], lines * rate / samples, np.full(len(lines), axis[0]), np.zeros(len(lines))


def spectral_lines(samples: int) -> NDArray[np.int64]:
    """Periods per block of ``samples`` of the lines at which a noise record is read: 20 a decade, none twice."""
    top = samples // 2 - 1
    lines: NDArray[np.int64] = np.unique(np.round(np.geomspace(1, top, 1 + int(20 * np.log10(top)))).astype(np.int64))
    return lines
