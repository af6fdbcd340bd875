"""The curves of an identified rig as numbers, for whoever draws them: frequency response, Nyquist, step."""

from __future__ import annotations

from typing import Any

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.loop.closed_loop import loop_states, sampled
from service.identification.loop.margins import sensitivity
from service.identification.measured.etfe import FrequencyResponse
from service.identification.result.commissioning import CommissioningResult, PlaneResult
from sim.datasheet import Datasheet
from sim.folded import folded

FORMAT = "amb-model-curves"
_STEP_S = 0.25
_STEP_POINTS = 500


def curves(result: CommissioningResult, datasheet: Datasheet) -> dict[str, Any]:
    """Curves of every plane; lists are indexed [frequency or time][output][input], in the order of ``axes``.

    ``frequency_response`` is u to y (m/A), as sampled and as measured; ``nyquist`` the loop of each axis with the
    others closed; ``step`` the displacement (m) after 1 A more on r.
    """
    datasheet = folded(datasheet).datasheet
    return {
        "format": FORMAT,
        "version": 1,
        "rig": result.rig,
        "planes": {name: _plane(plane, datasheet) for name, plane in result.planes.items()},
    }


def _plane(plane: PlaneResult, datasheet: Datasheet) -> dict[str, Any]:
    c = plane.curves
    controller = (np.asarray(datasheet.numerator), np.asarray(datasheet.denominator))
    return {
        "axes": list(plane.axes),
        "frequency_response": {
            "unit": "m/A",
            "measured": _measured(c.measured),
            "unseen": None if c.validation is None else _measured(c.validation),
            "model": {
                "frequency_hz": _rounded(c.omega / (2 * np.pi)),
                **_complex(c.model),
                "std": _rounded(c.model_std),
            },
        },
        "nyquist": _nyquist(plane, controller),
        "step": _step(plane, controller),
    }


def _measured(response: FrequencyResponse) -> dict[str, Any]:
    return {
        "frequency_hz": _rounded(response.frequency_hz),
        **_complex(response.value),
        "std": _rounded(response.std),
    }


def _nyquist(plane: PlaneResult, controller: tuple[Real, Real]) -> dict[str, Any]:
    omega = plane.curves.omega
    s = sensitivity(plane.model, controller, omega)
    loop = np.stack([1.0 / s[:, k, k] - 1.0 for k in range(2)], axis=1)
    return {"frequency_hz": _rounded(omega / (2 * np.pi)), **_complex(loop)}


def _step(plane: PlaneResult, controller: tuple[Real, Real]) -> dict[str, Any]:
    """Displacement after a step of 1 A on r, sample by sample: exact however slowly the loop comes to rest."""
    sample_time_s = plane.model.known.sample_time_s
    plant, loop = sampled(plane.model), loop_states(plane.model, controller)
    n = len(plant.A)
    count = round(_STEP_S / sample_time_s)
    y = np.empty((count, 2, 2))
    state = np.zeros((len(loop.A), 2))
    for k in range(count):
        y[k] = plant.C @ state[:n]
        state = loop.A @ state
        state[:n] += plant.B
    every = max(1, count // _STEP_POINTS)
    return {
        "unit": "m",
        "time_s": _rounded(np.arange(0, count, every, dtype=np.float64) * sample_time_s),
        "displacement": _rounded(y[::every]),
    }


def _complex(value: Complex) -> dict[str, Any]:
    return {"re": _rounded(value.real), "im": _rounded(value.imag)}


def _rounded(value: Real) -> Any:
    """Nested lists with six digits: a drawing needs no more, and the file is a third of the size."""
    flat = [float(f"{x:.6g}") if np.isfinite(x) else None for x in np.ravel(value)]
    return np.array(flat, dtype=object).reshape(np.shape(value)).tolist()
